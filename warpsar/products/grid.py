"""Which azimuth time and slant range a line and a pixel have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.products.ground_range import GroundRange
from warpsar.world.frame import SPEED_OF_LIGHT

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class LineGrid:
    """Lines at equal steps of zero-Doppler time, pixels at equal steps of slant range or of ground range.

    Whole numbers are the centres of lines and pixels, from 0. Steps may be negative. With `burst_start_s` the lines of
    bursts lie one behind the other, `lines / len(burst_start_s)` of each: a place can be in two bursts.
    """

    lines: int
    pixels: int
    first_line_s: float
    line_s: float
    """Between lines."""
    near_range_m: float
    """Slant range of pixel 0."""
    range_step_m: float
    """Between pixels, in slant range; in ground range where `ground` is there."""
    ground: GroundRange | None = None
    burst_start_s: tuple[float, ...] = ()
    bulk_range_m: float | None = None
    """Where the processor took one range's travel time for all: a place is at zero Doppler (R - this) / c after its
    line's time. The satellite flies on while the echo comes back, and that depends on range (Gisinger et al. 2021)."""

    @property
    def middle_s(self) -> float:
        """Azimuth time of the middle."""
        if self.burst_start_s:
            per_burst = self.lines // len(self.burst_start_s)
            return 0.5 * (self.burst_start_s[0] + self.burst_start_s[-1] + per_burst * self.line_s)
        return self.first_line_s + 0.5 * (self.lines - 1) * self.line_s

    def line(self, time_s: ArrayLike, slant_m: ArrayLike) -> F64:
        """Of azimuth times [s] and slant ranges [m]; among bursts, in the one whose middle is nearest."""
        time = np.asarray(time_s, np.float64) - self._late_s(np.asarray(slant_m, np.float64))
        if not self.burst_start_s:
            return (time - self.first_line_s) / self.line_s
        starts, per_burst = np.array(self.burst_start_s), self.lines // len(self.burst_start_s)
        inside = (time[..., None] - starts) / self.line_s
        burst = np.abs(inside - 0.5 * (per_burst - 1)).argmin(axis=-1)
        return burst * per_burst + np.take_along_axis(inside, burst[..., None], axis=-1)[..., 0]

    def pixel(self, time_s: ArrayLike, slant_m: ArrayLike) -> F64:
        """Of slant ranges [m] at azimuth times [s]."""
        slant = np.asarray(slant_m, np.float64)
        if self.ground is None:
            return (slant - self.near_range_m) / self.range_step_m
        return self.ground.ground_m(np.asarray(time_s, np.float64) - self._late_s(slant), slant) / self.range_step_m

    def _late_s(self, slant_m: F64) -> F64:
        return np.zeros_like(slant_m) if self.bulk_range_m is None else (slant_m - self.bulk_range_m) / SPEED_OF_LIGHT

    def time_s(self, line: ArrayLike, pixel: ArrayLike) -> F64:
        """Zero-Doppler time [s] of lines and pixels."""
        return self._line_time_s(line) + self._late_s(self.slant_m(line, pixel))

    def _line_time_s(self, line: ArrayLike) -> F64:
        at = np.asarray(line, np.float64)
        if not self.burst_start_s:
            return self.first_line_s + at * self.line_s
        per_burst = self.lines // len(self.burst_start_s)
        burst = np.clip(np.floor((at + 0.5) / per_burst).astype(int), 0, len(self.burst_start_s) - 1)
        return np.array(self.burst_start_s)[burst] + (at - burst * per_burst) * self.line_s

    def slant_m(self, line: ArrayLike, pixel: ArrayLike) -> F64:
        """Slant range [m] of pixels."""
        at = np.asarray(pixel, np.float64)
        if self.ground is None:
            return self.near_range_m + at * self.range_step_m
        return self.ground.slant_m(self._line_time_s(line), at * self.range_step_m)

    def slant_step_m(self, line: float, pixel: float) -> float:
        """Slant range from a pixel to the next one [m]."""
        return float(self.slant_m(line, pixel + 0.5) - self.slant_m(line, pixel - 0.5))
