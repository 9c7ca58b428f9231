"""`warpsar diagnose` on the cases of an independent renderer: exactly what is missing, and its parameters."""

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from warpsar.compare.comparison import Comparison
from warpsar.compare.metrics import pool
from warpsar.diagnosis.result import Diagnosed, diagnose
from warpsar.scene.scene import Scene
from warpsar.surface.surface import KEYS

pytestmark = pytest.mark.slow
NAMES = ("none", "noise_floor", "multibounce", "point_spread", "registration", "antenna_pattern")


@cache
def diagnosed(folder: Path) -> Diagnosed:
    return diagnose(Scene.load(folder / "scene.toml"), device="cpu")


def true_effect(key: str, value: Any) -> dict[str, dict[str, Any]]:
    """An effect of truth.json as scene.toml states it (the cases' README)."""
    if key == "antenna":  # phi = (X . v) / R0
        beamwidth_m, boresight_m = (value[0] * np.deg2rad(angle) for angle in value[1:])
        return {"antenna_pattern": {"beamwidth_m": beamwidth_m, "boresight_m": boresight_m}}
    if key == "registration_m":
        return {"registration": {"range_m": value[0], "azimuth_m": value[1]}}
    if key == "point_spread":
        return {key: {"range_fwhm_m": value[0], "azimuth_fwhm_m": value[1], "window": "gaussian"}}
    if key == "multibounce":
        return {key: {"strength": 1.0, "max_bounces": value, "reflection": "lobe"}}
    return {key: {"level": value}}


def truth_of(folder: Path, scene: Scene) -> Scene:
    """The scene with the true materials and effects."""
    truth = json.loads((folder / "truth.json").read_text())
    materials = {
        name: scene.materials[name].model_copy(update=dict(zip(KEYS, values, strict=True)))
        for name, values in truth["materials"].items()
    }
    effects: dict[str, dict[str, Any]] = {}
    for key, value in truth["effects"].items():
        effects |= true_effect(key, value)
    return replace(scene, materials=materials, effects=effects)


@pytest.mark.parametrize("name", NAMES)
def test_exactly_what_is_missing_is_named(name: str, independent_cases: Path) -> None:
    done = diagnosed(independent_cases / name)
    assert done.verdict == ([] if name == "none" else [name])
    assert done.reasons == []


def on_the_same_pixels(ours: Sequence[Comparison], true: Sequence[Comparison]) -> tuple[float, float]:
    """Mean scaled deviance of both over the pixels that both compare: a shift that is 3 mm off lights other borders."""
    found = np.zeros(2)
    pixels = 0
    for pair in zip(ours, true, strict=True):
        both = pair[0].interior & pair[1].interior
        assert both.sum() > 0.999 * max(one.interior.sum() for one in pair)
        found += [one.scaled_deviance[both[one.interior]].sum() for one in pair]
        pixels += int(both.sum())
    return tuple(found / pixels)


@pytest.mark.parametrize("name", NAMES)
def test_held_out_error_falls_to_that_of_the_true_model(name: str, independent_cases: Path) -> None:
    """Mean deviance on the test views, the same pixels and rays for both: within 3 standard errors."""
    folder = independent_cases / name
    done = diagnosed(folder)
    judged = [
        done.diagnosis.judge(s, "test") for s in (done.diagnosis.final.scene, truth_of(folder, done.diagnosis.scene))
    ]
    stated = pool(judged[1])
    assert done.after["test"] is not None
    assert stated is not None
    ours, true = on_the_same_pixels(*judged)
    assert done.after["test"]["deviance"] == pytest.approx(ours, abs=1e-3)
    assert abs(ours - true) < 3 * stated["deviance_error"]
    assert true == pytest.approx(1.0, abs=0.02 + 3 * stated["deviance_error"])


def parameters(name: str, folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """(found, true) tables of the effect."""
    done = diagnosed(folder / name)
    return done.diagnosis.final.scene.effects[name], truth_of(folder / name, done.diagnosis.scene).effects[name]


def test_noise_level_is_found(independent_cases: Path) -> None:
    found, true = parameters("noise_floor", independent_cases)
    assert found["level"] == pytest.approx(true["level"], rel=0.05)


def test_shift_is_found(independent_cases: Path) -> None:
    found, true = parameters("registration", independent_cases)
    for key in ("range_m", "azimuth_m"):
        assert found.get(key, 0.0) == pytest.approx(true[key], abs=0.05)


def test_widths_are_found(independent_cases: Path) -> None:
    found, true = parameters("point_spread", independent_cases)
    for key in ("range_fwhm_m", "azimuth_fwhm_m"):
        assert found[key] == pytest.approx(true[key], rel=0.15)


def test_beam_is_found(independent_cases: Path) -> None:
    found, true = parameters("antenna_pattern", independent_cases)
    assert found["beamwidth_m"] == pytest.approx(true["beamwidth_m"], rel=0.15)


def test_the_tower_that_stands_elsewhere_is_found(independent_cases: Path) -> None:
    """Its group of the mesh is tried without being declared: within 5 cm and 0.5 degrees, and nothing else is named."""
    folder = independent_cases / "moved_object"
    done = diagnosed(folder)
    assert done.diagnosis.verdict == ["object_pose"]
    assert not done.diagnosis.unexplained
    _, east, north, turn = json.loads((folder / "truth.json").read_text())["effects"]["moved"]
    found = done.diagnosis.objects["tower"]
    np.testing.assert_allclose(found["position_m"], (-east, -north, 0.0), atol=0.05)
    assert found["heading_deg"] == pytest.approx(turn, abs=0.5)
    after = done.after["test"]
    assert after is not None
    assert after["deviance"] == pytest.approx(1.0, abs=0.02 + 3 * after["deviance_error"])


def test_an_object_that_the_scene_lacks_is_no_other_objects_pose(independent_cases: Path) -> None:
    done = diagnosed(independent_cases / "missing_object").diagnosis
    assert not {"object_pose", "absent_object"} & set(done.verdict)
    assert done.unexplained or done.verdict == ["missing_object"]
