"""What rays find: lit points of the surface (hits), and the grid of bins that they fall into."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import warp as wp

from warpsar.kernels.trace import HitArrays
from warpsar.runtime.structs import element_types, fill
from warpsar.world.frame import ViewGeometry

DEFAULT_MEMORY_GIB = 2.0
ARRAYS = element_types(HitArrays)
"""The arrays of `Hits`, and the types of their elements."""


@dataclass(frozen=True)
class Strip:
    """Which part of an image a grid holds. `azimuth_m`: of its middle [m]. `beside`: how far on each side of it rays of
    several bounces enter, in widths of it."""

    azimuth_m: float = 0.0
    beside: float = 0.5


WHOLE = Strip()


@dataclass(frozen=True)
class BinGrid:
    """Bins of (range, azimuth) about the reference point: `shape` (rows, cols), `spacing_m` (range, azimuth) [m].

    A pixel of the image has `bins_per_pixel` bins along each axis. The grid may be wider than the image, by whole
    pixels and by as much on each side. `strip`: which part of an image it holds.
    """

    shape: tuple[int, int]
    spacing_m: tuple[float, float]
    bins_per_pixel: int = 1
    strip: Strip = WHOLE

    @property
    def start_m(self) -> tuple[float, float]:
        """Range of row 0's and azimuth of column 0's outer edge [m]."""
        first_column = self.strip.azimuth_m - self.shape[1] / 2 * self.spacing_m[1]
        return (-self.shape[0] / 2 * self.spacing_m[0], first_column)

    @property
    def pixel_area_m2(self) -> float:
        return self.spacing_m[0] * self.spacing_m[1]


@dataclass
class Hits:
    """The lit surface of one view, on a device: one hit is one face in one bin. Every array has shape (n,)."""

    grid: BinGrid
    geometry: ViewGeometry
    pixel: wp.array
    """int: row * cols + col in `grid`."""
    face: wp.array
    """int: the face of the mesh."""
    barycentric: wp.array
    """vec2: weights of the face's second and third vertex."""
    weight: wp.array
    """float: sum of dA_perp / cos(incidence) over the rays, divided by the pixel area."""
    point: wp.array
    """vec3 [m], about the reference point."""
    cos_incidence: wp.array
    """float: cosine of the local incidence angle."""
    cos_twist: wp.array
    """float: cosine of the angle psi between the radar's polarization basis and the facet's."""
    cos2_azimuth: wp.array
    """float: how the look direction lies to the facet's horizontal; the separable spectrum alone needs it."""
    rays_per_m2: float
    seed: int
    rays: int
    coarse: bool = False
    """Whether effects that send rays of their own leave out what only makes their bright points more exact."""
    derived: dict[Any, Any] = field(default_factory=dict)
    """What was worked out from these hits (shading samples, an effect's paths or edges): models that share the hits
    share it. Filled under each user's own key."""

    @property
    def count(self) -> int:
        return int(self.pixel.shape[0])

    @property
    def arrays(self) -> Any:
        """All arrays as kernels take them."""
        return fill(HitArrays, **{name: getattr(self, name) for name in ARRAYS})


def concatenate(parts: list[wp.array], dtype: type, device: wp.Device) -> wp.array:
    """The arrays one after the other, as a new array of `dtype`; a single one as it is."""
    if len(parts) == 1:
        return parts[0]
    whole = wp.empty(sum(p.shape[0] for p in parts), dtype=dtype, device=device)
    at = 0
    for part in parts:
        wp.copy(whole, part, dest_offset=at, count=part.shape[0])
        at += part.shape[0]
    return whole
