"""Test views that the train views do not foretell: their surface is open, or something is missing there."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from learning_scenes import START, cube_scene, measured
from worlds import view

from warpsar.diagnosis.command import in_short
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.result import Diagnosed, diagnose
from warpsar.io.images import read_image, write_tiff
from warpsar.scene.scene import Scene
from warpsar.world.tables import Material

# three train views look from one incidence: of a surface they tell one level for each polarization
ANGLES = (
    (15.0, 35.0, "train"),
    (135.0, 35.0, "train"),
    (250.0, 35.0, "train"),
    (330.0, 56.0, "test"),
    (70.0, 57.0, "test"),
)


def scene_in(folder: Path) -> Scene:
    views = [view(a, i, name=f"v{k}", role=role) for k, (a, i, role) in enumerate(ANGLES)]
    scene = measured(cube_scene(views, polarizations=("HH",), shape=44), folder)
    return replace(scene, materials={name: Material(**START[name]) for name in START})


def of(scene: Scene) -> Diagnosed:
    return diagnose(scene, device="cpu", options=DiagnoseOptions(draws=400, starts=1))


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Diagnosed:
    return of(scene_in(tmp_path_factory.mktemp("open")))


@pytest.mark.full
def test_a_surface_that_train_views_leave_open_is_no_missing_effect(opened: Diagnosed) -> None:
    assert (opened.verdict, opened.unexplained) == ([], False)
    assert opened.foretold is not None
    assert {"structure", "level"} & set(opened.foretold.findings)
    assert opened.foretold.deviance > 2.0
    # 500 pixels that are no edges: 0.09 of the mean deviance
    assert opened.verdicts["test"].deviance == pytest.approx(1.0, abs=0.3)
    assert "the train views leave the surface open" in in_short(opened)
    assert "test views, by the surface that the train views tell: structure is left" in opened.open_surface


@pytest.mark.full
def test_an_open_surface_excuses_nothing_else(tmp_path: Path) -> None:
    """A patch in a test view, 6 dB too bright, on ground that another test view sees, too."""
    scene = scene_in(tmp_path)
    path = scene.views[3].images["HH"]
    image = read_image(path).squeeze().copy()
    image[18:26, 6:14] *= 4.0
    write_tiff(path, image.astype(np.float32))
    found = of(scene)
    assert found.unexplained
    assert found.foretold is None
    assert any(one.startswith("test views: structure is left") for one in found.reasons)
