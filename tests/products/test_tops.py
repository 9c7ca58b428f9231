"""TOPS bursts: the drift of the spectrum is the one that a focused burst of a turning antenna has."""

from __future__ import annotations

import numpy as np
import pytest

from warpsar.products.grid import LineGrid
from warpsar.products.orbit import Orbit
from warpsar.products.tops import Tops
from warpsar.world.frame import SPEED_OF_LIGHT

pytestmark = pytest.mark.unit

FREQUENCY, SPEED, STEERING = 5.405e9, 7590.0, np.deg2rad(1.59)
RATE, CENTROID = -2200.0, 40.0
LINE_S, LINES = 2.0555e-3, 1500
BEAM_HZ = 327.0
STEERED = 2.0 * SPEED / SPEED_OF_LIGHT * FREQUENCY * STEERING


def burst() -> Tops:
    times = np.arange(-20.0, 21.0, 10.0)
    position = np.stack([SPEED * times, np.zeros(5), np.full(5, 7e6)], axis=-1)
    velocity = np.tile([SPEED, 0.0, 0.0], (5, 1))
    middle = 0.5 * (LINES - 1) * LINE_S
    grid = LineGrid(LINES, 100, -middle, LINE_S, 8e5, 2.33, None, (-middle,))
    at = np.array([0.0]), np.array([2 * 8e5 / SPEED_OF_LIGHT])
    orbit = Orbit.of("made", times, position, velocity)
    return Tops.of(grid, orbit, FREQUENCY, STEERING, (*at, np.array([[CENTROID]])), (*at, np.array([[RATE]])))


@pytest.mark.parametrize("when_s", [-1.1, 0.0, 0.8])
def test_a_focused_target_lies_about_zero_frequency(when_s: float) -> None:
    """Raw echoes of one target, made here: exp(j pi k_a (t - t0)^2), lit while k_a (t - t0) is within the beam's band.

    The beam's Doppler centroid runs as f + k_s t over the raw burst. Focused by the matched filter, the target's
    spectrum lies where it was lit: hundreds of hertz off zero, and more than a PRF. Deramped, within some hertz.
    """
    fine = 2e-5
    time = np.arange(-4.0, 4.0, fine)
    doppler = RATE * (time - when_s)
    # What is lit in the middle of the raw burst is at zero Doppler -f / k_a later: there the image has its middle.
    lit = np.abs(doppler - (CENTROID + STEERED * (time - CENTROID / RATE))) < BEAM_HZ / 2
    echo = np.where(lit, np.exp(1j * np.pi * RATE * (time - when_s) ** 2), 0.0)
    frequency = np.fft.fftfreq(time.size, fine)
    focused = np.fft.ifft(np.fft.fft(echo) * np.exp(1j * np.pi * frequency**2 / RATE))
    near = np.abs(time - when_s) < 0.06
    middle = float(np.sum(doppler * lit) / lit.sum())
    line = (time[near] + 0.5 * (LINES - 1) * LINE_S) / LINE_S
    made = burst()(line, np.array([0.0]), focused[near][:, None])[:, 0]

    def centre(samples: np.ndarray) -> float:
        return float(np.angle(np.vdot(samples[:-1], samples[1:])) / (2 * np.pi * fine))

    assert centre(focused[near]) == pytest.approx(middle, abs=3.0)
    assert centre(made) == pytest.approx(0.0, abs=3.0)
    assert abs(middle) > 300.0 or when_s == 0.0
