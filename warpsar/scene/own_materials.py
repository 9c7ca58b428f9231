"""Bodies of one kind that each have a material of their own: a brightness, and a share of detail, to be learned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from warpsar.effects.registry import get
from warpsar.world.objects.table import Object
from warpsar.world.tables import Material


def with_own_materials(
    objects: Sequence[Object], materials: Mapping[str, Material], effects: Mapping[str, Mapping[str, Any]]
) -> tuple[list[Object], dict[str, Material], dict[str, dict[str, Any]], list[str]]:
    """Objects with `own_material` have one that is called as they are, and begins as the one that they state.

    Effects that name the stated one name the own ones beside it, with the same numbers. A material that no object
    states any longer is left out. Also returns what is wrong with names.
    """
    given, problems = dict(materials), []
    owns: dict[str, list[str]] = {}
    for index, one in enumerate(objects):
        if not one.own_material or one.material is None or one.material not in materials:
            continue
        if one.label in materials:
            said = f"found a material {one.label!r} in the file; must have another name, or no own_material"
            problems.append(f"objects[{index}] ({one.label}).own_material: {said}")
        given[one.label] = materials[one.material]
        owns.setdefault(one.material, []).append(one.label)
    found = [_with_its_own(one) if one.own_material else one for one in objects]
    left = set(owns) - {one.material for one in found}
    tables = {name: _with_names(name, table, owns, left) for name, table in effects.items()}
    return found, {name: one for name, one in given.items() if name not in left}, tables, problems


def _with_its_own(one: Object) -> Object:
    stated = one.model_dump(mode="python", exclude_unset=True, exclude={"own_material"}, warnings=False)
    return Object.model_validate({**stated, "material": one.label})


def _with_names(
    effect: str, table: Mapping[str, Any], owns: Mapping[str, Sequence[str]], left: set[str]
) -> dict[str, Any]:
    """An effect's table with own materials wherever it names the one that they began as."""
    found = dict(table)
    for key in ("materials", *(p.name for p in get(effect).parameters if p.per_material)):
        stated = table.get(key)
        if isinstance(stated, Mapping):
            more = {own: stated[name] for name in stated for own in owns.get(name, ())}
            found[key] = {name: value for name, value in {**stated, **more}.items() if name not in left}
        elif stated:
            names = [own for name in stated for own in (name, *owns.get(name, ()))]
            found[key] = [name for name in names if name not in left]
    return found
