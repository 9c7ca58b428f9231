"""Fields of paths, summed over resolution cells (`warpsar.kernels.effects.multibounce_cells`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from warpsar.kernels.effects import multibounce_cells as kernels
from warpsar.kernels.geometry import RayGrid, Triangles
from warpsar.runtime.structs import allocate, fill
from warpsar.trace.hits import BinGrid
from warpsar.world.taper import taper

_FADES = 5.0, 11.5
"""Cells between which the response fades along an axis. Samples beyond have no share (`kernels.NEAR`)."""
_WEAK = 1e-6
"""Share of a group's strongest sample, in power, below which others get nothing. Fields of the groups of a long face
cancel: what is left out of one is left over of the next, and adds up."""
_WEAKEST = 1e-8
"""The same, of the view's strongest."""
_LEAST_FALL = 0.02
"""Share of a sample's power below which a bin gets less, and nothing below half of it."""
_ONE_PHASE = 3.0
"""A long even field has a third of the power that it would have if the response had no negative lobes, about."""
_ABOUT = 0.25
"""Of a cell: power that falls about one place is spread over so much."""

BRIGHT = 1e-3
"""Power of a sample, over that of the brightest, from which on its accuracy counts."""
_ERROR_OF_ONE = 1.26
"""Relative error of the power of a sample to which one tube sends."""
_BIAS = 0.45
"""Share of a power that comes from borders, which uncut tubes at them lack at most (docs/checks.md)."""
_EDGE = 0.03
"""Share of a band over which its ends fall to 0."""


@dataclass(frozen=True)
class Coupled:
    """Groups of tubes of a band: `records` by name (`PathRecords`), and their fields [m] by sample, complex (n, m).

    `moment` [m cells], complex (2, n, m): first moments of the fields about the sample, in range and azimuth. `even`
    [m], (n, m): what the fields would be if all had one phase. `loose` [m2] (n, m): sums of squares of their tubes'
    fields, as if these had no phase in common. `cell`: azimuth and elevation cell of each tube, (tubes, 2), those of a
    group together; `first`: where each begins.
    """

    records: Mapping[str, NDArray[Any]]
    field: NDArray[np.complex64]
    moment: NDArray[np.complex64]
    even: NDArray[np.float32]
    loose: NDArray[np.float32]
    cell: NDArray[np.int64]
    first: NDArray[np.int64]

    @property
    def tubes(self) -> NDArray[np.int64]:
        """How many each group has."""
        return np.diff(np.append(self.first, len(self.cell)))

    def between(self, a: int, b: int) -> Coupled:
        """The groups from number `a` to the one before `b`."""
        low, high = np.append(self.first, len(self.cell))[[a, b]]
        own = {name: array[a:b] for name, array in self.records.items()}
        parts = self.field[a:b], self.moment[:, a:b], self.even[a:b], self.loose[a:b]
        return Coupled(own, *parts, self.cell[low:high], self.first[a:b] - low)


@dataclass(frozen=True)
class SharedFields:
    """Groups of all bands, those of one bin and the same faces as one: how many bands there were does not matter.

    `records` as in `Coupled`; `tubes`, how many each has. `cell`, of each tube of the bands, and `owner`, its group.
    Some samples get a share of a group's field: `group`, `place`, the sample as a number, `field` [m], `even` [m] and
    `loose` [m2] (as in `Coupled`), (shares,). `at`, (2, shares): where the sample lies (range, azimuth), in bins from
    the first one's outer corner, and `moment` [m bins] about it. `cell_bins`: bins of a cell (range, azimuth).
    """

    records: dict[str, NDArray[Any]]
    tubes: NDArray[np.int64]
    cell: NDArray[np.int64]
    owner: NDArray[np.int64]
    group: NDArray[np.int64]
    place: NDArray[np.int64]
    at: NDArray[np.float64]
    field: NDArray[np.complex64]
    moment: NDArray[np.complex64]
    even: NDArray[np.float32]
    loose: NDArray[np.float32]
    cell_bins: tuple[float, float]


