"""Test images beside the mean of train images of nearly the same azimuth, which is laid on the ground: no physics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, uniform_filter

from warpsar.compare.comparison import Comparison
from warpsar.compare.prediction import FAR_DEG
from warpsar.compare.rivals import turn_deg
from warpsar.measured.ground import pixel_centres, plane_points
from warpsar.speckle.likelihood import best_gain, deviance, expected_deviance
from warpsar.world.tables import View
from warpsar.world.world import World, geometry_of

TILE = 10  # pixels on a side: wider than speckle is correlated, and than a parked car


@dataclass(frozen=True)
class BesideMean:
    """Mean gamma deviance of one test image over that of speckle, for each prediction, on the `pixels` that all have.

    The predictions: `model`, `before`, `mean`, of the train images as they lie on the ground, and `mean_3x3`, the same
    over 3 x 3 pixels. Each has the gain that fits best. `ahead`: by how much the model's is below the lesser of the two
    means; `error` is its standard deviation, from tiles of `TILE` pixels.
    """

    view: str
    polarization: str
    pixels: int
    deviances: Mapping[str, float]
    ahead: float
    error: float

    @property
    def words(self) -> str:
        of = self.deviances
        return (
            f"{self.view} {self.polarization}: deviance {of['model']:.3f} beside {of['mean_3x3']:.3f} of the train "
            f"images' mean on the ground over 3 x 3 pixels, and {of['mean']:.3f} of their mean"
        )


def laid_mean(world: World, images: Sequence[Comparison], view: View) -> np.ndarray:
    """Mean of measured images on the pixels of `view`, as they lie on the plane through the reference point,
    (rows, cols); NaN where one of them has nothing. They are interpolated linearly."""
    shape, spacing, origin = world.grid.shape, world.grid.spacing_m, np.asarray(world.reference_point_m)
    points = plane_points(geometry_of(world, view), origin, *pixel_centres(shape, spacing, (1, 1))) - origin
    laid = []
    for image in images:
        geometry = geometry_of(world, image.view)
        axes = zip((geometry.d, geometry.u), spacing, shape, strict=True)
        places = [points @ axis / step + (size - 1) / 2.0 for axis, step, size in axes]
        laid.append(map_coordinates(image.measured.astype(float), places, order=1, cval=np.nan))
    return np.asarray(np.mean(laid, axis=0))


def beside_means(world: World, models: Mapping[str, Sequence[Comparison]]) -> list[BesideMean]:
    """Every test image that has train images within `FAR_DEG` of azimuth, beside them; `models` by name, `model` first.

    Views about a track are left out: their pixels do not lie on straight lines.
    """
    found = []
    tests = [image for image in models["model"] if image.role == "test"]
    for test in tests:
        near = [
            image
            for image in models["model"]
            if image.role == "train"
            and image.polarization == test.polarization
            and abs(turn_deg(image.view.azimuth_deg, test.view.azimuth_deg)) <= FAR_DEG
        ]
        if not near or any(world.slant_range_m(image.view) is not None for image in (test, *near)):
            continue
        mean = laid_mean(world, near, test.view)
        smooth = np.where(np.isfinite(mean), uniform_filter(np.nan_to_num(mean), 3), np.nan)
        made = {
            name: next(i for i in images if (i.name, i.role) == (test.name, "test")).simulated
            for name, images in models.items()
        }
        found.append(_compared(test, {**made, "mean": mean, "mean_3x3": smooth}))
    return found


def _compared(test: Comparison, made: Mapping[str, np.ndarray]) -> BesideMean:
    looks, measured = test.seen.looks, np.nan_to_num(test.measured.astype(float))
    mask = test.usable & (measured > 0) & np.all([np.nan_to_num(image) > 0 for image in made.values()], axis=0)
    each = {}
    for name, image in made.items():
        modelled = image[mask].astype(float)
        modelled = modelled * best_gain("gamma", measured[mask], modelled, looks)
        each[name] = deviance(measured[mask], modelled, looks) / expected_deviance(looks)
    means = {name: float(of.mean()) for name, of in each.items()}
    less = each[min(("mean", "mean_3x3"), key=lambda name: means[name])] - each["model"]
    rows, cols = (index // TILE for index in np.nonzero(mask))
    tile = rows * mask.shape[1] + cols
    total = np.bincount(tile, less - less.mean())
    error = float(np.sqrt(np.sum(total**2)) / less.size)
    return BesideMean(test.view.name, test.polarization, int(mask.sum()), means, float(less.mean()), error)
