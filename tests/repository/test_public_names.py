"""Each public name has one path: `warpsar.NAME`, or `warpsar.ROOM.NAME` where the room's `__all__` has it. And no two
classes of the house and its benchmarks have one name."""

from __future__ import annotations

import ast
import json
import re
from importlib import import_module
from pathlib import Path

import pytest
from conftest import ROOT

import warpsar

pytestmark = pytest.mark.unit

ROOMS = sorted(path.parent.name for path in (ROOT / "warpsar").glob("*/__init__.pyi"))
OWN_PAGES = {"add-an-effect.md", "add-a-model.md", "design.md", "contributing.md"}
"""For those who write code inside of the package: kernels, and files that they make themselves."""
PYTHON = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
DIRECTIVE = re.compile(r"^\.\. auto\w+:: (warpsar[\w.]+)$", re.MULTILINE)


METAPHORS = {"bench", "course", "lead", "door", "told", "said", "heard", "begun"}
"""Words that say nothing of SAR, nor of what a function does."""


HOUSE = ("warpsar", "kernels", "cli")


def defined() -> list[tuple[Path, str]]:
    """Every class, function and module of the house, every argument and variable: where, and its name."""
    found = []
    for folder in HOUSE:
        for path in sorted((ROOT / folder).rglob("*.py")):
            found.append((path, path.stem))
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef | ast.FunctionDef):
                    found.append((path, node.name))
                elif isinstance(node, ast.arg):
                    found.append((path, node.arg))
                elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                    found.append((path, node.id))
    return found


def test_a_public_class_has_its_name_alone() -> None:
    places: dict[str, list[str]] = {}
    for folder in (*HOUSE, "benchmarks", "examples"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    places.setdefault(node.name, []).append(str(path.relative_to(ROOT)))
    assert len(places) > 200
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def test_names_are_no_metaphors() -> None:
    words = re.compile(r"[A-Z]?[a-z]+|[A-Z]+")
    wrong = [
        f"{path.relative_to(ROOT)}: {name}"
        for path, name in defined()
        if METAPHORS & {word.lower() for word in words.findall(name)}
    ]
    assert wrong == []


def public() -> dict[str, list[str]]:
    """The paths of every public name."""
    found: dict[str, list[str]] = {name: ["warpsar"] for name in warpsar.__all__}
    for room in ROOMS:
        for name in import_module(f"warpsar.{room}").__all__:
            found.setdefault(name, []).append(f"warpsar.{room}")
    return found


def imported(code: str) -> list[str]:
    """The names of this package that a piece of Python uses: "warpsar.world.Object"."""
    found = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "warpsar":
            found += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name.startswith("warpsar.")]
        elif isinstance(node, ast.Attribute) and ast.unparse(node).startswith("warpsar."):
            found.append(ast.unparse(node))
    return [name for name in found if re.fullmatch(r"[\w.]+", name)]


def pieces() -> list[tuple[str, str]]:
    """Every piece of Python that a reader is shown, and where it stands."""
    found = []
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        text = page.read_text(encoding="utf-8")
        if page.name not in OWN_PAGES:
            found += [(page.name, code) for code in PYTHON.findall(text)]
    for page in sorted((ROOT / "examples").rglob("*.ipynb")):
        cells = json.loads(page.read_text(encoding="utf-8"))["cells"]
        codes = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
        found += [(page.name, re.sub(r"^[%!].*$", "", code, flags=re.MULTILINE)) for code in codes]
    return found


def test_a_name_has_one_path() -> None:
    assert {name: paths for name, paths in public().items() if len(paths) > 1} == {}


@pytest.mark.parametrize("room", ROOMS)
def test_a_rooms_names_are_there(room: str) -> None:
    package = import_module(f"warpsar.{room}")
    said = {name.lstrip() for name in ast.literal_eval(_all_of(room))}
    assert sorted(package.__all__) == sorted(said)
    for name in package.__all__:
        if name == "TorchRenderer":
            pytest.importorskip("torch", reason="PyTorch is not installed")
        if name == "JaxRenderer":
            pytest.importorskip("jax", reason="JAX is not installed")
        assert getattr(package, name) is not None


def _all_of(room: str) -> str:
    tree = ast.parse((ROOT / "warpsar" / room / "__init__.pyi").read_text(encoding="utf-8"))
    (node,) = [one for one in tree.body if isinstance(one, ast.Assign)]
    return ast.unparse(node.value)


def test_what_readers_are_shown_is_public() -> None:
    paths = public()
    known = {f"{where[0]}.{name}" for name, where in paths.items()}
    shown = {(page, name) for page, code in pieces() for name in imported(code)}
    assert len(shown) > 30
    wrong = sorted(
        f"{page}: {name}"
        for page, name in shown
        if not any(name == one or name.startswith(f"{one}.") for one in known) and name not in _parents(known)
    )
    assert wrong == []


def test_the_reference_lists_public_paths() -> None:
    text = (ROOT / "docs" / "reference" / "python.md").read_text(encoding="utf-8")
    listed = DIRECTIVE.findall(text)
    assert len(listed) > 30
    known = {f"{where[0]}.{name}" for name, where in public().items()}
    modules = {f"warpsar.{room}.{name}" for room in ROOMS for name in import_module(f"warpsar.{room}").__all__}
    known |= {f"{name}.read" for name in modules if Path(ROOT, *name.split(".")).with_suffix(".py").exists()}
    assert sorted(set(listed) - known) == []
    # tables of a scene file are described in its reference, key by key
    tables = {name for name in warpsar.__all__ if hasattr(getattr(warpsar, name), "model_fields")}
    top = {name for name in warpsar.__all__ if not name.startswith("_")} - tables
    assert {name for name in top if f"warpsar.{name}" not in text} == set()


def _parents(names: set[str]) -> set[str]:
    return {name.rpartition(".")[0] for name in names}
