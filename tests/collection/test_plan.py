"""Tracks and bands: closed forms, and what is refused at the door."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from collected_scenes import FREQUENCY, SPOT, WAVELENGTH, field, scene

import warpsar
from warpsar.collection.plan import Plan, plan_of
from warpsar.collection.presets import PRESETS
from warpsar.world.collection import Collection, Transmitter
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.taper import width_in_cells

pytestmark = pytest.mark.unit

HOUSE = field(20.0, 20.0)


def plan(mesh: warpsar.Mesh = HOUSE, **more: object) -> Plan:
    made = scene(mesh, **more)
    wp.init()
    return plan_of(made, made.views[0], wp.get_device("cpu"))


def test_a_spotlight_flies_level_past_the_scene_on_its_right() -> None:
    track = plan().track
    s = np.array([np.sin(np.pi / 6) * np.sin(np.deg2rad(40)), np.cos(np.pi / 6) * np.sin(np.deg2rad(40))])
    middle = 0.5 * (track.receiver_m[0] + track.receiver_m[-1])
    assert middle[:2] == pytest.approx(10e3 * s)
    assert np.ptp(track.receiver_m[:, 2]) < 1e-6
    velocity = np.diff(track.receiver_m, axis=0) / np.diff(track.time_s)[:, None]
    assert np.linalg.norm(velocity, axis=1) == pytest.approx(np.full(len(velocity), 100.0))
    assert np.cross(velocity[0], -middle)[2] < 0.0  # toward the scene is clockwise of flight
    other = plan(collection={"side": "left"}).track
    assert other.receiver_m == pytest.approx(track.receiver_m[::-1])


def test_resolution_gives_band_and_aperture() -> None:
    """c / 2B and lambda / (4 sin(aperture / 2)), times the taper's width."""
    made = plan()
    assert made.bandwidth_hz == pytest.approx(width_in_cells("taylor") * SPEED_OF_LIGHT / (2 * 0.5))
    ends = np.array([made.track.receiver_m[0], made.track.receiver_m[-1]])
    unit = ends / np.linalg.norm(ends, axis=1, keepdims=True)
    aperture = np.arccos(unit[0] @ unit[1]) * len(made.track) / (len(made.track) - 1)
    cell = WAVELENGTH / (4 * np.sin(aperture / 2))
    assert width_in_cells("taylor") * cell == pytest.approx(0.5, rel=1e-3)
    assert made.cells_m[1] == pytest.approx(cell, rel=1e-3)


def test_widths_of_tapers() -> None:
    """Harris (1978), which gives three digits: 0.89 without a taper, 1.44 for Hann."""
    assert width_in_cells("none") == pytest.approx(0.89, abs=0.005)
    assert width_in_cells("hann") == pytest.approx(1.44, abs=0.005)


def test_squint_turns_the_track() -> None:
    made = plan(collection={"squint_deg": 20.0})
    way = made.track.straight
    assert way is not None
    assert way @ made.geometry.d == pytest.approx(np.sin(np.deg2rad(20.0)))
    assert way[2] == 0.0


def test_circle_and_turntable() -> None:
    made = plan(field(4.0, 4.0), collection={"mode": "circular", "resolution_m": None, "bandwidth_hz": 1e8})
    assert np.linalg.norm(made.track.receiver_m, axis=1) == pytest.approx(np.full(len(made.track), 10e3))
    azimuth = np.unwrap(np.arctan2(made.track.receiver_m[:, 0], made.track.receiver_m[:, 1]))
    assert np.rad2deg(np.ptp(azimuth)) == pytest.approx(360.0 * (1 - 1 / len(made.track)))
    turned = plan(field(4.0, 4.0), collection={"mode": "inverse", "aperture_deg": 5.0, "prf_hz": 100.0})
    assert np.diff(turned.track.time_s) == pytest.approx(np.full(len(turned.track) - 1, 0.01))


