"""One program: an effect, a model, a format or a change of geometry is known where it is made, and one thing compares a
model with what was measured. Nothing is imported: sources are read."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping

import pytest
from test_layers import ROOT, sources

pytestmark = pytest.mark.unit

EFFECTS = {
    "registration": {"effects.aim_point"},  # it moves a single view as that does
    "aim_point": {"compare.aim"},  # which finds the shifts that a table leaves open
    "glints": {"diagnosis.held_out.glints"},  # which finds their places in what views leave
    "multibounce": {"coherent", "world.tables"},  # a term of the complex engine, which is called so, too
    "noise_floor": {"learning.pose_pixels"},  # images on a floor, and blurred, for places: these two make both
    "phase_error": {"diagnosis.phase.declared"},  # which asks complex images for it
    "point_spread": {"learning.pose_pixels", "measured.importer"},  # a header's response becomes this table
    "saturation": {"speckle.facts"},  # a law of speckle that is called so, too
    "two_scale": {"models.two_scale", "world.library.surfaces"},  # a model has that name, too
}
MODELS = {
    "facet": {"world.tables"},  # the schema's words on `sigma0`
    "i2em": {"coherent.rough_models", "world.library.surfaces", "world.tables"},
    "ka_spm": {"coherent.learned", "kernels.coherent.rough_models", "models.base.model", "world.library.surfaces"},
    "two_scale": {"effects.two_scale", "world.library.surfaces"},
}
FORMATS = {"cphd": {"collection"}, "sicd": {"collection"}}
CHANGES: dict[str, set[str]] = {}
"""Who else names one of them, or takes from its file. All others are in one file each: a new one is no change here."""

COMPARED = {"simulated", "residual", "scaled_deviance"}
"""What a measurement beside its model has (`warpsar/compare/contract.py`)."""


QUOTED = re.compile(r"""["'](\w+)["']""")
IMPORTED = re.compile(r"^ *(?:from|import) +(warpsar[\w.]+)(?: import +(\([^)]*\)|[\w, ]+))?", re.MULTILINE)


def named_in(text: str, room: str, by_text: bool) -> set[str]:
    """The files of a room that a source imports, and what it has as strings."""
    found = set(QUOTED.findall(text)) if by_text else set()
    for module, names in IMPORTED.findall(text):
        inside = module.removeprefix(f"warpsar.{room}.")
        found |= {inside.partition(".")[0]} if inside != module else set()
        found |= set(re.findall(r"\w+", names)) if module == f"warpsar.{room}" else set()
    return found


def naming(room: str, *, by_text: bool, modules: Mapping[str, str]) -> dict[str, set[str]]:
    """Of each file of a room: the modules that import it or, `by_text`, have its name as a string."""
    folder = ROOT.joinpath("warpsar", *room.split("."))
    own = {path.stem for path in folder.glob("*.py")} - {"__init__", "registry"}
    found: dict[str, set[str]] = {}
    for module, text in modules.items():
        folders, _, file = module.rpartition(".")
        for name in named_in(text, room, by_text) & own - ({file} if f".{room}." in f".{folders}." else set()):
            found.setdefault(name, set()).add(module.removeprefix("warpsar."))
    return found


def beyond(found: dict[str, set[str]], known: dict[str, set[str]]) -> list[str]:
    """Who names what it need not know; a whole folder may be known by its name."""
    return [
        f"{module} names {name}"
        for name, modules in found.items()
        for module in sorted(modules)
        if not any(f"{module}.".startswith(f"{allowed}.") for allowed in known.get(name, ()))
    ]


@pytest.fixture(scope="module")
def modules() -> dict[str, str]:
    return {name: path.read_text(encoding="utf-8") for name, path in sources(ROOT).items()}


def test_an_effect_is_named_in_its_file(modules: dict[str, str]) -> None:
    assert beyond(naming("effects", by_text=True, modules=modules), EFFECTS) == []


def test_a_model_is_named_in_its_file(modules: dict[str, str]) -> None:
    assert beyond(naming("models", by_text=True, modules=modules), MODELS) == []


def test_a_format_is_imported_by_its_registry(modules: dict[str, str]) -> None:
    """Some are called as other things are (`gamma`, `rcs`): strings do not count."""
    assert beyond(naming("formats", by_text=False, modules=modules), FORMATS) == []


def test_a_change_of_geometry_is_named_in_its_file(modules: dict[str, str]) -> None:
    assert beyond(naming("diagnosis.geometry", by_text=True, modules=modules), CHANGES) == []


@pytest.mark.parametrize(
    "line", ['if kind == "view_angles": pass', "from warpsar.diagnosis.geometry.view_angles import CHANGE", ""]
)
def test_who_names_a_change_of_geometry_is_found(line: str) -> None:
    found = naming("diagnosis.geometry", by_text=True, modules={"warpsar.diagnosis.search.loop": line})
    assert beyond(found, CHANGES) == (["diagnosis.search.loop names view_angles"] if line else [])
    own = {"warpsar.diagnosis.geometry.view_angles": line}
    assert naming("diagnosis.geometry", by_text=True, modules=own) == {}


@pytest.mark.parametrize(
    "line", ['if "range_loss" in scene.effects: pass', "from warpsar.effects.range_loss import EFFECT", ""]
)
def test_who_names_an_effect_is_found(line: str) -> None:
    text = f'"""How much range_loss there is."""\n{line}'
    found = naming("effects", by_text=True, modules={"warpsar.world.tables": text})
    assert beyond(found, EFFECTS) == (["world.tables names range_loss"] if line else [])
    assert naming("effects", by_text=True, modules={"warpsar.effects.range_loss": text}) == {}


def comparing(text: str) -> list[str]:
    """Classes that hold a model beside what was measured."""
    found: list[str] = []
    if sum(word in text for word in COMPARED) < 2:  # to read them all takes long
        return found
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ClassDef):
            members = {one.name for one in node.body if isinstance(one, ast.FunctionDef)}
            members |= {ast.unparse(one.target) for one in node.body if isinstance(one, ast.AnnAssign)}
            found += [node.name] if len(members & COMPARED) > 1 else []
    return found


def test_one_thing_compares(modules: dict[str, str]) -> None:
    """Images and curves have one each, and both keep one contract."""
    found = {name: module for module, text in modules.items() for name in comparing(text)}
    assert found == {
        "AnyComparison": "warpsar.compare.contract",
        "Comparison": "warpsar.compare.comparison",
        "CurveComparison": "warpsar.compare.curve",
    }
