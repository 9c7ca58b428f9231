"""Backprojection against the theory of a point target, and against the sum it stands for."""

from pathlib import Path

import numpy as np
import pytest
from measured_files import C, Pass, echoes

from warpsar.errors import InputError
from warpsar.formats.base.data import PhaseHistory
from warpsar.measured.focus import cell_m, focus
from warpsar.measured.ground import plane_points
from warpsar.world.frame import view_geometry
from warpsar.world.taper import taper

pytestmark = pytest.mark.unit

LOOK = Pass(azimuth_deg=110.0, incidence_deg=44.0, slant_range_m=10e3)
FREQUENCY_HZ = 9.3e9 + 2e6 * np.arange(300)
POSITIONS = LOOK.position(np.linspace(-70.0, 70.0, 141))
GEOMETRY = view_geometry(LOOK.azimuth_deg, LOOK.incidence_deg, 9.6e9)
ORIGIN = np.zeros(3)


def history(points: np.ndarray, amplitude: np.ndarray, **changed: object) -> PhaseHistory:
    pulses = POSITIONS.shape[0]
    fields = {
        "source": "made",
        "samples": echoes(POSITIONS, FREQUENCY_HZ, points, amplitude, ORIGIN).astype(np.complex64),
        "frequency_start_hz": np.full(pulses, FREQUENCY_HZ[0]),
        "frequency_step_hz": np.full(pulses, 2e6),
        "position_m": POSITIONS,
        "reference_range_m": np.linalg.norm(POSITIONS, axis=1),
        "polarization": "HH",
    } | changed
    return PhaseHistory(**fields)


def cut(
    data: PhaseHistory, at: tuple[float, float], axis: int, window: str, device: str
) -> tuple[np.ndarray, np.ndarray]:
    """Power along range (0) or azimuth (1) through `at`, and the distance from it in resolution cells."""
    cells = np.linspace(-6.0, 6.0, 2401)
    step = cells * cell_m(data, ORIGIN)[axis]
    r, a = (at[0] + step, np.array([at[1]])) if axis == 0 else (np.array([at[0]]), at[1] + step)
    points = plane_points(GEOMETRY, ORIGIN, r, a)
    image = next(
        focus(data, points, reference_point_m=ORIGIN, window_range=window, window_azimuth=window, device=device)
    )
    return cells, np.abs(image.ravel()) ** 2


def shape(cells: np.ndarray, power: np.ndarray) -> tuple[float, float, float]:
    """Peak's place, half-power width (both in cells), and the highest sidelobe [dB]."""
    top = int(power.argmax())
    curve = np.polyfit(cells[top - 3 : top + 4], power[top - 3 : top + 4], 2)
    above = np.flatnonzero(power > power[top] / 2)
    left, right = above[0], above[-1]
    width = np.interp(power[top] / 2, power[right : right + 2][::-1], cells[right : right + 2][::-1]) - np.interp(
        power[top] / 2, power[left - 1 : left + 1], cells[left - 1 : left + 1]
    )
    valley = top + int(np.flatnonzero(np.diff(power[top:]) > 0)[0])
    return -curve[1] / (2 * curve[0]), width, 10 * np.log10(power[valley:].max() / power[top])


# Half-power width in cells and highest sidelobe of the continuous windows: sinc; cos^2 (Harris 1978, table 1); Taylor
# of -35 dB, nbar 5, whose Fourier integral has its first sidelobe at -35.22 dB (the design value is for infinite nbar).
THEORY = {"none": (0.8859, -13.26), "hann": (1.4410, -31.47), "taylor": (1.1875, -35.22)}


