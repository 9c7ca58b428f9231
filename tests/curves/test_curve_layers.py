"""A layer on metal that nobody declared, by curves of a plate: named with its values, and not where there is none."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from stack_reference import Stack, reflection

import warpsar
from warpsar.cli.main import main
from warpsar.curves.materials import MaterialHypothesis
from warpsar.diagnosis.curve_layers import FAMILIES, Probed, coated, reflections
from warpsar.diagnosis.curve_materials import beside
from warpsar.world.tables import MaterialLayer

PLATE = "usemtl sheet\nv 0 -.12 -.08\nv 0 .12 -.08\nv 0 .12 .08\nv 0 -.12 .08\nf 1 2 3\nf 1 3 4\n"
PHI = np.arange(-60.0, 60.01, 0.5)
ROLES = ((6e9, "train"), (8e9, "train"), (10e9, "test"))
SHORTEST_M = 0.03


def _pair(value: complex) -> tuple[float, float]:
    return complex(value).real, complex(value).imag


def diagnosed(folder: Path, stack: Stack, declared: str = "conductor = true", seed: int = 0) -> dict:
    """What `diagnose` says of a plate whose flat face has the closed form's coefficients, and the engine's edges."""
    (folder / "plate.obj").write_text(PLATE)
    head = (
        '[scene]\nmesh = "plate.obj"\n[radar]\nfrequency_hz = 8e9\npolarizations = ["HH", "VV"]\n'
        'terms = ["single", "edges"]\n[materials.sheet]\n'
    )
    (folder / "bare.toml").write_text(f"{head}conductor = true\n")
    bare = warpsar.Scene.load(folder / "bare.toml")
    layers = tuple(MaterialLayer(eps_r=_pair(eps), mu_r=_pair(mu), thickness_m=thick) for eps, mu, thick in stack)
    with_layers = replace(bare, materials={"sheet": warpsar.Material(conductor=True, layers=layers)})
    random, tables = np.random.default_rng(seed), ""
    for frequency, role in ROLES:
        made, edged = (warpsar.rcs(one, 90.0 - PHI, 90.0, [frequency], device="cpu") for one in (bare, with_layers))
        sin = np.abs(np.sin(np.deg2rad(PHI)))
        for place, pol in enumerate(("HH", "VV")):
            gain = -reflection(stack, True, frequency, pol == "VV", sin) if stack else np.ones(len(PHI))
            single, edges = (one[:, 0, 0, place] for one in (made.terms_m["single"], edged.terms_m["edges"]))
            field = np.sqrt(4 * np.pi) * (gain * single + edges)
            noise = 0.01 * np.abs(field).max() * (random.normal(size=(2, len(PHI))) / np.sqrt(2.0))
            level = 10 * np.log10(np.abs(field + noise[0] + 1j * noise[1]) ** 2)
            name = f"{pol}{frequency / 1e9:g}.csv"
            lines = [f"{frequency},90,{a},{v}" for a, v in zip(PHI, level, strict=True)]
            (folder / name).write_text("\n".join(["frequency_hz,theta_deg,phi_deg,rcs_dbsm", *lines]))
            tables += f'[[curves]]\nfile = "{name}"\npolarization = "{pol}"\nrole = "{role}"\n'
    (folder / "scene.toml").write_text(f"{head}{declared}\n{tables}")
    command = ["diagnose", str(folder / "scene.toml"), "-o", str(folder / "out"), "--device", "cpu"]
    done = CliRunner().invoke(main, command, catch_exceptions=False)
    assert done.exit_code in (0, 4), done.output
    return json.loads((folder / "out" / "diagnosis.json").read_text())


def of(found: dict, kind: str) -> dict:
    return next(one for one in found["materials"] if one["kind"] == kind)


def holds(value: dict, truth: float) -> bool:
    return bool(value["low"] <= truth <= value["high"])


@pytest.mark.slow
def test_a_lossy_dielectric_layer_on_metal_is_named(tmp_path: Path) -> None:
    """A fifth of a wavelength inside it: eps_r, loss and thickness are told each by itself."""
    found = diagnosed(tmp_path, [(4.0 - 0.8j, 1.0, 3e-3)])
    assert found["verdict"] == ["materials.sheet: dielectric layer"]
    told = of(found, "dielectric layer")["values"]
    truths = {"eps_r": 4.0, "loss tangent": 0.2, "thickness_m": 3e-3, "sqrt(eps_r) x thickness_m": 6e-3}
    assert all(holds(told[name], truth) for name, truth in truths.items()), told
    wide = {name: one["high"] / one["low"] for name, one in told.items()}
    assert wide["sqrt(eps_r) x thickness_m"] < min(1.5, wide["eps_r"]), wide
    (layer,) = warpsar.Scene.load(tmp_path / "out" / "scene.toml").materials["sheet"].layers
    assert layer.thickness_m == pytest.approx(told["thickness_m"]["value"])


@pytest.mark.slow
def test_a_thin_magnetic_layer_tells_products_with_its_thickness(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, [(8.0, 2.0 - 1.5j, 6e-4)])
    said = [one for one in found["materials"] if one["outcome"] in ("named", "tied")]
    assert "magnetic layer" in {one["kind"] for one in said}
    told = of(found, "magnetic layer")["values"]
    assert holds(told["mu_r loss x thickness_m"], 9e-4), told
    assert holds(told["mu_r x thickness_m"], 1.2e-3), told
    wide = {name: one["high"] / one["low"] for name, one in told.items()}
    assert wide["mu_r loss x thickness_m"] < min(1.3, wide["thickness_m"]), wide


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_no_layer_is_named_on_bare_metal(tmp_path: Path, seed: int) -> None:
    found = diagnosed(tmp_path, [], seed=seed)
    assert found["verdict"] == []
    assert {one["outcome"] for one in found["materials"]} == {"refused"}


@pytest.mark.slow
def test_bare_metal_that_was_declared_coated_is_named(tmp_path: Path) -> None:
    declared = "conductor = true\nlayers = [{eps_r = [4.0, -0.8], thickness_m = 3e-3}]"
    found = diagnosed(tmp_path, [], declared)
    said = {one["kind"] for one in found["materials"] if one["outcome"] in ("named", "tied")}
    assert "metal" in said


def test_coefficients_are_those_of_impedances() -> None:
    """Both are of a layer on metal: one by `reflections`, one by the impedance that metal hands up."""
    for family in FAMILIES:
        layer = family.layer(np.mean(np.log(np.array(family.ends)), axis=1), SHORTEST_M)
        eps, mu = (complex(*one) if isinstance(one, tuple) else one for one in (layer.eps_r, layer.mu_r))
        sin = np.sqrt(1.0 - np.linspace(0.04, 1.0, 25) ** 2)
        for across, found in zip((True, False), reflections(layer, 10e9), strict=True):
            assert found == pytest.approx(reflection([(eps, mu, layer.thickness_m)], True, 10e9, across, sin), abs=1e-9)


def test_probes_foretell_the_sweep_of_another_layer(tmp_path: Path) -> None:
    """A plate of one face: to 1 % of its bare amplitude, over thin and thick layers of both families."""
    folder = tmp_path / "plate"
    folder.mkdir()
    (folder / "plate.obj").write_text(PLATE)
    rows = "\n".join(f"8e9,90,{a},-20" for a in (0, 20, 40, 60))
    (folder / "VV8.csv").write_text(f"frequency_hz,theta_deg,phi_deg,rcs_dbsm\n{rows}")
    (folder / "scene.toml").write_text(
        '[scene]\nmesh = "plate.obj"\n[radar]\nfrequency_hz = 8e9\npolarizations = ["VV"]\n[materials.sheet]\n'
        'conductor = true\n[[curves]]\nfile = "VV8.csv"\npolarization = "VV"\nrole = "train"\n'
    )
    scene = warpsar.Scene.load(folder / "scene.toml")

    def swept(material: warpsar.Material) -> MaterialHypothesis:
        made = replace(scene, materials={"sheet": material})
        return beside(tmp_path / "cache", "cpu", "sheet", "metal", made)

    probed = Probed(swept, 299792458.0 / 8e9)
    (bare,) = swept(warpsar.Material(conductor=True)).train
    scale = np.abs(bare.terms["model"])
    for family in FAMILIES:
        low, high = np.log(np.array(family.ends)).T
        for share in (0.2, 0.5, 0.7):
            layer = family.layer(low + share * (high - low), probed.shortest_m)
            (foretold,), (exact,) = probed.beside(layer), swept(coated(layer)).train
            assert (np.abs(foretold.terms["model"] - exact.terms["model"]) < 0.01 * scale + 1e-9).all()