def test_a_stripmap_is_as_long_as_the_aperture_and_the_image() -> None:
    made = plan(collection={"mode": "stripmap", "resolution_m": None, "bandwidth_hz": 3e8, "aperture_deg": 1.0})
    length = np.linalg.norm(made.track.receiver_m[-1] - made.track.receiver_m[0]) * len(made.track)
    assert length / (len(made.track) - 1) == pytest.approx(2 * 10e3 * np.tan(np.deg2rad(0.5)) + 64 * 0.25, rel=1e-6)


def test_a_short_stripmap_is_finer_than_it_states() -> None:
    """docs/collections.md: each point is seen from all of the track, which is longer than the aperture by the image."""
    asked = {"point_spread": {"range_fwhm_m": 1.0, "azimuth_fwhm_m": 1.0, "window": "taylor"}}
    for slant_range_m, width_m in ((10e3, 0.52), (650e3, 0.99)):
        collection = {"mode": "stripmap", "resolution_m": None, "slant_range_m": slant_range_m}
        made = plan(collection=collection, shape=(128, 128), spacing=(1.0, 1.0), effects=asked)
        assert width_in_cells("none") * made.cells_m[1] == pytest.approx(width_m, abs=0.005)


@pytest.mark.parametrize("name", PRESETS)
def test_presets(name: str) -> None:
    carrier = {"x": 9.65e9, "c": 5.405e9, "l": 1.2365e9}[name[0]]
    made = scene(field(60.0, 60.0), radar={"frequency_hz": carrier}, shape=(16, 16), spacing=(2.0, 2.0))
    made = warpsar.Scene(**{**vars(made), "collection": Collection(preset=name)})
    found = plan_of(made, made.views[0], wp.get_device("cpu"))
    wanted = PRESETS[name]["resolution_m"]
    assert width_in_cells("taylor") * found.cells_m[0] <= wanted[0] * 1.001
    other = scene(field(60.0, 60.0), radar={"frequency_hz": 3e9}, collection={"preset": name})
    with pytest.raises(warpsar.InputError, match="carrier"):
        plan_of(other, made.views[0], wp.get_device("cpu"))


