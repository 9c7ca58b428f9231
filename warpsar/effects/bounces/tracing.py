"""Paths of rays over several surfaces, with the angles on them: traced once, and merged by bin and faces."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha1
from itertools import pairwise
from threading import Lock
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.effects.base.recorder import Recorder
from warpsar.effects.bounces.cells import (
    BRIGHT,
    Borders,
    CellSamples,
    Coupled,
    SharedFields,
    bodies_of,
    borders_of,
    cells_of,
    couple,
    errors_left,
    kinds_of,
    samples_of,
    share,
    tubes_of,
)
from warpsar.effects.bounces.curved import CurvedFaces, curved_faces, pieces_of
from warpsar.kernels import merge as merging
from warpsar.kernels.effects import multibounce as kernels
from warpsar.kernels.effects import multibounce_cells, multibounce_spread
from warpsar.kernels.geometry import Band, RayGrid
from warpsar.runtime import devices, threads
from warpsar.runtime.structs import allocate, element_types, fill
from warpsar.trace.hits import DEFAULT_MEMORY_GIB, BinGrid, concatenate
from warpsar.trace.rays import ray_grid
from warpsar.trace.target import Target

_RECORD_BYTES = 272  # a record, its field, and the sort's keys and order, twice
_SEGMENT = 64  # cells of one thread on CUDA
_FEWEST_BANDS, _MOST_BANDS = 8, 64  # on the CPU, where there is memory for them
_RAYS_OF_BAND = 100_000  # from so many on, a launch costs little beside them
_MOST_KEPT = 2**22  # records of paths that are kept, about half a GiB
_UNSURE = 0.12  # of a bright corner's power, half a decibel: rays are too few
_FAINTEST = 1e-3  # of a field, that a face is taken to mirror at least
_BUDGET = 3  # times the rays of a view, that cutting may add
_LEAST_BUDGET = 3_000_000  # rays that it may add to a small view
_FINE = 4.0  # ray cells, below which pieces of a curved surface have no borders: a strip would be cut at many
_STRIPS, _RAYS_OF_STRIP = 4, 90  # into which a cell at a border is cut, and rays that find where one lies and ends

_SPREAD_TASKS = 16  # at most, that tubes of one size are shared out among
_LEAST_TASK = 4096  # tubes

_MORE_TUBES = (
    "multibounce: ways over several curved surfaces need more tubes than the view may have, and lack power; "
    "give the view fewer curved bodies, or leave them flat faces"
)

_ARRAYS = {n: dtype for n, dtype in element_types(kernels.PathRecords).items() if n not in ("count", "area", "wide")}


@dataclass
class BouncePaths:
    """Paths of one number of bounces; arrays of shape (n,).

    `pixel` is a bin of the hits' grid. `weight` is dA_perp / cos(theta_n) over the pixel area. `point` [m] is where a
    single bounce would have the path's range, azimuth and mean elevation. At the last bounce, `cos_half` is between
    half vector and incoming direction, `cos_tilt` between half vector and normal. `arrival` is the direction of the
    ray to the first surface, `home` that from the last one to the radar.
    """

    bounces: list[kernels.Bounce]
    pixel: wp.array
    weight: wp.array
    point: wp.array
    cos_half: wp.array
    cos_tilt: wp.array
    arrival: wp.array
    home: wp.array


@dataclass
class CoherentPaths:
    """Paths by the cells in which their fields add up: `paths` has one for each sample and each order of faces."""

    paths: BouncePaths
    samples: CellSamples


@dataclass
class BouncesOfOneNumber:
    """Paths of one number of bounces, merged by bin and faces; by cells too, where these were asked for."""

    paths: BouncePaths
    coherent: CoherentPaths | None = None


@dataclass
class TracedPaths:
    """Paths of 2, 3, ... bounces, None where there are none of a number, and what a user should be told of them.

    `further`: share of the rays that meet two surfaces and go on to another one after all bounces. `without_cells`
    makes what the same rays have without cells, as if these had not been asked for.
    """

    of: list[BouncesOfOneNumber | None]
    further: float
    remarks: list[str]
    without_cells: Callable[[], TracedPaths]


def trace_paths(render: Recorder, max_bounces: int, cell_m: tuple[float, float] | None = None) -> TracedPaths:
    """Paths of 2, 3, ... `max_bounces` bounces, with the density and seed of the view's hits.

    With `cell_m`, the size of a resolution cell (range, azimuth) [m], their fields are summed over cells too, and cells
    at the borders of corners are cut finer, but for coarse hits. Rays do not know what a surface is made of: those of
    one mesh, view and grid are followed once, whoever asks.
    """
    followed = _FOLLOWED.of(
        _key(render, max_bounces, cell_m), render.stage.target.device, partial(_followed, render, max_bounces, cell_m)
    )
    found = [None if paths is None else BouncesOfOneNumber(paths) for paths in followed.paths]
    if cell_m is not None:
        hits, target = render.hits, render.stage.target
        device = target.device
        area = render.spacing_m[0] * render.spacing_m[1]
        (kinds, planes), mirrors = _kinds(render), _mirrors(render)
        bodies = bodies_of(target.corner_numbers, planes)
        for at, fields in enumerate(followed.shared):
            if fields is not None:
                made, samples = samples_of(fields, kinds, bodies, mirrors, hits.grid.shape[1], area, device)
                own: dict[str, Any] = {
                    name: wp.array(made[name], dtype=dtype, device=device) for name, dtype in _ARRAYS.items()
                }
                paths = fill(kernels.PathRecords, **own)
                coherent = CoherentPaths(_paths(paths, at + 2, followed.rays, target, followed.smooth), samples)
                plain = followed.paths[at]
                if plain is None:  # no ray over flat faces returns: one that scatters nothing
                    own["weight"].zero_()
                    plain = _paths(
                        fill(kernels.PathRecords, **{n: a[:1] for n, a in own.items()}), at + 2, followed.rays, target
                    )
                found[at] = BouncesOfOneNumber(plain, coherent)
    return TracedPaths(found, followed.further, list(followed.remarks), followed.without_cells)


@dataclass(frozen=True)
class _Followed:
    """What rays have met: the `paths` of 2, 3, ... bounces, and their fields by sample where these were asked for.
    `smooth`: a `kernels.SmoothFaces`."""

    rays: RayGrid
    smooth: Any
    paths: list[BouncePaths | None]
    shared: list[SharedFields | None]
    further: float
    remarks: list[str]
    without_cells: Callable[[], TracedPaths]

    @property
    def size(self) -> int:
        """Records that are held."""
        fields = sum(one.field.size + one.owner.size for one in self.shared if one is not None)
        return 2 * sum(int(one.pixel.shape[0]) for one in self.paths if one is not None) + fields


class _Kept:
    """What was followed lately, by `_key`; the oldest goes first."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Hashable, _Followed] = OrderedDict()
        self._lock = Lock()

    def of(self, key: Hashable, device: wp.Device, follow: Callable[[], _Followed]) -> _Followed:
        """What `follow` finds, or has found."""
        key = (str(device), key)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        found = follow()
        with self._lock:
            self._kept[key] = found
            while sum(one.size for one in self._kept.values()) > _MOST_KEPT:
                self._kept.popitem(last=False)
        return found


