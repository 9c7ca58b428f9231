"""A radar at a finite distance, against Fresnel integrals and against the plane wave."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import WAVELENGTH, K, amplitudes, dihedral, plate, rectangles, scene
from scipy.special import fresnel

import warpsar
from warpsar import InputError

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("distance_m", [6.0, 15.0, 60.0])
def test_plate_on_its_axis(distance_m: float) -> None:
    """-jk / (2 pi) times the product of INT e^{-jk x^2 / R} dx over both sides (quadratic phase)."""
    a, b = 10 * WAVELENGTH, 6 * WAVELENGTH

    def side(width: float) -> complex:
        scale = np.sqrt(2 * K / (np.pi * distance_m))
        sine, cosine = fresnel(scale * width / 2)
        return complex(2 / scale * (cosine - 1j * sine))

    expected = -1j * K / (2 * np.pi) * side(a) * side(b)
    found = amplitudes(plate(a, b), 90.0, 90.0, terms=("single",), slant_range_m=distance_m)[0, 0]
    # The next term of the phase is k x^4 / (4 R^3): 0.02 rad at the corners for 6 m.
    assert found[[0, 3]] == pytest.approx(expected, rel=0.01)
    far = amplitudes(plate(a, b), 90.0, 90.0, terms=("single",))[0, 0, 0]
    assert abs(found[0] - far) > 0.01 * abs(far)


@pytest.mark.parametrize("term", ["single", "multibounce", "edges"])
def test_far_away_it_is_a_plane_wave(term: str) -> None:
    """At 1e5 m the wave bends by k D^2 / (4 R) = 5e-5 rad over the body, and A is the same."""
    mesh = dihedral(0.3, 0.2)
    near, far = (
        amplitudes(mesh, [40.0, 47.0], [80.0, 90.0], terms=(term,), finer=20.0, **more)
        for more in ({"slant_range_m": 1e5}, {})
    )
    # Near by tubes sample the plates: their border, 0.2 m, is known to half a cell of lambda / 20.
    strip = 0.2 * 0.5 * WAVELENGTH / 20.0 / WAVELENGTH
    assert np.abs(near - far).max() < (strip if term == "single" else 1e-3 * np.abs(far).max())


def test_rough_ground_far_away() -> None:
    ground = rectangles([[-0.2, -0.2, 0], [0.2, -0.2, 0], [0.2, 0.2, 0], [-0.2, 0.2, 0]])
    material = {"eps_r": 6.0, "rms_height_m": 0.001, "correlation_length_m": 0.01}
    near, far = (
        amplitudes(ground, [40.0, 47.0], 50.0, terms=("rough",), material=material, **more)
        for more in ({"slant_range_m": 1e5}, {})
    )
    assert near == pytest.approx(far, abs=1e-3 * np.abs(far).max())


def test_the_phase_at_ten_thousand_kilometres() -> None:
    """The way is a difference of two distances: 2e-9 m of rounding at 1e7 m, 4e-5 degrees; float32 keeps 1 m."""
    small = plate(0.01, 0.01)
    steps = np.array([0.0, 0.001, 0.007])
    found = []
    for step in steps:
        mesh = warpsar.Mesh.of(small.vertices - np.array([step, 0.0, 0.0]), small.faces)
        found.append(amplitudes(mesh, 90.0, 90.0, terms=("single",), slant_range_m=1e7)[0, 0, 0])
    phase = np.angle(np.array(found) / found[0] * np.exp(2j * K * steps))
    assert np.rad2deg(np.abs(phase)).max() < 1e-4


def test_a_radar_inside_the_body_is_refused() -> None:
    with pytest.raises(InputError, match=r"radar\.slant_range_m: found 0\.2; must be at least"):
        warpsar.rcs(scene(plate(0.3, 0.3), slant_range_m=0.2), 90.0, device="cpu")
