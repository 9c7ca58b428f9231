"""Exact areas that models of one mesh share, against images made anew."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effect_worlds import street, with_effect
from learning_scenes import measured

from warpsar.compare import comparison, modelled
from warpsar.compare.comparison import compare
from warpsar.compare.modelled import KeptAreas
from warpsar.runtime import devices
from warpsar.scene.scene import Scene

CPU = devices.resolve_device("cpu")


def _images(scene: Scene, kept: KeptAreas | None) -> list[np.ndarray]:
    found = compare(scene, CPU, kept=kept).images
    return [plane for image in found for plane in (image.simulated, image.seen.measured, image.seen.interior)]


def _higher(scene: Scene) -> Scene:
    """The scene on a mesh whose highest points are half a metre higher."""
    vertices = np.array(scene.mesh.vertices)
    vertices[vertices[:, 2] == vertices[:, 2].max(), 2] += 0.5
    return replace(scene, mesh=replace(scene.mesh, vertices=vertices))


@pytest.mark.parametrize(
    "effects",
    [{}, {"multibounce": {"strength": 1.0}}, {"registration": {"range_m": 0.31, "azimuth_m": -0.17}}],
    ids=lambda effects: "+".join(effects) or "none",
)
def test_images_are_those_of_areas_made_anew(effects: dict[str, Any], tmp_path: Path) -> None:
    """After another surface, and after another mesh: to the bit."""
    scene = measured(street(), tmp_path)
    other = replace(scene, materials={n: m.model_copy(update={"eps_r": 9.0}) for n, m in scene.materials.items()})
    kept = KeptAreas()
    for one in (other, _higher(scene)):
        _images(one, kept)
    for name, table in effects.items():
        scene = with_effect(scene, name, table)
    for found, expected in zip(_images(scene, kept), _images(scene, None), strict=True):
        np.testing.assert_array_equal(found, expected)
    for found, expected in zip(_images(_higher(scene), kept), _images(_higher(scene), None), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_a_view_is_found_once_and_the_oldest_go(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    scene = with_effect(measured(street(), tmp_path), "multibounce", {"strength": 1.0})  # which takes two sets of rays
    made: list[int] = []
    exact_hits = modelled.exact_hits

    def counted(*given: Any, **named: Any) -> Any:
        made.append(1)
        return exact_hits(*given, **named)

    monkeypatch.setattr(modelled, "exact_hits", counted)
    views = sum(bool(view.images) for view in scene.views)
    kept = KeptAreas()
    for _ in range(2):
        compare(scene, CPU, kept=kept)
    assert len(made) == views
    monkeypatch.setattr(modelled, "MOST_KEPT", 1)
    compare(_higher(scene), CPU, kept=kept)
    assert len(made) == 2 * views
    compare(scene, CPU, kept=kept)
    assert len(made) == 3 * views


def test_the_density_of_rays_is_chosen_once_for_effects_of_any_numbers(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It depends on which effects send rays, on the views and on the grid; a model of other numbers shares it."""
    scene = measured(street(), tmp_path)
    chosen: list[int] = []
    choose = comparison.choose_density

    def counted(*given: Any, **named: Any) -> Any:
        chosen.append(1)
        return choose(*given, **named)

    monkeypatch.setattr(comparison, "choose_density", counted)
    kept = KeptAreas()
    for strength in (1.0, 0.5):
        compare(with_effect(scene, "multibounce", {"strength": strength}), CPU, kept=kept)
    assert len(chosen) == 1
    compare(with_effect(scene, "multibounce", {"strength": 1.0}), CPU, kept=KeptAreas())
    assert len(chosen) == 2
    compare(scene, CPU, kept=kept)  # exact areas alone have no noise of rays
    assert len(chosen) == 2
