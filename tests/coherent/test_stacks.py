"""Stacks of electric and magnetic layers: closed forms, their derivatives, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bodies import FREQUENCY, K, amplitudes, plate, scene

import warpsar
from warpsar import InputError, Material
from warpsar.coherent.rcs import cautions
from warpsar.scene.file import parse

WAVELENGTH_M = 2.0 * np.pi / K
FILM_M = WAVELENGTH_M / 1e4
ETA = 376.730313668
Layers = list[dict[str, Any]]


def parts(value: Any) -> complex:
    return complex(*value) if isinstance(value, tuple) else complex(value)


def stack(layers: Layers, backed: bool, sine: float, k: float = K) -> tuple[complex, complex]:
    """R in TE and TM by the product of 2 x 2 matrices of tangential E and H, from the outermost layer inward."""
    cosine = np.sqrt(1.0 - sine**2)
    found = []
    for te in (True, False):
        air = cosine if te else 1.0 / cosine  # admittances over that of space
        whole = np.eye(2, dtype=complex)
        for layer in layers:
            eps, mu = parts(layer.get("eps_r", 1.0)), parts(layer.get("mu_r", 1.0))
            q = np.sqrt(eps * mu - sine**2)
            inside, phase = (q / mu if te else eps / q), k * q * layer["thickness_m"]
            whole = whole @ [
                [np.cos(phase), 1j * np.sin(phase) / inside], [1j * inside * np.sin(phase), np.cos(phase)]
            ]  # fmt: skip
        e, h = whole @ ([0.0, 1.0] if backed else [1.0, air])
        found.append((air * e - h) / (air * e + h))
    return complex(found[0]), complex(found[1])


def reflection(layers: Layers, backed: bool, turned: Any, device: str = "cpu") -> Any:
    """R in (TE, TM) of a plate turned by angles [deg] about a vertical axis: -amplitude over the bare conductor's.

    Shape (angles, 2). HH is TM and VV is TE.
    """
    azimuths, mesh = 90.0 - np.asarray(turned), plate(0.3, 0.2)
    found = []
    for material in ({"conductor": True}, {"conductor": backed, "layers": layers}):
        made = scene(mesh, material=material, terms=("single",))
        found.append(warpsar.rcs(made, azimuths, 90.0, FREQUENCY, device=device).amplitude_m[:, 0, 0])
    same = [scene(mesh).radar.polarizations.index(each) for each in ("VV", "HH")]
    return -found[1][:, same] / found[0][:, same]


STACKS: list[tuple[Layers, bool]] = [
    ([{"eps_r": (12.0, -1.5), "mu_r": (1.6, -0.9), "thickness_m": 0.0017}], True),
    ([{"eps_r": 2.2, "mu_r": (3.0, -0.2), "thickness_m": 0.004}], False),
    ([{"eps_r": (3.2, -0.02), "thickness_m": 0.0012}, {"eps_r": 1.07, "thickness_m": 0.009},
      {"eps_r": (3.2, -0.02), "thickness_m": 0.0012}], False),
    ([{"eps_r": (1.5 + i, -0.1 * i), "mu_r": (1.0 + 0.2 * i, -0.05 * i), "thickness_m": 0.001 + 2e-4 * i}
      for i in range(8)], True),
]  # fmt: skip


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda:0", marks=pytest.mark.cuda)])
@pytest.mark.parametrize(("layers", "backed"), STACKS)
def test_a_plate_reflects_as_its_stack(layers: Layers, backed: bool, device: str) -> None:
    """At all angles, in both polarizations, by transfer matrices that NumPy multiplies; float64 on both sides."""
    turned = np.array([0.0, 12.0, 31.0, 55.0, 78.0])
    found = reflection(layers, backed, turned, device)
    for r, angle in zip(found, np.deg2rad(turned), strict=True):
        assert r == pytest.approx(stack(layers, backed, float(np.sin(angle))), abs=1e-9)


def film(sheet_ohm: float) -> dict[str, Any]:
    """A thin film of a sheet resistance: eps'' = eta / (R k d)."""
    return {"eps_r": (1.0, -ETA / (sheet_ohm * K * FILM_M)), "thickness_m": FILM_M}


@pytest.mark.parametrize("sheet_ohm", [150.0, ETA, 800.0])
def test_a_salisbury_screen(sheet_ohm: float) -> None:
    """A quarter wave in front of metal a sheet reflects (R - eta) / (R + eta): nothing at R = eta.

    The film has a thickness of 1e-4 wavelengths, and turns the phase of what it sees by k d = 6e-4.
    """
    layers = [film(sheet_ohm), {"eps_r": 1.0, "thickness_m": WAVELENGTH_M / 4.0}]
    r = reflection(layers, True, [0.0])[0]
    assert r == pytest.approx((sheet_ohm - ETA) / (sheet_ohm + ETA), abs=1.5e-3)


def test_a_dallenbach_layer_of_matched_stuff_fades_both_ways() -> None:
    """eps = mu is matched at its front: what comes back is -e^{-2jkd mu}, whatever the thickness."""
    for thickness in (0.001, 0.004, 0.02):
        layers = [{"eps_r": (2.0, -0.5), "mu_r": (2.0, -0.5), "thickness_m": thickness}]
        expected = -np.exp(-2j * K * thickness * (2.0 - 0.5j))
        assert reflection(layers, True, [0.0])[0] == pytest.approx(expected, abs=1e-9)


def test_a_dallenbach_layer_has_its_null() -> None:
    """Where tanh(j k d sqrt(eps mu)) sqrt(mu / eps) = 1 a coated conductor reflects nothing at normal incidence.

    For a thin magnetic layer on a thickness k d the solution in mu is found by Newton's method on this equation alone.
    """
    eps, kd, mu = 6.0 - 0.3j, K * 0.0015, 2.0 - 2.0j

    def equation(mu: complex) -> complex:
        return np.sqrt(mu / eps) * np.tanh(1j * kd * np.sqrt(mu * eps)) - 1.0

    for _ in range(50):
        slope = (equation(mu + 1e-6) - equation(mu - 1e-6)) / 2e-6
        mu -= equation(mu) / slope
    assert abs(equation(mu)) < 1e-12
    assert mu.real > 0 > mu.imag
    layers = [{"eps_r": (6.0, -0.3), "mu_r": (mu.real, mu.imag), "thickness_m": 0.0015}]
    assert np.abs(reflection(layers, True, [0.0])[0]).max() < 1e-9


def test_equal_permittivity_and_permeability_do_not_reflect_in_air() -> None:
    """At normal incidence; at any angle TE and TM are each other's negative (duality)."""
    found = reflection([{"eps_r": (2.5, -0.4), "mu_r": (2.5, -0.4), "thickness_m": 0.003}], False, [0.0, 40.0, 70.0])
    assert np.abs(found[0]).max() < 1e-12
    assert found[1:, 0] == pytest.approx(-found[1:, 1], abs=1e-9)
    assert np.abs(found[2]).min() > 0.05  # the test would pass on nothing


