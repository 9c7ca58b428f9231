"""A scene file as it stands: its tables, and one message with everything that is wrong in them."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, field_validator

from warpsar.effects.registry import validate
from warpsar.errors import InputError, listed, shown
from warpsar.io import input_file
from warpsar.world.collection import Antenna, AntennaChannels, Collection, CollectionErrors, Transmitter
from warpsar.world.curve import Curve
from warpsar.world.library.fill import filled, of_one_frequency
from warpsar.world.library.surfaces import SURFACES
from warpsar.world.mesh import SUFFIXES as MESH_SUFFIXES
from warpsar.world.objects.table import Object
from warpsar.world.problems import keys_of, problem
from warpsar.world.tables import (
    FileName,
    Grid,
    Material,
    Number,
    Origin,
    Radar,
    Sampling,
    Table,
    View,
)

LARGEST_FILE = 2**24
"""Bytes of a scene file: 50,000 views."""
_MOST_KEY_PARTS = 100


class SceneTable(Table):
    """`[scene]`: the mesh, and the point where range and azimuth are zero."""

    mesh: FileName | None = Field(
        default=None,
        description="Mesh file: OBJ, PLY, STL, glTF, GLB, or a DEM in GeoTIFF; may be left out beside [[objects]].",
        examples=["scene.obj"],
    )
    reference_point_m: tuple[Number, Number, Number] = Field(
        default=(0.0, 0.0, 0.0),
        description="World point in the middle of every image [m]: range and azimuth are zero.",
        examples=[[0.0, 0.0, 9.0]],
    )
    accuracy_m: Annotated[Number, Field(gt=0.0, le=100.0)] | None = Field(
        default=None,
        description="Standard deviation of the mesh's outlines about their true places along each axis [m], by which "
        "edges are judged. If not stated, they are taken to be right to a tenth of a pixel.",
        examples=[0.1],
    )
    origin: Origin | None = Field(
        default=None,
        description="Where the world's zero lies on the earth; not for a DEM, which says it itself.",
        examples=[{"latitude_deg": 48.137, "longitude_deg": 11.575, "height_m": 565.0}],
    )

    @field_validator("reference_point_m")
    @classmethod
    def _near(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if max(map(abs, value)) > 1e8:
            raise ValueError("must be three numbers within 1e8 m")
        return value


class SceneFile(Table):
    """All tables of a scene file."""

    scene: SceneTable = Field(description="The mesh and the reference point.")
    radar: Radar = Field(description="Frequency and polarizations.")
    image: Grid | None = Field(
        default=None, description="Pixels of every view; [image] and [[views]] may be left out together, for an RCS."
    )
    sampling: Sampling = Field(default=Sampling(), description="The rays.")
    materials: Annotated[dict[str, Material], Field(min_length=1)] = Field(
        default_factory=dict,
        description="The surface of each material of the mesh, under its name; names of the library need no table.",
    )
    effects: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="Effects that the model has, each with its parameters (docs/effects.md)."
    )
    objects: list[Object] = Field(default_factory=list, description="Bodies with a place of their own.")
    curves: list[Curve] = Field(default_factory=list, description="Measured radar cross-sections against angle.")
    collection: Collection | None = Field(
        default=None, description="How a sensor collects the views (docs/collections.md)."
    )
    views: Annotated[list[View], Field(min_length=1)] = Field(
        default=[], description="The views, at least one where there is an [image]."
    )


_TABLES: dict[str, type[Table]] = {
    "scene": SceneTable,
    "radar": Radar,
    "image": Grid,
    "sampling": Sampling,
    "materials": Material,
    "objects": Object,
    "curves": Curve,
    "collection": Collection,
    "views": View,
}


_INNER: dict[tuple[object, ...], type[Table]] = {
    ("scene", "origin"): Origin,
    ("collection", "antenna"): Antenna,
    ("collection", "transmitter"): Transmitter,
    ("collection", "errors"): CollectionErrors,
    ("collection", "errors", "transmit"): AntennaChannels,
    ("collection", "errors", "receive"): AntennaChannels,
}


def read(path: Path) -> tuple[str, dict[str, Any]]:
    """A scene file's text, and its tables as they stand there; raises InputError for text that is not TOML."""
    text = _read_text(path)
    lines = (line.partition("#")[0] for line in text.splitlines())
    if any(part.count(".") > _MOST_KEY_PARTS for line in lines for part in re.split(r"[=,{}\[\]]", line)):
        raise InputError(f"{path}: found a key of more than {_MOST_KEY_PARTS} parts; must be fewer")  # time ~ parts^2
    try:
        return text, tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: also numbers of thousands of digits
        raise InputError(f"{path}: not valid TOML ({error})") from error


