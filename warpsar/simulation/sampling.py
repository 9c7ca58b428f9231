"""How many rays are enough for the looks of the measured images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.ndimage import minimum_filter

from warpsar.effects.registry import declared
from warpsar.render.render import ViewRender
from warpsar.runtime import once
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.world.tables import View

FEWEST, MOST = 64.0, 4096.0  # rays per pixel
RAY_NOISE = 0.01  # looks x relative sampling variance of a lit pixel that a fit allows


@dataclass(frozen=True)
class Density:
    """`rays_per_m2` over the plane across the look direction, and whether it was `chosen` or stated by the scene.

    `noise` comes from two seeds: the largest over the views of looks x mean relative sampling variance of a lit pixel,
    or with `total` the sum over all lit pixels of looks x relative variance. It is NaN where the scene states the
    density. `sets` are those two.
    """

    rays_per_m2: float
    rays_per_pixel: float
    noise: float
    chosen: bool
    sets: tuple[Rays, Rays] | None = None


def relative_variance(scene: Scene, view: View, sets: tuple[Rays, Rays]) -> tuple[float, int]:
    """Mean relative variance of beta0 over the lit interior of one view, and the number of pixels in it.

    It comes from two independent sets of rays.
    """
    effects = declared(scene, view)
    pair, lit = [], []
    for rays in sets:
        hits = rays.hits(scene, view, effects)
        render = ViewRender(rays.stage, view, hits, scene.grid.shape, scene.radar.polarizations[:1], effects)
        pair.append(next(iter(render.forward().values())).astype(float))
        lit.append(render.covered(scene.radar.polarizations[0]))
    mean = (pair[0] + pair[1]) / 2.0
    interior = minimum_filter((lit[0] & lit[1]).astype(np.uint8), size=3, mode="constant") > 0
    if not interior.any():
        return 0.0, 0
    return float(np.mean((pair[0] - pair[1])[interior] ** 2 / 2.0 / mean[interior] ** 2)), int(interior.sum())


def choose_density(
    scene: Scene,
    stage: Stage,
    views: Sequence[View],
    looks: Sequence[float],
    limit: float,
    *,
    total: bool = False,
    shared: bool = False,
    kept: tuple[int, int] | None = None,
) -> Density:
    """The scene's stated density, or the smallest power of two of rays per pixel that keeps the noise under `limit`.

    The noise is that of the noisiest view's lit pixel, or with `total` of all pixels together. `shared`: whether
    the processes of the run share the views. `kept`: seeds of two sets of rays that go on to be used; their hits stay.
    """
    area = scene.grid.pixel_area_m2
    stated = scene.sampling.density_per_m2(scene.grid)
    if scene.sampling.stated and not total:
        return Density(stated, stated * area, float("nan"), False)
    per_pixel = max(FEWEST, stated * area) if scene.sampling.stated else FEWEST

    while True:
        one, other = (Rays(stage, per_pixel / area, seed) for seed in kept or (101, 202))

        def noise_of(view: View, sets: tuple[Rays, Rays] = (one, other)) -> tuple[float, int]:
            found = relative_variance(scene, view, sets)
            for rays in sets if kept is None else ():
                rays.forget(view)
            return found

        tasks = [partial(noise_of, view) for view in views]
        found = once.share(tasks) if shared else [task() for task in tasks]
        noises = [look * variance for look, (variance, _) in zip(looks, found, strict=True)]
        noise = sum(each * count for each, (_, count) in zip(noises, found, strict=True)) if total else max(noises)
        if noise < limit or per_pixel >= MOST:
            return Density(per_pixel / area, per_pixel, noise, not scene.sampling.stated, (one, other))
        per_pixel *= 2.0