def test_one_layer_is_the_old_keys() -> None:
    """Both ways of writing a slab are one, with its edges in air, too."""
    for more in ({}, {"conductor": True}):
        old = {"eps_r": (2.6, -0.1), "thickness_m": 0.002, "rms_height_m": 0.0, **more}
        new = {"layers": [{"eps_r": (2.6, -0.1), "thickness_m": 0.002}], **more}
        found = [amplitudes(plate(0.3, 0.2), [90.0, 55.0], 90.0, material=each) for each in (old, new)]
        assert (found[0] == found[1]).all()


def test_a_layer_cut_in_two_is_the_same() -> None:
    whole = {"eps_r": (4.0, -0.3), "mu_r": (1.3, -0.2), "thickness_m": 0.003}
    halves = [{**whole, "thickness_m": 0.001}, {**whole, "thickness_m": 0.002}]
    found = [reflection(each, True, [0.0, 50.0]) for each in ([whole], halves)]
    assert found[1] == pytest.approx(found[0], abs=1e-12)


NAMES = [f"layers.{i}.{key}" for i in (0, 1, 2) for key in ("eps_r", "mu_r", "thickness_m")]
LOSSES = ["layers.0.mu_r_loss", "layers.1.eps_r_loss", "layers.2.eps_r_loss", "layers.2.mu_r_loss"]


