"""How powers become greys, in every picture of this program: one curve, stated by four levels in dB.

A radar image spans more than a screen does. On a linear scale in dB either strong points are cut off, or ground and its
materials share a few dark greys. So most greys go to ground and what is somewhat brighter, and the last ones to the
rest, up to the strongest pixel.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from matplotlib.colors import ListedColormap, Normalize

GREYS = (0.0, 0.42, 0.8, 1.0)
"""Of the four levels: 0 is black, 1 white."""
DARKEST_DB, SHADOW_DB = 25.0, 12.0
"""Of black below ground at most, and at least: the speckle of a few looks does not reach it, so shadow stands apart."""
BRIGHT_DB, NARROWEST_DB = 25.0, 6.0
"""Of bright above ground at most, and at least."""
TAIL_DB = 3.0
"""White lies at least so far above bright."""
EDGES_DB = np.arange(-160.0, 100.25, 0.25)
_STEPS = 1024
"""Of a map of greys for matplotlib: no step is above a grey of 256 where a scale spans 100 dB."""
NOTHING = 1e-30
"""Linear beta0 that is shown as none."""
WITHOUT_MESH, WITHOUT_POWER = (0.75, 0.85, 1.0), (0.05, 0.12, 0.27)
"""Where there is no mesh: what white and what black become."""
UNMEASURED = "tab:blue"
"""Where an image has no number."""


@dataclass(frozen=True)
class GreyScale:
    """`levels_db`: black, ground (mid-grey), bright and white [dB], rising; greys are linear in dB between them."""

    levels_db: tuple[float, float, float, float]

    @classmethod
    def of_counts(cls, counts: NDArray[np.int64]) -> GreyScale:
        """Of pixels by their dB (`count`): ground is their median, white the strongest; black is the 2nd percentile and
        bright the 98th, within bounds. All in whole dB."""
        total = counts.sum()
        if not total:
            return cls((-SHADOW_DB, 0.0, NARROWEST_DB, NARROWEST_DB + TAIL_DB))
        share = np.cumsum(counts) / total

        def below(part: float) -> float:
            return float(EDGES_DB[np.searchsorted(share, part)])

        ground = float(np.round(below(0.5)))
        black = float(np.clip(np.floor(below(0.02)), ground - DARKEST_DB, ground - SHADOW_DB))
        bright = float(np.clip(np.ceil(below(0.98)), ground + NARROWEST_DB, ground + BRIGHT_DB))
        strongest = float(np.ceil(EDGES_DB[np.flatnonzero(counts)[-1] + 1]))
        return cls((black, ground, bright, max(strongest, bright + TAIL_DB)))

    @classmethod
    def of(cls, powers: Iterable[ArrayLike]) -> GreyScale:
        """Of images of linear power, any shapes."""
        return cls.of_counts(np.sum([count(power) for power in powers], axis=0, dtype=np.int64))

    def grey(self, decibel: ArrayLike) -> NDArray[np.float64]:
        """0 to 1, of the same shape; NaN stays NaN."""
        return np.asarray(np.interp(np.asarray(decibel, float), self.levels_db, GREYS))

    def along(self, steps: int) -> NDArray[np.float64]:
        """Greys from black to white at even steps in dB: those of a bar, along which dB are read off as on a ruler."""
        return self.grey(np.linspace(self.levels_db[0], self.levels_db[-1], steps))

    def norm(self) -> Normalize:
        """For matplotlib, beside `colours`: linear in dB from black to white."""
        from matplotlib.colors import Normalize

        return Normalize(self.levels_db[0], self.levels_db[-1])

    def colours(self) -> ListedColormap:
        """Greys along `norm`."""
        from matplotlib.colors import ListedColormap

        return ListedColormap(self.along(_STEPS)[:, None] * np.ones(3))


def tinted(colours: NDArray[np.float64], covered: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Greys as colours, 0 to 1, (rows, cols, 3), dark blue where no surface lies, lit or hidden: not `covered`."""
    white, black = np.array(WITHOUT_MESH), np.array(WITHOUT_POWER)
    return np.where(covered[..., None], colours, black + colours * (white - black))


def count(power: ArrayLike) -> NDArray[np.int64]:
    """How many pixels of linear power have which dB: counts that add up over pictures and over processes."""
    values = np.asarray(power)
    positive = values[np.isfinite(values) & (values > NOTHING)]
    return np.histogram(10.0 * np.log10(positive.astype(float)), EDGES_DB)[0].astype(np.int64)


def in_decibel(power: ArrayLike) -> NDArray[np.float64]:
    """dB of linear power, far below every scale where there is none; NaN stays NaN."""
    return np.asarray(10.0 * np.log10(np.maximum(np.asarray(power, float), NOTHING)))
