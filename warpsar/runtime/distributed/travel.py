"""Values as bytes that another process of the run reads: numbers, text, lists, arrays and dataclasses of these.

Arrays keep every bit, and JSON keeps every digit of a number. No pickle is ever read.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from typing import Any

import numpy as np

OWN = "warpsar."  # packages of the dataclasses that are made of what was read


def packed(value: Any) -> bytes:
    """The bytes of a value. Raises TypeError for one that is not of the kinds above, at any depth."""
    arrays: list[np.ndarray] = []
    tree = json.dumps(_plain(value, arrays)).encode()
    buffer = io.BytesIO()
    named = {str(number): array for number, array in enumerate(arrays)}
    np.savez(buffer, tree=np.frombuffer(tree, np.uint8), **named)  # type: ignore[arg-type]
    return buffer.getvalue()


def unpacked(data: bytes) -> Any:
    """The value of which `packed` made the bytes."""
    with np.load(io.BytesIO(data), allow_pickle=False) as stored:
        return _made(json.loads(stored["tree"].tobytes()), stored)


def _plain(value: Any, arrays: list[np.ndarray]) -> Any:
    """JSON of a value; `arrays` grows by those in it. All but lists and single values are tables of one kind."""
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("an array of objects cannot go to another process")
        arrays.append(value)
        return {"array": str(len(arrays) - 1)}
    if isinstance(value, list):
        return [_plain(one, arrays) for one in value]
    if isinstance(value, tuple):
        return {"tuple": [_plain(one, arrays) for one in value]}
    if isinstance(value, Mapping):
        return {"table": [[_plain(key, arrays), _plain(one, arrays)] for key, one in value.items()]}
    if is_dataclass(value) and not isinstance(value, type):
        kind = f"{type(value).__module__}:{type(value).__qualname__}"
        own = {one.name: _plain(getattr(value, one.name), arrays) for one in fields(value) if one.init}
        return {"kind": kind, "fields": own}
    raise TypeError(f"a {type(value).__name__} cannot go to another process")


def _made(tree: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """The value of which `_plain` made JSON."""
    if isinstance(tree, list):
        return [_made(one, arrays) for one in tree]
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        return arrays[tree["array"]]
    if "tuple" in tree:
        return tuple(_made(one, arrays) for one in tree["tuple"])
    if "table" in tree:
        return {_made(key, arrays): _made(one, arrays) for key, one in tree["table"]}
    module, _, name = tree["kind"].partition(":")
    kind = getattr(import_module(module), name) if module.startswith(OWN) else None
    if not (isinstance(kind, type) and is_dataclass(kind)):
        raise TypeError(f"{tree['kind']} is no dataclass of warpsar")
    return kind(**{key: _made(one, arrays) for key, one in tree["fields"].items()})