def test_derivatives_of_a_stack_are_those_of_its_closed_form() -> None:
    """Of every value of three layers; central differences of the product of matrices, whose own error is 1e-7."""
    layers: Layers = [
        {"eps_r": 3.0, "mu_r": (1.4, -0.3), "thickness_m": 0.0012},
        {"eps_r": (5.0, -0.6), "mu_r": 1.0, "thickness_m": 0.002},
        {"eps_r": (2.0, -0.1), "mu_r": (2.0, -0.8), "thickness_m": 0.001},
    ]
    angle = 35.0
    mesh = plate(0.3, 0.2)
    made = scene(mesh, material={"conductor": True, "layers": layers}, terms=("single",))
    bare = warpsar.rcs(scene(mesh, terms=("single",)), 90.0 - angle, 90.0, FREQUENCY, device="cpu").amplitude_m
    names = [f"materials.default.{name}" for name in NAMES + LOSSES]
    found = warpsar.rcs_gradients(made, 90.0 - angle, 90.0, FREQUENCY, parameters=names, device="cpu").jacobian()
    polarizations = made.radar.polarizations
    for name in NAMES:
        _, number, key = name.split(".")
        stated = layers[int(number)][key]
        slopes = found[f"materials.default.{name}"][0, 0, 0]
        for part in range(2 if isinstance(stated, tuple) else 1):
            step = 1e-6 * (1e-3 if key == "thickness_m" else 1.0)
            ends = []
            for sign in (1.0, -1.0):
                moved = np.array(stated, float)
                moved[(part,) if isinstance(stated, tuple) else ()] += sign * step
                value = tuple(moved.tolist()) if isinstance(stated, tuple) else float(moved)
                changed = [dict(each) for each in layers]
                changed[int(number)][key] = value
                ends.append(np.array(stack(changed, True, float(np.sin(np.deg2rad(angle))))))
            expected = (ends[0] - ends[1]) / (2 * step)
            for p, which in (("VV", 0), ("HH", 1)):
                at = polarizations.index(p)
                slope = slopes[at, part] if isinstance(stated, tuple) else slopes[at]
                assert slope == pytest.approx(-expected[which] * bare[0, 0, 0, at], rel=1e-5, abs=1e-9), (name, part, p)
    for name in LOSSES:  # the second number of a pair is the loss, negative
        pair = found[f"materials.default.{name.removesuffix('_loss')}"]
        assert (found[f"materials.default.{name}"] == -pair[..., 1]).all()
    lossless = ["materials.default.layers.0.eps_r_loss"]
    with pytest.raises(InputError, match="found no such parameter"):
        warpsar.rcs_gradients(made, 90.0, 90.0, FREQUENCY, parameters=lossless, device="cpu")


def test_a_loss_moves_alone() -> None:
    made = scene(
        plate(0.3, 0.2), material={"conductor": True, "layers": [{"eps_r": (4.0, -0.5), "thickness_m": 0.002}]}
    )
    lossier = made.with_values({"materials.default.layers.0.eps_r_loss": 0.8})
    assert lossier.materials["default"].layers[0].eps_r == (4.0, -0.8)
    denser = lossier.with_values({"materials.default.layers.0.eps_r": 5.0})
    assert denser.materials["default"].layers[0].eps_r == (5.0, -0.8)