_FOLLOWED = _Kept()


def _key(render: Recorder, max_bounces: int, cell_m: tuple[float, float] | None) -> Hashable:
    """Everything that decides where rays go, and how their fields are added up."""
    hits, target = render.hits, render.stage.target
    geometry = hits.geometry
    mesh = sha1(target.corners.tobytes())
    mesh.update(target.corner_numbers.tobytes())
    if cell_m is not None:
        mesh.update(render.stage.face_material.numpy().tobytes())
    axes = np.concatenate([geometry.d, geometry.u, geometry.v]).tobytes()
    view = axes, geometry.wavenumber, geometry.slant_range_m, hits.grid, hits.rays_per_m2, hits.seed, render.spacing_m
    return mesh.digest(), view, max_bounces, cell_m, None if cell_m is None else (render.taper, hits.coarse)


def _followed(render: Recorder, max_bounces: int, cell_m: tuple[float, float] | None) -> _Followed:
    """Follow the rays of a view's grid."""
    hits, target = render.hits, render.stage.target
    # Rays that enter beside the image may leave inside: half of it on each side, and no farther than the mesh.
    grid = hits.grid
    shape = grid.shape[0], round((1.0 + 2.0 * grid.strip.beside) * grid.shape[1])
    wide = BinGrid(shape, grid.spacing_m, strip=grid.strip)
    area = render.spacing_m[0] * render.spacing_m[1]
    rays = ray_grid(target, hits.geometry, wide, hits.rays_per_m2, area)
    first, last = rays.first_cell, rays.end_cell
    width = _band_width(rays, max_bounces, target.device)
    devices.load_kernels(target.device, "effects.multibounce")
    cells = None if cell_m is None else cells_of(grid, cell_m, render.taper, target.device)
    bands = [
        fill(Band, first_cell=begin, end_cell=min(begin + width, last), seed=hits.seed)
        for begin in range(first, last, width)
    ]
    pieces = pieces_of(*target.places_once, planes := planes_of(target))
    curved = curved_faces(*target.places_once, pieces)
    planes = pieces.surfaces(planes, _FINE / hits.rays_per_m2)
    sent = _path_rays(render, rays, planes, curved, max_bounces)
    size = (last - first, rays.elevation_cells) if cells is not None and curved.turn.any() else (0, 0)
    spread_from: wp.array = wp.zeros(size, dtype=wp.uint8, device=target.device)
    tasks = [partial(_band, render, sent, cells, band, spread_from) for band in bands]
    traced_bands = list(threads.ordered(tasks, target.device))
    plain = [_Traced([one and _Merged(one.records, None) for one in band.of], band.area) for band in traced_bands]
    shared: list[SharedFields | None] = [None] * (max_bounces - 1)
    error = 0.0
    if cell_m is not None:
        shared = _shared(traced_bands, max_bounces, grid, cell_m)
        cuts, error = ({}, 0.0) if hits.coarse else _cuts(shared, planes, sent, bands, target.device)
        if cuts:
            none: wp.array = wp.empty((0, 0), dtype=wp.uint8, device=target.device)
            again = [partial(_band, render, sent, cells, bands[at], none, cut) for at, cut in cuts.items()]
            finer = dict(zip(cuts, threads.ordered(again, target.device), strict=True))
            traced_bands = [finer.get(at, one) for at, one in enumerate(traced_bands)]
            shared = _shared(traced_bands, max_bounces, grid, cell_m)
    remarks = _remarks(error)
    smooth = fill(kernels.SmoothFaces, turn=wp.empty(0, dtype=float, device=target.device))
    if cell_m is not None and spread_from.shape[0] > 0:
        smooth = fill(
            kernels.SmoothFaces,
            turn=sent.turn,
            normals=wp.array(curved.normals, dtype=wp.vec3d, device=target.device),
        )
        spread, all_sent = _spread(render, sent, cells, smooth, spread_from.numpy())
        if any(one is not None for band in spread for one in band.of):
            shared = _shared([*traced_bands, *spread], max_bounces, grid, cell_m)
        if not all_sent:
            remarks.append(_MORE_TUBES)

    def without_cells() -> TracedPaths:
        paths = _joined(plain, max_bounces, rays, target)
        found = [None if one is None else BouncesOfOneNumber(one) for one in paths]
        return TracedPaths(found, _further(plain), [], without_cells)

    paths, further = _joined(traced_bands, max_bounces, rays, target), _further(traced_bands)
    return _Followed(rays, smooth, paths, shared, further, remarks, without_cells)


