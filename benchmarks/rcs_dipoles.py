"""Solid dielectrics as a lattice of dipoles: a reference that knows nothing of rays.

The discrete dipole approximation (Purcell and Pennypacker, Astrophys. J. 186, 1973), with the polarizability of the
lattice dispersion relation (Draine and Goodman, Astrophys. J. 405, 1993, pp. 685-697), and products by Fourier
transforms (Goodman, Draine, Flatau, Opt. Lett. 16, 1991). The time factor within is e^{-j omega t}, so that a loss is a
positive imaginary part. `tests/coherent/test_dipoles.py` holds the ball to Mie's series.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fftn, ifftn
from scipy.sparse.linalg import LinearOperator, bicgstab

TOLERANCE = 1e-3
"""Of the residual of the fields: 0.01 dB."""
_B1, _B2, _B3 = -1.891531, 0.1648469, -1.7700004


class Lattice:
    """A body of cubes: `filled` (nx, ny, nz), their edge `step` [m], wavenumber `k` [1/m], eps_r with losses > 0."""

    def __init__(self, filled: NDArray[np.bool_], step: float, k: float, eps_r: complex) -> None:
        self.filled, self.step, self.k, self.eps_r = filled, step, k, eps_r
        place = np.stack(np.nonzero(filled), axis=1).astype(float)
        self.points = (place - place.mean(axis=0)) * step
        self.shape = tuple(2 * n for n in filled.shape)
        self.kernel = self._kernel()

    def _kernel(self) -> NDArray[np.complex64]:
        """Transforms of the six components of what a dipole sends to another, (6, 2 nx, 2 ny, 2 nz)."""
        axes = [np.minimum(np.arange(n), n - np.arange(n)) * np.where(np.arange(n) <= n // 2, 1, -1)
                for n in self.shape]  # fmt: skip
        way = np.stack(np.meshgrid(*axes, indexing="ij")).astype(float) * self.step
        r = np.sqrt((way**2).sum(axis=0))
        r[0, 0, 0] = 1.0
        unit, kr = way / r, self.k * r
        wave = np.exp(1j * kr) / r**3
        found = []
        for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
            both, one = unit[a] * unit[b], float(a == b)
            each = wave * (kr**2 * (one - both) + (1.0 - 1j * kr) * (3.0 * both - one))
            each[0, 0, 0] = 0.0
            found.append(fftn(each).astype(np.complex64))
        return np.stack(found)

    def _fields(self, dipoles: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """What the others send to each dipole, (n, 3)."""
        nx, ny, nz = self.filled.shape
        grid = np.zeros((3, *self.shape), np.complex64)
        grid[:, :nx, :ny, :nz][:, self.filled] = dipoles.T
        p = fftn(grid, axes=(1, 2, 3))
        xx, yy, zz, xy, xz, yz = self.kernel
        sums = np.stack([xx * p[0] + xy * p[1] + xz * p[2], xy * p[0] + yy * p[1] + yz * p[2],
                         xz * p[0] + yz * p[1] + zz * p[2]])  # fmt: skip
        return np.asarray(ifftn(sums, axes=(1, 2, 3))[:, :nx, :ny, :nz][:, self.filled].T, np.complex128)

    def rcs_m2(self, to_radar: NDArray[np.float64], polarization: NDArray[np.float64]) -> float:
        """Backscatter of one linear polarization; both are unit vectors (3,). Raises ArithmeticError if unsolved."""
        d, k = self.step, self.k
        still = 3.0 * d**3 / (4.0 * np.pi) * (self.eps_r - 1.0) / (self.eps_r + 2.0)
        spread = float(((to_radar * polarization) ** 2).sum())
        more = (_B1 + self.eps_r * _B2 + self.eps_r * _B3 * spread) * (k * d) ** 2 - 2j / 3.0 * (k * d) ** 3
        alpha = still / (1.0 + still / d**3 * more)
        wave = np.exp(-1j * k * self.points @ to_radar)
        sent = (alpha * wave[:, None] * polarization).ravel()

        def product(x: NDArray[np.complex128]) -> NDArray[np.complex128]:
            p = x.reshape(-1, 3)
            return (p - alpha * self._fields(p)).ravel()

        n = len(sent)
        operator = LinearOperator((n, n), matvec=product, dtype=np.complex128)
        found, failed = bicgstab(operator, sent, rtol=TOLERANCE, maxiter=300)
        if failed:
            raise ArithmeticError(f"{n // 3} dipoles: no solution after 300 steps")
        amplitude = k**2 * (found.reshape(-1, 3) @ polarization) @ wave
        return float(4.0 * np.pi * abs(amplitude) ** 2)
