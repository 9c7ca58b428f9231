"""A format is one file: the command line, detection, messages and the tables of docs/ follow from the registries."""

from __future__ import annotations

import re
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import pytest
from click.testing import CliRunner

import warpsar.formats
import warpsar.simulation.formats
from warpsar.cli.main import main
from warpsar.errors import InputError
from warpsar.formats import registry
from warpsar.runtime.extra import Extra
from warpsar.simulation.formats import registry as images

ROOT = Path(__file__).resolve().parents[2]


def choices(command: str) -> list[str]:
    """What --format of a command takes, on a command line that is started anew."""
    module = {"import": "warpsar.cli.import_", "simulate": "warpsar.cli.simulate"}[command]
    with pytest.MonkeyPatch.context() as patch:
        patch.delitem(sys.modules, module, raising=False)
        found = main.get_command(click.Context(main), command)
    assert found is not None
    option = next(each for each in found.params if "--format" in each.opts)
    assert isinstance(option.type, click.Choice)
    return list(option.type.choices)


def add(name: str, text: str, package: ModuleType, folder: Path, patch: pytest.MonkeyPatch) -> None:
    """A format's file in a folder that its package looks into."""
    (folder / f"{name}.py").write_text(text, encoding="utf-8")
    patch.setattr(package, "__path__", [*package.__path__, str(folder)])
    patch.delitem(sys.modules, f"{package.__name__}.{name}", raising=False)


# ---- what is there ----


@pytest.mark.parametrize("there", [registry, images], ids=["formats", "simulation.formats"])
def test_a_format_has_the_name_of_its_file(there: Any) -> None:
    assert [there.get(name).name for name in there.names()] == list(there.names())


def test_the_commands_take_what_the_registries_have() -> None:
    assert choices("import") == ["auto", *registry.names()]
    assert choices("simulate") == list(images.names())


def cell(extra: Extra | None) -> str:
    return f"`warpsar[{extra.name}]` |" if extra is not None else "|"


def table(page: str) -> list[str]:
    """Rows of the table in the section `## Formats`."""
    section = (ROOT / "docs" / page).read_text(encoding="utf-8").split("\n## Formats\n")[1].split("\n## ")[0]
    return re.findall(r"^\| `.*", section, re.MULTILINE)


def test_the_page_of_import_has_a_row_for_each_format() -> None:
    formats = map(registry.get, registry.names())
    assert table("import.md") == [
        f"| `{one.name}` | {one.title} | {one.known_by} | {one.gives} |{' yes' * bool(one.write)} | {cell(one.extra)}"
        for one in formats
    ]


def test_the_page_of_simulate_has_a_row_for_each_format() -> None:
    formats = map(images.get, images.names())
    assert table("simulate.md") == [
        f"| `{one.name}` | {one.files} | {one.opens_in} | {cell(one.extra)}" for one in formats
    ]


# ---- what is new ----

RAW = """
import numpy as np

from warpsar.runtime.extra import Extra
from warpsar.formats.base.format import Format
from warpsar.formats.base.pictures import ASKS, in_slant_plane


def read(path, stated):
    FORMAT.extra.require(f"{path}: RAW")
    return in_slant_plane(path, np.ones((2, 3), np.float32), stated)


FORMAT = Format(
    "raw", "RAW", "`RAW!`", "a picture", read, detect=lambda path, head: head.startswith(b"RAW!"),
    extra=Extra("raw", ("numpy",)), asks=ASKS,
)  # fmt: skip
"""
CARDS = """
from warpsar.runtime.extra import Extra
from warpsar.simulation.image_format import ImageFormat


def parts(view, name, ground):
    yield "", f"{name}.txt", lambda path: path.write_text(view.name)


FORMAT = ImageFormat("cards", "Punched cards", "`<view>.txt`", "a reader", parts, Extra("cards", ("LIBRARY",)))
"""


def test_a_new_format_is_a_file_in_the_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The command line takes it, its files are told by their bytes, and messages name it."""
    path, other = tmp_path / "a.xyz", tmp_path / "b.xyz"
    path.write_bytes(b"RAW! and so on")
    other.write_bytes(b"nothing known")
    with pytest.raises(InputError, match="--format"):
        registry.detect(path)
    add("raw", RAW, warpsar.formats, tmp_path, monkeypatch)
    assert "raw" in choices("import")
    assert registry.detect(path) == "raw"
    for refused in (lambda: registry.detect(other), lambda: registry.read([path], file_format="rav")):
        with pytest.raises(InputError, match=r"\braw\b"):
            refused()
    with pytest.raises(InputError, match=r"only AFRL \.mat files can be combined, and .*a\.xyz is raw"):
        registry.read([path, other])
    with pytest.raises(InputError, match="use --quantity"):
        registry.read([path])
    assert registry.read([path], quantity="power", spacing_m=(1.0, 2.0)).spacing_m == (1.0, 2.0)
    monkeypatch.setattr("warpsar.runtime.extra.find_spec", lambda library: None)
    with pytest.raises(InputError, match=r'a\.xyz: RAW needs numpy: pip install "warpsar\[raw\]"'):
        registry.read([path], quantity="power")
    monkeypatch.delitem(sys.modules, "warpsar.formats.raw")


@pytest.mark.full
def test_a_new_format_of_images_is_a_file_in_the_folder(tmp_path: Path) -> None:
    """`simulate --format` writes it, or says which extra it needs."""
    scene = str(ROOT / "data" / "example" / "scene.toml")
    for library, exit_code in (("missing_library", 2), ("json", 0)):
        folder = tmp_path / library
        folder.mkdir()
        with pytest.MonkeyPatch.context() as patch:
            add("cards", CARDS.replace("LIBRARY", library), warpsar.simulation.formats, folder, patch)
            patch.delitem(sys.modules, "warpsar.cli.simulate", raising=False)
            arguments = ["simulate", scene, "-o", str(folder / "out"), "--device", "cpu", "--format", "cards"]
            done = CliRunner().invoke(main, arguments)
            patch.delitem(sys.modules, "warpsar.simulation.formats.cards")
        assert done.exit_code == exit_code, done.output
        if exit_code:
            assert '--format cards: needs missing_library: pip install "warpsar[cards]"' in done.output
        else:
            assert (folder / "out" / "north.txt").read_text() == "north"
            assert "beta0: north.txt" in done.output
    import_module("warpsar.cli.simulate")
