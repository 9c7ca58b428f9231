"""Double scattering of the integral equation's models in backscatter, co-polarization too, in NumPy, float64.

Sources: Fung, Li and Chen 1992 (waves without phases of their own between the two places); Chen, Wu, Tsang, Li, Shi and
Fung 2003, and Yang, Chen, Tsang and Yu 2017, equations 11 to 14 and appendices A to C (each wave with its own). Lengths
are over k, and u and v are a wave's horizontal parts. tests/models/test_double.py holds the fields against those of
scattering_reference.py.
"""

from __future__ import annotations

import math

import numpy as np
from scattering_reference import fresnel, shadowed

Waves = list[tuple[np.ndarray, np.ndarray]]
LOSS = 1e-4  # of a grazing wave, as in kernels/models/i2em.py


def _over(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a / b, and 0 where b is: a slope that is not defined is none."""
    safe = np.abs(b) > 1e-10
    return np.where(safe, a / np.where(safe, b, 1), 0)


def complementary(
    polarization: str,
    theta: float,
    eps: complex,
    u: np.ndarray,
    v: np.ndarray,
    q: np.ndarray,
    q_slopes: np.ndarray,
    *,
    below: bool,
) -> np.ndarray:
    """F (G below) of the wave (u, v) with the vertical part q; `q_slopes`: the same in the slopes of the surface."""
    c, s = math.cos(theta), math.sin(theta)
    r_v, r_h = fresnel(theta, eps)
    x, y = _over(s - u, c - q_slopes), _over(-v, c - q_slopes)
    x2, y2 = _over(s + u, c + q_slopes), _over(v, c + q_slopes)
    if polarization == "HV":
        r = (r_v - r_h) / 2
        terms = (
            c * x2 * y - s * y,
            s * (-c * q * y - q * s * x2 * y + q * s * x * y2 - c * u * x * y2 - c * v * y * y2)
            + c * (c * u * y + s * u * x2 * y + q * s * y2 - c * u * y2 + s * v * y * y2),
            c * (-s * v + c * v * x2 + q * s * y - c * q * x2 * y)
            + s * (-s * v * x + c * v * x * x2 + s * u * y - c * u * x2 * y),
            c * x * y2 - s * y2,
            v * (x2 - x),
            q * x * y2 - u * y2,
        )
    else:
        r = r_v if polarization == "VV" else r_h
        terms = (
            -1 - x * x2,
            -c * q - c * u * x - q * s * x2 - s * u * x * x2 - c * v * y2 - s * v * x * y2,
            s * u - q * s * x - c * u * x2 + c * q * x * x2,
            -c * (c + s * x2 + c * y * y2) - s * (c * x + s * x * x2 + s * y * y2),
            c * (q + u * x2 + v * y) + s * (q * x + u * x * x2 + v * x2 * y),
            c * (v * y2 - q * y * y2) + s * (v * x * y2 - u * y * y2),
        )
    p, m = 1 + r, 1 - r
    one, two, three, four, five, six = terms
    if polarization == "HV":
        if below:
            return p * (-p * one + m * two + p * three / eps) - m * (m * four * eps + p * five + m * six)
        return m * (p * one - m * two - p * three) + p * (m * four + p * five + m * six)
    if not below:
        sign = 1 if polarization == "VV" else -1
        return sign * (m * (-p * one + m * two + p * three) + p * (m * four + p * five + m * six))
    if polarization == "VV":
        return p * (p * one - m * two - p * three / eps) - m * (m * four * eps + p * five + m * six)
    return p * (-p * one * eps + m * two + p * three) + m * (m * four + p * five + m * six / eps)


def _decaying(square: np.ndarray) -> np.ndarray:
    root = np.sqrt(square + 0j)
    return np.where(root.imag > 0, -root, root)


def waves(
    polarization: str, theta: float, eps: complex, u: np.ndarray, v: np.ndarray, *, own_phases: bool, loss: float = LOSS
) -> Waves:
    """Fields over their vertical parts, and the vertical part in their phases: up and down, above and below."""
    square = u * u + v * v
    found: Waves = []
    for q, below in ((_decaying(1 - square - 1j * loss), False), (_decaying(eps - square), True)):
        for way in (way * q for way in (1, -1)):
            slopes = way if own_phases else 0 * q
            found.append((complementary(polarization, theta, eps, u, v, way, slopes, below=below) / q, slopes))
    return found if own_phases else [(sum(field for field, _ in found), 0 * square)]  # type: ignore[list-item]


def series(x: np.ndarray, kl: float, square: np.ndarray, *, lowest: bool = False) -> np.ndarray:
    """Sum of x^n / n! times the exponential spectrum of the n-th power at K^2 = `square`; `lowest`: its first term."""
    total, share = np.zeros(np.broadcast(x, square).shape, complex), 1 + 0j
    largest = float(np.abs(x).max())
    for n in range(1, 2 if lowest else int(largest + 8 * math.sqrt(largest) + 14)):
        share = share * x / n
        total += share * (kl / n) ** 2 * (1 + kl**2 * square / n**2) ** -1.5
    return total


class Disc:
    """Waves up to `finest`, dense where they graze, and what a surface makes of them. v > 0 stands for both sides."""

    def __init__(
        self, theta: float, kh: float, kl: float, finest: float, rings: int, spokes: int, lowest: bool
    ) -> None:
        self.theta, self.kh, self.kl, self.lowest = theta, kh, kl, lowest
        low, high = -math.asinh(1 / LOSS), math.asinh((finest**2 - 1) / LOSS)
        at = low + (np.arange(rings) + 0.5) * (high - low) / rings
        radius = np.sqrt(np.maximum(1 + LOSS * np.sinh(at), 0))
        angle = (np.arange(spokes) + 0.5) * math.pi / spokes
        self.u, self.v = (np.outer(radius, turn(angle)).ravel() for turn in (np.cos, np.sin))
        self.weight = np.repeat(LOSS * np.cosh(at) * (high - low) / rings * math.pi / spokes, spokes)
        s = math.sin(theta)
        self.near, self.far = ((self.u + side * s) ** 2 + self.v**2 for side in (1, -1))
        self.bragg = 4 * s * s + 0 * self.u

    def fallen(self, exponent: np.ndarray) -> np.ndarray:
        return np.ones(1) if self.lowest else np.exp(-(self.kh**2) * exponent)

    def pair(self, x: np.ndarray, one: np.ndarray, y: np.ndarray, other: np.ndarray) -> np.ndarray:
        """The spectra of two correlations whose phases are x and y, at K^2 = `one` and `other`."""
        h2 = self.kh**2
        first = series(h2 * x, self.kl, one, lowest=self.lowest)
        return self.weight * first * series(h2 * y, self.kl, other, lowest=self.lowest)

    def with_kirchhoff(self, q: np.ndarray, rest: bool) -> np.ndarray:
        """g of kc 1 and, with `rest`, of kc 2 and 3."""
        c = math.cos(self.theta)
        up, down, meet = (c - q) * 2 * c, (c + q) * 2 * c, -(c - q) * (c + q)
        total = self.pair(down, self.near, up, self.far)
        if rest:
            total = total + self.pair(down, self.bragg, meet, self.far) + self.pair(up, self.bragg, meet, self.near)
        return total * self.fallen(3 * c * c + q * q)

    def alone(self, q: np.ndarray, k: np.ndarray) -> np.ndarray:
        """g of c 1; of c 2 with k turned over."""
        c = math.cos(self.theta)
        found = self.pair((c - q) * (c - k), self.far, (c + q) * (c + k), self.near)
        return found * self.fallen(2 * c * c + q * q + k * k)

    def with_single(self, q: np.ndarray, k: np.ndarray, side: int) -> np.ndarray:
        """g of c 3 to 5 (side 1, the scattered wave) or of c 6 to 8 (side -1, the incident one)."""
        c = math.cos(self.theta)
        up, down, meet = (c - q) * (c + side * k), (c + q) * (c + side * k), -(c - q) * (c + q)
        total = self.pair(up, self.far, down, self.near)
        total = total + self.pair(up, self.bragg, meet, self.near) + self.pair(down, self.bragg, meet, self.far)
        return total * self.fallen(2 * c * c + q * q + k * k)


def double(
    polarization: str,
    theta: float,
    eps: complex,
    kh: float,
    kl: float,
    *,
    own_phases: bool = False,
    rest: bool = False,
    lowest: bool = False,
    rings: int = 120,
    spokes: int = 32,
) -> tuple[float, float]:
    """sigma0 of double scattering off an exponential surface: with the Kirchhoff field, and complementary alone.

    `own_phases`: as Chen et al. 2003, over waves that leave the surface (the powers of others grow without bound), and
    else as Fung, Li and Chen 1992. `rest`: the terms too that are no loop of two waves (kc 2 and 3, c 3 to 14 of 2017).
    `lowest`: to h^4 alone.
    """
    c, s = math.cos(theta), math.sin(theta)
    r_v, r_h = fresnel(theta, eps)
    f = {"VV": 2 * r_v / c, "HH": -2 * r_h / c, "HV": 0j}[polarization]
    disc = Disc(theta, kh, kl, 1.0 if own_phases else 32.0, rings, spokes, lowest)
    there = waves(polarization, theta, eps, disc.u, disc.v, own_phases=own_phases)
    back = waves(polarization, theta, eps, -disc.u, -disc.v, own_phases=own_phases)
    crossed = alone = 0j
    for field, q in there:
        crossed += (np.conj(f) * field * disc.with_kirchhoff(q, rest)).sum()
        alone += sum((field * np.conj(other) * disc.alone(q, np.conj(p))).sum() for other, p in there)
        alone += sum((field * np.conj(other) * disc.alone(q, -np.conj(p))).sum() for other, p in back)
        for side in (1, -1) if rest else ():
            at = np.array([side * s])
            for other, p in waves(polarization, theta, eps, at, 0 * at, own_phases=own_phases, loss=0.0):
                # twice: c 9 to 14 are their conjugates
                alone += 2 * (field * np.conj(other) * disc.with_single(q, np.conj(p), side)).sum()
    once = shadowed(theta, kh, kl, "exponential", ways=1)
    return float(crossed.real) / (8 * math.pi) * once, float(alone.real) / (64 * math.pi) * once
