"""Published systems, as tables of `[collection]`: round figures of what their operators state."""

from __future__ import annotations

from typing import Any

from warpsar.world.collection import Collection, Preset

PRESETS: dict[Preset, dict[str, Any]] = {
    # TerraSAR-X and its kin: staring spotlight, 0.3 m class, 514 km of height.
    "x-spotlight": {
        "mode": "spotlight",
        "resolution_m": (0.3, 0.3),
        "slant_range_m": 650e3,
        "speed_m_s": 7600.0,
    },
    # Sentinel-1's stripmap: 5.405 GHz, 12.3 m antenna, 693 km of height; 3 m x 5 m.
    "c-stripmap": {
        "mode": "stripmap",
        "resolution_m": (3.0, 5.0),
        "slant_range_m": 850e3,
        "speed_m_s": 7600.0,
    },
    # ALOS-2's stripmap: 1.2365 GHz, 84 MHz, 9.9 m antenna, 628 km of height; 3 m.
    "l-stripmap": {
        "mode": "stripmap",
        "bandwidth_hz": 84e6,
        "resolution_m": (3.0, 5.0),
        "slant_range_m": 750e3,
        "speed_m_s": 7600.0,
    },
}
BANDS_HZ: dict[Preset, tuple[float, float]] = {
    "x-spotlight": (8e9, 12e9),
    "c-stripmap": (4e9, 8e9),
    "l-stripmap": (1e9, 2e9),
}
"""Where the carrier of a preset lies."""
_BAND = ("bandwidth_hz", "start_hz", "stop_hz")


def filled(table: Collection, *, resolved: bool = False) -> Collection:
    """The table with what its preset states and it does not. `resolved`: the width in range is stated elsewhere."""
    stated = {name: value for name, value in table if name in table.model_fields_set and value is not None}
    base: dict[str, Any] = {"mode": "spotlight", "window": "taylor"}
    if table.preset is not None:
        base |= PRESETS[table.preset]
        if resolved or any(name in stated for name in (*_BAND, "resolution_m")):
            base = {name: value for name, value in base.items() if name != "bandwidth_hz"}
    return Collection.model_validate({**base, **stated})
