"""What a system does and its files do not say, each against a closed form or a sum of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from collected_scenes import WAVELENGTH, field, scene
from test_phase_history import plan, points

import warpsar
from warpsar.collection.antenna_file import read
from warpsar.collection.history import Collected
from warpsar.collection.history import phase_history as recorded
from warpsar.collection.scatterers import ScattererPart, Scatterers
from warpsar.measured.focus import focus
from warpsar.runtime import devices
from warpsar.world.collection import Antenna, AntennaChannels, CollectionErrors, Transmitter
from warpsar.world.frame import SPEED_OF_LIGHT

PLACE = np.array([[3.0, -2.0, 0.0]])
ONE = np.ones(1)


def peak_m(made: Collected, about: np.ndarray, axis: np.ndarray, reach: float = 3.0) -> tuple[float, float]:
    """Where the focused image is brightest along an axis through a place (3,) [m], and its amplitude there."""
    step = np.linspace(-reach, reach, 1201)
    where = about + step[:, None] * axis
    (image,) = focus(made.history(made.polarizations[0]), where, reference_point_m=np.zeros(3), device="cpu")
    best = int(np.argmax(np.abs(image)))
    return float(step[best]), float(np.abs(image[best]))


@pytest.fixture
def sines(tmp_path: Path) -> Path:
    """A track error of some millimetres: time, and three sines."""
    path = tmp_path / "error.csv"
    time = np.linspace(-10.0, 10.0, 801)
    aside = [0.004 * np.sin(0.9 * time), 0.003 * np.cos(1.3 * time), 0.005 * np.sin(0.7 * time + 1.0)]
    rows = [",".join(f"{value:.9f}" for value in row) for row in zip(time, *aside, strict=True)]
    path.write_text("time_s,x_m,y_m,z_m\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


def test_a_track_error_is_in_the_way_and_not_in_the_file(sines: Path) -> None:
    """Samples go by the way from the true track, less what the recorded one says of the reference point."""
    planned = plan(collection={"errors": CollectionErrors(track=sines)})
    made = points(planned, PLACE, ONE, "cpu")
    time = planned.track.time_s
    wanted = np.stack(
        [0.004 * np.sin(0.9 * time), 0.003 * np.cos(1.3 * time), 0.005 * np.sin(0.7 * time + 1.0)], axis=1
    )
    history = made.history("HH")
    np.testing.assert_allclose(history.position_m - planned.track.receiver_m, wanted, atol=1e-8)
    way = np.linalg.norm(planned.track.receiver_m - PLACE, axis=1) - np.linalg.norm(history.position_m, axis=1)
    sums = np.exp(-4j * np.pi / SPEED_OF_LIGHT * made.frequency_hz[:, None] * way)
    assert np.abs(made.samples[0] - sums).max() < 2e-4
    # Without the error in the file's track the point is focused; with it the phase is wrong by up to a radian.
    blurred = peak_m(made, PLACE[0], planned.geometry.u)[1]
    sharp = peak_m(points(plan(), PLACE, ONE, "cpu"), PLACE[0], planned.geometry.u)[1]
    assert blurred < 0.9 * sharp


def test_a_late_echo_lies_farther(device: str) -> None:
    planned = plan(collection={"errors": CollectionErrors(timing_s=4e-9)})
    found, _ = peak_m(points(planned, PLACE, ONE, device), PLACE[0], planned.geometry.d)
    assert found == pytest.approx(0.5 * SPEED_OF_LIGHT * 4e-9, abs=0.01)


@pytest.mark.parametrize("offset_hz", [0.8, -0.4])
def test_oscillators_that_differ_move_the_image_in_azimuth(offset_hz: float) -> None:
    """By lambda R / 2 v for each hertz, along the flight."""
    planned = plan(collection={"errors": CollectionErrors(frequency_hz=offset_hz)})
    flight = planned.track.velocity_m_s()[0][planned.middle]
    speed = float(np.linalg.norm(flight))
    found, level = peak_m(points(planned, PLACE, ONE, "cpu"), PLACE[0], flight / speed)
    assert found == pytest.approx(0.5 * WAVELENGTH * planned.slant_range_m * offset_hz / speed, abs=0.02)
    assert level > 0.98


def test_too_few_pulses_fold_where_that_is_asked_for() -> None:
    """Copies lie lambda / 2 over the angle from pulse to pulse away: lambda R PRF / 2 v."""
    few: dict[str, Any] = {"pulses": 40, "resolution_m": (2.0, 1.0)}
    with pytest.raises(warpsar.InputError, match="ambiguous"):
        plan(collection=few)
    planned = plan(collection={**few, "azimuth_ambiguities": True})
    track = planned.track
    prf = 1.0 / np.diff(track.time_s).mean()
    speed = float(np.linalg.norm(track.velocity_m_s()[0][planned.middle]))
    apart = 0.5 * WAVELENGTH * planned.slant_range_m * prf / speed
    made = points(planned, np.zeros((1, 3)), ONE, "cpu")
    found, level = peak_m(made, apart * planned.geometry.u, planned.geometry.u, 1.0)
    assert abs(found) < 0.1
    assert level > 0.9
    assert peak_m(made, 0.5 * apart * planned.geometry.u, planned.geometry.u, 1.0)[1] < 0.1
    with pytest.raises(warpsar.InputError, match="azimuth_ambiguities without"):
        plan(collection={"azimuth_ambiguities": True})


def pattern_file(path: Path, gain: Any, phase_deg: Any, elevations: Any = None) -> Path:
    rows = []
    for azimuth in np.linspace(-1.0, 1.0, 161):
        for elevation in [None] if elevations is None else elevations:
            head = [azimuth] if elevation is None else [azimuth, elevation]
            decibels = 20.0 * np.log10(max(abs(gain(azimuth, elevation or 0.0)), 1e-9))
            rows.append(",".join(f"{value:.9f}" for value in (*head, decibels, phase_deg(azimuth))))
    names = "azimuth_deg,gain_db,phase_deg" if elevations is None else "azimuth_deg,elevation_deg,gain_db,phase_deg"
    path.write_text(names + "\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("prf_hz", [3.0, 7.0])
@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
def test_pulses_come_as_often_as_stated(prf_hz: float, mode: str) -> None:
    """Few of them, too: with more than stated the copies would lie elsewhere."""
    table = {"mode": mode, "prf_hz": prf_hz, "azimuth_ambiguities": True, "resolution_m": (1.0, 1.0)}
    planned = plan(collection=table)
    np.testing.assert_allclose(np.diff(planned.track.time_s), 1.0 / prf_hz, rtol=1e-9)
    speed = np.linalg.norm(planned.track.velocity_m_s()[0][planned.middle])
    assert speed == pytest.approx(100.0, rel=1e-6)


def test_a_measured_pattern_is_the_one_that_its_table_says(tmp_path: Path, device: str) -> None:
    """That of a rectangular antenna, from its closed form: sinc of the sine over the half-power width, twice."""

    def gain(azimuth: float, elevation: float) -> float:
        sines = np.sin(np.deg2rad([azimuth, elevation]))
        return float(np.prod(np.sinc(0.8859 * sines / np.sin(np.deg2rad([0.9, 0.7]))) ** 2))

    path = pattern_file(tmp_path / "pattern.csv", gain, lambda _: 0.0, np.linspace(-0.5, 0.5, 81))
    where = np.random.default_rng(3).uniform(-14.0, 14.0, (20, 3)) * [1.0, 1.0, 0.2]
    mode = {"mode": "stripmap", "resolution_m": (1.0, 1.0)}
    made = [
        points(plan(collection={**mode, "antenna": antenna}), where, np.ones(20), device).samples
        for antenna in (Antenna(pattern=path), Antenna(azimuth_deg=0.9, elevation_deg=0.7))
    ]
    np.testing.assert_allclose(made[0], made[1], atol=2e-3 * np.abs(made[1]).max())


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("squint_deg", [0.0, 10.0])
def test_angles_of_a_pattern_are_forward_and_up(side: str, squint_deg: float, tmp_path: Path) -> None:
    """Gain and phase that are linear in both angles, at points on all sides: by the geometry of angles."""
    path = tmp_path / "pattern.csv"
    angles = np.linspace(-1.0, 1.0, 41)
    rows = [f"{a},{e},{4.0 * a + 2.0 * e - 3.0},{50.0 * a - 70.0 * e}" for a in angles for e in angles]
    path.write_text("azimuth_deg,elevation_deg,gain_db,phase_deg\n" + "\n".join(rows) + "\n", encoding="utf-8")
    table = {"antenna": Antenna(pattern=path), "side": side, "squint_deg": squint_deg}
    planned = plan(collection=table)
    flight = planned.track.velocity_m_s()[0][planned.middle]
    place = planned.track.receiver_m[planned.middle]
    look = -place / np.linalg.norm(place)
    level = np.cross(look, [0.0, 0.0, 1.0])
    level *= np.sign(level @ flight) / np.linalg.norm(level)
    up = np.cross(level, look)
    up *= np.sign(up[2])
    for where in (12.0 * level, -9.0 * level, 10.0 * np.array([*look[:2], 0.0]), np.array([4.0, -6.0, 3.0])):
        seen, plain = (
            points(one, where[None], ONE, "cpu") for one in (planned, plan(collection=table | {"antenna": None}))
        )
        ratio = seen.samples[0, 3, planned.middle] / plain.samples[0, 3, planned.middle]
        to = (where - place) / np.linalg.norm(where - place)
        azimuth, elevation = np.rad2deg(np.arcsin([to @ level, to @ up]))
        assert 20.0 * np.log10(abs(ratio)) == pytest.approx(4.0 * azimuth + 2.0 * elevation - 3.0, abs=0.005)
        turned = ratio * np.exp(-1j * np.deg2rad(50.0 * azimuth - 70.0 * elevation))
        assert np.angle(turned, deg=True) == pytest.approx(0.0, abs=0.1)  # between the table's angles it is cubic


def test_images_of_both_kinds_are_calibrated_at_the_axis(tmp_path: Path) -> None:
    """Whatever the gain of the axis is; its phase stays, and the fall off the axis."""
    path = tmp_path / "pattern.csv"
    rows = [f"{a},{e},{40.0 - 30.0 * (a * a + e * e)},{25.0}" for a in ANGLES for e in ANGLES]
    path.write_text("azimuth_deg,elevation_deg,gain_db,phase_deg\n" + "\n".join(rows) + "\n", encoding="utf-8")
    images = {}
    for focused in ("direct", "backprojection"):
        for antenna in (None, Antenna(pattern=path)):
            made = scene(
                field(16.0, 16.0),
                shape=(40, 40),
                spacing=(0.6, 0.6),
                radar={"terms": ("rough",)},
                collection={"focus": focused, "antenna": antenna, "resolution_m": (1.0, 1.0), "slant_range_m": 1e3},
            )
            images[focused, antenna is None] = warpsar.slc(made, device="cpu")[0].images["HH"]
    one, other = images["direct", False], images["backprojection", False]
    np.testing.assert_allclose(one, other, atol=0.03 * np.abs(other).max())
    for focused in ("direct", "backprojection"):
        with_pattern, without = images[focused, False], images[focused, True]
        middle = (slice(17, 23), slice(17, 23))  # within 0.15 degrees of the axis: 0.7 dB at its corners
        ratio = (with_pattern[middle] * without[middle].conj()).sum() / (np.abs(without[middle]) ** 2).sum()
        assert np.angle(ratio, deg=True) == pytest.approx(25.0, abs=2.0)
        assert 0.92 < abs(ratio) < 1.0


ANGLES = np.linspace(-1.0, 1.0, 81)


def test_a_phase_over_the_beam_moves_a_stripmap(tmp_path: Path) -> None:
    """A phase of k radians in each radian is that of an antenna k lambda / 4 pi farther along: so far lies a point."""
    apart = 0.5
    slope = 4.0 * np.pi * apart / WAVELENGTH

    def made(phase: float) -> tuple[Collected, np.ndarray]:
        path = pattern_file(tmp_path / f"{phase:.0f}.csv", lambda *_: 1.0, lambda azimuth: phase * azimuth)
        planned = plan(collection={"mode": "stripmap", "resolution_m": (1.0, 1.0), "antenna": Antenna(pattern=path)})
        return points(planned, PLACE, ONE, "cpu"), planned.geometry.u

    (plain, axis), (moved, _) = made(0.0), made(slope)
    level = np.cross([0.0, 0.0, 1.0], plain.plan.geometry.d)
    sign = float(np.sign(level @ axis))
    found = peak_m(moved, PLACE[0], axis)[0] - peak_m(plain, PLACE[0], axis)[0]
    assert found == pytest.approx(-sign * apart, abs=0.02)  # angles grow along `level`


ALL = ("HH", "HV", "VH", "VV")
ERRORS = CollectionErrors(
    transmit=AntennaChannels(imbalance=(1.1, 0.2), v_in_h=(0.03, 0.01), h_in_v=(-0.02, 0.04)),
    receive=AntennaChannels(imbalance=(0.9, -0.1), v_in_h=(0.01, -0.05), h_in_v=(0.06, 0.0)),
)


def test_channels_mix_the_four_polarizations() -> None:
    """M = R S T, entry by entry: what channel r receives of wave a, that scatters from wave b, sent by channel t."""
    planned = plan(collection={"errors": ERRORS}, radar={"polarizations": ALL})
    amplitude = (np.random.default_rng(1).normal(size=(4, 1, 2)) @ [1.0, 1j]).astype(np.complex64)
    part = ScattererPart(np.zeros((1, 3)), amplitude, np.ones(len(planned.track), np.float32))
    made = recorded(planned, Scatterers((part,), 0.0), ALL, devices.resolve_device("cpu"))
    waves = dict(zip(ALL, amplitude[:, 0], strict=True))
    sent = {"HH": 1.0, "HV": 0.03 + 0.01j, "VH": -0.02 + 0.04j, "VV": 1.1 + 0.2j}  # channel, wave
    received = {"HH": 1.0, "HV": 0.01 - 0.05j, "VH": 0.06, "VV": 0.9 - 0.1j}
    for name, samples in zip(ALL, made.samples, strict=True):
        t, r = name
        wanted = sum(received[r + a] * waves[b + a] * sent[t + b] for a in "HV" for b in "HV")
        np.testing.assert_allclose(samples[:, 5], wanted, atol=2e-4)


def test_direct_images_have_the_same_channels() -> None:
    """A direct image is the backprojected one to 2 %, with the channels of its system, too."""
    images = []
    for focused in ("direct", "backprojection"):
        made = scene(
            field(8.0, 8.0),
            shape=(24, 24),
            spacing=(0.6, 0.6),
            radar={"polarizations": ALL, "terms": ("rough",)},
            collection={"errors": ERRORS, "focus": focused, "resolution_m": (1.0, 1.0), "scatterers_per_cell": 2.0},
        )
        images.append(np.stack(list(warpsar.slc(made, device="cpu")[0].images.values())))
    np.testing.assert_allclose(images[0], images[1], atol=0.03 * np.abs(images[1]).max())


@pytest.mark.parametrize("focused", ["direct", "backprojection"])
def test_noise_of_each_polarization_is_its_nesz(focused: str) -> None:
    """beta0 is sigma0 over the sine of the incidence: the mean of a dark image, to four standard errors."""
    nesz = {"HH": -20.0, "VV": -26.0}
    made = scene(
        field(4.0, 4.0),
        shape=(96, 96),
        spacing=(0.4, 0.4),
        radar={"polarizations": ("HH", "VV"), "terms": ("rough",)},
        collection={"nesz_db": nesz, "focus": focused, "scatterers_per_cell": 1.0},
    )
    (image,) = warpsar.slc(made, device="cpu")
    assert image.plan.noise_of("HH") == pytest.approx(10.0**-2.0 / np.sin(np.deg2rad(40.0)))
    for name, decibels in nesz.items():
        power = np.abs(image.images[name][:, :24]) ** 2  # beside the field
        wanted = 10.0 ** (decibels / 10.0) / np.sin(np.deg2rad(40.0))
        looks = power.size * (0.4 / 0.5) ** 2 / 1.4
        assert power.mean() == pytest.approx(wanted, rel=4.0 / np.sqrt(looks) + 0.02)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"focus": "direct", "errors": CollectionErrors(timing_s=1e-9)}, "errors of track, timing or frequency"),
        ({"focus": "direct", "azimuth_ambiguities": True, "pulses": 256}, "azimuth_ambiguities"),
        ({"errors": ERRORS}, "must be all four"),
        ({"nesz_db": {"VV": -20.0}}, "collection.nesz_db: found VV"),
    ],
)
def test_what_cannot_be_is_refused_by_name(more: dict[str, Any], message: str) -> None:
    made = scene(field(4.0, 4.0), collection=more, radar={"terms": ("rough",)})
    with pytest.raises(warpsar.InputError, match=message):
        warpsar.slc(made, device="cpu")


def test_a_two_way_pattern_has_one_antenna(tmp_path: Path) -> None:
    path = pattern_file(tmp_path / "pattern.csv", lambda *_: 1.0, lambda _: 0.0)
    apart = Transmitter(position_m=(2e3, 6e3, 8e3))
    with pytest.raises(warpsar.InputError, match="beside a transmitter"):
        plan(collection={"antenna": Antenna(pattern=path), "transmitter": apart})
    with pytest.raises(warpsar.InputError, match="must be azimuth_deg, or pattern"):
        Antenna(pattern=path, azimuth_deg=1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("azimuth_deg,phase_deg\n0,0\n", "must have azimuth_deg, gain_db"),
        ("azimuth_deg,gain_db\n0,0\n1,0\n3,0\n", "regular grid"),
        ("azimuth_deg,gain_db\n0,0\n1,nan\n", "not finite"),
        ("azimuth_deg,gain_db\n0,0\n100,0\n", "beyond 90 degrees"),
        ("azimuth_deg,gain_db\n1,0\n2,0\n", "must hold the beam's axis"),
    ],
)
def test_a_pattern_that_is_none(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "pattern.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(warpsar.InputError, match=message):
        read(path)


def test_a_track_error_must_hold_all_pulses(tmp_path: Path) -> None:
    path = tmp_path / "error.csv"
    path.write_text("time_s,x_m,y_m,z_m\n0,0,0,0\n1,0,0,0\n2,0,0,0\n3,0,0,0\n", encoding="utf-8")
    with pytest.raises(warpsar.InputError, match="must hold all pulses"):
        plan(collection={"errors": CollectionErrors(track=path)})


def test_the_tables_come_back_from_a_file(sines: Path, tmp_path: Path) -> None:
    """Names of files are relative to the scene file."""
    pattern = pattern_file(tmp_path / "pattern.csv", lambda *_: 1.0, lambda _: 0.0)
    errors = ERRORS.model_copy(update={"track": sines})
    table = {"errors": errors, "antenna": Antenna(pattern=pattern), "nesz_db": {"HH": -20.0}, "resolution_m": None}
    made = scene(field(4.0, 4.0), collection={**table, "bandwidth_hz": 2e8, "aperture_deg": 1.0})
    made.save(tmp_path / "scene.toml")
    text = (tmp_path / "scene.toml").read_text(encoding="utf-8")
    assert 'pattern = "pattern.csv"' in text
    assert 'track = "error.csv"' in text
    assert warpsar.Scene.load(tmp_path / "scene.toml").collection == made.collection
    sines.unlink()
    with pytest.raises(warpsar.InputError, match=r"collection.errors.track: found .*there is no such file"):
        warpsar.Scene.load(tmp_path / "scene.toml")
