"""Keys of a material's table that the user left out, from the library."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Mapping
from typing import Any

from warpsar.errors import InputError, did_you_mean, shown
from warpsar.world.library.surfaces import DEFAULT, SURFACES
from warpsar.world.tables import Material

_OF_DEFAULT = {"conductor", "thickness_m", "layers", "specular_fraction"}
"""Keys that the default model alone has: a table that states one gets that model."""


def filled(table: dict[str, Any], frequency_hz: float) -> dict[str, Any]:
    """The table of a material with what its `library` says at this frequency; keys of the table come first.

    Raises InputError for a surface that the library does not know.
    """
    name = table["library"]
    if not isinstance(name, str) or name not in SURFACES:
        listed = ", ".join(SURFACES)
        raise InputError(f"library: found {shown(name)}; must be one of {listed}{did_you_mean(name, SURFACES)}")
    model = table.get("model") or (DEFAULT if _OF_DEFAULT & table.keys() else None)
    return {**SURFACES[name].table(frequency_hz, model), **table}


def material(name: str, frequency_hz: float, **changed: Any) -> Material:
    """A surface of the library at this frequency [Hz], with `changed` keys, such as `rms_height_m`.

    Its permittivity is a number like any other: a fit may change it, and starts there. Raises InputError.
    """
    return Material(**filled({"library": name, **changed}, frequency_hz))


def named(names: Iterable[str], frequency_hz: float) -> dict[str, Material]:
    """Those of the names that the library knows, each as a material."""
    return {name: material(name, frequency_hz) for name in names if name in SURFACES}


LARGEST_STEP_DB = 0.5
"""Change of the reflectivity at normal incidence that one permittivity for all views may hide."""


def of_one_frequency(name: str, library: str, frequency_hz: float, views: Mapping[str, float]) -> str | None:
    """What is wrong where a view's own frequency asks for another permittivity than the scene has, or None.

    A material has one permittivity for all views, that of `frequency_hz`. `views` are the frequencies [Hz] of views
    that state their own, by name.
    """
    for view, other_hz in views.items():
        if step := _step(library, frequency_hz, other_hz):
            return (
                f"materials.{name}: found eps_r of {library} at {frequency_hz / 1e9:g} GHz; view {view} has "
                f"{other_hz / 1e9:g} GHz, where it is {step}. A scene has one eps_r for all views: make a scene for "
                f"each frequency, or state eps_r"
            )
    return None


def held(materials: Mapping[str, Material], frequency_hz: float, others_hz: Iterable[float]) -> list[str]:
    """What to say where a sweep uses the library's permittivity at `frequency_hz` for other frequencies [Hz] too."""
    found = []
    for name, one in materials.items():
        if one.library in SURFACES and one.eps_r == material(one.library, frequency_hz).eps_r:
            steps = {other: step for other in others_hz if (step := _step(one.library, frequency_hz, other))}
            for other, step in list(steps.items())[-1:]:
                found.append(
                    f"materials.{name}: eps_r of {one.library} at {frequency_hz / 1e9:g} GHz is used at every "
                    f"frequency; at {other / 1e9:g} GHz it is {step}"
                )
    return found


def _step(library: str, frequency_hz: float, other_hz: float) -> str | None:
    """The permittivity at another frequency and what it changes, in words, where that is more than
    `LARGEST_STEP_DB`."""
    here, other = (SURFACES[library].permittivity(each) for each in (frequency_hz, other_hz))
    step_db = 20.0 * math.log10(_reflectivity(other) / _reflectivity(here))
    if abs(step_db) <= LARGEST_STEP_DB:
        return None
    known, wanted = (f"{eps.real:.3g} - {-eps.imag:.3g}j" for eps in (here, other))
    return f"{wanted} in place of {known} ({step_db:+.1f} dB)"


def _reflectivity(eps: complex) -> float:
    """Magnitude of the field's reflection at normal incidence."""
    root = cmath.sqrt(eps)
    return abs((1.0 - root) / (1.0 + root))


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
