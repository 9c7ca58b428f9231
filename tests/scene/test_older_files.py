"""Files that version 0.1.0 wrote still load: a scene with all kinds of tables, its images, and the checkpoint of a fit.

`tests/data/from_0_1` was made by 0.1.0: the images by `simulate`, with speckle; the checkpoint by `learn`, four
iterations, one start.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import warpsar
from warpsar.io import checkpoint

OLD = Path(__file__).resolve().parents[1] / "data" / "from_0_1"


def test_a_scene_of_0_1_loads() -> None:
    scene = warpsar.Scene.load(OLD / "scene.toml")
    assert [(view.name, view.role, view.looks) for view in scene.views] == [
        ("north", "train", 16.0),
        ("west", "test", 16.0),
    ]
    assert list(scene.materials) == ["soil", "steel"]
    assert scene.materials["steel"].eps_r == (80.0, -20.0)
    assert scene.effects["noise_floor"]["level"] == 0.002
    assert [(one.label, list(one.position_m)) for one in scene.objects] == [("crate", [1.0, -1.0, 0.0])]


def test_a_checkpoint_of_0_1_is_resumed(tmp_path: Path) -> None:
    """The run had ended, so what is resumed ends at once, at the values that 0.1.0 found."""
    shutil.copy(OLD / "checkpoint.npz", tmp_path)
    scene = warpsar.Scene.load(OLD / "scene.toml")
    options = warpsar.LearnOptions(starts=1, iterations=4)
    found = warpsar.learn(scene, device="cpu", options=options, folder=tmp_path, resume=True)
    assert found.labels == ["soil.eps_r", "noise_floor.level"]
    np.testing.assert_allclose(found.x, [1.71878586, -11.4500228], rtol=1e-6)


def test_a_checkpoint_of_another_run_is_refused() -> None:
    with pytest.raises(warpsar.InputError, match="found a checkpoint of other input or options"):
        checkpoint.read(OLD, "another run")
