"""Where a view was aimed: the shift at which a measured image and a prediction of it agree best.

A chip that was cut out about a target shows it some pixels off the middle, in each chip otherwise. So a prediction is
compared with it at the best shift within the `Reach` of the scene's `[effects.aim_point]`. The window that is compared
is the image less the reach on every side: no shift leads beyond the image. Images are linear power, (rows, cols), NaN
where nothing is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft2, rfft2
from scipy.ndimage import gaussian_filter, shift

from warpsar.errors import InputError
from warpsar.speckle.likelihood import best_gain, bounded, bounded_level, deviance, expected_deviance
from warpsar.world.world import World

EFFECT = "aim_point"
S = TypeVar("S", bound=World)
SMOOTHED_PX = 1.5
"""Standard deviation of the Gaussian that smooths power before its fourth root is correlated."""
EXPECTED = expected_deviance(1.0)
"""Mean gamma deviance of one look."""
BOUND = 20.0  # of a pixel's loss, where the gain is sought: one bright pixel does not set it
FAINTEST = 1e-3  # of a prediction's median: no pixel counts as darker
SAME_GAIN = 1e-5  # of a logarithm: views left out tell gains of a thousandth
LEAST = 1e-4  # of a measurement's median: the logarithm of 0 is none
ROOM_PX = 4  # about a window that is moved by a part of a pixel
CROSS = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
Shift = tuple[int, int]


@dataclass(frozen=True)
class Reach:
    """How many rows and columns a view may lie off."""

    rows: int
    cols: int

    @classmethod
    def of(cls, scene: World) -> Reach:
        """Of the scene's `[effects.aim_point]`; none without one. Raises InputError where the image is too small."""
        reach = reach_m(scene)
        rows, cols = (int(np.ceil(reach / step - 1e-9)) for step in scene.grid.spacing_m)
        if any(n - 2 * r < 8 for n, r in zip(scene.grid.shape, (rows, cols), strict=True)):
            raise InputError(
                f"{scene.name}: effects.aim_point.reach_m: found {reach:g} in an image of "
                f"{scene.grid.shape[0]} x {scene.grid.shape[1]} pixels; must leave 8 pixels to compare on every side"
            )
        return cls(rows, cols)

    def window(self, image: np.ndarray, moved: Shift = (0, 0), room: int = 0) -> np.ndarray:
        """What is compared of an image that is `moved` by (rows, columns), with `room` pixels on every side, for which
        the image's border is continued."""
        low = [r - s for r, s in zip((self.rows, self.cols), moved, strict=True)]
        sizes = [n - 2 * r for n, r in zip(image.shape, (self.rows, self.cols), strict=True)]
        wide = np.pad(image, room, mode="edge") if room else image
        (row, col), (rows, cols) = low, sizes
        return wide[row : row + rows + 2 * room, col : col + cols + 2 * room]

    def holds(self, at: Shift) -> bool:
        return abs(at[0]) <= self.rows and abs(at[1]) <= self.cols


def aimed(scene: World) -> bool:
    """Whether the scene says that its views may lie off."""
    return EFFECT in scene.effects


def without_aims(scene: S) -> S:
    """The scene whose views lie where they should."""
    return replace(scene, effects={name: table for name, table in scene.effects.items() if name != EFFECT})


def with_aims(scene: S, shifts: Mapping[str, Shift]) -> S:
    """The scene with these shifts [pixels] of views by name, beside those that it states."""
    table = dict(scene.effects[EFFECT])
    for axis, key in enumerate(("range_m", "azimuth_m")):
        step = scene.grid.spacing_m[axis]
        table[key] = {**table.get(key, {}), **{name: float(at[axis] * step) for name, at in shifts.items()}}
    return replace(scene, effects={**scene.effects, EFFECT: table})


def reach_m(scene: World) -> float:
    """How far views may lie off whose shift is not stated [m]; 0 where they lie where they should."""
    return float(scene.effects.get(EFFECT, {}).get("reach_m", 0.0))


def stated_aims(scene: World) -> set[str]:
    """Views whose aim point the scene states."""
    table = scene.effects.get(EFFECT, {})
    return {name for key in ("range_m", "azimuth_m") for name in table.get(key, {})}


def unaimed(scene: World) -> list[str]:
    """The warning that a command takes measured views to lie where they should, though the scene says that they may lie
    off; empty where it does not say so, or states all."""
    if not reach_m(scene):
        return []
    stated = stated_aims(scene)
    count = sum(bool(view.images) and view.name not in stated for view in scene.views)
    message = (
        f"effects.aim_point.reach_m: {count} measured views state no shift, and it is taken to be 0 here; `diagnose "
        "--folds` finds the shifts of train views, `evaluate` those of test views"
    )
    return [message] if count else []


def roots(power: np.ndarray, smoothed_px: float = SMOOTHED_PX) -> np.ndarray:
    """The fourth root of smoothed power; what is not used has the median."""
    filled = np.where(np.isfinite(power), power, np.nanmedian(power))
    return np.asarray(np.maximum(gaussian_filter(filled, smoothed_px), 0.0) ** 0.25)


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Pearson's, of two images of one shape; 0 where one of them is constant."""
    x, y = a.ravel() - a.mean(), b.ravel() - b.mean()
    norm = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / norm if norm > 0.0 else 0.0


def best_shift(measured: np.ndarray, predicted: np.ndarray, reach: Reach) -> tuple[float, Shift]:
    """The largest correlation of fourth roots over all shifts of the prediction, and its shift."""
    return MeasuredImage(measured, reach).best_shift(predicted)


