"""Is there a phase error over slow time in complex images? Decided on rows that had no part in finding it.

The rows lie in blocks of range, and every other block belongs to one fold. The phase that gives one fold the most
contrast is judged on the other, and the other way round. What is gained there is compared with two things:

- the same search on homogeneous speckle with the image's mean spectra, which no phase changes;
- a rival without physics, real weights on the spectrum, found and judged on the same rows: beside it the phase must
  still gain.

Then a phase of 2 pi at the aperture's ends is put into the sharpest image. If not even that shows, nothing can be told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from warpsar.diagnosis.phase.fit import MOTION, POLYNOMIAL, QUADRATIC, SPLINE, PhaseFamily, fitted, weights_fitted
from warpsar.diagnosis.phase.spectrum import AzimuthSpectrum, contrast, corrected

F64 = NDArray[np.float64]
Outcome = Literal["named", "absent", "not testable", "not told", "declared"]
BLOCKS = 8
GAP_CELLS = 2.0
"""Between blocks: rows so near share their points."""
DRAWS, MOTION_DRAWS = 12, 8
SURE = 4.0
"""Standard deviations of speckle's own gains that a gain must reach."""
PROBE_RAD = 2.0 * np.pi
FEWEST_ROWS = 16


@dataclass(frozen=True)
class PhaseFound:
    """What complex images of one view say of a phase error."""

    outcome: Outcome
    why: str
    family: str = "polynomial"
    coefficients: tuple[float, ...] = ()
    """Of the family's columns [rad]."""
    error: tuple[float, ...] = ()
    """Half of what the two folds differ [rad]."""
    gain: float = 0.0
    """Sum over the rows of what the contrast gains, each under the phase of the other fold."""
    gain_of_speckle: tuple[float, float] = (0.0, 0.0)
    """Mean and standard deviation of that in homogeneous speckle."""
    gain_of_weights: float = 0.0
    """Of the rival."""
    least_rad: float | None = None
    """The smallest quadratic error that would have shown."""


