"""scene.toml in and out: everything refused at the door, comments kept on the way out."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, ValidationError, field_validator

from warpsar.errors import InputError, shown
from warpsar.images import read_channel, read_mask, replacing
from warpsar.mesh import Mesh, read_mesh
from warpsar.scene import (
    SURFACE_KEYS,
    FileName,
    Grid,
    Material,
    Number,
    Radar,
    Sampling,
    Scene,
    Table,
    View,
    allowed_values,
    within,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray


LARGEST_FILE = 2**24
"""Bytes of a scene file: 50,000 views."""
_MOST_KEY_PARTS = 100
_MOST_SHOWN = 50


def load(path: Path) -> Scene:
    """`Scene.load`."""
    text, raw = read(path)
    path = path.parent.resolve() / path.name
    file, problems = _parse(raw)
    effects = _parse_effects(raw, problems)
    _refuse(path, problems)
    assert file is not None
    return _Loader(path, text, file, effects).scene()


def save(scene: Scene, path: Path) -> None:
    """`Scene.save`."""
    with replacing(path) as temporary:
        text = _Writer(scene, path.parent.resolve()).text()
        temporary.write_text(text, encoding="utf-8", newline="\n")


class _SceneTable(Table):
    mesh: FileName
    reference_point_m: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)

    @field_validator("reference_point_m")
    @classmethod
    def _near(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if max(map(abs, value)) > 1e8:
            raise ValueError("must be three numbers within 1e8 m")
        return value


class _File(Table):
    scene: _SceneTable
    radar: Radar
    image: Grid
    sampling: Sampling = Sampling()
    materials: Annotated[dict[str, Material], Field(min_length=1)]
    effects: dict[str, dict[str, Any]] = Field(default_factory=dict)
    views: Annotated[list[View], Field(min_length=1)]


_TABLES: dict[str, type[Table]] = {
    "scene": _SceneTable,
    "radar": Radar,
    "image": Grid,
    "sampling": Sampling,
    "materials": Material,
    "views": View,
}


# ---- what is in the file ----


def read(path: Path) -> tuple[str, dict[str, Any]]:
    """A scene file's text, and its tables as they stand there; raises InputError for what is not TOML."""
    text = _read_text(path)
    lines = (line.partition("#")[0] for line in text.splitlines())
    if any(part.count(".") > _MOST_KEY_PARTS for line in lines for part in re.split(r"[=,{}\[\]]", line)):
        raise InputError(f"{path}: found a key of more than {_MOST_KEY_PARTS} parts; must be fewer")  # time ~ parts^2
    try:
        return text, tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: also numbers of thousands of digits
        raise InputError(f"{path}: not valid TOML ({error})") from error


def _read_text(path: Path) -> str:
    try:
        if path.exists() and not path.is_file():  # a FIFO waits for ever, a device never ends
            raise InputError(f"{path}: cannot be read as a scene file (a directory, pipe or device)")
        if (size := path.stat().st_size) > LARGEST_FILE:
            raise InputError(f"{path}: found a scene file of {size} bytes; must be at most {LARGEST_FILE}")
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read as a scene file ({reason})") from error
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        byte = f"byte {error.start} is 0x{data[error.start]:02x}"
        raise InputError(f"{path}: not UTF-8 text ({byte})") from error


def _parse(raw: dict[str, Any]) -> tuple[_File | None, list[str]]:
    try:
        return _File.model_validate(raw), []
    except ValidationError as error:
        return None, [_problem(details, raw) for details in error.errors(include_url=False)]


def _parse_effects(raw: Mapping[str, Any], problems: list[str]) -> dict[str, dict[str, Any]]:
    from warpsar.effects import validate

    effects = {}
    tables = raw.get("effects", {})
    for name, table in tables.items() if isinstance(tables, dict) else ():
        if isinstance(table, dict):
            try:
                effects[name] = validate(name, table, f"effects.{name}")
            except InputError as error:
                problems.append(str(error))
    return effects


def _refuse(path: Path, problems: list[str]) -> None:
    if len(problems) == 1:
        raise InputError(f"{path}: {problems[0]}")
    if problems:
        more = [f"and {len(problems) - _MOST_SHOWN} more"] if len(problems) > _MOST_SHOWN else []
        listed = [f"{path}: {len(problems)} things are wrong", *problems[:_MOST_SHOWN], *more]
        raise InputError("\n  ".join(listed))


def _problem(details: Mapping[str, Any], raw: dict[str, Any]) -> str:
    """One of pydantic's errors as: key, what was found, what is allowed."""
    place = tuple(part for part in details["loc"] if part != "[key]")
    key = _key(place, raw)
    found, kind = details["input"], details["type"]
    if kind == "missing":
        return f"{key}: missing"
    if kind == "extra_forbidden":
        model = _TABLES[str(place[0])] if len(place) > 1 else _File
        known = [info.alias or name for name, info in model.model_fields.items()]
        return f"{key}: unknown key; must be one of {', '.join(known)}"
    message = re.sub(r"^(Value error, |Input )", "", details["msg"]).replace("should", "must")
    if kind == "string_pattern_mismatch":
        message = "must be up to 50 letters, digits, '_', '-', '+' and '.', the first a letter, digit or '_'"
    if isinstance(found, dict) and kind == "value_error":
        return f"{key}: {message}"
    return f"{key}: found {shown(found)}; {message}"


