"""Which parameters of a declared effect a fit moves: the keys `fixed` and `learn`, which every effect's table has.

`tolerance` beside them says how well they are known (learning/prior.py).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from warpsar.errors import InputError, shown
from warpsar.world import tolerance

FITTED_KEYS = ("fixed", "learn", "tolerance")


def is_fitted(parameter: str, table: Mapping[str, Any]) -> bool:
    """Whether a fit moves the parameter: one that the table states, and that neither `fixed` nor `learn` holds."""
    return parameter in table and not table.get("fixed", False) and parameter in table.get("learn", table)


def refuse_fitted_keys(table: Mapping[str, Any], parameters: Collection[str], where: str) -> None:
    """Raise InputError for a `fixed`, `learn` or `tolerance` that says nothing; `where` names the table in it."""
    fixed, learn = table.get("fixed", False), table.get("learn", [])
    if not isinstance(fixed, bool):
        raise InputError(f"{where}.fixed: found {shown(fixed)}; allowed is true or false")
    stated = [name for name in parameters if name in table]
    allowed = f"allowed are parameters that this table states ({', '.join(stated) or 'it states none'})"
    if not isinstance(learn, list | tuple):
        raise InputError(f"{where}.learn: found {shown(learn)}; allowed is a list; {allowed}")
    for name in learn:
        if name not in stated:
            raise InputError(f"{where}.learn: found {shown(name)}; {allowed}")
    if fixed and learn:
        raise InputError(f"{where}: found fixed = true and learn = {shown(list(learn))}; allowed is one of them")
    _refuse_tolerances(table, parameters, f"{where}.tolerance")


def _refuse_tolerances(table: Mapping[str, Any], parameters: Collection[str], where: str) -> None:
    known = table.get("tolerance", {})
    fitted = [name for name in parameters if is_fitted(name, table)]
    allowed = f"allowed are parameters of this table that a fit moves ({', '.join(fitted) or 'it moves none'})"
    if not isinstance(known, Mapping):
        raise InputError(f"{where}: found {shown(known)}; allowed is a table; {allowed}")
    for name, one in known.items():
        if name not in fitted:
            raise InputError(f"{where}: found {shown(name)}; {allowed}")
        if (problem := tolerance.refusal(one, table[name])) is not None:
            raise InputError(f"{where}.{name}{problem}")
