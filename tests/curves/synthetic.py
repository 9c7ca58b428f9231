"""Synthetic curves: scatterers across a body, and noise that is as correlated in angle as the body's width makes it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from warpsar.curves.angles import independent_deg
from warpsar.curves.observed import ObservedCurve
from warpsar.world.frame import SPEED_OF_LIGHT

WIDTH_M = 0.4
AZIMUTH = np.arange(-60.0, 60.01, 0.5)


def field(rng: np.random.Generator, frequency_hz: float, count: int = 60, width_m: float = WIDTH_M) -> NDArray:
    """A complex Gaussian field of mean power 1 over `AZIMUTH`: scatterers evenly over the width."""
    k = 2.0 * np.pi * frequency_hz / SPEED_OF_LIGHT
    place = width_m * (np.arange(count) / count - 0.5 + rng.uniform(0, 1.0 / count))
    strength = (rng.normal(size=count) + 1j * rng.normal(size=count)) / np.sqrt(2 * count)
    return np.exp(2j * k * np.outer(np.deg2rad(AZIMUTH), place)) @ strength


def curve(
    rng: np.random.Generator,
    terms: dict[str, NDArray],
    shown: list[str],
    *,
    frequency_hz: float = 5e9,
    polarization: str = "VV",
    role: str = "train",
    background_m2: float = 0.01,
    share: float = 0.01,
) -> ObservedCurve:
    """A measured curve that shows some of the terms, with noise."""
    truth = sum((terms[name] for name in shown), np.zeros(len(AZIMUTH), complex))
    noise = np.sqrt(background_m2) * field(rng, frequency_hz) + np.sqrt(share) * field(rng, frequency_hz) * truth
    return ObservedCurve(
        f"{frequency_hz:g} {polarization}",
        frequency_hz,
        polarization,
        role,
        AZIMUTH,
        np.full(len(AZIMUTH), 90.0),
        np.abs(truth + noise) ** 2,
        terms,
        independent_deg(WIDTH_M, frequency_hz),
    ).thinned(4)
