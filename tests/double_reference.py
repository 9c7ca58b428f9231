"""Double scattering of the integral equation's models in backscatter, co-polarization too, in NumPy, float64.

Sources: Fung, Li and Chen 1992 (waves without phases of their own between the two places); Chen, Wu, Tsang, Li, Shi and
Fung 2003, and Yang, Chen, Tsang and Yu 2017, equations 11 to 14 and appendices A to C (each wave with its own). Lengths
are over k, and u and v are a wave's horizontal parts. tests/test_double.py holds the fields against those of
scattering_reference.py.
"""

from __future__ import annotations

import math

import numpy as np
from scattering_reference import fresnel, shadowed

Waves = list[tuple[np.ndarray, np.ndarray]]
LOSS = 1e-4  # of a grazing wave, as in kernels/i2em_crossed.py


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


def series(x: np.ndarray, kl: float, square: np.ndarray, lowest: bool) -> np.ndarray:
    """Sum of x^n / n! times the exponential spectrum of the n-th power at K^2 = `square`; `lowest`: its first term."""
    total, share = np.zeros(np.broadcast(x, square).shape, complex), 1 + 0j
    largest = float(np.abs(x).max())
    for n in range(1, 2 if lowest else int(largest + 8 * math.sqrt(largest) + 14)):
        share = share * x / n
        total += share * (kl / n) ** 2 * (1 + kl**2 * square / n**2) ** -1.5
    return total


def _disc(finest: float, rings: int, spokes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Waves up to `finest` and their weights, dense where they graze: v above 0 alone, which stands for both sides."""
    low, high = -math.asinh(1 / LOSS), math.asinh((finest**2 - 1) / LOSS)
    at = low + (np.arange(rings) + 0.5) * (high - low) / rings
    radius = np.sqrt(np.maximum(1 + LOSS * np.sinh(at), 0))
    weight = LOSS * np.cosh(at) * (high - low) / rings / 2
    angle = (np.arange(spokes) + 0.5) * math.pi / spokes
    u, v = np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))
    return u.ravel(), v.ravel(), np.repeat(weight * 2 * math.pi / spokes, spokes)


def double(
    polarization: str,
    theta: float,
    eps: complex,
    kh: float,
    kl: float,
    *,
    own_phases: bool = False,
    finest: float | None = None,
    rest: bool = False,
    lowest: bool = False,
    rings: int = 120,
    spokes: int = 32,
) -> tuple[float, float]:
    """sigma0 of double scattering off an exponential surface: Kirchhoff times complementary field, complementary alone.

    `own_phases`: as Chen et al. 2003, and else as Fung, Li and Chen 1992. `finest`: the finest wave, 1 (those that leave
    the surface: beyond, the powers of waves with phases of their own grow without bound) or 32. `rest`: the terms too
    in which the two places are no loop of two waves (kc 2 and 3, c 3 to 14 of 2017). `lowest`: to h^4 alone.
    """
    c, s = math.cos(theta), math.sin(theta)
    h2 = kh * kh
    r = fresnel(theta, eps)[polarization == "HH"]
    f = {"VV": 2 * r / c, "HH": -2 * r / c, "HV": 0j}[polarization]
    u, v, weight = _disc(finest or (1.0 if own_phases else 32.0), rings, spokes)
    near, far, bragg = (u + s) ** 2 + v * v, (u - s) ** 2 + v * v, 4 * s * s + 0 * u

    def fallen(exponent: np.ndarray) -> np.ndarray:
        return np.ones(1) if lowest else np.exp(-h2 * exponent)

    def loop(x: np.ndarray, one: np.ndarray, y: np.ndarray, other: np.ndarray) -> np.ndarray:
        return weight * series(h2 * x, kl, one, lowest) * series(h2 * y, kl, other, lowest)

    crossed = alone = 0j
    there = waves(polarization, theta, eps, u, v, own_phases=own_phases)
    back = waves(polarization, theta, eps, -u, -v, own_phases=own_phases)
    for field, q in there:
        drop = np.conj(f) * field * fallen(3 * c * c + q * q)
        crossed += (drop * loop((c + q) * 2 * c, near, (c - q) * 2 * c, far)).sum()
        if rest:
            meet = -(c - q) * (c + q)
            crossed += (drop * (loop((c + q) * 2 * c, bragg, meet, far) + loop((c - q) * 2 * c, bragg, meet, near))).sum()
        for (other, p), turned in [(one, False) for one in there] + [(one, True) for one in back]:
            k = -np.conj(p) if turned else np.conj(p)
            drop = field * np.conj(other) * fallen(2 * c * c + q * q + k * k)
            alone += (drop * loop((c - q) * (c - k), far, (c + q) * (c + k), near)).sum()
    if rest:
        alone += _rest(polarization, theta, eps, there, fallen, loop, (near, far, bragg), own_phases)
    once = shadowed(theta, kh, kl, "exponential", ways=1)
    return float(crossed.real) / (8 * math.pi) * once, float(alone.real) / (64 * math.pi) * once


def _rest(polarization, theta, eps, there, fallen, loop, squares, own_phases):  # type: ignore[no-untyped-def]
    """c 3 to 14: a wave of the loop with one of the two that single scattering has."""
    c, s = math.cos(theta), math.sin(theta)
    near, far, bragg = squares
    total = 0j
    for side in (1.0, -1.0):  # along the scattered wave, along the incident one
        at = np.array([side * s])
        for other, p in waves(polarization, theta, eps, at, 0 * at, own_phases=own_phases, loss=0.0):
            k = np.conj(p)
            step = c + side * k
            for field, q in there:
                drop = 2 * field * np.conj(other) * fallen(2 * c * c + q * q + k * k)
                meet = -(c - q) * (c + q)
                total += (drop * loop((c - q) * step, far, (c + q) * step, near)).sum()
                total += (drop * (loop((c - q) * step, bragg, meet, near) + loop((c + q) * step, bragg, meet, far))).sum()
    return total
