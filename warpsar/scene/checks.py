"""What must fit together in a scene, be it read from a file or made in memory. Each gives a list of what is wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.effects.registry import refused_with, validate
from warpsar.errors import InputError, did_you_mean, refuse_number, shown
from warpsar.models import registry as backscatter
from warpsar.world import scattering_term, sigma0_table
from warpsar.world.collection import RENAMED, Collection
from warpsar.world.curve import Curve
from warpsar.world.library import fill
from warpsar.world.mesh import Mesh
from warpsar.world.objects.table import Object
from warpsar.world.pixels import Pixels, in_memory, mask, measured
from warpsar.world.tables import (
    SURFACE_KEYS,
    Grid,
    Material,
    Origin,
    Radar,
    Sampling,
    View,
    allowed_values,
    within,
)
from warpsar.world.world import World

_SURFACE = "each a warpsar.Material or the name of a surface of the library"


def kinds(world: World) -> list[str]:
    """What a scene made in memory holds that is of another kind than a scene has."""
    effects: Any = world.effects
    found = [
        f"{key}: found {shown(getattr(world, key))}; must be {allowed}"
        for key, sound, allowed in (
            ("mesh", isinstance(world.mesh, Mesh), "a warpsar.Mesh"),
            ("radar", isinstance(world.radar, Radar), "a warpsar.Radar"),
            ("grid", isinstance(world.grid, Grid), "a warpsar.Grid"),
            ("sampling", isinstance(world.sampling, Sampling), "a warpsar.Sampling"),
            ("materials", _named(world.materials, Material, str), f"a dict of names and materials, {_SURFACE}"),
            ("views", _row(world.views, View), "a list of warpsar.View"),
            ("effects", _named(effects, Mapping), "a dict of names and tables"),
            ("reference_point_m", _point(world.reference_point_m), "three numbers"),
            ("origin", isinstance(world.origin, Origin | None), "a warpsar.world.tables.Origin"),
            ("collection", isinstance(world.collection, Collection | None), "a warpsar.world.collection.Collection"),
            ("objects", _row(world.objects, Object), "warpsar.world.objects.table.Object, one or more"),
            ("curves", _row(world.curves, Curve), "warpsar.world.curve.Curve, one or more"),
        )
        if not sound
    ]
    try:
        if world.accuracy_m is not None:
            refuse_number(world.accuracy_m, "accuracy_m", above=True)
        for name, table in effects.items() if _named(effects, Mapping) else ():
            validate(name, dict(table), f"effects.{name}")
    except InputError as error:
        found.append(str(error))
    return found


def _named(given: object, *allowed: type) -> bool:
    return isinstance(given, Mapping) and all(isinstance(one, allowed) for one in given.values())


def _row(given: object, allowed: type) -> bool:
    return isinstance(given, list | tuple) and all(isinstance(one, allowed) for one in given)


def _point(given: Any) -> bool:
    try:
        return bool(np.shape(given) == (3,) and np.isfinite(np.asarray(given, float)).all())
    except (TypeError, ValueError):
        return False


def with_surfaces(
    given: Mapping[str, Material | str], radar: Radar, views: Sequence[View]
) -> tuple[dict[str, Material], list[str], list[str]]:
    """The materials, with those that are named surfaces of the library at the radar's frequency; what is wrong, and
    what should be said."""
    found, problems, warnings = {}, [], []
    others = {view.name: view.frequency_hz for view in views if view.frequency_hz is not None}
    for name, one in given.items():
        if isinstance(one, Material):
            found[name] = one
            continue
        try:
            found[name] = fill.material(one, radar.frequency_hz)
        except InputError as error:
            problems.append(f"materials.{name}: {error}")
            continue
        problems += [wrong for wrong in [fill.of_one_frequency(name, one, radar.frequency_hz, others)] if wrong]
        warnings += [warning for warning in [fill.beyond(name, found[name], radar.frequency_hz)] if warning]
    return found, problems, warnings


def view_names(views: Sequence[View]) -> list[str]:
    """Files are named after views, and file systems may not tell upper from lower case."""
    seen: dict[str, int] = {}
    problems = []
    for index, view in enumerate(views):
        first = seen.setdefault(view.name.casefold(), index)
        if first != index:
            problems.append(f"views[{index}].name: found {view.name!r} again; must differ from views[{first}]'s")
    return problems


def polarizations(key: str, view: View, known: Sequence[str]) -> list[str]:
    return [
        f"{key}.images: found {one}; must be one of radar.polarizations, {', '.join(known)}"
        for one in view.images
        if one not in known
    ]


def with_pixels(view: View) -> View:
    """The view with arrays that `model_copy` has put into it checked and copied, as `View` does. Raises InputError."""
    raw = {key: image for key, image in view.images.items() if in_memory(image) and not isinstance(image, Pixels)}
    changed = {"images": {**view.images, **{key: measured(image, Path) for key, image in raw.items()}}} if raw else {}
    if in_memory(view.mask) and not isinstance(view.mask, Pixels):
        changed["mask"] = mask(view.mask, Path)
    return view.model_copy(update=changed) if changed else view


def pixels(key: str, view: View, grid: Grid) -> list[str]:
    """Images and masks in memory: those in files are read with the shape that they must have."""
    given = {**{f"{key}.images.{name}": image for name, image in view.images.items()}, f"{key}.mask": view.mask}
    return [
        f"{where}: found {one.shape[0]} x {one.shape[1]} pixels; must be {grid.shape[0]} x {grid.shape[1]} (grid.shape)"
        for where, one in given.items()
        if isinstance(one, Pixels) and one.shape != tuple(grid.shape)
    ]


def material_names(given: Sequence[str], mesh: Mesh, where: str) -> list[str]:
    if set(given) == set(mesh.materials):
        return []
    found = ", ".join(given) or "none"
    unknown = "".join(
        f"; no {name}{did_you_mean(name, mesh.materials)}" for name in given if name not in mesh.materials
    )
    return [f"materials: found {found}; must be those of {where}: {', '.join(mesh.materials)}{unknown}"]


def models(name: str, material: Material, radar: Radar, effects: Mapping[str, Any]) -> list[str]:
    """What a material's backscatter model does not have: a polarization, an effect that works on the default alone."""
    key, model = f"materials.{name}", material.model
    problems = []
    for one in refused_with(model):
        if one in effects:
            taken = (other for other in backscatter.names() if one not in refused_with(other))
            problems.append(f'{key}.model: found "{model}" and effects.{one}; allowed with it: {", ".join(taken)}')
    channels = backscatter.get(model).channels
    if lacking := [one for one in radar.polarizations if one not in channels]:
        problems.append(f'{key}.model: found "{model}" and {lacking[0]}; it has {" and ".join(channels)} alone')
    if material.learned_term is not None:
        try:
            learned_for = scattering_term.read(material.learned_term).model
            if learned_for != model:
                found = f'{material.learned_term}: found a term of "{learned_for}"'
                problems.append(f'{key}.learned_term: {found}; must be of "{model}"')
        except InputError as error:
            problems.append(f"{key}.learned_term: {error}")
    if material.sigma0 is not None:
        try:
            table = sigma0_table.read(material.sigma0)
        except InputError as error:
            return [*problems, f"{key}.sigma0: {error}"]
        missing = [one for one in radar.polarizations if {"VH": "HV"}.get(one, one) not in table.sigma0_db]
        if missing:
            has = ", ".join(table.sigma0_db)
            problems.append(f"{key}.sigma0: {material.sigma0}: found {has}; must have {', '.join(missing)} too")
    return problems


