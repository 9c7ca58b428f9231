"""What families of phases find on two folds of rows, what the same search finds on speckle, and what follows.

The decisions stand here, so that `ask.py` and the probes of `least.py` go by the same ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from warpsar.diagnosis.phase.fit import (
    MOTION,
    POLYNOMIAL,
    QUADRATIC,
    QUADRATIC_MOTION,
    PhaseFamily,
    fitted,
    trials,
    weights_fitted,
)
from warpsar.diagnosis.phase.spectrum import AzimuthSpectrum, contrast, corrected

F64 = NDArray[np.float64]
DRAWS = 12
SPECKLE_ROWS = 128
"""Of a fold of speckle that are searched, at most. No phase changes speckle's contrast but by chance, so sums over its
rows grow with the root of their number, and fewer rows tell those of all."""
SURE = 4.0
"""Standard deviations of speckle's own gains that a gain must reach."""
PROBE_RAD = 2.0 * np.pi
PAIRS = ((QUADRATIC_MOTION, QUADRATIC), (MOTION, POLYNOMIAL))
"""Families that change with range, and the same without."""


@dataclass(frozen=True)
class FamilySearch:
    """Both folds under one family."""

    family: PhaseFamily
    each: tuple[F64, F64]
    """Coefficients that each fold found."""
    sharp: F64
    """The contrast of each row under what the other fold found, one fold after the other, (rows,)."""
    gain: float
    """Of that over the rows as they are, their sum."""


class FoldedRows:
    """Two folds of rows, and what each family finds on them, worked out when it is asked for."""

    def __init__(self, folds: Sequence[AzimuthSpectrum]) -> None:
        self.folds = list(folds)
        self._found: dict[PhaseFamily, FamilySearch] = {}

    @cached_property
    def has_look_directions(self) -> bool:
        """Whether the rows' look directions are known, and differ."""
        return any(one.aside.any() for one in self.folds)

    @cached_property
    def families(self) -> tuple[PhaseFamily, ...]:
        """Those that can be asked: without look directions none that changes with range."""
        if self.has_look_directions:
            return QUADRATIC, QUADRATIC_MOTION, POLYNOMIAL, MOTION
        return QUADRATIC, POLYNOMIAL

    @cached_property
    def plain(self) -> F64:
        """The contrast of each row as it is, one fold after the other, (rows,)."""
        return self.under([np.zeros(len(lines.place)) for lines in self.folds])

    @cached_property
    def _trials(self) -> list[F64]:
        return [trials(lines) for lines in self.folds]

    def under(self, phases: Sequence[F64]) -> F64:
        """The contrast of each row with the phase of its fold taken off, one fold after the other, (rows,)."""
        return np.concatenate([corrected(*pair) for pair in zip(self.folds, phases, strict=True)])

    def search(self, family: PhaseFamily) -> FamilySearch:
        if family not in self._found:
            one, other = (fitted(*pair) for pair in zip(self.folds, (family,) * 2, self._trials, strict=True))
            sharp = self.under([family.phase(*pair) for pair in zip(self.folds, (other, one), strict=True)])
            self._found[family] = FamilySearch(family, (one, other), sharp, float((sharp - self.plain).sum()))
        return self._found[family]

    def loss(self, family: PhaseFamily) -> float:
        """What the contrast of all rows loses to a quadratic error beside what they themselves find, the mean of both
        signs."""
        lines = AzimuthSpectrum.joined(self.folds)
        phase = family.phase(lines, fitted(lines, family, np.concatenate(self._trials)))
        square = QUADRATIC.phase(lines, np.array([PROBE_RAD]))
        best, *worse = (float(corrected(lines, phase + sign * square).sum()) for sign in (0.0, 1.0, -1.0))
        return best - 0.5 * sum(worse)

    def sharpened(self, family: PhaseFamily) -> list[AzimuthSpectrum]:
        """Each fold with the phase of the other taken off."""
        pairs = zip(self.folds, reversed(self.search(family).each), strict=True)
        return [lines.turned(-family.phase(lines, found)) for lines, found in pairs]

    def bent(self) -> FoldedRows:
        """A rival: the same rows, and in place of the sine of a look direction its square, less what goes with the sine
        and with none. No track gives that."""
        aside = np.concatenate([one.aside for one in self.folds])
        line = np.polynomial.Polynomial.fit(aside, aside**2, 1)
        most = max(float(np.abs(aside**2 - line(aside)).max()), 1e-12)
        found = FoldedRows([replace(one, aside=(one.aside**2 - line(one.aside)) / most) for one in self.folds])
        found._trials = self._trials  # which know of no look direction
        return found