def _key(place: tuple[int | str, ...], raw: dict[str, Any]) -> str:
    key = ""
    for depth, part in enumerate(place):
        if isinstance(part, int):
            key += f"[{part}]"
            if place[0] == "views" and depth == 1 and isinstance(name := raw["views"][part], dict):
                key += f" ({shown(name.get('name')).strip(chr(39))})" if "name" in name else ""
        else:
            part = part if re.fullmatch(r"[\w-]+", part) else shown(part)
            key += f".{part}" if key else part
    return key


# ---- what the file refers to ----


def _has_uv(mesh: Mesh, corners: NDArray[np.int32]) -> bool:
    return mesh.uv is not None and not np.isnan(mesh.uv[corners]).any()


class _Loader:
    """Turns a sound `_File` into a `Scene`, collecting everything that is wrong with the files it names."""

    def __init__(self, path: Path, text: str, file: _File, effects: dict[str, dict[str, Any]]) -> None:
        self.path, self.text, self.file, self.effects = path, text, file, effects
        self.problems: list[str] = []
        self.warnings: list[str] = []

    def scene(self) -> Scene:
        from warpsar.effects import check as check_effects

        file = self.file
        mesh_path = self.absolute(file.scene.mesh)
        mesh: Mesh | None = None
        try:
            mesh = read_mesh(mesh_path)
        except InputError as error:
            self.problems.append(f"scene.mesh: {error}")
        views = [self.view(index, view) for index, view in enumerate(file.views)]
        self.unique_names(views)
        materials = {name: self.material(name, table, mesh) for name, table in file.materials.items()}
        if mesh is not None and set(materials) != set(mesh.materials):
            self.problems.append(
                f"materials: found {', '.join(materials)}; must be those of the mesh {mesh_path}: "
                f"{', '.join(mesh.materials)}"
            )
        _refuse(self.path, self.problems)
        assert mesh is not None
        scene = Scene(
            mesh=mesh,
            radar=file.radar,
            grid=file.image,
            materials={name: materials[name] for name in mesh.materials},
            views=views,
            sampling=file.sampling,
            effects=self.effects,
            reference_point_m=file.scene.reference_point_m,
            path=self.path,
            mesh_path=mesh_path,
            warnings=(*(f"{mesh_path}: {warning}" for warning in mesh.warnings), *self.warnings),
            source=self.text,
        )
        check_effects(scene)
        return scene

    def absolute(self, name: str | Path) -> Path:
        path = self.path.parent / name
        return Path(os.path.realpath(path.parent)) / path.name

    def unique_names(self, views: list[View]) -> None:
        # Files are named after views, and file systems may not tell upper from lower case.
        seen: dict[str, int] = {}
        for index, view in enumerate(views):
            first = seen.setdefault(view.name.casefold(), index)
            if first != index:
                self.problems.append(
                    f"views[{index}].name: found {view.name!r} again; must differ from views[{first}]'s"
                )

    def view(self, index: int, view: View) -> View:
        key = f"views[{index}] ({view.name})"
        images = {polarization: self.absolute(name) for polarization, name in view.images.items()}
        for polarization, path in images.items():
            if polarization not in self.file.radar.polarizations:
                self.problems.append(
                    f"{key}.images: found {polarization}; must be one of radar.polarizations, "
                    f"{', '.join(self.file.radar.polarizations)}"
                )
            self.check_image(f"{key}.images.{polarization}", path, polarization)
        changed: dict[str, Any] = {"images": images} if images else {}
        if view.mask is not None:
            changed["mask"] = self.absolute(view.mask)
            self.check_mask(f"{key}.mask", changed["mask"])
        return view.model_copy(update=changed)

    def check_image(self, key: str, path: Path, polarization: str) -> None:
        try:
            image = read_channel(path, polarization, shape=self.file.image.shape)
        except InputError as error:
            self.problems.append(f"{key}: {error}")
            return
        finite = np.isfinite(image)
        missing, negative = int(image.size - finite.sum()), finite & (image < 0)
        if missing == image.size:
            self.problems.append(f"{key}: {path}: every pixel is NaN or infinite; must be linear power")
        elif negative.any():
            self.problems.append(
                f"{key}: {path}: {int(negative.sum())} pixels are negative "
                f"(down to {float(image[negative].min()):g}); must be linear power, 0 or more"
            )
        elif missing:
            self.warnings.append(f"{key}: {missing} of {image.size} pixels are NaN or infinite and masked")

    def check_mask(self, key: str, path: Path) -> None:
        try:
            mask = read_mask(path, shape=self.file.image.shape)
        except InputError as error:
            self.problems.append(f"{key}: {error}")
            return
        if not mask.any():
            self.problems.append(f"{key}: {path}: every pixel is 0; must be nonzero where pixels are used")

    def material(self, name: str, material: Material, mesh: Mesh | None) -> Material:
        """Check what the names in a material stand for; a texture's become absolute paths."""
        key = f"materials.{name}"
        changed: dict[str, Any] = {}
        corners = np.zeros(0, np.int32)
        if mesh is not None and name in mesh.materials:
            corners = mesh.faces[mesh.face_material == mesh.materials.index(name)]
        if material.layout == "texture" and mesh is not None and not _has_uv(mesh, corners):
            self.problems.append(f'{key}.layout: found "texture"; its faces must have UV in the mesh')
        for field_key in SURFACE_KEYS:
            value = getattr(material, field_key)
            if not isinstance(value, str):
                continue
            where = f"{key}.{field_key}"
            if material.layout == "texture":
                path = self.absolute(value)
                changed[field_key] = str(path)
                try:
                    self.check_values(f"{where}: {path}", field_key, read_channel(path, field_key))
                except InputError as error:
                    self.problems.append(f"{where}: {error}")
            elif mesh is not None:
                if value in mesh.vertex_scalars:
                    values = mesh.vertex_scalars[value][np.unique(corners)]
                    self.check_values(f"{where}: scalar {value!r}", field_key, values)
                else:
                    known = ", ".join(mesh.vertex_scalars) or "it has none"
                    self.problems.append(f"{where}: found {value!r}; must be a vertex scalar of the mesh ({known})")
        return material.model_copy(update=changed)

    def check_values(self, where: str, key: str, values: NDArray[Any]) -> None:
        bad = ~within(key, values)  # NaN is within nothing
        if bad.any():
            self.problems.append(
                f"{where}: {int(bad.sum())} of {values.size} values are out of range "
                f"(one is {float(values[bad][0]):g}); each must be {allowed_values(key)}"
            )


