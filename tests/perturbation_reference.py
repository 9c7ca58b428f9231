"""Small perturbation of a dielectric surface to the fourth order of h in power, in NumPy: the exact limit of small kh.

Method: the Rayleigh series with the transmitted field eliminated (Soubret, Berginc and Bourrely 2001, reduced Rayleigh
equations), solved order by order (Johnson 1999). In place of their printed matrices the reciprocity integral is taken
between each wave above the surface and a wave that runs down below it. Fields are exp(-i w t), k = 1. The
amplitude scattered from p0 to u is, with the heights' transform H,

    R(u) = R0 delta + K1 H(u - p0) + int K2 H(u - p) H(p - p0) + int int K3 H(u - p) H(p - q) H(q - p0)

Matrices are (2, 2): received by sent, H before V. tests/models/test_perturbation.py holds them against Fresnel, Bragg,
reciprocity and the phase of a surface that is moved up.
"""

from __future__ import annotations

import math

import numpy as np


def _root(square: np.ndarray) -> np.ndarray:
    """Vertical wave number of a wave that runs up, or decays upwards."""
    found = np.sqrt(square + 0j)
    return np.where(found.imag < 0, -found, found)


def _waves(p: np.ndarray, vertical: np.ndarray, k: complex) -> tuple[np.ndarray, np.ndarray]:
    """Electric fields of H and V, (..., 2, 3), and wave vectors, (..., 3), of waves with horizontal parts p."""
    length = np.maximum(np.hypot(p[..., 0], p[..., 1]), 1e-12)
    zero = np.zeros_like(length)
    h = np.stack([-p[..., 1] / length, p[..., 0] / length, zero], -1) + 0j
    k_wave = np.stack([p[..., 0] + 0j, p[..., 1] + 0j, vertical], -1)
    return np.stack([h, np.cross(h, k_wave) / k], -2), k_wave


def _meeting(u: np.ndarray, p: np.ndarray, eps: complex, up: int) -> tuple[np.ndarray, np.ndarray]:
    """Reciprocity integral of a wave p above (up: 1 or -1) and the wave -u that runs down below, and its Q_z."""
    above, k = _waves(p, up * _root(1 - (p**2).sum(-1)), 1.0)
    below, k_below = _waves(-u, -_root(eps - (u**2).sum(-1)), np.sqrt(eps + 0j))
    q = k + k_below
    magnetic, magnetic_below = np.cross(k[..., None, :], above), np.cross(k_below[..., None, :], below)
    crossed = np.cross(above[..., None, :, :], magnetic_below[..., :, None, :])
    crossed = crossed - np.cross(below[..., :, None, :], magnetic[..., None, :, :])
    vertical = q[..., 2][..., None, None]
    return (crossed * q[..., None, None, :]).sum(-1) / vertical, vertical


class Perturbation:
    """Kernels for the incident wave with the horizontal part p0, (2,); eps has a positive imaginary part."""

    def __init__(self, eps: complex, p0: np.ndarray) -> None:
        self.eps, self.p0 = eps, p0
        self.r0 = -np.linalg.solve(_meeting(p0, p0, eps, 1)[0], _meeting(p0, p0, eps, -1)[0])

    def _solved(self, u: np.ndarray, right: np.ndarray) -> np.ndarray:
        return -np.linalg.solve(_meeting(u, u, self.eps, 1)[0], right)

    def _driven(self, u: np.ndarray, order: int) -> np.ndarray:
        """Of the waves that a smooth surface has."""
        (up, q_up), (down, q_down) = (_meeting(u, self.p0, self.eps, way) for way in (1, -1))
        return ((1j * q_up) ** order * (up @ self.r0) + (1j * q_down) ** order * down) / math.factorial(order)

    def k1(self, u: np.ndarray) -> np.ndarray:
        return self._solved(u, self._driven(u, 1))

    def k2(self, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        met, q = _meeting(u, p, self.eps, 1)
        return self._solved(u, 1j * q * (met @ self.k1(p)) + self._driven(u, 2))

    def k3(self, u: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
        (met, at), (other, at_other) = _meeting(u, p, self.eps, 1), _meeting(u, q, self.eps, 1)
        right = 1j * at * (met @ self.k2(p, q)) - at_other**2 / 2 * (other @ self.k1(q))
        return self._solved(u, right + self._driven(u, 3))


def backscatter(
    theta: float, eps: complex, kh: float, kl: float, cut: float, rings: int = 160, spokes: int = 48
) -> tuple[np.ndarray, np.ndarray]:
    """sigma0 of an exponential surface to second and to fourth order in h, each (2, 2).

    Waves along the surface are taken up to `cut` (in k): what is finer than a wavelength over `cut` is smoothed away.
    """
    s, c = math.sin(theta), math.cos(theta)
    p0, u = np.array([s, 0.0]), np.array([-s, 0.0])
    kernels = Perturbation(complex(eps.real, abs(eps.imag)), p0)

    def w(k: np.ndarray) -> np.ndarray:
        return np.asarray((kh * kl) ** 2 / (2 * np.pi) * (1 + kl**2 * (k**2).sum(-1)) ** -1.5)

    # rings of equal steps in asinh(3 k)
    top = math.asinh(3 * cut)
    t = (np.arange(rings) + 0.5) / rings * top
    radius, weight = np.sinh(t) / 3, np.cosh(t) / 3 * np.sinh(t) / 3 * top / rings * 2 * np.pi / spokes
    angle = (np.arange(spokes) + 0.5) * 2 * np.pi / spokes
    k = np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))], -1).reshape(-1, 2)
    weight = np.repeat(weight, spokes)
    u_, p0_ = u + 0 * k, p0 + 0 * k
    third = kernels.k3(u_, p0_, p0 + k) + kernels.k3(u_, u - k, u_) + kernels.k3(u_, u - k, p0 - k)
    third = ((weight * w(k))[:, None, None] * third).sum(0)
    first = kernels.k1(u)
    second = np.zeros((2, 2))
    for centre, other in ((p0, u), (u, p0)):  # the spectra's two peaks
        p = centre + k
        near, far = ((p - centre) ** 2).sum(-1), ((p - other) ** 2).sum(-1)
        one, two = kernels.k2(u_, p), kernels.k2(u_, u + p0 - p)
        power = (one * np.conj(one) + one * np.conj(two)).real
        second += ((weight * far / (near + far) * w(u - p) * w(p - p0))[:, None, None] * power).sum(0)
    bragg = w(u - p0) * np.abs(first) ** 2
    scale = 4 * np.pi * c**2
    return scale * bragg, scale * (bragg + 2 * w(u - p0) * (np.conj(first) * third).real + second)