@pytest.mark.parametrize("window", THEORY)
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("at", [(0.0, 0.0), (21.3, -17.9)])
def test_a_point_target_is_where_and_as_wide_as_theory_says(
    window: str, axis: int, at: tuple[float, float], device: str
) -> None:
    target = plane_points(GEOMETRY, ORIGIN, np.array([at[0]]), np.array([at[1]])).reshape(1, 3)
    data = history(target, np.array([3.0]))
    place, width, sidelobe = shape(*cut(data, at, axis, window, device))
    expected_width, expected_sidelobe = THEORY[window]
    # 1/100 of a cell: the cubic interpolation of profiles 8 times oversampled is better than that.
    assert place == pytest.approx(0.0, abs=0.01)
    # 1 %: the aperture is even in position along the track, not in angle (0.2 %), and sampled at 141 pulses.
    assert width == pytest.approx(expected_width, rel=0.01)
    assert sidelobe == pytest.approx(expected_sidelobe, abs=0.2)  # for the same reasons


def test_cells_are_band_and_aperture() -> None:
    data = history(np.zeros((1, 3)), np.ones(1))
    range_cell, azimuth_cell = cell_m(data, ORIGIN)
    assert range_cell == pytest.approx(C / (2 * 600e6), rel=1e-9)
    aperture = 2 * np.sin(np.arctan(70.5 / 10e3))  # 141 intervals of 1 m
    assert azimuth_cell == pytest.approx(C / 9.599e9 / 2 / aperture, rel=1e-4)  # track and chord differ by 2e-5


def test_image_is_the_matched_filter_in_amplitude_and_phase(device: str) -> None:
    generator = np.random.default_rng(1)
    targets = np.column_stack([generator.uniform(-20, 20, (5, 2)), np.zeros(5)])
    amplitude = generator.normal(size=5) + 1j * generator.normal(size=5)
    data = history(targets, amplitude)
    points = np.concatenate(
        [targets, np.column_stack([generator.uniform(-20, 20, (40, 2)), generator.uniform(0, 3, 40)])]
    )
    found = next(focus(data, points, reference_point_m=ORIGIN, device=device))
    dr = np.linalg.norm(POSITIONS[None] - points[:, None], axis=-1) - data.reference_range_m
    filters = np.exp(4j * np.pi / C * FREQUENCY_HZ[None, :, None] * dr[:, None, :])
    exact = (filters * data.samples[None]).mean(axis=(1, 2))
    # 6e-4 of the amplitude is what the interpolation loses at the edge of the band.
    np.testing.assert_allclose(found, exact, atol=6e-4 * np.abs(exact).max())


def test_every_pulse_may_have_its_own_frequencies(device: str) -> None:
    pulses = POSITIONS.shape[0]
    start = 9.3e9 + np.linspace(0.0, 5e7, pulses)
    step = np.linspace(1.9e6, 2.1e6, pulses)
    target = np.array([[12.0, -7.0, 0.0]])
    frequency = start + np.arange(300)[:, None] * step
    dr = np.linalg.norm(POSITIONS - target, axis=1) - np.linalg.norm(POSITIONS, axis=1)
    samples = np.exp(-4j * np.pi / C * frequency * dr).astype(np.complex64)
    data = history(target, np.ones(1), samples=samples, frequency_start_hz=start, frequency_step_hz=step)
    found = next(focus(data, target, reference_point_m=ORIGIN, device=device))
    assert np.abs(found[0]) == pytest.approx(1.0, abs=1e-3)  # interpolation, as above


def test_subapertures_halve_the_aperture_and_see_the_same_target(device: str) -> None:
    data = history(np.zeros((1, 3)), np.array([2.0]))
    step = np.linspace(-6.0, 6.0, 2401)
    points = plane_points(GEOMETRY, ORIGIN, np.zeros(1), step * cell_m(data, ORIGIN)[1])
    images = list(focus(data, points, reference_point_m=ORIGIN, subapertures=3, device=device))
    assert len(images) == 3
    for image in images:
        place, width, _ = shape(step, np.abs(image.ravel()) ** 2)
        assert place == pytest.approx(0.0, abs=0.01)
        assert width == pytest.approx(3 * 0.8859, rel=0.01)  # 47 of 141 pulses each
        assert np.abs(image).max() == pytest.approx(2.0, rel=1e-3)


