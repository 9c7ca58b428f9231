"""Whether the power of rows, or of columns, is off the model.

A gain with a ripple, an antenna pattern or a smear changes every pixel of a row a little: no window by itself shows it.
So the residual is summed over single rows, over bands of three, over the two sides of every cut between rows, and in
step with waves; and likewise over columns. The sums are compared with those of draws of speckle. Single lines show
lines that were lost, bands a smear, the sides of a cut two parts of an image that were calibrated apart, and waves a
ripple that no line by itself shows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.special import chdtrc

from warpsar.compare.comparison import Comparison
from warpsar.runtime.matmul import times

BANDS = (1, 3)  # rows, or columns, of a band
SHORTEST = 6  # lines of a wave
PHASES = 4  # of each wave: the nearest loses 8 % of its size
FEWEST = 30  # pixels of a band, or of a side of a cut, that counts
MOST = 700.0  # -ln p: beyond it exp is 0
STEP = 2.0  # at a cut, over the mean of both sides
WAVE = 4.0 / (np.pi * np.sqrt(2.0))  # the root mean square of a wave, over its mean
AXES = ("range", "azimuth")
TOGETHER = "several images together"


@dataclass(frozen=True)
class AxisProfile:
    """How far power is off along one axis of an `image`, or of several together: `rms_db`, the root mean square over
    bands of rows or columns or of a wave, or the step at a cut, without what speckle makes of it [dB]. `surprise`: -ln
    of the chance of so much beyond what is granted, if sums were independent."""

    image: str
    axis: str
    rms_db: float
    surprise: float

    @property
    def words(self) -> str:
        return f"power is off by {self.rms_db:.2g} dB (rms) along {self.axis} in {self.image}"


@dataclass(frozen=True)
class _Sums:
    """Weighted sums of lines, that are asked together: `weights`, shape (sums, lines), and the `variance` that speckle
    gives them, shape (sums,). `strongest`: what the departure of the strongest sum is in units of its mean over the
    lines, if that sum counts; None where the squares of all do."""

    weights: np.ndarray
    variance: np.ndarray
    strongest: float | None

    def surprise(self, squares: np.ndarray) -> np.ndarray:
        """-ln of the chance of such squares over their variances, shape (sums, draws), by speckle; shape (draws,)."""
        count = len(squares)
        if self.strongest is not None:
            return np.maximum(_surprise(squares.max(axis=0), 1) - np.log(count), 0.0)
        return _surprise(squares.sum(axis=0), count)


class Profiles:
    """Sums over lines of the residuals of several images, given on their usable pixels. Pixels at edges do not count:
    the model may be wrong there by what outlines lie off. `autocovariance`: the residual's, shape (lags, lags), odd.
    Images of one polarization are summed over views, too, unless they are `parts` of larger ones: two polarizations of
    a view may share their speckle."""

    def __init__(self, images: Sequence[Comparison], autocovariance: np.ndarray, *, parts: bool = False) -> None:
        self.images = images
        self._lines = [[_lines(image, axis) for axis in (0, 1)] for image in images]
        alike: dict[tuple[object, ...], list[int]] = {}
        for k, image in enumerate(images):
            alike.setdefault((image.start_m, image.simulated.shape, image.polarization), []).append(k)
        together = [] if parts else [group for group in alike.values() if len(group) > 1]
        # of residuals of unit variance: relative power, times the root of the looks
        self._relative = [
            np.where(image.even, image.simulated / image.sd, 0.0)[image.usable].astype(float) for image in images
        ]
        self._asked = []
        for group in [*([k] for k in range(len(images))), *together]:
            for axis in (0, 1):
                counts = np.sum([self._lines[k][axis].sum(axis=1) for k in group], axis=0)
                self._asked.append((group, axis, _sums_of(counts, autocovariance.sum(axis=1 - axis))))

    def largest(self, residuals: Sequence[np.ndarray]) -> np.ndarray:
        """The largest surprise of each draw, shape (draws,); `residuals`: (pixels, draws) of each image."""
        found = np.zeros(residuals[0].shape[1])
        for _, sums, lines in self._each(residuals):
            found = np.maximum(found, sums.surprise(times(sums.weights, lines) ** 2 / sums.variance[:, None]))
        return found

    def strongest(self, residuals: Sequence[np.ndarray], granted: float) -> AxisProfile:
        """The most surprising profile of one residual, an array (pixels,) of each image. `granted`: relative power that
        every line may be off by."""
        both = [np.column_stack([one, granted * free]) for one, free in zip(residuals, self._relative, strict=True)]
        best = AxisProfile(self.images[0].name, AXES[0], 0.0, 0.0)
        for (group, axis), sums, lines in self._each(both):
            off, allowed = np.abs(sums.weights @ lines[:, 0]), np.abs(sums.weights) @ lines[:, 1]
            beyond = np.maximum(off - allowed, 0.0) ** 2 / sums.variance
            surprise = float(sums.surprise(beyond[:, None])[0])
            if surprise > best.surprise:
                counted = slice(None) if sums.strongest is None else [int(np.argmax(beyond))]
                square = (off**2 - sums.variance)[counted].sum() / max(float((allowed[counted] ** 2).sum()), 1e-30)
                rms = granted * (sums.strongest or 1.0) * float(np.sqrt(max(square, 0.0)))
                name = TOGETHER if len(group) > 1 else self.images[group[0]].name
                best = AxisProfile(name, AXES[axis], 10.0 * float(np.log10(1.0 + rms)), surprise)
        return best

    def _each(self, parts: Sequence[np.ndarray]) -> Iterator[tuple[tuple[list[int], int], _Sums, np.ndarray]]:
        """What is asked of which images along which axis, and the sums of their lines, shape (lines, draws)."""
        for group, axis, asked in self._asked:
            lines = sum(self._lines[k][axis] @ parts[k] for k in group) if asked else np.zeros(0)
            for sums in asked:
                yield (group, axis), sums, np.asarray(lines)


def _lines(image: Comparison, axis: int) -> csr_array:
    """1 where a usable pixel, column, is even and lies in a line, row."""
    at = np.nonzero(image.usable)[axis]
    even = image.even[image.usable]
    pixels = np.flatnonzero(even)
    shape = (image.simulated.shape[axis], even.size)
    return csr_array((np.ones(pixels.size, np.float32), (at[pixels], pixels)), shape=shape)


def _sums_of(counts: np.ndarray, lags: np.ndarray) -> list[_Sums]:
    """What is asked of lines with so many pixels: bands of each width, the sides of every cut, and waves. `lags`: the
    residual's autocovariance across lines, summed along them."""
    lines = np.arange(counts.size)
    away = np.abs(np.arange(lags.size) - lags.size // 2)
    found = []
    for width in BANDS:
        bands = (lines // width == np.arange(-(-lines.size // width))[:, None]).astype(float)
        pixels = bands @ counts
        inflation = max(float(lags @ np.maximum(1.0 - away / width, 0.0)), 1e-3)
        use = pixels >= FEWEST
        found.append(_Sums(bands[use], pixels[use] * inflation, strongest=None))
    below = np.cumsum(counts)[:-1]
    above = counts.sum() - below
    use = np.minimum(below, above) >= FEWEST
    below, above = below[use], above[use]
    whole = (below + above)[:, None]
    first = lines < lines[1:][use][:, None]
    sides = np.where(first, above[:, None] / whole, -below[:, None] / whole) * (counts > 0)
    inflation = max(float(lags.sum()), 1e-3)
    found.append(_Sums(sides, inflation * below * above / whole[:, 0], strongest=STEP))
    found.append(_waves(counts, lags))
    return [one for one in found if len(one.variance)]


def _waves(counts: np.ndarray, lags: np.ndarray) -> _Sums:
    """Sums in step with waves: from one that fills the lines that have pixels to the shortest, by halves of a wave."""
    there = np.flatnonzero(counts)
    lines = np.arange(counts.size)
    span = int(np.ptp(there)) + 1 if there.size else 0
    frequency = np.arange(2, 2 * span // SHORTEST + 1) / (2.0 * max(span, 1))
    phase = np.repeat(np.arange(PHASES) * np.pi / PHASES, frequency.size)
    angle = 2.0 * np.pi * np.tile(frequency, PHASES)
    weights = np.cos(angle[:, None] * lines + phase[:, None])
    weights = (weights - (weights @ counts / max(counts.sum(), 1))[:, None]) * (counts > 0)
    away = np.arange(lags.size) - lags.size // 2
    inflation = np.maximum(np.cos(angle[:, None] * away) @ lags, 1e-3)
    enough = np.full(angle.size, counts.sum() >= FEWEST * SHORTEST)
    return _Sums(weights[enough], (inflation * (weights**2 @ counts))[enough], strongest=WAVE)


def _surprise(squares: np.ndarray, bands: int) -> np.ndarray:
    """-ln of the chance that so many standard normal squares have such a sum."""
    with np.errstate(divide="ignore"):  # of a chance of 0
        return np.minimum(-np.log(chdtrc(bands, squares)), MOST)
