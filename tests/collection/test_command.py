"""`warpsar simulate --product`: its files, and what it refuses, in one message each."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import pytest
import warp as wp
from click.testing import CliRunner
from collected_scenes import field, scene

from warpsar.cli.main import main
from warpsar.collection.plan import plans_of
from warpsar.collection.scatterers import body_of, spacing_m
from warpsar.errors import InputError

PRODUCTS = {"slc": {"one.npz", "one.png"}, "phase-history": {"one.npz"}}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    made = scene(field(6.0, 6.0), collection={"resolution_m": (1.0, 1.0)}, shape=(16, 16), spacing=(0.5, 0.5))
    made.save(tmp_path / "scene.toml")
    return tmp_path / "scene.toml"


@pytest.mark.parametrize("product", PRODUCTS)
def test_files_and_facts(path: Path, product: str) -> None:
    out = path.parent / product
    done = CliRunner().invoke(main, ["simulate", str(path), "-o", str(out), "--product", product, "--device", "cpu"])
    assert done.exit_code == 0, done.output
    facts = json.loads((out / "simulate.json").read_text(encoding="utf-8"))
    (view,) = facts["views"]
    assert PRODUCTS[product] <= set(view["files"].values())
    assert all((out / name).exists() for name in view["files"].values())
    assert facts["product"] == product
    assert view["pulses"] > 0
    # Without sarkit there are no files in earth coordinates, and that is what is said.
    said = "origin" if find_spec("sarkit") is not None else "sarkit"
    assert any(said in warning for warning in facts["warnings"])


def test_the_same_seed_gives_the_same_image(path: Path) -> None:
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        words = ["simulate", str(path), "-o", str(path.parent / name), "--product", "phase-history", "--device", "cpu"]
        assert CliRunner().invoke(main, [*words, "--seed", seed]).exit_code == 0
    first, same, other = ((path.parent / name / "one.npz").read_bytes() for name in "abc")
    assert first == same
    assert first != other


def test_options_of_power_images_are_refused(path: Path) -> None:
    words = ["simulate", str(path), "-o", str(path.parent / "out"), "--product", "slc", "--layers"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 2
    assert "--layers" in done.output
    assert not (path.parent / "out").exists()


def test_a_scene_without_the_table_is_refused(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    path.write_text(text[: text.index("[collection]")] + text[text.index("[[views]]") :], encoding="utf-8")
    words = ["simulate", str(path), "-o", str(path.parent / "out"), "--product", "slc"]
    done = CliRunner().invoke(main, words)
    assert isinstance(done.exception, InputError) or done.exit_code == 2
    assert not (path.parent / "out").exists()


@pytest.mark.parametrize("product", PRODUCTS)
def test_quiet_is_for_all_products(path: Path, product: str) -> None:
    words = ["simulate", str(path), "-o", str(path.parent / "out"), "--product", product, "--device", "cpu", "-q"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    assert "device:" not in done.output
    assert (path.parent / "out" / "one.npz").exists()


def test_too_many_scatterers_are_placed_in_parts(path: Path) -> None:
    """A surface may have more than can be held at once; only all at once are refused, with their own spacing."""
    made = scene(field(6e3, 6e3), collection={"resolution_m": (1.0, 1.0)}, shape=(16, 16), spacing=(0.5, 0.5))
    (plan,) = plans_of(made, wp.get_device("cpu"))
    body = body_of(made, spacing_m(plan), wp.get_device("cpu"), 0)
    assert len(body.patches) > 1e8
    there = body.patches.on(body.device)
    assert len(there.placed(slice(len(there) - 10, len(there)))) == 10
    with pytest.raises(InputError, match=rf"scatterers {spacing_m(plan):.3g} m apart".replace(".", r"\.")):
        _ = body.placed
