"""How long products with phase will take, and how much memory: measured on parts of the work before it begins."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import warp as wp
from numpy.typing import NDArray

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
from warpsar.world.world import World

FEWEST = 2**14
"""Scatterers that are held at a time at least."""
BANDS = 5
"""Places of a view, at least, where three rows of coarse cells are traced for the forecast."""
_CELLS = 2**16
"""Coarse cells of the sample."""
_SAMPLE_S = 1.0
"""How long tubes of the sample are traced."""
_ROUGH_BYTES = 300
"""Of a rough place while the body is made: on the host, on the device, and what it is drawn from."""
_HELD_BYTES = 300
"""Of a scatterer that is held: as it is seen, as it is joined to others, and on the device."""
_HIT_BYTES = 300
"""Of a hit of a tube, and what is made of it, in a launch of `GROUP` cells."""
_SAMPLE_BYTES, _PIXEL_BYTES = 24, 96
"""Of a sample of phase history, and of a pixel of a complex image in one polarization, with their copies."""


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


def held_gib(world: World, plan: Plan, product: str) -> float:
    """Memory of one view that no smaller parts of the work save [GiB]: rough places, a launch of tubes, the product."""
    corners = world.mesh.vertices[world.mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    rough = np.array([world.materials[name].rms_height_m != 0.0 for name in world.mesh.materials])
    places = area[rough[world.mesh.face_material]].sum() / spacing_m(plan) ** 2 if "rough" in world.radar.terms else 0.0
    several = len(world.radar.polarizations)
    total = _ROUGH_BYTES * places
    if {"single", "multibounce"} & set(world.radar.terms):
        bounces = world.radar.max_bounces if "multibounce" in world.radar.terms else 1
        total += _HIT_BYTES * bounces * GROUP * COARSE**2
    if product == "phase-history" or plan.table.focus == "backprojection":
        total += _SAMPLE_BYTES * several * plan.frequencies * len(plan.track)
    if product == "slc":
        fine = 1.0
        if plan.table.focus == "direct":
            steps = zip(world.grid.spacing_m, plan.cells_m, strict=True)
            fine = math.prod(math.ceil(step / (0.5 * cell)) for step, cell in steps)
        total += _PIXEL_BYTES * several * fine * math.prod(world.grid.shape)
    return float(total / 2**30)


def together(world: World, plans: Sequence[Plan], product: str, device: wp.Device, max_memory_gib: float | None) -> int:
    """Scatterers that may be held at a time.

    Raises InputError where even the fewest do not fit into `max_memory_gib`, or into the device's memory without it.
    """
    there = default_gib(device) if max_memory_gib is None else max_memory_gib
    held = max(held_gib(world, plan, product) for plan in plans)
    least = held + FEWEST * _HELD_BYTES / 2**30
    if least > there:
        what = "--max-memory" if max_memory_gib is not None else "the memory that this machine can give"
        raise InputError(
            f"{world.name}: {product}: found {least:.3g} GiB for rough places, tubes, phase history and image, beside "
            f"the scatterers that are held in turn; {what} allows {there:.3g} GiB; ask for fewer pixels, pulses or "
            f"polarizations, fewer scatterers_per_cell of [collection], or a smaller mesh"
        )
    return int(min(TOGETHER, (there - held) * 2**30 / _HELD_BYTES))


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
    stream = Stream(world, first, body, once=once, together=FEWEST)
    rough, tubes = _rough(stream), _tubes(stream)
    parts = [*rough.parts, *tubes.parts]
    seconds = built * (len({spacing_m(plan) for plan in plans}) - 1)
    scatterers = 0.0
    deposit = _Deposit.of(bodies, first, parts, once)
    for plan in plans:
        mine = stream if plan is first else Stream(world, plan, body, once=once, together=FEWEST)
        for knots, kind in ((mine.rough_knots, rough), (mine.tube_knots, tubes)):
            seen = 1 if once else (fading(plan, knots) > 0.0).sum(axis=1)
            several = kind.scatterers * (1 + len(plan.copies))
            scatterers += several * len(knots)
            seconds += kind.seconds * len(knots) + deposit.each * several * float(np.sum(seen))
        pulses = 1 if once else len(plan.track)
        batches = math.ceil(max(scatterers, 1.0) / len(plans) / bodies.together)
        seconds += deposit.whole * (pulses * batches if not once else 1)
    if product == "slc":
        seconds += len(plans) * (_picture(world) + (0.0 if once else _focusing(bodies, first)))
    held = max(held_gib(world, plan, product) for plan in plans)
    gib = held + min(bodies.together, scatterers / len(plans)) * _HELD_BYTES / 2**30
    return CollectionForecast(len(plans), scatterers, seconds, gib) if seconds > LONG_S else None


@dataclass(frozen=True)
class _Look:
    """One look at the scene from one place of the track: how long it takes, and the scatterers that it finds."""

    seconds: float
    scatterers: float
    parts: tuple[ScattererPart, ...]


def _rough(stream: Stream) -> _Look:
    """Of rough places, by three stretches of them."""
    places = stream.body.scatterers
    if not len(stream.rough_knots) or places is None:
        return _Look(0.0, 0.0, ())
    total, knot = places.shape[0], stream.plan.middle
    size = max(1, min(total // 3, 2 * FEWEST * threads.thread_count()))
    stream.rough(knot, slice(0, min(total, 16)))  # loads the kernels
    spent, found = timed(
        lambda: [stream.rough(knot, slice(a, a + size)) for a in np.linspace(0, total - size, 3).astype(int).tolist()]
    )
    whole = total / (3.0 * size)
    return _Look(spent * whole, whole * sum(len(some.face) for some in found), _alike(stream, found))


def _tubes(stream: Stream) -> _Look:
    """Of tubes, by bands of the coarse cells and by tubes of some of them."""
    if not len(stream.tube_knots) or not {"single", "multibounce"} & set(stream.terms):
        return _Look(0.0, 0.0, ())
    cells = stream.cells(stream.plan.middle)
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

        run([one])  # loads the kernels
        empty = timed(lambda: run([one]))[0]
        full = timed(lambda: run(parts))[0] if parts else empty
        return cls(max(full - empty, 0.0) / (max(scatterers, 1) * pulses), empty * scale)


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
