"""A scene as the text of a scene file, with the comments of the one it was loaded from."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Any

import tomlkit

from warpsar.errors import InputError
from warpsar.io.images import replacing
from warpsar.world.collection import RENAMED
from warpsar.world.curve import Curve
from warpsar.world.objects.table import Object
from warpsar.world.tables import (
    SURFACE_KEYS,
    Material,
    Table,
    View,
)
from warpsar.world.world import World


def save(scene: World, path: Path) -> None:
    """`Scene.save`."""
    with replacing(path) as temporary:
        text = _Writer(scene, path.parent.resolve()).text()
        temporary.write_text(text, encoding="utf-8", newline="\n")


class _Writer:
    """The text of a scene file in `folder`."""

    def __init__(self, scene: World, folder: Path) -> None:
        self.scene, self.folder = scene, folder

    def text(self) -> str:
        tables = self.tables()
        fresh = tomlkit.dumps(tables)
        if not self.scene.source:
            return fresh
        try:
            document = tomlkit.parse(self.scene.source)
            _merge(document, tables)
            text = tomlkit.dumps(document)
            kept = tomllib.loads(text) == tables
        except Exception:  # a comment is not worth losing a result for
            kept = False
        return text if kept else fresh

    def tables(self) -> dict[str, Any]:
        scene = self.scene
        if scene.mesh_path is None and (scene.assembly is None or scene.assembly.base is not None):
            raise InputError("a scene without a mesh file cannot be saved: write the mesh and give mesh_path")
        head: dict[str, Any] = {} if scene.mesh_path is None else {"mesh": self.relative(scene.mesh_path)}
        if any(scene.reference_point_m):
            head["reference_point_m"] = list(scene.reference_point_m)
        if scene.accuracy_m is not None:
            head["accuracy_m"] = scene.accuracy_m
        if scene.origin is not None:
            head["origin"] = _plain(scene.origin)
        tables: dict[str, Any] = {"scene": head, "radar": _plain(scene.radar)}
        if scene.views:
            tables["image"] = _plain(scene.grid)
        if sampling := _plain(scene.sampling):
            tables["sampling"] = sampling
        tables["materials"] = {name: self.material(material) for name, material in scene.materials.items()}
        if scene.effects:
            tables["effects"] = scene.effects
        if scene.objects:
            tables["objects"] = [self.object(one) for one in scene.objects]
        if scene.curves:
            tables["curves"] = [self.curve(one) for one in scene.curves]
        if scene.collection is not None:
            table = _plain(scene.collection.with_files(self.relative))
            tables["collection"] = {key: value for key, value in table.items() if not _twice(scene, key)}
        if scene.views:
            tables["views"] = [self.view(view) for view in scene.views]
        return tables

    def material(self, material: Material) -> dict[str, Any]:
        table = _plain(material)
        for key in ("sigma0", "learned_term"):
            if key in table:
                table[key] = self.relative(Path(table[key]))
        if material.layout == "texture":
            for key in SURFACE_KEYS:
                if isinstance(table.get(key), str):
                    table[key] = self.relative(Path(table[key]))
        return table

    def curve(self, one: Curve) -> dict[str, Any]:
        mesh = {} if one.mesh is None else {"mesh": self.relative(one.mesh)}
        return {**_plain(one), "file": self.relative(one.file), **mesh}

    def object(self, one: Object) -> dict[str, Any]:
        table = _plain(one)
        return table if one.mesh is None else {**table, "mesh": self.relative(one.mesh)}

    def view(self, view: View) -> dict[str, Any]:
        table = _plain(view)
        if abs(view.azimuth_deg) > 360.0:  # all views were turned together
            table["azimuth_deg"] = view.azimuth_deg % 360.0
        for key in {"images", "slc"} & set(table):
            table[key] = {name: self.relative(Path(path)) for name, path in table[key].items()}
        if "mask" in table:
            table["mask"] = self.relative(Path(table["mask"]))
        return table

    def relative(self, path: Path) -> str:
        try:
            return Path(os.path.relpath(self.folder / path, self.folder)).as_posix()
        except ValueError:  # another drive
            return path.as_posix()


def _twice(scene: World, key: str) -> bool:
    """Whether an effect says what an old key of `[collection]` did: a fit may have found the effect beside it."""
    return RENAMED.get(key, "").removeprefix("effects.") in scene.effects


def _plain(table: Table) -> dict[str, Any]:
    """What was stated or changed of a table, as TOML knows it."""
    # warnings: a field with a validator of its own is serialized twice, and the second time its pair is a list.
    return table.model_dump(mode="json", by_alias=True, exclude_unset=True, exclude_none=True, warnings=False)


def _merge(document: Any, tables: Any) -> None:
    """Make a parsed TOML container hold `tables`, touching nothing that already does."""
    for key in [key for key in document if key not in tables]:
        del document[key]
    for key, value in tables.items():
        old = document.get(key)
        if isinstance(value, dict) and isinstance(old, dict):
            _merge(old, value)
        elif key in ("views", "objects", "curves") and isinstance(old, list):
            for index, item in enumerate(value):
                if index < len(old):
                    new = [name for name, of in item.items() if isinstance(of, dict) and name not in old[index]]
                    _merge(old[index], item)
                    if new and index + 1 < len(old):
                        old[index][new[-1]].add(tomlkit.nl())  # else the next head stands right below it
                else:
                    old.append(tomlkit.item(item))
            del old[len(value) :]
        elif old is None and not isinstance(value, dict) and key not in ("views", "objects", "curves"):
            _add(document, key, value)
        elif old is None or not _same(old, value):
            document[key] = value


def _add(table: Any, key: str, value: Any) -> None:
    """A new key below the last one. To tomlkit the comments between it and the next table's head are of this table:
    they speak of the next one, so the key goes above them."""
    body = getattr(getattr(table, "value", table), "body", None)
    behind = []
    while body and body[-1][0] is None:  # comments and empty lines have no key
        behind.append(body.pop()[1])
    table[key] = value
    for item in reversed(behind):
        table.add(item)


def _same(old: Any, new: Any) -> bool:
    return bool(old == new) and isinstance(old, bool) == isinstance(new, bool)
