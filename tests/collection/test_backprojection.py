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


def double(one: PhaseHistory, points: np.ndarray) -> np.ndarray:
    """The sum itself at points (..., 3) in float64, from the profiles that the kernels read."""
    chosen = np.arange(one.samples.shape[1])
    profiles, frequency, per_metre = focusing.range_profiles(one, chosen, np.ones(len(chosen)), "none")
    bins = profiles.shape[1]
    image = np.zeros(points.shape[:-1], complex)
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
    exact = double(one, grid.points())
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
    exact = double(one, grid.points())
    found = focus_plane(one, grid, reference_point_m=np.zeros(3), device="cpu")
    assert signal_to_error_db(found, exact) > 60.0
    monkeypatch.setattr(planes, "part_of", lambda *_: None)
    whole = focus_plane(one, grid, reference_point_m=np.zeros(3), device="cpu")
    assert signal_to_error_db(whole, exact) > 87.0
    assert not np.array_equal(whole, found)


X_BAND = 9.6e9


def arc(range_m: float, incidence_deg: float, aperture_deg: float, pulses: int = 256) -> np.ndarray:
    angle, incidence = np.deg2rad(np.linspace(-0.5, 0.5, pulses) * aperture_deg), np.deg2rad(incidence_deg)
    level = range_m * np.sin(incidence)
    height = np.full(pulses, range_m * np.cos(incidence))
    return np.stack([-level * np.cos(angle), level * np.sin(angle), height], axis=1)


def line(range_m: float, length_m: float, squint_deg: float = 0.0, pulses: int = 256) -> np.ndarray:
    level = range_m * np.sqrt(0.5)
    y = np.linspace(-0.5, 0.5, pulses) * length_m + level * np.tan(np.deg2rad(squint_deg))
    return np.stack([np.full(pulses, -level), y, np.full(pulses, level)], axis=1)


def seen(track: np.ndarray, points: np.ndarray, band_hz: float, sender: np.ndarray | None = None) -> PhaseHistory:
    """Noise of a band whose unambiguous swath just holds points (n, 3): the fewest frequencies."""

    def ways(at: np.ndarray) -> np.ndarray:
        way = np.linalg.norm(track - at, axis=1)
        return way if sender is None else 0.5 * (way + np.linalg.norm(sender - at, axis=1))

    reference = ways(np.zeros(3))
    swath = max(np.abs(ways(point) - reference).max() for point in points)
    frequencies = max(16, int(1.1 * swath * 4.0 * band_hz / SPEED_OF_LIGHT) + 2)
    drawn = np.random.default_rng(6).standard_normal((frequencies, len(track), 2), dtype=np.float32)
    return PhaseHistory(
        source="noise",
        samples=drawn.view(np.complex64)[..., 0],
        frequency_start_hz=np.full(len(track), X_BAND - 0.5 * band_hz),
        frequency_step_hz=np.full(len(track), band_hz / frequencies),
        position_m=track,
        reference_range_m=reference,
        polarization="HH",
        transmitter_m=sender,
    )


def level(shape: tuple[int, int], steps_m: tuple[float, float], middle_m: tuple[float, float] = (0.0, 0.0)) -> Plane:
    row, column = np.array([steps_m[0], 0.0, 0.0]), np.array([0.0, steps_m[1], 0.0])
    origin = np.array([*middle_m, 0.0]) - 0.5 * shape[0] * row - 0.5 * shape[1] * column
    return Plane(origin, row, column, shape)


