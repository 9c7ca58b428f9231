"""A change of geometry is one file: what everybody asks of it, the search, the scene and the words take from there.

The change that is added here, a body that leans, is in no file of the package.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import ClassVar

import numpy as np
import pytest
from test_diagnose_geometry import QUICK, case, fitted_of, moved, true_scene

from warpsar.diagnosis.command import run
from warpsar.diagnosis.geometry import registry
from warpsar.diagnosis.geometry.base.body import MovedBody
from warpsar.diagnosis.models.all_pixels import Exact
from warpsar.diagnosis.models.change import BodyDifference
from warpsar.diagnosis.search.geometry_confirmation import asked_of, taken_back
from warpsar.diagnosis.turn.geometry_search import screening
from warpsar.diagnosis.written_scene import annotate
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Learnable, Object

__all__ = ["moved"]  # a fixture

LEANING = {"pitch_deg": 15.0}


class ObjectTilt(MovedBody):
    """Pitch and roll of a body."""

    name = "object_tilt"
    order = 25
    summary = "an object of the scene leans"
    frees = 2
    keys: ClassVar[frozenset[str]] = frozenset({"pitch_deg", "roll_deg"})
    commented = ("pitch_deg", "roll_deg")

    def is_of(self, difference: BodyDifference) -> bool:
        return bool(difference.keys) and difference.keys <= self.keys

    def words(self, one: Object) -> tuple[Learnable, ...]:
        return ("pitch", "roll")


@pytest.fixture
def tilt(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The registry with one more file in its folder."""
    module = ModuleType("warpsar.diagnosis.geometry.object_tilt")
    module.CHANGE = ObjectTilt()  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    files = (*registry.names(), "object_tilt")
    monkeypatch.setattr(registry, "names_in", lambda _: files)
    registry.names.cache_clear()
    yield
    for asked in (registry.names, registry.get):
        asked.cache_clear()


@pytest.mark.unit
def test_every_change_says_what_is_asked() -> None:
    orders = [registry.get(name).order for name in registry.names()]
    assert orders == sorted(set(orders))
    assert [registry.get(name).name for name in registry.names()] == list(registry.names())
    page = (Path(__file__).resolve().parents[2] / "docs" / "diagnosis.md").read_text(encoding="utf-8")
    assert [name for name in registry.names() if f"`{name}`" not in page] == []


def test_a_new_change_is_named_freed_and_taken_back(tilt: None, tmp_path: Path) -> None:
    scene, leaning = true_scene(), true_scene(**LEANING)
    assert registry.changes(scene, leaning) == ["object_tilt hut"]
    assert registry.summary_of("object_tilt") == "an object of the scene leans"
    assert registry.coordinates(scene, leaning) == ["objects.hut.pitch_deg", "objects.hut.roll_deg"]
    assert registry.changes(scene, registry.without_change(scene, leaning, "object_tilt hut")) == []
    again = registry.scene_with(scene, scene, json.loads(json.dumps(registry.content(scene, leaning))))
    np.testing.assert_array_equal(again.mesh.vertices, leaning.mesh.vertices)
    both = true_scene(**LEANING, position_m=(0.5, 0.0, 0.0))
    assert registry.changes(scene, both) == ["object_pose hut"]
    path = tmp_path / "scene.toml"
    path.write_text('[[objects]]\ngroup = "hut"\npitch_deg = 15.0\n')
    annotate(path, {"hut": {"pitch_sd_deg": 0.25}})
    assert "pitch_deg = 15.0 # standard deviation 0.25\n" in path.read_text()


def test_a_new_change_is_screened_beside_the_others(tilt: None, moved: Scene) -> None:
    """Its columns stand beside those of the others, which are foretold what they were."""
    setup, fitted = fitted_of(moved)
    exact = Exact.of(setup, fitted)
    found = {one.name: one for one in screening(moved, exact, fitted, alarm=False)}
    assert [one.numbers for name, one in found.items() if name.endswith(" hut")] == [4, 3, 2]
    assert found["object_pose hut"].foretold > found["object_tilt hut"].foretold > 0.0


@pytest.mark.full
def test_a_new_change_is_found(tilt: None, tmp_path: Path) -> None:
    """A hut that leans by 15 degrees is named so, to within four standard deviations."""
    scene = case(tmp_path / "scene", true_scene(**LEANING))
    assert scene.path is not None
    content = run(scene.path, tmp_path / "out", device="cpu", options=QUICK)
    assert content["verdict"] == ["object_tilt"]
    hut = content["objects"]["hut"]
    assert abs(hut["pitch_deg"] - LEANING["pitch_deg"]) < 4.0 * hut["pitch_sd_deg"] < 1.0
    (step,) = content["steps"]
    assert (step["effect"], step["object"], step["refit_size"]) == ("object_tilt", "hut", 2)
    written = Scene.load(tmp_path / "out" / "scene.toml")
    assert written.objects[0].pitch_deg == hut["pitch_deg"]
    assert "object_tilt of hut: an object of the scene leans" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.full
def test_a_new_change_is_asked_beside_all_others(tilt: None, tmp_path: Path) -> None:
    declared = case(tmp_path, true_scene(**LEANING))
    leaning = registry.scene_with(declared, declared, registry.content(true_scene(), true_scene(**LEANING)))
    setup, fitted = fitted_of(leaning)
    without = taken_back(setup, fitted, declared, "object_tilt hut")
    answer = asked_of(setup, fitted, without, declared, "object_tilt hut")
    assert answer.size == 2
    assert answer.gain > 100.0
