"""The scan of a search beside double bounces: what is right is left alone, and a storey more is found."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp
from effect_worlds import with_effect
from worlds import BRICK, SOIL, box, ground, mesh_of, scene_of, view

from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.frozen import frozen
from warpsar.diagnosis.scores.evidence import Evidence
from warpsar.io.images import write_tiff
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.simulation.rays import Rays
from warpsar.speckle.draws import Speckle
from warpsar.speckle.scan import Scan
from warpsar.speckle.tail import Tails
from warpsar.surface.stage import Stage

CPU = wp.get_device("cpu")
LOOKS = 20.0
SIDE = 0.5  # [m]


def block(height: float, rays_per_pixel: float) -> Scene:
    """A block of flats on level ground in pixels of 0.5 m. Two of its walls lie within five degrees of a line of
    sight."""
    mesh = mesh_of(soil=ground(50.0), brick=box((-12.0, -7.0, 0.0), (12.0, 7.0, height)))
    looks = [view(85.7, 34.0, name="v0", looks=LOOKS), view(87.7, 45.0, name="v1", looks=LOOKS)]
    made = scene_of(
        mesh,
        looks,
        shape=(110, 110),
        spacing_m=(SIDE, SIDE),
        rays_per_pixel=rays_per_pixel,
        materials={"soil": SOIL, "brick": BRICK},
        frequency_hz=9.6e9,
    )
    return with_effect(made, "multibounce", {"strength": 1.0})


def alarm(declared: Scene, clean: dict[str, np.ndarray], folder: Path, seed: int) -> float:
    """-ln p of the scan's strongest window in images with speckle, under the declared model."""
    random, looks = np.random.default_rng(seed), []
    for look in declared.views:
        path = folder / f"{look.name}.tif"
        write_tiff(path, (clean[look.name] * random.gamma(LOOKS, 1.0 / LOOKS, (110, 110))).astype(np.float32))
        looks.append(look.model_copy(update={"images": {"HH": path}}))
    scene, stage = replace(declared, views=looks), Stage.of(declared, CPU)
    one, other = (FitSetup(CPU, Rays(stage, 64.0 / SIDE**2, of), {}, mesh=scene.mesh) for of in (1, 2))
    problem = replace(one, observations=frozen(one, other, scene)).problem(scene)
    evidence = Evidence.of(problem, problem.x0)
    scan = Scan(evidence.observations, evidence.autocovariance, evidence.silent)
    speckle = Speckle(evidence.observations, evidence.autocovariance)
    draws = [scan.largest(evidence.split(speckle(random, 20))) for _ in range(5)]
    strength = scan.strongest(evidence.split(evidence.standardised))[1]
    return float(Tails.of(np.concatenate(draws, axis=-1))(strength))


def images(scene: Scene) -> dict[str, np.ndarray]:
    return {one.name: one.beta0["HH"].astype(float) for one in simulate(scene, device="cpu")}


@pytest.mark.full
def test_a_correct_block_raises_no_alarm_whatever_rays_made_its_images(tmp_path: Path) -> None:
    """Images by 16 rays a pixel, a model by 64. Before tubes took the response at their ends, power fell behind bright
    corners as the rays were: 5 to 17. A storey more, of three, must still be seen."""
    right, wrong = images(block(9.0, 16.0)), images(block(12.0, 16.0))
    found: list[Any] = [alarm(block(9.0, 64.0), right, tmp_path, seed) for seed in range(3)]
    missing = alarm(block(9.0, 64.0), wrong, tmp_path, 3)
    print(f"right: {[round(one, 1) for one in found]}; a storey more: {missing:.1f}")
    assert max(found) < 7.0  # a chance of 0.3 % for all three
    assert missing > 12.0