def _read_text(path: Path) -> str:
    if path.suffix.lower() in MESH_SUFFIXES and path.is_file():
        raise InputError(
            f"{path}: found a mesh; must be a scene file: warpsar new FOLDER {path.name} writes one for it"
        )
    return input_file.read_text(path, "a scene file", LARGEST_FILE)


def parse(raw: dict[str, Any]) -> tuple[SceneFile | None, list[str]]:
    """The checked tables, or None and what is wrong with them, a line each."""
    stated: Any = raw.get("materials")
    raw, problems = _with_library(raw)
    try:
        file = SceneFile.model_validate(raw)
        own = {name for name in file.materials if "eps_r" in stated[name]}
        of_library = {name: one.library for name, one in file.materials.items() if one.library and name not in own}
        problems += beside_the_radar(file, of_library)
        if (file.image is None) != (not file.views):
            found, missing = ("views", "image") if file.image is None else ("image", "views")
            problems.append(f"{missing}: missing; must be there beside {found}, or both left out for an RCS")
        if file.scene.mesh is None and all(one.group is not None for one in file.objects):
            return None, ["scene.mesh: missing; it may be left out where [[objects]] holds a mesh or a primitive"]
        return (None, problems) if problems else (file, [])
    except ValidationError as error:
        wrong = [details for details in error.errors(include_url=False) if not _emptied(details)]
        return None, problems + [_problem(details, raw) for details in wrong]


def _emptied(details: Mapping[str, Any]) -> bool:
    """Whether pydantic finds a list too short only since it has taken wrong values out of it, which it says too."""
    return details["type"] == "too_short" and len(details["input"]) >= details["ctx"]["min_length"]


def beside_the_radar(file: SceneFile, libraries: Mapping[str, str]) -> list[str]:
    """What is wrong where views have a frequency of their own; `libraries` names the surface of each material whose
    permittivity is the library's."""
    views = {view.name: view.frequency_hz for view in file.views if view.frequency_hz is not None}
    found = (of_one_frequency(name, one, file.radar.frequency_hz, views) for name, one in libraries.items())
    return [one for one in found if one is not None]


def _with_library(raw: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """The tables with the materials' keys that the library gives, and what is wrong with the names of its surfaces."""
    tables, radar, problems = raw.get("materials"), raw.get("radar"), []
    frequency_hz = radar.get("frequency_hz") if isinstance(radar, dict) else None
    if not isinstance(tables, dict) or not isinstance(frequency_hz, int | float) or not 1e6 <= frequency_hz <= 1e13:
        return raw, []  # that is wrong too, and said
    materials = dict(tables)
    for name, table in tables.items():
        if isinstance(table, dict) and "library" in table:
            try:
                materials[name] = filled(table, frequency_hz)
            except InputError as error:
                problems.append(f"{_key(('materials', name), raw)}.{error}")
                materials[name] = filled({**table, "library": next(iter(SURFACES))}, frequency_hz)
    return {**raw, "materials": materials}, problems


def parse_effects(raw: Mapping[str, Any], problems: list[str]) -> dict[str, dict[str, Any]]:
    """Checked parameters of every effect in `[effects]`; what is wrong is added to `problems`."""
    effects = {}
    tables = raw.get("effects", {})
    for name, table in tables.items() if isinstance(tables, dict) else ():
        if isinstance(table, dict):
            try:
                effects[name] = validate(name, table, f"effects.{name}")
            except InputError as error:
                problems.append(str(error))
    return effects


def refuse(path: Path, problems: list[str]) -> None:
    """Raise one InputError for all problems; nothing where there are none."""
    if problems:
        raise InputError(listed(path, problems))


def _problem(details: Mapping[str, Any], raw: dict[str, Any]) -> str:
    """One of pydantic's errors as: key, what was found, what is allowed."""
    place = tuple(part for part in details["loc"] if part != "[key]")
    model = _TABLES.get(str(place[0]), SceneFile) if len(place) > 1 else SceneFile
    model = _INNER.get(place[:2], model) if len(place) > 2 else model
    return problem(_key(place, raw), details, keys_of(model))


def _key(place: tuple[int | str, ...], raw: dict[str, Any]) -> str:
    key = ""
    for depth, part in enumerate(place):
        if isinstance(part, int):
            key += f"[{part}]"
            if place[0] in ("views", "objects") and depth == 1 and isinstance(name := raw[place[0]][part], dict):
                key += f" ({shown(name.get('name')).strip(chr(39))})" if "name" in name else ""
        else:
            part = part if re.fullmatch(r"[\w-]+", part) else shown(part)
            key += f".{part}" if key else part
    return key