@dataclass
class CellSamples:
    """The fields of paths in the samples of the cells. Paths of one sample lie together.

    `coupling` [m], vec2 (n,): the field of each path for an answer of 1. `sample`: which one it belongs to; `first`:
    where each sample begins, and the end. Each sample's power falls into bins of the hits' grid: `bin` and `weight`
    [1/m2] with `path`, each path of a sample having all the sample's bins.
    """

    coupling: wp.array
    sample: wp.array
    first: wp.array
    path: wp.array
    bin: wp.array
    weight: wp.array


def offsets() -> NDArray[np.int32]:
    """The samples about one that get a share of a field between it and the next ones, or half a cell beyond, as bins
    may lie anywhere among the samples, (m, 2)."""
    first = 1 - int(kernels.NEAR)
    nearest = np.maximum(np.abs(np.arange(first, int(kernels.NEAR) + 1) - 0.5) - 1.0, 0.0)
    return np.argwhere(np.multiply.outer(nearest, nearest) < float(kernels.FADED)).astype(np.int32) + first


@cache
def response_of(name: str) -> NDArray[np.float64]:
    """The response of a band with a taper, and its derivative, (2, n), at STEPS places in a cell, REACH cells each way.

    The squares at places one cell apart add up to 1, wherever they lie: the taper's own correlation is 0 at a shift by
    the whole band. A few samples cannot hold a band with sharp ends: what lies at an end would have a quarter of its
    power, and not half of it. So the ends are a quarter of a cosine (root of Nyquist's), a few percent of it wide.
    """
    steps, reach = int(kernels.STEPS), int(kernels.REACH)
    at = np.arange(-reach * steps, reach * steps + 1) / steps
    part = ((np.arange(1024) + 0.5) / 1024 - 0.5) * (1.0 + _EDGE)
    beyond = np.clip((np.abs(part) - 0.5 * (1.0 - _EDGE)) / _EDGE, 0.0, 1.0)
    weight = taper(name, np.clip(part, -0.5, 0.5)) * np.cos(0.5 * np.pi * beyond)
    phase = 2.0 * np.pi * at[:, None] * part
    scale = np.sqrt(1024 * (weight**2).sum() / (1.0 + _EDGE))
    return np.stack([np.cos(phase) @ weight, -np.sin(phase) @ (2.0 * np.pi * part * weight)]) / scale


def _fading(response: NDArray[np.float64]) -> NDArray[np.float64]:
    """`response_of` that falls to nothing along its axis, over `_FADES`, and its first and second derivative, (3, n).
    In both axes at once `kernels.faded` does it."""
    steps, (whole, none) = int(kernels.STEPS), _FADES
    at = np.arange(response.shape[1]) / steps - int(kernels.REACH)
    part = 0.5 * np.pi * np.clip((np.abs(at) - whole) / (none - whole), 0.0, 1.0)
    left, slope = np.cos(part) ** 2, -0.5 * np.pi / (none - whole) * np.sin(2.0 * part) * np.sign(at)
    slope = response[1] * left + response[0] * slope
    return np.stack([response[0] * left, slope, np.gradient(slope, 1.0 / steps)])