def folds_of(rows: int, spacing_m: float, cell_m: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Two masks of an image's rows, (rows,): every other block of range, without the rows at their borders."""
    place = np.arange(rows) * BLOCKS / rows
    block = place.astype(int)
    edge = np.minimum(place - block, block + 1 - place) * rows / BLOCKS * spacing_m
    inside = edge >= 0.5 * GAP_CELLS * cell_m
    return inside & (block % 2 == 0), inside & (block % 2 == 1)


def asked(folds: Sequence[AzimuthSpectrum], seed: int = 0) -> PhaseFound:
    """What two folds of rows say. The seed draws speckle."""
    if min(map(len, folds)) < FEWEST_ROWS:
        few = min(map(len, folds))
        return PhaseFound("not testable", f"{few} rows in one half of the image; at least {FEWEST_ROWS} are needed")
    found = _searched(folds, POLYNOMIAL)
    random = np.random.default_rng([seed, 5])
    draws = []
    for _ in range(DRAWS):
        drawn = [one.speckle(random) for one in folds]
        draws.append(_searched(drawn, POLYNOMIAL))
    speckle = _moments([one.gain for one in draws])
    weights = _gain_of_weights(folds, drawn)
    beside = found.gain + _gain_of_weights(found.sharpened(folds), drawn) - weights
    least = _least(found, draws, speckle[1])
    told = partial(PhaseFound, gain=found.gain, gain_of_speckle=speckle, gain_of_weights=weights, least_rad=least)
    beyond = found.gain - speckle[0] > SURE * speckle[1]
    if least is None:
        return told(
            "not testable",
            "an error of 2 pi at the ends of the aperture would not change the contrast by more than speckle does: "
            "there are no points and no edges that tell",
        )
    if not beyond:
        return told("absent", f"rows that decided nothing get no sharper; an error of {least:.2g} rad would have shown")
    if beside <= SURE * speckle[1]:
        return told("not told", "beside real weights on the spectrum a phase adds nothing to rows that decided nothing")
    simple, finer = _searched(folds, QUADRATIC), _searched(folds, SPLINE)
    best = simple if simple.gain >= found.gain - speckle[1] else found
    best = finer if finer.gain - best.gain > SURE * speckle[1] else best
    why = (
        f"rows that decided nothing get sharper by {best.gain:.3g}, speckle by {speckle[0]:.2g} +- {speckle[1]:.2g}, "
        f"under real weights by {weights:.3g}, and beside these the phase adds {beside:.3g}"
    )
    told = partial(told, family=best.family.name, coefficients=tuple(best.whole.tolist()))
    return told("named", why, error=tuple((0.5 * np.abs(best.each[0] - best.each[1])).tolist()), gain=best.gain)


@dataclass(frozen=True)
class _Search:
    """Both folds under one family."""

    family: PhaseFamily
    each: tuple[F64, F64]
    """Coefficients of each fold."""
    whole: F64
    """Of all rows."""
    gain: float
    lines: AzimuthSpectrum

    def sharpened(self, folds: Sequence[AzimuthSpectrum]) -> list[AzimuthSpectrum]:
        """Each fold with the phase of the other taken off."""
        pairs = zip(folds, reversed(self.each), strict=True)
        return [lines.turned(-self.family.phase(lines, found)) for lines, found in pairs]

    def loss(self, probe_rad: float) -> float:
        """What the contrast of all rows loses to a quadratic error beside what was found, the mean of both signs; with
        one that changes with range, to an error of that size at the ends of range."""
        square = QUADRATIC.basis(self.lines.place)[:, 0]
        if self.family.aside:
            square = self.lines.aside[:, None] * square
        phase = self.family.phase(self.lines, self.whole)
        best = corrected(self.lines, phase).sum()
        worse = [corrected(self.lines, phase + sign * probe_rad * square).sum() for sign in (-1.0, 1.0)]
        return float(best - 0.5 * np.sum(worse))


def _searched(folds: Sequence[AzimuthSpectrum], family: PhaseFamily) -> _Search:
    one, other = folds
    both = AzimuthSpectrum.joined(folds)
    each = fitted(one, family), fitted(other, family)
    gain = 0.0
    for lines, coefficients in ((one, each[1]), (other, each[0])):
        phase = family.phase(lines, coefficients)
        gain += float((corrected(lines, phase) - corrected(lines, np.zeros_like(phase))).sum())
    return _Search(family, each, fitted(both, family), gain, both)


@dataclass(frozen=True)
class MotionFound:
    """What complex images of one view say of an error of the track, whose phase changes with range."""

    outcome: Outcome
    why: str
    same: tuple[float, ...] = ()
    """Coefficients of the part that all ranges share, quadratic, cubic, quartic [rad]."""
    aside: tuple[float, ...] = ()
    """Of the part that goes with `AzimuthSpectrum.aside`, where that is 1 [rad]."""
    error: tuple[float, ...] = ()
    """Half of what the two folds differ, of both parts [rad]."""
    gain: float = 0.0
    """Of rows under what the other fold found, beyond that of a phase that all ranges share."""
    gain_of_speckle: tuple[float, float] = (0.0, 0.0)
    gain_of_shuffled: float = 0.0
    """Of the rival: the same numbers, and ranges in another order."""
    least_rad: float | None = None
    """The smallest quadratic error at the ends of range, none in their middle, that would have shown."""


def asked_of_motion(folds: Sequence[AzimuthSpectrum], seed: int = 0) -> MotionFound:
    """Whether the phase changes with range, as that of a track error does and that of `phase_error` does not.

    Judged as in `asked`. The rival has as many numbers, and the ranges of its rows in the order of another block.
    """
    if min(map(len, folds)) < FEWEST_ROWS or not any(one.aside.any() for one in folds):
        return MotionFound(
            "not testable",
            "look directions of the rows are not known, or the same; slant_range_m of the view says them",
        )
    flat, moved = _searched(folds, POLYNOMIAL), _searched(folds, MOTION)
    random = np.random.default_rng([seed, 6])
    draws, gains = [], []
    for _ in range(MOTION_DRAWS):
        drawn = [one.speckle(random) for one in folds]
        draws.append(_searched(drawn, MOTION))
        gains.append(draws[-1].gain - _searched(drawn, POLYNOMIAL).gain)
    speckle, gain = _moments(gains), moved.gain - flat.gain
    least = _least(moved, draws, speckle[1])
    told = partial(MotionFound, gain=gain, gain_of_speckle=speckle, least_rad=least)
    if least is None:
        return told("not testable", "an error of 2 pi at the ends of range would not show: no points and no edges tell")
    if gain - speckle[0] <= SURE * speckle[1]:
        return told("absent", f"no phase that changes with range; {least:.2g} rad at its ends would have shown")
    shuffled = [replace(one, aside=np.roll(one.aside, len(one) // 2)) for one in folds]
    rival = _searched(shuffled, MOTION).gain - flat.gain
    if gain - rival <= SURE * speckle[1]:
        return told("not told", "ranges in another order do as well as their own", gain_of_shuffled=rival)
    error = tuple((0.5 * np.abs(moved.each[0] - moved.each[1])).tolist())
    same, aside = np.split(moved.whole, 2)
    why = (
        f"with a part that goes with the look direction rows that decided nothing gain {gain:.3g} more, speckle "
        f"{speckle[0]:.2g} +- {speckle[1]:.2g}, and with ranges in another order {rival:.3g}"
    )
    return told("named", why, tuple(same.tolist()), tuple(aside.tolist()), error, gain_of_shuffled=rival)


def _gain_of_weights(folds: Sequence[AzimuthSpectrum], speckle: Sequence[AzimuthSpectrum]) -> float:
    """Of real weights that the other fold has found, less what they do to speckle."""
    weights = [weights_fitted(*pair) for pair in zip(folds, speckle, strict=True)]
    total = 0.0
    for lines, drawn, factor in zip(folds, speckle, reversed(weights), strict=True):
        for sign, one in ((1.0, lines), (-1.0, drawn)):
            total += sign * float((contrast(one, factor) - contrast(one, np.ones_like(factor))).sum())
    return total


def _moments(values: Sequence[float]) -> tuple[float, float]:
    return float(np.mean(values)), float(np.std(values, ddof=1))


def _least(found: _Search, draws: Sequence[_Search], gain_sd: float) -> float | None:
    """The smallest probe whose loss is beyond that of speckle; None where `PROBE_RAD` is not."""

    def beyond(probe_rad: float) -> float:
        mean, sd = _moments([one.loss(probe_rad) for one in draws])
        return found.loss(probe_rad) - mean - SURE * max(sd, gain_sd)

    if beyond(PROBE_RAD) <= 0.0:
        return None
    low = 0.05
    return low if beyond(low) > 0.0 else float(brentq(beyond, low, PROBE_RAD, xtol=0.02))
