"""What rays leave: hits, and the grid of bins that they fall into."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any

import warp as wp

from warpsar.world.frame import ViewGeometry

DEFAULT_MEMORY_GIB = 2.0


@dataclass(frozen=True)
class BinGrid:
    """Bins of [range, azimuth] about the reference point: shape (rows, cols), `spacing_m` (range, azimuth) [m].

    `bins_per_pixel` of them, per axis, make a pixel of the image; the grid may be wider than the image, by whole
    pixels and as much on each side.
    """

    shape: tuple[int, int]
    spacing_m: tuple[float, float]
    bins_per_pixel: int = 1

    @property
    def start_m(self) -> tuple[float, float]:
        """Range of row 0's and azimuth of column 0's outer edge [m]."""
        return (-self.shape[0] / 2 * self.spacing_m[0], -self.shape[1] / 2 * self.spacing_m[1])

    @property
    def pixel_area_m2(self) -> float:
        return self.spacing_m[0] * self.spacing_m[1]


@dataclass
class Hits:
    """Lit surface of one view, on a device; arrays of shape (n,).

    `pixel` is row * cols + col in `grid`; `barycentric` holds the weights of the face's second and third vertex;
    `weight` is the sum of dA_perp / cos(theta) over the rays, divided by the pixel area (scene-format.md, "Pixel
    value"); `point` [m] is about the reference point; `cos_twist` is cos psi of the facet's basis, and
    `cos2_azimuth` tells how the look direction lies to the facet's horizontal (for the separable spectrum alone).
    """

    grid: BinGrid
    geometry: ViewGeometry
    pixel: wp.array
    face: wp.array
    barycentric: wp.array
    weight: wp.array
    point: wp.array
    cos_incidence: wp.array
    cos_twist: wp.array
    cos2_azimuth: wp.array
    rays_per_m2: float
    seed: int
    rays: int
    derived: dict[Hashable, Any] = field(default_factory=dict)  # worked out once, for all that share the hits

    @property
    def count(self) -> int:
        return int(self.pixel.shape[0])


def concatenate(parts: list[Any], dtype: Any, device: Any) -> Any:
    if len(parts) == 1:
        return parts[0]
    whole = wp.empty(sum(p.shape[0] for p in parts), dtype=dtype, device=device)
    at = 0
    for part in parts:
        wp.copy(whole, part, dest_offset=at, count=part.shape[0])
        at += part.shape[0]
    return whole
