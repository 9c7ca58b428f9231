"""Declared effects whose parameters a fit holds: `fixed = true` and `learn = [...]` in their tables."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effect_worlds import refusal
from learning_scenes import cube_scene, measured, starting, views_at
from test_diagnose import QUICK, scene_with

import warpsar
from warpsar.diagnosis.result import diagnose
from warpsar.effects.registry import get, names, validate
from warpsar.errors import InputError
from warpsar.evaluation.report import identified_words
from warpsar.learning.learn import LearnOptions, learn
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.surface.stage import Stage

BLUR = {"range_fwhm_m": 0.9, "azimuth_fwhm_m": 0.7, "window": "gaussian"}
START = {"range_fwhm_m": 0.7, "azimuth_fwhm_m": 1.0, "window": "gaussian"}  # of a fit that is wrong in both
SLOPE = {"per_m_east": 0.08, "per_m_north": -0.05}
OPTIONS = LearnOptions(starts=1, iterations=6)


@pytest.fixture(scope="module")
def blurred(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Two train views of a cube on a plane, whose images are blurred."""
    truth = cube_scene(views_at((20.0, 40.0), (140.0, 50.0)), polarizations=("HH",))
    truth = replace(truth, effects={"point_spread": dict(BLUR)})
    return starting(measured(truth, tmp_path_factory.mktemp("blurred")))


def declaring(scene: Scene, **tables: dict[str, Any]) -> Scene:
    return replace(scene, effects={name: validate(name, table, f"effects.{name}") for name, table in tables.items()})


def test_what_is_fixed_does_not_move(blurred: Scene) -> None:
    scene = declaring(blurred, point_spread={**START, "fixed": True}, noise_floor={"level": 1e-3})
    found = learn(scene, device="cpu", options=OPTIONS)
    assert found.scene.effects["point_spread"] == scene.effects["point_spread"]
    assert found.scene.effects["noise_floor"]["level"] != 1e-3
    assert [label for label in found.labels if label.startswith("point_spread")] == []
    assert found.identified is not None
    assert "noise_floor.level" in found.identified.labels
    assert not any("point_spread" in words for words in found.identified.words)
    assert found.scene.materials["ground"].eps_r != blurred.materials["ground"].eps_r


def test_only_what_learn_names_moves(blurred: Scene) -> None:
    scene = declaring(blurred, point_spread={**START, "learn": ["azimuth_fwhm_m"]})
    found = learn(scene, device="cpu", options=OPTIONS)
    table = found.scene.effects["point_spread"]
    assert {key for key in table if table[key] != scene.effects["point_spread"][key]} == {"azimuth_fwhm_m"}
    assert table["azimuth_fwhm_m"] == pytest.approx(BLUR["azimuth_fwhm_m"], abs=0.1)
    assert [label for label in found.labels if label.startswith("point_spread")] == ["point_spread.azimuth_fwhm_m"]


@pytest.mark.parametrize("held", [{"fixed": True}, {"learn": []}, {"fixed": True, "learn": []}])
def test_an_effect_alone_and_held_leaves_nothing_to_learn(held: dict[str, Any], blurred: Scene) -> None:
    scene = declaring(blurred, point_spread={**BLUR, **held})
    still = {name: material.model_copy(update={"learn": ()}) for name, material in scene.materials.items()}
    scene = replace(scene, materials=still)
    with pytest.raises(InputError, match="nothing to learn: every `learn` is empty, and no effect's parameter is"):
        learn(scene, device="cpu", options=OPTIONS)
    _, words = identified_words(scene, Stage.of(scene, devices.resolve_device("cpu")), 256.0)
    assert "Nothing is to be learned here" in words[0]


@pytest.mark.parametrize("said", [{}, {"fixed": False}, {"learn": ["range_fwhm_m", "azimuth_fwhm_m"]}])
def test_by_default_what_is_stated_is_fitted(said: dict[str, Any], blurred: Scene) -> None:
    problem = FitProblem(declaring(blurred, point_spread={**START, **said}), devices.resolve_device("cpu"))
    assert problem.labels[-2:] == ["point_spread.range_fwhm_m", "point_spread.azimuth_fwhm_m"]


def test_a_gain_of_single_views_is_held_whole(blurred: Scene) -> None:
    gains = {"gain_db": {"v0": 1.0, "v1": -1.0}}
    for said, count in (({}, 2), ({"learn": ["gain_db"]}, 2), ({"learn": []}, 0), ({"fixed": True}, 0)):
        problem = FitProblem(declaring(blurred, view_gain={**gains, **said}), devices.resolve_device("cpu"))
        assert len(problem.effect_coordinates) == count


def test_images_do_not_depend_on_what_is_held(blurred: Scene) -> None:
    plain, held = (
        warpsar.simulate(declaring(blurred, point_spread={**BLUR, **said}), device="cpu")
        for said in ({}, {"learn": ["range_fwhm_m"]})
    )
    for one, other in zip(plain, held, strict=True):
        np.testing.assert_array_equal(one.beta0["HH"], other.beta0["HH"])


@pytest.mark.parametrize("said", [{"fixed": True}, {"fixed": False}, {"learn": []}, {"learn": ["range_fwhm_m"]}])
def test_a_saved_scene_keeps_what_is_held(said: dict[str, Any], tmp_path: Path) -> None:
    scene = declaring(scene_with({}, tmp_path), point_spread={**BLUR, **said})
    scene.save(tmp_path / "again.toml")
    assert tomllib.loads((tmp_path / "again.toml").read_text())["effects"]["point_spread"] == {**BLUR, **said}
    again = Scene.load(tmp_path / "again.toml")
    assert again.effects == scene.effects
    again.save(tmp_path / "third.toml")
    assert (tmp_path / "third.toml").read_text() == (tmp_path / "again.toml").read_text()


