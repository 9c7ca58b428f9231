"""Layers learned from curves of RCS: values where curves tell them, products where they tell those alone."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from stack_reference import Stack, reflection

import warpsar
from warpsar import Scene
from warpsar.cli.main import main
from warpsar.curves.noise import densities, fit
from warpsar.curves.observe import observe
from warpsar.errors import InputError
from warpsar.learning.coordinates import SceneCoordinates
from warpsar.learning.curve_likelihood import CurveLikelihood
from warpsar.world.tables import LAYER_KEYS

PHI = np.arange(0.0, 60.0, 0.5)
PLATE = "usemtl sheet\nv 0 -.08 -.05\nv 0 .08 -.05\nv 0 .08 .05\nv 0 -.08 .05\nf 1 2 3\nf 1 3 4\n"


def curves_of(folder: Path, stack: Stack, metal: bool, frequencies: Sequence[float], noise: float) -> list[str]:
    """CSV files of an upright plate in metal times the stack's coefficient, with noise relative to the peak."""
    (folder / "plate.obj").write_text(PLATE)
    plate = _scene(folder, [], "conductor = true", "")
    random, tables = np.random.default_rng(5), []
    for frequency in frequencies:
        bare = warpsar.rcs(plate, 90.0 - PHI, 90.0, [frequency], device="cpu")
        sin = np.sin(np.deg2rad(PHI))
        for place, polarization in enumerate(("HH", "VV")):
            gain = reflection(stack, metal, frequency, polarization == "VV", sin)
            field = np.sqrt(4 * np.pi) * bare.amplitude_m[:, 0, 0, place] * gain
            spread = noise * np.abs(field).max() / np.sqrt(2)
            field = field + spread * (random.normal(size=PHI.size) + 1j * random.normal(size=PHI.size))
            lines = [f"{frequency},90,{a},{10 * np.log10(abs(v) ** 2)}" for a, v in zip(PHI, field, strict=True)]
            name = f"{polarization}{frequency / 1e9:g}.csv"
            (folder / name).write_text("\n".join(["frequency_hz,theta_deg,phi_deg,rcs_dbsm", *lines]))
            tables.append(f'[[curves]]\nfile = "{name}"\npolarization = "{polarization}"\nrole = "train"\n')
    return tables


def _scene(folder: Path, tables: Sequence[str], material: str, learn: str) -> Scene:
    (folder / "scene.toml").write_text(
        '[scene]\nmesh = "plate.obj"\n[radar]\nfrequency_hz = 10e9\npolarizations = ["HH", "VV"]\nterms = ["single"]\n'
        f"[materials.sheet]\n{material}\nrms_height_m = 0.0\n{learn}\n{''.join(tables)}"
    )
    return Scene.load(folder / "scene.toml")


def learned(folder: Path, tables: Sequence[str], material: str, learn: str) -> dict[str, Any]:
    _scene(folder, tables, material, f"learn = {learn}")
    done = CliRunner().invoke(main, ["learn", str(folder / "scene.toml"), "-o", str(folder / "out"), "--device", "cpu"])
    assert done.exit_code == 0, done.output
    return dict(json.loads((folder / "out" / "learn.json").read_text())["materials"])


def holds(found: dict[str, Any], truth: float) -> bool:
    low, high = found["interval_95"]
    return bool(low < truth < high)


@pytest.mark.full
def test_a_thin_sheet_tells_its_product_alone(tmp_path: Path) -> None:
    """A sixtieth of a wavelength: the field that it sends back goes with (eps_r - 1) x thickness, up to the next order
    in the thickness."""
    tables = curves_of(tmp_path, [(3.0, 1.0, 5e-4)], False, [10e9], 1e-2)
    found = learned(tmp_path, tables, "eps_r = 2.0\nthickness_m = 8e-4", '["eps_r", "thickness_m"]')
    assert holds(found["sheet.(eps_r - 1) x thickness_m"], 1e-3)
    assert holds(found["sheet.eps_r"], 3.0)
    assert holds(found["sheet.thickness_m"], 5e-4)
    wide = {key: np.divide(*one["interval_95"][::-1]) for key, one in found.items()}
    assert wide["sheet.(eps_r - 1) x thickness_m"] < 1.5
    assert wide["sheet.eps_r"] > 20.0
    assert wide["sheet.thickness_m"] > 20.0


