"""Errors that are hidden in a measured study: each changes what it says, and leaves a scene file that loads."""

from typing import Any

import pytest
import tomlkit
from conftest import ROOT, benchmark

from warpsar.world.objects.table import Object


@pytest.fixture
def document() -> Any:
    text = (ROOT / "examples" / "measured" / "btr70" / "scene.toml").read_text(encoding="utf-8")
    found = tomlkit.parse(text)
    views = tomlkit.aot()
    for azimuth in (10.0, 358.5):
        views.append(tomlkit.item({"azimuth_deg": azimuth}))
    found["views"] = views
    return found


@pytest.fixture(scope="module")
def hidden() -> Any:
    return benchmark("measured_hidden")


def spoiled(hidden: Any, document: Any, name: str) -> dict[str, Any]:
    """The scene file with the error of a trial, written and read again."""
    hidden.TRIALS[name][1](document)
    return tomlkit.parse(tomlkit.dumps(document)).unwrap()


@pytest.mark.parametrize(
    ("name", "azimuths"), [("nothing", [10.0, 358.5]), ("azimuths", [13.0, 1.5]), ("reversed", [350.0, 1.5])]
)
def test_azimuths_are_wrong_as_said(hidden: Any, document: Any, name: str, azimuths: list[float]) -> None:
    assert [view["azimuth_deg"] for view in spoiled(hidden, document, name)["views"]] == azimuths


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("length", "scale", [1.1, 1.0, 1.0]),
        ("front", "front", "+X"),
        ("truck", "primitive", "truck"),
        ("box", "primitive", "box"),
    ],
)
def test_the_vehicle_is_wrong_as_said(hidden: Any, document: Any, name: str, key: str, value: Any) -> None:
    before = document.unwrap()["objects"]
    ground, vehicle = spoiled(hidden, document, name)["objects"]
    assert ground == before[0]
    assert vehicle[key] == value
    assert vehicle != before[1]
    if "primitive" in vehicle:
        Object.model_validate(vehicle)  # no key of the mesh is left


def test_a_scene_without_a_vehicle_is_refused(hidden: Any) -> None:
    with pytest.raises(LookupError):
        hidden.body({"objects": [{"primitive": "box", "learn": ["heading"]}]})