class SpeckleGains:
    """What the search gains on homogeneous speckle with the mean spectra of the rows."""

    def __init__(self, rows: FoldedRows, seed: int) -> None:
        self._rows, self._seed = rows, seed
        gains: dict[PhaseFamily, list[float]] = {family: [] for family in rows.families}
        for drawn in self._drawn():
            for family, several in gains.items():
                several.append(self._root * drawn.search(family).gain)
        self.gains = {family: np.array(several) for family, several in gains.items()}
        self.folds = next(self._folds_drawn())
        """Of one draw, all rows."""

    @cached_property
    def _root(self) -> float:
        """What sums over the rows that are searched are of those over all rows."""
        lengths = [len(one) for one in self._rows.folds]
        return float(np.sqrt(sum(lengths) / sum(min(one, SPECKLE_ROWS) for one in lengths)))

    def _folds_drawn(self) -> Iterator[list[AzimuthSpectrum]]:
        random = np.random.default_rng([self._seed, 5])
        for _ in range(DRAWS):
            yield [one.speckle(random) for one in self._rows.folds]

    def _drawn(self) -> Iterator[FoldedRows]:
        for folds in self._folds_drawn():
            yield FoldedRows([one.first(SPECKLE_ROWS) for one in folds])

    def tells(self, family: PhaseFamily) -> bool:
        """Whether the rows lose more contrast beside their best phase than speckle does beside its own: without points
        and edges both folds may agree by chance, and one phase is as good as the next."""
        losses = self._root * np.array([drawn.loss(family) for drawn in self._drawn()])
        return self._rows.loss(family) > float(losses.mean() + SURE * losses.std(ddof=1))

    def moments(self, family: PhaseFamily, less: PhaseFamily | None = None) -> tuple[float, float]:
        """Mean and standard deviation of what a family gains, beyond what another does."""
        differences = self.gains[family] if less is None else self.gains[family] - self.gains[less]
        return float(differences.mean()), float(differences.std(ddof=1))

    def beyond(self, gain: float | F64, family: PhaseFamily, less: PhaseFamily | None = None) -> F64:
        """How far a gain lies beyond what is sure not to be speckle's; negative where it does not."""
        mean, sd = self.moments(family, less)
        return np.asarray(gain - mean - SURE * sd)


@dataclass(frozen=True)
class Present:
    """Whether there is a phase error at all."""

    family: PhaseFamily
    """The first that says so; without one the last that gains more than speckle does, or that gains most."""
    named: bool
    sure: bool
    """Whether a family gains more than speckle does."""
    weights: float = 0.0
    """What the rival gains."""
    beside: float = 0.0
    """What the phase adds to that."""


def present(rows: FoldedRows, speckle: SpeckleGains) -> Present:
    """Families in turn: one must gain more than speckle does, and beside real weights."""
    weights: float | None = None
    last: Present | None = None
    for family in rows.families:
        gain = rows.search(family).gain
        if speckle.beyond(gain, family) <= 0.0:
            continue
        weights = _gain_of_weights(rows.folds, speckle.folds) if weights is None else weights
        beside = gain + _gain_of_weights(rows.sharpened(family), speckle.folds) - weights
        last = Present(family, beside > SURE * speckle.moments(family)[1], True, weights, beside)
        if last.named:
            return last
    if last is not None:
        return last
    return Present(max(rows.families, key=lambda family: rows.search(family).gain), False, False)


def _gain_of_weights(folds: Sequence[AzimuthSpectrum], speckle: Sequence[AzimuthSpectrum]) -> float:
    """Of real weights that the other fold has found, less what they do to speckle."""
    weights = [weights_fitted(*pair) for pair in zip(folds, speckle, strict=True)]
    total = 0.0
    for lines, drawn, factor in zip(folds, speckle, reversed(weights), strict=True):
        for sign, one in ((1.0, lines), (-1.0, drawn)):
            total += sign * float((contrast(one, factor) - contrast(one, np.ones_like(factor))).sum())
    return total


@dataclass(frozen=True)
class Moved:
    """Whether the phase changes with range."""

    family: PhaseFamily
    less: PhaseFamily
    named: bool
    gain: float
    """Beyond that of `less`."""
    rival: float = 0.0
    """The same of `FoldedRows.bent`."""


def moved(rows: FoldedRows, speckle: SpeckleGains) -> Moved:
    """Pairs of families in turn: the part that goes with range must gain more than it does in speckle, and than the
    rival's part does."""
    last: Moved | None = None
    for family, less in PAIRS:
        flat = rows.search(less).gain
        gain = rows.search(family).gain - flat
        if speckle.beyond(gain, family, less) <= 0.0:
            last = last or Moved(family, less, False, gain)
            continue
        rival = rows.bent().search(family).gain - flat
        last = Moved(family, less, gain - rival > SURE * speckle.moments(family, less)[1], gain, rival)
        if last.named:
            return last
    assert last is not None
    return last
