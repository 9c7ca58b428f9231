"""How well a mesh is known: what `accuracy_m` of a scene or of an object grants, and what it does not excuse."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from test_pose import BOX, displaced, measured, scene_with

from warpsar.compare.judgement import Judgement
from warpsar.evaluation.command import evaluate
from warpsar.scene.scene import Scene

OFF_M = 0.45  # nearly a pixel of 0.5 m: edges and borders of the shadow change by much more than speckle of 16 looks
EAST, NORTH, UP = BOX["position_m"]


@pytest.fixture(scope="module")
def elsewhere() -> Scene:
    """Images of a box that stands `OFF_M` north of where the scene has it."""
    return displaced(measured(scene_with(BOX)), position_m=(EAST, NORTH - OFF_M, UP))


def judged(scene: Scene) -> Judgement:
    return evaluate(scene, device="cpu").verdicts["train"]


def test_a_box_that_stands_elsewhere_is_no_all_clear(elsewhere: Scene) -> None:
    found = judged(elsewhere)
    assert "edges" in found.findings
    # a slope is linear over a quarter of a pixel, so that what is told of a whole one is a lower bound, and a low one
    assert found.edges.together.allowed_m < found.edges.displacement_m < OFF_M


@pytest.mark.full
@pytest.mark.parametrize("whose", ["scene", "object"])
def test_a_stated_accuracy_grants_it(whose: str, elsewhere: Scene) -> None:
    known = replace(elsewhere, accuracy_m=0.3) if whose == "scene" else displaced(elsewhere, accuracy_m=0.3)
    assert judged(known).findings == []


@pytest.mark.full
@pytest.mark.parametrize("whose", ["scene", "object"])
def test_an_accuracy_of_a_tenth_of_it_does_not(whose: str, elsewhere: Scene) -> None:
    known = replace(elsewhere, accuracy_m=0.02) if whose == "scene" else displaced(elsewhere, accuracy_m=0.02)
    assert {"structure", "edges"} & set(judged(known).findings)


@pytest.mark.full
def test_an_accuracy_excuses_no_box_that_is_missing(elsewhere: Scene) -> None:
    """A box of another place altogether, 4 m off, is structure, whatever a tenth of that is granted."""
    far = displaced(elsewhere, position_m=(EAST, NORTH - 4.0, UP))
    assert "structure" in judged(replace(far, accuracy_m=0.3)).findings


@pytest.mark.parametrize("value", [0.0, -1.0, 1e3, "much"])
@pytest.mark.parametrize("where", ["[scene]", "[[objects]]"])
def test_a_bad_accuracy_is_refused_by_name(where: str, value: Any, tmp_path: Path) -> None:
    from warpsar.errors import InputError

    scene = scene_with(BOX)
    path = tmp_path / "scene.toml"
    scene.save(path)
    text = path.read_text()
    line = f'accuracy_m = "{value}"' if isinstance(value, str) else f"accuracy_m = {value}"
    if where == "[scene]":
        text = text.replace("[scene]", f"[scene]\n{line}", 1)
    else:
        text = text.replace("[[objects]]", f"[[objects]]\n{line}", 1)
    assert line in text
    path.write_text(text)
    with pytest.raises(InputError, match="accuracy_m"):
        Scene.load(path)


def test_accuracies_survive_saving(tmp_path: Path) -> None:
    scene = replace(displaced(scene_with(BOX), accuracy_m=0.25), accuracy_m=0.04)
    scene.save(tmp_path / "scene.toml")
    loaded = Scene.load(tmp_path / "scene.toml")
    assert loaded.accuracy_m == 0.04
    assert loaded.objects[0].accuracy_m == 0.25
