"""TOPS bursts: how their spectrum drifts along azimuth, and samples without that drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.products.grid import LineGrid
from warpsar.products.orbit import Orbit
from warpsar.world.frame import SPEED_OF_LIGHT

F64 = NDArray[np.float64]
Polynomials = tuple[F64, F64, F64]
"""Azimuth times (n,) [s], origins in two-way range time (n,) [s], and coefficients of rising powers (n, k)."""


@dataclass(frozen=True)
class Tops:
    """Called with lines, pixels and samples: the samples times exp(-j phase), whose spectrum lies about zero.

    The antenna turns ahead during a burst, so that the Doppler centroid runs over several PRF. Interpolation by FFT
    needs it taken off first. Equations: Miranda, "Definition of the TOPS SLC deramping function for products generated
    by the S-1 IPF", COPE-GSEG-EOPG-TN-14-0025 (2014).
    """

    grid: LineGrid
    frequency_hz: float
    steering_rad_s: float
    speed_m_s: F64
    """Of the satellite, in the middle of each burst."""
    centroid: Polynomials
    rate: Polynomials

    @classmethod
    def of(
        cls,
        grid: LineGrid,
        orbit: Orbit,
        frequency_hz: float,
        steering_rad_s: float,
        centroid: Polynomials,
        rate: Polynomials,
    ) -> Tops:
        middles = np.array(grid.burst_start_s) + 0.5 * (grid.lines // len(grid.burst_start_s)) * grid.line_s
        speed = np.linalg.norm(orbit.at(middles)[1], axis=-1)
        return cls(grid, frequency_hz, steering_rad_s, speed, centroid, rate)

    def __call__(self, line: F64, pixel: F64, samples: NDArray[np.complex128]) -> NDArray[np.complex128]:
        return samples * np.exp(-1j * self.phase(line, pixel))

    def phase(self, line: F64, pixel: F64) -> F64:
        """[rad], (lines, pixels); the lines are taken to lie in the burst of the middle one."""
        starts = np.array(self.grid.burst_start_s)
        per_burst = self.grid.lines // starts.size
        burst = int(np.clip(line[line.size // 2] // per_burst, 0, starts.size - 1))
        middle = starts[burst] + 0.5 * (per_burst - 1) * self.grid.line_s
        range_s = 2.0 * self.grid.slant_m(0.0, pixel) / SPEED_OF_LIGHT
        centre_s = 2.0 * self.grid.slant_m(0.0, 0.5 * (self.grid.pixels - 1)) / SPEED_OF_LIGHT
        rate, centroid = _nearest(self.rate, middle, range_s), _nearest(self.centroid, middle, range_s)
        steered = 2.0 * self.speed_m_s[burst] / SPEED_OF_LIGHT * self.frequency_hz * self.steering_rad_s
        drift = rate * steered / (rate - steered)
        reference = -centroid / rate + (
            _nearest(self.centroid, middle, centre_s) / _nearest(self.rate, middle, centre_s)
        )
        late = (line - burst * per_burst - 0.5 * (per_burst - 1))[:, None] * self.grid.line_s - reference
        found: F64 = np.pi * drift * late**2 + 2.0 * np.pi * centroid * late
        return found


def _nearest(polynomials: Polynomials, time_s: float, range_s: F64) -> F64:
    times, origins, coefficients = polynomials
    i = int(np.abs(times - time_s).argmin())
    return np.asarray(np.polynomial.polynomial.polyval(range_s - origins[i], coefficients[i]))
