"""`warpsar schema`: what editors are told of a scene file is what the reader accepts."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from warpsar.cli.main import main
from warpsar.effects.base.fitted import FITTED_KEYS
from warpsar.effects.registry import get, names
from warpsar.scene.file import parse, parse_effects
from warpsar.scene.schema import scene_schema

jsonschema = pytest.importorskip("jsonschema")

ROOT = Path(__file__).resolve().parents[2]
SCENES = sorted(path for path in (ROOT / "data").glob("*/*.toml") if "[radar]" in path.read_text(encoding="utf-8"))
EXAMPLE = tomllib.loads((ROOT / "data" / "example" / "scene.toml").read_text(encoding="utf-8"))
EFFECTS = {
    "point_spread": {"range_fwhm_m": 1.0, "window": "taylor"},
    "interference": {"level": {"north": 0.1}, "rows": {"north": [[3, 5]]}},
    "saturation": {"exponent": 0.9, "pivot": 0.2},
    "antenna_pattern": {"beamwidth_m": float("inf")},
    "multibounce": {"max_bounces": 4},
}


def accepted(scene: dict[str, Any]) -> bool:
    """By the schema."""
    return bool(jsonschema.Draft7Validator(scene_schema()).is_valid(scene))


def read(scene: dict[str, Any]) -> bool:
    """Whether the reader takes the scene; without the files that it names."""
    file, problems = parse(scene)
    parse_effects(scene, problems)
    return file is not None and not problems


def changed(place: str, value: Any) -> dict[str, Any]:
    """The example with other effects, and with `value` at a dotted place; None takes the key away."""
    scene: Any = {**copy.deepcopy(EXAMPLE), "effects": copy.deepcopy(EFFECTS)}
    *path, last = [int(part) if part.isdigit() else part for part in place.split(".")]
    table = scene
    for part in path:
        table = table[part]
    if value is None:
        del table[last]
    else:
        table[last] = value
    return scene


def test_schema_is_a_schema() -> None:
    jsonschema.Draft7Validator.check_schema(scene_schema())


@pytest.mark.parametrize("path", SCENES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_scenes_of_the_project_fit(path: Path) -> None:
    scene = tomllib.loads(path.read_text(encoding="utf-8"))
    assert accepted(scene)
    assert read(scene)


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("scene.reference_point_m", [0, 0.5, 1]),
        ("materials.lawn.eps_r", [5.0, -1.0]),
        ("materials.lawn.eps_r", 2),
        ("materials.lawn", {"conductor": True}),
        ("materials.lawn", {"eps_r": [2.6, -0.04], "rms_height_m": 0, "thickness_m": 0.0015}),
        ("materials.lawn", {"conductor": True, "layers": [{"mu_r": [1.6, -0.9], "thickness_m": 0.002}]}),
        ("materials.lawn", {"layers": [{"eps_r": 3.2, "thickness_m": 0.002}]}),
        ("radar.terms", ["single", "edges"]),
        ("materials.lawn", {"layout": "vertex", "eps_r": "e", "rms_height_m": "h", "correlation_length_m": 0.1}),
        ("sampling", {}),
        ("sampling", {"rays_per_m2": 3.0, "deposit": "linear"}),
        ("views.0", {"name": "a", "azimuth_deg": -3.0, "grazing_deg": 20.0, "images": {"HH": "a.tif"}, "looks": 2.0}),
        ("effects.multibounce", {}),
        ("effects.edge_diffraction", {"fixed": True}),
        ("effects.vegetation", {"optical_depth": 0.3, "tolerance": {"optical_depth": 0.1}}),
        ("effects.point_spread", {"range_fwhm_m": 0.3, "tolerance": {"range_fwhm_m": "2.5 %"}}),
        ("effects.point_spread", {"range_fwhm_m": 0.3, "tolerance": {"range_fwhm_m": {"about": 0.28, "sd": "5%"}}}),
        ("effects.interference", {"level": {"a": 0.1}, "tolerance": {"level": {"about": {"a": 0.2}, "sd": 0.1}}}),
        ("materials.lawn.tolerance", {"eps_r": "20 %", "rms_height_m": {"about": 0.002, "sd": 0.001}}),
    ],
)
def test_sound_scenes_are_accepted(place: str, value: Any) -> None:
    scene = changed(place, value)
    assert read(scene)
    assert accepted(scene)


BROKEN: list[tuple[str, Any]] = [
    ("radar", None),
    ("scene.mesh", None),
    ("scene.mesh", ""),
    ("scene.reference_point_m", [0.0, 0.0]),
    ("scene.origin_of_nothing", 1),
    ("radar.frequency", 9.6e9),
    ("radar.frequency_hz", 1e14),
    ("radar.frequency_hz", "9.6 GHz"),
    ("radar.polarizations", []),
    ("radar.polarizations", ["HX"]),
    ("radar.slant_range_m", 0.0),
    ("image.shape", [160]),
    ("image.shape", [160, 1.5]),
    ("image.spacing_m", [0.5, 0.0]),
    ("image.calibrated", 1),
    ("sampling", {"rays_per_pixel": 1.0, "rays_per_m2": 1.0}),
    ("sampling.seed", -1),
    ("sampling.deposit", "far"),
    ("materials", {}),
    ("materials.lawn.eps_r", None),
    ("materials.lawn.eps_r", 1.0),
    ("materials.lawn.eps_r", [5.0, 1.0]),
    ("materials.lawn.eps_r", True),
    ("materials.lawn.rms_height_m", -0.001),
    ("materials.lawn.thickness_m", 0.0),
    ("materials.lawn", {"layers": [{"eps_r": 0.0, "thickness_m": 0.002}]}),
    ("materials.lawn", {"layers": [{"mu_r": [2.0, 0.1], "thickness_m": 0.002}]}),
    ("materials.lawn", {"layers": [{"mu_r": 2.0}]}),
    ("materials.lawn", {"conductor": False}),
    ("materials.lawn", {"eps_r": 4.0, "rms_height_m": 0.001}),
    ("radar.terms", ["double"]),
    ("radar.max_bounces", 0),
    ("materials.lawn.rms_height_m", [0.1, 0.1]),
    ("materials.lawn.specular_fraction", 1.1),
    ("materials.lawn.layout", "wild"),
    ("materials.lawn.learn", ["eps"]),
    ("materials.lawn.colour", "green"),
    ("views", []),
    ("views.0.name", "a/b"),
    ("views.0.name", None),
    ("views.0.azimuth_deg", 361.0),
    ("views.0.incidence_deg", None),
    ("views.0.incidence_deg", 90.0),
    ("views.0.grazing_deg", 48.0),
    ("views.0.images", {"XX": "a.tif"}),
    ("views.0.images", "a.tif"),
    ("views.0.looks", 0.0),
    ("views.0.role", "exam"),
    ("effects.fog", {}),
    ("effects.vegetation", 3),
    ("effects.vegetation", {}),
    ("effects.vegetation", {"albedo": 0.1}),
    ("effects.vegetation", {"depth": 3.0}),
    ("effects.vegetation", {"optical_depth": -1.0}),
    ("effects.vegetation", {"optical_depth": "deep"}),
    ("effects.point_spread.window", "hann"),
    ("effects.multibounce.max_bounces", 5),
    ("effects.interference.level", 0.1),
    ("effects.interference.level", {"north": -0.1}),
    ("effects.interference.rows", {"north": [[3]]}),
    ("effects.saturation.pivot", "mean"),
    ("effects.saturation.pivot", 0.0),
    ("effects.antenna_pattern.beamwidth_m", 0.0),
    ("effects.vegetation", {"optical_depth": 0.3, "tolerance": 0.1}),
    ("effects.vegetation", {"optical_depth": 0.3, "tolerance": {"depth": 0.1}}),
    ("effects.vegetation", {"optical_depth": 0.3, "tolerance": {"optical_depth": 0}}),
    ("effects.vegetation", {"optical_depth": 0.3, "tolerance": {"optical_depth": -0.1}}),
    ("effects.vegetation", {"optical_depth": 0.3, "tolerance": {"optical_depth": "0 %"}}),
    ("effects.vegetation", {"optical_depth": 0.3, "tolerance": {"optical_depth": "five %"}}),
    ("effects.vegetation", {"optical_depth": 0.3, "tolerance": {"optical_depth": {"sd": 0.1}}}),
    ("effects.vegetation", {"optical_depth": 0.3, "tolerance": {"optical_depth": {"about": -1.0, "sd": 0.1}}}),
    ("materials.lawn.tolerance", 0.1),
    ("materials.lawn.tolerance", {"eps": 0.1}),
    ("materials.lawn.tolerance", {"eps_r": 0.0}),
    ("materials.lawn.tolerance", {"eps_r": "5"}),
]


@pytest.mark.full
@pytest.mark.parametrize(("place", "value"), BROKEN)
def test_broken_scenes_are_refused_by_both(place: str, value: Any) -> None:
    scene = changed(place, value)
    assert not read(scene)
    assert not accepted(scene)


def test_examples_and_defaults_of_every_key_fit() -> None:
    for name, table in tables():
        for key, field in table["properties"].items():
            assert field["description"].endswith("."), f"{name}.{key}"
            assert field["examples"], f"{name}.{key}: no example"
            for value in (*field["examples"], *([field["default"]] if "default" in field else [])):
                jsonschema.validate(value, field, jsonschema.Draft7Validator)


def tables() -> Iterator[tuple[str, dict[str, Any]]]:
    """The tables of the file that have keys of their own, the effects apart."""
    tables = dict(scene_schema()["properties"])
    del tables["effects"]
    tables |= {"materials": tables["materials"]["additionalProperties"]}
    tables |= {name: tables[name]["items"] for name in ("objects", "curves", "views")}
    yield from tables.items()


@pytest.mark.parametrize("name", names())
def test_effects_are_as_they_are_declared(name: str) -> None:
    effect, table = get(name), scene_schema()["properties"]["effects"]["properties"][name]
    declared = [each.name for each in (*effect.parameters, *effect.settings)]
    assert list(table["properties"]) == [*declared, *FITTED_KEYS]
    jsonschema.validate(effect.example, table, jsonschema.Draft7Validator)
    for each in (*effect.parameters, *effect.settings):
        field = table["properties"][each.name]
        assert each.description.endswith(".")
        assert each.description.rstrip(".") in field["description"]
        if not getattr(each, "keyed_by", each.per_view) and "default" in field:
            assert field["default"] == each.default
            jsonschema.validate(each.default, field, jsonschema.Draft7Validator)


def test_schema_is_strict_json_without_references() -> None:
    text = json.dumps(scene_schema(), allow_nan=False)
    assert "$ref" not in text
    assert "null" not in text
    # tables of the file, scene.origin and those of the collection among them; effects; each effect,
    # and in it tolerance; { about, sd } of each parameter, and of what materials, objects, views, radar and image know;
    # the curves' profiles, the materials' layers
    tolerances = sum(len(get(name).parameters) for name in names()) + 2 + 3 + 1
    assert text.count('"additionalProperties": false') == 16 + 2 + 2 * len(names()) + tolerances


@pytest.mark.full
def test_command_prints_what_it_writes(tmp_path: Path) -> None:
    printed = CliRunner().invoke(main, ["schema"])
    # a process of its own: click 8.1's runner has one stream for both
    words = [sys.executable, "-m", "warpsar", "schema", "-o", str(tmp_path / "made" / "scene.schema.json")]
    written = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True)
    assert (printed.exit_code, written.stdout) == (0, "")
    text = (tmp_path / "made" / "scene.schema.json").read_text(encoding="utf-8")
    assert text == printed.stdout
    assert json.loads(text) == scene_schema()
