"""The library's manners: it prints nothing unasked, its objects show in one line, and `dir` shows what is public."""

from __future__ import annotations

import logging

import numpy as np
import pytest

import warpsar
from warpsar.runtime import console
from warpsar.simulation import SimulatedView
from warpsar.world.tables import Radar

pytestmark = pytest.mark.unit


@pytest.fixture
def unset(monkeypatch: pytest.MonkeyPatch) -> None:
    """The logger as a user's program finds it after `import warpsar`."""
    monkeypatch.setattr(console.LOGGER, "handlers", [])
    monkeypatch.setattr(console.LOGGER, "propagate", True)
    monkeypatch.setattr(console.LOGGER, "level", logging.NOTSET)


def scene() -> warpsar.Scene:
    image = np.ones((64, 64), np.float32)
    return warpsar.Scene(
        mesh=warpsar.Mesh.of({"lawn": ([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [(0, 1, 2), (0, 2, 3)])}),
        radar=warpsar.Radar(frequency_hz=9.6e9, polarizations=("HH",)),
        grid=warpsar.Grid(shape=(64, 64), spacing_m=(0.5, 0.5)),
        materials={"lawn": warpsar.Material(eps_r=6.0, rms_height_m=1e-3, correlation_length_m=1e-2)},
        views=[warpsar.View(name="a", azimuth_deg=0.0, incidence_deg=40.0, images={"HH": image})],
    )


@pytest.mark.usefixtures("unset")
def test_messages_of_a_library_call_go_to_the_logger(
    caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    with caplog.at_level(logging.INFO, logger="warpsar"):
        console.say("device: cpu")
        console.warn(["one", "100 %"])
    assert [(each.name, each.levelname, each.getMessage()) for each in caplog.records] == [
        ("warpsar", "INFO", "device: cpu"),
        ("warpsar", "WARNING", "one"),
        ("warpsar", "WARNING", "100 %"),
    ]
    assert capsys.readouterr() == ("", "")


@pytest.mark.usefixtures("unset")
def test_the_command_line_shows_them_on_stderr_once(capsys: pytest.CaptureFixture[str]) -> None:
    console.show_messages()
    console.show_messages()
    console.say("device: cpu")
    console.warn(["look here"])
    assert capsys.readouterr() == ("", "device: cpu\nwarning: look here\n")
    console.be_quiet(True)
    try:
        console.say("device: cpu")
        console.warn(["look here"])
    finally:
        console.be_quiet(False)
    assert capsys.readouterr() == ("", "warning: look here\n")


def test_a_scene_and_a_mesh_show_in_one_line() -> None:
    made = scene()
    assert repr(made) == "<Scene scene in memory: 1 view, 2 triangles>"
    assert repr(made.mesh) == "<Mesh: 2 triangles, 4 vertices, materials lawn>"


def test_a_table_shows_what_is_not_as_by_default() -> None:
    radar = Radar(frequency_hz=9.6e9, polarizations=("HH",), max_bounces=30)
    assert repr(radar) == "Radar(frequency_hz=9600000000.0, polarizations=('HH',))"
    assert repr(radar.model_copy(update={"max_bounces": 3})).endswith(", max_bounces=3)")
    view = warpsar.View(name="a", azimuth_deg=10.0, incidence_deg=40.0)
    assert repr(view) == str(view) == "View(name='a', azimuth_deg=10.0, incidence_deg=40.0)"


def test_results_show_in_one_line() -> None:
    image, axis = np.ones((64, 32), np.float32), np.arange(64.0)
    view = SimulatedView("a", {"HH": image}, axis, axis[:32], rays=10, hits=5)
    assert repr(view) == "<SimulatedView a: HH, 64 x 32 pixels, 10 rays>"


def test_dir_shows_public_names_alone() -> None:
    assert dir(warpsar) == sorted(warpsar.__all__)
