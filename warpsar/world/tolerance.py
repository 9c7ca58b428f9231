"""`tolerance = { KEY = ... }`: how well the value at a key is known, as one standard deviation."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from warpsar.errors import shown

SHARE = r"^(?![0.]* ?%)(\d+(\.\d*)?|\.\d+) ?%$"
"""A share of the known value, such as "5 %", above 0."""
ABOUT = ("about", "sd")
IN_THE_UNIT = "allowed is a number above 0 in the key's unit, because a share of 0 is 0"
ALLOWED = 'allowed is one standard deviation: a number above 0 in the key\'s unit, or a share such as "5 %"'


def known_value(tolerance: Any, stated: float, key: str | None = None) -> float:
    """The value that is known: `about` where the tolerance has one, else the `stated` value of the key.

    `key` names one value where the tolerance's key has a table of them.
    """
    about = tolerance["about"] if isinstance(tolerance, Mapping) else stated
    return float(about[key] if isinstance(about, Mapping) else about)


def known_sd(tolerance: Any, about: float) -> float:
    """One standard deviation in the key's unit; `about` is the known value, of which it may be a share."""
    sd = tolerance["sd"] if isinstance(tolerance, Mapping) else tolerance
    return float(sd.rstrip(" %")) / 100.0 * abs(about) if isinstance(sd, str) else float(sd)


def pinned(tolerance: Any, stated: Any) -> dict[str, Any]:
    """The tolerance with the value that is known, which stays where it is when a fit moves the key's own value.

    `stated` is a number, or a table of view names and numbers.
    """
    if isinstance(tolerance, Mapping):
        return dict(tolerance)
    return {"about": dict(stated) if isinstance(stated, Mapping) else stated, "sd": tolerance}


def refusal(tolerance: Any, stated: Any) -> str | None:
    """What is wrong with a tolerance of a key whose valid value is `stated` (as in `pinned`); None if nothing.

    The text follows the key in a message. Whether `about` lies within the key's bounds is not asked here.
    """
    if isinstance(tolerance, Mapping):
        if set(tolerance) != set(ABOUT):
            return f": found {shown(dict(tolerance))}; allowed is a table of exactly {' and '.join(ABOUT)}"
        about, sd, at = tolerance["about"], tolerance["sd"], ".sd"
        if isinstance(stated, Mapping) != isinstance(about, Mapping) or (
            isinstance(stated, Mapping) and set(about) != set(stated)
        ):
            wanted = f"a table of the views {', '.join(stated)}" if isinstance(stated, Mapping) else "a number"
            return f".about: found {shown(about)}; allowed is {wanted}"
    else:
        about, sd, at = stated, tolerance, ""
    places = about.items() if isinstance(about, Mapping) else [("", about)]
    values = {f".{view}" if view else "": value for view, value in places}
    if bad := [value for value in values.values() if not _finite(value)]:
        return f": found a tolerance of the value {shown(bad[0])}; allowed is one of a finite number"
    if isinstance(sd, str) and re.fullmatch(SHARE, sd):
        if zero := [view for view, value in values.items() if value == 0.0]:
            return f"{at}: found {shown(sd)} of{' ' + zero[0][1:] if zero[0] else ''} 0; {IN_THE_UNIT}"
        return None
    if not _finite(sd) or sd <= 0:
        return f"{at}: found {shown(sd)}; {ALLOWED}"
    return None


def _finite(value: object) -> bool:
    # abs, not isfinite: a whole number may be too long for a float
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf
