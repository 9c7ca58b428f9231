"""Whether rows, columns or windows of pixels hold more or less power than speckle allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from warpsar.runtime import threads
from warpsar.speckle.compared import ComparedPixels
from warpsar.speckle.draws import Speckle
from warpsar.speckle.scan import POWER, Scan
from warpsar.speckle.tail import Tail

SHORTEST = 8  # pixels of a row or a column that is judged
DRAWS, BATCH = 200, 25


@dataclass(frozen=True)
class StrongestLine:
    """The strongest row, column or window of one residual: `z`, and the pixels `[first, end)` that it spans."""

    z: float
    observation: int
    kind: str  # "row", "column" or "window"
    rows: tuple[int, int]
    cols: tuple[int, int]


class Lines:
    """Sums over rows, over columns and over the windows of `Scan`, of pixels of several images."""

    def __init__(self, images: Sequence[ComparedPixels], autocovariance: np.ndarray) -> None:
        self.images = [image for image in images if image.interior.any()]
        self.numbers = [k for k, image in enumerate(images) if image.interior.any()]
        self.autocovariance = autocovariance
        middle = autocovariance.shape[0] // 2
        self._along = [float(a.sum()) for a in (autocovariance[middle], autocovariance[:, middle])]

    @property
    def pixels(self) -> int:
        return sum(int(image.interior.sum()) for image in self.images)

    def tail(self, seed: int, largest: float) -> Tail:
        """-ln p of the largest |z|, from draws of speckle at the images' looks, cut off at +-`largest`."""
        speckle, scan = Speckle(self.images, self.autocovariance), self._scan()

        def drawn(sequence: np.random.SeedSequence) -> np.ndarray:
            limit = np.float32(largest)
            parts = self._split(np.clip(speckle(np.random.default_rng(sequence), BATCH), -limit, limit))
            most = [scan.largest(parts)[POWER]]
            for image, part in zip(self.images, parts, strict=True):
                most += [np.abs(z).max(axis=0) for z in self._lines(image, part) if z.size]
            return np.asarray(np.max(most, axis=0))

        seeds = np.random.SeedSequence(seed).spawn(DRAWS // BATCH)
        return Tail.of(np.concatenate(list(threads.in_threads([partial(drawn, each) for each in seeds]))))

    def strongest(self, residuals: Sequence[np.ndarray]) -> StrongestLine:
        """The strongest of all; `residuals` are those of all images, an array (pixels,) each."""
        parts = [residuals[k] for k in self.numbers]
        spot = self._scan().strongest(parts)[0][POWER]
        rows, cols = (
            (at - size // 2, at + size // 2 + 1) for at, size in zip((spot.row, spot.col), spot.window, strict=True)
        )
        best = StrongestLine(spot.z, self.numbers[spot.observation], "window", rows, cols)
        for number, image, part in zip(self.numbers, self.images, parts, strict=True):
            for kind, axis, z in zip(("row", "column"), (1, 0), self._lines(image, part[:, None]), strict=True):
                at = int(np.argmax(np.abs(z[:, 0]))) if z.size else 0
                if z.size and abs(z[at, 0]) > abs(best.z):
                    across = np.flatnonzero(image.interior[at] if axis == 1 else image.interior[:, at])
                    extent = [(at, at + 1), (int(across[0]), int(across[-1]) + 1)]
                    best = StrongestLine(float(z[at, 0]), number, kind, *(extent if axis == 1 else extent[::-1]))
        return best

    def _scan(self) -> Scan:
        return Scan(self.images, self.autocovariance)

    def _split(self, drawn: np.ndarray) -> list[np.ndarray]:
        return np.split(drawn, np.cumsum([int(image.interior.sum()) for image in self.images])[:-1])

    def _lines(self, image: ComparedPixels, part: np.ndarray) -> list[np.ndarray]:
        """z of every row and of every column, shape (lines, draws); 0 where fewer than `SHORTEST` pixels are."""
        found: list[np.ndarray] = []
        for index, inflation in zip(np.nonzero(image.interior), self._along, strict=True):
            lines = image.interior.shape[len(found)]
            total = np.zeros((lines, part.shape[1]))
            order = np.argsort(index, kind="stable")
            met, first = np.unique(index[order], return_index=True)
            total[met] = np.add.reduceat(part[order], first, axis=0, dtype=float) if met.size else 0.0
            count = np.bincount(index, minlength=lines)[:, None]
            found.append(np.where(count >= SHORTEST, total / np.sqrt(np.maximum(count, 1) * inflation), 0.0))
        return found