@pytest.mark.full
def test_a_slab_tells_both_of_its_values(tmp_path: Path) -> None:
    """About half a wavelength: another valley of the likelihood, of 6.9 mm, lies nearer to the start."""
    tables = curves_of(tmp_path, [(3.0, 1.0, 9e-3)], False, [8e9, 11e9], 1e-2)
    found = learned(tmp_path, tables, "eps_r = 2.5\nthickness_m = 8e-3", '["eps_r", "thickness_m"]')
    truths = {"sheet.eps_r": 3.0, "sheet.thickness_m": 9e-3, "sheet.(eps_r - 1) x thickness_m": 18e-3}
    assert found.keys() == truths.keys()
    for key, truth in truths.items():
        assert holds(found[key], truth)
        assert found[key]["value"] == pytest.approx(truth, rel=0.02)


@pytest.mark.slow
def test_an_absorber_on_metal_tells_its_values(tmp_path: Path) -> None:
    tables = curves_of(tmp_path, [(6.0 - 1.0j, 1.6 - 0.9j, 2e-3)], True, [6e9, 10e9, 14e9], 1e-2)
    stack = "conductor = true\nlayers = [{eps_r = [5.0, -1.0], mu_r = [1.8, -0.9], thickness_m = 1.7e-3}]"
    found = learned(tmp_path, tables, stack, '["layers.0.eps_r", "layers.0.mu_r", "layers.0.thickness_m"]')
    truths = {"eps_r": 6.0, "mu_r": 1.6, "thickness_m": 2e-3, "mu_r x thickness_m": 3.2e-3}
    assert found.keys() == {f"sheet.layers.0.{key}" for key in truths}
    for key, truth in truths.items():
        assert holds(found[f"sheet.layers.0.{key}"], truth)
        assert found[f"sheet.layers.0.{key}"]["value"] == pytest.approx(truth, rel=0.1)


@pytest.mark.slow
def test_an_absorber_on_metal_tells_its_losses(tmp_path: Path) -> None:
    """A thin one tells the loss of mu_r x thickness better than its factors: the interval is less than half as wide."""
    tables = curves_of(tmp_path, [(8.0, 2.0 - 1.5j, 6e-4)], True, [6e9, 10e9, 14e9], 1e-2)
    stack = "conductor = true\nlayers = [{eps_r = 8.0, mu_r = [2.0, -1.2], thickness_m = 7e-4}]"
    found = learned(tmp_path, tables, stack, '["layers.0.mu_r", "layers.0.mu_r_loss", "layers.0.thickness_m"]')
    truths = {"mu_r": 2.0, "mu_r_loss": 1.5, "thickness_m": 6e-4}
    truths |= {f"{key} x thickness_m": truths[key] * 6e-4 for key in ("mu_r", "mu_r_loss")}
    assert found.keys() == {f"sheet.layers.0.{key}" for key in truths}
    assert all(holds(found[f"sheet.layers.0.{key}"], truth) for key, truth in truths.items()), found
    wide = {key: np.log(np.divide(*found[f"sheet.layers.0.{key}"]["interval_95"][::-1])) for key in truths}
    assert wide["mu_r_loss x thickness_m"] < 0.5 * min(wide["mu_r_loss"], wide["thickness_m"]), wide


