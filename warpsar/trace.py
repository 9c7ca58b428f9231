"""Scene + View -> Hits: the geometry of one view, traced once and kept."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar import runtime
from warpsar.errors import InputError
from warpsar.frame import ViewGeometry
from warpsar.merge import merge_records

if TYPE_CHECKING:
    import warp as wp

    from warpsar.mesh import Mesh

DEFAULT_MEMORY_GIB = 2.0
_RECORDS_PER_RAY = 2
_RECORD_BYTES = 52  # key, weight, moment; the sort's keys, order, starts
_SEGMENT = 64  # cells of one thread on CUDA, where the columns alone are too few threads


@dataclass(frozen=True)
class BinGrid:
    """Bins of [range, azimuth] about the reference point: shape (rows, cols), `spacing_m` (range, azimuth) [m].

    `bins_per_pixel` of them, per axis, make a pixel of the image; the grid may be wider than the image, by whole
    pixels and as much on each side.
    """

    shape: tuple[int, int]
    spacing_m: tuple[float, float]
    bins_per_pixel: int = 1

    @property
    def start_m(self) -> tuple[float, float]:
        """Range of row 0's and azimuth of column 0's outer edge [m]."""
        return (-self.shape[0] / 2 * self.spacing_m[0], -self.shape[1] / 2 * self.spacing_m[1])

    @property
    def pixel_area_m2(self) -> float:
        return self.spacing_m[0] * self.spacing_m[1]


@dataclass
class Target:
    """A mesh on a device, about its reference point, with its BVH."""

    device: Any
    vertices: wp.array  # [m], shape (n,), vec3
    faces: wp.array  # shape (m, 3), int32
    bvh: wp.Mesh
    corners: np.ndarray  # [m], shape (n, 3), float64, about the reference point

    @classmethod
    def upload(cls, mesh: Mesh, reference_point_m: Any, device: Any) -> Target:
        import warp as wp

        corners = np.asarray(mesh.vertices, np.float64) - np.asarray(reference_point_m, np.float64)
        vertices: wp.array = wp.array(corners.astype(np.float32), dtype=wp.vec3, device=device)
        faces: wp.array = wp.array(np.ascontiguousarray(mesh.faces, np.int32), dtype=int, device=device)
        # Measured on CUDA: cuBQL traces 4.85 Grays/s, SAH 4.2, the default 3.4 (docs/benchmarks.md).
        constructor = "sah" if device.is_cpu else "cubql"
        bvh = wp.Mesh(vertices, faces.flatten(), bvh_constructor=constructor)
        return cls(device, vertices, faces, bvh, corners)


@dataclass
class Hits:
    """Lit surface of one view, on a device; arrays of shape (n,).

    `pixel` is row * cols + col in `grid`; `barycentric` holds the weights of the face's second and third vertex;
    `weight` is the sum of dA_perp / cos(theta) over the rays, divided by the pixel area (scene-format.md, "Pixel
    value"); `point` [m] is about the reference point; `cos_twist` is cos psi of the facet's basis, and
    `cos2_azimuth` tells how the look direction lies to the facet's horizontal (for the separable spectrum alone).
    """

    grid: BinGrid
    geometry: ViewGeometry
    pixel: wp.array
    face: wp.array
    barycentric: wp.array
    weight: wp.array
    point: wp.array
    cos_incidence: wp.array
    cos_twist: wp.array
    cos2_azimuth: wp.array
    rays_per_m2: float
    seed: int
    rays: int
    kept: dict[Any, Any] = field(default_factory=dict)  # what effects traced besides, for models that share the hits

    @property
    def count(self) -> int:
        return int(self.pixel.shape[0])


def trace(
    target: Target,
    geometry: ViewGeometry,
    grid: BinGrid,
    rays_per_m2: float,
    *,
    seed: int = 0,
    deposit: str = "footprint",
    merge: bool = True,
    cells_multiple: int = 1,
    pixel_area_m2: float | None = None,
    max_memory_gib: float = DEFAULT_MEMORY_GIB,
    progress: Any = None,
) -> Hits:
    """Trace one view and bin it.

    `rays_per_m2` counts rays over the plane across the look direction. `deposit`: a ray's power goes to the bin
    of its sample ("nearest"), to the range bins its cell covers on the facet's plane ("footprint"), or is split
    between the two nearest bin centres in range ("linear", differentiable). `pixel_area_m2` divides the weights
    and is the grid's own unless the grid is finer than the image. Memory stays near `max_memory_gib` beside the
    hits themselves; the result does not depend on it, nor on the number of threads.
    """
    import warp as wp

    from warpsar.kernels import trace as kernels

    device = target.device
    rays = ray_grid(target, geometry, grid, rays_per_m2, cells_multiple, pixel_area_m2 or grid.pixel_area_m2)
    first, last = cells_on_the_mesh(target, geometry, rays)
    face_bits = max(1, int(target.faces.shape[0] - 1).bit_length())
    key_bits = face_bits + max(1, (grid.shape[0] * grid.shape[1] - 1).bit_length())
    if key_bits > 63:
        raise InputError(
            f"[image] shape: {grid.shape[0]} x {grid.shape[1]} pixels with {target.faces.shape[0]} faces cannot be "
            f"numbered in 63 bits; allowed are {2 ** (63 - face_bits)} pixels"
        )
    codes = {"nearest": kernels.NEAREST, "linear": kernels.LINEAR, "footprint": kernels.FOOTPRINT}
    segment = rays.elevation_cells if device.is_cpu else _SEGMENT
    workers = runtime.thread_count() if device.is_cpu else 1
    most = min(max_memory_gib * 2**30 / workers / _RECORD_BYTES, 2**30)  # records, numbered in 31 bits
    room = most / (_RECORDS_PER_RAY * max(rays.elevation_cells, 1))
    # whole columns of pixels, so that no two bands share one; at least 8 bands for the threads to share
    columns = -(-(last - first) // rays.cells_per_column)
    per_band = max(1, min(int(room) // rays.cells_per_column, -(-columns // 8) if device.is_cpu else columns))
    width = per_band * rays.cells_per_column

    def band(begin: int) -> tuple[Any, ...] | None:
        end = min(begin + width, last)
        dim = (end - begin, -(-rays.elevation_cells // segment))
        # Rays in a run share a record, and one may leave a few; where that is not enough the count says so, and all
        # is traced again.
        capacity = max(4096, (end - begin) * rays.elevation_cells * _RECORDS_PER_RAY)
        while True:
            records = kernels.Records()
            records.key = wp.empty(capacity, dtype=wp.int64, device=device)
            records.weight = wp.empty(capacity, dtype=float, device=device)
            records.moment = wp.empty(capacity, dtype=wp.vec2, device=device)
            records.count = wp.zeros(1, dtype=int, device=device)
            wp.launch(
                kernels.trace_kernel,
                dim,
                inputs=[
                    rays,
                    target.bvh.id,
                    target.vertices,
                    target.faces,
                    begin,
                    segment,
                    seed,
                    int(codes[deposit]),
                    face_bits,
                    int(merge),
                ],
                outputs=[records],
                device=device,
            )
            count = int(records.count.numpy()[0])
            if count <= capacity:
                break
            capacity = count
        if progress is not None:
            progress.update(dim[0] * rays.elevation_cells)
        if not count:
            return None
        key = wp.empty(2 * count, dtype=wp.int64, device=device)
        wp.copy(key, records.key, count=count)
        pixel, face, weight, barycentric = merge_records(
            key, records.weight, records.moment, count, key_bits, face_bits, merge
        )
        n = pixel.shape[0]
        point = wp.empty(n, dtype=wp.vec3, device=device)
        cos_incidence = wp.empty(n, dtype=float, device=device)
        cos_twist = wp.empty(n, dtype=float, device=device)
        cos2_azimuth = wp.empty(n, dtype=float, device=device)
        wp.launch(
            kernels.hit_geometry_kernel,
            n,
            inputs=[rays, target.vertices, target.faces, face, barycentric],
            outputs=[point, cos_incidence, cos_twist, cos2_azimuth],
            device=device,
        )
        return pixel, face, barycentric, weight, point, cos_incidence, cos_twist, cos2_azimuth

    wp.load_module(kernels, device=device)
    tasks = [partial(band, begin) for begin in range(first, last, width)]
    parts = [part for part in runtime.ordered(tasks, device) if part is not None]
    total_rays = (last - first) * rays.elevation_cells
    dtypes = (int, int, wp.vec2, float, wp.vec3, float, float, float)
    names = ("pixel", "face", "barycentric", "weight", "point", "cos_incidence", "cos_twist", "cos2_azimuth")
    arrays: dict[str, Any] = {
        name: concatenate([part[k] for part in parts], dtype, device)
        for k, (name, dtype) in enumerate(zip(names, dtypes, strict=True))
    }
    return Hits(grid, geometry, rays_per_m2=rays_per_m2, seed=seed, rays=total_rays, **arrays)


def ray_count(
    target: Target, geometry: ViewGeometry, grid: BinGrid, rays_per_m2: float, cells_multiple: int = 1
) -> int:
    """Rays that `trace` will send: what a progress bar counts to."""
    rays = ray_grid(target, geometry, grid, rays_per_m2, cells_multiple, grid.pixel_area_m2)
    first, last = cells_on_the_mesh(target, geometry, rays)
    return (last - first) * rays.elevation_cells


def launch_layers(
    target: Target, geometry: ViewGeometry, grid: BinGrid, rays_per_m2: float
) -> tuple[np.ndarray, np.ndarray]:
    """Visits of the lit surface per pixel (float32) and whether a hidden surface lies there (bool), (rows * cols,)."""
    import warp as wp

    from warpsar.kernels import layers as kernels

    device = target.device
    rays = ray_grid(target, geometry, grid, rays_per_m2, 1, grid.pixel_area_m2)
    first, last = cells_on_the_mesh(target, geometry, rays)
    visits = wp.zeros(grid.shape[0] * grid.shape[1], dtype=float, device=device)
    hidden = wp.zeros(grid.shape[0] * grid.shape[1], dtype=int, device=device)
    width = max(1, -(-(last - first) // rays.cells_per_column // 8)) * rays.cells_per_column

    def band(begin: int) -> None:
        # bands are whole columns of pixels: no two threads write into one
        wp.launch(
            kernels.layers_kernel,
            min(width, last - begin),
            inputs=[rays, target.bvh.id, target.vertices, target.faces, begin],
            outputs=[visits, hidden],
            device=device,
        )

    if last > first:
        wp.load_module(kernels, device=device)
        for _ in runtime.ordered([partial(band, begin) for begin in range(first, last, width)], device):
            pass
    return visits.numpy(), hidden.numpy() > 0


def concatenate(parts: list[Any], dtype: Any, device: Any) -> Any:
    import warp as wp

    if len(parts) == 1:
        return parts[0]
    whole = wp.empty(sum(p.shape[0] for p in parts), dtype=dtype, device=device)
    at = 0
    for part in parts:
        wp.copy(whole, part, dest_offset=at, count=part.shape[0])
        at += part.shape[0]
    return whole


def ray_grid(
    target: Target,
    geometry: ViewGeometry,
    grid: BinGrid,
    rays_per_m2: float,
    cells_multiple: int,
    pixel_area_m2: float,
) -> Any:
    """Cells nest in the columns of `grid`, `cells_multiple` or a multiple of it to a column, about square."""
    import warp as wp

    from warpsar.kernels.geometry import RayGrid

    along = target.corners @ geometry.d
    across = target.corners @ geometry.v
    spacing = grid.spacing_m[1]
    per_column = max(1, round(spacing * math.sqrt(rays_per_m2) / cells_multiple)) * cells_multiple
    step = spacing / per_column
    across_step = 1.0 / (rays_per_m2 * step)
    rays = RayGrid()
    rays.d, rays.u, rays.v = (wp.vec3(*axis) for axis in (geometry.d, geometry.u, geometry.v))
    margin = 1e-3 * max(1.0, float(np.ptp(along)))
    rays.standoff = float(margin - along.min())
    if geometry.slant_range_m is None:
        rays.slant_range = 0.0
        rays.reach = float(np.ptp(along) + 3 * margin)
        low, high = across.min(), across.max()
    else:
        r0 = geometry.slant_range_m
        if along.min() <= -r0:
            raise InputError(
                f"[radar] slant_range_m: found {r0:g}, and the mesh reaches {-along.min():g} m toward the radar; "
                f"allowed is a track in front of the whole mesh"
            )
        rays.slant_range = r0
        rays.standoff = min(rays.standoff, r0)
        rays.reach = float(np.hypot(along + r0, across).max() - r0 + rays.standoff + 3 * margin)
        angle = np.arctan2(across, along + r0)
        low, high = angle.min(), angle.max()
        across_step /= r0
    rays.azimuth_start = grid.start_m[1]
    rays.azimuth_step = step
    rays.cells_per_column = per_column
    rays.elevation_cells = max(1, math.ceil((high - low) / across_step * (1 - 1e-9)))
    rays.elevation_step = across_step
    # centred, so that a mesh seen from the opposite side meets the same strata
    rays.elevation_start = float((low + high) / 2 - rays.elevation_cells * across_step / 2)
    rays.range_start = grid.start_m[0]
    rays.range_spacing = grid.spacing_m[0]
    rays.rows, rays.cols = grid.shape
    rays.pixel_area = pixel_area_m2
    return rays


def cells_on_the_mesh(target: Target, geometry: ViewGeometry, rays: Any) -> tuple[int, int]:
    """Azimuth cells, in whole columns of the image, that can meet the mesh."""
    azimuth = target.corners @ geometry.u
    width = rays.azimuth_step * rays.cells_per_column
    first = max(0, math.floor((azimuth.min() - rays.azimuth_start) / width))
    last = min(rays.cols, math.ceil((azimuth.max() - rays.azimuth_start) / width))
    return first * rays.cells_per_column, max(first, last) * rays.cells_per_column
