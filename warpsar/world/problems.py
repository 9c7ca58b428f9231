"""What pydantic finds wrong in a table, in the words of every other message: key, what was found, what is allowed."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import ValidationError

from warpsar.errors import did_you_mean, shown


def problem(key: str, details: Mapping[str, Any], known: Iterable[str]) -> str:
    """One line for one of pydantic's errors; `known` are the keys of the table that it stands in."""
    found, kind = details["input"], details["type"]
    if kind == "extra_forbidden":
        known = list(known)
        return f"{key}: unknown key; must be one of {', '.join(known)}{did_you_mean(details['loc'][-1], known)}"
    if kind == "missing" or found is None:  # TOML has no null
        return f"{key}: missing"
    message = re.sub(r"^(Value error, |Input )", "", details["msg"]).replace("should", "must")
    if kind == "string_pattern_mismatch":
        message = "must be up to 50 letters, digits, '_', '-', '+' and '.', the first a letter, digit or '_'"
    if kind == "too_short":
        message = f"must hold at least {details['ctx']['min_length']}"
    if kind == "path_type":
        message = "must be the name of a file"
    if isinstance(found, dict) and kind == "value_error":
        return f"{key}: {message}" if key else message
    return f"{key}: found {shown(found)}; {message}"


def keys_of(model: Any) -> list[str]:
    """The keys of a table as a scene file has them."""
    return [info.alias or name for name, info in model.model_fields.items()]


def first_problem(error: ValueError, table: Any) -> str:
    """The first of pydantic's errors in making a table, in one line; any other error in its own words."""
    if not isinstance(error, ValidationError):
        return str(error)
    details = error.errors(include_url=False)[0]
    return problem(".".join(map(str, details["loc"])), details, keys_of(table))
