"""Rays through the views of a scene: traced when first asked for, and kept."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from typing import Any

import numpy as np

from warpsar.effects.base.effect import DeclaredEffect
from warpsar.runtime.memory import in_parts
from warpsar.scene.scene import Scene
from warpsar.surface.stage import Stage
from warpsar.trace.hits import DEFAULT_MEMORY_GIB, WHOLE, BinGrid, Hits, Strip
from warpsar.trace.layers import covered
from warpsar.trace.rays import ray_count
from warpsar.trace.trace import trace
from warpsar.world.tables import View
from warpsar.world.world import geometry_of

SAMPLED = 16  # columns of an image by which its hits are estimated


def view_seed(scene_seed: int, index: int) -> int:
    """Seed of view `index`: views do not share their jitter. Fits a signed 32-bit integer."""
    return (scene_seed * 7919 + index * 104729 + 1) % (2**31 - 1)


def trace_view(
    scene: Scene,
    stage: Stage,
    view: View,
    *,
    seed: int,
    effects: list[DeclaredEffect],
    rays_per_m2: float | None = None,
    merge: bool = True,
    max_memory_gib: float = DEFAULT_MEMORY_GIB,
    strip: Strip = WHOLE,
    **options: Any,
) -> Hits:
    """Hits of one view, with the scene's sampling unless `rays_per_m2` is given, binned as its effects need.

    `strip`: which part of another image the scene's image is. `options` go to `trace`. Raises OutOfMemoryError where
    even the smallest parts of the work are too large.
    """
    geometry, grid = geometry_of(scene, view), replace(effects_grid(scene, effects), strip=strip)

    def traced(parts: int) -> Hits:
        return trace(
            stage.target,
            geometry,
            grid,
            rays_per_m2 or scene.sampling.density_per_m2(scene.grid),
            seed=seed,
            deposit=scene.sampling.deposit,
            merge=merge,
            pixel_area_m2=scene.grid.pixel_area_m2,
            max_memory_gib=max_memory_gib / parts,
            **options,
        )

    return in_parts(traced, f"view {view.name}")


def hit_grid(scene: Scene, bins_per_pixel: int = 1, margin_m: float = 0.0) -> BinGrid:
    """Bins of the hits: the image's pixels, or `bins_per_pixel` of them per axis, and whole pixels of margin."""
    shape = [
        (n + 2 * math.ceil(margin_m / step)) * bins_per_pixel
        for n, step in zip(scene.grid.shape, scene.grid.spacing_m, strict=True)
    ]
    spacing = [step / bins_per_pixel for step in scene.grid.spacing_m]
    return BinGrid((shape[0], shape[1]), (spacing[0], spacing[1]), bins_per_pixel)


def covered_in(scene: Scene, stage: Stage, view: View) -> np.ndarray:
    """Where a surface lies in the view's image, lit or hidden, for pictures; bool of shape (rows, cols)."""
    return covered(stage.target, geometry_of(scene, view), hit_grid(scene))


def effects_grid(scene: Scene, effects: list[DeclaredEffect]) -> BinGrid:
    """Bins as fine and as wide as the effects need."""
    fine = max((e.effect.bins_per_pixel for e in effects), default=1)
    margin = sum(e.effect.margin_m(scene.grid, e.values) for e in effects)
    return hit_grid(scene, fine, margin)


_Key = tuple[str, float, float, BinGrid]
"""What tells the hits of one set of rays apart"""


def _key(view: View, grid: BinGrid) -> _Key:
    return view.name, view.azimuth_deg, view.incidence_deg, grid


class Rays:
    """One set of rays through a scene: hits of its views, traced when first asked for, and kept.

    Models that differ only in materials and effects share them, so that they are compared on the same rays.
    """

    def __init__(self, stage: Stage, rays_per_m2: float | None = None, seed: int = 0, *, coarse: bool = False) -> None:
        """`coarse` as in `Hits`: for images that are screened, not compared."""
        self.stage, self.rays_per_m2, self.seed, self.coarse = stage, rays_per_m2, seed, coarse
        self._kept: dict[_Key, Hits] = {}
        self._most: dict[_Key, int] = {}
        self._tracing = threading.Lock()
        self._thinned: dict[float, Rays] = {}

    def thinned(self, share: float) -> Rays:
        """A coarse set with a `share` of the rays, made when first asked for and then kept. Both state a density."""
        assert self.rays_per_m2 is not None
        if share not in self._thinned:
            self._thinned[share] = Rays(self.stage, share * self.rays_per_m2, self.seed, coarse=True)
        return self._thinned[share]

    def hits(self, scene: Scene, view: View, effects: list[DeclaredEffect]) -> Hits:
        """Hits of a view, traced when first asked for and then kept."""
        key = _key(view, effects_grid(scene, effects))
        with self._tracing:  # threads that ask for the same hits share them
            if key not in self._kept:
                self._kept[key] = self.trace(scene, view, effects)
            return self._kept[key]

    def trace(
        self,
        scene: Scene,
        view: View,
        effects: list[DeclaredEffect],
        only_columns: tuple[int, int] | None = None,
        max_memory_gib: float = DEFAULT_MEMORY_GIB,
    ) -> Hits:
        """Hits of a view, or of a band of its columns; they are not kept here."""
        found = trace_view(
            scene,
            self.stage,
            view,
            seed=view_seed(self.seed, [v.name for v in scene.views].index(view.name)),
            effects=effects,
            rays_per_m2=self.rays_per_m2,
            only_columns=only_columns,
            max_memory_gib=max_memory_gib,
        )
        return replace(found, coarse=self.coarse)

    def forget(self, view: View) -> None:
        """Let go of a view's hits."""
        for key in [key for key in self._kept if key[0] == view.name]:
            del self._kept[key]

    def most_hits(self, scene: Scene, view: View, effects: list[DeclaredEffect]) -> int:
        """An upper bound of a view's merged hits: two of every ray."""
        grid = effects_grid(scene, effects)
        key = _key(view, grid)
        if key not in self._most:
            density = self.rays_per_m2 or scene.sampling.density_per_m2(scene.grid)
            self._most[key] = 2 * ray_count(self.stage.target, geometry_of(scene, view), grid, density)
        return self._most[key]

    def expected_hits(self, scene: Scene, view: View, effects: list[DeclaredEffect]) -> int:
        """An estimate of a view's merged hits, from every `cols // SAMPLED`-th column of its grid."""
        columns = effects_grid(scene, effects).shape[1]
        stride = max(1, columns // SAMPLED)
        sample = range(stride // 2, columns, stride)
        found = sum(self.trace(scene, view, effects, (column, column + 1)).count for column in sample)
        return round(found * columns / len(sample))
