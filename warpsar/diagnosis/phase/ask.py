"""Is there a phase error over slow time in complex images? Decided on rows that had no part in finding it.

The rows lie in blocks of range, and every other block belongs to one fold. The phase that gives one fold the most
contrast is judged on the other, and the other way round. Four families are searched: a quadratic and a polynomial that
all ranges share, and the same two beside a part that goes with the look direction, as a track error has it. An error
that is a mix of both may lie under what the first two can tell, so all four decide whether there is one. What is gained
is compared with two things:

- the same search on homogeneous speckle with the image's mean spectra, which no phase changes;
- a rival without physics, real weights on the spectrum, found and judged on the same rows: beside it the phase must
  still gain.

Where nothing is named, `least.py` puts errors into the image as it is, and says from which size on they are found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from warpsar.diagnosis.phase.fit import (
    MOTION,
    POLYNOMIAL,
    QUADRATIC,
    QUADRATIC_MOTION,
    SPLINE,
    PhaseFamily,
    deviations,
    fitted,
)
from warpsar.diagnosis.phase.least import ACROSS, CUBIC, FOUND, SQUARE, least_found
from warpsar.diagnosis.phase.search import SURE, FoldedRows, Present, SpeckleGains, moved, present
from warpsar.diagnosis.phase.spectrum import AzimuthSpectrum

Outcome = Literal["named", "absent", "not testable", "not told", "declared"]
BLOCKS = 8
GAP_CELLS = 2.0
"""Between blocks: rows so near share their points."""
FEWEST_ROWS, MOST_ROWS = 16, 1024
"""In one fold, and in both. The middles of the blocks are looked at where an image has more: so they reach over all its
ranges, from whose ends an error of the track is told."""


@dataclass(frozen=True)
class PhaseFound:
    """What complex images of one view say of a phase error that all ranges share."""

    outcome: Outcome
    why: str
    family: str = "polynomial"
    coefficients: tuple[float, ...] = ()
    """Of the family's columns [rad]."""
    error: tuple[float, ...] = ()
    """Standard deviations, from how blocks of rows differ [rad]."""
    gain: float = 0.0
    """Sum over the rows of what the contrast gains, each under the phase of the other fold."""
    gain_of_speckle: tuple[float, float] = (0.0, 0.0)
    """Mean and standard deviation of that in homogeneous speckle."""
    gain_of_weights: float = 0.0
    """Of the rival."""
    least_rad: float | None = None
    """The smallest quadratic error that would have been found in the image as it is; None where one is named."""
    least_cubic_rad: float | None = None
    """The smallest cubic one; None where not even a turn would have been."""


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
    """Standard deviations of both parts [rad]."""
    gain: float = 0.0
    """Of rows under what the other fold found, beyond that of a phase that all ranges share."""
    gain_of_speckle: tuple[float, float] = (0.0, 0.0)
    gain_of_bent: float = 0.0
    """Of the rival: a part that goes with the square of the look direction."""
    least_rad: float | None = None
    """The smallest quadratic error at the ends of range, none in their middle, that would have been found in the image
    as it is; None where one is named, or not even a turn would have been found."""


class Asked(NamedTuple):
    """Both together, as one search decides them."""

    phase: PhaseFound
    motion: MotionFound