# ---- and back ----


class _Writer:
    """The text of a scene file in `folder`."""

    def __init__(self, scene: Scene, folder: Path) -> None:
        self.scene, self.folder = scene, folder

    def text(self) -> str:
        import tomlkit

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
        if scene.mesh_path is None:
            raise InputError("a scene without a mesh file cannot be saved: write the mesh and give mesh_path")
        head: dict[str, Any] = {"mesh": self.relative(scene.mesh_path)}
        if any(scene.reference_point_m):
            head["reference_point_m"] = list(scene.reference_point_m)
        tables: dict[str, Any] = {"scene": head, "radar": _plain(scene.radar), "image": _plain(scene.grid)}
        if sampling := _plain(scene.sampling):
            tables["sampling"] = sampling
        tables["materials"] = {name: self.material(material) for name, material in scene.materials.items()}
        if scene.effects:
            tables["effects"] = scene.effects
        tables["views"] = [self.view(view) for view in scene.views]
        return tables

    def material(self, material: Material) -> dict[str, Any]:
        table = _plain(material)
        if material.layout == "texture":
            for key in SURFACE_KEYS:
                if isinstance(table.get(key), str):
                    table[key] = self.relative(Path(table[key]))
        return table

    def view(self, view: View) -> dict[str, Any]:
        table = _plain(view)
        if "images" in table:
            table["images"] = {name: self.relative(Path(path)) for name, path in table["images"].items()}
        if "mask" in table:
            table["mask"] = self.relative(Path(table["mask"]))
        return table

    def relative(self, path: Path) -> str:
        try:
            return Path(os.path.relpath(self.folder / path, self.folder)).as_posix()
        except ValueError:  # another drive
            return path.as_posix()


def _plain(table: Table) -> dict[str, Any]:
    """What was stated or changed of a table, as TOML knows it."""
    # warnings: a field with a validator of its own is serialized twice, and the second time its pair is a list.
    return table.model_dump(mode="json", by_alias=True, exclude_unset=True, exclude_none=True, warnings=False)


def _merge(document: Any, tables: Any) -> None:
    """Make a parsed TOML container hold `tables`, touching nothing that already does."""
    import tomlkit

    for key in [key for key in document if key not in tables]:
        del document[key]
    for key, value in tables.items():
        old = document.get(key)
        if isinstance(value, dict) and isinstance(old, dict):
            _merge(old, value)
        elif key == "views" and isinstance(old, list):
            for index, item in enumerate(value):
                if index < len(old):
                    _merge(old[index], item)
                else:
                    old.append(tomlkit.item(item))
            del old[len(value) :]
        elif old is None or not _same(old, value):
            document[key] = value


def _same(old: Any, new: Any) -> bool:
    return bool(old == new) and isinstance(old, bool) == isinstance(new, bool)
