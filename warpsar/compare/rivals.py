"""Predictions of a view that need no physics: other measured images of the same target.

They turn with it as pictures, about the image's middle. A model that does not predict better has explained nothing.
A picture has speckle of its own, which no view shares and no model has. So one of the rivals is smoothed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import affine_transform, gaussian_filter

from warpsar.compare.aim import SMOOTHED_PX


@dataclass(frozen=True)
class Seen:
    """A measured image, power (rows, cols), NaN where nothing is used, and from where it was taken [deg]."""

    name: str
    azimuth_deg: float
    incidence_deg: float
    power: np.ndarray


def turn_deg(a: float, b: float) -> float:
    """a - b, -180 to 180 degrees."""
    return (a - b + 180.0) % 360.0 - 180.0


def turned(seen: Seen, azimuth_deg: float, spacing_m: tuple[float, float], *, mirror: bool = False) -> np.ndarray:
    """An image turned to another azimuth as a picture; `mirror`: of a target that is alike on both sides, seen from
    the other one."""
    filled = np.where(np.isfinite(seen.power), seen.power, np.nanmedian(seen.power))
    root, own = np.maximum(filled, 0.0) ** 0.25, seen.azimuth_deg
    if mirror:
        root, own = root[:, ::-1], -own
    angle = np.radians(turn_deg(azimuth_deg, own))
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])  # from the turned image back
    steps = np.diag(spacing_m)
    matrix = np.linalg.inv(steps) @ turn @ steps
    middle = (np.array(root.shape) - 1.0) / 2.0
    found = affine_transform(root, matrix, middle - matrix @ middle, order=1, mode="nearest")
    return np.asarray(found**4)


def rivals(view: Seen, train: Sequence[Seen], spacing_m: tuple[float, float]) -> Mapping[str, np.ndarray]:
    """`nearest`: the train image of the nearest azimuth. `smoothed`: the same without its speckle, as far as the
    correlation smooths both images. `mirrored`: that nearest to the mirrored azimuth, mirrored. `mean`: of all train
    images, each with the median 1. Among images of one azimuth the nearest incidence decides."""

    def far(one: Seen, azimuth_deg: float) -> tuple[float, float]:
        away = abs(turn_deg(azimuth_deg, one.azimuth_deg))
        return round(away, 1), abs(view.incidence_deg - one.incidence_deg)

    near = min(train, key=lambda one: far(one, view.azimuth_deg))
    other = min(train, key=lambda one: far(one, -view.azimuth_deg))
    levels = [np.nan_to_num(one.power / np.nanmedian(one.power), nan=1.0) for one in train]
    nearest = turned(near, view.azimuth_deg, spacing_m)
    return {
        "nearest": nearest,
        "smoothed": gaussian_filter(nearest, SMOOTHED_PX),
        "mirrored": turned(other, view.azimuth_deg, spacing_m, mirror=True),
        "mean": np.mean(levels, axis=0),
    }
