"""Made complex images with a phase over slow time: speckle, points and an edge, whose true phase is known."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.diagnosis.phase.ask import folds_of
from warpsar.diagnosis.phase.spectrum import AzimuthSpectrum
from warpsar.world.taper import taper

SPACING_M, CELLS_M = (0.3, 0.35), (0.59, 0.59)
ROWS, COLUMNS = 128, 160
TURN = 2.0 * np.pi
DARK = 0.1
"""Amplitude behind an edge: 20 dB."""


def aside_of(rows: int = ROWS) -> NDArray[np.float64]:
    """Of each row: how far its look direction is turned, (rows,)."""
    return np.linspace(-1.0, 1.0, rows)


def amplitude_at(place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the spectrum at places of the aperture: Taylor's taper, nothing beyond."""
    return np.where(np.abs(place) <= 1.0, taper("taylor", np.clip(0.5 * place, -0.5, 0.5)), 0.0)


def places(columns: int) -> NDArray[np.float64]:
    """Of the frequencies of an image twice as wide as its columns, (2 columns,)."""
    return -2.0 * CELLS_M[1] * np.fft.fftfreq(2 * columns, SPACING_M[1])


def image(
    phase: Callable[[NDArray[np.float64]], Any],
    *,
    points: int = 0,
    edge: bool = False,
    seed: int = 0,
    shape: tuple[int, int] = (ROWS, COLUMNS),
) -> NDArray[np.complex64]:
    """Speckle under Taylor's taper and a phase [rad] of places of the aperture; with points 35 dB above it, or 20 dB
    darker behind an edge.

    It is cut from an image twice as wide, so that power comes in over its ends as in a real one.
    """
    random, (rows, columns) = np.random.default_rng(seed), shape
    place = places(columns)
    field = random.standard_normal((rows, 2 * columns)) + 1j * random.standard_normal((rows, 2 * columns))
    if edge:
        field[:, columns:] *= DARK
    for _ in range(points):
        field[random.integers(rows), random.integers(columns // 2 + 30, columns + columns // 2 - 30)] += 80.0
    made = np.fft.ifft(np.fft.fft(field, axis=1) * amplitude_at(place) * np.exp(1j * phase(place)), axis=1)
    made = 0.5 * (made + np.roll(made, 1, axis=0))  # cells of two rows
    return made[:, columns // 2 : columns // 2 + columns].astype(np.complex64)


def folds(made: NDArray[np.complex64]) -> list[AzimuthSpectrum]:
    """Both folds of rows, as `diagnose` takes them from an image."""
    aside = aside_of(len(made))
    return [
        AzimuthSpectrum.of(made[mask], SPACING_M, CELLS_M, aside[mask])
        for mask in folds_of(len(made), SPACING_M[0], CELLS_M[0])
    ]