def folds_of(rows: int, spacing_m: float, cell_m: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Two masks of an image's rows, (rows,): every other block of range, without the rows at their borders, and with
    at most `MOST_ROWS` together."""
    place = np.arange(rows) * BLOCKS / rows
    block = place.astype(int)
    edge = np.minimum(place - block, block + 1 - place) * rows
    inside = edge >= max(0.5 * GAP_CELLS * cell_m / spacing_m * BLOCKS, 0.5 * (rows - MOST_ROWS))
    return inside & (block % 2 == 0), inside & (block % 2 == 1)


def asked(folds: Sequence[AzimuthSpectrum], seed: int = 0) -> Asked:
    """What two folds of rows say. The seed draws speckle."""
    if min(map(len, folds)) < FEWEST_ROWS:
        few = min(map(len, folds))
        return _both("not testable", f"{few} rows in one half of the image; at least {FEWEST_ROWS} are needed")
    rows = FoldedRows(folds)
    speckle = SpeckleGains(rows, seed)
    found = present(rows, speckle)
    if found.named and not speckle.tells(found.family):
        return _both("not testable", "beside the best phase contrast falls no more than that of speckle does")
    if found.named:
        return _named(rows, speckle, found)
    least = least_found(rows, speckle, SQUARE)
    if least is None:
        return _both(
            "not testable",
            "an error of 2 pi at the ends of the aperture, put into the image as it is, would not be found: there are "
            "no points and no edges that tell",
        )
    result = partial(
        PhaseFound,
        gain=rows.search(found.family).gain,
        gain_of_speckle=speckle.moments(found.family),
        gain_of_weights=found.weights,
        least_rad=least,
    )
    if found.sure:
        why = "beside real weights on the spectrum a phase adds nothing to rows that decided nothing"
        return Asked(result("not told", why), MotionFound("not told", why))
    cubic = least_found(rows, speckle, CUBIC)
    more = "" if cubic is None else f", a cubic one from {cubic:.2g} rad on"
    why = (
        f"rows that decided nothing get no sharper; in this image a quadratic error would be found from {least:.2g} "
        f"rad on{more} ({FOUND:.0%} of draws)"
    )
    return Asked(result("absent", why, least_cubic_rad=cubic), _not_moved(rows, speckle))


def _both(outcome: Outcome, why: str) -> Asked:
    return Asked(PhaseFound(outcome, why), MotionFound(outcome, why))


def _named(rows: FoldedRows, speckle: SpeckleGains, found: Present) -> Asked:
    """There is a phase error: does it change with range?"""
    motion = _motion(rows, speckle)
    result = partial(PhaseFound, gain_of_weights=found.weights)
    if motion.outcome == "named":
        why = "what all ranges share is stated with the error of the track, which gives it, too"
        return Asked(result("not told", why), motion)
    simple, more, finer = (rows.search(one) for one in (QUADRATIC, POLYNOMIAL, SPLINE))
    mean, sd = speckle.moments(POLYNOMIAL)
    best = simple if simple.gain >= more.gain - sd else more
    best = finer if finer.gain - best.gain > SURE * sd else best
    why = (
        f"rows that decided nothing get sharper by {best.gain:.3g}, speckle by {mean:.2g} +- {sd:.2g}, "
        f"under real weights by {found.weights:.3g}, and beside these the phase adds {found.beside:.3g}"
    )
    whole, error = _of_all_rows(rows, best.family)
    result = partial(result, family=best.family.name, coefficients=tuple(whole.tolist()), error=tuple(error.tolist()))
    return Asked(result("named", why, gain=best.gain, gain_of_speckle=(mean, sd)), motion)


def _motion(rows: FoldedRows, speckle: SpeckleGains) -> MotionFound:
    """Of an image that has a phase error."""
    if not rows.has_look_directions:
        return _not_moved(rows, speckle)
    found = moved(rows, speckle)
    mean, sd = speckle.moments(found.family, found.less)
    result = partial(MotionFound, gain=found.gain, gain_of_speckle=(mean, sd), gain_of_bent=found.rival)
    if not found.named:
        if found.rival:
            return result("not told", "a part that goes with the square of the look direction does as well")
        return replace(_not_moved(rows, speckle), gain=found.gain, gain_of_speckle=(mean, sd))
    simple, more = rows.search(QUADRATIC_MOTION), rows.search(MOTION)
    best = simple if simple.gain >= more.gain - speckle.moments(MOTION)[1] else more
    why = (
        f"with a part that goes with the look direction rows that decided nothing gain {found.gain:.3g} more, speckle "
        f"{mean:.2g} +- {sd:.2g}, and with one that goes with its square {found.rival:.3g}"
    )
    whole, error = _of_all_rows(rows, best.family)
    same, aside = (_filled(part) for part in np.split(whole, 2))
    return result("named", why, same, aside, sum((_filled(part) for part in np.split(error, 2)), ()))


def _not_moved(rows: FoldedRows, speckle: SpeckleGains) -> MotionFound:
    """With the size from which on an error of the track would be found."""
    if not rows.has_look_directions:
        return MotionFound(
            "not testable",
            "look directions of the rows are not known, or the same; slant_range_m of the view says them",
        )
    least = least_found(rows, speckle, ACROSS)
    if least is None:
        return MotionFound(
            "not testable", "an error of 2 pi at the ends of range, put into the image as it is, would not be found"
        )
    why = f"no phase that changes with range; in this image one would be found from {least:.2g} rad at its ends on"
    return MotionFound("absent", why, least_rad=least)


def _of_all_rows(rows: FoldedRows, family: PhaseFamily) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The coefficients, and their standard deviations."""
    joined = AzimuthSpectrum.joined(rows.folds)
    found = fitted(joined, family)
    return found, deviations(joined, family, found)


def _filled(part: NDArray[np.float64]) -> tuple[float, ...]:
    """Coefficients of a polynomial, 0 for those that its family has not."""
    return (*part.tolist(), *[0.0] * (POLYNOMIAL.columns - len(part)))
