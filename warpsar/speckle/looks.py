"""Equivalent number of looks of an intensity image, from its homogeneous parts."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

WINDOW = 9  # [pixels] on a side: 81 samples, and still small beside a field or a car park
_FEWEST_WINDOWS = 16
_LAGS = 4
_MOST_MADE = 32  # looks of the simulated speckle; beyond it speckle is Gaussian, and the factor constant
_MOST_PATCHES = 400


def equivalent_looks(power: np.ndarray) -> float | None:
    """Mean^2 / variance of speckle in an image of linear power, shape (rows, cols).

    Texture and targets only lower the ratio. So its most common value over 9 x 9 windows is that of homogeneous ground.
    Small, skewed and correlated samples bias this value: neighbours share speckle, which a window's variance does not
    see. The same measurement on simulated speckle, with known looks and the correlation found around the mode, gives
    the correction factor. None where fewer than 16 windows are whole and not zero.
    """
    found = _mode(power)
    if found is None:
        return None
    looks, homogeneous = found
    correlation = _correlation(power, homogeneous)
    for _ in range(2):  # the factor hardly depends on the looks: two turns settle it
        made = int(np.clip(round(looks), 1, _MOST_MADE))
        speckle = _mode(_speckle(made, correlation))
        assert speckle is not None
        looks = found[0] * made / speckle[0]
    return float(looks)


def _speckle(looks: int, correlation: np.ndarray) -> np.ndarray:
    """Intensity of `looks` summed circular Gaussian fields whose intensity has that correlation, (288, 288)."""
    side = 32 * WINDOW
    field = np.zeros((side, side))
    lag = np.arange(-_LAGS, _LAGS + 1)
    field[np.ix_(lag, lag)] = np.sqrt(np.maximum(correlation, 0.0))  # |field correlation|^2 is the intensity's
    amplitude = np.sqrt(np.maximum(np.fft.fft2(field).real, 0.0))
    generator = np.random.default_rng(0)
    total = np.zeros((side, side))
    for _ in range(looks):
        white = generator.normal(size=(side, side)) + 1j * generator.normal(size=(side, side))
        total += np.abs(np.fft.ifft2(np.fft.fft2(white) * amplitude)) ** 2
    return total


def _mode(power: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Most common mean^2 / variance, and the upper left corners (n, 2) of windows near it."""
    step = WINDOW // 2
    mean, variance = _window_moments(power, step)
    usable = np.isfinite(mean) & (mean > 0) & (variance > 0)
    if usable.sum() < _FEWEST_WINDOWS:
        return None
    values = np.log(mean[usable] ** 2 / variance[usable])
    mode, width = _densest(values)
    corners = np.argwhere(usable) * step
    return float(np.exp(mode)), corners[np.abs(values - mode) < width]


def _window_moments(power: np.ndarray, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and unbiased variance of the windows at every `step` pixels; NaN where a pixel is not finite."""
    if min(power.shape) < WINDOW:
        return np.empty((0, 0)), np.empty((0, 0))
    image = np.where(np.isfinite(power) & (power >= 0), power, np.nan).astype(np.float64)
    scale = np.nanmean(image) if np.isfinite(image).any() else 0.0
    windows = sliding_window_view(image / (scale or 1.0), (WINDOW, WINDOW))[::step, ::step]
    return windows.mean(axis=(2, 3)), windows.var(axis=(2, 3), ddof=1)


def _densest(values: np.ndarray) -> tuple[float, float]:
    """Mode of a kernel density, and the kernel's width: Silverman's, from the upper half, which texture spares."""
    median, upper = np.percentile(values, [50, 75])
    spread = min(values.std(), (upper - median) / 0.6745) or 1e-3
    width = 0.9 * spread * values.size**-0.2
    grid = np.linspace(values.min() - width, values.max() + width, 2048)
    counts, edges = np.histogram(values, bins=grid)
    centres = (edges[:-1] + edges[1:]) / 2.0
    reach = np.arange(-4.0 * width, 4.0 * width, centres[1] - centres[0])
    density = np.convolve(counts, np.exp(-0.5 * (reach / width) ** 2), mode="same") if reach.size > 1 else counts
    return float(centres[np.argmax(density)]), float(max(width, 2.0 * (centres[1] - centres[0])))


def _correlation(power: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Intensity correlation at lags -4 to 4, (9, 9), 1 in the middle, from windows at the upper left `corners`."""
    rows, cols = power.shape
    side = 2 * WINDOW  # wider than a window: the mean that is taken out must not eat the correlation
    half = np.zeros((_LAGS + 1, 2 * _LAGS + 1))
    for row, col in corners[:: max(1, len(corners) // _MOST_PATCHES)]:
        top, left = min(max(0, row - WINDOW // 2), rows - side), min(max(0, col - WINDOW // 2), cols - side)
        if top < 0 or left < 0:
            continue
        patch = power[top : top + side, left : left + side].astype(np.float64)
        if not np.isfinite(patch).all() or patch.mean() <= 0:
            continue
        patch = patch / patch.mean() - 1.0
        for i in range(_LAGS + 1):
            for j in range(-_LAGS, _LAGS + 1):
                here = patch[: side - i, max(0, -j) : side - max(0, j)]
                there = patch[i:, max(0, j) : side - max(0, -j)]
                half[i, j + _LAGS] += (here * there).mean()
    whole = np.concatenate([half[:0:-1, ::-1], half])
    whole[_LAGS, _LAGS] = max(half[0, _LAGS], 1e-300)
    return whole / whole[_LAGS, _LAGS]