def test_slopes_of_every_value_of_a_layer_are_those_of_its_closed_form(tmp_path: Path) -> None:
    """-ln L with the noise held, over the amplitude of bare metal times the coefficient of the stack."""
    truth = [6.0, 1.0, 1.6, 0.9, 2e-3]
    tables = curves_of(tmp_path, [(6.5 - 1.2j, 1.5 - 0.8j, 2.1e-3)], True, [6e9, 10e9], 1e-2)
    keys = [f"layers.0.{key}" for key in LAYER_KEYS]
    stack = "conductor = true\nlayers = [{eps_r = [6.0, -1.0], mu_r = [1.6, -0.9], thickness_m = 2e-3}]"
    scene = _scene(tmp_path, tables, stack, f"learn = {json.dumps(keys)}")
    wanted = [one for one in scene.parameters.values() if one.freed]
    assert [one.key for one in wanted] == keys
    likelihood = CurveLikelihood(scene, wanted, device="cpu")
    x = np.array([float(one.transform.to_coordinate(one.value)) for one in wanted])
    bare = [
        one.amplitude(["single"]) for one in observe(_scene(tmp_path, tables, "conductor = true", ""), device="cpu")
    ]
    curves = observe(scene, device="cpu")
    noises = fit(curves, ["single"]).noise

    def loss(x: np.ndarray) -> float:
        real, loss, mu, mu_loss, thickness = (
            float(one.transform.from_coordinate(u)) for one, u in zip(wanted, x, strict=True)
        )
        total = 0.0
        for one, metal in zip(curves, bare, strict=True):
            layer = complex(real, -loss), complex(mu, -mu_loss), thickness
            sin = np.sin(np.deg2rad(one.azimuth_deg - 90.0))
            field = -metal * reflection([layer], True, one.frequency_hz, one.polarization == "VV", np.abs(sin))
            total -= densities(one, field, noises[one.polarization]).sum()
        return float(total)

    assert [one.transform.from_coordinate(u) for one, u in zip(wanted, x, strict=True)] == pytest.approx(truth)
    expected = [(loss(x + step) - loss(x - step)) / 2e-5 for step in 1e-5 * np.eye(len(x))]
    gradient, _ = likelihood.slopes(x)
    assert gradient == pytest.approx(expected, rel=1e-2)


@pytest.mark.full
def test_a_value_that_the_curves_do_not_show_has_no_narrow_interval(tmp_path: Path) -> None:
    """Behind a film that nothing passes, 46 nepers thick, mu_r may be anything."""
    film = 1.0 - 1e5j, 1.0, 1e-3
    tables = curves_of(tmp_path, [film, (3.0, 1.5, 2e-3)], True, [10e9], 1e-2)
    layers = "{eps_r = [1.0, -1e5], thickness_m = 1e-3}, {eps_r = 3.0, mu_r = 1.5, thickness_m = 2e-3}"
    found = learned(tmp_path, tables, f"conductor = true\nlayers = [{layers}]", '["layers.1.mu_r"]')
    low, high = found["sheet.layers.1.mu_r"]["interval_95"]
    assert found["sheet.layers.1.mu_r"]["open"]
    assert high > 100.0 * low


def test_layers_are_refused_where_nothing_tells_them(tmp_path: Path) -> None:
    (tmp_path / "plate.obj").write_text(PLATE)
    slab = "eps_r = 2.0\nthickness_m = 8e-4"
    with pytest.raises(InputError, match=r"learn: found layers.0.mu_r, which the material does not state; allowed are"):
        _scene(tmp_path, [], slab, 'learn = ["layers.0.mu_r"]')
    lossless = "conductor = true\nlayers = [{eps_r = 3.0, thickness_m = 1e-3}]"
    with pytest.raises(InputError, match=r"learn: found layers.0.eps_r_loss, which the material does not state; allow"):
        _scene(tmp_path, [], lossless, 'learn = ["layers.0.eps_r_loss"]')
    with pytest.raises(InputError, match="learn: found thickness_m, which the material does not state; it has no"):
        _scene(tmp_path, [], "eps_r = 2.0", 'learn = ["thickness_m"]')
    scene = _scene(tmp_path, [], slab, 'learn = ["thickness_m"]')
    with pytest.raises(InputError, match=r"materials.sheet.learn: found thickness_m; an image of power does not"):
        SceneCoordinates(scene, [])
