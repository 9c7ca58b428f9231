"""Edges of coated metal against exact wedges, boundary integrals, duality and their own limits."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from bodies import amplitudes, plate, scene
from test_rcs_gradients import agrees, amplitude, by_vertex, slopes

import warpsar
from warpsar import Material
from warpsar.coherent.contributors import contributors
from warpsar.coherent.wedge import fringes
from warpsar.world.frame import SPEED_OF_LIGHT

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
from coated_edges import (
    LAYERS,
    WIDE,
    K,
    box_amplitudes,
    exact,
    far_field,
    layers_of,
    material,
    of_square,
    of_wedge,
    optics,
    sines,
    square,
)

LAYER = LAYERS["eps_r 1.5 - 3j, an eighth"]
STACK: list[dict[str, Any]] = [
    {"eps_r": (3.0, -0.4), "thickness_m": 0.0012},
    {"eps_r": (5.0, -1.0), "mu_r": (1.5, -0.3), "thickness_m": 0.0007},
]
MATCHED: dict[str, Any] = {
    "conductor": True,
    "layers": [{"eps_r": (20.0, -20.0), "mu_r": (20.0, -20.0), "thickness_m": 0.003}],
}


def box() -> warpsar.Mesh:
    made = trimesh.creation.box((0.12, 0.2, 0.16))
    return warpsar.Mesh.of(made.vertices, made.faces)


@pytest.mark.parametrize("outer", [2.0, 1.5, 1.2])
@pytest.mark.parametrize("polarization", ["E", "H"])
@pytest.mark.parametrize("name", list(LAYERS))
def test_the_exact_wedge(name: str, polarization: str, outer: float) -> None:
    """Fringe currents and physical optics of both faces, in amplitude and phase: Maliuzhinets by another quadrature."""
    true, found, bare = of_wedge(LAYERS[name], outer, polarization)
    assert np.abs(found - true).max() < 1e-5 * np.abs(true).max()
    assert np.abs(bare / true - 1.0).max() > 0.02


@pytest.mark.parametrize("polarization", ["E", "H"])
def test_it_is_finite_where_physical_optics_is_not(polarization: str) -> None:
    """On both sides of a mirror direction and of a border of light, whose poles are those of each face's own layer."""
    for outer, borders in ((2.0, (90.0, 180.0, 270.0)), (1.5, (90.0, 180.0)), (1.25, (45.0, 90.0, 135.0, 180.0))):
        phi = np.deg2rad(np.array(borders)[:, None] + [-0.2, 0.2]).ravel()
        both = [sines(LAYER, float(each), outer, polarization) for each in phi]
        true = [
            exact(float(each), outer, *pair) - optics(float(each), outer, *pair)
            for each, pair in zip(phi, both, strict=True)
        ]
        made, which = material(LAYER, 1.0), "EH".index(polarization)
        assert fringes(made, SPEED_OF_LIGHT, phi, outer)[which] == pytest.approx(np.array(true), rel=1e-4)
        inside = np.deg2rad(np.array(borders) + 1e-9)
        assert np.abs(fringes(made, SPEED_OF_LIGHT, inside, outer)[which]).max() < 2.0


@pytest.mark.parametrize("reach", [1e9, 3.0])
def test_a_layer_that_gets_thin_is_a_conductor(reach: float) -> None:
    """Also along a face of finite length: what is left falls with the thickness."""
    phi = np.deg2rad([0.01, 3.0, 60.0, 120.0, 179.0, 200.0, 300.0, 357.0])[1 if reach > 1e6 else 0 :]
    bare, *layers = (
        fringes(material(each, 1.0), SPEED_OF_LIGHT, phi, 2.0, reach)
        for each in (None, (3.0 - 0.1j, 1.0, 1e-3), (3.0 - 0.1j, 1.0, 1e-5))
    )
    for i in range(2):
        off = [np.abs(each[i] - bare[i]).max() for each in layers]
        assert off[1] < 2e-3 * np.abs(bare[i]).max()
        assert off[1] < 0.05 * off[0]


def test_what_is_matched_sends_the_dual_wave() -> None:
    """eps_r = mu_r: a body turns E into H, so HH = -VV and HV = VH, at any angle to its edges; metal does neither."""
    for mesh in (plate(0.15, 0.1), box()):
        for stuff, most in ((MATCHED, 5e-3), ({"conductor": True}, np.inf)):
            made = amplitudes(mesh, [20.0, 50.0, 77.0], [90.0, 70.0, 40.0], material=stuff, terms=("edges",))
            scale = np.abs(made).max()
            off = max(np.abs(made[..., 0] + made[..., 3]).max(), np.abs(made[..., 1] - made[..., 2]).max()) / scale
            assert off < most
        assert off > 0.1


