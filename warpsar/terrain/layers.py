"""What each layer is: its name in files, its unit, and words for people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["power", "angle", "share", "count", "length", "area", "place", "class"]


@dataclass(frozen=True)
class Layer:
    """`unit` as CF conventions write it. `kind` says how a picture shows it."""

    name: str
    unit: str
    words: str
    kind: Kind
    standard_name: str | None = None
    """Of CF."""


IN_IMAGE = (
    Layer("beta0", "1", "simulated beta0, linear, without noise", "power"),
    Layer("sigma0", "1", "simulated sigma0, linear: beta0 times area_beta / area_sigma", "power"),
    Layer("gamma0", "1", "simulated gamma0, linear: beta0 times area_beta / area_gamma", "power"),
    Layer("noise", "1", "thermal noise as beta0, linear, by the product's annotation", "power"),
    Layer("measured", "1", "the product's pixels as beta0, linear, noise inside", "power"),
    Layer(
        "incidence", "degree", "local incidence, of what is seen at the pixel's middle", "angle", "angle_of_incidence"
    ),
    Layer("ellipsoid_incidence", "degree", "incidence on the ellipsoid there", "angle"),
    Layer("cover", "1", "number of the surface at the pixel's middle, in the file's `surfaces`, from 0", "class"),
    Layer("layover", "1", "share of the pixel in which several surfaces lie over each other", "share"),
    Layer("shadow", "1", "share of the pixel that no lit surface fills", "share"),
    Layer("surfaces", "1", "number of lit surfaces in the pixel, mean over its area", "count"),
    Layer("area_beta", "m2", "area of the pixel in the slant plane", "area"),
    Layer("area_sigma", "m2", "lit area of the ground in the pixel", "area"),
    Layer("area_gamma", "m2", "the same as seen from the radar (Small 2011)", "area"),
    Layer("longitude", "degree_east", "of what is seen at the pixel's middle", "place", "longitude"),
    Layer("latitude", "degree_north", "of what is seen at the pixel's middle", "place", "latitude"),
    Layer(
        "height", "m", "above the WGS 84 ellipsoid, of what is seen there", "length", "height_above_reference_ellipsoid"
    ),
)
"""On the product's own grid: lines and pixels."""

ON_MAP = (
    Layer("beta0", "1", "simulated beta0, linear, of the pixel that shows the cell's middle", "power"),
    Layer("sigma0", "1", "simulated sigma0, linear, of that pixel", "power"),
    Layer("gamma0", "1", "simulated gamma0, linear, of that pixel", "power"),
    Layer("measured", "1", "the product's pixel as beta0, linear, noise inside", "power"),
    Layer("measured_gamma0", "1", "the same less noise, times area_beta / area_gamma: terrain flattened", "power"),
    Layer("incidence", "degree", "local incidence at the cell's middle", "angle", "angle_of_incidence"),
    Layer("layover", "1", "1 where the cell's pixel shows several surfaces in half of it or more", "share"),
    Layer("shadow", "1", "1 where the radar does not see the cell's middle", "share"),
    Layer("surfaces", "1", "number of lit surfaces in that pixel", "count"),
    Layer("line", "1", "line of the product, from 0, fractional", "place"),
    Layer("pixel", "1", "pixel of the product, from 0, fractional", "place"),
)
"""On the map: cells of the elevation model, or parts of them as fine as the product's pixels."""


def of_image(name: str) -> Layer:
    return next(one for one in IN_IMAGE if one.name == name)


def of_map(name: str) -> Layer:
    return next(one for one in ON_MAP if one.name == name)
