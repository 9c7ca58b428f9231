"""Buildings of GeoJSON and CityGML files, as outlines with heights or as surfaces, in the file's own coordinates."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError, shown
from warpsar.io import input_file

GEOJSON = (".geojson", ".json")
CITYGML = (".gml", ".citygml", ".xml")
SUFFIXES = (*GEOJSON, *CITYGML)
LARGEST_FILE = 2**28
"""Bytes: some 200,000 buildings."""
STOREY_M, UNKNOWN_M = 3.0, 6.0
"""Height of a storey (`building:levels`), and of a building that says nothing."""
FOOT_M = 0.3048
_WGS_84 = "EPSG:4326"
_NO_ROOF = ("GroundSurface", "ClosureSurface", "InteriorWallSurface", "FloorSurface", "CeilingSurface")

Ring = NDArray[np.float64]


@dataclass(frozen=True)
class Outline:
    """A building of a GeoJSON: `rings` of (n, 2), the outer one and its holes, x before y; `height_m` over the ground,
    None where the file says nothing."""

    rings: list[Ring]
    height_m: float | None


@dataclass(frozen=True)
class Surfaces:
    """A building of a CityGML: polygons of 3D rings, (n, 3), the outer one and its holes. `kinds`: "roof" or "wall"."""

    polygons: list[list[Ring]]
    kinds: list[str]


@dataclass(frozen=True)
class Buildings:
    """`crs`: the coordinate system of x and y, as "EPSG:...". `latitude_first` where it is geographic: in CityGML the
    axes stand in the order of the system's own definition, in GeoJSON longitude comes first."""

    crs: str
    found: list[Outline] | list[Surfaces]
    latitude_first: bool


def read(path: Path) -> Buildings:
    """The buildings of a file. Raises InputError for a file that is broken or holds none."""
    data = input_file.read_bytes(path, "a file of buildings", LARGEST_FILE)
    made = _geojson(path, data) if path.suffix.lower() in GEOJSON else _citygml(path, data)
    if not made.found:
        raise InputError(f"{path}: found no building; must hold one or more")
    return made


def _geojson(path: Path, data: bytes) -> Buildings:
    """RFC 7946: WGS 84 longitude and latitude, unless the older member `crs` names another system."""
    try:
        content = json.loads(data)
        name = str(content.get("crs", {}).get("properties", {}).get("name", _WGS_84))
        features = content["features"] if content.get("type") == "FeatureCollection" else [content]
        outlines = [outline for feature in features for outline in _outlines(feature)]
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read as GeoJSON ({type(error).__name__}: {error})") from error
    return Buildings(_WGS_84 if "CRS84" in name else _epsg(path, name), outlines, latitude_first=False)


def _outlines(feature: dict[str, Any]) -> Iterator[Outline]:
    geometry = feature.get("geometry") or {}
    for one in geometry.get("geometries", [geometry]):
        kind = one.get("type")
        polygons = [one["coordinates"]] if kind == "Polygon" else one["coordinates"] if kind == "MultiPolygon" else []
        for rings in polygons:
            flat = [np.array([point[:2] for point in ring], float) for ring in rings]
            if all(len(ring) >= 4 and np.isfinite(ring).all() for ring in flat):
                yield Outline([ring[:-1] for ring in flat], _height(feature.get("properties") or {}))


def _height(properties: dict[str, Any]) -> float | None:
    """OpenStreetMap's `height` ("12.5 m", a number, or feet as 39'4" and 39 ft), else its `building:levels`."""
    for key, metres in (("height", 1.0), ("building:levels", STOREY_M), ("levels", STOREY_M)):
        text = str(properties.get(key, "")).replace(",", ".")
        number = re.match(r"\s*(\d+(?:\.\d*)?)\s*(?:(ft|feet)\b|'\s*(?:(\d+(?:\.\d*)?)\s*(?:\"|''))?)?", text)
        if number is None:
            continue
        height = float(number[1]) * metres
        if number[0] != number[1] and re.search(r"ft|feet|'", number[0]):
            height = FOOT_M * (float(number[1]) + float(number[3] or 0.0) / 12.0)
        if 0.0 < height < 2000.0:
            return height
    return None


def _citygml(path: Path, data: bytes) -> Buildings:
    """LoD2 surfaces with their kinds where there are some, else the solid of LoD1."""
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise InputError(f"{path}: found a document type or an entity; a CityGML file needs none")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: cannot be read as CityGML ({error})") from error
    names = [value for node in root.iter() for key, value in node.attrib.items() if key == "srsName"]
    if not names:
        raise InputError(f"{path}: found no srsName; must name the coordinate system, such as EPSG:25832")
    crs = _epsg(path, names[0])
    found = []
    for node in root.iter():
        if _tag(node) == "Building":
            try:
                surfaces = _surfaces(node)
            except ValueError as error:
                raise InputError(f"{path}: cannot be read as CityGML ({error})") from error
            if surfaces.polygons:
                found.append(surfaces)
    return Buildings(crs, found, latitude_first=True)


def _surfaces(building: ElementTree.Element) -> Surfaces:
    polygons: list[list[Ring]] = []
    kinds: list[str] = []
    stated = [node for node in building.iter() if _tag(node).endswith("Surface") and _tag(node) != "MultiSurface"]
    stated = [node for node in stated if _tag(node) in ("RoofSurface", "WallSurface", "OuterCeilingSurface", *_NO_ROOF)]
    for owner in stated or [building]:
        if _tag(owner) in _NO_ROOF:
            continue
        for node in owner.iter():
            if _tag(node) != "Polygon":
                continue
            rings = [ring for each in node.iter() if _tag(each) == "LinearRing" and len(ring := _ring(each)) >= 3]
            if not rings:
                continue
            up = normal(rings[0])[2]
            if owner is building and up < -0.7:
                continue  # the underside of a solid
            kind = "roof" if _tag(owner) == "RoofSurface" or (owner is building and up > 0.3) else "wall"
            polygons.append(rings)
            kinds.append(kind)
    return Surfaces(polygons, kinds)


def _ring(node: ElementTree.Element) -> Ring:
    """The corners of a gml:LinearRing, the repeated last one left out."""
    words = " ".join(each.text or "" for each in node.iter() if _tag(each) in ("posList", "pos"))
    corners = np.array(words.split(), float)
    if corners.size % 3 or not np.isfinite(corners).all():
        raise ValueError(f"found a ring of {corners.size} numbers; must be three for each corner")
    corners = corners.reshape(-1, 3)
    return corners[:-1] if len(corners) > 1 and (corners[0] == corners[-1]).all() else corners


def normal(ring: Ring) -> NDArray[np.float64]:
    """The unit normal of a 3D ring, counterclockwise about it (Newell's method); zero for one without area."""
    near = ring - ring[0]
    total = np.cross(near, np.roll(near, -1, axis=0)).sum(axis=0)
    length = float(np.linalg.norm(total))
    return np.asarray(total / length if length > 0.0 else total)


def _epsg(path: Path, name: str) -> str:
    """EPSG:N of a name such as urn:ogc:def:crs,crs:EPSG::25832,crs:EPSG::5783: its first code."""
    code = re.search(r"EPSG[:/]+(?:[\d.]+[:/]+|0[:/]+)?(\d{4,6})", name)
    if code is None:
        raise InputError(f"{path}: found the coordinate system {shown(name)}; must be an EPSG code, or WGS 84")
    return f"EPSG:{code[1]}"


def _tag(node: ElementTree.Element) -> str:
    return str(node.tag).rpartition("}")[2]
