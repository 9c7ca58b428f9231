"""Bent ducts of rectangular cross-section by their exact modes, with Kirchhoff's integral at the mouth.

The duct is a prism between two flat side walls, and its bend is a problem in its plane, solved by the modes of each
straight or curved piece, matched where pieces meet, without an approximation.
The mouth takes of the plane wave, and sends back, what Kirchhoff's integral says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Complexes = NDArray[np.complex128]
Reals = NDArray[np.float64]


@dataclass(frozen=True)
class Piece:
    """A piece of a duct in the plane of its bend: straight, or an arc."""

    length: float
    """[m], or the angle of an arc [rad]."""
    radius_m: float = 0.0
    """Of an arc, at the lower wall; 0 for a straight piece."""
    down: bool = True
    """Whether the arc's centre lies under the lower wall, or over the upper one."""


@dataclass(frozen=True)
class Duct:
    """A bent duct of rectangular cross-section, shorted at its end. Its mouth lies in the plane x = 0 and faces +X."""

    width_m: float
    """Between the flat side walls."""
    height_m: float
    """In the plane of the bend."""
    pieces: tuple[Piece, ...]
    """From the mouth to the short."""


def transverse(duct: Duct, electric: bool, count: int) -> tuple[Reals, Reals, Reals]:
    """Places across the height (q,) [m], orthonormal functions there (count, q), and their slopes.

    `electric`: zero on both walls, as the field across the plane of the bend is. Else their slopes are.
    """
    h, q = duct.height_m, max(4000, 60 * count)
    z = (np.arange(q) + 0.5) / q * h
    kz = (np.arange(count) + electric)[:, None] * np.pi / h
    size = np.sqrt(np.where(kz == 0.0, 1.0, 2.0) / h)
    if electric:
        return z, size * np.sin(kz * z), size * kz * np.cos(kz * z)
    return z, size * np.cos(kz * z), -size * kz * np.sin(kz * z)


def reflection(duct: Duct, electric: bool, kt2: float, count: int) -> tuple[Complexes, Complexes]:
    """What the mouth gives back of each of its modes, (count, count), and their wavenumbers, (count,).

    a holds the field's coefficients, b those of its slope along the arc. Over the angle s a curved piece has
    da/ds = P b and db/ds = (K - kt2 P) a, with P and K the integrals of r f f and of r f' f' over the height (Felix and
    Pagneux, JASA 110(3), 2001). The eigenvectors are the piece's modes.
    """
    z, f, slope = transverse(duct, electric, count)
    dz, one = duct.height_m / len(z), np.eye(count)
    rho: Complexes = (-1.0 if electric else 1.0) * one.astype(complex)
    far = None
    for piece in reversed(duct.pieces):
        r = np.ones_like(z) if not piece.radius_m else piece.radius_m + (z if piece.down else -z)
        p, stiff = (f * r) @ f.T * dz, (slope * r) @ slope.T * dz
        root = np.linalg.cholesky(p)
        middle = root.T @ (stiff - kt2 * p) @ root
        value, vector = np.linalg.eigh(0.5 * (middle + middle.T))
        if not piece.radius_m:  # in the order of the functions, which the modes of a straight piece are
            value, vector, root = np.diag(stiff) - kt2, one, one
        x = root @ vector
        gamma = np.sqrt(value.astype(complex))
        slopes = np.linalg.solve(p, x) * gamma
        if far is not None:
            x_far, slopes_far = far
            y = slopes_far @ (one - rho) @ np.linalg.inv(one + rho) @ np.linalg.inv(x_far) @ x
            rho = np.linalg.solve(slopes + y, slopes - y)
        way = np.exp(-gamma * piece.length)
        rho = way[:, None] * rho * way
        far = x, slopes
    return rho, -1j * gamma


def in_bend(duct: Duct, phi: Reals, k: float, low_m: float) -> Complexes:
    """A [m] of the inside in the plane of the bend, E across it: the modes with m = 0. `low_m`: of the lower wall."""
    sine, cosine = np.sin(phi), np.cos(phi)
    count = int(k * duct.height_m / np.pi) + 12
    rho, beta = reflection(duct, True, k * k, count)
    some = np.flatnonzero(beta.real > 1e-9 * k)
    b = beta[some].real
    z, f, _ = transverse(duct, True, count)
    seen = np.exp(1j * k * sine[:, None] * (z + low_m)) @ f[some].T * (duct.height_m / len(z))
    into = 0.5 * (cosine[:, None] * k / b + 1.0) * seen
    out = into @ rho[np.ix_(some, some)].T
    found: Complexes = 1j * k / (4 * np.pi) * duct.width_m * ((b / k + cosine[:, None]) * out * seen).sum(axis=1)
    return found
