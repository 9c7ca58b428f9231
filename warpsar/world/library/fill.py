"""Keys of a material's table that the user left out, from the library."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from warpsar.errors import InputError, did_you_mean, shown
from warpsar.world.library.surfaces import SURFACES
from warpsar.world.tables import Material


def filled(table: dict[str, Any], frequency_hz: float) -> dict[str, Any]:
    """The table of a material with what its `library` says at this frequency; keys of the table come first.

    Raises InputError for a surface that the library does not know.
    """
    name = table["library"]
    if not isinstance(name, str) or name not in SURFACES:
        listed = ", ".join(SURFACES)
        raise InputError(f"library: found {shown(name)}; must be one of {listed}{did_you_mean(name, SURFACES)}")
    return {**SURFACES[name].table(frequency_hz), **table}


def material(name: str, frequency_hz: float, **changed: Any) -> Material:
    """A surface of the library at this frequency [Hz], with `changed` keys, such as `rms_height_m`.

    Its permittivity is a number like any other: a fit may change it, and starts there. Raises InputError.
    """
    return Material(**filled({"library": name, **changed}, frequency_hz))


def named(names: Iterable[str], frequency_hz: float) -> dict[str, Material]:
    """Those of the names that the library knows, each as a material."""
    return {name: material(name, frequency_hz) for name in names if name in SURFACES}


def beyond(name: str, material: Material, frequency_hz: float) -> str | None:
    """What to say where a material's library states its permittivity for other frequencies."""
    if material.library is None or material.library not in SURFACES:
        return None
    low, high = SURFACES[material.library].band_ghz
    if low <= frequency_hz / 1e9 <= high:
        return None
    return (
        f"materials.{name}: {SURFACES[material.library].source} holds from {low:g} to {high:g} GHz; "
        f"its permittivity at {frequency_hz / 1e9:g} GHz is an extrapolation"
    )
