"""How long products with phase will take, and how much memory: measured on parts of the work before it begins."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent.patches import SIDE, SIDE_M
from warpsar.collection import direct, history, slc
from warpsar.collection.bodies import Bodies
from warpsar.collection.places import COARSE, GROUP, Places
from warpsar.collection.plan import Plan
from warpsar.collection.scatterers import TOGETHER, ScattererPart, Scatterers, Stream, fading, spacing_m
from warpsar.errors import InputError
from warpsar.io.quick_look import draw_blank
from warpsar.runtime import threads
from warpsar.runtime.forecast import LONG_S, duration, timed
from warpsar.runtime.memory import default_gib
from warpsar.world.tables import OF_RAYS
from warpsar.world.world import World

FEWEST = 2**14
"""Scatterers that are held at a time at least."""
BANDS = 5
"""Places of a view, at least, where three rows of coarse cells are traced for the forecast."""
_CELLS = 2**16
"""Coarse cells of the sample."""
_SAMPLE_S = 1.0
"""How long tubes of the sample are traced."""
_SAMPLE_SIDE = 96
"""Half of the pixels of a side of a tile of the sample, at most."""
_SAMPLE_TILES = 3
"""Tiles of a direct image that are made for the forecast."""
_PATCH_BYTES = 800
"""Of a patch of rough faces: on the host, on the device, and for the tiles that it reaches."""
_HELD_BYTES = 300
"""Of a scatterer that is held: as it is seen, as it is joined to others, and on the device."""
_HIT_BYTES = 300
"""Of a hit of a tube, and what is made of it, in a launch of `GROUP` cells."""
_SAMPLE_BYTES, _PIXEL_BYTES, _FOCUS_BYTES = 24, 40, 56
"""Of a sample of phase history, and of a pixel of a complex image in one polarization, with their copies; and what a
pixel takes beside it while it is backprojected."""
_LEAST_TILE = 2**24
"""Bytes of a tile of a direct image, in one polarization, at least."""


@dataclass(frozen=True)
class CollectionForecast:
    """Of all views together, but `gib`: of the largest."""

    views: int
    scatterers: float
    seconds: float
    gib: float

    def __str__(self) -> str:
        return (
            f"{self.views} view{'s' if self.views > 1 else ''}, {self.scatterers:.2g} scatterers: about "
            f"{duration(self.seconds)} and {self.gib:.2g} GiB"
        )


def placed_on_device(world: World, plan: Plan) -> bool:
    """Whether scatterers of rough faces are placed, seen and deposited into a direct image without leaving the device:
    not where effects change them."""
    return "rough" in world.radar.terms and plan.table.focus == "direct" and not plan.moves_scatterers


def held_gib(world: World, plan: Plan, product: str) -> float:
    """Memory of one view that no smaller parts of the work save [GiB]: patches, a launch of tubes, the product."""
    several = len(world.radar.polarizations)
    total = 0.0
    if "rough" in world.radar.terms:
        total += _PATCH_BYTES * _patches(world, spacing_m(plan))
    if OF_RAYS & set(world.radar.terms):
        total += _HIT_BYTES * world.radar.bounces * GROUP * COARSE**2
    if product == "phase-history" or plan.table.focus == "backprojection":
        total += _SAMPLE_BYTES * several * plan.frequencies * len(plan.track)
    if product == "slc":
        total += _PIXEL_BYTES * several * math.prod(world.grid.shape)
        total += _LEAST_TILE * several if plan.table.focus == "direct" else _FOCUS_BYTES * math.prod(world.grid.shape)
    return float(total / 2**30)


def _patches(world: World, spacing: float) -> float:
    """How many patches rough faces have."""
    corners = world.mesh.vertices[world.mesh.faces]
    rough = np.array([world.materials[name].rms_height_m != 0.0 for name in world.mesh.materials])
    longest = np.linalg.norm(corners[:, [1, 2, 0]] - corners, axis=2).max(axis=1)[rough[world.mesh.face_material]]
    return float((np.ceil(longest / min(SIDE * spacing, SIDE_M)).clip(1.0) ** 2).sum())


@dataclass(frozen=True)
class Room:
    """What may be held at a time: scatterers, and bytes of a direct image's tile."""

    together: int
    tile_bytes: int


