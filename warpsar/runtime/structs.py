"""Structs that kernels take: filled in one way, and the arrays in their fields."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import warp as wp
from warp.types import is_struct


def fill(kind: Any, /, **fields: Any) -> Any:
    """A struct of a `wp.struct` with these fields; an array that is left out has no elements."""
    made = kind()
    for name, value in fields.items():
        setattr(made, name, value)
    return made


def element_types(kind: Any) -> dict[str, Any]:
    """The fields of a `wp.struct` that are arrays, and the types of their elements."""
    return {name: field.type.dtype for name, field in kind.vars.items() if isinstance(field.type, wp.array)}


def allocate(struct: Any, n: int, device: wp.Device | None, /, **fields: Any) -> Any:
    """A struct whose arrays have room for `n` elements each, but for those that are given among `fields`."""
    arrays = {name: dtype for name, dtype in element_types(struct).items() if name not in fields}
    return fill(struct, **fields, **{name: wp.empty(n, dtype=dtype, device=device) for name, dtype in arrays.items()})


def assign(array: wp.array, values: np.ndarray) -> None:
    """Write `values` into an array, from its first element on, as `wp.array.assign` does; on the CPU without copies."""
    device = array.device
    assert device is not None
    if device.is_cpu:
        array.numpy()[: len(values)] = values
    else:
        array.assign(values)


def arrays_in(arguments: Iterable[Any]) -> list[wp.array]:
    """The arrays among a launch's arguments, and those in the fields of its structs."""
    found: list[wp.array] = []
    for argument in arguments:
        if isinstance(argument, wp.array):
            found.append(argument)
        elif is_struct(argument):
            found += arrays_in(_fields(argument).values())
    return found


def with_views(argument: Any, views: Mapping[int, wp.array]) -> Any:
    """An argument with other arrays in the place of those whose `id` is in `views`; a struct without any as it is."""
    if isinstance(argument, wp.array):
        return views.get(id(argument), argument)
    if views and is_struct(argument):
        fields = _fields(argument)
        seen = {name: with_views(value, views) for name, value in fields.items()}
        return argument if all(seen[name] is fields[name] for name in fields) else fill(type(argument), **seen)
    return argument


def renewed(argument: Any) -> Any:
    """An argument, a struct anew: it then has the gradients that its arrays have now.

    A struct holds those of the moment at which a field was set.
    """
    if is_struct(argument):
        return fill(type(argument), **{name: renewed(value) for name, value in _fields(argument).items()})
    return argument


def _fields(struct: Any) -> dict[str, Any]:
    return {name: getattr(struct, name) for name in struct._cls.vars}
