"""Bodies of revolution of metal, solved by the method of moments: a reference that knows nothing of rays.

The electric field integral equation in azimuthal modes (Mautz and Harrington, AEU 32, 1978, pp. 157-164, and 33, 1979,
pp. 71-80). Currents along and around the body are T(t) / rho e^{j n phi}, T a triangle over two pieces of the outline.
`tests/coherent/test_revolved.py` holds the sphere to Mie's series.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import spherical_jn, spherical_yn

import warpsar

ETA = 376.730313668
_NEAR = 3
"""Pieces up to this far from one another are integrated with graded points."""


def pieces(corners: Sequence[tuple[float, float]], step: float) -> NDArray[np.float64]:
    """Points (rho, z) at most `step` apart along a polygon from axis to axis, (n, 2)."""
    points = [np.array(corners[0], float)]
    for a, b in zip(np.array(corners[:-1]), np.array(corners[1:]), strict=True):
        count = max(int(np.ceil(np.hypot(*(b - a)) / step)), 1)
        points += [a + (b - a) * i / count for i in range(1, count + 1)]
    return np.array(points)


def sphere(radius: float, count: int = 400) -> list[tuple[float, float]]:
    angle = np.linspace(0.0, np.pi, count + 1)
    rho = radius * np.sin(angle)
    rho[[0, -1]] = 0.0
    return list(zip(rho.tolist(), (radius * np.cos(angle)).tolist(), strict=True))


def spheroid(radius: float, half_length: float, count: int = 400) -> list[tuple[float, float]]:
    return [(rho * radius, z * half_length) for rho, z in sphere(1.0, count)]


def cylinder(radius: float, length: float) -> list[tuple[float, float]]:
    return [(0.0, length / 2), (radius, length / 2), (radius, -length / 2), (0.0, -length / 2)]


def cone(radius: float, length: float) -> list[tuple[float, float]]:
    return [(0.0, length), (radius, 0.0), (0.0, 0.0)]


def top_hat(radius: float, height: float, brim: float, thickness: float) -> list[tuple[float, float]]:
    """A cylinder on a disc."""
    return [(0.0, height), (radius, height), (radius, 0.0), (brim, 0.0), (brim, -thickness), (0.0, -thickness)]


def mesh(corners: Sequence[tuple[float, float]], around: int) -> warpsar.Mesh:
    """The closed body about the z axis; corners (rho, z) from its top to its bottom."""
    angle = 2.0 * np.pi * np.arange(around) / around
    rings = [[rho * np.cos(angle), rho * np.sin(angle), np.full(around, z)] for rho, z in corners[1:-1]]
    vertices = np.concatenate([[[0.0, 0.0, corners[0][1]]], *(np.stack(r, 1) for r in rings), [[0, 0, corners[-1][1]]]])
    i, last = np.arange(around), len(vertices) - 1
    j = (i + 1) % around
    faces = [np.stack([np.zeros_like(i), 1 + i, 1 + j], 1)]
    for ring in range(len(rings) - 1):
        a, b = 1 + ring * around, 1 + (ring + 1) * around
        faces += [np.stack([a + i, b + i, b + j], 1), np.stack([a + i, b + j, a + j], 1)]
    end = 1 + (len(rings) - 1) * around
    faces.append(np.stack([end + i, np.full_like(i, last), end + j], 1))
    return warpsar.Mesh.of(vertices, np.concatenate(faces))


def amplitudes(points: NDArray[np.float64], k: float, incidence_deg: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Backscattered A [m], (incidences, 2): V (theta-hat) and H (phi-hat), of the outline `points` (rho, z), (n, 2).

    Incidence counts from +z. The time factor is e^{+j omega t}.
    """
    theta = np.deg2rad(np.asarray(incidence_deg, float))
    modes = int(np.ceil(k * points[:, 0].max() * np.abs(np.sin(theta)).max() + 6.0))
    modes = 1 if np.abs(np.sin(theta)).max() < 1e-9 else modes
    matrices = _Matrices(points, k, modes)
    plus = [_waves(points, k, theta, n) for n in range(-modes, modes + 1)]
    found = np.zeros((len(theta), 2), np.complex128)
    for n in range(modes + 1):
        # mode -n has the same matrix but for the sign of what couples t and phi, and so the same share of each sum
        z = matrices.of(n)
        current = np.linalg.solve(z, plus[modes + n].reshape(len(z), -1)).reshape(plus[modes + n].shape)
        each = np.einsum("itp,itp->tp", plus[modes - n], current)
        found += each if n == 0 else 2.0 * each
    return np.asarray(-1j * k * ETA / (4.0 * np.pi) * found)