def room_of(world: World, plans: Sequence[Plan], product: str, device: wp.Device, max_memory_gib: float | None) -> Room:
    """What memory leaves room for.

    Raises InputError where even the least does not fit into `max_memory_gib`, or into the device's memory without it.
    """
    there = default_gib(device) if max_memory_gib is None else max_memory_gib
    held = max(held_gib(world, plan, product) for plan in plans)
    least = held + FEWEST * _HELD_BYTES / 2**30
    if least > there:
        what = "--max-memory" if max_memory_gib is not None else "the memory that this machine can give"
        raise InputError(
            f"{world.name}: {product}: found {least:.3g} GiB for the surface, tubes, phase history and image, beside "
            f"the scatterers that are held in turn; {what} allows {there:.3g} GiB; ask for fewer pixels, pulses or "
            f"polarizations, fewer scatterers_per_cell of [collection], or a smaller mesh"
        )
    left = (there - held) * 2**30
    together = int(min(TOGETHER, max(0.5 * left / _HELD_BYTES, FEWEST)))
    least_tile = _LEAST_TILE * len(world.radar.polarizations)
    return Room(together, int(max(left - together * _HELD_BYTES, 0.0)) + least_tile)


def forecast(bodies: Bodies, plans: Sequence[Plan], product: str) -> CollectionForecast | None:
    """What the product of all plans will take; None where that is not long.

    The first plan's scatterers are sampled: pieces of its rough places, bands of its coarse cells, and tubes of some of
    the cells that matter, all seen from the middle of the track. They are deposited into some pulses, or into a part of
    the image, and a part of the image is focused. The counts of every plan give the whole.
    """
    world, first = bodies.world, plans[0]
    once = product == "slc" and first.table.focus == "direct"
    started = time.perf_counter()
    body = bodies.of(first)
    built = time.perf_counter() - started
    apart = once and placed_on_device(world, first)
    stream = Stream(world, first, body, once=once, together=FEWEST, rough=not apart)
    rough, tubes = _rough(stream), _tubes(stream)
    parts = [*rough.parts, *tubes.parts]
    seconds = built * (len({spacing_m(plan) for plan in plans}) - 1)
    scatterers = look = 0.0
    deposit = _Deposit.of(bodies, first, parts, once) if parts or not once else _Deposit(0.0, 0.0)
    tiled = _Tiled.of(bodies, first) if once else None
    for plan in plans:
        mine = stream if plan is first else Stream(world, plan, body, once=once, together=FEWEST, rough=not apart)
        again = 1 if tiled is None else tiled.tiles  # tubes are traced for each tile
        for knots, kind in ((mine.rough_knots, rough), (mine.tube_knots, tubes)):
            seen = 1 if once else (fading(plan, knots) > 0.0).sum(axis=1)
            several = kind.scatterers * (1 + len(plan.copies))
            scatterers += several * len(knots)
            look = max(look, several if len(knots) else 0.0)
            seconds += again * (kind.seconds * len(knots) + deposit.each * several * float(np.sum(seen)))
        pulses = 1 if once else len(plan.track)
        batches = math.ceil(max(scatterers, 1.0) / len(plans) / bodies.together)
        if history.holds_bins(plan, len(world.radar.polarizations), bodies.device):
            batches = 1
        seconds += 0.0 if once else deposit.whole * pulses * batches
    held = max(held_gib(world, plan, product) for plan in plans)
    gib = held + min(bodies.together, look) * _HELD_BYTES / 2**30  # looks follow one another
    if tiled is not None:
        seconds += len(plans) * tiled.seconds
        scatterers += len(plans) * tiled.scatterers
        look = max(look, tiled.scatterers)
        gib = held + (tiled.bytes + min(bodies.together, look) * _HELD_BYTES) / 2**30
    if product == "slc":
        seconds += len(plans) * (_picture(world) + (0.0 if once else _focusing(bodies, first)))
    return CollectionForecast(len(plans), scatterers, seconds, gib) if seconds > LONG_S else None


