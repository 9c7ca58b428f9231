"""The scatterers of a collection: parts, each seen from one place of the track, that fade into one another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent.body import CoherentBody
from warpsar.coherent.patches import PatchesOnDevice
from warpsar.coherent.records import upload
from warpsar.coherent.rough_models import backscatter_alone
from warpsar.coherent.sweep import POLARIZATIONS, RAYS_PER_WAVELENGTH
from warpsar.collection import places
from warpsar.collection.places import TubeTally
from warpsar.collection.plan import Plan, plan_axes
from warpsar.errors import InputError
from warpsar.runtime.program import Program
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import OF_RAYS, SURFACE_KEYS, Grid, bounces
from warpsar.world.world import World

F64 = NDArray[np.float64]
ROUGH_STEP_DEG = 2.0
"""Between the places of the track from which rough faces are seen: sigma0 and shadows change slowly."""
TUBE_STEP_DEG = 0.5
"""Between those from which tubes are traced: the effective place of several bounces is right to first order."""
TOGETHER = 2**20
"""Scatterers that are held at a time, where memory does not ask for fewer."""
BAND_SAMPLE = 2**20
"""About so many rough places tell how amplitudes change within the band."""
FAR_FIELD = float(np.sqrt(np.float32(4.0 * np.pi)))
"""From the engine's amplitude A to one whose power is the RCS."""


def power_gain(plan: Plan, points_m: F64, pulse: int, device: wp.Device) -> F64 | None:
    """The factor on the power of scatterers at points (n, 3) [m] about the reference point, (n,), as a pulse sees
    them; None where no effect is a gain.

    The effects record their gains as they do for an image of power, each on a power of 1.
    """
    effects = [one for one in plan.effects if one.effect.stage == "gain"]
    if not effects:
        return None
    total = np.ones(len(points_m))
    points = upload(points_m, wp.vec3, device)
    for one in effects:
        program = Program(device)
        recorder: Any = SimpleNamespace(program=program, geometry=plan.geometry_at(pulse))
        p: wp.array = wp.array(one.values, dtype=float, device=device)
        power = wp.ones(len(points_m), dtype=float, device=device)
        result = one.effect.gain(recorder, p, power, points)
        program.forward()
        total *= result.numpy()
    return total


@dataclass(frozen=True)
class MovedScatterers:
    """Scatterers where the effects put them: (n, 3) [m], the factor on their amplitudes, (n,), and which of the given
    ones each is."""

    point: F64
    factor: NDArray[np.complex64]
    index: NDArray[np.int64]


def moved(plan: Plan, points_m: F64, pulse: int, grid: Grid, seed: int, device: wp.Device) -> MovedScatterers:
    """Scatterers at points (n, 3) [m], with gains as a pulse sees them, shifted, and with their copies.

    Copies are those of scatterers that lie in the image. Each has a phase that the seed draws, one for all its
    scatterers: so smooth faces of the copy stay smooth, and two passes with one seed see one copy.
    """
    gain = power_gain(plan, points_m, pulse, device)
    factor = np.ones(len(points_m), np.complex64) if gain is None else np.sqrt(gain).astype(np.complex64)
    point, index = points_m + plan.shift_m, np.arange(len(points_m))
    if not plan.copies:
        return MovedScatterers(point, factor, index)
    row, column = plan_axes(plan)
    place = np.stack([point @ plan.geometry.d / float(row @ plan.geometry.d), point @ column], axis=1)
    inside = (np.abs(place) <= 0.5 * np.multiply(grid.shape, grid.spacing_m)).all(axis=1)
    found = [MovedScatterers(point, factor, index)]
    for number, copy in enumerate(plan.copies):
        turn = np.random.default_rng([seed, 2, number]).uniform(0.0, 2.0 * np.pi)
        amplitude = np.complex64(np.sqrt(copy.power) * np.exp(1j * turn))
        found.append(
            MovedScatterers(point[inside] + copy.azimuth_m * column, amplitude * factor[inside], index[inside])
        )
    joined = (np.concatenate([getattr(one, name) for one in found]) for name in ("point", "factor", "index"))
    return MovedScatterers(*joined)


