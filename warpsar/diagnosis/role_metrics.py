"""Metrics of all images of a role, dark pixels among them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import numpy as np

from warpsar.compare.comparison import Comparison
from warpsar.compare.metrics import PooledMetrics, pool
from warpsar.diagnosis.dark.pixels import DarkPixels
from warpsar.speckle.likelihood import scaled_deviance


class RoleMetrics(PooledMetrics):
    """Of the compared pixels of several images together.

    `dark_pixels` are those far from everything lit, zeros among them. `dark_measured` and `dark_modelled` are their
    mean beta0, None without any. `dark_impossible`: how many measure more than a trace of the lit pixels' median where
    the model has less than a hundredth of it. `dark_deviance`: the mean of d / E[d] over the others that measure power,
    and where the model has a trace; None without any.
    """

    dark_pixels: int
    dark_measured: float | None
    dark_modelled: float | None
    dark_impossible: int
    dark_deviance: float | None


def role_metrics(images: Sequence[Comparison]) -> RoleMetrics | None:
    """Metrics over the pixels of all images of a role together; None where there are none."""
    pooled = pool(images)
    if pooled is None:
        return None
    return cast(RoleMetrics, {**pooled, **_in_the_dark([dark_of(image) for image in images])})


def dark_of(image: Comparison) -> DarkPixels:
    """Its pixels far from everything lit."""
    return DarkPixels.of(image.seen, image.simulated)


def _in_the_dark(pixels: Sequence[DarkPixels]) -> dict[str, float | int | None]:
    """What `RoleMetrics` says of dark pixels."""

    def gathered(plane: Callable[[DarkPixels], np.ndarray]) -> np.ndarray:
        return np.concatenate([plane(one)[one.interior] for one in pixels])

    measured, modelled = gathered(lambda one: one.measured), gathered(lambda one: one.modelled)
    deviances = [
        scaled_deviance(one.measured[use], one.modelled[use], one.law)
        for one in pixels
        for use in [one.powered & (one.measured > 0)]
    ]
    both = np.concatenate(deviances)
    return {
        "dark_pixels": int(measured.size),
        "dark_measured": float(measured.mean()) if measured.size else None,
        "dark_modelled": float(modelled.mean()) if measured.size else None,
        "dark_impossible": sum(int((one.empty & (one.measured > one.allowed)).sum()) for one in pixels),
        "dark_deviance": float(both.mean()) if both.size else None,
    }
