"""A measured curve beside the terms of its model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from warpsar.curves.angles import blocks, weights


@dataclass(frozen=True, eq=False)
class ObservedCurve:
    """One curve, arrays of shape (n,). Amplitudes are sqrt(4 pi) A, so that their power is an RCS [m2]."""

    name: str
    frequency_hz: float
    polarization: str
    role: str
    azimuth_deg: NDArray[np.float64]
    incidence_deg: NDArray[np.float64]
    measured_m2: NDArray[np.float64]
    terms: Mapping[str, NDArray[np.complex128]]
    """Of the engine, under their names in `[radar] terms`; further ones may be offered under names of their own."""
    step_deg: float
    """lambda / 2D: how far independent directions lie apart."""
    background_m2: float | None = None
    """Mean power of the background, where it is stated; else it is fitted."""
    share: float | None = None
    """Variance of the relative error of the amplitude, where it is stated; else it is fitted."""
    level_m2: NDArray[np.float64] = field(default_factory=lambda: np.zeros(1))
    """Mean power of what is known by its level alone, without phase; (n,) or (1,)."""

    fitted_level_db: float | None = None
    """What `measured_m2` was raised by, where the file has no absolute level."""

    @cached_property
    def weight(self) -> NDArray[np.float64]:
        """Share of an independent direction that each row stands for."""
        return weights(self.azimuth_deg, self.step_deg)

    @cached_property
    def block(self) -> NDArray[np.int64]:
        """The independent stretch that each row lies in."""
        return blocks(self.azimuth_deg, self.step_deg)

    def amplitude(self, names: Sequence[str]) -> NDArray[np.complex128]:
        """The sum of some terms; 0 for those that the model does not have."""
        total = np.zeros(len(self.measured_m2), np.complex128)
        for name in names:
            if name in self.terms:
                total += self.terms[name]
        return total

    def beside(self, terms: Mapping[str, NDArray[np.complex128]]) -> ObservedCurve:
        """The same curve beside other terms, (n,) each."""
        return replace(self, terms=terms)

    def where(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> ObservedCurve:
        """The same with some rows alone: a mask, or their numbers."""
        level = self.level_m2[keep] if len(self.level_m2) > 1 else self.level_m2
        return replace(
            self,
            azimuth_deg=self.azimuth_deg[keep],
            incidence_deg=self.incidence_deg[keep],
            measured_m2=self.measured_m2[keep],
            terms={name: term[keep] for name, term in self.terms.items()},
            level_m2=level,
        )

    def thinned(self, most: float) -> ObservedCurve:
        """The same with at most about `most` rows for an independent direction, in the order of azimuth.

        Rows in between say nothing new: their weights grow with the distance of those that stay.
        """
        order = np.argsort(self.azimuth_deg, kind="stable")
        place = (self.azimuth_deg[order] - self.azimuth_deg.min()) * most / self.step_deg
        _, first = np.unique(np.floor(place + 1e-9), return_index=True)
        return self.where(order[first])


def independent(curves: Sequence[ObservedCurve]) -> float:
    """Number of independent directions in some curves."""
    return float(sum(one.weight.sum() for one in curves))