@dataclass(frozen=True)
class ScattererPart:
    """Scatterers about the reference point, and how much each pulse has of them."""

    point: F64
    """(n, 3) [m], in the frame of `Site`."""
    amplitude: NDArray[np.complex64]
    """sqrt(4 pi) A [m], (polarizations, n): a scatterer's power is its RCS."""
    weight: NDArray[np.float32]
    """(pulses,)."""
    velocity: F64 | None = None
    """(n, 3) [m/s]; None where nothing moves."""

    def __len__(self) -> int:
        return len(self.point)


@dataclass(frozen=True)
class Scatterers:
    parts: tuple[ScattererPart, ...]
    aliased: float
    """Share of the tubes that are too wide after a curved surface."""

    @property
    def count(self) -> int:
        return sum(map(len, self.parts))


def refuse_materials(world: World) -> None:
    """Raise InputError for materials that are no numbers."""
    for name, material in world.materials.items():
        for key in SURFACE_KEYS:
            if not isinstance(getattr(material, key), float | int | tuple | None):
                raise InputError(
                    f"{world.name}: materials.{name}.{key}: found a field; must be a number for a product with phase"
                )


def rough_alone(world: World) -> bool:
    """Whether `[radar] terms` asks for rough faces and nothing else."""
    return set(world.radar.terms) == {"rough"}


def spacing_m(plan: Plan) -> float:
    """Between scatterers of rough faces [m]: each cell of the system holds enough of them."""
    return float(np.sqrt(np.prod(plan.cells_m) / plan.table.scatterers_per_cell))


def body_of(world: World, spacing_m: float, device: wp.Device, seed: int) -> CoherentBody:
    """The mesh on the device, with its rough places at a spacing."""
    refuse_materials(world)
    return CoherentBody.of(world, device, spacing_m=spacing_m, seed=seed, rough_only=rough_alone(world))


