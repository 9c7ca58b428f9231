"""Rough faces as complex scatterers: mean power, statistics, and that they belong to places."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from bodies import ALL, FREQUENCY, K, plate, rectangles, scene
from surface_model import sigma0_kernel

import warpsar
from warpsar.kernels.codes import Polarization

MATERIAL = {"eps_r": (7.0, -0.9), "rms_height_m": 0.0012, "correlation_length_m": 0.01, "specular_fraction": 0.1}
SIDE = 0.6


def ground() -> warpsar.Mesh:
    h = SIDE / 2
    return rectangles([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]])


def looks(material=MATERIAL, mesh=None, incidence=40.0, n=400, **more) -> np.ndarray:
    """Amplitudes of many azimuths, (n, 4)."""
    found = warpsar.rcs(
        scene(mesh or ground(), material=material, terms=("rough",), **more),
        np.arange(n) * 360.0 / n,
        incidence,
        device="cpu",
        rays_per_wavelength=4.0,
    )
    return found.amplitude_m[:, 0, 0]


@pytest.mark.full
@pytest.mark.parametrize("tau", [0.0, 0.1])
def test_mean_power_is_sigma0(tau: float) -> None:
    """Over the azimuths of a square of ground."""
    found = looks({**MATERIAL, "specular_fraction": tau}, incidence=25.0)
    power = 4 * np.pi * (np.abs(found) ** 2).mean(axis=0) / SIDE**2
    expected = _sigma0(np.deg2rad(25.0), tau)
    # Speckle of 400 azimuths 0.9 degrees apart: lambda / (2 D sin) is 4 degrees, so some 90 looks; 4 sigma are 42 %.
    assert power[[0, 3]] == pytest.approx(expected, rel=0.42)
    # Both polarizations share their scatterers: their ratio is known far better.
    if tau == 0.0:
        assert power[3] / power[0] == pytest.approx(expected[1] / expected[0], rel=0.02)


def _sigma0(theta: float, tau: float) -> np.ndarray:
    out = wp.empty(2, dtype=wp.float64, device="cpu")
    inputs = [K, np.cos(theta), 7.0, 0.9, 0.0012, 0.01, tau, out]
    wp.launch(sigma0_kernel, 2, inputs=inputs, device="cpu")
    assert (int(Polarization.HH), int(Polarization.VV)) == (0, 1)
    return out.numpy()


def test_amplitudes_are_circular_gaussian() -> None:
    found = looks()[:, ALL.index("VV")]
    contrast = (np.abs(found) ** 2).std() / (np.abs(found) ** 2).mean()
    assert contrast == pytest.approx(1.0, abs=0.25)
    assert np.abs((found**2).mean()) < 0.25 * (np.abs(found) ** 2).mean()


@pytest.mark.full
def test_neighbouring_passes_see_nearly_one_speckle() -> None:
    """|coherence| falls as a sinc of the baseline: 1 at none, 0 where the phase across the ground turns by 2 pi."""
    small = np.rad2deg(0.03 / (2 * SIDE) / np.cos(np.deg2rad(40.0)))  # of incidence: lambda / (2 D cos)
    steps = np.array([0.0, 0.25, 1.0]) * small
    found = warpsar.rcs(
        scene(ground(), material=MATERIAL, terms=("rough",)), np.arange(60) * 6.0, 40.0 + steps, device="cpu"
    ).amplitude_m[:, :, 0, 3]
    first = found[:, 0]
    coherence = [
        abs(np.vdot(first, found[:, i])) / np.linalg.norm(first) / np.linalg.norm(found[:, i]) for i in range(3)
    ]
    assert coherence[0] == pytest.approx(1.0)
    assert coherence[1] == pytest.approx(0.9, abs=0.1)
    assert coherence[2] < 0.35


def test_scatterers_do_not_change_with_rays_or_other_directions() -> None:
    base = scene(ground(), material=MATERIAL, terms=("rough",))
    some = warpsar.rcs(base, [10.0, 20.0, 30.0], 40.0, device="cpu").amplitude_m[1]
    other = warpsar.rcs(base, [20.0], 40.0, [0.5 * FREQUENCY, FREQUENCY], device="cpu", rays_per_wavelength=20.0)
    assert np.array_equal(some[:, 0], other.amplitude_m[0, :, 1])


def test_a_smooth_face_has_no_scatterers() -> None:
    found = warpsar.rcs(scene(plate(0.2, 0.2), terms=("rough",)), [80.0], 90.0, device="cpu")
    assert not found.amplitude_m.any()
