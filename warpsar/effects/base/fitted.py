"""Which parameters of a declared effect a fit moves: the keys `fixed` and `learn`, which every effect's table has."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from warpsar.errors import InputError, shown

FITTED_KEYS = ("fixed", "learn")


def is_fitted(parameter: str, table: Mapping[str, Any]) -> bool:
    """Whether a fit moves the parameter: one that the table states, and that neither `fixed` nor `learn` holds."""
    return parameter in table and not table.get("fixed", False) and parameter in table.get("learn", table)


def refuse_fitted_keys(table: Mapping[str, Any], parameters: Collection[str], where: str) -> None:
    """Raise InputError for a `fixed` or a `learn` that says nothing; `where` names the table in it."""
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