def _joined(traced: Sequence[_Traced], max_bounces: int, rays: RayGrid, target: Target) -> list[BouncePaths | None]:
    """The paths of all bands by number of bounces, two first; None where there are none."""
    found: list[BouncePaths | None] = []
    for index in range(max_bounces - 1):
        mine = [merged.records for one in traced if (merged := one.of[index]) is not None]
        if not mine:
            found.append(None)
            continue
        arrays = {
            name: concatenate([getattr(one, name) for one in mine], dtype, target.device)
            for name, dtype in _ARRAYS.items()
        }
        found.append(_paths(fill(kernels.PathRecords, **arrays), index + 2, rays, target))
    return found


def _kinds(render: Recorder) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """`kinds_of` the faces of the mesh by their material, and by their plane (`planes_of`)."""
    target = render.stage.target
    return kinds_of(_normals(target), render.stage.face_material.numpy()), planes_of(target)


def planes_of(target: Target) -> NDArray[np.int64]:
    """`kinds_of` the faces of the mesh by their plane, to a centimetre."""
    normal = _normals(target)
    distance = np.round((normal * target.corners[target.corner_numbers[:, 0]]).sum(axis=1), 2)
    return kinds_of(normal, distance)


def _normals(target: Target) -> NDArray[np.float64]:
    p0, p1, p2 = (target.corners[corner] for corner in target.corner_numbers.T)
    normal = np.cross(p1 - p0, p2 - p0)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    found: NDArray[np.float64] = normal / np.maximum(length, np.finfo(float).tiny)
    return found


