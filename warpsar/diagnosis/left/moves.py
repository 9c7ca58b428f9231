"""Whether what is left moves with the surface or with the image, from view to view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from warpsar.compare.observation import Observation
from warpsar.diagnosis.models.carried import on_the_surface
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.scene.scene import Scene

SMOOTHED = 3  # pixels on a side, over which the other views' residual is averaged
STANDS_OUT = 2.5  # standard deviations of that average, from which it is carried over
MOST = 16.0  # of a squared residual: a few pixels shall not decide
SURE = 4.0  # standard deviations from which the other views are said to show it


@dataclass(frozen=True)
class ResidualMotion:
    """`way`: "surface", "image", "both", "neither" (single views hold it, or it is faint), or "one view" where nothing
    can be compared. `z_surface`, `z_image`: how well the other views' residual predicts a view's own, carried along
    with the surface or left at its place in the image, in standard deviations."""

    way: str
    z_surface: float
    z_image: float


def moves_with(
    setup: FitSetup, scene: Scene, seen: Sequence[Observation], residuals: Sequence[np.ndarray], spread: float
) -> ResidualMotion:
    """`residuals` are images of the standardised residual, 0 where no pixel is compared; `spread` is the variance of
    a sum of them over that of white ones."""
    pairs = [(k, [o for o, other in enumerate(seen) if _comparable(other, mine)]) for k, mine in enumerate(seen)]
    if not any(others for _, others in pairs):
        return ResidualMotion("one view", 0.0, 0.0)
    fields = [_standing_out(residual, spread) for residual in residuals]
    scores, energies = np.zeros(2), np.zeros(2)
    for k, others in pairs:
        mine = seen[k]
        if not others:
            continue
        own = np.minimum(residuals[k] ** 2, MOST)
        here = residuals[k] != 0
        own = np.where(here, own - own[here].mean() if here.any() else 0.0, 0.0)
        carried = np.zeros((2, here.size))
        for o in others:
            carried += on_the_surface(setup, scene, mine.view, seen[o], fields[o])
        by_surface = np.where(carried[1] > 0, carried[0] / np.where(carried[1] > 0, carried[1], 1.0), 0.0)
        by_image = np.mean([fields[o] for o in others], axis=0).ravel()
        for which, field in enumerate((by_surface, by_image)):
            field = np.where(here.ravel(), field, 0.0)
            scores[which] += float(field @ own.ravel())
            energies[which] += float(field @ field) * float(own[here].var()) * spread
    surface, image = scores / np.sqrt(np.maximum(energies, 1e-12))
    way = "neither"
    if max(surface, image) > SURE:
        way = "surface" if surface > image else "image"
        if min(surface, image) > max(SURE, 0.7 * max(surface, image)):
            way = "both"
    return ResidualMotion(way, float(surface), float(image))


def _comparable(other: Observation, mine: Observation) -> bool:
    return other.view.name != mine.view.name and other.polarization == mine.polarization


def _standing_out(residual: np.ndarray, spread: float) -> np.ndarray:
    """Where the residual, averaged over a few pixels, is more than speckle makes, up or down; shape (rows, cols).

    Its size counts, not its sign: what stands on the ground is bright from one side and a shadow from another.
    """
    mask = (residual != 0).astype(float)
    share = uniform_filter(mask, SMOOTHED, mode="constant")
    mean = uniform_filter(residual * mask, SMOOTHED, mode="constant") / np.maximum(share, 1e-6)
    error = np.sqrt(spread / np.maximum(share * SMOOTHED**2, 1.0))
    return np.where((np.abs(mean) > STANDS_OUT * error) & (mask > 0), np.abs(mean), 0.0)
