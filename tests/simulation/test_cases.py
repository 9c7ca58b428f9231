"""Images of an independent renderer (float64, another ray caster, 16 looks of speckle): do ours agree with them?"""

import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.special import digamma

from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.command import view_render
from warpsar.simulation.rays import trace_view
from warpsar.surface.stage import Stage
from warpsar.surface.surface import KEYS

UNDECLARED = ("antenna_pattern", "multibounce", "noise_floor", "point_spread", "registration")


@dataclass
class Pair:
    """One view: our image, theirs, and the share that each material has in the lit area of our pixels."""

    name: str
    ours: np.ndarray
    theirs: np.ndarray
    share: dict[str, np.ndarray]


@cache
def pairs(folder: Path, rays_per_pixel: float) -> tuple[float, list[Pair]]:
    """The case's looks, and its views simulated from the true materials."""
    truth = json.loads((folder / "truth.json").read_text())
    scene = Scene.load(folder / "scene.toml")
    materials = {
        name: scene.materials[name].model_copy(update=dict(zip(KEYS, values, strict=True)))
        for name, values in truth["materials"].items()
    }
    sampling = scene.sampling.model_copy(update={"rays_per_pixel": rays_per_pixel})
    scene = replace(scene, materials=materials, sampling=sampling)
    stage = Stage.of(scene, devices.resolve_device("cpu"))
    found = []
    for index, view in enumerate(scene.views):
        hits = trace_view(scene, stage, view, seed=index, effects=[])
        material = scene.mesh.face_material[hits.face.numpy()]
        pixel, weight = hits.pixel.numpy(), hits.weight.numpy().astype(float)
        n = scene.grid.shape[0] * scene.grid.shape[1]
        area = np.bincount(pixel, weight, n)
        with np.errstate(invalid="ignore"):
            share = {
                name: (np.bincount(pixel, weight * (material == i), n) / area).reshape(scene.grid.shape)
                for i, name in enumerate(scene.mesh.materials)
            }
        ours = view_render(scene, stage, view, hits).forward()["HH"]
        found.append(Pair(view.name, ours, scene.measured(view, "HH"), share))
    return float(truth["looks"]), found


def whole_neighbourhood(mask: np.ndarray) -> np.ndarray:
    """Pixels whose 3 x 3 neighbourhood is all in the mask; the image's border is not."""
    inside = np.zeros_like(mask)
    rows, cols = mask.shape
    inside[1:-1, 1:-1] = np.all([mask[i : rows - 2 + i, j : cols - 2 + j] for i in range(3) for j in range(3)], axis=0)
    return inside


def test_materials_are_as_bright_as_they_should_be(independent_cases: Path) -> None:
    """Ratio of means within 3 standard errors per material and view, and within 1 % for the ground.

    Over pixels with nothing else in their 3 x 3 neighbourhood, lit, at least 30 of them. The standard error is that
    of the measured mean of their speckle, mu_i / sqrt(16) in each; our own sampling adds little to it.
    """
    looks, views = pairs(independent_cases / "none", 256.0)
    compared, scores = set(), []
    for view in views:
        for name, share in view.share.items():
            pixels = whole_neighbourhood(share == 1)
            n = int(pixels.sum())
            if n < 30:
                continue
            ours, theirs = view.ours[pixels].astype(float), view.theirs[pixels].astype(float)
            ratio = theirs.mean() / ours.mean()
            score = (ratio - 1) * n * ours.mean() / np.sqrt((ours**2).sum() / looks)
            assert abs(score) < 3, f"{view.name} {name}: {ratio:.4f} of {n} pixels is {score:.1f} standard errors"
            if name == "ground":
                assert abs(ratio - 1) < 0.01, f"{view.name}: {ratio:.4f}"
            compared.add(name)
            scores.append(score)
    assert compared >= {"ground", "concrete", "brick"}
    assert len(scores) >= 12
    # and they scatter as standard errors do
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.6


def deviance(view: Pair, looks: float) -> np.ndarray:
    """d / E[d] (docs/evaluate.md) over the lit interior: 1 on average where the model is right."""
    pixels = whole_neighbourhood(view.ours > 0) & (view.theirs > 0)
    ratio = view.theirs[pixels].astype(float) / view.ours[pixels]
    return (ratio - 1 - np.log(ratio)) / (np.log(looks) - digamma(looks))


def test_nothing_but_speckle_is_left(independent_cases: Path) -> None:
    """Mean of d / E[d] over the lit interiors of all views together, a hundred thousand pixels: 0.98 to 1.02.

    d / E[d] of one pixel has a standard deviation of 1.41 at 16 looks, so the mean of them all scatters by 0.0045,
    and one view's of 10 000 by 0.014: single views are held to three times that.
    """
    looks, views = pairs(independent_cases / "none", 256.0)
    values = [deviance(view, looks) for view in views]
    for view, value in zip(views, values, strict=True):
        assert value.mean() == pytest.approx(1, abs=3 * 1.41 / np.sqrt(value.size)), view.name
    pooled = np.concatenate(values)
    assert pooled.size > 90_000
    assert 0.98 < pooled.mean() < 1.02


def test_shadows_are_where_they_are(independent_cases: Path) -> None:
    """Without noise a shadow is dark in both; outlines differ by the pixels they pass through."""
    _, views = pairs(independent_cases / "none", 256.0)
    for view in views:
        ours, theirs = view.ours == 0, view.theirs == 0
        assert ours.any()
        assert (ours != theirs).mean() < 0.002, view.name
        # and never by more than a pixel's breadth
        assert ours[whole_neighbourhood(theirs)].all()
        assert theirs[whole_neighbourhood(ours)].all()


@pytest.mark.parametrize(
    "case",
    ["noise_floor", *(pytest.param(name, marks=pytest.mark.slow) for name in UNDECLARED if name != "noise_floor")],
)
def test_an_undeclared_effect_is_not_speckle(case: str, independent_cases: Path) -> None:
    """The same measure is not blind: what the plain model lacks shows in it."""
    looks, views = pairs(independent_cases / case, 64.0)
    assert np.concatenate([deviance(view, looks) for view in views]).mean() > 1.02
