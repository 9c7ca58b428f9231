"""What the layers say in a few numbers and words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.io.bands import bands_of, order_statistics, release
from warpsar.runtime.threads import in_threads
from warpsar.terrain.layers import of_image
from warpsar.terrain.result import SimulatedProduct

LEVELS = (5.0, 50.0, 95.0)
"""Percentiles."""


@dataclass(frozen=True)
class LayerSummary:
    """Percentiles of a layer's values, in its unit; dB for powers."""

    name: str
    unit: str
    words: str
    percentiles: tuple[float, ...]


@dataclass(frozen=True)
class TwinSummary:
    """Of the part of the product where there is ground. Shares are of its pixels, from 0 to 1."""

    shape: tuple[int, int]
    ground: float
    layover: float
    shadow: float
    layers: tuple[LayerSummary, ...]
    words: tuple[str, ...]

    def content(self) -> dict[str, Any]:
        return {
            "shares": {"ground": self.ground, "layover": self.layover, "shadow": self.shadow},
            "layers": {
                one.name: dict(zip(("p5", "median", "p95"), one.percentiles, strict=True)) | {"unit": one.unit}
                for one in self.layers
            },
            "words": list(self.words),
        }


def summary(found: SimulatedProduct) -> TwinSummary:
    """Percentiles of each layer, shares of layover and shadow, and sentences for people."""
    image = found.image
    rows, columns = found.window.shape
    covered = _count(image["surfaces"], np.isfinite)
    shares = [_count(image[name], lambda part: part >= 0.5) / max(covered, 1) for name in ("layover", "shadow")]
    layers = []
    percentiles = in_threads([partial(_percentiles, image[name], of_image(name).kind) for name in image])
    for name, values in zip(image, percentiles, strict=True):
        layer = of_image(name)
        unit = "dB" if layer.kind == "power" else layer.unit
        if values:
            layers.append(LayerSummary(name, unit, layer.words, values))
    ground = covered / (rows * columns)
    words = [
        f"{rows} lines x {columns} pixels of {found.product.platform}, {found.pixels}",
        f"ground in {ground:.1%} of them; of those {shares[0]:.2%} in layover, {shares[1]:.2%} in shadow",
        f"heights: {found.elevation.datum.words}",
    ]
    return TwinSummary((rows, columns), ground, shares[0], shares[1], tuple(layers), tuple(words))


def _count(values: np.ndarray, what: Callable[[np.ndarray], np.ndarray]) -> int:
    """How many numbers of a layer are so; where there is no ground they are NaN."""
    total = 0
    for rows in bands_of(values.shape):
        total += int(np.count_nonzero(what(values[rows])))
        release(values)
    return total


def _percentiles(values: np.ndarray, kind: str) -> tuple[float, ...]:
    """`LEVELS` of finite values, linear between neighbours; of powers above zero, in dB. Empty where there are none."""
    share = np.zeros(0)

    def places(count: int) -> NDArray[np.int64]:
        nonlocal share
        share = np.array(LEVELS) / 100.0 * (count - 1)
        return np.concatenate([np.floor(share), np.ceil(share)]).astype(np.int64)

    ends = order_statistics(values, places, above_zero=kind == "power")
    if not ends.size:
        return ()
    low, high = ends.reshape(2, -1)  # their order is that of decibels, too
    if kind == "power":
        low, high = 10.0 * np.log10(low), 10.0 * np.log10(high)
    return tuple((low + (share - np.floor(share)) * (high - low)).tolist())
