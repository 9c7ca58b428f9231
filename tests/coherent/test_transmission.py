"""What comes out of solid dielectrics, against layers by 2 x 2 matrices and Mie's series."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from bodies import FREQUENCY, WAVELENGTH, K, scene
from scipy.special import spherical_jn, spherical_yn

import warpsar
from warpsar.coherent import sweep
from warpsar.coherent.rays import CellGrid
from warpsar.coherent.rcs import rcs
from warpsar.world.frame import SPEED_OF_LIGHT

TERMS = ("single", "transmission")


def stack(eps: complex, thickness: float, last: complex | None) -> complex:
    """Reflection at normal incidence of a layer in air (`last` None), or on something of the reflection `last`."""
    index = np.sqrt(eps)
    index = index if index.imag <= 0.0 else -index
    first = (1.0 - index) / (1.0 + index)
    passed = np.exp(-2j * K * index * thickness)
    back = -first if last is None else last
    return complex((first + back * passed) / (1.0 + first * back * passed))


def box(thickness: float, width: float = 3 * WAVELENGTH) -> warpsar.Mesh:
    made = trimesh.creation.box((thickness, width, width))
    return warpsar.Mesh.of(made.vertices, made.faces)


@pytest.mark.parametrize(("eps", "allowed"), [((4.0, 0.0), 0.01), ((2.9, -0.0822), 0.05)])
@pytest.mark.parametrize("thickness", [0.02 * WAVELENGTH, 0.3 * WAVELENGTH, 0.8 * WAVELENGTH])
def test_a_box_is_a_layer_from_its_front(eps: tuple[float, float], allowed: float, thickness: float) -> None:
    made = scene(box(thickness), material={"eps_r": eps, "rms_height_m": 0.0}, terms=TERMS)
    found = rcs(made, 90.0, 90.0, FREQUENCY, device="cpu")
    area = (3 * WAVELENGTH) ** 2
    expected = area / WAVELENGTH * abs(stack(complex(*eps), thickness, None))
    for polarization in (0, 3):  # HH, VV
        decibels = 20.0 * np.log10(abs(found.amplitude_m[0, 0, 0, polarization]) / expected)
        assert decibels == pytest.approx(0.0, abs=allowed)


@pytest.mark.parametrize("azimuth", [90.0, 60.0, 20.0])
def test_wide_tubes_send_what_narrow_ones_do(azimuth: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thin plate: tubes stay wide where they meet the same faces, and are halved where they do not.

    Narrow ones, 24 across the plate, are themselves right to 5 % this far from the mirror direction.
    """
    made = scene(
        box(0.1 * WAVELENGTH, 2 * WAVELENGTH), material={"eps_r": (4.0, -0.1), "rms_height_m": 0.0}, terms=TERMS
    )
    wide = rcs(made, azimuth, 80.0, FREQUENCY, device="cpu").terms_m["transmission"]
    width = 0.1 * WAVELENGTH / 24.0
    monkeypatch.setattr(sweep, "_PARTED", 24.0)  # so that none is halved
    monkeypatch.setattr(sweep, "CellGrid", lambda body, views, _, away: CellGrid(body, views, width, away))
    narrow = rcs(made, azimuth, 80.0, FREQUENCY, device="cpu").terms_m["transmission"]
    assert np.abs(wide - narrow).max() < 0.06 * np.abs(narrow).max()


def test_metal_within_the_solid_reflects() -> None:
    """A box whose back is of metal: a layer on a conductor, whose loss alone is left of the amplitude."""
    thickness, width = 0.8 * WAVELENGTH, 3 * WAVELENGTH
    mesh = box(thickness, width)
    back = mesh.vertices[mesh.faces].mean(axis=1)[:, 0] < -0.49 * thickness
    mesh = warpsar.Mesh(mesh.vertices, mesh.faces, back.astype(np.int32), ("resin", "metal"))
    made = scene(mesh, terms=TERMS)
    made.materials["resin"] = warpsar.Material(eps_r=(2.9, -0.0822), rms_height_m=0.0)
    found = rcs(made, 90.0, 90.0, FREQUENCY, device="cpu")
    expected = width**2 / WAVELENGTH * abs(stack(2.9 - 0.0822j, thickness, -1.0))
    assert 20.0 * np.log10(abs(found.amplitude_m[0, 0, 0, 0]) / expected) == pytest.approx(0.0, abs=0.05)


def mie(x: float, index: complex) -> float:
    """|A| / (a / 2) of the backscatter of a ball (Bohren and Huffman, chapter 4); `index` with e^{-iwt}."""
    n = np.arange(1, int(x + 4 * x ** (1 / 3) + 10))
    slopes = np.zeros(len(n) + 40, complex)
    for i in range(len(slopes) - 1, 0, -1):
        slopes[i - 1] = i / (index * x) - 1.0 / (slopes[i] + i / (index * x))
    d = slopes[1 : len(n) + 1]
    psi, before = x * spherical_jn(n, x), x * spherical_jn(n - 1, x)
    xi, xi_before = psi + 1j * x * spherical_yn(n, x), before + 1j * x * spherical_yn(n - 1, x)
    a = ((d / index + n / x) * psi - before) / ((d / index + n / x) * xi - xi_before)
    b = ((d * index + n / x) * psi - before) / ((d * index + n / x) * xi - xi_before)
    return float(abs(np.sum((2 * n + 1) * (-1.0) ** n * (a - b))) / x)


@pytest.mark.full
def test_a_ball_with_losses_is_that_of_mie() -> None:
    """Mean power over a band: both know the first surface, and the loss leaves little of the rest."""
    radius = 5 * WAVELENGTH
    made = trimesh.creation.icosphere(5, radius)
    world = scene(
        warpsar.Mesh.of(made.vertices, made.faces), material={"eps_r": (2.9, -0.3), "rms_height_m": 0.0}, terms=TERMS
    )
    frequencies = np.linspace(0.9, 1.1, 21) * FREQUENCY
    found = rcs(world, 30.0, 90.0, frequencies, device="cpu")
    expected = [mie(2 * np.pi * f / SPEED_OF_LIGHT * radius, np.sqrt(2.9 + 0.3j)) * radius / 2 for f in frequencies]
    power = np.mean(np.abs(found.amplitude_m[0, 0, :, 0]) ** 2)
    assert 10.0 * np.log10(power / np.mean(np.square(expected))) == pytest.approx(0.0, abs=0.2)


def test_ground_has_no_such_term_unless_it_is_asked_for() -> None:
    material = {"eps_r": (4.0, -0.01), "rms_height_m": 0.0}
    found = rcs(scene(box(WAVELENGTH), material=material), 90.0, 90.0, FREQUENCY, device="cpu")
    assert "transmission" not in found.terms_m


def test_a_derivative_is_refused() -> None:
    world = scene(box(WAVELENGTH), material={"eps_r": (4.0, -0.01), "rms_height_m": 0.0}, terms=TERMS)
    with pytest.raises(warpsar.InputError, match="transmission"):
        warpsar.rcs_gradients(world, 90.0, 90.0, FREQUENCY, parameters=["materials.default.eps_r"], device="cpu")