STATED = "allowed are parameters that this table states"


@pytest.mark.parametrize(
    ("name", "table", "message"),
    [
        ("noise_floor", {"level": 1.0, "fixed": 1}, "noise_floor.fixed: found 1; allowed is true or false"),
        ("noise_floor", {"level": 1.0, "fixed": "yes"}, "noise_floor.fixed: found 'yes'; allowed is true or false"),
        ("noise_floor", {"level": 1.0, "learn": "level"}, f"learn: found 'level'; allowed is a list; {STATED} (level)"),
        ("noise_floor", {"level": 1.0, "learn": True}, "noise_floor.learn: found True; allowed is a list"),
        ("noise_floor", {"level": 1.0, "learn": ["floor"]}, f"learn: found 'floor'; {STATED} (level)"),
        ("noise_floor", {"learn": ["level"]}, f"learn: found 'level'; {STATED} (it states none)"),
        ("noise_floor", {"level": 1.0, "learn": [["level"]]}, f"learn: found ['level']; {STATED}"),
        ("point_spread", {**BLUR, "learn": ["window"]}, f"found 'window'; {STATED} (range_fwhm_m, azimuth_fwhm_m)"),
        (
            "noise_floor",
            {"level": 1.0, "fixed": True, "learn": ["level"]},
            "effects.noise_floor: found fixed = true and learn = ['level']; allowed is one of them",
        ),
    ],
)
def test_refuses(name: str, table: dict[str, Any], message: str) -> None:
    assert message in refusal(name, table)


@pytest.mark.parametrize("name", names())
def test_no_effect_has_keys_of_these_names(name: str) -> None:
    effect = get(name)
    assert {"fixed", "learn"}.isdisjoint(each.name for each in (*effect.parameters, *effect.settings))


@pytest.mark.full
def test_diagnose_holds_what_is_declared_and_fixed_and_fits_what_it_adds(tmp_path: Path) -> None:
    held = {**BLUR, "fixed": True}
    scene = scene_with({"eps_gradient": SLOPE, "point_spread": BLUR}, tmp_path)
    scene = declaring(scene, point_spread=held)
    done = diagnose(scene, device="cpu", options=QUICK).diagnosis
    assert done.verdict == ["eps_gradient"]
    for fitted in (done.declared, done.final, *(turn.base for turn in done.turns)):
        assert fitted.scene.effects["point_spread"] == held
        assert not any("point_spread" in label for label in fitted.problem.labels)
    assert set(done.final.scene.effects["eps_gradient"]) == set(SLOPE)
    assert {f"eps_gradient.{key}" for key in SLOPE} <= set(done.final.problem.labels)


@pytest.mark.full
def test_diagnose_of_a_model_of_which_nothing_is_fitted(tmp_path: Path) -> None:
    """Surface and blur are known: what is missing is still found, and nothing else moves."""
    scene = declaring(scene_with({"eps_gradient": SLOPE, "point_spread": BLUR}, tmp_path), point_spread=BLUR)
    scene = replace(scene, effects={"point_spread": {**BLUR, "fixed": True}})
    true = cube_scene([], polarizations=("HH",)).materials
    known = {name: material.model_copy(update={"learn": ()}) for name, material in true.items()}
    done = diagnose(replace(scene, materials=known), device="cpu", options=QUICK).diagnosis
    assert done.verdict == ["eps_gradient"]
    assert done.declared.x.size == 0
    assert done.final.scene.materials == known


@pytest.fixture(scope="module")
def uneven(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Two train views and two test views, v0 to v3, none calibrated like another."""
    views = [
        view.model_copy(update={"role": role})
        for view, role in zip(
            views_at((20.0, 40.0), (140.0, 50.0), (80.0, 45.0), (250.0, 42.0)),
            ("train", "train", "test", "test"),
            strict=True,
        )
    ]
    truth = cube_scene(views, polarizations=("HH",))
    return measured(truth, tmp_path_factory.mktemp("uneven"))


@pytest.mark.parametrize(
    ("gains", "roles", "summed"),
    [
        ({"v0": 0.5, "v1": -1.0}, ("train",), [["v0", "v1"]]),
        ({"v1": -1.0}, ("train",), []),  # v0 holds the level
        ({"v0": 0.5, "v1": -0.5, "v2": 1.0, "v3": 0.5}, ("test",), []),  # train views hold it
        ({"v2": 1.0, "v3": 0.5}, ("test",), [["v2", "v3"]]),
    ],
)
def test_gains_are_free_where_other_views_hold_the_level(
    gains: dict[str, float], roles: tuple[str, ...], summed: list[list[str]], uneven: Scene
) -> None:
    """And the loss's slope to each is what the loss does, whatever mean is taken off."""
    problem = FitProblem(declaring(uneven, view_gain={"gain_db": gains}), devices.resolve_device("cpu"), roles=roles)
    assert list(problem.zero_sums.values()) == summed
    x, step = problem.x0, 0.02
    _, slope = problem.gradient(x)
    fitted = range(problem.learned.size, x.size)
    assert len(fitted) == len([name for name in gains if name in {view.view.name for view in problem.views}])
    for column in fitted:
        ends = x + np.outer((-1.0, 1.0), np.eye(x.size)[column]) * step
        low, high = (problem.loss_at(end) for end in ends)
        # the loss is a sum over some 1,000 pixels in float32, curved over a step of 0.06 dB
        assert slope[column] == pytest.approx((high - low) / (2.0 * step), rel=5e-3, abs=0.05)