def mie(x: float) -> complex:
    """A / (a / 2) of the backscatter of a conducting ball of radius a, k a = x, phase at its middle."""
    n = np.arange(1, int(x + 4.0 * x ** (1 / 3) + 12))
    j, h = spherical_jn(n, x), spherical_jn(n, x) - 1j * spherical_yn(n, x)
    slope_j = x * spherical_jn(n - 1, x) - n * j
    slope_h = x * (spherical_jn(n - 1, x) - 1j * spherical_yn(n - 1, x)) - n * h
    return complex(-1j * np.sum((-1.0) ** n * (2 * n + 1) * (j / h - slope_j / slope_h)) / x)


def _gauss(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, w = np.polynomial.legendre.leggauss(count)
    return 0.5 * (x + 1.0), 0.5 * w


_FAR, _TEST, _SOURCE = _gauss(2), _gauss(3), _gauss(8)
_AROUND = _gauss(48)
_BLOCK = 20_000


class _Matrices:
    """Impedances of all modes, from integrals over pairs of pieces."""

    def __init__(self, points: NDArray[np.float64], k: float, modes: int) -> None:
        self.points, self.k, self.modes = points, k, modes
        n = len(points) - 1
        d = np.diff(points, axis=0)
        self.length = np.hypot(d[:, 0], d[:, 1])
        self.sine, self.cosine = d[:, 0] / self.length, d[:, 1] / self.length
        # G_n, n up to modes + 1, weighted by what the test and the source have: 1, the two half-triangles (1 - x, x)
        # and these over rho: (modes + 2, n, n, 5, 5)
        self.sums = np.zeros((modes + 2, n, n, 5, 5), np.complex128)
        i, j = np.nonzero(np.abs(np.subtract.outer(np.arange(n), np.arange(n))) > _NEAR)
        for at, weight in zip(*_FAR, strict=True):
            for place, share in zip(*_FAR, strict=True):
                for some in np.array_split(np.arange(len(i)), max(len(i) // _BLOCK, 1)):
                    self._add(i[some], j[some], at, place, weight * share)
        for off in range(-_NEAR, _NEAR + 1):
            i = np.arange(max(0, -off), n - max(0, off))
            for at, weight in zip(*_TEST, strict=True):
                # graded toward the test point, or toward the nearer end
                middle = at if off == 0 else (0.0 if off > 0 else 1.0)
                for u, share in zip(*_SOURCE, strict=True):
                    for end in (0.0, 1.0):
                        if end != middle:
                            grade = 3.0 * u**2 * abs(end - middle)
                            self._add(i, i + off, at, middle + (end - middle) * u**3, weight * share * grade)

    def _add(self, i: NDArray[np.intp], j: NDArray[np.intp], x: float, y: float, weight: float) -> None:
        """Points at x and y, 0 to 1, of the pieces i and j."""
        p = self.points[i] + (self.points[i + 1] - self.points[i]) * x
        q = self.points[j] + (self.points[j + 1] - self.points[j]) * y
        gap = np.maximum(np.hypot(p[:, 0] - q[:, 0], p[:, 1] - q[:, 1]), 1e-12)
        wide = np.sqrt(p[:, 0] * q[:, 0])
        delta = np.minimum(gap / wide, 3.0)
        top = np.arcsinh(np.pi / delta)
        u, v = _AROUND
        alpha = delta[:, None] * np.sinh(top[:, None] * u)  # more points where the two come near
        w = v * top[:, None] * delta[:, None] * np.cosh(top[:, None] * u) * 2.0  # both sides of alpha = 0
        r = np.sqrt(gap[:, None] ** 2 + (2.0 * wide[:, None] * np.sin(alpha / 2)) ** 2)
        g = w * np.exp(-1j * self.k * r) / (4.0 * np.pi * r)
        area = weight * self.length[i] * self.length[j] * 2.0 * np.pi
        ones = np.ones(len(i))
        test = np.stack([ones, ones * (1.0 - x), ones * x, (1.0 - x) / p[:, 0], x / p[:, 0]], -1)
        source = np.stack([ones, ones * (1.0 - y), ones * y, (1.0 - y) / q[:, 0], y / q[:, 0]], -1)
        pair = area[:, None, None] * test[:, :, None] * source[:, None, :]
        cosine = np.cos(alpha)
        now, before = np.ones_like(alpha), cosine  # cos(n alpha) by recurrence
        for n in range(self.modes + 2):
            self.sums[n, i, j] += np.einsum("ij,ij->i", g, now)[:, None, None] * pair
            now, before = 2.0 * cosine * now - before, now

    def of(self, n: int) -> NDArray[np.complex128]:
        """(2 m, 2 m) of m inner points: t, then phi."""
        k, m = self.k, len(self.length) - 1
        mu, eps = 1j * k * ETA, ETA / (1j * k)  # j omega mu, 1 / (j omega eps)
        zero, next_one, last = self.sums[n], self.sums[n + 1], self.sums[abs(n - 1)]
        even, odd = 0.5 * (last + next_one), 0.5 * (last - next_one)  # with cos(alpha), with sin(alpha)
        out = np.zeros((2, m, 2, m), np.complex128)
        for a in (1, 2):  # inner point i is the start of piece i + 1 (a = 1) and the end of piece i (a = 2)
            i = np.arange(m) + (2 - a)
            for b in (1, 2):
                j = np.arange(m) + (2 - b)
                at = np.ix_(i, j)
                left, right = (2 * a - 3) / self.length[i][:, None], (2 * b - 3) / self.length[j][None, :]
                si, sj, ci, cj = self.sine[i][:, None], self.sine[j], self.cosine[i][:, None], self.cosine[j]
                c, s, g = (each[at][..., a, b] for each in (even, odd, zero))
                out[0, :, 0] += mu * (si * sj * c + ci * cj * g) + eps * left * right * zero[at][..., 0, 0]
                out[0, :, 1] += -1j * mu * si * s + eps * 1j * n * left * zero[at][..., 0, b + 2]
                out[1, :, 0] += 1j * mu * sj * s - eps * 1j * n * right * zero[at][..., a + 2, 0]
                out[1, :, 1] += mu * c + eps * n**2 * zero[at][..., a + 2, b + 2]
        return out.reshape(2 * m, 2 * m)


def _waves(points: NDArray[np.float64], k: float, theta: NDArray[np.float64], n: int) -> NDArray[np.complex128]:
    """INT f* . p e^{jk s.r} of mode n, (2 m, angles, polarizations V, H)."""
    count = len(points) - 1
    d = np.diff(points, axis=0)
    length = np.hypot(d[:, 0], d[:, 1])
    sine, cosine = d[:, 0] / length, d[:, 1] / length
    around = max(64, int(8 * np.ceil((k * points[:, 0].max() * 2.0 + abs(n) + 8) / 8)))
    phi = 2.0 * np.pi * np.arange(around) / around
    out = np.zeros((2, count + 1, len(theta), 2), complex)
    for x, w in zip(*_TEST, strict=True):
        p = points[:-1] + d * x
        for t, angle in enumerate(theta):
            s = np.sin(angle)
            phase = np.exp(1j * k * (p[:, :1] * s * np.cos(phi) + p[:, 1:] * np.cos(angle)))
            wave = phase * np.exp(-1j * n * phi) * (2.0 * np.pi / around)
            c0, c1, s1 = wave.sum(1), (wave * np.cos(phi)).sum(1), (wave * np.sin(phi)).sum(1)
            # V: theta-hat = (cos, 0, -sin); H: phi-hat = (0, 1, 0); the radar in the plane y = 0
            along = np.stack([sine * np.cos(angle) * c1 - cosine * s * c0, sine * s1], -1)
            cross = np.stack([-np.cos(angle) * s1, c1], -1)
            for part, value in ((0, along), (1, cross)):
                value = value * (w * length)[:, None]
                out[part, :-1, t] += value * (1.0 - x)
                out[part, 1:, t] += value * x
    return np.concatenate([out[0, 1:-1], out[1, 1:-1]])
