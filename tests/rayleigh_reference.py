"""A dielectric random surface to all orders of h, in NumPy: the reduced Rayleigh equations of a periodic surface.

They are those of perturbation_reference.py (Soubret, Berginc and Bourrely 2001), solved as one system of equations in
place of order by order. The surface repeats after `periods` wavelengths, so its waves are discrete. Like the series
they take the waves between the hills for waves that leave the surface (Rayleigh's hypothesis), so slopes must be
moderate. Units and conventions are those of perturbation_reference.py. Arrays of CuPy stay on their device.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from perturbation_reference import Perturbation, _meeting, _root

BLOCK = 64  # rows of the matrix that are made at once


class Period:
    """The waves of a period of `periods` wavelengths up to `finest` (in k), lit near `theta` from several azimuths.

    Waves lie half a step off the grid's middle, so that the vertical wave, which has no H and V, is none of them.
    """

    def __init__(self, periods: int, finest: float, eps: complex, theta: float, xp: Any = np) -> None:
        eps, self.periods = complex(eps.real, abs(eps.imag)), periods
        count = int(finest * periods) + 1
        grid = np.arange(-count, count)
        at = np.stack([one.ravel() for one in np.meshgrid(grid, grid, indexing="ij")], -1)
        at = at[np.hypot(*(at + 0.5).T) <= finest * periods]
        radius = np.hypot(*(at + 0.5).T) / periods
        nearest = np.abs(radius - math.sin(theta)).min()
        lit = (np.abs(radius - math.sin(theta)) < nearest + 1e-9) & (at[:, 0] >= 0)  # the others are their reverse
        self.sine = float(radius[lit][0])
        self.incident = np.flatnonzero(lit)
        self.back = np.array([np.flatnonzero((at == -1 - at[i]).all(-1))[0] for i in self.incident])
        waves = (at + 0.5) / periods
        self.first = np.stack(
            [Perturbation(eps, waves[i]).k1(waves[j]) for i, j in zip(self.incident, self.back, strict=True)]
        )
        self.at, p = xp.asarray(at), xp.asarray(waves)
        self.above, self.below = _root(1 - (p**2).sum(-1)), -_root(eps - (p**2).sum(-1))
        rows = (p[i : i + BLOCK, None] for i in range(0, len(p), BLOCK))
        self.scattered = np.concatenate([_meeting(row + 0 * p, p + 0 * row, eps, 1)[0] for row in rows])
        self.driven = [_meeting(p, 0 * p + p[int(i)], eps, -1)[0] for i in self.incident]

    def _shifted(self, transforms: list[Any], received: Any, sent: Any, vertical: Any) -> Any:
        """Transform of exp(i Q_z h) over a period, by the powers of h."""
        points = transforms[0].shape[0]
        where = tuple(((received - sent) % points)[..., axis] for axis in (0, 1))
        share, total = 1 + 0j, 0j
        for power, transform in enumerate(transforms):
            share = share * (1j * vertical / power) if power else share
            total = total + share * transform[where]
        return total

    def backscatter(self, height: Any, orders: int = 36) -> tuple[Any, Any]:
        """Amplitudes of backscatter, (azimuths, 2, 2): all orders, and the first alone. `height`: (n, n), over k."""
        count = len(self.at)
        transforms = [np.fft.fft2(height**power) / height.size for power in range(orders + 1)]
        phases = self._shifted(transforms, self.at[:, None], self.at[None], self.above[None, :] + self.below[:, None])
        matrix = (self.scattered * phases[..., None, None]).transpose(0, 2, 1, 3).reshape(2 * count, 2 * count)
        right = []
        for i, driven in zip(self.incident, self.driven, strict=True):
            phases = self._shifted(transforms, self.at, self.at[int(i)], self.below - self.above[int(i)])
            right.append(-(driven * phases[:, None, None]).reshape(2 * count, 2))
        solved = np.linalg.solve(matrix, np.concatenate(right, 1))
        solved = solved.reshape(count, 2, len(self.incident), 2)
        found, first = [], []
        for azimuth, (i, j) in enumerate(zip(self.incident, self.back, strict=True)):
            found.append(_host(solved[int(j), :, azimuth]))
            where = tuple(int(one) for one in (self.at[int(j)] - self.at[int(i)]) % height.shape[0])
            first.append(self.first[azimuth] * complex(transforms[1][where]))
        return np.stack(found), np.stack(first)


def _host(array: Any) -> np.ndarray:
    return np.asarray(array.get() if hasattr(array, "get") else array)


def surface(random: np.random.Generator, points: int, periods: int, kh: float, kl: float, cut: float) -> np.ndarray:
    """Heights of an exponential surface without its waves beyond `cut`, over k, (points, points)."""
    along = np.fft.fftfreq(points, 1 / points) / periods
    square = along[:, None] ** 2 + along[None] ** 2
    power = (kh * kl / periods) ** 2 / (2 * np.pi) * (1 + kl**2 * square) ** -1.5 * (square <= cut**2)
    noise = np.fft.fft2(random.normal(size=(points, points))) / points
    return np.fft.ifft2(noise * np.sqrt(power)).real * points**2


def powers(
    period: Period, kh: float, kl: float, cut: float, count: int, points: int = 128, seed: int = 0, xp: Any = np
) -> tuple[np.ndarray, np.ndarray]:
    """Backscattered powers of `count` surfaces, (count, azimuths, 2, 2): all orders, and the first.

    Each surface is taken upside down too: the odd orders of h in power then cancel, which only add noise.
    """
    random = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        height = xp.asarray(surface(random, points, period.periods, kh, kl, cut))
        (up, first), (down, _first) = (period.backscatter(way * height) for way in (1, -1))
        found.append((0.5 * np.abs(up) ** 2 + 0.5 * np.abs(down) ** 2, np.abs(first) ** 2))
    return tuple(np.stack(each) for each in zip(*found, strict=True))  # type: ignore[return-value]


def decibels(found: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """VV, HH and VV - HH over Bragg's [dB], and their standard errors (jackknife over surfaces), each (3,)."""

    def of(keep: np.ndarray) -> np.ndarray:
        hh, vv = (10 * np.log10(found[keep, :, i, i].mean() / first[keep, :, i, i].mean()) for i in (0, 1))
        return np.array([vv, hh, vv - hh])

    count = len(found)
    without = np.array([of(np.arange(count) != i) for i in range(count)])
    return of(np.ones(count, bool)), np.sqrt((count - 1) * without.var(axis=0))
