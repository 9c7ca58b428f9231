"""The fourth-order perturbation beside the kernels: Fresnel, Bragg, reciprocity, a surface that is moved, and I2EM."""

import math

import numpy as np
import pytest
import scattering_reference as reference
from perturbation_reference import Perturbation, backscatter

EPS = 9 + 1j
P0, U, P, Q = (np.array(one) for one in ((0.6, 0.1), (-0.3, 0.5), (0.2, -0.7), (1.4, 0.3)))


def vertical(p: np.ndarray) -> complex:
    return complex(np.sqrt(1 - p @ p + 0j))


def test_a_smooth_surface_has_fresnels_coefficients() -> None:
    kernels = Perturbation(EPS, P0)
    r_v, r_h = reference.fresnel(math.asin(math.hypot(*P0)), EPS)
    np.testing.assert_allclose(np.abs(kernels.r0), np.abs([[r_h, 0], [0, r_v]]), atol=1e-14)


@pytest.mark.parametrize("theta", [0.2, 0.7, 1.2])
def test_the_first_order_is_braggs(theta: float) -> None:
    kh, kl, eps, s, c = 0.05, 2.0, 9 - 1j, math.sin(theta), math.cos(theta)
    found = backscatter(theta, eps, kh, kl, 2.0, 20, 8)[0]
    hh = reference.fresnel(theta, eps)[1]
    vv = (eps - 1) * (s**2 - eps * (1 + s**2)) / (eps * c + np.sqrt(eps - s**2)) ** 2
    scale = 8 * (kh * kl) ** 2 * c**4 * (1 + (2 * kl * s) ** 2) ** -1.5
    np.testing.assert_allclose(found, scale * np.diag(np.abs([hh, vv]) ** 2), rtol=1e-9, atol=1e-20)


def test_a_surface_that_is_moved_up_has_another_phase_alone() -> None:
    """h + c scatters exp(-i (q_u + q_0) c) times what h does: each order is tied to the one below it."""
    kernels = Perturbation(EPS, P0)
    phase = -1j * (vertical(U) + vertical(P0))
    np.testing.assert_allclose(kernels.k2(U, U) + kernels.k2(U, P0), phase * kernels.k1(U), atol=1e-12)
    moved = kernels.k3(U, U, Q) + kernels.k3(U, Q, Q) + kernels.k3(U, Q, P0)
    np.testing.assert_allclose(moved, phase * kernels.k2(U, Q), atol=1e-12)


def test_kernels_are_reciprocal() -> None:
    """Sent along p0 and received along u, or the other way: the same with its vertical wave number."""
    one, other = Perturbation(EPS, P0), Perturbation(EPS, -U)
    for there, back in (
        (one.k1(U), other.k1(-P0)),
        (one.k2(U, P) + one.k2(U, U + P0 - P), other.k2(-P0, -P) + other.k2(-P0, P - U - P0)),
    ):
        forward, backward = vertical(U) * there, vertical(P0) * back.T
        np.testing.assert_allclose(np.abs(forward), np.abs(backward), rtol=1e-9)


def test_i2em_lies_beside_it_where_the_surface_is_smooth() -> None:
    """kh 0.13, kl 1: HH and VV to 0.5 dB, VV - HH to 0.3 dB, and HV to 3 dB."""
    theta, eps, kh, kl = math.radians(40.0), 9 - 2.5j, 0.13, 1.0
    exact = 10 * np.log10(backscatter(theta, eps, kh, kl, 8.0)[1])
    hh, vv = (10 * math.log10(reference.i2em(p, theta, eps, kh, kl)) for p in ("HH", "VV"))
    assert abs(hh - exact[0, 0]) < 0.5
    assert abs(vv - exact[1, 1]) < 0.5
    assert abs((vv - hh) - (exact[1, 1] - exact[0, 0])) < 0.3
    assert abs(10 * math.log10(reference.i2em_hv(theta, eps, kh, kl)) - exact[0, 1]) < 3
