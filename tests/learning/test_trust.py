"""Do the intervals of a fit hold? Said first where they do not; nothing said where all is right."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learning_scenes import cube_scene, measured, noise_free, starting, views_at
from test_learn import save_scene

from warpsar.learning import command as learning
from warpsar.learning.learn import Learned, learn
from warpsar.learning.options import LearnOptions
from warpsar.learning.trust import doubts, outside_domains
from warpsar.scene.scene import Scene

ANGLES = ((20.0, 35.0), (140.0, 50.0))
ONCE = LearnOptions(starts=1)
Clean = tuple[Scene, list[dict[str, np.ndarray]]]


def truth() -> Scene:
    return cube_scene(views_at(*ANGLES))


@pytest.fixture(scope="module")
def clean() -> Clean:
    return truth(), noise_free(truth())


@pytest.fixture(scope="module")
def bouncing() -> Clean:
    """The same, with the double bounce of the cube's walls."""
    scene = replace(truth(), effects={"multibounce": {"strength": 1.0}})
    return truth(), noise_free(scene)


@pytest.fixture(scope="module")
def right(clean: Clean, tmp_path_factory: pytest.TempPathFactory) -> Learned:
    scene, images = clean
    return learn(starting(measured(scene, tmp_path_factory.mktemp("right"), images=images)), device="cpu", options=ONCE)


def ran(clean: Clean, folder: Path, **more: Any) -> dict[str, Any]:
    """learn.json of the scene with the images of `clean`."""
    scene, images = clean
    scene = starting(measured(scene, folder, images=images, **more))
    return learning.run(save_scene(scene, folder / "scene"), folder / "out", device="cpu", options=ONCE)


@pytest.mark.full
def test_a_missing_double_bounce_is_said_first(
    bouncing: Clean, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = ran(bouncing, tmp_path)
    assert content["intervals_hold"] is False
    assert any(reason.startswith("train views: structure is left") for reason in content["reasons"])
    assert content["verdict"]["train"]["finding"] == "structure"
    entry = content["materials"]["cube"]["eps_r"]
    assert entry["interval_holds"] is False
    assert len(entry["interval_95"]) == 2
    stored = json.loads((tmp_path / "out" / "learn.json").read_text())
    assert (stored["intervals_hold"], stored["reasons"]) == (False, content["reasons"])
    said = capsys.readouterr().err
    order = ["the intervals do not hold:", content["reasons"][0], "warpsar diagnose", "if the model were right:"]
    places = [said.index(words) for words in [*order, content["identifiability"]["words"][0]]]
    assert places == sorted(places)


@pytest.mark.full
def test_what_is_right_stays_silent(clean: Clean, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = ran(clean, tmp_path)
    assert content["intervals_hold"] is True
    assert content["reasons"] == []
    assert content["materials"]["cube"]["eps_r"]["interval_holds"] is True
    said = capsys.readouterr().err
    assert "intervals do not hold" not in said
    assert "diagnose" not in said


@pytest.mark.parametrize("seed", [*range(3), *(pytest.param(k, marks=pytest.mark.slow) for k in range(3, 20))])
def test_no_false_warning(seed: int, clean: Clean, tmp_path: Path) -> None:
    scene, images = clean
    found = learn(starting(measured(scene, tmp_path, images=images, seed=100 + seed)), device="cpu", options=ONCE)
    assert found.doubts == []
    assert found.verdicts["train"].finding == "speckle"


@pytest.mark.full
def test_a_wrong_test_view_alone_is_said(clean: Clean, tmp_path: Path) -> None:
    scene, images = clean
    scene = starting(measured(scene, tmp_path, images=images))
    last = scene.views[1].model_copy(update={"role": "test", "looks": 60.0})
    found = learn(replace(scene, views=[scene.views[0], last]), device="cpu", options=ONCE)
    assert found.verdicts["train"].finding == "speckle"
    assert found.doubts[0].startswith("test views: ")
    assert not any(reason.startswith("train views") for reason in found.doubts)


@pytest.mark.full
def test_bounds_are_named(right: Learned) -> None:
    problem, labels = right.problem, right.labels
    low, high = problem.bounds
    x = right.x.copy()
    x[labels.index("cube.rms_height_m")] = high[labels.index("cube.rms_height_m")]
    x[labels.index("ground.eps_r")] = low[labels.index("ground.eps_r")]
    assert doubts(problem, x, {}, right.domains) == [
        "ground.eps_r lies on its bound, 1.01",
        "cube.rms_height_m lies on its bound, 10",
    ]
    assert doubts(problem, right.x, {}, right.domains) == []


@pytest.mark.full
def test_a_bound_of_an_effect_is_named(clean: Clean, tmp_path: Path) -> None:
    """No floor is in the images, and one is declared: it goes to its lower bound."""
    scene, images = clean
    scene = measured(scene, tmp_path, images=images)
    found = learn(replace(scene, effects={"noise_floor": {"level": 1e-4}}), device="cpu", options=ONCE)
    problem = found.problem
    x = found.x.copy()
    x[-1] = problem.bounds[0][-1]
    assert doubts(problem, x, {}, found.domains)[-1].startswith("noise_floor.level lies on its bound, ")


@pytest.mark.full
def test_what_lies_outside_its_domain_is_named(right: Learned) -> None:
    """h of 10 mm at X band: kh = 2, and small perturbation ends at 0.3."""
    x = right.x.copy()
    x[right.labels.index("ground.rms_height_m")] = np.log(0.01)
    found = doubts(right.problem, x, {}, outside_domains(right.problem, x))
    assert found == ["ground lies outside its model's domain on 100 % of its lit area"]
