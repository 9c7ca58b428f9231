"""Which names are earned where something is left."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from comparisons import comparison
from test_proposals import BOX, plain

from warpsar.compare.judgement import Judgement, judge
from warpsar.diagnosis.found import Diagnosis
from warpsar.diagnosis.models.projection import pixel_of
from warpsar.diagnosis.result import not_established
from warpsar.diagnosis.single_views import _moved_px
from warpsar.learning.pose_sharing import boxes
from warpsar.parameters.at import at
from warpsar.scene.placing import with_objects

HELD = [
    "noise_floor",
    "registration",
    "point_spread",
    "object_pose house",
    "object_size shed",
    "absent_object hut",
    "missing_object found_1",
    "view_angles v0",
    "pixel_spacing range",
]
EFFECTS, SENSOR = {"point_spread"}, {"view_angles v0", "pixel_spacing range"}
MOVING = {"object_pose house", "object_size shed", "registration"}


def doubted(findings: list[str], on_trial: list[str] | None = None, **more: Any) -> dict[str, str]:
    """Of a model with all of `HELD`, whose floor and shift alone are confirmed by their own tests."""
    signed = {"noise_floor", "registration"}.__contains__
    about = {"unexplained": False, "withdrawn": [], **more}
    found: Any = SimpleNamespace(held=HELD, on_trial=on_trial or [], signed=signed, **about)
    judged = {"p_window": 1.0, "window": None}
    verdicts: Any = {
        "train": SimpleNamespace(findings=[], **judged),
        "test": SimpleNamespace(findings=findings, **judged),
    }
    return not_established(cast(Diagnosis, found), cast(dict[str, Judgement], verdicts))


@pytest.mark.parametrize(
    ("findings", "names"),
    [
        ([], set()),
        (["level"], set()),
        (["looks"], set()),
        (["structure"], EFFECTS | SENSOR),
        (["edges"], EFFECTS | SENSOR | MOVING),
        (["structure", "edges", "level"], EFFECTS | SENSOR | MOVING),
    ],
)
def test_what_is_left_takes_names_that_may_stand_in_for_it(findings: list[str], names: set[str]) -> None:
    assert set(doubted(findings)) == names


def test_what_the_scan_finds_counts_as_structure() -> None:
    """A judgement may find nothing, and a refused effect may still say that something stands there. Beside a name that
    was withdrawn all others stand."""
    assert set(doubted([], unexplained=True)) == EFFECTS | SENSOR
    assert doubted([], unexplained=True, withdrawn=["interference"]) == {}


def test_what_was_left_on_trial_is_no_name() -> None:
    told = doubted([], ["noise_floor", "missing_object found_1"])
    assert set(told) == {"noise_floor", "missing_object found_1"}
    assert all("time was over" in why for why in told.values())


HELD_SIZE = "object_size it"


def beside_a_window(row: int, col: int, chance: float) -> dict[str, str]:
    """Names that fail of a box's size, beside a window of 5 x 5 pixels in the first view that speckle makes by
    `chance`; edges agree."""
    scene = with_objects(plain(), (BOX.model_copy(update={"name": "it", "material": "hut"}),))
    found: Any = SimpleNamespace(
        held=[HELD_SIZE], on_trial=[], unexplained=False, withdrawn=[], final=SimpleNamespace(scene=scene)
    )
    window = SimpleNamespace(view=scene.views[0].name, row=row, col=col, rows=5, columns=5)
    verdict: Any = SimpleNamespace(findings=["structure"], p_window=chance, window=window)
    return not_established(found, {"train": verdict})


def test_a_size_is_not_established_beside_structure_on_its_body() -> None:
    """What is left there may be what the size stands in for: a gable, for instance. Elsewhere it is another thing."""
    scene = plain()
    middle = np.array([[2.0, -1.5, 1.25]]) - scene.reference_point_m
    row, col = (int(at[0]) for at in pixel_of(scene, scene.views[0], middle))
    assert beside_a_window(row, col, 1e-6) == {HELD_SIZE: "structure is left on it"}
    assert beside_a_window(2, 2, 1e-6) == {}
    assert beside_a_window(row, col, 0.5) == {}  # it was rows or columns that departed


def test_a_size_is_not_established_where_its_body_is_less_like_the_model_than_speckle() -> None:
    """Over a whole body a model may be too bright by so little that no window shows it."""
    scene = with_objects(plain(), (BOX.model_copy(update={"name": "it", "material": "hut"}),))
    body = (boxes(scene, scene.views[0]) or {})["it"].alone(np.ones(scene.grid.shape)) > 0.0
    power = np.random.default_rng(3).gamma(1.0, 1.0, scene.grid.shape)
    found: Any = SimpleNamespace(
        held=[HELD_SIZE], on_trial=[], unexplained=False, withdrawn=[], final=SimpleNamespace(scene=scene)
    )
    alike, brighter, elsewhere = (
        comparison(power, np.where(where, 4.0, 1.0), 1.0) for where in (body & False, body, ~body)
    )
    images = {name: [one] for name, one in (("alike", alike), ("on it", brighter), ("elsewhere", elsewhere))}
    doubts = {name: not_established(found, {"train": judge([alike])}, (), some) for name, some in images.items()}
    assert doubts["alike"] == doubts["elsewhere"] == {}
    assert "on it and its shadow the deviance is" in doubts["on it"][HELD_SIZE]


def test_how_far_an_angle_moves_outlines() -> None:
    """A turn by d moves a point of the ground by d times its distance from the axis, along azimuth or along the
    ground's range."""
    scene = plain()
    view, step = scene.views[0], np.array(scene.grid.spacing_m)
    turned = at(scene, {scene.parameters[f"views.{view.name}.azimuth_deg"]: np.array(view.azimuth_deg + 0.1)})
    points = scene.mesh.vertices - scene.reference_point_m
    places = np.array(pixel_of(scene, view, points))
    inside = np.all((places >= 0) & (places < np.array(scene.grid.shape)[:, None]), axis=0)
    away = np.linalg.norm(points[inside, :2], axis=1).max() * np.radians(0.1)
    moved = _moved_px(scene, turned, view.name) * step
    assert np.hypot(*moved) <= np.sqrt(2.0) * away
    assert moved.max() > away / 2.0
    assert np.all(_moved_px(scene, scene, view.name) == 0.0)
