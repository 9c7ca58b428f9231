"""The shape of what is left in one image: a point, a patch, a streak, a broad change, or a period."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

SIDES = (1, 3, 5, 9, 17, 33)  # pixels on a side of the rectangles that are tried
FULL = 0.5  # share of a rectangle that must be judged pixels
LONG = 4  # times as long as wide: a streak
BROAD = 17  # pixels on both sides: not a patch any more
POINT = 3  # pixels on both sides, at most
SLOWEST = 2.0  # periods that must fit into the image
PERIODIC = 1e-3  # chance of any such peak by speckle
FAINT = 4.0  # times the power of speckle, that one frequency in fifty has by chance
CHIEF = 0.5  # of all power over speckle's, that lies about the peak of what is called periodic


@dataclass(frozen=True)
class ResidualShape:
    """`kind` in words. `rows`, `cols`: extent of the best rectangle [pixels], `range_m`, `azimuth_m` the same in
    metres; `row`, `col`: its middle; `z`: its sum over the standard deviation of speckle."""

    kind: str
    row: int
    col: int
    rows: int
    cols: int
    range_m: float
    azimuth_m: float
    z: float

    @property
    def rectangle(self) -> tuple[int, int, int, int]:
        """First and last row, first and last column, inside."""
        top, left = self.row - self.rows // 2, self.col - self.cols // 2
        return top, top + self.rows - 1, left, left + self.cols - 1


@dataclass(frozen=True)
class ResidualSpectrum:
    """The strongest frequency of a residual.

    `power`: over what speckle has there, shape (rows, cols), frequencies ascending along both axes, `per_m_range` and
    `per_m_azimuth` [1/m]. `peak_range`, `peak_azimuth` [1/m]: the strongest one, with `period_m`; `minus_log_p`: -ln of
    the chance that speckle has any as strong. `share`: of all power that
    stands out of speckle, what lies about the peak.
    """

    power: np.ndarray
    per_m_range: np.ndarray
    per_m_azimuth: np.ndarray
    peak_range: float
    peak_azimuth: float
    period_m: float
    minus_log_p: float
    share: float

    @property
    def periodic(self) -> bool:
        """A single line has all frequencies alike; what repeats has one above all."""
        return self.minus_log_p > -np.log(PERIODIC) and self.share > CHIEF


def shape_of(
    residual: np.ndarray, mask: np.ndarray, autocovariance: np.ndarray, spacing_m: Sequence[float]
) -> tuple[ResidualShape, ResidualSpectrum]:
    """`residual` in standard deviations, shape (rows, cols), where `mask` holds; at least one pixel does."""
    field = np.where(mask, residual, 0.0)
    best = _best_rectangle(field, mask, max(float(autocovariance.sum()), 1e-3))
    spectrum = spectrum_of(field, mask, autocovariance, spacing_m)
    z, row, col, high, wide = best
    if spectrum.periodic and spectrum.minus_log_p > z**2 / 2.0:
        kind = "periodic"
    elif high <= POINT and wide <= POINT:
        kind = "a point"
    elif wide >= LONG * high:
        kind = "a streak along azimuth"
    elif high >= LONG * wide:
        kind = "a streak along range"
    else:
        kind = "broad" if min(high, wide) >= BROAD else "a patch"
    return ResidualShape(kind, row, col, high, wide, high * spacing_m[0], wide * spacing_m[1], z), spectrum


def _best_rectangle(field: np.ndarray, mask: np.ndarray, inflation: float) -> tuple[float, int, int, int, int]:
    """(z, row, col, rows, cols) of the rectangle with the largest |z|; the smaller one of two alike."""
    best = (0.0, 0, 0, 1, 1)
    sides = [sorted({n, *(side for side in SIDES if side < n)}) for n in _extent(mask)]
    for high, wide in sorted(product(*sides), key=lambda both: both[0] * both[1]):
        total, count = (_boxes(plane, high, wide) for plane in (field, mask.astype(float)))
        # one pixel alone shares its speckle with no other
        spread = 1.0 if high * wide == 1 else inflation
        z = np.where(count >= FULL * high * wide, total / np.sqrt(np.maximum(count, 1.0) * spread), 0.0)
        at = np.unravel_index(int(np.argmax(np.abs(z))), z.shape)
        if abs(z[at]) > abs(best[0]):
            best = (float(z[at]), int(at[0]) + high // 2, int(at[1]) + wide // 2, high, wide)
    return best


def _extent(mask: np.ndarray) -> list[int]:
    """Rows and columns that the mask spans."""
    return [int(np.ptp(at)) + 1 for at in np.nonzero(mask)]


def _boxes(plane: np.ndarray, high: int, wide: int) -> np.ndarray:
    """Sums over all rectangles inside the image, by their upper left corner."""
    total = np.pad(plane, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    return np.asarray(total[high:, wide:] - total[:-high, wide:] - total[high:, :-wide] + total[:-high, :-wide])


def spectrum_of(
    field: np.ndarray, mask: np.ndarray, autocovariance: np.ndarray, spacing_m: Sequence[float]
) -> ResidualSpectrum:
    """The periodogram of the residual about its mean, over the spectrum of its speckle."""
    rows, cols = field.shape
    mean = field[mask].mean() if mask.any() else 0.0
    power = np.abs(np.fft.fft2(np.where(mask, field - mean, 0.0))) ** 2 / max(int(mask.sum()), 1)
    kernel = np.zeros((rows, cols))
    lags = autocovariance.shape[0] // 2
    reach = [min(lags, (n - 1) // 2) for n in (rows, cols)]
    steps = [np.arange(-r, r + 1) for r in reach]
    kernel[np.ix_(*steps)] = autocovariance[np.ix_(*(s + lags for s in steps))]
    expected = np.maximum(np.fft.fft2(kernel).real, 0.05 * autocovariance.max())
    power = np.fft.fftshift(power / expected)
    down, across = (np.fft.fftshift(np.fft.fftfreq(n, step)) for n, step in zip((rows, cols), spacing_m, strict=True))
    # slow changes are not called periodic: fewer than two periods would fit
    extent = [n * step for n, step in zip(_extent(mask), spacing_m, strict=True)]
    slow = np.hypot(down[:, None] * extent[0], across[None] * extent[1]) < SLOWEST
    # a frequency that is its own conjugate (0 or the highest along both axes) has one degree of freedom, not two
    single = [np.isclose(2.0 * at * step % 1.0, 0.0) for at, step in zip((down, across), spacing_m, strict=True)]
    tried = np.where(slow, 0.0, np.where(single[0][:, None] & single[1][None], 0.5, 1.0) * power)
    i, j = np.unravel_index(int(np.argmax(tried)), tried.shape)
    frequency = float(np.hypot(down[i], across[j]))
    independent = max(int(mask.sum()) // 2, 1)
    return ResidualSpectrum(
        power,
        down,
        across,
        abs(float(down[i])),
        float(across[j] * (np.sign(down[i]) or 1.0)),
        1.0 / frequency if frequency > 0 else float("inf"),
        float(tried[i, j] - np.log(independent)),
        _share_about(np.maximum(power - FAINT, 0.0), int(i), int(j)),
    )


def _share_about(excess: np.ndarray, row: int, col: int) -> float:
    """The share of a sum that lies within a bin of a frequency and of its conjugate."""
    rows, cols = excess.shape
    near = np.zeros(excess.shape, bool)
    # the image is real: the frequency of the opposite sign has the same power
    for i, j in ((row, col), (2 * (rows // 2) - row, 2 * (cols // 2) - col)):
        near[np.ix_(np.arange(i - 1, i + 2) % rows, np.arange(j - 1, j + 2) % cols)] = True
    return float(excess[near].sum() / max(float(excess.sum()), 1.0))