def fields(name: str, material: Material, mesh: Mesh) -> list[str]:
    """What a material that is not uniform needs of its mesh: UV, or the scalars that it names."""
    if material.layout == "uniform" or name not in mesh.materials:
        return []
    key = f"materials.{name}"
    corners = mesh.faces[mesh.face_material == mesh.materials.index(name)]
    if material.layout == "texture":
        placed = mesh.uv is not None and not np.isnan(mesh.uv[corners]).any()
        return [] if placed else [f'{key}.layout: found "texture"; its faces must have UV in the mesh']
    problems = [] if corners.size else [f'{key}.layout: found "vertex", and no face of that material; must have one']
    for field_key in SURFACE_KEYS:
        value = getattr(material, field_key)
        if not isinstance(value, str):
            continue
        if value in mesh.vertex_scalars:
            used = mesh.vertex_scalars[value][np.unique(corners)]
            problems += values(f"{key}.{field_key}: scalar {value!r}", field_key, used)
        else:
            known = ", ".join(mesh.vertex_scalars) or "it has none"
            problems.append(f"{key}.{field_key}: found {value!r}; must be a vertex scalar of the mesh ({known})")
    return problems


def values(where: str, key: str, given: NDArray[Any]) -> list[str]:
    bad = ~within(key, given)  # NaN is within nothing
    if not bad.any():
        return []
    return [
        f"{where}: {int(bad.sum())} of {given.size} values are out of range "
        f"(one is {float(given[bad][0]):g}); each must be {allowed_values(key)}"
    ]


def declared_twice(effects: Mapping[str, Any], collection: Collection) -> list[str]:
    """What an effect and an old key of `[collection]` both state."""
    found = []
    for key in collection.old_keys:
        name = RENAMED[key]
        if name.removeprefix("effects.") in effects:
            found.append(f"collection.{key}: found beside [{name}], which says the same; leave collection.{key} out")
    return found