def test_a_sandwich_moves_with_its_mirror_image() -> None:
    """In air a layer's twin gets the same value; the middle one has none."""
    skin, core = {"eps_r": 3.2, "thickness_m": 0.001}, {"eps_r": 1.1, "thickness_m": 0.008}
    made = scene(plate(0.3, 0.2), material={"layers": [skin, core, skin]})
    one = made.with_values({"materials.default.layers.0.thickness_m": 0.0015}).materials["default"]
    assert [each.thickness_m for each in one.layers] == [0.0015, 0.008, 0.0015]
    name = "materials.default.layers.0.thickness_m"
    only = replace(made, radar=made.radar.model_copy(update={"terms": ("single",)}))
    slope = warpsar.rcs_gradients(only, 55.0, 90.0, FREQUENCY, parameters=[name], device="cpu").jacobian()[name]
    ends = [
        warpsar.rcs(only.with_values({name: 0.001 + step}), 55.0, 90.0, FREQUENCY, device="cpu").amplitude_m
        for step in (1e-7, -1e-7)
    ]
    # a difference of numbers with 1e-16 over 2e-7 of some mm is right to 1e-6
    assert slope == pytest.approx((ends[0] - ends[1]) / 2e-7, rel=1e-5, abs=1e-6 * np.abs(slope).max())


def test_the_example_absorbs_what_its_stack_does() -> None:
    """`data/coherent/absorber.toml` and its plate of bare metal, broadside: -17.9 dB by the product of matrices."""
    folder = Path(__file__).resolve().parents[2] / "data" / "coherent"
    made = [warpsar.Scene.load(folder / name) for name in ("plate.toml", "absorber.toml")]
    parts = [warpsar.rcs(one, 90.0, 90.0, FREQUENCY, device="cpu").terms_m["single"] for one in made]
    layers = [one.model_dump() for one in made[1].materials["body"].layers]
    expected = stack(layers, True, 0.0)[0]
    assert 20.0 * np.log10(abs(expected)) == pytest.approx(-17.9, abs=0.05)
    assert -parts[1] / parts[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"layers": [{"eps_r": 3.0}], "conductor": True}, r"materials.body.layers[0].thickness_m: missing"),
        ({"layers": [{"mu_r": [2.0, 0.5], "thickness_m": 0.01}]}, "materials.body.layers[0].mu_r: found"),
        ({"layers": [{"mu_r": 0.0, "thickness_m": 0.01}]}, "materials.body.layers[0].mu_r: found 0"),
        ({"layers": [{"thickness_m": 0.01}], "eps_r": 3.0}, "eps_r or thickness_m beside them"),
        ({"layers": [{"thickness_m": 0.01}], "rms_height_m": 0.01, "correlation_length_m": 0.1}, "rms_height_m"),
        ({"layers": [{"thickness_m": 0.01}, {"eps_r": 2.0, "thickness_m": 0.01}]}, "the same from both ends"),
        ({"layers": [{"thickness_m": 0.01}] * 9}, "materials.body.layers: found"),
    ],
)
def test_what_is_no_stack_is_refused(table: dict[str, Any], said: str) -> None:
    _, problems = parse({"materials": {"body": table}})
    assert any(said in each for each in problems), problems


def test_what_stacks_lack_is_said() -> None:
    stacked = Material(layers=[{"eps_r": 2.0, "mu_r": 1.5, "thickness_m": 0.01}])
    assert stacked.rms_height_m == 0.0
    made = scene(plate(0.1, 0.1), material={"layers": [{"eps_r": 2.0, "mu_r": 1.5, "thickness_m": 0.01}]})
    assert any("edges of default have no term: stacks and magnetic slabs" in each for each in cautions(made))
    coated = scene(plate(0.1, 0.1), material={"conductor": True, "layers": [{"mu_r": 1.5, "thickness_m": 0.01}]})
    assert any("edges of default have the impedance of their layers" in each for each in cautions(coated))
    assert not any("impedance" in each for each in cautions(coated, FREQUENCY / 10.0))
    assert not any("edge_waves" in each for each in cautions(coated))
    waves = replace(coated, radar=coated.radar.model_copy(update={"terms": ("edges", "edge_waves")}))
    assert any("edge_waves has nothing between edges of default" in each for each in cautions(waves))
    assert np.isnan(warpsar.rcs(coated, 90.0, device="cpu").model_error_m).all()
    with pytest.raises(InputError, match="found rms_height_m = 0, layers"):
        warpsar.simulate(scene(plate(1.0, 1.0), material={"layers": [{"thickness_m": 0.01}]}), device="cpu")
