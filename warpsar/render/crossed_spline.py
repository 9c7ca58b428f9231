"""Coefficients of the spline from which HV of `i2em` is read where a surface varies (kernels/crossed_spline.py)."""

from __future__ import annotations

import threading
from functools import lru_cache

import numpy as np
import warp as wp

from warpsar.kernels import crossed_spline as kernels
from warpsar.kernels.models.i2em import RINGS

MOST_ROWS = 32
"""Of a table, 4.3 MB each: with more there is none, and every hit has the integral"""
_NODES = kernels.COSINES, kernels.HEIGHTS, kernels.LENGTHS, kernels.CONTRASTS
_making = threading.Lock()  # views are recorded side by side: the first makes the table, and the others wait


def table(surfaces: tuple[tuple[int, float], ...], device: wp.Device) -> wp.array:
    """The coefficients of each (spectrum, eps_im), one row after the other, float.

    They depend on nothing else. So they are made once for all views and fits of a process.
    """
    with _making:
        return _table(surfaces, device.alias)


@lru_cache(maxsize=4)
def _table(surfaces: tuple[tuple[int, float], ...], device: str) -> wp.array:
    rows = np.stack([_coefficients(*surface, device) for surface in surfaces])
    return wp.array(rows.ravel(), dtype=float, device=device)


def _coefficients(spectrum: int, eps_im: float, device: str) -> np.ndarray:
    """Of one spectrum and eps_im, float32 (COSINES + 2, HEIGHTS + 2, LENGTHS + 2, ROW)."""
    power = _launched(kernels.power_kernel, (kernels.COSINES, kernels.CONTRASTS, RINGS), [eps_im], device)
    found = _launched(kernels.lattice_kernel, _NODES, [power, _series(spectrum, device)], device).numpy()
    for axis in range(4):
        found = np.moveaxis(spline(np.moveaxis(found, axis, 0)), 0, axis)
    padded = np.zeros((*found.shape[:3], kernels.ROW), np.float32)
    padded[..., : found.shape[3]] = found
    return padded


@lru_cache(maxsize=4)
def _series(spectrum: int, device: str) -> wp.array:
    return _launched(kernels.series_kernel, (*_NODES[:3], RINGS), [spectrum], device)


def _launched(kernel: wp.Kernel, shape: tuple[int, ...], inputs: list[object], device: str) -> wp.array:
    made = wp.empty(shape, dtype=wp.float64, device=device)
    wp.launch(kernel, shape, inputs=inputs, outputs=[made], device=device, record_tape=False)
    return made


def spline(values: np.ndarray) -> np.ndarray:
    """Coefficients (n + 2, ...) of the quadratic spline through values (n, ...) at equal steps along the first axis.

    (c[i] + 6 c[i + 1] + c[i + 2]) / 8 is value i. At both ends third differences of the coefficients are zero.
    """
    n = len(values)
    found = np.empty((n + 2, *values.shape[1:]))
    inner = found[1:-1]
    # a tridiagonal system, by elimination: the ends give c[1] - c[2] = values[0] - values[1], and the same at the last
    inner[0] = values[0] - values[1]
    above = np.full(n, -1.0)
    for i in range(1, n - 1):
        above[i] = 1.0 / (6.0 - above[i - 1])
        inner[i] = above[i] * (8.0 * values[i] - inner[i - 1])
    inner[-1] = (values[-1] - values[-2] + inner[-2]) / (1.0 + above[n - 2])
    for i in range(n - 2, -1, -1):
        inner[i] -= above[i] * inner[i + 1]
    found[0] = 3.0 * (inner[0] - inner[1]) + inner[2]
    found[-1] = 3.0 * (inner[-1] - inner[-2]) + inner[-3]
    return found