def deviances(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Gamma deviance of one look of each used pixel, shape (n,), at the gain of least bounded loss."""
    use = np.isfinite(measured)
    power, mu = measured[use].astype(float), predicted[use].astype(float)
    power = np.maximum(power, LEAST * np.median(power))
    mu = np.maximum(mu, FAINTEST * np.median(mu))
    return deviance(power, best_gain("gamma", power, mu, 1.0, BOUND) * mu, 1.0)


def mean_deviance(measured: np.ndarray, predicted: np.ndarray) -> float:
    return float(deviances(measured, predicted).mean())


def own_shift(measured: np.ndarray, predicted: np.ndarray, reach: Reach) -> Shift:
    """The aim point that the likelihood chooses, by whole pixels: the least bounded gamma loss, from the shift of the
    best correlation on."""
    return MeasuredImage(measured, reach).own_shift(predicted)


class MeasuredImage:
    """A measured image beside predictions that may be shifted. What is of it alone is found once: a search asks for
    hundreds of predictions."""

    def __init__(self, measured: np.ndarray, reach: Reach) -> None:
        self._measured, self._reach = measured, reach

    @cached_property
    def _roots(self) -> tuple[np.ndarray, float, tuple[int, int]]:
        """Transform of the compared window's fourth roots about their mean, their sum of squares, and its shape."""
        own = self._reach.window(roots(self._measured))
        own = own - own.mean()
        return rfft2(own[::-1, ::-1], self._measured.shape), float((own**2).sum()), own.shape

    @cached_property
    def _power(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which pixels of the window are used, their power, and its logarithm."""
        power = self._reach.window(self._measured)
        use = np.isfinite(power)
        used = power[use].astype(float)
        used = np.maximum(used, LEAST * np.median(used))
        return use, used, np.log(used)

    def best_shift(self, predicted: np.ndarray) -> tuple[float, Shift]:
        """The largest correlation of fourth roots over all shifts of the prediction, and its shift."""
        transform, square, shape = self._roots
        wide = roots(predicted)
        wide = wide - wide.mean()  # the less there is to subtract below
        total, squares = (
            sliding_window_view(np.pad(one.cumsum(0).cumsum(1), ((1, 0), (1, 0))), [n + 1 for n in shape])
            for one in (wide, wide**2)
        )
        sums, powers = (w[..., -1, -1] - w[..., 0, -1] - w[..., -1, 0] + w[..., 0, 0] for w in (total, squares))
        spread = np.maximum(powers - sums**2 / np.prod(shape), 1e-12 * float((wide**2).sum()) + 1e-300)
        # where the window lies inside, nothing comes round from the other side
        valid = irfft2(transform * rfft2(wide), wide.shape)[shape[0] - 1 :, shape[1] - 1 :]
        found = valid / np.sqrt(spread * max(square, 1e-300))
        row, col = np.unravel_index(found.argmax(), found.shape)
        return float(found[row, col]), (self._reach.rows - int(row), self._reach.cols - int(col))

    def own_shift(self, predicted: np.ndarray) -> Shift:
        """The shift of least bounded loss that steps of one pixel lead to from the best correlation."""
        return self._least(predicted, lambda terms: float(bounded(terms, BOUND).mean()))[0]

    def deviance(self, predicted: np.ndarray) -> float:
        """Mean deviance at the model's best aim point, between the pixels: where parabolas through the best shift and
        its neighbours have their least value. By whole pixels a profile over a size would have steps, and its least
        value a bias."""
        at, score = self._least(predicted, lambda terms: 2.0 * float(terms.mean()))
        here, up, down, left, right = (score((at[0] + i, at[1] + j)) for i, j in CROSS)
        step = [
            (before - after) / (2.0 * (before + after - 2.0 * here))
            if np.isfinite(before + after) and before + after > 2.0 * here
            else 0.0
            for before, after in ((up, down), (left, right))
        ]
        if not any(step):
            return here
        wide = self._reach.window(predicted, at, ROOM_PX)
        between = shift(wide, np.clip(step, -0.5, 0.5), mode="nearest")[ROOM_PX:-ROOM_PX, ROOM_PX:-ROOM_PX]
        return min(here, mean_deviance(self._reach.window(self._measured), between))

    def _least(
        self, predicted: np.ndarray, loss: Callable[[np.ndarray], float]
    ) -> tuple[Shift, Callable[[Shift], float]]:
        """The shift of least loss that steps of one pixel lead to from the best correlation; and the loss at any shift,
        infinite beyond the reach. A loss is of half deviances, at the gain of least bounded loss."""
        use, power, logarithm = self._power
        inverse = 1.0 / np.maximum(predicted, FAINTEST * np.median(self._reach.window(predicted)))
        logarithms = np.log(inverse)
        gains: list[float] = []  # the next one is near the last one

        @cache
        def score(at: Shift) -> float:
            if not self._reach.holds(at):
                return np.inf
            ratio = power * self._reach.window(inverse, at)[use]
            own = logarithm + self._reach.window(logarithms, at)[use]
            start = gains[-1] if gains else float(np.median(own))
            gains.append(bounded_level(ratio, own, 1.0, BOUND, start, SAME_GAIN))
            return loss(ratio * np.exp(-gains[-1]) - (1.0 - gains[-1]) - own)

        at = self.best_shift(predicted)[1]
        while (better := min(((at[0] + i, at[1] + j) for i, j in CROSS), key=score)) != at:
            at = better
        return at, score