@dataclass(frozen=True)
class _Tiled:
    """A direct image: its tiles, what one takes, and the seconds and scatterers of all with rough faces in them."""

    tiles: int
    bytes: float
    seconds: float
    scatterers: float

    @classmethod
    def of(cls, bodies: Bodies, plan: Plan) -> _Tiled:
        """By small tiles along the image's diagonal: once without scatterers, and once with."""
        world, device, names = bodies.world, bodies.device, tuple(bodies.world.radar.polarizations)
        image = direct.DirectImage(plan, names, world.grid, device)
        tiles = image.tiles(bodies.tile_bytes)
        samples = [math.prod(image.samples(tile)) for tile in tiles]
        size = float(max(samples)) * direct.SAMPLE_BYTES * len(names)
        small = [_middle(world.grid.shape, (i + 0.5) / _SAMPLE_TILES) for i in range(_SAMPLE_TILES)]
        image.made(small[0], lambda *_: [])  # loads the kernels
        empty = timed(lambda: [image.made(tile, lambda *_: []) for tile in small])[0]
        each = empty / sum(math.prod(image.samples(tile)) for tile in small)
        seconds = each * sum(samples)
        if not placed_on_device(world, plan):
            return cls(len(tiles), size, seconds, 0.0)
        seen, patches = direct.rough_of(bodies, plan), bodies.patches(plan)

        def placed(tile: direct.Tile) -> int:
            return len(direct.within(patches, image.frame(tile), *image.reach(tile)))

        if len(patches):
            image.made(_middle(world.grid.shape, 0.5, 1), seen)  # loads the kernels of the materials
        spent = traced = inside = 0.0
        made: list[direct.Tile] = []
        for tile in small:
            time_s, (_, count) = timed(partial(image.made, tile, seen))
            spent, traced, inside = spent + time_s, traced + placed(tile), inside + count
            made.append(tile)
            if spent > _SAMPLE_S * _SAMPLE_TILES:
                break
        each = max(spent - empty * len(made) / len(small), 0.0) / max(traced, 1.0)
        seconds += each * sum(placed(tile) for tile in tiles)
        # Of what is placed for an area some is hidden. The sample says how much of it.
        area = sum(math.prod(image.samples(tile)) for tile in made)
        pixels = sum(_pixels(tile) for tile in made)
        whole = slice(0, world.grid.shape[0]), slice(0, world.grid.shape[1])
        seen_share = inside / pixels / max(traced / area, 1e-9)
        expected = seen_share * placed(whole) / math.prod(image.samples(whole)) * _pixels(whole)
        return cls(len(tiles), size, seconds, expected)


def _pixels(tile: direct.Tile) -> int:
    return math.prod(some.stop - some.start for some in tile)