def test_csv_track(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    rows = [f"{0.01 * i},{-2.0 + 0.05 * i},-8000,6000" for i in range(81)]
    path.write_text("time_s,x_m,y_m,z_m\n" + "\n".join(rows) + "\n", encoding="utf-8")
    more = {"mode": "file", "trajectory": path, "resolution_m": None, "bandwidth_hz": 1e8}
    made = plan(field(4.0, 4.0), collection=more, reference_point_m=(1.0, 0.0, 0.0))
    assert made.track.receiver_m[0] == pytest.approx([-3.0, -8000, 6000])
    path.write_text("time_s,x_m,y_m\n0,0,0\n", encoding="utf-8")
    with pytest.raises(warpsar.InputError, match="must have time_s, x_m, y_m, z_m"):
        plan(collection=more)


@pytest.mark.parametrize(
    ("step", "more", "message"),
    [
        (0.0, {"bandwidth_hz": 1e8}, "in one direction all the time"),
        (0.05, {"resolution_m": (2.0, 0.5)}, "resolution_m: found 0.5 m in azimuth, but the track of"),
        (20.0, {"bandwidth_hz": 1e8}, "collection.trajectory: found 81 pulses, so far apart"),
    ],
)
def test_tracks_of_files_are_held_against_the_image(
    step: float, more: dict[str, object], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "track.csv"
    rows = [f"{0.01 * i},{step * i},-8000,6000" for i in range(81)]
    path.write_text("time_s,x_m,y_m,z_m\n" + "\n".join(rows) + "\n", encoding="utf-8")
    table = Collection(mode="file", trajectory=path, **more)
    made = replace(scene(HOUSE), collection=table)
    with pytest.raises(warpsar.InputError, match=message):
        plan_of(made, made.views[0], wp.get_device("cpu"))


def test_a_track_with_a_short_line_says_which(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    path.write_text("time_s,x_m,y_m,z_m\n0,0,-8000,6000\n1,0,-8000\n", encoding="utf-8")
    with pytest.raises(warpsar.InputError, match="pulse 2: found 3 cells; must be 4"):
        plan(collection={"mode": "file", "trajectory": path})


@pytest.mark.parametrize(
    ("mode", "key", "value"), [("circular", "squint_deg", 10.0), ("inverse", "squint_deg", 5.0), ("file", "pulses", 64)]
)
def test_a_key_that_a_mode_has_no_use_for_is_refused(mode: str, key: str, value: float) -> None:
    given = {"mode": mode, key: value} | ({"trajectory": Path("a.csv")} if mode == "file" else {})
    with pytest.raises(warpsar.InputError, match=f'found {key} with mode = "{mode}"'):
        Collection(**given)


REFUSED = {
    "below the mesh": ({"slant_range_m": 5.0, "aperture_deg": 10.0, "pulses": 64}, "under the ground"),
    "pulses too far apart": ({"pulses": 8}, "ambiguous"),
    "too few pulses a second": ({"prf_hz": 2.0}, "collection.prf_hz: found 2, 8 pulses"),
    "no pulse": ({"prf_hz": 1e-9, "azimuth_ambiguities": True}, "which gives 3.71e-09 pulses"),
    "pulses beyond number": ({"prf_hz": 1e12}, "must give 2 to 10000000"),
    "a transmitter in the scene": (
        {"transmitter": Transmitter(position_m=(0.0, 0.0, 0.0))},
        "from the reference point",
    ),
    "a transmitter behind": (
        {"transmitter": Transmitter(position_m=(-3000.0, -5e3, -8e3))},
        "degrees from the receiver",
    ),
    "a carrier beside the band": ({"start_hz": 1e9, "stop_hz": 1.4e9}, "must hold the carrier frequency, 9.6e"),
    "too few frequencies": ({"frequencies": 16}, "collection.frequencies"),
    "a band too narrow": ({"bandwidth_hz": 1e8}, "holds 1.78 m"),
    "an aperture too narrow": ({"aperture_deg": 1.0}, "takes an aperture"),
    "no range": ({"slant_range_m": None}, "slant_range_m: missing"),
    "no band": ({"resolution_m": None, "aperture_deg": 3.0}, "bandwidth_hz: missing"),
    "a band as wide as the carrier": ({"bandwidth_hz": 2 * FREQUENCY}, "below the carrier"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_collections_are_refused_in_one_message(case: str) -> None:
    more, message = REFUSED[case]
    mesh = field(20.0, 20.0, lambda x, y: 10.0 + 0.5 * y) if case == "below the mesh" else HOUSE
    with pytest.raises(warpsar.InputError, match=message) as refused:
        plan(mesh, collection=more)
    assert "\n" not in str(refused.value)


def test_the_table_is_read_checked_and_written(tmp_path: Path) -> None:
    made = scene(HOUSE)
    path = tmp_path / "scene.toml"
    made.save(path)
    again = warpsar.Scene.load(path)
    assert again.collection == made.collection
    assert again.collection is not None
    assert again.collection.resolution_m == SPOT["resolution_m"]
    text = path.read_text(encoding="utf-8")
    for bad, message in (
        ('mode = "around"', "collection.mode"),
        ("antenna = { wide_deg = 3.0 }", "must be one of azimuth_deg, elevation_deg"),
        ("start_hz = 1e9", "a part of a band"),
        ('mode = "file"', "go together"),
        ("velocity_m_s = { car = [1.0, 0.0, 0.0] }", "must name one of"),
    ):
        wrong = text.replace('mode = "spotlight"\n', "" if bad.startswith("mode") else 'mode = "spotlight"\n')
        path.write_text(wrong.replace("[collection]\n", f"[collection]\n{bad}\n"), encoding="utf-8")
        with pytest.raises(warpsar.InputError, match=message):
            warpsar.Scene.load(path)
