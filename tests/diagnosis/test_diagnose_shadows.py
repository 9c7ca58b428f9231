"""Shadows that measure power where nothing lies far from what is lit: a floor, a body that is absent, and a blur all
put it there, and each gets its own name."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from learning_scenes import measured
from worlds import BRICK, SOIL, box, ground, mesh_of, scene_of, view

from warpsar.diagnosis.result import Diagnosed, diagnose
from warpsar.scene.scene import Scene
from warpsar.world.mesh import Mesh

SIDES = ((10, 40, "train"), (100, 45, "train"), (190, 50, "train"), (280, 40, "train"), (55, 44, "test"))
"""Four incidences, by which lit pixels tell a floor from a surface."""
ONE_INCIDENCE = tuple((azimuth, 45, role) for azimuth, _, role in SIDES)
"""By which they do not: a floor is told in shadows alone."""
HUT = box((-7.0, 2.0, 0.0), (-4.0, 6.0, 3.0))


def town(sides: Any = SIDES) -> Scene:
    """Level ground wider than the images, with a hut, whose shadow is six pixels long, and no floor declared."""
    views = [view(azimuth, incidence, name=f"v{k}", role=role) for k, (azimuth, incidence, role) in enumerate(sides)]
    materials = {"ground": SOIL, "hut": BRICK}
    mesh = mesh_of(ground=ground(30), hut=HUT)
    return scene_of(mesh, views, shape=(44, 40), spacing_m=(0.5, 0.5), materials=materials)


def diagnosed(folder: Path, effects: dict[str, Any], sides: Any = SIDES, mesh: Mesh | None = None) -> Diagnosed:
    """The town beside images that have `effects`, or another `mesh`, besides."""
    scene = town(sides)
    truth = replace(scene, effects=effects)
    if mesh is not None:
        truth = replace(truth, mesh=mesh, materials={name: scene.materials[name] for name in mesh.materials})
    given = measured(truth, folder, looks=16.0, seed=3)
    return diagnose(replace(scene, views=given.views), device="cpu")


@pytest.mark.full
@pytest.mark.parametrize(("level", "sides"), [(0.02, SIDES), (0.003, SIDES), (0.02, ONE_INCIDENCE)])
def test_a_floor_shows_in_short_shadows(level: float, sides: Any, tmp_path: Path) -> None:
    """The ground has some 0.02. A fifth of the level: shadows of 85 pixels and 16 looks tell it to 3 %, and what leaks
    from lit pixels adds to a weak one."""
    found = diagnosed(tmp_path, {"noise_floor": {"level": level}}, sides)
    assert (found.verdict, found.unexplained) == (["noise_floor"], False)
    table = found.diagnosis.final.scene.effects["noise_floor"]
    assert table["level"] == pytest.approx(level, rel=0.2)


@pytest.mark.full
def test_an_absent_body_is_no_floor(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, {}, mesh=mesh_of(ground=ground(30)))
    assert (found.verdict, found.unexplained) == (["absent_object"], False)


@pytest.mark.full
def test_a_blur_is_no_floor(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, {"point_spread": {"range_fwhm_m": 1.3, "azimuth_fwhm_m": 1.2}})
    assert (found.verdict, found.unexplained) == (["point_spread"], False)
