"""Whether the power of rows, or of columns, is off the model.

A gain with a ripple, an antenna pattern or a smear changes every pixel of a row a little: no window by itself shows it.
So the residual is summed over bands of rows, and of columns, and the squares of the sums are compared with those of
draws of speckle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.special import chdtrc

from warpsar.compare.comparison import Comparison

BAND = 3  # rows, or columns, of a band
FEWEST = 30  # pixels of a band that counts
MOST = 700.0  # -ln p: beyond it exp is 0
AXES = ("range", "azimuth")
TOGETHER = "several images together"


@dataclass(frozen=True)
class AxisProfile:
    """How far power is off along one axis of an `image`, or of several together: `rms_db`, the root mean square over
    bands of `BAND` rows or columns, without what speckle makes of it [dB]. `surprise`: -ln of the chance of so much
    beyond what is granted, if bands were independent."""

    image: str
    axis: str
    rms_db: float
    surprise: float

    @property
    def words(self) -> str:
        return f"power is off by {self.rms_db:.2g} dB (rms) along {self.axis} in {self.image}"


class Profiles:
    """Sums over bands of the residuals of several images, given on their usable pixels. Pixels at edges do not count:
    the model may be wrong there by what outlines lie off. `inflation`: the residual's autocovariance, summed over lags.
    Images of one polarization are summed over views, too, unless they are `parts` of larger ones: two polarizations of
    a view may share their speckle."""

    def __init__(self, images: Sequence[Comparison], inflation: float, *, parts: bool = False) -> None:
        self.images, self.inflation = images, max(inflation, 1e-3)
        self._bands = [[_bands(image, axis) for axis in (0, 1)] for image in images]
        alike: dict[tuple[object, ...], list[int]] = {}
        for k, image in enumerate(images):
            alike.setdefault((image.start_m, image.simulated.shape, image.polarization), []).append(k)
        together = [] if parts else [group for group in alike.values() if len(group) > 1]
        self._groups = [[k] for k in range(len(images))] + together
        # of residuals of unit variance: relative power, times the root of the looks
        self._relative = [
            np.where(image.even, image.simulated / image.sd, 0.0)[image.usable].astype(float) for image in images
        ]

    def largest(self, residuals: Sequence[np.ndarray]) -> np.ndarray:
        """The largest surprise of each draw, shape (draws,); `residuals`: (pixels, draws) of each image."""
        found = np.zeros(residuals[0].shape[1])
        for group in self._groups:
            for axis in (0, 1):
                sums, counts = self._summed(group, axis, residuals)
                squares = (sums**2 / (np.maximum(counts, 1.0) * self.inflation)[:, None])[counts >= FEWEST]
                if len(squares):
                    found = np.maximum(found, _surprise(squares.sum(axis=0), len(squares)))
        return found

    def strongest(self, residuals: Sequence[np.ndarray], granted: float) -> AxisProfile:
        """The most surprising profile of one residual, an array (pixels,) of each image. `granted`: relative power that
        every band may be off by."""
        parts, free = [one[:, None] for one in residuals], [granted * one[:, None] for one in self._relative]
        best = AxisProfile(self.images[0].name, AXES[0], 0.0, 0.0)
        for group in self._groups:
            for axis in (0, 1):
                (sums, counts), (allowed, _) = (self._summed(group, axis, each) for each in (parts, free))
                use = counts >= FEWEST
                off, allowed, speckle = np.abs(sums[use, 0]), allowed[use, 0], counts[use] * self.inflation
                beyond = np.maximum(off - allowed, 0.0) ** 2 / np.maximum(speckle, 1e-30)
                surprise = float(_surprise(beyond.sum(), int(use.sum()))) if use.any() else 0.0
                if surprise > best.surprise:
                    share = (off**2 - speckle).sum() / max(float((allowed**2).sum()), 1e-30)
                    rms = granted * float(np.sqrt(max(share, 0.0)))
                    name = TOGETHER if len(group) > 1 else self.images[group[0]].name
                    best = AxisProfile(name, AXES[axis], 10.0 * float(np.log10(1.0 + rms)), surprise)
        return best

    def _summed(self, group: Sequence[int], axis: int, parts: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Sums, shape (bands, draws), and numbers of pixels, shape (bands,), of some images together."""
        sums = sum(self._bands[k][axis] @ parts[k] for k in group)
        counts = sum(self._bands[k][axis].sum(axis=1) for k in group)
        return np.asarray(sums), np.asarray(counts, float)


def _bands(image: Comparison, axis: int) -> csr_array:
    """1 where a usable pixel, column, is even and lies in a band, row."""
    at = np.nonzero(image.usable)[axis] // BAND
    even = image.even[image.usable]
    pixels = np.flatnonzero(even)
    shape = (-(-image.simulated.shape[axis] // BAND), even.size)
    return csr_array((np.ones(pixels.size, np.float32), (at[pixels], pixels)), shape=shape)


def _surprise(squares: np.ndarray, bands: int) -> np.ndarray:
    """-ln of the chance that so many standard normal squares have such a sum."""
    with np.errstate(divide="ignore"):  # of a chance of 0
        return np.minimum(-np.log(chdtrc(bands, squares)), MOST)
