"""Backprojection onto a plane grid in float32, against the exact way in float64."""

from __future__ import annotations

import numpy as np
import pytest

from warpsar.formats.base.data import PhaseHistory
from warpsar.measured import focus as focusing
from warpsar.measured import plane as planes
from warpsar.measured.focus import focus
from warpsar.measured.plane import EXPANDED_TURNS, Plane, focus_plane
from warpsar.world.frame import SPEED_OF_LIGHT


def history(range_m: float, pulses: int = 96, frequencies: int = 64, apart_m: float | None = None) -> PhaseHistory:
    """Noise as a spotlight records it: X band, 300 MHz, 2 degrees. `apart_m`: of a transmitter along the track."""
    random = np.random.default_rng(4)
    angle = np.deg2rad(np.linspace(-1.0, 1.0, pulses))
    level, height = range_m * np.sin(np.deg2rad(45.0)), range_m * np.cos(np.deg2rad(45.0))
    place = np.stack([-level * np.cos(angle), level * np.sin(angle), np.full(pulses, height)], axis=1)
    sender = None if apart_m is None else place + np.array([0.0, apart_m, 0.0])
    ways = [np.linalg.norm(each, axis=1) for each in (place, place if sender is None else sender)]
    drawn = random.standard_normal((frequencies, pulses, 2), dtype=np.float32).view(np.complex64)[..., 0]
    return PhaseHistory(
        source="noise",
        samples=drawn,
        frequency_start_hz=np.full(pulses, 9.45e9),
        frequency_step_hz=np.full(pulses, 3e8 / frequencies),
        position_m=place,
        reference_range_m=0.5 * (ways[0] + ways[1]),
        polarization="HH",
        transmitter_m=sender,
    )


def plane(rows: int = 37, columns: int = 45, step_m: float = 0.3) -> Plane:
    row, column = np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5)]) * step_m, np.array([0.0, 1.0, 0.0]) * step_m
    return Plane(-0.5 * rows * row - 0.5 * columns * column, row, column, (rows, columns))


def double(one: PhaseHistory, grid: Plane) -> np.ndarray:
    """The sum itself in float64, from the profiles that the kernels read."""
    chosen = np.arange(one.samples.shape[1])
    profiles, frequency, per_metre = focusing.range_profiles(one, chosen, np.ones(len(chosen)), "none")
    points, bins = grid.points(), profiles.shape[1]
    image = np.zeros(grid.shape, complex)
    for p in chosen:
        way = np.linalg.norm(points - one.position_m[p], axis=-1)
        if one.transmitter_m is not None:
            way = 0.5 * (way + np.linalg.norm(points - one.transmitter_m[p], axis=-1))
        way -= one.reference_range_m[p]
        at = way * per_metre[p]
        base = np.floor(at).astype(int)
        t = at - base
        weights = {
            -1: -t * (t - 1) * (t - 2) / 6,
            0: (t + 1) * (t - 1) * (t - 2) / 2,
            1: -(t + 1) * t * (t - 2) / 2,
            2: (t + 1) * t * (t - 1) / 6,
        }
        echo = sum(weight * profiles[p, (base + k) % bins].astype(complex) for k, weight in weights.items())
        image += echo * np.exp(2j * np.pi * way * 2.0 * frequency[p] / SPEED_OF_LIGHT)
    return image / len(chosen)


def signal_to_error_db(found: np.ndarray, exact: np.ndarray) -> float:
    return float(10.0 * np.log10((np.abs(exact) ** 2).sum() / (np.abs(found - exact) ** 2).sum()))


@pytest.mark.parametrize(
    ("range_m", "apart_m", "least_db"), [(770e3, None, 100.0), (10e3, None, 87.0), (10e3, 300.0, 87.0)]
)
def test_signal_to_error(
    range_m: float, apart_m: float | None, least_db: float, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against float64: 87 dB at 10 km, where the term of third order is what is left out, and 100 dB from space.

    What is left of the exact way is float32 in the interpolation and the sum of 96 pulses.
    """
    monkeypatch.setattr(planes, "part_of", lambda *_: None)
    one, grid = history(range_m, apart_m=apart_m), plane()
    assert grid.expanded_turns(one) < EXPANDED_TURNS
    exact = double(one, grid)
    assert signal_to_error_db(focus_plane(one, grid, reference_point_m=np.zeros(3), device=device), exact) > least_db
    (other,) = focus(one, grid.points(), reference_point_m=np.zeros(3), device=device)
    assert signal_to_error_db(other, exact) > 95.0


def test_near_ranges_take_the_exact_way(device: str) -> None:
    """A block of 10 m across seen from 300 m is no parabola: the plane's image is `focus`'s own."""
    one, grid = history(300.0), plane(step_m=0.5)
    assert grid.expanded_turns(one) > EXPANDED_TURNS
    found = focus_plane(one, grid, reference_point_m=np.zeros(3), device=device)
    (exact,) = focus(one, grid.points(), reference_point_m=np.zeros(3), device=device)
    assert np.array_equal(found, exact)


def test_beyond_the_swath_there_is_nothing(device: str) -> None:
    """64 frequencies in 300 MHz hold 16 m on either side: further pixels are NaN, as with `focus`."""
    one, grid = history(10e3), plane(rows=130)
    found = focus_plane(one, grid, reference_point_m=np.zeros(3), device=device)
    assert np.isnan(found[0]).all()
    assert np.isfinite(found[65]).all()


def test_parts_of_an_aperture(monkeypatch: pytest.MonkeyPatch) -> None:
    """A long aperture in parts, by coarse images: 60 dB against float64 over all pixels, the border's too.

    The CPU takes this way by itself where it saves work; the scatterers lie about the image, as a real scene's do.
    """
    one, grid = history(10e3, pulses=256), plane(24, 200)
    part = planes.part_of(one, grid)
    assert part is not None
    assert part.pulses < 256
    exact = double(one, grid)
    found = focus_plane(one, grid, reference_point_m=np.zeros(3), device="cpu")
    assert signal_to_error_db(found, exact) > 60.0
    monkeypatch.setattr(planes, "part_of", lambda *_: None)
    whole = focus_plane(one, grid, reference_point_m=np.zeros(3), device="cpu")
    assert signal_to_error_db(whole, exact) > 87.0
    assert not np.array_equal(whole, found)