def _mirrors(render: Recorder) -> NDArray[np.float64]:
    """About how much of a field each face mirrors as its surface is declared: at normal incidence, with what roughness
    takes at 45 degrees. It tells corners of one sample apart, and enters no power."""
    stage, loss = render.stage, []
    for name, eps_im in zip(stage.surface.materials, stage.surface.eps_im, strict=True):
        eps, height = (float(stage.surface.values(name, key).mean()) for key in ("eps_r", "rms_height_m"))
        index = np.sqrt(eps - 1j * float(eps_im))
        loss.append(abs((index - 1.0) / (index + 1.0)) * np.exp(-((render.hits.geometry.wavenumber * height) ** 2)))
    return np.maximum(np.array(loss), _FAINTEST)[stage.face_material.numpy()]


def _shared(
    traced: Sequence[_Traced], max_bounces: int, grid: BinGrid, cell_m: tuple[float, float]
) -> list[SharedFields | None]:
    """The fields of all bands' paths by number of bounces, two first; None where there are no paths."""
    found: list[SharedFields | None] = []
    for index in range(max_bounces - 1):
        mine = [merged.coupled for one in traced if (merged := one.of[index]) is not None]
        found.append(share(mine, grid, cell_m) if mine else None)
    return found


def _further(traced: Sequence[_Traced]) -> float:
    """Share of the rays that meet two surfaces and go on to another one after all bounces."""
    met, further = np.sum([one.area for one in traced], axis=0) if traced else (0.0, 0.0)
    return float(further / met) if further else 0.0


def _remarks(error: float) -> list[str]:
    """What a user should be told of rays that bright corners lack (`error` of power)."""
    if error <= _UNSURE:
        return []
    return [
        f"multibounce: bright corners get so few rays that their power is known to {100 * error:.0f} % alone; "
        "more rays_per_pixel of [sampling] are needed"
    ]


def _cuts(
    shared: Sequence[SharedFields | None],
    planes: NDArray[np.int64],
    followed: Any,
    bands: Sequence[Any],
    device: wp.Device,
) -> tuple[dict[int, NDArray[np.int32]], float]:
    """The bands that have cells to cut, each with those of `kernels.border_kernel`, (n, 4).

    All cuts together send at most `_BUDGET` times as many rays again: the view's brightest samples come first. And the
    largest relative error that is left of the power of one of the brightest corners.
    """
    there = [fields for fields in shared if fields is not None]
    found = [borders_of(fields, planes) for fields in there]
    if not any(len(one.cell) for one in found):
        return {}, 0.0
    rays = followed.grid
    size = rays.end_cell - rays.first_cell, rays.elevation_cells
    cell, error, bright = (
        np.concatenate([getattr(one, name) for one in found]) for name in ("cell", "error", "bright")
    )
    cell, worst, among = _once(cell - (rays.first_cell, 0), error, bright.astype(float), size)
    count = max(_BUDGET * size[0] * size[1], _LEAST_BUDGET) // (_RAYS_OF_STRIP * _STRIPS)
    order = np.lexsort((-worst, -among))[:count]
    if not count:
        return {}, _left(there, found, planes, cell[:0], rays)
    cell, axis = _surveyed(cell[order], worst[order], among[order], followed, count, device)
    left = _left(there, found, planes, cell, rays)
    order = np.lexsort((cell[:, 1], cell[:, 0]))
    start = np.array([rays.first_cell, 0])
    chosen = np.column_stack([cell + start, axis, np.full(len(cell), _STRIPS)])[order].astype(np.int32)
    owner = np.searchsorted([band.end_cell for band in bands], chosen[:, 0], side="right")
    return {int(at): np.ascontiguousarray(chosen[owner == at]) for at in np.unique(owner)}, left


