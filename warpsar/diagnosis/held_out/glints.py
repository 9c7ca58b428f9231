"""Glints of bodies: found one by one in what train views leave beside their models, as many as views left out pay for.

A glint has a place on a body, a lobe about an azimuth of the radar and a cross-section. The one that raises the
likelihood of a part's train views most is taken, with a share of its likeliest cross-section; what is left of it may be
taken again. All parts go on side by side. After each glint, the views left out of each part say how well they are
predicted. A lobe narrower than the arcs that are left out is seen there by its flanks alone, so it hardly pays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from warpsar.compare.aim import BOUND, FAINTEST, LEAST, Reach, mean_deviance, own_shift
from warpsar.diagnosis.held_out.geometry import bodies
from warpsar.diagnosis.held_out.model import TrainViews
from warpsar.effects.glints import ALL_ROUND_DEG, EFFECT, Glint, lobe
from warpsar.effects.registry import declared, response_of
from warpsar.kernels.codes import Polarization
from warpsar.runtime import threads
from warpsar.runtime.deadline import check
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import best_gain, bounded
from warpsar.world.objects.pose import rotation
from warpsar.world.world import geometry_of

NAME = EFFECT.name
FEWEST_VIEWS = 18  # train views from which on azimuths are many
STEP_M = (0.25, 0.25, 0.5)  # between places that are tried: east, north, up
BEYOND_M = 0.2  # the body's extent
HALF_WIDTHS_DEG = (10.0, 20.0, 40.0, 80.0, ALL_ROUND_DEG)
STEP_OF_LOBES_DEG = 10.0  # at least; half of a half width
LEVELS = np.linspace(math.log(3e-3), math.log(100.0), 15)
"""Logarithms of the cross-sections that are tried, over what the body's pixels have in the middle."""
SHARE = 0.6  # of a likeliest cross-section that is taken at a time: the place was chosen by speckle, too
AROUND = 2  # pixels about a point that are compared
MOST = 60
PATIENCE = 20  # glints that may pay nothing in a row
LEAST_GAIN = 6.0  # in log-likelihood: one for each number of a glint. Views left out ask for more
ALIGNED = 8  # glints after which shifts and gains of the images are found anew
ON_BODY = 3.0  # times the median of an image from which on a modelled pixel is the body's


@dataclass(frozen=True)
class PlacedGlint:
    """A glint on a body: `place_m` across, along and up in the object's own frame, `aspect_deg` the radar's azimuth in
    the lobe's middle, clockwise from the body's front; None all round."""

    body: str
    place_m: tuple[float, float, float]
    aspect_deg: float | None
    half_width_deg: float
    rcs_dbsm: float