class Stream:
    """All that `[radar] terms` asks for, seen along the track, in parts that are made when they are asked for.

    `once`: seen from the middle of the track alone. `together`: the most scatterers of a part; the memory that they
    take is bounded by it. `progress` counts the places of the track that are done, by fractions. `seed` draws what
    effects draw of scatterers. `rough`: with those of rough faces.
    """

    def __init__(
        self,
        world: World,
        plan: Plan,
        body: CoherentBody,
        *,
        once: bool = False,
        rays_per_wavelength: float = RAYS_PER_WAVELENGTH,
        together: int = TOGETHER,
        progress: Any = None,
        seed: int = 0,
        rough: bool = True,
    ) -> None:
        k = 2.0 * np.pi * plan.centre_hz / SPEED_OF_LIGHT
        terms = world.radar.terms
        self.plan, self.body, self.terms = plan, body, terms
        self.grid, self.seed = world.grid, seed
        self.worker = places.worker_of(body, k, terms, world.radar.max_bounces, rays_per_wavelength)
        tracer = self.worker.tracer
        group, most = places.GROUP * places.COARSE**2, min(tracer.together, together // tracer.bounces)
        tracer.together = max(most - most % group, group)
        # The engine names the received one first, [radar] the transmitted one.
        self._columns = [POLARIZATIONS.index(name[::-1]) for name in world.radar.polarizations]
        self._apart = plan.track.bistatic
        self._rates = [np.gradient(end, axis=0) for end in plan.track.ends()]
        self._velocity = _velocities(world, plan)
        middle = np.array([plan.middle])
        rough = rough and "rough" in terms and len(body.patches) > 0
        smooth = bool((OF_RAYS | {"edges"}) & set(terms))
        self.rough_knots = (middle if once else plan.knots(ROUGH_STEP_DEG)) if rough else middle[:0]
        self.tube_knots = (middle if once else plan.knots(TUBE_STEP_DEG)) if smooth else middle[:0]
        self.together, self.progress = together, progress
        self.count, self.tally = 0, TubeTally()
        """Of the parts made so far: scatterers, and tubes."""

    @cached_property
    def _patches(self) -> PatchesOnDevice:
        return self.body.patches.on(self.body.device)

    @property
    def aliased(self) -> float:
        """Share of the tubes of the parts made so far that are too wide after a curved surface."""
        return self.tally.share

    @property
    def looks(self) -> int:
        """What `progress` counts to."""
        return len(self.rough_knots) + len(self.tube_knots)

    @property
    def parts(self) -> Iterator[ScattererPart]:
        """Make them, one after the other."""
        self.count, self.tally = 0, TubeTally()
        for found in (self._rough(), self._smooth()):
            for part in found:
                self.count += len(part)
                yield part

    def cells(self, knot: int) -> list[places.CoarseCells]:
        """The coarse cells of the body as the pulse `knot` sees it.

        Of two antennas they are those of the transmitter, and where rough faces scatter what others mirror to them,
        those of the receiver, too: a wave goes from a rough face to a mirror as it comes back.
        """
        if not self._apart:
            still = np.zeros(3)
            return [places.CoarseCells(self.worker, between(self.plan, knot), [still, still])]
        track = self.plan.track
        ends = [track.transmitter_m[knot], track.receiver_m[knot]]
        rates = [rate[knot] for rate in self._rates]
        found = [places.CoarseCells(self.worker, ends, rates)]
        after_mirrors = "rough" in self.terms and bounces(self.terms, 2) > 1
        if after_mirrors and any(m.rms_height_m for m in self.body.materials):
            found.append(places.CoarseCells(self.worker, ends[::-1], rates[::-1], returned=True))
        return found

    def rough(self, knot: int, some: slice) -> Iterator[places.Places]:
        """Rough places as the pulse `knot` sees them, without those that it does not see, in parts."""
        radar = rough_sight(self.plan, self.body, knot)
        start = some.start
        for found in places.rough_seen(self.worker, radar, self._patches, some, self.together):
            amplitude = places.complex_of(found.amplitude)
            seen = (amplitude != 0.0).any(axis=1)
            face = self.body.patches.faces_of(slice(start, start + len(seen)))
            start += len(seen)
            yield places.Places(found.placed.points.numpy()[seen], amplitude[seen], face[seen])

    def part(self, some: places.Places, weight: NDArray[np.float32], knot: int) -> ScattererPart:
        """Places that the pulse `knot` sees as scatterers about the reference point, with what effects do to them."""
        plan = self.plan
        point = plan.site.about(some.point + self.body.origin + plan.site.reference_m)
        amplitude = np.float32(FAR_FIELD) * some.amplitude[:, self._columns].T
        face = some.face
        if plan.moves_scatterers:
            found = moved(plan, point, knot, self.grid, self.seed, self.body.device)
            point, amplitude, face = found.point, amplitude[:, found.index] * found.factor, face[found.index]
        moving = None if self._velocity is None else self._velocity[face]
        return ScattererPart(point, np.ascontiguousarray(amplitude), weight, moving)

    def _done(self, share: float) -> None:
        if self.progress is not None:
            self.progress.update(share)

    def _rough(self) -> Iterator[ScattererPart]:
        total = len(self.body.patches)
        for knot, weight in zip(self.rough_knots.tolist(), fading(self.plan, self.rough_knots), strict=True):
            for start in range(0, total, self.together):
                stop = min(start + self.together, total)
                found = places.joined(list(self.rough(knot, slice(start, stop))))
                if len(found.face):
                    yield self.part(found, weight, knot)
                self._done((stop - start) / total)

    def _smooth(self) -> Iterator[ScattererPart]:
        terms = self.terms
        for knot, weight in zip(self.tube_knots.tolist(), fading(self.plan, self.tube_knots), strict=True):
            if OF_RAYS & set(terms):
                yield from self._tubes(knot, weight)
            if "edges" in terms and self.worker.edges.shape[0]:
                edges = places.edge_places(self.worker, places.sight(self.body, *between(self.plan, knot))[1])
                if len(edges.face):
                    yield self.part(edges, weight, knot)

    def _tubes(self, knot: int, weight: NDArray[np.float32]) -> Iterator[ScattererPart]:
        waiting: list[places.Places] = []
        several = self.cells(knot)
        for cells in several:
            before = 0.0
            for found, tally, share in places.tube_places(cells):
                self.tally += tally
                waiting.append(found)
                if sum(len(each.face) for each in waiting) >= self.together:
                    yield self.part(places.joined(waiting), weight, knot)
                    waiting = []
                self._done((share - before) / len(several))
                before = share
            self._done((1.0 - before) / len(several))
        if sum(len(each.face) for each in waiting):
            yield self.part(places.joined(waiting), weight, knot)


def between(plan: Plan, pulse: int) -> list[F64]:
    """The place of the sensor, or of one halfway between two antennas, (3,) [m] about the reference point."""
    return [plan.track.towards()[pulse] * plan.track.reference_m()[pulse]]


def rough_sight(plan: Plan, body: CoherentBody, pulse: int) -> wp.array:
    """The radars of `places.rough_seen` at a pulse: one halfway between two antennas where a model has no other."""
    track = plan.track
    if not track.bistatic or backscatter_alone(body.materials, body.variant):
        return places.sight(body, *between(plan, pulse))[1]
    return places.sight(body, track.transmitter_m[pulse], track.receiver_m[pulse])[1]


def scatterers_of(
    world: World,
    plan: Plan,
    body: CoherentBody,
    *,
    once: bool = False,
    rays_per_wavelength: float = RAYS_PER_WAVELENGTH,
    seed: int = 0,
) -> Scatterers:
    """All parts of a `Stream` at once."""
    found = Stream(world, plan, body, once=once, rays_per_wavelength=rays_per_wavelength, seed=seed)
    return Scatterers(tuple(found.parts), found.aliased)


def band_error_db(world: World, plan: Plan, body: CoherentBody) -> float:
    """How far amplitudes at an end of the band lie from those of its middle, which stand for the whole band [dB].

    Currents on smooth faces send back in proportion to the frequency. Rough places are computed at both ends, as the
    middle of the track sees them: the change is that of their power.
    """
    ends = np.array([-0.5, 0.5]) * plan.bandwidth_hz + plan.centre_hz
    found = [0.0]
    if OF_RAYS & set(world.radar.terms) and not all(m.rms_height_m for m in body.materials):
        found += (20.0 * np.log10(ends / plan.centre_hz)).tolist()
    if "rough" in world.radar.terms and len(body.patches):
        radar = rough_sight(plan, body, plan.middle)
        total = len(body.patches)
        # A sample: some patches of a large surface tell the change as well as all of them.
        some = slice(None, None, -(-total // BAND_SAMPLE))
        there = body.patches.chosen(some).on(body.device)
        powers = []
        for frequency in (plan.centre_hz, *ends):
            k = 2.0 * np.pi * frequency / SPEED_OF_LIGHT
            worker = places.worker_of(body, k, ("rough",), 1, RAYS_PER_WAVELENGTH)
            parts = places.rough_seen(worker, radar, there, slice(0, len(there)), TOGETHER)
            powers.append(sum(float((np.abs(places.complex_of(each.amplitude)) ** 2).sum()) for each in parts))
        if powers[0] > 0.0:
            found += (10.0 * np.log10(np.maximum(np.divide(powers[1:], powers[0]), 1e-30))).tolist()
    return max(map(abs, found))


def fading(plan: Plan, knots: NDArray[np.int64]) -> NDArray[np.float32]:
    """Linear weights of the knots at each pulse, (knots, pulses), which add up to 1."""
    pulses = np.arange(len(plan.track))
    if len(knots) == 0:
        return np.empty((0, len(pulses)), np.float32)
    identity = np.eye(len(knots))
    return np.array([np.interp(pulses, knots, row) for row in identity], np.float32)


def _velocities(world: World, plan: Plan) -> F64 | None:
    """Velocity of each face, (m, 3) [m/s]; None where nothing moves."""
    movers = plan.table.velocity_m_s
    if not movers:
        return None
    if world.assembly is None:
        raise InputError(f"{world.name}: collection.velocity_m_s: found {', '.join(movers)}, but no [[objects]]")
    found = np.zeros((len(world.mesh.faces), 3))
    start = 0 if world.assembly.base is None else len(world.assembly.base.faces)
    for one in world.objects:
        if one.group is None:
            end = start + len(world.assembly.placed(one).faces)
            some: Any = slice(start, end)
            start = end
        else:
            mine = np.zeros(len(world.mesh.vertices), bool)
            mine[world.assembly.moved[one.label]] = True
            some = mine[world.mesh.faces].all(axis=1)
        if one.label in movers:
            found[some] = movers[one.label]
    return found


def total_weight(parts: Sequence[ScattererPart]) -> int:
    """Deposits: scatterers times the pulses that have them."""
    return sum(len(part) * int((part.weight > 0.0).sum()) for part in parts)
