"""How many rays are enough for the looks of the measured images (scene-format.md, "Layouts")."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpsar.effects import declared
from warpsar.render import Stage, ViewRender
from warpsar.simulation import trace_view, view_seed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warpsar.scene import Scene, View

FEWEST, MOST = 64.0, 4096.0  # rays per pixel


@dataclass(frozen=True)
class Density:
    """`rays_per_m2` over the plane across the look direction, and the largest looks x relative sampling variance of a
    lit pixel that two seeds show, averaged over each view's lit interior; nan where the scene stated the density."""

    rays_per_m2: float
    rays_per_pixel: float
    noise: float
    chosen: bool


def relative_variance(scene: Scene, stage: Stage, view: View, rays_per_m2: float, seeds: tuple[int, int]) -> float:
    """Mean relative variance of beta0 over the lit interior of one view, from two independent sets of rays."""
    from scipy.ndimage import minimum_filter

    effects = declared(scene, view)
    pair = []
    for seed in seeds:
        hits = trace_view(scene, stage, view, seed=seed, effects=effects, rays_per_m2=rays_per_m2)
        render = ViewRender(stage, view, hits, scene.grid.shape, scene.radar.polarizations[:1], effects)
        pair.append(next(iter(render.forward().values())).astype(float))
    mean = (pair[0] + pair[1]) / 2.0
    interior = minimum_filter((mean > 0).astype(np.uint8), size=3, mode="constant") > 0
    if not interior.any():
        return 0.0
    return float(np.mean((pair[0] - pair[1])[interior] ** 2 / 2.0 / mean[interior] ** 2))


def choose_density(scene: Scene, stage: Stage, views: Sequence[View], looks: Sequence[float], limit: float) -> Density:
    """The scene's stated density, or the smallest power of two of rays per pixel that keeps looks x relative variance
    under `limit` in every view."""
    area = scene.grid.pixel_area_m2
    stated = scene.sampling.density_per_m2(scene.grid)
    if scene.sampling.stated:
        return Density(stated, stated * area, float("nan"), False)
    per_pixel = FEWEST
    while True:
        noise = max(
            look * relative_variance(scene, stage, view, per_pixel / area, (view_seed(101, i), view_seed(202, i)))
            for i, (view, look) in enumerate(zip(views, looks, strict=True))
        )
        if noise < limit or per_pixel >= MOST:
            return Density(per_pixel / area, per_pixel, noise, True)
        per_pixel *= 2.0
