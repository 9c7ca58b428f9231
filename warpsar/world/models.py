"""What a material must state for its backscatter model, and must not (docs/scattering.md)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from warpsar.models import registry
from warpsar.models.base.model import DEFAULT, BackscatterModel

TERM = "learned_term"
"""What `learn` calls the learned term of a material: it is trained while the material's values are held."""
TABLE = "sigma0"
"""What `learn` calls the values of a material's table."""


def keys_of(model: str, among: Sequence[str] | None = None) -> tuple[str, ...]:
    """The keys that sigma0 of a model depends on, in the order of the model; those `among` some keys, in theirs."""
    own = registry.get(model).keys
    return own if among is None else tuple(key for key in among if key in own)


def needless(model: str, key: str) -> bool:
    """Whether a material with this model may leave the value out."""
    return model != DEFAULT and key not in keys_of(model)


def refusals(material: Any, stated: set[str]) -> list[str]:
    """What does not fit the model, in words; `stated` are the keys that the scene file has."""
    model = registry.get(material.model)
    named, tables = f'model = "{model.name}"', _quoted("model = ", _with_tables())
    found = []
    if (material.sigma0 is not None) != model.from_table:
        found.append(
            f"{named} needs sigma0, the name of a CSV"
            if model.from_table
            else f"found sigma0 and {named}; allowed with {tables} alone"
        )
    if material.learned_term is not None and not model.of_surface:
        why = "a table needs none" if model.from_table else "it has no eps_r and rms_height_m for it"
        found.append(f"found learned_term and {named}; {why}")
    if "learn" in stated:
        found += _not_learned(model, material.learn)
    for key, one in registry.own_parameters().items():
        if key not in model.keys and getattr(material, key) != one.default:
            having = _quoted("model = ", [name for name in registry.names() if key in keys_of(name)])
            found.append(f"found {key} and {named}; allowed with {having} alone")
    default = f'allowed with model = "{DEFAULT}" alone'
    if material.specular_fraction != 0.0 and "specular_fraction" not in model.keys:
        found.append(f"found specular_fraction and {named}; {default}")
    if material.spectrum not in model.spectra and not model.from_table:
        found.append(f'found spectrum = "{material.spectrum}" and {named}; allowed are {_quoted("", model.spectra)}')
    if (material.conductor or material.layers or material.thickness_m is not None) and not model.coherent_only:
        found.append(f"found conductor, thickness_m or layers and {named}; {default}")
    return found


def _with_tables() -> list[str]:
    return [name for name in registry.names() if registry.get(name).from_table]


def _quoted(before: str, names: Sequence[str]) -> str:
    return " and ".join(f'{before}"{name}"' for name in names)


def _not_learned(model: BackscatterModel, learn: Sequence[str]) -> Iterator[str]:
    """What `learn` must not name with the model, in words."""
    if TERM in learn and (len(learn) > 1 or not model.of_surface):
        yield f"learn: found {', '.join(learn)} with a material of {model.name}; {TERM} is learned alone"
    if TABLE in learn and not model.from_table:
        tables = _quoted("model = ", _with_tables())
        yield f'learn: found {TABLE} and model = "{model.name}"; allowed with {tables} alone'
    elif TABLE in learn and len(learn) > 1:
        yield f"learn: found {', '.join(learn)}; {TABLE} is learned alone"
    allowed = (*model.keys, TABLE) if model.from_table else model.keys
    for key in learn:
        if key not in (*allowed, TERM, TABLE, "thickness_m") and not key.startswith("layers."):
            yield (
                f"learn: found {key}; sigma0 of the model {model.name} does not depend on it; "
                f"allowed: {', '.join(allowed)}"
            )
