"""The backscatter models by name. A file in this folder is a model."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from warpsar.models.base.model import BackscatterModel, SurfaceParameter
from warpsar.models.base.parameters import OF_SURFACES
from warpsar.runtime.plugins import names_in


@cache
def names() -> tuple[str, ...]:
    """All models by their `order`: the default is the first."""
    return tuple(sorted(names_in(__package__), key=lambda name: (get(name).order, name)))


@cache
def get(name: str) -> BackscatterModel:
    """The model called `name`; each module `warpsar.models.<name>` holds it as `MODEL`."""
    model: BackscatterModel = import_module(f"warpsar.models.{name}").MODEL
    return model


@cache
def own_parameters() -> dict[str, SurfaceParameter]:
    """What models have beside the parameters of surfaces, by key. Raises ValueError for a key of two meanings."""
    found = {one.key: one for one in OF_SURFACES}
    for name in names():
        for one in get(name).parameters:
            if found.setdefault(one.key, one) != one:
                raise ValueError(f"model {name}: {one.key} is the key of another parameter already")
    return {key: one for key, one in found.items() if one not in OF_SURFACES}