@dataclass
class _Image:
    """One measured image, its model on the whole image, and both in the window that is compared."""

    power: np.ndarray
    plane: np.ndarray
    reach: Reach
    azimuth_deg: float
    axes: tuple[np.ndarray, np.ndarray]
    widths_m: tuple[float, float]
    spacing_m: tuple[float, float]
    weight: float  # independent draws of a pixel
    measured: np.ndarray = field(init=False)
    model: np.ndarray = field(init=False)
    _low: tuple[int, int] = field(init=False)

    def align(self) -> None:
        """Find the shift, and the gain of the measured image. What is not used of it is NaN."""
        shift = own_shift(self.power, self.plane, self.reach)
        self._low = self.reach.rows - shift[0], self.reach.cols - shift[1]
        power, mu = self.reach.window(self.power), self.reach.window(self.plane, shift)
        use = np.isfinite(power)
        power = np.maximum(power, LEAST * np.median(power[use]))
        self.model = np.maximum(mu, FAINTEST * np.median(mu))
        self.measured = power / best_gain("gamma", power[use], self.model[use], 1.0, BOUND)

    def pixels_of(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row and column of places (n, 3) in the window, (n,) each."""
        low, shape = self._low, self.plane.shape
        row, col = (
            places @ axis / step + n / 2.0 - 0.5 - first
            for axis, step, n, first in zip(self.axes, self.spacing_m, shape, low, strict=True)
        )
        return row, col

    def add(self, glint: Glint) -> None:
        rcs = glint.rcs_at(self.azimuth_deg)
        at = self.pixels_of(np.array([glint.place_m]))
        lines = [
            self._response(np.arange(n) - low - middle, axis)
            for axis, (n, low, middle) in enumerate(zip(self.plane.shape, self._low, at, strict=True))
        ]
        added = rcs / float(np.prod(self.spacing_m)) * np.outer(*lines)
        self.plane = self.plane + added
        row, col = self._low
        rows, cols = self.model.shape
        self.model = self.model + added[row : row + rows, col : col + cols]

    def _response(self, off_px: np.ndarray, axis: int) -> np.ndarray:
        """A Gaussian of the response's width, of sum 1 over the pixels."""
        width, step = self.widths_m[axis], self.spacing_m[axis]
        peak = step / width * math.sqrt(4.0 * math.log(2.0) / math.pi)
        return np.asarray(peak * np.exp(-4.0 * math.log(2.0) * (off_px * step / width) ** 2))

    def gains(self, places: np.ndarray, unit: float) -> np.ndarray:
        """What a point of each of `LEVELS` times `unit` gains in log-likelihood at each place, (places, levels)."""
        shape, near = self.model.shape, np.arange(-AROUND, AROUND + 1)
        at = self.pixels_of(places)
        middle = [np.rint(one).astype(int) for one in at]
        inside = np.logical_and.reduce(
            [(m > AROUND) & (m < n - 1 - AROUND) for m, n in zip(middle, shape, strict=True)]
        )
        index = [np.clip(m, AROUND, n - 1 - AROUND)[:, None] + near for m, n in zip(middle, shape, strict=True)]
        row, col = (self._response(i - a[:, None], axis) for axis, (i, a) in enumerate(zip(index, at, strict=True)))
        point = (row[:, :, None] * col[:, None, :]).reshape(len(places), -1, 1).astype(np.float32)
        window = index[0][:, :, None], index[1][:, None, :]
        old, measured = (
            one[window].reshape(len(places), -1, 1).astype(np.float32) for one in (self.model, self.measured)
        )
        new = old + np.float32(unit) * np.exp(LEVELS).astype(np.float32) * point

        def loss(mu: np.ndarray) -> np.ndarray:
            ratio = measured / mu
            return bounded(ratio - 1.0 - np.log(ratio), BOUND)

        found = np.nansum(loss(old) - loss(new), axis=1) * self.weight
        return np.asarray(np.where(inside[:, None], found, 0.0), np.float32)


class _Part:
    """The search in the train views of one part."""

    def __init__(self, trained: TrainViews, scene: Scene, names: Sequence[str], left: Sequence[str]) -> None:
        self.images, self.left = (_images(trained, scene, some) for some in (names, left))
        self.found: list[Glint] = []
        self.places = _places(scene)
        self._pixel_m2 = float(np.prod(scene.grid.spacing_m))
        on_body = [one.model[one.model > ON_BODY * np.median(one.model)] for one in self.images]
        self._unit = float(np.median(np.concatenate(on_body))) if any(one.size for one in on_body) else 0.0
        azimuths = np.array([one.azimuth_deg for one in self.images])
        self._lobes, self._moved = _lobes(azimuths)
        self._gains = np.stack([one.gains(self.places, self._unit) for one in self.images], axis=1)

    def one_more(self) -> bool:
        """Take the likeliest glint; False where none gains what its numbers cost."""
        if not self._unit:
            return False
        if self.found and len(self.found) % ALIGNED == 0:
            for one in self.images:
                one.align()
            self._gains = np.stack([one.gains(self.places, self._unit) for one in self.images], axis=1)
        count, views, levels = self._gains.shape
        total = self._gains.reshape(count, views * levels) @ self._moved
        at, which = np.unravel_index(int(total.argmax()), total.shape)
        if total[at, which] < LEAST_GAIN:
            return False
        lobe_at, level = divmod(int(which), levels)
        about, half = self._lobes[lobe_at]
        rcs_m2 = SHARE * self._unit * math.exp(LEVELS[level]) * self._pixel_m2
        east, north, up = self.places[at].tolist()
        glint = Glint((east, north, up), about, half, rcs_m2)
        self.found.append(glint)
        for number, one in enumerate(self.images):
            if glint.rcs_at(one.azimuth_deg) > 1e-3 * rcs_m2:
                one.add(glint)
                off = [p - q for p, q in zip(one.pixels_of(self.places), one.pixels_of(self.places[[at]]), strict=True)]
                near = np.maximum(*map(np.abs, off)) < 3 * AROUND
                self._gains[near, number] = one.gains(self.places[near], self._unit)
        for one in self.left:
            one.add(glint)
        return True

    def deviances(self) -> list[float]:
        """Of the views left out."""
        return [mean_deviance(one.measured, one.model) for one in self.left]


def found_by_parts(
    trained: TrainViews, scenes: Sequence[Scene], folds: Sequence[Sequence[str]]
) -> tuple[list[list[Glint]], int]:
    """Glints for each part's scene, found in its train views; how many were taken, as many as the views left out pay
    for together. Each list has places once."""
    parts = []
    for scene, left in zip(scenes, folds, strict=True):
        parts.append(_Part(trained, scene, [name for name in trained.names if name not in left], left))
    best, count = float(np.mean([one for part in parts for one in part.deviances()])), 0
    for number in range(1, MOST + 1):
        check()
        if not all(threads.in_threads([part.one_more for part in parts])):
            break
        mean = float(np.mean([one for part in parts for one in part.deviances()]))
        if mean < best:
            best, count = mean, number
        if number - count >= PATIENCE:
            break
    return [merged(part.found[:count]) for part in parts], count


def found_in_all(trained: TrainViews, scene: Scene, count: int) -> list[Glint]:
    """At most so many glints, found in all train views."""
    part = _Part(trained, scene, trained.names, [])
    while len(part.found) < count and part.one_more():
        check()
    return merged(part.found)


def glints_of(rows: Sequence[Sequence[float]]) -> list[Glint]:
    """The glints whose rows these are."""
    return [Glint.of(row) for row in rows]


def merged(glints: Sequence[Glint]) -> list[Glint]:
    """Those of one place and one lobe as one."""
    sums: dict[tuple[tuple[float, float, float], float, float], float] = {}
    for one in glints:
        key = one.place_m, one.azimuth_deg, one.half_width_deg
        sums[key] = sums.get(key, 0.0) + one.rcs_m2
    return [Glint(*key, rcs_m2) for key, rcs_m2 in sums.items()]


def on_bodies(scene: Scene) -> list[PlacedGlint]:
    """The scene's glints on its bodies, the strongest first."""
    table = scene.effects.get(NAME, {})
    placed = []
    for one in (Glint.of(row) for row in table.get("points", [])):
        rcs_m2 = one.rcs_m2 * float(table.get("strength", 0.0))
        at = np.array(one.place_m) + np.array(scene.reference_point_m)
        best: tuple[float, str, np.ndarray, float] | None = None
        for each in (each for each in scene.objects if each.label in bodies(scene)):
            turn = rotation(each.heading_deg, each.pitch_deg, each.roll_deg)
            own = turn.T @ (at - np.array(each.position_m))
            far = float(np.linalg.norm(at - _extent(scene, each.label).mean(axis=0)))
            if best is None or far < best[0]:
                best = far, each.label, own, each.heading_deg
        if best is None or rcs_m2 <= 0.0:
            continue
        _, label, own, heading = best
        aspect = None if one.half_width_deg >= ALL_ROUND_DEG else (one.azimuth_deg - heading) % 360.0
        across, along, up = (round(float(value), 2) for value in own)
        level = 10.0 * math.log10(rcs_m2)
        placed.append(PlacedGlint(label, (across, along, up), aspect, one.half_width_deg, round(level, 1)))
    return sorted(placed, key=lambda one: -one.rcs_dbsm)


def _extent(scene: Scene, label: str) -> np.ndarray:
    """The low and the high corner of an object, (2, 3), in the scene's frame [m]."""
    assert scene.assembly is not None
    vertices = scene.assembly.vertices_of(next(one for one in scene.objects if one.label == label))
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


def _places(scene: Scene) -> np.ndarray:
    """A grid of places about each body, (n, 3), about the reference point [m]."""
    found = []
    for label in bodies(scene):
        low, high = _extent(scene, label)
        axes = [np.arange(a - BEYOND_M, b + BEYOND_M + s, s) for a, b, s in zip(low, high, STEP_M, strict=True)]
        axes[2] = np.arange(low[2] + BEYOND_M, high[2] + BEYOND_M + STEP_M[2], STEP_M[2])
        found.append(np.stack([one.ravel() for one in np.meshgrid(*axes, indexing="ij")], axis=1))
    return np.concatenate(found) - np.asarray(scene.reference_point_m)


def _lobes(azimuths_deg: np.ndarray) -> tuple[list[tuple[float, float]], np.ndarray]:
    """The lobes that are tried, (middle, half width), and the matrix (views * levels, lobes * levels) that takes gains
    by view and by cross-section towards it to those of all views by the lobe's cross-section. Between levels gains are
    linear; below the least, they are 0."""
    lobes = []
    for half in HALF_WIDTHS_DEG:
        step = max(STEP_OF_LOBES_DEG, half / 2.0)
        middles = [0.0] if half >= ALL_ROUND_DEG else np.arange(0.0, 360.0, step).tolist()
        lobes += [(float(middle), half) for middle in middles]
    levels, step = LEVELS.size, LEVELS[1] - LEVELS[0]
    moved = np.zeros((azimuths_deg.size, levels, len(lobes), levels), np.float32)
    own = np.arange(levels)
    for number, (middle, half) in enumerate(lobes):
        down = np.log(np.maximum(lobe(azimuths_deg, middle, half), 1e-30)) / step
        for view, by in enumerate(down):
            low = np.floor(own + by).astype(int)
            share = own + by - low
            for index, weight in ((low, 1.0 - share), (low + 1, share)):
                some = (index >= 0) & (index < levels)
                moved[view, index[some], number, own[some]] += weight[some]
    return lobes, moved.reshape(azimuths_deg.size * levels, -1)


def _images(trained: TrainViews, scene: Scene, names: Sequence[str]) -> list[_Image]:
    views = {view.name: view for view in scene.views}
    spacing = scene.grid.spacing_m
    found = []
    for name, planes in zip(names, trained.images(scene, names) if names else [], strict=True):
        view, geometry = views[name], geometry_of(scene, views[name])
        asked = response_of(declared(scene, view)).width_m
        widths = tuple(max(wide or 0.0, step) for wide, step in zip(asked, spacing, strict=True))
        shared = float(np.prod([wide / step for wide, step in zip(widths, spacing, strict=True)]))
        for pol, plane in planes.items():
            if Polarization[pol].crossed or pol not in view.images:
                continue
            one = _Image(
                trained.measured(name, pol),
                plane,
                trained.reach,
                view.azimuth_deg,
                (geometry.d, geometry.u),
                (widths[0], widths[1]),
                spacing,
                (view.looks or 1.0) / shared,
            )
            one.align()
            found.append(one)
    return found


def with_glints(scene: Scene, glints: Sequence[Glint]) -> Scene:
    """The scene with the effect, which no fit moves."""
    table = {"strength": 1.0, "fixed": True, "points": [one.row for one in glints]}
    return replace(scene, effects={**scene.effects, NAME: table})
