"""Where something stands that the scene does not have: places on which several views agree.

A body on the ground makes pixels brighter from its roof's near edge to its foot (layover), and darker from there to the
end of its shadow. Both stretches have a place in every view once the body's place, width and height are given. So all
places are tried with a few sizes, on the ratios of measured to modelled power, without any render.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpsar.diagnosis.models.projection import pixel_of
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import expected_deviance
from warpsar.world.mesh import Mesh
from warpsar.world.tables import View
from warpsar.world.world import geometry_of

# ---- points on the ground with nothing of the scene above them


SAME_M = 1e-3  # surfaces closer than this are one


def free_ground(mesh: Mesh, east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """The height of the ground [m], shape (len(north), len(east)), at every point of a regular grid of places.

    NaN where there is no surface, or where another one lies above it: a body of the scene stands there.
    """
    lowest = np.full((north.size, east.size), np.inf)
    highest = np.full((north.size, east.size), -np.inf)
    corners = mesh.vertices[mesh.faces]
    low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
    first_col, last_col = np.searchsorted(east, low[:, 0]), np.searchsorted(east, high[:, 0], side="right")
    first_row, last_row = np.searchsorted(north, low[:, 1]), np.searchsorted(north, high[:, 1], side="right")
    for k in np.flatnonzero((last_col > first_col) & (last_row > first_row)):
        there = (slice(first_row[k], last_row[k]), slice(first_col[k], last_col[k]))
        height = _height(corners[k], east[there[1]], north[there[0]])
        np.fmin(lowest[there], height, out=lowest[there])
        np.fmax(highest[there], height, out=highest[there])
    alone = np.isfinite(lowest) & (highest < lowest + SAME_M)
    return np.where(alone, lowest, np.nan)


def covers(corners: np.ndarray, at: Sequence[float]) -> bool:
    """Whether one of the triangles, (n, 3, 3) [m], lies above or below a place, (east, north) [m]."""
    east, north = np.array([at[0]]), np.array([at[1]])
    low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
    near = np.flatnonzero(((low <= at) & (high >= at)).all(axis=1))
    return any(bool(np.isfinite(_height(corners[k], east, north)).all()) for k in near)


def _height(corners: np.ndarray, east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """The height of a triangle, (3, 3) [m], over each point of a grid; NaN beside it, and for one that is upright."""
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    if abs(normal[2]) <= 1e-9 * np.linalg.norm(normal):
        return np.full((north.size, east.size), np.nan)
    x, y = np.meshgrid(east, north)
    turn = [(q[0] - p[0]) * (y - p[1]) - (x - p[0]) * (q[1] - p[1]) for p, q in ((a, b), (b, c), (c, a))]
    sign = np.sign(normal[2])
    slack = 1e-9 * abs(normal[2])
    inside = np.all([sign * t >= -slack for t in turn], axis=0)
    height = a[2] - ((x - a[0]) * normal[0] + (y - a[1]) * normal[1]) / normal[2]
    return np.where(inside, height, np.nan)


WIDTHS_PX, HEIGHTS_PX = (1, 2, 4, 8, 16, 32), (1, 2, 4, 8, 16)
STEPS = 160  # of the grid of places along each side, at most
LEAST_RATIO = 1e-2
LARGEST_RATIO = 20.0  # of measured to modelled power: a single bright pixel is no wide body


@dataclass(frozen=True)
class Ratios:
    """Measured over modelled power of a view; 0 where `usable` is false. Both have shape (rows, cols)."""

    view: View
    ratio: np.ndarray
    usable: np.ndarray
    looks: float


@dataclass(frozen=True)
class BodyPlace:
    """A body's place on the ground [m], its width and height [m], the log-likelihood that all views but the best one
    gain (`score`), and what `share` that is of all that is unlike speckle in its pixels there."""

    position_m: tuple[float, float, float]
    width_m: float
    height_m: float
    score: float
    share: float


@dataclass(frozen=True)
class Looked:
    """What every image says of every place: `scores[k]`, shape (images, 2, places), are the log-likelihood and the
    excess of `_Sums.scores` for a body of `sizes_m[k]`, width and height. `points` have shape (places, 3) [m]."""

    scene: Scene
    views: tuple[str, ...]
    points: np.ndarray
    sizes_m: tuple[tuple[float, float], ...]
    scores: tuple[np.ndarray, ...]

    @classmethod
    def at(cls, scene: Scene, ratios: Sequence[Ratios]) -> Looked:
        points, finest = _points(scene), max(scene.grid.spacing_m)
        sizes = tuple(
            (width * finest, height * finest)
            for width, height in itertools.product(WIDTHS_PX, HEIGHTS_PX)
            if height <= 4 * width and not height == 1 < width  # a pixel's height is tried for a point alone
        )
        sums = [_Sums.of(one) for one in ratios] if len(points) else []
        scores = tuple(np.stack([one.scores(scene, points, *size) for one in sums]) for size in sizes if sums)
        return cls(scene, tuple(one.view.name for one in ratios), points, sizes, scores)

    def best(self, most: int, without: str = "") -> list[BodyPlace]:
        """The `most` best places that do not overlap, the best first; as if the view `without` were not there.

        A score is the sum over all views but the best one: no view alone makes a place.
        """
        used = [k for k, name in enumerate(self.views) if name != without]
        if not self.scores or not used:
            return []
        rest = [_all_but_the_best(each[used]) for each in self.scores]
        scores = np.stack([score for score, _ in rest])
        best, at = scores.max(axis=0), scores.argmax(axis=0)
        chosen: list[BodyPlace] = []
        for k in np.argsort(-best):
            if best[k] <= 0 or len(chosen) == most:
                break
            width_m, height_m = self.sizes_m[at[k]]
            east, north, up = (self.points[k] + self.scene.reference_point_m).tolist()
            if all(math.dist((east, north), one.position_m[:2]) > max(width_m, one.width_m) for one in chosen):
                share = float(best[k] / rest[at[k]][1][k])
                chosen.append(BodyPlace((east, north, up), width_m, height_m, float(best[k]), share))
        return chosen


def _all_but_the_best(both: np.ndarray) -> np.ndarray:
    """The sum over images, shape (2, places), of shape (images, 2, places), without that of the largest score."""
    rest = both.sum(axis=0) - np.take_along_axis(both, both[:, :1].argmax(axis=0)[None], axis=0)[0]
    return np.asarray(rest)


def _points(scene: Scene) -> np.ndarray:
    """Points of the free ground about the reference point, (n, 3) [m], as far as an image reaches."""
    origin = np.asarray(scene.reference_point_m)
    least_sine = min(math.sin(math.radians(view.incidence_deg)) for view in scene.views)
    halves = [n * step / 2.0 for n, step in zip(scene.grid.shape, scene.grid.spacing_m, strict=True)]
    reach = math.hypot(halves[0] / least_sine, halves[1])
    low = np.maximum(scene.mesh.vertices[:, :2].min(axis=0), origin[:2] - reach)
    high = np.minimum(scene.mesh.vertices[:, :2].max(axis=0), origin[:2] + reach)
    step = max(max(scene.grid.spacing_m), float((high - low).max()) / STEPS)
    east, north = (np.arange(a + step / 2.0, b, step) for a, b in zip(low, high, strict=True))
    ground = free_ground(scene.mesh, east, north)
    x, y = np.meshgrid(east, north)
    free = np.isfinite(ground)
    return np.stack([x[free], y[free], ground[free]], axis=1) - origin


@dataclass(frozen=True)
class _Sums:
    """Sums of ratios and of usable pixels over all rows and columns before each, shape (rows + 1, cols + 1)."""

    one: Ratios
    ratios: np.ndarray
    pixels: np.ndarray
    excess: np.ndarray

    @classmethod
    def of(cls, one: Ratios) -> _Sums:
        ratio = np.where(one.usable, np.minimum(one.ratio, LARGEST_RATIO), 0.0)
        sure = np.where(one.usable, np.maximum(ratio, LEAST_RATIO), 1.0)
        excess = one.looks * (sure - 1.0 - np.log(sure)) - 0.5 * expected_deviance(one.looks) * one.usable
        return cls(one, _summed(ratio), _summed(one.usable.astype(float)), _summed(excess))

    def scores(self, scene: Scene, points: np.ndarray, width_m: float, height_m: float) -> np.ndarray:
        """Log-likelihood that one factor on the layover and one on the shadow add, (n,); negative where the factor is
        on the wrong side of 1."""
        view = self.one.view
        d = geometry_of(scene, view).d
        away = np.array([d[0], d[1], 0.0]) / np.hypot(d[0], d[1])
        up, far = np.array([0.0, 0.0, height_m]), away * width_m / 2.0
        shadow = away * height_m * np.hypot(d[0], d[1]) / -d[2]
        roof_near, _ = pixel_of(scene, view, points - far + up)
        foot, _ = pixel_of(scene, view, points - far)
        roof_far, _ = pixel_of(scene, view, points + far + up)
        end, col = pixel_of(scene, view, points + far + shadow)
        half = width_m / 2.0 / scene.grid.spacing_m[1]
        columns = (col - half, col + half)
        bright = self._gain(roof_near, foot, columns, 1.0)
        return bright + self._gain(np.maximum(foot, roof_far), end, columns, -1.0)

    def _gain(
        self, first: np.ndarray, last: np.ndarray, columns: tuple[np.ndarray, np.ndarray], sign: float
    ) -> np.ndarray:
        (top, bottom), (left, right) = (
            _between(a, b, size) for (a, b), size in zip(((first, last), columns), self.one.ratio.shape, strict=True)
        )
        count = _box(self.pixels, top, bottom, left, right)
        with np.errstate(invalid="ignore", divide="ignore"):
            factor = np.maximum(_box(self.ratios, top, bottom, left, right) / count, 1e-6)
            gain = self.one.looks * count * (factor - 1.0 - np.log(factor))
        gain = np.where(count > 0, gain * np.sign(factor - 1.0) * sign, 0.0)
        return np.stack([gain, _box(self.excess, top, bottom, left, right)])


def _summed(image: np.ndarray) -> np.ndarray:
    return np.pad(image.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))


def _between(first: np.ndarray, last: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Whole pixels from `first` to `last`, at least one, inside the image."""
    begin = np.round(first).astype(np.int64)
    end = np.maximum(np.round(last).astype(np.int64), begin + 1)
    return np.clip(begin, 0, size), np.clip(end, 0, size)


def _box(sums: np.ndarray, top: np.ndarray, bottom: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    return np.asarray(sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left])
