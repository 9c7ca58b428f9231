"""What a batch makes: views at angles, and the name of each view and each scene."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from decimal import Decimal, InvalidOperation
from itertools import product
from pathlib import Path

from warpsar.errors import InputError
from warpsar.world.tables import View

MOST_VIEWS = 10_000_000


def angles(
    text: str, option: str, low: float, high: float, *, what: str = "angles", ends: bool = False
) -> list[Decimal]:
    """The angles [deg] of "start:stop:step" or of "a,b,c"; as in Python's `range`, the stop is left out.

    Raises InputError for any other text, and for angles outside (low, high), or outside [low, high] with `ends`.
    """
    between = f"from {low:g} to {high:g}" if ends else f"between {low:g} and {high:g}"
    allowed = f"allowed is START:STOP:STEP or A,B,C of {what} {between}"
    try:
        parts = [Decimal(part) for part in re.split("[:,]", text)]
        if ":" in text:
            start, stop, step = parts
            count = math.ceil((stop - start) / step) if step > 0 else 0
            if count > MOST_VIEWS:
                raise InputError(f"{option}: found {text!r}, {count} {what}; allowed are up to {MOST_VIEWS}")
            if count <= 0:
                raise InputError(f"{option}: found {text!r}; {allowed}, STEP above 0 and STOP above START")
            parts = [start + i * step for i in range(count)]
        outside = [angle for angle in parts if not (low < angle < high or (ends and angle in (low, high)))]
    except (InvalidOperation, ValueError, OverflowError):
        raise InputError(f"{option}: found {text!r}; {allowed}") from None
    if outside:
        raise InputError(f"{option}: found {outside[0]}; {allowed}")
    if len(set(parts)) < len(parts):
        raise InputError(f"{option}: found {text!r}, with one of them twice; allowed is each once")
    return parts


def views_at(azimuths: Sequence[Decimal], incidences: Sequence[Decimal]) -> list[View]:
    """A view at every pair of angles [deg], named after them: az000_inc30, with as many decimals as the angles have."""

    def name(values: Sequence[Decimal]) -> Callable[[Decimal], str]:
        decimals = max(0, *(-int(v.normalize().as_tuple().exponent) for v in values))
        width = max(len(f"{v:.{decimals}f}") for v in values)
        return lambda value: f"{value:0{width}.{decimals}f}"

    azimuth, incidence = name(azimuths), name(incidences)
    return [
        View(name=f"az{azimuth(a)}_inc{incidence(i)}", azimuth_deg=float(a), incidence_deg=float(i))
        for a, i in product(azimuths, incidences)
    ]


def labels(paths: Sequence[Path]) -> list[str]:
    """A folder name for each scene file: its stem, its folder's name, or both, whichever tells the files apart."""
    namings: tuple[Callable[[Path], str], ...] = (
        lambda path: path.stem,
        lambda path: path.resolve().parent.name,
        lambda path: f"{path.resolve().parent.name}_{path.stem}",
    )
    for naming in namings:
        found = [re.sub(r"[^\w.+-]", "_", naming(path)) or "scene" for path in paths]
        if len({each.casefold() for each in found}) == len(found):
            return found
    raise InputError(
        "SCENES: found two that have the same name in folders of the same name; allowed are scene files whose folders "
        "or names differ"
    )