def _middle(shape: tuple[int, int], share: float, side: int = 0) -> direct.Tile:
    """A small tile at a share of both sides of an image."""
    rows, columns = (
        slice(max(int(share * n) - half, 0), min(int(share * n) + half + 1, n))
        for n, half in ((n, side or max(1, min(n // 8, _SAMPLE_SIDE))) for n in shape)
    )
    return rows, columns


@dataclass(frozen=True)
class _Look:
    """One look at the scene from one place of the track: how long it takes, and the scatterers that it finds."""

    seconds: float
    scatterers: float
    parts: tuple[ScattererPart, ...]


def _rough(stream: Stream) -> _Look:
    """Of rough places, by three stretches of them."""
    total, knot = len(stream.body.patches), stream.plan.middle
    if not len(stream.rough_knots) or not total:
        return _Look(0.0, 0.0, ())
    size = max(1, min(total // 3, 2 * FEWEST * threads.thread_count()))
    list(stream.rough(knot, slice(0, min(total, 16))))  # loads the kernels
    starts = np.linspace(0, total - size, 3).astype(int).tolist()
    spent, found = timed(lambda: [some for a in starts for some in stream.rough(knot, slice(a, a + size))])
    whole = total / (3.0 * size)
    return _Look(spent * whole, whole * sum(len(some.face) for some in found), _alike(stream, found))


def _tubes(stream: Stream) -> _Look:
    """Of tubes, by bands of the coarse cells and by tubes of some of them."""
    if not len(stream.tube_knots) or not OF_RAYS & set(stream.terms):
        return _Look(0.0, 0.0, ())
    both_ways = stream.cells(stream.plan.middle)
    cells = both_ways[0]
    rows, columns = (int(n) for n in cells.count)
    count = min(max(rows // 3, 1), max(BANDS, _CELLS // (3 * columns)))
    starts = np.unique(np.linspace(0, max(rows - 3, 0), count).astype(int))
    ends = np.minimum(starts + 3, rows)
    cells.matter(0, 1)  # loads the kernels
    bands = np.stack([starts, ends], axis=1).tolist()
    coarse, matter = timed(lambda: [cells.matter(a * columns, b * columns) for a, b in bands])
    found_cells = []
    for (a, b), each in zip(bands, matter, strict=True):
        near = cells.chosen(each)
        middle = near[near[:, 0] == (b - a) // 2]  # whose neighbours are both there
        found_cells.append(middle + np.array([a, 0]))
    chosen = np.concatenate(found_cells)
    coarse *= rows * columns / float(sum(map(len, matter)))
    whole = rows / len(bands)
    coarse, whole = coarse * len(both_ways), whole * len(both_ways)
    if not len(chosen):
        return _Look(coarse, 0.0, ())
    size = min(cells.together, max(1, len(chosen) // BANDS))
    blocks = np.random.default_rng(0).permutation(len(chosen) // size) * size
    cells.places(chosen[:size])  # loads the kernels
    found, traced, started = [], 0, time.perf_counter()
    for start in blocks.tolist():
        found.append(cells.places(chosen[start : start + size])[0])
        traced += size
        if time.perf_counter() - started > _SAMPLE_S:
            break
    fine = (time.perf_counter() - started) * len(chosen) / traced
    several = whole * len(chosen) / traced * sum(len(some.face) for some in found)
    return _Look(coarse + fine * whole, several, _alike(stream, found))


def _alike(stream: Stream, found: Sequence[Places]) -> tuple[ScattererPart, ...]:
    """Some of what was found, as parts that every pulse has: `FEWEST` scatterers at most."""
    weight = np.ones(len(stream.plan.track), np.float32)
    parts, left = [], FEWEST
    for some in found:
        part = stream.part(some, weight, stream.plan.middle)
        few = slice(0, left)
        moving = None if part.velocity is None else part.velocity[few]
        parts.append(ScattererPart(part.point[few], np.ascontiguousarray(part.amplitude[:, few]), weight, moving))
        left -= len(parts[-1])
        if left <= 0:
            break
    return tuple(part for part in parts if len(part))


@dataclass(frozen=True)
class _Deposit:
    """Seconds of a scatterer in one pulse, or in the image; and of a pulse's transform, or of the image's."""

    each: float
    whole: float

    @classmethod
    def of(cls, bodies: Bodies, plan: Plan, parts: Sequence[ScattererPart], once: bool) -> _Deposit:
        world, device = bodies.world, bodies.device
        names = tuple(world.radar.polarizations)
        weight = np.ones(len(plan.track), np.float32)
        one = ScattererPart(np.zeros((1, 3)), np.ones((len(names), 1), np.complex64), weight)
        scatterers = sum(map(len, parts))
        run: Callable[[Sequence[ScattererPart]], object]
        if once:
            small = max(1, world.grid.shape[0] // 4), max(1, world.grid.shape[1] // 4)
            grid = world.grid.model_copy(update={"shape": small})
            scale, pulses = math.prod(world.grid.shape) / math.prod(small), 1

            def run(some: Sequence[ScattererPart]) -> object:
                return direct.direct(plan, Scatterers(tuple(some), 0.0), names, grid, device)
        else:
            track = history.track_of(plan, device)
            most = history.PULSES_TOGETHER["cpu" if device.is_cpu else "cuda"]
            pulses = min(len(plan.track), 2 * most * (threads.thread_count() if device.is_cpu else 1))
            scale = 1.0 / pulses
            spectrum = np.zeros((len(names), len(plan.track), plan.frequencies), np.complex64)
            start = (len(plan.track) - pulses) // 2

            def run(some: Sequence[ScattererPart]) -> object:
                history.add_spectra(plan, track, some, spectrum, slice(start, start + pulses))
                return spectrum

            if device.is_cuda:  # where a transform takes longer than the deposit of the sample
                each = _on_device(plan, track, parts, len(names), slice(start, start + pulses))
                run([one])  # loads the kernels
                return cls(each, timed(lambda: run([one]))[0] * scale)

        run([one])  # loads the kernels
        empty = timed(lambda: run([one]))[0]
        full = timed(lambda: run(parts))[0] if parts else empty
        return cls(max(full - empty, 0.0) / (max(scatterers, 1) * pulses), empty * scale)


def _on_device(plan: Plan, track: Any, parts: Sequence[ScattererPart], polarizations: int, some: slice) -> float:
    """Seconds of the deposit of a scatterer into one of some pulses, without transfers."""
    device = track.time.device
    there = [history.PartOnDevice.of(part, device) for part in parts]
    bins = history.no_bins(plan, polarizations, some, device)

    def run() -> None:
        history.deposited(plan, track, there, some, bins)
        wp.synchronize_device(device)

    run()  # loads the kernels
    return timed(run)[0] / (max(sum(map(len, parts)), 1) * (some.stop - some.start))


def _focusing(bodies: Bodies, plan: Plan) -> float:
    """Seconds of the backprojection of a whole image, by two parts of its rows."""
    grid, names = bodies.world.grid, tuple(bodies.world.radar.polarizations)
    random = np.random.default_rng(0)
    shape = (len(names), plan.frequencies, len(plan.track))
    samples: NDArray[np.complex64] = random.standard_normal((*shape, 2), np.float32).view(np.complex64)[..., 0]
    made = history.Collected(plan, names, samples, 0, 0.0)
    rows = grid.shape[0]
    few, more = min(rows, max(1, rows // 64)), min(rows, max(2, rows // 10))

    def spent(count: int) -> float:
        part = grid.model_copy(update={"shape": (count, grid.shape[1])})
        return timed(lambda: slc.focused(made, part, bodies.device))[0]

    spent(few)  # loads the kernels
    low, high = spent(few), spent(more)
    return high + (rows - more) * max(high - low, 0.0) / max(more - few, 1)


def _picture(world: World) -> float:
    """Seconds of a quick look."""
    draw = partial(draw_blank, world.radar.polarizations, world.grid.shape, world.grid.spacing_m)
    draw()  # loads the library that draws
    return timed(draw)[0]
