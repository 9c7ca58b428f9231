"""Which pixels a pose is fitted on: all that are usable, lit or not, above a floor that both sides share.

A pose is told by what turns dark as much as by what turns bright, and pixels of a shadow measure zero, which no gamma
likelihood allows. A known level added to model and measurement alike leaves the mean as it is and makes every pixel
count.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from warpsar.compare.observation import Observation, usable_pixels
from warpsar.effects.registry import declared, response_of, validate
from warpsar.scene.scene import Scene
from warpsar.world.tables import Grid

FLOOR_SHARE = 0.05  # of the median of the lit pixels
FWHM = math.sqrt(8.0 * math.log(2.0))  # of a Gaussian, in standard deviations


@dataclass(frozen=True)
class PosePixels:
    """A scene with the floor, of `level` [beta0], and blur that its `observations`, by view name, were given too."""

    scene: Scene
    observations: dict[str, list[Observation]]
    level: float


def compared(
    scene: Scene,
    lit: Mapping[str, Sequence[Observation]],
    blur_m: float = 0.0,
    gains: Mapping[tuple[str, str], float] | None = None,
) -> PosePixels:
    """The scene and its images with a common floor, blurred by a Gaussian of `blur_m` full width at half maximum.

    `lit` are the declared model's own observations by view name: they say how bright lit pixels are, and give the
    looks. A floor that the scene declares stays as it is. `gains`, by view name and polarization: those of images that
    are not calibrated, which their floor must have, too.
    """

    def gain(seen: Observation) -> float:
        return 1.0 if gains is None else gains[seen.view.name, seen.polarization]

    levels = [np.median(seen.values) / gain(seen) for found in lit.values() for seen in found if seen.values.size]
    level = 0.0 if "noise_floor" in scene.effects else FLOOR_SHARE * float(np.median(levels))
    effects: dict[str, dict[str, Any]] = dict(scene.effects)
    if level:
        effects["noise_floor"] = validate("noise_floor", {"level": level, "fixed": True}, "effects.noise_floor")
    if blur_m:
        effects["point_spread"] = _wider(scene, blur_m)
    observations = {
        name: [_prepared(scene, seen, level * gain(seen), blur_m) for seen in found] for name, found in lit.items()
    }
    return PosePixels(replace(scene, effects=effects), observations, level)


def _wider(scene: Scene, blur_m: float) -> dict[str, Any]:
    """The table of a kernel that is wider by `blur_m` than the scene's. Fields of corners add up in the radar's cells
    as before: a blur of power makes no corner brighter."""
    stated = scene.effects.get("point_spread", {})
    widths = {key: math.hypot(float(stated.get(key, 0.0)), blur_m) for key in ("range_fwhm_m", "azimuth_fwhm_m")}
    cells = [list(one) for one in response_of(declared(scene, scene.views[0])).cells()]
    return validate(
        "point_spread", {**widths, "window": "gaussian", "cells": cells, "fixed": True}, "effects.point_spread"
    )


def _prepared(scene: Scene, seen: Observation, level: float, blur_m: float) -> Observation:
    measured = np.asarray(seen.measured, float)
    usable = usable_pixels(scene, seen.view, measured)
    measured = blurred(scene.grid, measured, blur_m) + level
    none = np.zeros_like(usable)
    return replace(seen, measured=measured, interior=usable & (measured > 0), silent=none, dark=none, least=None)


def blurred(grid: Grid, image: np.ndarray, blur_m: float) -> np.ndarray:
    """The image with a Gaussian blur of `blur_m` full width at half maximum; what is not finite counts for nothing."""
    if not blur_m:
        return image
    sigma = [blur_m / FWHM / step for step in grid.spacing_m]
    total = gaussian_filter(np.nan_to_num(image), sigma)
    return np.asarray(total / np.maximum(gaussian_filter(np.isfinite(image).astype(float), sigma), 1e-3))
