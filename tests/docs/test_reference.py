"""The reference of the scene file: nothing that the code reads is missing on the page."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from warpsar.effects.registry import get, names
from warpsar.scene.schema import scene_schema
from warpsar.world.mesh import LARGEST_COORDINATE_M, SUFFIXES, SUSPICIOUS_EXTENT_M
from warpsar.world.meshes.dem import LARGEST_DEM
from warpsar.world.meshes.through_trimesh import LARGEST_MESH

pytestmark = pytest.mark.unit

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def extension() -> ModuleType:
    spec = importlib.util.spec_from_file_location("scene_file", DOCS / "extensions" / "scene_file.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rows(text: str) -> list[list[str]]:
    """Cells of the tables' rows, the headers apart."""
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in text.splitlines() if line[:3] == "| `"]
    assert cells
    return cells


def keys_of(table: dict[str, Any]) -> Iterator[str]:
    """Keys of a table; of a table in it, with its name before."""
    for key, each in table["properties"].items():
        yield from (f"{key}.{inner}" for inner in each["properties"]) if "properties" in each else (key,)


def test_every_key_has_value_default_example_and_meaning(extension: ModuleType) -> None:
    tables = dict(scene_schema()["properties"])
    del tables["effects"]
    tables |= {"materials": tables["materials"]["additionalProperties"]}
    tables |= {name: tables[name]["items"] for name in ("objects", "curves", "views")}
    keys = [f"`{key}`" for table in tables.values() for key in keys_of(table)]
    found = rows(extension.scene_tables())
    assert [row[0] for row in found] == keys
    assert all(len(row) == 5 and all(row) for row in found)


def test_every_key_of_an_effect_has_value_default_example_and_meaning(extension: ModuleType) -> None:
    effects = map(get, names())
    keys = [f"`{each.name}`" for effect in effects for each in (*effect.parameters, *effect.settings)]
    found = rows(extension.effect_tables())
    assert [row[0] for row in found] == keys
    assert all(len(row) == 5 and all(row) for row in found)


def test_units_stand_beside_values(extension: ModuleType) -> None:
    values = {row[0].strip("`"): row[1] for row in rows(extension.scene_tables())}
    for key, unit in {"frequency_hz": "Hz", "azimuth_deg": "deg", "spacing_m": "m", "rays_per_m2": "1/m^2"}.items():
        assert f"[{unit}]" in values[key]
    assert values["eps_r"].startswith("number above 1 up to 1e+09, or ")


def test_every_mesh_format_and_limit_is_named() -> None:
    section = (DOCS / "reference" / "scene-file.md").read_text(encoding="utf-8").split("## Mesh formats")[1]
    section = section.split("\n## ")[0]
    assert [suffix for suffix in SUFFIXES if f"`{suffix}`" not in section] == []
    for limit in (LARGEST_MESH, LARGEST_DEM, f"{LARGEST_COORDINATE_M:g}", f"{SUSPICIOUS_EXTENT_M:g} m"):
        assert str(limit) in section
