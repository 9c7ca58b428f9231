"""Scene + View -> Hits: the geometry of one view, traced once and kept."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property, partial
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar import runtime
from warpsar.errors import InputError
from warpsar.frame import ViewGeometry
from warpsar.merge import rows_by_key, sorted_rows
from warpsar.raster import ParallelRaster, Raster

if TYPE_CHECKING:
    import warp as wp

    from warpsar.mesh import Mesh

DEFAULT_MEMORY_GIB = 2.0
_RAY_BYTES = 96  # at most: its face, what the raster keeps of it, two rows of its band's table, their marks and ranks
_BAND_RAYS = 2**20  # of a CPU's band; smaller ones share more faces, and larger ones leave cores without
_TILE = (4, 8)  # rays of a CUDA warp: across azimuth, along elevation
_SEGMENT = 4  # rays of one CUDA thread when they are recorded
_KEPT_SHARE = 0.25  # of a CUDA device's memory, that a process does not hand back between views


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
    """A mesh on a device, about its reference point."""

    device: Any
    vertices: wp.array  # [m], shape (n,), vec3
    faces: wp.array  # shape (m, 3), int32
    corners: np.ndarray  # [m], shape (n, 3), float64, about the reference point
    places: wp.array  # the same on the device, vec3d
    _ends: dict[bytes, np.ndarray] = field(default_factory=dict)
    _bvh: wp.Mesh | None = None
    _building: Lock = field(default_factory=Lock)

    @classmethod
    def upload(cls, mesh: Mesh, reference_point_m: Any, device: Any) -> Target:
        import warp as wp

        corners = np.asarray(mesh.vertices, np.float64) - np.asarray(reference_point_m, np.float64)
        vertices: wp.array = wp.array(corners.astype(np.float32), dtype=wp.vec3, device=device)
        faces: wp.array = wp.array(np.ascontiguousarray(mesh.faces, np.int32), dtype=int, device=device)
        if device.is_cuda and wp.is_mempool_enabled(device):
            wp.set_mempool_release_threshold(device, _KEPT_SHARE)
        places: wp.array = wp.array(corners, dtype=wp.vec3d, device=device, copy=False)
        return cls(device, vertices, faces, corners, places)

    @property
    def bvh(self) -> wp.Mesh:
        """Built when a ray first asks for it: most views are traced without (`Raster`)."""
        import warp as wp

        with self._building:  # bands ask for it side by side
            if self._bvh is None:
                # Measured on CUDA (docs/benchmarks.md): cuBQL with two faces a leaf traces fastest, and is built in a
                # sixth of SAH's time.
                constructor, leaf = ("sah", None) if self.device.is_cpu else ("cubql", 2)
                faces = self.faces.flatten()
                self._bvh = wp.Mesh(self.vertices, faces, bvh_constructor=constructor, bvh_leaf_size=leaf)
        return self._bvh

    def ends(self, geometry: ViewGeometry) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest (X . d, X . u, elevation, distance from the track) of the mesh, float64, shape (4,) each.

        Elevation is X . v [m]; with a track, the angle about it [rad]. Found on the device: the host takes as long
        for a million vertices as CUDA for all of their image. Kept: whoever counts a view's rays traces them, too.
        """
        import warp as wp

        from warpsar.kernels.trace import BLOCK, extent_kernel
        from warpsar.kernels.wide import WARP

        track = geometry.slant_range_m or 0.0
        key = np.concatenate([geometry.d, geometry.u, geometry.v, [track]]).tobytes()
        if key in self._ends:
            return self._ends[key][:4], -self._ends[key][4:]
        axes = [wp.vec3d(*axis) for axis in (geometry.d, geometry.u, geometry.v)]
        threads = 1 if self.device.is_cpu else 512 * WARP
        ends = wp.empty((-(-threads // WARP), 8), dtype=wp.float64, device=self.device)
        inputs = [self.places, *axes, track, threads]
        wp.launch(extent_kernel, threads, inputs=inputs, outputs=[ends], device=self.device, block_dim=BLOCK)
        self._ends[key] = found = ends.numpy().min(axis=0)
        return found[:4], -found[4:]

    @cached_property
    def area_m2(self) -> float:
        """Area of all faces together."""
        import warp as wp

        from warpsar.kernels.raster import BLOCK, area_kernel

        area = wp.empty(1 if self.device.is_cpu else 16384, dtype=wp.float64, device=self.device)
        inputs = [self.vertices, self.faces]
        wp.launch(area_kernel, area.shape[0], inputs=inputs, outputs=[area], device=self.device, block_dim=BLOCK)
        return float(area.numpy().sum())


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
    only_columns: tuple[int, int] | None = None,
    max_memory_gib: float = DEFAULT_MEMORY_GIB,
    progress: Any = None,
) -> Hits:
    """Trace one view and bin it.

    `rays_per_m2` counts rays over the plane across the look direction. `deposit`: a ray's power goes to the bin
    of its sample ("nearest"), to the range bins its cell covers on the facet's plane ("footprint"), or is split
    between the two nearest bin centres in range ("linear", differentiable). `pixel_area_m2` divides the weights
    and is the grid's own unless the grid is finer than the image. `only_columns`: the first of the grid's and the one
    after the last, with the rays that they would have in the whole. Memory stays near `max_memory_gib` beside the hits
    themselves; the result does not depend on it, nor on the number of threads, nor on the order of CUDA's.
    """
    import warp as wp

    from warpsar.kernels import hit_lanes, record_lanes
    from warpsar.kernels import trace as kernels
    from warpsar.kernels.codes import Deposit

    device = target.device
    rays = ray_grid(target, geometry, grid, rays_per_m2, cells_multiple, pixel_area_m2 or grid.pixel_area_m2)
    first, last = rays.first_cell, rays.end_cell
    if only_columns is not None:
        first = max(first, only_columns[0] * rays.cells_per_column)
        last = max(first, min(last, only_columns[1] * rays.cells_per_column))
    faces = int(target.faces.shape[0])
    face_bits = max(1, (faces - 1).bit_length())
    key_bits = face_bits + max(1, (grid.shape[0] * grid.shape[1] - 1).bit_length())
    if key_bits > 62:
        raise InputError(
            f"[image] shape: {grid.shape[0]} x {grid.shape[1]} pixels with {faces} faces cannot be "
            f"numbered in 62 bits; allowed are {2 ** (62 - face_bits)} pixels"
        )
    codes = {code.name.lower(): code for code in Deposit}
    segment, block = rays.elevation_cells if device.is_cpu else _SEGMENT, kernels.BLOCK
    workers = runtime.thread_count() if device.is_cpu else 1
    most = min(max_memory_gib * 2**30 / workers / _RAY_BYTES, 2**29)  # rays of a band; rows are numbered in 31 bits

    def rows_expected(begin: int, end: int) -> float:
        """Rows of the table for the azimuth cells `begin` to `end`, with as many left free."""
        expected = 2.0 * (end - begin) * rays.elevation_cells
        if merge:
            # As many (pixel, face) as two nets of cells cut one another into, one surface deep; more is retried.
            pixels = grid.shape[0] * (end - begin) / rays.cells_per_column
            lit = faces * (end - begin) / max(rays.end_cell - rays.first_cell, 1)
            expected = min(expected, 2.0 * (math.sqrt(pixels) + math.sqrt(lit)) ** 2)
        return expected

    # whole columns of pixels, so that no two bands share one; at least 8 bands for the threads to share
    columns = -(-(last - first) // rays.cells_per_column)
    room = int(most / max(rays.elevation_cells, 1)) // rays.cells_per_column
    if device.is_cpu:
        # not by the number of threads: the bands' order is that of the hits
        pieces = max(8, (last - first) * rays.elevation_cells // _BAND_RAYS)
        room = min(room, -(-columns // pieces))
    width = max(1, min(room, columns)) * rays.cells_per_column

    kind: type[Raster | ParallelRaster] = Raster if device.is_cpu else ParallelRaster
    raster = kind.where_it_pays(target, rays, first, last)

    def recorded(begin: int, end: int, capacity: int) -> tuple[Any, Any, Any]:
        """Records of a band's rays in a table of `capacity` rows, or of more where they find no room; their keys in
        order, and their rows."""
        face = nearest_faces(target, rays, begin, end, seed) if raster is None else raster.nearest(begin, end, seed)
        records = kernels.Records()
        # a ray's own weight is at least 2^29 quanta, and at grazing incidence 1e6 times as much
        records.quanta = 2.0 ** (30 - math.floor(math.log2(1.0 / (rays_per_m2 * rays.pixel_area))))
        if device.is_cpu and merge:
            records.rows, taken = recorded_in_columns(
                target, rays, face, begin, end, capacity, seed, codes[deposit], face_bits, records.quanta
            )
            return records, *rows_by_key(records.rows, taken, key_bits)
        while True:
            records.rows = wp.zeros((capacity, 4), dtype=wp.int64, device=device)
            records.merge = int(merge)
            records.count = wp.zeros(2, dtype=int, device=device)
            inputs = [rays, target.vertices, target.faces, face, begin, segment, seed, int(codes[deposit]), face_bits]
            dim = (-(-rays.elevation_cells // segment), end - begin)
            wp.launch(kernels.record_kernel, dim, inputs=inputs, outputs=[records], device=device, block_dim=block)
            lost, taken, key, row = sorted_rows(records.rows, records.count, key_bits)
            if not lost:
                return records, key, row
            capacity = 4 * capacity if merge else taken

    def band(begin: int) -> tuple[Any, ...] | None:
        end = min(begin + width, last)
        sent = (end - begin) * rays.elevation_cells
        records, key, row = recorded(begin, end, int(rows_expected(begin, end)) + 1024)
        if progress is not None:
            progress.update(sent)
        n = row.shape[0]
        if not n:
            return None
        found = tuple(wp.empty(n, dtype=dtype, device=device) for dtype in dtypes)
        mesh = [rays, target.vertices, target.faces]
        if device.is_cpu:
            inputs = [*mesh, records.rows, records.quanta, key, row, face_bits]
            blocks = -(-n // hit_lanes.LANES)
            wp.launch(hit_lanes.hit_kernel, blocks, inputs=inputs, outputs=list(found), device=device)
        else:
            inputs = [*mesh, records, key, row, face_bits]
            wp.launch(kernels.hit_kernel, n, inputs=inputs, outputs=list(found), device=device, block_dim=block)
        return found

    names = ("pixel", "face", "barycentric", "weight", "point", "cos_incidence", "cos_twist", "cos2_azimuth")
    dtypes = (int, int, wp.vec2, float, wp.vec3, float, float, float)
    for module in [kernels, record_lanes, hit_lanes] if device.is_cpu else [kernels]:
        wp.load_module(module, device=device, block_dim=block)
    tasks = [partial(band, begin) for begin in range(first, last, width)]
    parts = [part for part in runtime.ordered(tasks, device) if part is not None]
    total_rays = (last - first) * rays.elevation_cells
    whole = [partial(concatenate, [part[k] for part in parts], dtype, device) for k, dtype in enumerate(dtypes)]
    arrays: dict[str, Any] = dict(zip(names, runtime.ordered(whole, device), strict=True))
    return Hits(grid, geometry, rays_per_m2=rays_per_m2, seed=seed, rays=total_rays, **arrays)


def nearest_faces(target: Target, rays: Any, begin: int, end: int, seed: int) -> Any:
    """The face that each ray of the azimuth cells `begin` to `end` meets first, or -1; int, shape (rays of the band,),
    the elevation cells of one azimuth cell side by side."""
    import warp as wp

    from warpsar.kernels.trace import BLOCK, query_kernel

    face = wp.empty((end - begin) * rays.elevation_cells, dtype=int, device=target.device)
    # a CPU launch walks its threads one after the other: down the columns
    tile = (1, rays.elevation_cells) if target.device.is_cpu else _TILE
    dim = (-(-(end - begin) // tile[0]), -(-rays.elevation_cells // tile[1]), tile[0] * tile[1])
    inputs = [rays, target.bvh.id, begin, end, *tile, seed]
    wp.launch(query_kernel, dim, inputs=inputs, outputs=[face], device=target.device, block_dim=BLOCK)
    return face


def recorded_in_columns(
    target: Target,
    rays: Any,
    face: Any,
    begin: int,
    end: int,
    capacity: int,
    seed: int,
    deposit: int,
    face_bits: int,
    quanta: float,
) -> tuple[Any, int]:
    """Records of the band's rays on the CPU, merged, in the order in which their columns left them: rows as in
    `kernels.trace.Records`, with the key itself, and how many. `capacity` of them are expected at most."""
    import warp as wp

    from warpsar.kernels import record_lanes as kernels

    device, columns = target.device, (end - begin) // rays.cells_per_column
    across, along = (wp.empty(face.shape[0] + kernels.LANES, dtype=float, device=device) for _ in range(2))
    inputs = [rays, begin, seed]
    wp.launch(kernels.jitter_kernel, end - begin, inputs=inputs, outputs=[across, along], device=device)
    while True:
        taken = wp.zeros(1, dtype=int, device=device)
        rows = wp.empty((capacity, 4), dtype=wp.int64, device=device)
        link = wp.empty(capacity, dtype=int, device=device)
        head = wp.empty(1 << (capacity // columns).bit_length(), dtype=int, device=device)
        inputs = [rays, target.vertices, target.faces, face, across, along, begin, int(deposit), face_bits, quanta]
        outputs = [head, link, taken, rows]
        wp.launch(kernels.record_kernel, columns, inputs=inputs, outputs=outputs, device=device)
        found = int(taken.numpy()[0])
        if found <= capacity:
            return rows, found
        capacity = found


def ray_count(
    target: Target, geometry: ViewGeometry, grid: BinGrid, rays_per_m2: float, cells_multiple: int = 1
) -> int:
    """Rays that `trace` will send: what a progress bar counts to."""
    rays = ray_grid(target, geometry, grid, rays_per_m2, cells_multiple, grid.pixel_area_m2)
    first, last = rays.first_cell, rays.end_cell
    return (last - first) * rays.elevation_cells


def launch_layers(
    target: Target, geometry: ViewGeometry, grid: BinGrid, rays_per_m2: float
) -> tuple[np.ndarray, np.ndarray]:
    """Visits of the lit surface per pixel (float32) and whether a hidden surface lies there (bool), (rows * cols,)."""
    import warp as wp

    from warpsar.kernels import layers as kernels

    device = target.device
    rays = ray_grid(target, geometry, grid, rays_per_m2, 1, grid.pixel_area_m2)
    first, last = rays.first_cell, rays.end_cell
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

    low, high = target.ends(geometry)
    spacing = grid.spacing_m[1]
    per_column = max(1, round(spacing * math.sqrt(rays_per_m2) / cells_multiple)) * cells_multiple
    step = spacing / per_column
    across_step = 1.0 / (rays_per_m2 * step)
    rays = RayGrid()
    rays.d, rays.u, rays.v = (wp.vec3(*axis) for axis in (geometry.d, geometry.u, geometry.v))
    margin = 1e-3 * max(1.0, high[0] - low[0])
    rays.standoff = float(margin - low[0])
    if geometry.slant_range_m is None:
        rays.slant_range = 0.0
        rays.reach = float(high[0] - low[0] + 3 * margin)
    else:
        r0 = geometry.slant_range_m
        if low[0] <= -r0:
            raise InputError(
                f"[radar] slant_range_m: found {r0:g}, and the mesh reaches {-low[0]:g} m toward the radar; "
                f"allowed is a track in front of the whole mesh"
            )
        rays.slant_range = r0
        rays.standoff = min(rays.standoff, r0)
        rays.reach = float(high[3] - r0 + rays.standoff + 3 * margin)
        across_step /= r0
    rays.azimuth_start = grid.start_m[1]
    rays.azimuth_step = step
    rays.cells_per_column = per_column
    rays.elevation_cells = max(1, math.ceil((high[2] - low[2]) / across_step * (1 - 1e-9)))
    rays.elevation_step = across_step
    # centred, so that a mesh seen from the opposite side meets the same strata
    rays.elevation_start = float((low[2] + high[2]) / 2 - rays.elevation_cells * across_step / 2)
    rays.range_start = grid.start_m[0]
    rays.range_spacing = grid.spacing_m[0]
    rays.rows, rays.cols = grid.shape
    rays.pixel_area = pixel_area_m2
    width = rays.azimuth_step * per_column
    first = max(0, math.floor((low[1] - rays.azimuth_start) / width))
    end = min(rays.cols, math.ceil((high[1] - rays.azimuth_start) / width))
    rays.first_cell, rays.end_cell = first * per_column, max(first, end) * per_column
    return rays
