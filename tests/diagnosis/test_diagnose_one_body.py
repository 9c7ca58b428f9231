"""A scene with one body and short shadows, as a first one often is. Shadows that measure power may be a floor, a body
that is absent, or a blur; and what moves the body in every image may be the body or the images. Each has its name."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learning_scenes import measured
from one_body import SIDES, town, views
from worlds import box, ground, mesh_of

from warpsar.diagnosis.result import Diagnosed, diagnose
from warpsar.parameters.at import at
from warpsar.world.mesh import Mesh

ONE_INCIDENCE = tuple((azimuth, 45, role) for azimuth, _, role in SIDES)
"""By which lit pixels do not tell a floor from a surface: it is told in shadows alone."""


def diagnosed(
    folder: Path,
    effects: dict[str, Any],
    sides: Any = SIDES,
    mesh: Mesh | None = None,
    declared: dict[str, Any] | None = None,
    looks: float = 16.0,
) -> Diagnosed:
    """The town with `declared` effects beside images that have `effects`, or another `mesh`, besides."""
    scene = replace(town(views(sides)), effects=declared or {})
    truth = replace(scene, effects={**scene.effects, **effects})
    if mesh is not None:
        truth = replace(truth, mesh=mesh, materials={name: scene.materials[name] for name in mesh.materials})
    given = measured(truth, folder, looks=looks, seed=3)
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


@pytest.mark.slow  # test_diagnose_geometry.py asks the same of a hut beside a house
def test_an_absent_body_is_no_floor(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, {}, mesh=mesh_of(ground=ground(30)))
    assert (found.verdict, found.unexplained) == (["absent_object"], False)


@pytest.mark.full
def test_a_blur_is_no_floor(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, {"point_spread": {"range_fwhm_m": 1.3, "azimuth_fwhm_m": 1.2}})
    assert (found.verdict, found.unexplained) == (["point_spread"], False)


@pytest.mark.parametrize(
    "looks", [pytest.param(16.0, marks=pytest.mark.slow), pytest.param(4.0, marks=pytest.mark.full)]
)
def test_a_gain_is_told_over_a_declared_floor(looks: float, tmp_path: Path) -> None:
    """Lit pixels leave the floor open. Fitted to them alone, it would leave power in the shadows of one view."""
    effects = {"view_gain": {"gain_db": {"v1": 1.5}}}
    found = diagnosed(tmp_path, effects, declared={"noise_floor": {"level": 0.003}}, looks=looks)
    assert (found.verdict, found.unexplained) == (["view_gain"], False)


@pytest.mark.slow  # test_diagnose_geometry.py asks the same of a hut beside a house
def test_the_only_body_stands_elsewhere(tmp_path: Path) -> None:
    """A shift of each image takes most of the loss: only the body shows it. With the body moved the rest goes, too."""
    moved = box((-6.2, 2.5, 0.0), (-3.2, 6.5, 3.0))
    found = diagnosed(tmp_path, {}, mesh=mesh_of(ground=ground(30), hut=moved))
    assert (found.verdict, found.unexplained) == (["object_pose"], False)
    at = found.diagnosis.objects["hut"]["position_m"]
    np.testing.assert_allclose(at, (0.8, 0.5, 0.0), atol=0.03)  # the standard deviations are 4 to 6 mm


@pytest.mark.full
def test_the_angle_of_a_test_view_is_its_own(tmp_path: Path) -> None:
    """No train view can tell it, and it is no fault of the model. The hut's far corner is 10 m from the turn's axis."""
    truth = town(views())
    given = measured(truth, tmp_path, looks=16.0, seed=3)
    azimuth = given.parameters["views.v4.azimuth_deg"]
    found = diagnose(at(given, {azimuth: np.array(59.0)}), device="cpu")
    assert (found.verdict, found.unexplained) == (["view_angles"], False)
    assert found.diagnosis.of_test_views == ["view_angles v4"]
    about = found.diagnosis.sensor["v4"]["azimuth_deg"]
    assert about["declared"] == 59.0
    assert about["found"] == pytest.approx(55.0, abs=0.3)  # 5 cm at the corner, a tenth of a pixel