def some_pixels(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Five hundred pixels, a third of them on the ends of rows, where a coarse image reaches beyond the fine one."""
    random = np.random.default_rng(8)
    i, j = (random.integers(0, n, 500) for n in shape)
    j[:160] = random.choice([0, shape[1] - 1], 160)
    return i, j


SQUARE, FINE = (24, 200), (0.3, 0.3)
GEOMETRIES = {
    # name: track, grid, band [Hz], transmitter, factorised
    "spotlight": (arc(10e3, 45.0, 2.0), level(SQUARE, FINE), 3e8, None, True),
    "wide spotlight": (arc(10e3, 45.0, 12.0, 512), level(SQUARE, (0.2, 0.2)), 6e8, None, True),
    "circle": (arc(10e3, 45.0, 360.0, 512), level(SQUARE, (0.2, 0.2)), 3e8, None, False),
    "squinted by 5 degrees": (line(10e3, 300.0, 5.0), level(SQUARE, FINE), 3e8, None, True),
    "squinted by 45 degrees": (line(10e3, 300.0, 45.0), level(SQUARE, FINE), 3e8, None, False),
    "from space": (arc(650e3, 35.0, 1.0), level(SQUARE, FINE), 6e8, None, True),
    "strip-map": (line(8e3, 800.0), level((16, 1500), (0.5, 0.4)), 1.5e8, None, True),
    "image much smaller than the aperture": (line(10e3, 3000.0, pulses=512), level((16, 24), FINE), 3e8, None, False),
    "image much larger than the aperture": (line(20e3, 40.0), level((16, 3000), (0.6, 0.6)), 6e7, None, True),
    "many rows, few columns": (arc(10e3, 45.0, 2.0), level((600, 40), FINE), 3e8, None, True),
    "two rows": (arc(10e3, 45.0, 2.0), level((2, 700), FINE), 3e8, None, True),
    "off the reference point": (arc(10e3, 45.0, 2.0), level(SQUARE, FINE, (300.0, 250.0)), 3e8, None, True),
    "near, in small blocks": (arc(2e3, 45.0, 2.0), level(SQUARE, (0.25, 0.25)), 3e8, None, True),
    "uneven track": (
        arc(10e3, 45.0, 2.0) + np.random.default_rng(2).normal(0.0, 0.3, (256, 3)),
        level(SQUARE, FINE),
        3e8,
        None,
        True,
    ),
    "two antennas": (
        arc(10e3, 45.0, 2.0),
        level(SQUARE, FINE),
        3e8,
        arc(10e3, 45.0, 2.0) + np.array([0.0, 800.0, 0.0]),
        True,
    ),
}


@pytest.mark.parametrize("name", GEOMETRIES)
def test_any_geometry_holds_60_db(name: str) -> None:
    """On the CPU, whichever way `focus_plane` takes there: 60 dB against float64, and 60 dB at the ends of rows alone.

    Coarse grids must be fine enough for the spectrum of their part, wherever the image lies. Where none saves work the
    aperture is not cut, and the sum holds 80 dB.
    """
    track, grid, band, sender, factorised = GEOMETRIES[name]
    one = seen(track, grid.ends(), band, sender)
    assert planes.block_size(one, grid) is not None
    assert (planes.part_of(one, grid) is not None) == factorised
    found = focus_plane(one, grid, reference_point_m=np.zeros(3), device="cpu")
    i, j = some_pixels(grid.shape)
    exact = double(one, grid.points()[i, j])
    least = 60.0 if factorised else 80.0
    assert signal_to_error_db(found[i, j], exact) > least
    assert signal_to_error_db(found[i, j][:160], exact[:160]) > least


def test_heights_of_terrain_take_the_exact_way(device: str) -> None:
    """Points on hills form no plane: `focus` sums them in float64, 100 dB against the sum itself."""
    points = level((12, 40), (1.0, 1.0)).points()
    points[..., 2] = 8.0 * np.sin(0.2 * points[..., 0]) * np.cos(0.1 * points[..., 1])
    one = seen(arc(10e3, 45.0, 2.0), points.reshape(-1, 3), 3e8)
    (found,) = focus(one, points, reference_point_m=np.zeros(3), device=device)
    assert signal_to_error_db(found, double(one, points)) > 95.0


def test_small_blocks_where_large_ones_leave_too_much(monkeypatch: pytest.MonkeyPatch) -> None:
    """From 2 km a block of 16 x 32 pixels is no parabola, and one of 4 x 8 is: the bound falls with its size cubed."""
    monkeypatch.setattr(planes, "part_of", lambda *_: None)
    one, grid = history(2e3), plane()
    assert grid.expanded_turns(one) > EXPANDED_TURNS
    assert planes.block_size(one, grid) == (4, 8)
    assert grid.expanded_turns(one, 4, 8) == pytest.approx(grid.expanded_turns(one) / 64.0, rel=0.02)
    found = focus_plane(one, grid, reference_point_m=np.zeros(3), device="cpu")
    assert signal_to_error_db(found, double(one, grid.points())) > 85.0