def test_points_beyond_the_unambiguous_swath_are_nan(device: str) -> None:
    data = history(np.zeros((1, 3)), np.ones(1))
    swath = C / (4 * 2e6)  # on each side
    points = plane_points(GEOMETRY, ORIGIN, np.array([-swath - 1, -swath + 1, swath - 1, swath + 1]), np.zeros(1))
    found = next(focus(data, points, reference_point_m=ORIGIN, device=device)).ravel()
    assert np.isfinite(found).tolist() == [False, True, True, False]


def test_autofocus_sharpens_and_does_not_move() -> None:
    """Errors as AFRL states them: its corrections are r0 + r_correct and a phase of +ph_correct."""
    generator = np.random.default_rng(2)
    pulses = POSITIONS.shape[0]
    smooth = 1.5 * np.sin(np.linspace(0.0, 9.0, pulses))  # [rad], what really was wrong
    ranges = 0.3 + 0.02 * generator.normal(size=pulses)
    clean = history(np.zeros((1, 3)), np.ones(1))
    wavenumber = 4 * np.pi * clean.centre_frequency_hz / C
    blurred = history(
        np.zeros((1, 3)),
        np.ones(1),
        samples=(clean.samples * np.exp(-1j * smooth)).astype(np.complex64),
        autofocus_range_m=ranges,
        autofocus_phase=np.angle(np.exp(1j * (smooth + wavenumber * ranges + 0.02 * np.arange(pulses)))),
    )
    peaks = [
        np.abs(next(focus(data, np.zeros((1, 3)), reference_point_m=ORIGIN, device="cpu")))[0]
        for data in (blurred, blurred.with_autofocus())
    ]
    assert peaks[0] < 0.7
    # The fitted line takes a little of the sine with it, a shift of less than a tenth of a cell; and the range
    # corrections of 2 cm rms are real displacements of the echoes, 8 % of a cell.
    assert peaks[1] > 0.97


def test_taper_is_symmetric_and_refuses_what_it_does_not_know() -> None:
    x = np.linspace(-0.5, 0.5, 101)
    for window in THEORY:
        w = taper(window, x)
        np.testing.assert_allclose(w, w[::-1], atol=1e-9)
        assert w.argmax() == 50 or window == "none"
    with pytest.raises(InputError, match=r"'hamming'.*none, hann, taylor"):
        taper("hamming", x)


def test_more_subapertures_than_pulses_are_refused() -> None:
    data = history(np.zeros((1, 3)), np.ones(1))
    with pytest.raises(InputError, match=r"subapertures = 71.*141 pulses.*1 to 70"):
        next(focus(data, np.zeros((1, 3)), reference_point_m=ORIGIN, subapertures=71, device="cpu"))


@pytest.mark.measured
def test_gotcha_reflector_is_as_sharp_as_its_band_and_aperture(measured_data: Path) -> None:
    from warpsar.formats import registry

    data = registry.read([measured_data / "gotcha" / "data_3dsar_pass1_az001_HH.mat"])
    facts = data.facts(ORIGIN)
    geometry = view_geometry(facts.azimuth_deg, facts.incidence_deg, facts.frequency_hz)
    cells = cell_m(data, ORIGIN)
    near = np.array([-15.6, 21.6, 0.0])
    at = near @ geometry.d, near @ geometry.u
    step = np.arange(-2.0, 2.0, 0.02)
    image = next(
        focus(
            data,
            plane_points(geometry, ORIGIN, at[0] + step, at[1] + step),
            reference_point_m=ORIGIN,
            window_range="hann",
            device="cpu",
        )
    )
    power = np.abs(image) ** 2
    i, j = np.unravel_index(power.argmax(), power.shape)
    assert np.hypot(step[i], step[j]) < 0.3  # the place is given to 0.1 m
    widths = [0.02 * np.count_nonzero(line > power[i, j] / 2) for line in (power[:, j], power[i])]
    # A reflector is no ideal point, and the clutter around it is 30 dB down: 5 %.
    assert widths[0] == pytest.approx(1.441 * cells[0], rel=0.05)
    assert widths[1] == pytest.approx(0.886 * cells[1], rel=0.05)