def _left(
    shared: Sequence[SharedFields],
    borders: Sequence[Borders],
    planes: NDArray[np.int64],
    cut: NDArray[np.int64],
    rays: RayGrid,
) -> float:
    """The largest relative error of the power of one of the brightest corners, if these cells of the grid are `cut`."""
    width = (rays.elevation_cells, 1)
    cut_keys = cut @ width
    corners = []
    for fields, one in zip(shared, borders, strict=True):
        own = one.owner >= 0
        key = (one.cell[own] - (rays.first_cell, 0)) @ width
        pair = np.unique(np.column_stack([key, one.owner[own]]), axis=0)  # a tube may have several unlike neighbours
        count, free = (
            np.bincount(pair[:, 1], weights, fields.tubes.size) for weights in (None, ~np.isin(pair[:, 0], cut_keys))
        )
        corners.append(errors_left(fields, planes, free / np.maximum(count, 1)))
    power, error = (np.concatenate(both) for both in zip(*corners, strict=True))
    return float(error[power > BRIGHT * power.max(initial=0.0)].max(initial=0.0))


def _once(
    cell: NDArray[np.int64], worst: NDArray[np.float64], among: NDArray[np.float64], size: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Each cell (n, 2) inside of `size` once, with the largest of its values."""
    inside = ((cell >= 0) & (cell < size)).all(axis=1)
    keys, number = np.unique(cell[inside] @ (size[1], 1), return_inverse=True)
    most = np.zeros((2, keys.size))
    for one, values in zip(most, (worst, among), strict=True):
        np.maximum.at(one, number, values[inside])
    return np.stack(np.divmod(keys, size[1]), axis=1), most[0], most[1]


def _surveyed(
    cell: NDArray[np.int64],
    worst: NDArray[np.float64],
    among: NDArray[np.float64],
    followed: Any,
    count: int,
    device: wp.Device,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cells at borders, with those over whose sides these go on, `count` at most; and the axis of each one's strips."""
    rays = followed.grid
    size = rays.end_cell - rays.first_cell, rays.elevation_cells
    start = np.array([rays.first_cell, 0])
    none = _records(0, device)
    known = np.zeros(0, np.int64)
    cells, axes = [], []
    while len(cell) > 0:
        known = np.union1d(known, cell @ (size[1], 1))
        at: wp.array = wp.array((cell + start).astype(np.int32), dtype=wp.vec2i, device=device)
        axis: wp.array = wp.empty(len(cell), dtype=int, device=device)
        opens: wp.array = wp.empty(len(cell), dtype=wp.vec4i, device=device)
        wp.launch(kernels.survey_kernel, len(cell), inputs=[followed, at], outputs=[none, axis, opens], device=device)
        cells.append(cell)
        axes.append(axis.numpy().astype(np.int64))
        owner, side = np.nonzero(opens.numpy())
        beside = cell[owner] + np.array([(-1, 0), (1, 0), (0, -1), (0, 1)])[side]
        cell, worst, among = _once(beside, worst[owner], among[owner], size)
        new = ~np.isin(cell @ (size[1], 1), known)
        order = np.lexsort((-worst[new], -among[new]))[: max(count - known.size, 0)]
        cell, worst, among = cell[new][order], worst[new][order], among[new][order]
    return np.concatenate(cells), np.concatenate(axes)


def _band_width(rays: RayGrid, max_bounces: int, device: wp.Device) -> int:
    """Azimuth cells that are traced in one launch: as many as the memory for their records allows."""
    cells = rays.end_cell - rays.first_cell
    workers = threads.thread_count() if device.is_cpu else 1
    room = int(DEFAULT_MEMORY_GIB * 2**30 / workers / (_RECORD_BYTES * rays.elevation_cells * (max_bounces - 1)))
    if device.is_cpu:
        # bands for the threads to share, and so narrow that few rays go again with those that are cut
        least, most = (-(-cells // bands) for bands in (_MOST_BANDS, _FEWEST_BANDS))
        cells = min(max(least, _RAYS_OF_BAND // rays.elevation_cells), most)
    return max(1, min(room, cells))


@dataclass(frozen=True)
class _Merged:
    """Paths of one number of bounces in a band: `PathRecords`, and their fields where there are cells."""

    records: Any
    coupled: Any


@dataclass(frozen=True)
class _Traced:
    """What a band has by number of bounces, 2 first, and `PathRecords.area`."""

    of: list[_Merged | None]
    area: NDArray[np.float32]


def _path_rays(
    render: Recorder, rays: RayGrid, planes: NDArray[np.int64], curved: CurvedFaces, max_bounces: int
) -> Any:
    """`kernels.PathRays` of a view. `planes` numbers what borders lie between."""
    target, grid = render.stage.target, render.hits.grid
    return fill(
        kernels.PathRays,
        grid=rays,
        mesh=target.triangles,
        columns=fill(kernels.ImageColumns, start=grid.start_m[1], spacing=grid.spacing_m[1], count=grid.shape[1]),
        tree=target.bvh.id,
        plane=wp.array(planes, dtype=int, device=target.device),
        turn=wp.array(curved.turn, dtype=float, device=target.device),
        bend=wp.array(curved.bend, dtype=float, device=target.device),
        max_bounces=max_bounces,
        size=float(np.linalg.norm(np.ptp(target.corners, axis=0))),
    )


def _band(
    render: Recorder, followed: Any, cells: Any, band: Any, wide: wp.array, cut: NDArray[np.int32] | None = None
) -> _Traced:
    """Paths of a band of azimuth cells, merged, by number of bounces. `wide`: as in `PathRecords`. `cut`: cells of
    `border_kernel`, (n, 4)."""
    device, rays, max_bounces = render.stage.target.device, followed.grid, followed.max_bounces
    segment = rays.elevation_cells if device.is_cpu else _SEGMENT
    dim = (band.end_cell - band.first_cell, -(-rays.elevation_cells // segment))
    out = np.zeros((0, 0) if cut is None else (dim[0], rays.elevation_cells), np.uint8)
    sent = dim[0] * rays.elevation_cells
    if cut is not None:
        out[cut[:, 0] - band.first_cell, cut[:, 1]] = 1
        sent += 3 * int(cut[:, 3].sum())
    left_out: wp.array = wp.array(out, dtype=wp.uint8, device=device)
    # a ray may return from each of its bounces but the first; on the CPU, room that nothing is written to is free
    capacity = (max_bounces - 1) * sent if device.is_cpu else max(4096, sent // 4)
    while True:
        records = _records(capacity, device, wide)
        wp.launch(
            kernels.path_kernel, dim, inputs=[followed, band, left_out, segment], outputs=[records], device=device
        )
        if cut is not None:
            at: wp.array = wp.array(cut, dtype=wp.vec4i, device=device)
            strips = int(cut[:, 3].max())
            wp.launch(
                kernels.border_kernel, (len(cut), strips), inputs=[followed, at], outputs=[records], device=device
            )
        count = int(records.count.numpy()[0])
        if count <= capacity:
            couples = partial(_coupled, render, followed, cells, cut is None, None)
            of: list[_Merged | None] = [None] * (max_bounces - 1)
            if count:
                of = _merge(records, count, max_bounces, couples)
            return _Traced(of, records.area.numpy().copy())
        capacity = count


def _spread(
    render: Recorder, followed: Any, cells: Any, smooth: Any, wide: NDArray[np.uint8]
) -> tuple[list[_Traced], bool]:
    """What returns over several curved surfaces, or over one in the middle, by tubes that are halved until they are
    narrow enough; and whether there were enough of them. `wide`: ray cells, (azimuth, elevation), to begin with; those
    beside them are looked at, too."""
    device, target = render.stage.target.device, render.stage.target
    devices.load_kernels(device, "effects.multibounce_spread")
    sent = fill(
        multibounce_spread.SpreadRays,
        rays=followed,
        vertices=target.places,
        normals=smooth.normals,
        cells=cells,
        wavenumber=render.hits.geometry.wavenumber,
    )
    about = np.pad(wide > 0, 1)
    for axis in (0, 1):
        about = about | np.roll(about, 1, axis) | np.roll(about, -1, axis)
    cell = np.argwhere(about[1:-1, 1:-1])
    place = cell + np.array([followed.grid.first_cell + 0.5, 0.5])
    parts = np.ones(cell.shape, np.int32)
    left = max(_BUDGET * wide.size, _LEAST_BUDGET)
    found: list[_Traced] = []

    while len(place):
        left -= len(place)
        if left < 0:
            return found, False
        count = max(1, min(_SPREAD_TASKS, len(place) // _LEAST_TASK))
        some = zip(np.array_split(place, count), np.array_split(parts, count), strict=True)
        tasks = [partial(_sent_on, render, sent, cells, *one) for one in some]
        made = list(threads.ordered(tasks, device))
        found += [traced for traced, _ in made if traced is not None]
        place, parts = _halved(place, parts, np.concatenate([split for _, split in made]))
    return found, True


def _sent_on(
    render: Recorder, sent: Any, cells: Any, place: NDArray[np.float64], parts: NDArray[np.int32]
) -> tuple[_Traced | None, NDArray[np.int32]]:
    """Returns of tubes, merged, None if there are none; and the sides along which the others are to be halved."""
    device, max_bounces, n = render.stage.target.device, sent.rays.max_bounces, len(place)
    inputs = [sent, wp.array(place, dtype=wp.vec2d, device=device), wp.array(parts, dtype=wp.vec2i, device=device)]
    split: wp.array = wp.empty(n, dtype=int, device=device)
    capacity = max(4096, n // 4)
    while True:
        records = _records(capacity, device)
        tubes = allocate(multibounce_cells.TubeFields, capacity, device)
        wp.launch(multibounce_spread.spread_kernel, n, inputs=inputs, outputs=[split, records, tubes], device=device)
        count = int(records.count.numpy()[0])
        if count <= capacity:
            break
        capacity = count
    if count == 0:
        return None, split.numpy()
    couples = partial(_coupled, render, sent.rays, cells, False, tubes)
    return _Traced(_merge(records, count, max_bounces, couples), np.zeros(2, np.float32)), split.numpy()


def _halved(
    place: NDArray[np.float64], parts: NDArray[np.int32], split: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """The halves of tubes along the sides that each one's `split` says: their places [cells] and parts of a cell."""
    place, parts, split = place[split > 0], parts[split > 0], split[split > 0]
    for axis, side in ((0, multibounce_spread.U_SIDE), (1, multibounce_spread.V_SIDE)):
        mine = (split & int(side)) > 0
        more, finer = place[mine], parts[mine]
        finer[:, axis] *= 2
        away = np.zeros_like(more)
        away[:, axis] = 0.5 / finer[:, axis]
        place = np.concatenate([place[~mine], more - away, more + away])
        parts = np.concatenate([parts[~mine], finer, finer])
        split = np.concatenate([split[~mine], split[mine], split[mine]])
    return place, parts


def _records(capacity: int, device: wp.Device, wide: wp.array | None = None) -> kernels.PathRecords:
    """Room for `capacity` records: a `kernels.PathRecords`."""
    count: wp.array = wp.zeros(1, dtype=int, device=device)
    area: wp.array = wp.zeros(2, dtype=float, device=device)
    none: wp.array = wp.empty((0, 0), dtype=wp.uint8, device=device)
    records: kernels.PathRecords = allocate(
        kernels.PathRecords, capacity, device, count=count, area=area, wide=none if wide is None else wide
    )
    return records


def _coupled(
    render: Recorder,
    followed: Any,
    cells: Any,
    loosely: bool,
    tubes: Any,
    records: Any,
    order: wp.array,
    first: wp.array,
    merged: Any,
) -> Coupled | None:
    """Fields of merged paths by sample, and the rays that they are of; None without cells. `tubes`: the fields of the
    records, if they are known."""
    if cells is None:
        return None
    rays, wavenumber = followed.grid, render.hits.geometry.wavenumber
    if tubes is None:
        tubes = tubes_of(rays, followed.mesh, records, len(order), cells, wavenumber, followed.turn)
    fields = couple(tubes, order, first, merged, cells, loosely)
    middle = records.ray.numpy()[order.numpy()][:, :2].astype(float)
    start, step = (rays.azimuth_start, rays.elevation_start), (rays.azimuth_step, rays.elevation_step)
    cell = np.floor((middle - start) / step).astype(np.int64)
    own = {name: getattr(merged, name).numpy() for name in _ARRAYS}
    return Coupled(own, **fields, cell=cell, first=first.numpy().astype(np.int64))


def _merge(records: kernels.PathRecords, count: int, max_bounces: int, couples: Any) -> list[_Merged | None]:
    """Records of one bin and the same faces become one path; by number of bounces, 2 first, or None."""
    device = records.bin.device
    order = wp.empty(2 * count, dtype=int, device=device)
    key = wp.empty(2 * count, dtype=wp.int64, device=device)
    wp.launch(merging.number_kernel, count, outputs=[order], device=device)
    for what in range((max_bounces + 1) // 2, -1, -1):
        wp.launch(kernels.sort_key_kernel, count, inputs=[records, order, what], outputs=[key], device=device)
        wp.utils.radix_sort_pairs(key, order, count, 0, 64)
    start, rank = (wp.empty(count, dtype=int, device=device) for _ in range(2))
    wp.launch(
        kernels.mark_path_starts_kernel,
        count,
        inputs=[records, order],
        outputs=[start],
        device=device,
    )
    wp.utils.array_scan(start, rank, inclusive=True)
    paths = int(rank[count - 1 :].numpy()[0])
    first = wp.empty(paths, dtype=int, device=device)
    wp.launch(merging.place_starts_kernel, count, inputs=[start, rank], outputs=[first], device=device)
    merged = _records(paths, device)
    wp.launch(
        kernels.reduce_paths_kernel, paths, inputs=[records, order, first, count], outputs=[merged], device=device
    )
    # the sort has put them in the order of their bounces
    ends = np.searchsorted(merged.bounces.numpy(), np.arange(2, max_bounces + 2))

    coupled = couples(records, order[:count], first, merged)

    def between(a: int, b: int) -> _Merged | None:
        if b == a:
            return None
        own = {name: getattr(merged, name)[a:b] for name in _ARRAYS}
        return _Merged(fill(kernels.PathRecords, **own), coupled and coupled.between(a, b))

    return [between(a, b) for a, b in pairwise(ends.tolist())]


def _paths(paths: kernels.PathRecords, bounces: int, rays: RayGrid, target: Target, smooth: Any = None) -> BouncePaths:
    """Merged paths of one number of bounces, with the angles at their faces; `smooth`: a `kernels.SmoothFaces` where
    tubes were spread."""
    device, mesh, n = target.device, target.triangles, paths.bin.shape[0]
    if smooth is None:
        smooth = fill(kernels.SmoothFaces, turn=wp.empty(0, dtype=float, device=device))
    angles = allocate(kernels.PathAngles, n, device)
    inputs = [rays, mesh, smooth, paths, bounces]
    wp.launch(kernels.path_geometry_kernel, n, inputs=inputs, outputs=[angles], device=device)
    each = []
    for k in range(bounces):
        one = allocate(kernels.Bounce, n, device)
        wp.launch(
            kernels.bounce_kernel, n, inputs=[mesh, smooth, paths, angles, bounces, k], outputs=[one], device=device
        )
        each.append(one)
    ends = angles.cos_half, angles.cos_tilt, angles.arrival, angles.home
    return BouncePaths(each, paths.bin, angles.weight, paths.point, *ends)
