"""Colours of materials by what they are: grass is green, asphalt grey. Names that say nothing get strong colours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from warpsar.world.library.names import surface_named

COLOURS = {
    "asphalt": "#6f7378",
    "concrete": "#b3ada3",
    "brick": "#b2573c",
    "roof_tiles": "#8c3b2e",
    "gravel": "#a0937f",
    "stone": "#c9c2b0",
    "wood": "#a5733f",
    "glass": "#8fc7d9",
    "metal": "#7d93a8",
    "painted_steel": "#3f76b5",
    "soil_dry": "#c19a6b",
    "soil_wet": "#7a5a3c",
    "grass": "#6da34d",
    "water_calm": "#4a90c2",
    "water_rough": "#2f6f9f",
    "snow_dry": "#eef3f7",
    "snow_wet": "#d3e0ea",
}
"""By surface of the library."""
STRONG = "tab20"
LIGHTER = 0.35  # of the way to white, for each further material of the same surface


def by_meaning(names: Sequence[str]) -> NDArray[np.uint8]:
    """A colour for each material, shape (n, 4), RGBA. A second material of one surface is lighter than the first."""
    found = strong(len(names))
    seen: dict[str, int] = {}
    for index, name in enumerate(names):
        surface = surface_named(name)
        if surface in COLOURS:
            again = seen[surface] = seen.get(surface, -1) + 1
            colour = np.frombuffer(bytes.fromhex(COLOURS[surface][1:]), np.uint8)
            found[index, :3] = 255.0 - (255.0 - colour) * (1.0 - LIGHTER) ** again
    return found


def strong(count: int) -> NDArray[np.uint8]:
    """Colours for names without a meaning, shape (count, 4): strong ones first, then their pale sisters, then again."""
    from matplotlib import colormaps

    table = colormaps[STRONG](np.arange(20), bytes=True)
    return np.concatenate([table[::2], table[1::2]])[np.arange(count) % 20]