@pytest.mark.parametrize("mesh", [plate(0.15, 0.21), box()], ids=["plate", "box"])
def test_derivatives(mesh: warpsar.Mesh) -> None:
    """Of layers and vertices, against differences of the engine."""

    def changed(row: int, key: str, step: float) -> dict[str, Any]:
        layers = [dict(one) for one in STACK]
        value = layers[row][key]
        layers[row][key] = value + step if key == "thickness_m" else (value[0] + step, value[1])
        return {"conductor": True, "layers": layers}

    angles, more = ([70.0, 35.0], 80.0), {"terms": ("edges",)}
    some = ((0, "eps_r", 1e-5), (0, "thickness_m", 1e-7), (1, "mu_r", 1e-5), (1, "thickness_m", 1e-7))
    names = [f"materials.default.layers.{row}.{key}" for row, key, _ in some]
    here = changed(0, "thickness_m", 0.0)
    _, jacobian = slopes(mesh, *angles, "mesh.vertices", *names, material=here, **more)
    for name, (row, key, step) in zip(names, some, strict=True):
        ends = [amplitude(mesh, *angles, material=changed(row, key, s), **more) for s in (step, -step)]
        found = jacobian[name] if key == "thickness_m" else jacobian[name][..., 0]
        assert agrees(found, (ends[0] - ends[1]) / (2 * step), 1e-6)
    for vertex, axis in ((0, 1), (2, 2)) if len(mesh.vertices) == 4 else ((7, 2), (5, 0)):
        expected = by_vertex(mesh, vertex, axis, 1e-7, *angles, material=here, **more)
        assert agrees(jacobian["mesh.vertices"][..., vertex, axis], expected, 1e-5)


def test_bare_edges_of_a_body_with_coats_are_those_of_bare_metal() -> None:
    """The kernel that knows layers has for an edge of bare metal what the other one has."""
    one = plate(0.15, 0.1)
    both = warpsar.Mesh.of(
        np.concatenate([one.vertices, one.vertices + np.array([0.0, 0.0, 1.0])]),
        np.concatenate([one.faces, one.faces + 4]),
        face_material=np.array([0, 0, 1, 1]),
        materials=("bare", "coated"),
    )
    made = replace(scene(both), materials={"bare": Material(conductor=True), "coated": Material(**MATCHED)})
    alone = contributors(scene(one), 20.0, 80.0, device="cpu")
    found = contributors(made, 20.0, 80.0, device="cpu")
    first = found.start[:, 2] < 0.5
    assert np.abs(found.edges_m[first]) == pytest.approx(np.abs(alone.edges_m), rel=1e-12)
    assert np.abs(found.edges_m[~first]).max() < 0.5 * np.abs(alone.edges_m).max()


@pytest.mark.slow
def test_a_matched_square() -> None:
    """A box whose faces have the impedance of space, against boundary integrals with that impedance."""
    azimuths = np.arange(5.0, 46.0, 2.0)
    turned = np.deg2rad(90.0 - azimuths)
    s = np.stack([np.cos(turned), np.sin(turned)], axis=1)
    sides = square(WIDE, 200)
    single, double = layers_of(sides, sides, K)
    matrix = 0.5 * np.eye(len(single)) - double + 1j * K * single
    field = np.linalg.solve(matrix, np.exp(1j * K * sides[0] @ s.T))
    true = far_field(sides, field, 1j * K * field, s)
    made = box_amplitudes(azimuths, 0.1 * WIDE, material((20.0 - 20.0j, 20.0 - 20.0j, 0.1), 0.1), "single", "edges")
    for amplitude_m, turn in ((made[:, 0], 1j), (made[:, 1], -1j)):
        off = np.pi * turn * amplitude_m - true
        print(f"{np.abs(20.0 * np.log10(np.abs(1.0 + off / true))).mean():.2f} dB")
        assert np.sqrt((np.abs(off) ** 2).mean()) < 0.03 * np.sqrt((np.abs(true) ** 2).mean())


@pytest.mark.slow
def test_a_square_under_a_layer() -> None:
    """A box against boundary integrals of metal under a layer, which know neither impedances nor edges."""
    true, found, bare = of_square(LAYERS["eps_r 3, a fiftieth of a wavelength"], "E", 120)
    off, before = (np.sqrt((np.abs(each - true) ** 2).mean()) for each in (found, bare))
    assert off < 0.05 * np.sqrt((np.abs(true) ** 2).mean())
    assert off < 0.5 * before