@cache
def _responses(tapers: tuple[str, str]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`response` and `even` of `kernels.ResolutionCells`, with these tapers in range and azimuth."""
    response = np.stack([_fading(response_of(name)).T for name in tapers])
    steps, reach = int(kernels.STEPS), int(kernels.REACH)
    at = np.arange(response.shape[1]) / steps - reach
    place = np.arange(int(kernels.EVEN) + 1) / int(kernels.EVEN)
    away = [place[:, None] - offsets()[:, axis] for axis in (0, 1)]
    share = [np.interp(one, at, table, 0.0, 0.0) for one, table in zip(away, response[..., 0], strict=True)]
    whole, faded = float(kernels.WHOLE), float(kernels.FADED)
    part = np.clip((faded - np.abs(away[0][:, None] * away[1])) / (faded - whole), 0.0, 1.0)
    left = part * part * (3.0 - 2.0 * part)  # as `kernels.faded`
    total = ((left * share[0][:, None] * share[1]) ** 2).sum(axis=-1)
    return response, 1.0 / np.sqrt(total)


def cells_of(grid: BinGrid, cell_m: tuple[float, float], tapers: tuple[str, str], device: wp.Device) -> Any:
    """`kernels.ResolutionCells` of a size (range, azimuth) [m] and tapers among the bins of a grid."""
    response, even = _responses(tapers)
    return fill(
        kernels.ResolutionCells,
        size=wp.vec2d(*cell_m),
        bin_start=wp.vec2d(*grid.start_m),
        bin_size=wp.vec2d(*grid.spacing_m),
        bin_cols=grid.shape[1],
        offset=wp.array(offsets(), dtype=wp.vec2i, device=device),
        response=wp.array(response, dtype=wp.vec3d, device=device),
        even=wp.array(even, dtype=wp.float64, device=device),
    )


def tubes_of(
    rays: RayGrid, mesh: Triangles, records: Any, count: int, cells: Any, wavenumber: float, turn: wp.array
) -> Any:
    """`kernels.TubeFields` of `count` records; `turn` of each face, as `PathRays` has it."""
    device = records.bin.device
    tubes = allocate(kernels.TubeFields, count, device)
    inputs = [rays, mesh, records, cells, wavenumber, turn]
    wp.launch(kernels.tube_kernel, count, inputs=inputs, outputs=[tubes], device=device)
    return tubes


def couple(
    tubes: Any, order: wp.array, first: wp.array, merged: Any, cells: Any, loosely: bool
) -> dict[str, NDArray[Any]]:
    """`field`, `moment`, `even` and `loose` of `Coupled`, by group and sample: groups are those of `order` from each
    `first` on. `loose` is 0 if it is not asked for.
    """
    device = order.device
    shape = first.shape[0], cells.offset.shape[0]
    fields: list[wp.array] = [wp.zeros(shape, dtype=wp.vec2d, device=device) for _ in range(3)]
    even: wp.array = wp.zeros(shape, dtype=wp.float64, device=device)
    loose: wp.array = wp.zeros(shape if loosely else (0, 0), dtype=wp.float64, device=device)
    inputs = [tubes, order, first, merged.bin, cells]
    wp.launch(kernels.couple_kernel, shape[0], inputs=inputs, outputs=[*fields, even, loose], device=device)
    field, *moment = (one.numpy().astype(np.float32).view(np.complex64)[..., 0] for one in fields)
    return {
        "field": field,
        "moment": np.stack(moment),
        "even": even.numpy().astype(np.float32),
        "loose": loose.numpy().astype(np.float32) if loosely else np.zeros(shape, np.float32),
    }


def kinds_of(normal: NDArray[np.float64], other: NDArray[Any]) -> NDArray[np.int64]:
    """Numbers of faces, from 1 on, that are alike for faces of one direction, to a thousandth, and one `other`."""
    key = np.column_stack([np.round(normal, 3), other])
    return np.unique(key, axis=0, return_inverse=True)[1].reshape(-1) + 1


def bodies_of(corners: NDArray[np.int64], planes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of faces, from 1 on, that are alike for faces of one plane, by number, that touch.

    `corners`: numbers of the places of each face's corners, (n, 3).
    """
    n = len(corners)
    _, node = np.unique(np.column_stack([np.repeat(planes, 3), corners.reshape(-1)]), axis=0, return_inverse=True)
    node = node.reshape(-1)
    links = coo_array((np.ones(3 * n, bool), (np.repeat(np.arange(n), 3), n + node)), shape=(n + 3 * n,) * 2)
    label = connected_components(links, directed=False)[1][:n]
    return np.asarray(np.unique(label, return_inverse=True)[1].reshape(-1) + 1, np.int64)


def samples_of(
    fields: SharedFields,
    kinds: NDArray[np.int64],
    bodies: NDArray[np.int64],
    mirrors: NDArray[np.float64],
    columns: int,
    pixel_area_m2: float,
    device: wp.Device,
) -> tuple[dict[str, NDArray[Any]], CellSamples]:
    """Paths by sample and kinds of their faces (`kinds_of`), as arrays of `PathRecords`, and their samples.

    Faces of one kind answer alike, so the fields of their tubes are added up. The surface is that where the strongest
    of them lies. `bodies`: numbers of the connected planes of faces, from 1 on. `mirrors`: about how much of a field
    each face sends on, by number. `columns` of the bins.

    A sample's power falls where the tubes lie from which it comes, not into the sample's own place: an isolated body
    keeps its pixel, and its power does not depend on where it lies between the samples. Two corners in one sample share
    its power as their `mirrors` say: one of metal and one of soil do not have half of it each. None of it falls between
    two bodies.
    """
    records, group, place, field = fields.records, fields.group, fields.place, fields.field
    mirrored = np.append(1.0, mirrors)[records["faces"]].prod(axis=1)[group]
    sent = field * mirrored
    power = np.abs(sent) ** 2
    bins = records["bin"][group]
    keys, path, ways = _by_sample(place, kinds, records["faces"], group)
    n = keys.size
    total = np.bincount(path, power, n)

    _, head, sample = np.unique(keys // ways, return_index=True, return_inverse=True)
    first = np.append(head, n)
    of_sample = np.bincount(sample, total)
    place_m = [np.bincount(sample[path], power * column) / of_sample for column in records["point"][group].T]
    strongest = np.zeros(n, np.int64)
    rising = np.argsort(power, kind="stable")
    strongest[path[rising]] = group[rising]  # the last one stays
    made = {
        "bin": np.zeros(n, np.int32),
        **{name: records[name][strongest] for name in ("bounces", "faces", "second", "third")},
        "weight": np.ones(n, np.float32),
        "point": np.stack(place_m, axis=1)[sample].astype(np.float32),
        "ray": np.zeros((n, 4), np.float32),
        "ends": np.zeros((n, 3), np.float32),
    }
    met = _by_sample(place, bodies, records["faces"], group)[1]
    owner, bin_, share = _falls(fields, sample[path], met, bins, columns, mirrored)
    count = np.diff(first)[owner]
    entry = np.repeat(first[owner] - np.append(0, np.cumsum(count)[:-1]), count) + np.arange(count.sum())
    bin_, share = np.repeat(bin_, count), np.repeat(share, count) * 4.0 * np.pi / pixel_area_m2
    order = np.argsort(bin_, kind="stable")
    coupling = np.stack([np.bincount(path, part, n) for part in (field.real, field.imag)], axis=1)

    def upload(values: NDArray[Any], dtype: Any, kind: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(values, dtype), dtype=kind, device=device)

    return made, CellSamples(
        upload(coupling, np.float32, wp.vec2),
        upload(sample, np.int32, int),
        upload(first, np.int32, int),
        upload(entry[order], np.int32, int),
        upload(bin_[order], np.int32, int),
        upload(share[order], np.float32, float),
    )


def _by_sample(
    place: NDArray[np.int64], numbers: NDArray[np.int64], faces: NDArray[np.int32], group: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Shares of fields by sample and by the `numbers` of the faces that their groups meet: keys in order, each share's,
    and what a key is to be divided by for its sample."""
    _, met = np.unique(np.append(0, numbers)[faces], axis=0, return_inverse=True)
    ways = int(met.max(initial=0)) + 1
    keys, which = np.unique(place * ways + met.reshape(-1)[group], return_inverse=True)
    return keys, which, ways


def share(parts: Sequence[Coupled], grid: BinGrid, cell_m: tuple[float, float]) -> SharedFields:
    """Join the groups of bands, and give their fields to samples."""
    records = {name: np.concatenate([part.records[name] for part in parts]) for name in parts[0].records}
    tubes = np.concatenate([part.tubes for part in parts])
    keys = np.column_stack([records["bin"], records["faces"]])
    _, first, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    number = number.reshape(-1)
    order = np.argsort(number, kind="stable")
    starts = np.searchsorted(number[order], np.arange(first.size))

    def added(values: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(np.add.reduceat(values[order], starts)) if first.size else values[order]

    total = added(tubes)
    point = added(records["point"] * tubes[:, None]) / total[:, None]
    one = {name: array[first] for name, array in records.items()} | {"point": point.astype(np.float32)}
    field, even, loose = (
        added(np.concatenate([getattr(part, name) for part in parts])) for name in ("field", "even", "loose")
    )
    moment = np.stack([added(np.concatenate([part.moment[axis] for part in parts])) for axis in (0, 1)])
    group, which, node = _shares(one["bin"], field, grid, cell_m)
    bins = cell_m[0] / grid.spacing_m[0], cell_m[1] / grid.spacing_m[1]
    at = [node[:, k] * bins[k] - grid.start_m[k] / grid.spacing_m[k] for k in (0, 1)]
    node = node - (node.min(axis=0) if len(node) else 0)
    return SharedFields(
        records=one,
        tubes=total,
        cell=np.concatenate([part.cell for part in parts]),
        owner=np.repeat(number, tubes),
        group=group,
        place=node[:, 0] * (int(node[:, 1].max(initial=0)) + 1) + node[:, 1],
        at=np.stack(at),
        field=field[group, which],
        moment=(moment[:, group, which] * np.array(bins)[:, None]).astype(np.complex64),
        even=even[group, which],
        loose=loose[group, which],
        cell_bins=bins,
    )


def _shares(
    bins: NDArray[np.int32], field: NDArray[np.complex64], grid: BinGrid, cell_m: tuple[float, float]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Groups of tubes, offsets of the samples with a share of them, and these samples (range, azimuth) [cells], (n, 2);
    weak ones are left out."""
    power = field.real**2 + field.imag**2
    strongest = power.max(axis=1, keepdims=True)
    group, which = np.nonzero((power > _WEAK * strongest) & (power > _WEAKEST * power.max(initial=0.0)))
    places = [
        np.floor((start + (at + 0.5) * step) / size).astype(np.int64)
        for at, start, step, size in zip(
            np.divmod(bins, grid.shape[1]), grid.start_m, grid.spacing_m, cell_m, strict=True
        )
    ]
    return group, which, np.stack(places, axis=1)[group] + offsets()[which]


@dataclass(frozen=True)
class Borders:
    """Ray cells at the borders of bodies: `cell` (azimuth, elevation), (n, 2); `error`, `bright` and `owner`, (n,).

    `error` is that of the power of the brightest samples that the cell's tube sends to, relative, if it is not cut.
    `bright`: whether these are among the view's brightest, and do not only stand out of the ground. `owner`: the group
    of the tube; -1 for the cells beside it.
    """

    cell: NDArray[np.int64]
    error: NDArray[np.float64]
    bright: NDArray[np.bool_]
    owner: NDArray[np.int64]


def borders_of(fields: SharedFields, planes: NDArray[np.int64]) -> Borders:
    """Cells of tubes where neighbours meet other surfaces; these neighbours too.

    A tube inside of a body is exact, however wide: its phase is linear. One at a border is in or out by chance.
    `planes` numbers the planes of faces, from 1 on.
    """
    errors, brightest = errors_of(fields)
    error, bright = errors[fields.owner], brightest[fields.owner]
    cell, wanted = fields.cell, error > 0.0  # other groups send nothing
    if not wanted.any():
        return Borders(np.zeros((0, 2), np.int64), np.zeros(0), np.zeros(0, bool), np.zeros(0, np.int64))
    _, met = np.unique(np.append(0, planes)[fields.records["faces"]], axis=0, return_inverse=True)
    of = met.reshape(-1)[fields.owner] + 1
    start = cell.min(axis=0) - 1
    surfaces = np.zeros(np.ptp(cell, axis=0) + 3, np.int64)
    surfaces[tuple((cell - start).T)] = of
    cell, of, error, bright, owner = cell[wanted], of[wanted], error[wanted], bright[wanted], fields.owner[wanted]
    nobody = np.full_like(owner, -1)
    found = []
    for step in product((-1, 0, 1), repeat=2):
        beside = cell + step
        other = surfaces[tuple((beside - start).T)] != of
        found += [
            (at[other], error[other], bright[other], whose[other]) for at, whose in ((beside, nobody), (cell, owner))
        ]
    return Borders(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def errors_of(fields: SharedFields) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Relative error of the power of the samples to which each group of tubes sends, (n,), by their number. And whether
    such a sample is among the view's brightest.

    Of n tubes, those at the border of a body are in or out by chance: 4 sqrt(n) of them, each with a variance of about
    0.1 of its square. The sum of their fields may be much smaller than they are, as off the flash of a long face.
    """
    group, field, loose = fields.group, fields.field, fields.loose.astype(float)
    _, sample = np.unique(fields.place, return_inverse=True)
    size = np.abs(field).astype(float)
    power = np.bincount(sample, field.real) ** 2 + np.bincount(sample, field.imag) ** 2
    squares = np.bincount(sample, loose)
    least = np.finfo(float).tiny
    tubes = np.bincount(sample, np.sqrt(loose * fields.tubes[group])) ** 2 / np.maximum(squares, least)
    bright = power > BRIGHT * power.max(initial=0.0)
    error = _ERROR_OF_ONE * np.sqrt(squares / np.maximum(power, least)) * np.maximum(tubes, 1.0) ** -0.25
    strongest, worst, among = (np.zeros(fields.tubes.size) for _ in range(3))
    np.maximum.at(strongest, group, size)
    mine = size**2 >= 0.1 * strongest[group] ** 2
    np.maximum.at(worst, group[mine], error[sample[mine]])
    np.maximum.at(among, group[mine], bright[sample[mine]])
    return worst, among > 0.0


def errors_left(
    fields: SharedFields, planes: NDArray[np.int64], uncut: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Power of each corner, which is all that goes over the same planes, and its relative error; (corners,) each.

    `uncut`: share of the tubes at borders, of each group, that are not cut. By chance these are in or out, as in
    `errors_of`; samples err by themselves, so the power of a corner is better known than theirs. And where the fields
    of a sample cancel, its power comes from the borders: tubes that end at random lack `_BIAS` of it, at most.
    """
    _, met = np.unique(np.append(0, planes)[fields.records["faces"]], axis=0, return_inverse=True)
    met, group = met.reshape(-1), fields.group
    _, sample = np.unique(fields.place, return_inverse=True)
    corners = int(met.max(initial=-1)) + 1
    keys, at = np.unique(sample * max(corners, 1) + met[group], return_inverse=True)
    power = np.abs(_sums(at, fields.field, keys.size)) ** 2
    loose, least = fields.loose.astype(float), np.finfo(float).tiny
    squares, free = (np.bincount(at, loose * share, keys.size) for share in (1.0, uncut[group]))
    tubes = np.bincount(at, np.sqrt(loose * fields.tubes[group]), keys.size) ** 2 / np.maximum(squares, least)
    by_chance = _ERROR_OF_ONE**2 * free * power * np.maximum(tubes, 1.0) ** -0.5
    even = np.bincount(at, fields.even.astype(float), keys.size)
    cancelled = 1.0 - np.minimum(_ONE_PHASE * power / np.maximum(even**2, least), 1.0)
    of = keys % max(corners, 1)
    total: NDArray[np.float64] = np.bincount(of, power, corners).astype(np.float64)
    lacks = _BIAS * np.bincount(of, power * cancelled * free / np.maximum(squares, least), corners)
    error: NDArray[np.float64] = np.hypot(np.sqrt(np.bincount(of, by_chance, corners)), lacks) / np.maximum(
        total, least
    )
    return total, error


def _falls(
    fields: SharedFields,
    sample: NDArray[Any],
    path: NDArray[Any],
    bins: NDArray[Any],
    columns: int,
    mirrored: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Into which bins the power of each sample falls: samples in order, bins, and shares whose sum is 1 by sample.

    `sample` and `path` of each share of a field, both from 0 on, paths being those over other bodies; `columns` of the
    bins; `mirrored`: how much of a field its faces send on. The paths of a sample share its power by that of their own
    fields, all their groups together: how the tubes were grouped, by bands of rays, by the triangles of a face and by
    the size of the bins, does not matter.
    Where the fields of a path have one phase, its bins share by the power of a tube that is as large in all of them.
    Where they cancel, little is left, and it comes from the ends: its mean place is that which the sum of the fields
    has, Re(SUM x f F*) / |F|^2, whose mean over samples is that of the image of |field|^2 by Parseval. A part of the
    power then falls about one place, so that the mean is so.
    """
    sent, even = fields.field * mirrored, fields.even.astype(float)
    across = int(bins.max(initial=0)) + columns + 2
    of_path = np.zeros(int(path.max(initial=-1)) + 1, np.int64)
    of_path[path] = sample
    keys, inverse = np.unique(path * across + bins, return_inverse=True)
    owner, bin_ = np.divmod(keys, across)  # of a path
    head = np.searchsorted(owner, np.arange(of_path.size))
    part = _sums(inverse, sent, keys.size)
    whole = np.add.reduceat(part, head)
    in_phase = np.bincount(path, even * mirrored, of_path.size)
    power = np.maximum(np.abs(whole) ** 2, np.maximum(1e-12 * in_phase**2, np.finfo(float).tiny))
    one_phase = np.minimum(_ONE_PHASE * power / np.maximum(in_phase**2, np.finfo(float).tiny), 1.0)
    share = np.abs(part) ** 2 / np.maximum(np.bincount(inverse, even, keys.size), np.finfo(float).tiny)
    share = share / np.maximum(np.add.reduceat(share, head), np.finfo(float).tiny)[owner]
    rest = 1.0 - one_phase
    lines = [(of_path[owner] * across + bin_, share * (one_phase * power)[owner])]
    ends = [(np.arange(of_path.size), np.zeros(of_path.size, np.int64), rest * power)]
    for k, (cells, stride) in enumerate(zip(np.divmod(bin_, columns), (columns, 1), strict=True)):
        moment = _sums(path, fields.moment[k] * mirrored, of_path.size)
        at = np.zeros(of_path.size)
        at[path] = fields.at[k]  # one for all that is in a sample
        wanted = at + np.real(moment * whole.conj()) / power
        wanted = wanted - one_phase * np.add.reduceat(share * (cells + 0.5), head)
        low, high = np.minimum.reduceat(cells, head), np.maximum.reduceat(cells, head) + 1.0
        middle = np.clip(wanted / np.where(rest > 0.0, rest, 1.0), low, high)
        half = np.minimum(0.5 * _ABOUT * fields.cell_bins[k], np.minimum(middle - low, high - middle))
        spread = _spread(middle, half, low, high - 1.0)
        ends = [
            (each, key + stride * bin_of[each], of_it * part_of[each])
            for each, key, of_it in ends
            for bin_of, part_of in spread
        ]
    lines += [(of_path[each] * across + key, of_it) for each, key, of_it in ends]
    keys, falls = (np.concatenate(both) for both in zip(*lines, strict=True))
    keys, inverse = np.unique(keys[falls > 0.0], return_inverse=True)
    share = np.bincount(inverse, falls[falls > 0.0]).astype(float)
    owner, bin_ = np.divmod(keys, across)
    count = int(of_path.max(initial=-1)) + 1
    share = share / np.bincount(owner, share, count)[owner]
    least = np.minimum(np.maximum.reduceat(share, np.searchsorted(owner, np.arange(count))), _LEAST_FALL)
    share = share * np.clip(2.0 * share / least[owner] - 1.0, 0.0, 1.0)  # small ones go, without a step
    owner, bin_, share = owner[share > 0.0], bin_[share > 0.0], share[share > 0.0]
    return owner, bin_, share / np.bincount(owner, share, count)[owner]


def _sums(index: NDArray[Any], values: NDArray[Any], count: int) -> NDArray[np.complex128]:
    """Sums of complex values by their index."""
    return np.bincount(index, values.real, count) + 1j * np.bincount(index, values.imag, count)


def _spread(
    middle: NDArray[np.float64], half: NDArray[np.float64], lowest: NDArray[Any], highest: NDArray[Any]
) -> list[tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Bins from `lowest` to `highest`, and what falls into each of an even spread of 1 by `half` to both sides of a
    `middle`."""
    begin, end = middle - half, middle + half
    first = np.clip(np.floor(begin), lowest, highest)
    found = []
    for step in range(int(np.ceil(2.0 * half.max(initial=0.0))) + 1):
        bin_ = np.minimum(first + step, highest)
        over = np.minimum(end, first + step + 1.0) - np.maximum(begin, first + step)
        part = np.where(half > 0.0, over / np.where(half > 0.0, 2.0 * half, 1.0), 1.0 - min(step, 1))
        found.append((bin_.astype(np.int64), np.maximum(part, 0.0)))
    return found
