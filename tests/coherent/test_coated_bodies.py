"""Curved metal under a layer, by the exact series of coated spheres and cylinders; nothing of the package is in them.

The engine gives each point of a surface a plane's coefficient. The layers have losses: without them a layer guides a
wave around the back, as no ray does (docs/coherent-checks.md).
"""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from bodies import ALL, WAVELENGTH, K, amplitudes
from numpy.typing import NDArray
from scipy.special import h1vp, h2vp, hankel1, hankel2

import warpsar

RADII = 8 * WAVELENGTH, 16 * WAVELENGTH
Layer = tuple[complex, complex, float]
LAYERS: list[Layer] = [
    (4.0 - 0.8j, 1.0, 0.10 * WAVELENGTH),
    (8.0, 2.0 - 1.5j, 0.02 * WAVELENGTH),
    (6.0 - 1.0j, 1.6 - 0.9j, 0.05 * WAVELENGTH),
]


def waves(nu: NDArray, x: complex, slope: bool, round_: bool) -> tuple[NDArray, NDArray]:
    """Waves in and out, (n,) each, or their slopes: Hankel's functions, times sqrt(x) for a sphere."""
    found = []
    for of, of_slope in ((hankel1, h1vp), (hankel2, h2vp)):
        value = of(nu, x)
        if slope:
            value = of_slope(nu, x) + round_ * value / (2.0 * x)
        found.append(value * np.sqrt(x + 0j) ** round_)
    return found[0], found[1]


def sent_back(layer: Layer | None, radius: float, electric: bool, round_: bool) -> NDArray:
    """What comes out of a wave that goes in, of each order from 0, e^{jwt}: twice the books' coefficient less one.

    With `electric` the radial function is that of H, whose slope goes with the tangential E and is 0 at metal; without
    it is that of E, 0 there itself. Bohren and Huffman, Absorption and Scattering of Light (1983), ch. 8.
    """
    y = K * radius
    nu = np.arange(int(y + 6.0 * y ** (1 / 3))) + 0.5 * round_
    inward, outward = (waves(nu, y, slope, round_) for slope in (False, True))
    if layer is None:
        inside, outside = (inward, outward)[electric]
        return inside / outside
    eps, mu, thickness = layer
    m = np.sqrt(eps * mu + 0j)
    metal = waves(nu, m * (y - K * thickness), electric, round_)
    value, slope = (a * metal[1] - b * metal[0] for a, b in (waves(nu, m * y, at, round_) for at in (False, True)))
    q = m / (eps if electric else mu) * slope / value
    return (outward[0] - q * inward[0]) / (outward[1] - q * inward[1])


def sphere(layer: Layer | None, radius: float) -> complex:
    """The far field up to a factor: the sum over (-1)^n (n + 1/2) (a_n - b_n)."""
    a, b = (sent_back(layer, radius, electric, True)[1:] for electric in (True, False))
    n = np.arange(1, len(a) + 1)
    return complex(((-1.0) ** n * (n + 0.5) * (a - b)).sum())


def cylinder(layer: Layer | None, radius: float, electric: bool) -> complex:
    """The far field of a wave from the side, up to a factor; with `electric` H lies along the axis."""
    found = 1.0 + sent_back(layer, radius, electric, False)
    n = np.arange(len(found))
    return complex(((-1.0) ** n * np.where(n, 2.0, 1.0) * found).sum())


def by_rays(mesh: warpsar.Mesh, layer: Layer, incidence: float) -> NDArray[np.complex128]:
    """Coated over bare in HH and VV."""
    eps, mu, thickness = layer
    values = {"eps_r": (eps.real, eps.imag), "mu_r": (complex(mu).real, complex(mu).imag), "thickness_m": thickness}
    bare, coated = (
        amplitudes(mesh, 20.0, incidence, terms=("single",), material=made)[0, 0, [ALL.index("HH"), ALL.index("VV")]]
        for made in ({"conductor": True}, {"conductor": True, "layers": [values]})
    )
    return coated / bare


def allowed(layer: Layer, radius: float) -> float:
    """What spreads in the layer, and what the border of light alone gives to a sphere by physical optics: 1 / (2 ka) of
    the bare amplitude (`test_sphere`) times the change of the coefficient, which is 2 at most."""
    return layer[2] / radius + 1.0 / (K * radius)


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("layer", LAYERS)
def test_a_coated_sphere(layer: Layer, radius: float) -> None:
    ball = warpsar.Mesh.of(trimesh.creation.icosphere(5, radius=radius))
    expected = sphere(layer, radius) / sphere(None, radius)
    assert by_rays(ball, layer, 70.0) == pytest.approx(expected, rel=0.0, abs=allowed(layer, radius))


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("layer", LAYERS)
def test_a_coated_cylinder_from_its_side(layer: Layer, radius: float) -> None:
    tube = trimesh.creation.cylinder(radius=radius, height=4 * WAVELENGTH, sections=720)
    expected = [cylinder(layer, radius, electric) / cylinder(None, radius, electric) for electric in (True, False)]
    found = by_rays(warpsar.Mesh.of(tube), layer, 90.0)
    assert found == pytest.approx(expected, rel=0.0, abs=allowed(layer, radius))


def test_a_layer_with_little_loss_guides_a_wave_that_no_ray_has() -> None:
    """Around the back of a sphere all ways are equally long: 15 % of the bare amplitude at ka 50."""
    layer, radius = (3.0 - 0.1j, 1.0, 0.04 * WAVELENGTH), RADII[0]
    ball = warpsar.Mesh.of(trimesh.creation.icosphere(5, radius=radius))
    lacking = np.abs(sphere(layer, radius) / sphere(None, radius) - by_rays(ball, layer, 70.0))
    assert lacking == pytest.approx(0.15, abs=0.02)
