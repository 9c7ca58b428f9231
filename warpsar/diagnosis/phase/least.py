"""From which size on a phase error would be found: in the image as it is, by the search that was made.

An image may be blurred already by what the search does not tell, so an error is put on top of it, with both signs. Its
rows are drawn again, in blocks: this is how the same ground under another speckle would differ. A phase that is added
to an image moves the optimum of the contrast by as much, so what a search would gain follows from the one that was
made, and from the contrast under the added phase. The size that this gives is then tried: the error goes into the
image, the whole search is made again, and the size grows until it is found with either sign.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.diagnosis.phase.fit import POLYNOMIAL
from warpsar.diagnosis.phase.search import FoldedRows, SpeckleGains, moved, present
from warpsar.diagnosis.phase.spectrum import AzimuthSpectrum

F64 = NDArray[np.float64]
FOUND = 0.9
"""Share of draws in which an error of the size must be found."""
SIZES_RAD = 2.0 * np.pi * 0.8 ** np.arange(14)[::-1]
"""Of errors that are tried, at the aperture's ends, from the smallest."""
_DRAWS = 50
_SIGNS = (1.0, -1.0)


@dataclass(frozen=True)
class Injected:
    """An error of one column of the polynomial."""

    column: int
    across: bool = False
    """Whether it goes with the look direction, and the size is that at the ends of range."""

    def phase(self, lines: AzimuthSpectrum, size_rad: float) -> F64:
        """(frequencies,), or (rows, frequencies) [rad]."""
        one = POLYNOMIAL.phase(lines, size_rad * np.eye(POLYNOMIAL.columns)[self.column])
        return np.asarray(lines.aside[:, None] * one if self.across else one)


SQUARE, CUBIC, ACROSS = Injected(0), Injected(1), Injected(0, across=True)


def shows(rows: FoldedRows, speckle: SpeckleGains, kind: Injected, size_rad: float) -> float:
    """The share of draws and signs in which an error would gain more than speckle does, as said above."""
    drawn = _blocks_drawn(rows)
    families = [family for family in rows.families if family.aside or not kind.across]
    several = []
    for sign in _SIGNS:
        blurred = rows.under([kind.phase(lines, -sign * size_rad) for lines in rows.folds])
        exceeding = [speckle.beyond(drawn @ (rows.search(one).sharp - blurred), one) > 0.0 for one in families]
        several.append(np.any(exceeding, axis=0))
    return float(np.mean(several))


def least_found(rows: FoldedRows, speckle: SpeckleGains, kind: Injected) -> float | None:
    """The smallest size that is found [rad]; None where not even a turn is."""
    first = len(SIZES_RAD)
    while first > 0 and shows(rows, speckle, kind, SIZES_RAD[first - 1]) >= FOUND:
        first -= 1
    for size in SIZES_RAD[first:]:
        if all(_is_found(one, speckle, kind) for one in _with_error(rows, kind, size)):
            return float(size)
    return None


def _with_error(rows: FoldedRows, kind: Injected, size_rad: float) -> Iterator[FoldedRows]:
    for sign in _SIGNS:
        yield FoldedRows([lines.turned(kind.phase(lines, sign * size_rad)) for lines in rows.folds])


def _is_found(rows: FoldedRows, speckle: SpeckleGains, kind: Injected) -> bool:
    return present(rows, speckle).named and (not kind.across or moved(rows, speckle).named)


def _blocks_drawn(rows: FoldedRows) -> F64:
    """How often each row is there when blocks of neighbours are drawn again, (draws, rows)."""
    random, drawn = np.random.default_rng(7), []
    for lines in rows.folds:
        block = lines.row_blocks()
        blocks = int(block[-1]) + 1
        drawn.append(random.multinomial(blocks, np.full(blocks, 1.0 / blocks), _DRAWS)[:, block])
    return np.concatenate(drawn, axis=1).astype(np.float64)
