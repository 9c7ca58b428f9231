"""What a diagnosis fits of an object that it found, and what it writes of it."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_proposals import BODY, BOX, CPU, measured, plain, ratios_of

from warpsar.diagnosis.geometry import missing_object
from warpsar.diagnosis.geometry.registry import coordinates
from warpsar.diagnosis.models.movable import own_material, standing
from warpsar.diagnosis.proposals.fit import TrialGround
from warpsar.diagnosis.proposals.left_out import left_out
from warpsar.diagnosis.proposals.places import Looked
from warpsar.diagnosis.search import geometry_confirmation
from warpsar.diagnosis.search.geometry_confirmation import taken_back
from warpsar.diagnosis.written_scene import annotate
from warpsar.effects.registry import validate
from warpsar.learning.geometry import with_free
from warpsar.learning.pose import STANDS_M
from warpsar.learning.pose_search import find_poses
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Object

ALL = ("position", "heading", "size")
OF_IT = [f"objects.it.{key}" for key in ("position_m", "heading_deg", "size_m")]


def with_box(
    size: tuple[float, float, float] = (4.0, 2.5, 2.5), at: Any = (2.0, -1.5, 0.0), material: str = "it"
) -> Scene:
    """Images with the box, and a scene with a box of another size and place."""
    table = BOX.model_copy(update={"size_m": size, "position_m": at, "material": material})
    return with_objects(measured(plain(), (BOX,)), (table,), {"it": BODY})


def test_size_and_place_of_what_was_missing_are_fitted() -> None:
    """A size stays no longer as it was proposed; of a body that a scene has, place and heading alone are fitted."""
    declared, scene = plain(), with_box()
    assert coordinates(declared, scene) == OF_IT
    turned = with_objects(declared, [Object(group="hut", heading_deg=3.0)])
    assert coordinates(declared, turned) == ["objects.hut.position_m", "objects.hut.heading_deg"]
    free = with_free(scene, coordinates(declared, scene))
    assert [one.learn for one in free.objects] == [ALL]
    assert standing(free) == ["it"]
    assert own_material(declared, scene, "it") == "it"
    assert own_material(declared, with_box(material="hut"), "it") is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"primitive": "sphere", "size_m": (0.5, 0.5, 0.5), "heading_deg": 0.0}, ("position",)),
        ({"primitive": "cylinder", "size_m": (3.0, 3.0, 2.0), "heading_deg": 0.0}, ("position", "size")),
        ({"primitive": "cylinder", "size_m": (4.0, 3.0, 2.0), "heading_deg": 20.0}, ALL),
        ({"primitive": "car", "size_m": (4.5, 1.8, 1.5)}, ALL),
    ],
)
def test_a_body_without_front_has_no_heading(change: dict[str, Any], words: tuple[str, ...]) -> None:
    assert missing_object.CHANGE.words(BOX.model_copy(update=change)) == words


@pytest.mark.full
def test_the_foot_stays_on_the_ground_while_the_size_is_fitted() -> None:
    """From 20 % too large and 30 cm off, to within four standard deviations of the truth. The foot's height does not
    move, is known to a centimetre, and counts as no number; no tolerance was stated, so nothing pulls."""
    scene = with_free(with_box((4.6, 2.9, 2.2), (2.3, -1.3, 0.0)), OF_IT)
    found = find_poses(scene, CPU, held=True, search=False, standing=["it"])
    told = found.objects["it"]
    assert found.size == 6
    assert found.pulls == []
    assert told["position_m"][2] == 0.0
    assert told["position_sd_m"][2] <= STANDS_M * 1.001
    for value, sd, truth in (
        *zip(told["position_m"][:2], told["position_sd_m"][:2], (2.0, -1.5), strict=True),
        *zip(told["size_m"], told["size_sd_m"], (4.0, 2.5, 2.5), strict=True),
    ):
        assert abs(value - truth) < 4.0 * sd
    assert max(told["size_sd_m"]) < 0.1


def test_a_place_is_looked_for_without_a_view() -> None:
    """Without each view the others find the box; a view that shows it alone is none of theirs."""
    scene = measured(plain(), (BOX,))
    ratios = ratios_of(scene)
    looked = Looked.at(scene, ratios)
    for view in scene.views:
        (place,) = looked.best(1, without=view.name)
        assert np.hypot(place.position_m[0] - 2.0, place.position_m[1] + 1.5) < 1.0
        assert place.score < looked.best(1)[0].score
    assert Looked.at(scene, ratios[:1]).best(1, without=ratios[0].view.name) == []


@pytest.mark.slow
def test_a_view_gains_nothing_of_what_the_others_do_not_propose() -> None:
    """The same object, with and without places of the other views; the truth gains in every view."""
    scene = measured(plain(), (BOX,))
    ground = TrialGround.of(scene, CPU, None, "gamma")
    without = ground.settled(ground.scene)
    whole = ground.settled(ground.holding(BOX.model_copy(update={"learn": ALL}), BODY))
    looked = Looked.at(scene, ratios_of(scene))
    all_of_them = left_out(ground, without, whole, lambda view: looked.best(1, without=view))
    assert all_of_them.passed
    part = left_out(ground, without, whole, lambda view: looked.best(1, without=view) if view == "v0" else [])
    assert 0.0 < part.gain < 0.6 * all_of_them.gain
    nothing = left_out(ground, without, whole, lambda _: [])
    assert (nothing.gain, nothing.passed) == (0.0, False)


def test_the_written_scene_says_how_well_an_object_is_known(tmp_path: Path) -> None:
    """As comments: the scene reads as it did, and no tolerance takes a fit for knowledge."""
    path = tmp_path / "scene.toml"
    path.write_text(
        '[[objects]]\nname = "found_1"\nsize_m = [4.0, 2.5, 2.5]\nposition_m = [2.0, -1.5, 0.0]\n\n'
        '[[objects]]\ngroup = "hut"\nheading_deg = 3.0\n'
    )
    told = {
        "found_1": {"position_sd_m": [0.0101, 0.02, 0.01], "size_sd_m": [0.03, 0.04, 0.05]},
        "hut": {"heading_sd_deg": 0.25},
    }
    before = json.dumps(_read(path))
    annotate(path, told)
    text = path.read_text()
    assert "size_m = [4.0, 2.5, 2.5] # standard deviation 0.03, 0.04, 0.05\n" in text
    assert "position_m = [2.0, -1.5, 0.0] # standard deviation 0.01, 0.02, 0.01\n" in text
    assert "heading_deg = 3.0 # standard deviation 0.25\n" in text
    assert json.dumps(_read(path)) == before
    annotate(path, told)
    assert path.read_text().count("standard deviation") == 3


def _read(path: Path) -> dict[str, Any]:
    import tomllib

    return tomllib.loads(path.read_text())


def test_a_body_is_taken_back_with_the_effects_of_its_own_material(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the body there is no such material; other effects stay."""
    scene = with_box()
    detail = {"level": 0.1, "spread_m": 1.0}
    kept = {"noise_floor": validate("noise_floor", {"level": 0.01}, "")}
    monkeypatch.setattr(geometry_confirmation, "fitted_beside", lambda _, without, declared: (None, without))
    for materials, left in ((["it"], kept), (["hut"], {**kept, "unresolved_detail": ...})):
        effects = {**kept, "unresolved_detail": validate("unresolved_detail", {**detail, "materials": materials}, "")}
        model = SimpleNamespace(scene=replace(scene, effects=effects))
        without: Any = taken_back(None, model, plain(), "missing_object it")  # type: ignore[arg-type]
        assert set(without.effects) == set(left)
        assert not without.objects
