"""Waves from edge to edge of a thin plate against Ross's formula and the transition function of scipy."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from bodies import FREQUENCY, WAVELENGTH, K, plate, rectangles, scene
from scipy.special import erfc

import warpsar
from warpsar import InputError
from warpsar.kernels.coherent import edge_waves

TERMS = ("single", "edges", "edge_waves")


@wp.kernel(enable_backward=False)
def transition_kernel(x: wp.array[wp.float64], out: wp.array[wp.vec2d]):
    i = wp.tid()
    out[i] = edge_waves.transition(x[i])


def test_the_transition_function() -> None:
    """F(x) / sqrt(x) = e^{j (x + pi / 4)} sqrt(pi) erfc(e^{j pi / 4} sqrt(x)), in both its series."""
    x = np.concatenate([[0.0, 1e-9], np.geomspace(1e-3, 1e3, 200)])
    out = wp.empty(len(x), dtype=wp.vec2d, device="cpu")
    wp.launch(transition_kernel, len(x), [wp.array(x, dtype=wp.float64, device="cpu")], [out], device="cpu")
    turn = np.exp(0.25j * np.pi)
    expected = np.sqrt(np.pi) * turn * np.exp(1j * x) * erfc(turn * np.sqrt(x))
    assert out.numpy() @ [1.0, 1j] == pytest.approx(expected, rel=3e-5)


def amplitude(mesh: warpsar.Mesh, turned_deg: np.ndarray, terms: tuple[str, ...] = TERMS) -> np.ndarray:
    found = warpsar.rcs(scene(mesh, terms=terms, polarizations=("HH", "VV")), 90.0 - turned_deg, 90.0, device="cpu")
    return found.amplitude_m[:, 0, 0]


def ross(width: float, height: float, turned_deg: np.ndarray) -> np.ndarray:
    """Ross (1966), magnetic field along the two edges: one diffraction, two, three, and the sum of all further ones."""
    ka, sine, cosine = K * width, np.sin(np.deg2rad(turned_deg)), np.cos(np.deg2rad(turned_deg))
    first = np.cos(ka * sine) + 1j * np.sin(ka * sine) / sine
    step = np.exp(1j * (ka + np.pi / 4.0)) / np.sqrt(2.0 * np.pi * ka)
    ends = (1.0 - sine) * np.exp(-1j * ka * sine) + (1.0 + sine) * np.exp(1j * ka * sine)
    further = 4.0 * step * (1.0 / cosine - step * ends / (2.0 * cosine**2)) / (1.0 - step**2)
    return height / (2.0 * np.pi) * np.abs(first - further)


def test_a_plate_in_its_principal_plane() -> None:
    """Far from the plate's own plane the transition functions are 1 up to 1 / (2 x), x = 2 pi 20 (1 - sin): 1 %.

    The plate is high: what the upper and lower edge send goes with the width alone, and Ross leaves it out.
    """
    width, height = 20.0 * WAVELENGTH, 2.0
    turned = np.linspace(5.0, 50.0, 91)
    expected = ross(width, height, turned)
    found = np.abs(amplitude(plate(width, height), turned)[:, 0])
    assert np.abs(found - expected).max() < 0.01 * height / (2.0 * np.pi)
    without = np.abs(amplitude(plate(width, height), turned, TERMS[:2])[:, 0])
    assert np.abs(without - expected).max() > 0.2 * height / (2.0 * np.pi)


def test_nothing_comes_back_along_the_plate() -> None:
    """Along itself an endless thin plate is not there for an electric field across it: all orders cancel. What is left
    is of the terms that have no transition function, 1 / (2 pi ka)."""
    found = np.abs(amplitude(plate(6.0 * WAVELENGTH, 0.2), np.array([60.0, 88.0, 89.9, 90.0]))[:, 0])
    assert found[1] < 0.1 * found[0]
    assert (found[2:] < 0.04 * found[0]).all()


def test_a_thin_box_has_the_waves_of_a_sheet_and_a_thick_one_has_none() -> None:
    """The rims of the lit face are half the thickness nearer, which turns the phase alone."""
    turned = np.linspace(5.0, 75.0, 15)
    sheet = amplitude(plate(0.2, 0.2), turned, ("edge_waves",))

    def box(thickness: float) -> np.ndarray:
        made = trimesh.creation.box((thickness, 0.2, 0.2))
        return amplitude(warpsar.Mesh.of(made.vertices, made.faces), turned, ("edge_waves",))

    nearer = np.exp(1j * K * WAVELENGTH / 40.0 * np.cos(np.deg2rad(turned)))[:, None]
    assert box(WAVELENGTH / 40.0) == pytest.approx(sheet * nearer, abs=1e-3 * np.abs(sheet).max())
    assert not box(WAVELENGTH / 5.0).any()


def test_a_slanting_wave_needs_an_edge_where_it_arrives() -> None:
    """Turned about the horizontal, the upright edges see the wave aslant: it runs h tan(elevation) farther along."""
    made = scene(plate(0.1, 0.1), terms=("edge_waves",), polarizations=("HH", "VV"))
    found = np.abs(warpsar.rcs(made, 90.0, [46.0, 44.0], device="cpu").amplitude_m[0, :, 0])
    assert found[0, 0] > 1e-5
    assert found[1, 0] < 1e-12  # of HH, whose magnetic field goes along the upright edges


def test_edges_that_are_not_parallel_have_no_wave() -> None:
    trapezium = rectangles([[0, -0.1, -0.1], [0, 0.1, -0.1], [0, 0.06, 0.1], [0, -0.1, 0.1]])
    found = warpsar.rcs(scene(trapezium, terms=("edge_waves",), polarizations=("HH",)), 40.0, 90.0, device="cpu")
    level = warpsar.rcs(scene(plate(0.2, 0.2), terms=("edge_waves",), polarizations=("HH",)), 40.0, 90.0, device="cpu")
    assert abs(found.amplitude_m).max() < 0.3 * abs(level.amplitude_m).max()


def test_it_has_no_derivative() -> None:
    made = scene(plate(0.1, 0.1), terms=TERMS)
    with pytest.raises(InputError, match='found "edge_waves", which has no derivative'):
        warpsar.rcs_gradients(made, 80.0, 90.0, FREQUENCY, parameters=["mesh.vertices"], device="cpu")
