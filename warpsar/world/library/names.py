"""Which surface of the library a mesh means by the name of a material."""

from __future__ import annotations

import re

from warpsar.world.library.surfaces import SURFACES

MEANT = {
    "road": "asphalt",
    "roads": "asphalt",
    "street": "asphalt",
    "parking": "asphalt",
    "tarmac": "asphalt",
    "pavement": "concrete",
    "cement": "concrete",
    "wall": "brick",
    "walls": "brick",
    "bricks": "brick",
    "roof": "roof_tiles",
    "roofs": "roof_tiles",
    "tiles": "roof_tiles",
    "ground": "grass",
    "terrain": "grass",
    "lawn": "grass",
    "meadow": "grass",
    "rock": "stone",
    "stones": "stone",
    "timber": "wood",
    "window": "glass",
    "windows": "glass",
    "steel": "painted_steel",
    "car": "painted_steel",
    "vehicle": "painted_steel",
    "aluminium": "metal",
    "aluminum": "metal",
    "iron": "metal",
    "soil": "soil_dry",
    "earth": "soil_dry",
    "sand": "soil_dry",
    "water": "water_calm",
    "river": "water_calm",
    "lake": "water_calm",
    "sea": "water_rough",
    "snow": "snow_dry",
}
"""Words that are no names of surfaces, and the surface that they are taken for: our choice, for a first scene."""


def surface_named(material: str) -> str | None:
    """The surface, or None where no word of the name says any.

    The whole name counts first, then its words from the last one on, since that is the noun: "red brick", "brick wall".
    Case and numbers do not count: "Asphalt.001" is asphalt.
    """
    words = [word for word in re.split(r"[\W\d_]+", material.lower()) if word]
    for name in ("_".join(words), *reversed(words)):
        if name in SURFACES:
            return name
        if name in MEANT:
            return MEANT[name]
    return None
