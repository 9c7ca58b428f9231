"""What a model puts into dark pixels, and what is measured there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter

from warpsar.compare.observation import TRACE, Observation
from warpsar.diagnosis.scores.evidence import LARGEST
from warpsar.learning.problem import FitProblem
from warpsar.speckle.law import Law

NOTHING = 0.01
EXPLAINED = 10.0  # times the modelled power: speckle and a response known to some dB scatter by less
LEAST = 1e-6
"""Of a trace: what is measured below is 0. The far tail of a smear leaves as much, and so does rounding."""
UNSURE = 0.1  # of the modelled power, by which two sets of rays may differ where a pixel is judged


@dataclass(frozen=True)
class DarkPixels:
    """Pixels of one image that are far from everything lit: arrays of shape (rows, cols).

    `modelled`: beta0 with its gain. `interior`: the dark pixels that are judged, zeros among them. `allowed` [beta0]: a
    trace of the lit pixels' median. Less than this is not called power: sidelobes and quantisation leave as much.
    """

    seen: Observation
    modelled: np.ndarray
    interior: np.ndarray
    allowed: float

    @classmethod
    def of(cls, seen: Observation, modelled: np.ndarray) -> DarkPixels:
        """All dark pixels of an image; `modelled` is beta0 with its gain, shape (rows, cols)."""
        lit = seen.interior & ~seen.dark
        allowed = TRACE * float(np.median(modelled[lit])) if lit.any() else 0.0
        return cls(seen, modelled, seen.dark, allowed)

    @property
    def looks(self) -> float:
        return self.seen.looks

    @property
    def law(self) -> Law:
        return self.seen.law

    @cached_property
    def measured(self) -> np.ndarray:
        """Measured beta0, 0 where there is none."""
        return np.nan_to_num(self.seen.measured).astype(float)

    @property
    def empty(self) -> np.ndarray:
        """Judged pixels where the model puts nothing: less than `NOTHING` of a trace."""
        return self.interior & (self.modelled <= NOTHING * self.allowed)

    @property
    def measures_power(self) -> np.ndarray:
        """Empty pixels that measure more than 0, whatever it is: all of them do under a floor."""
        return self.empty & (self.measured > LEAST * self.allowed)

    @property
    def unexplained(self) -> np.ndarray:
        """Those of them that measure far more than the little that the model puts there, such as its sidelobes."""
        return self.measures_power & (self.measured > EXPLAINED * self.modelled)

    @property
    def powered(self) -> np.ndarray:
        """Judged pixels where the model puts a trace or more."""
        return self.interior & (self.modelled >= self.allowed)

    @property
    def residual(self) -> np.ndarray:
        """sqrt(L) (I - mu) / max(mu, `allowed`) within +-`LARGEST` of the judged pixels, shape (n,).

        Its variance under speckle is 1 at most. Where the model has less than `allowed`, it is judged as a floor of
        that level would be.
        """
        mu = self.modelled[self.interior]
        found = np.sqrt(self.looks) * (self.measured[self.interior] - mu) / np.maximum(mu, self.allowed)
        return np.clip(found, -LARGEST, LARGEST)


def dark_pixels(problem: FitProblem, x: np.ndarray, other: FitProblem | None = None) -> list[DarkPixels]:
    """The dark pixels of every observation under the problem's model at `x`.

    `other` is the same model on other rays. Pixels are left out where the two differ, with their neighbours: few rays
    find the paths that end there, and their noise is no power.
    """
    images = _images(problem, x)
    others = images if other is None else _images(other, x)
    found = []
    for seen, image, second in zip(problem.observations, images, others, strict=True):
        one = DarkPixels.of(seen, image)
        apart = np.abs(image - second) > UNSURE * np.maximum(image, one.allowed)
        found.append(replace(one, interior=one.interior & ~maximum_filter(apart, 3)))
    return found


def _images(problem: FitProblem, x: np.ndarray) -> list[np.ndarray]:
    gains = problem.gains(problem.modelled(x))
    pairs = [(view, seen) for view in problem.views for seen in view.observations]
    return [
        gain * view.render.images[seen.polarization].numpy().reshape(seen.interior.shape).astype(float)
        for (view, seen), gain in zip(pairs, gains, strict=True)
    ]


def impossible(pixels: Sequence[DarkPixels]) -> dict[str, np.ndarray]:
    """By view name, beta0 measured where the model puts nothing, shape (rows, cols): 0 where it is as little, NaN where
    the model has power or the pixel is not judged. Of several polarizations, their mean."""
    found: dict[str, list[np.ndarray]] = {}
    for one in pixels:
        power = np.where(one.unexplained & (one.measured > NOTHING * one.allowed), one.measured, 0.0)
        found.setdefault(one.seen.view.name, []).append(np.where(one.empty, power, np.nan))
    return {name: np.mean(planes, axis=0) for name, planes in found.items()}
