"""Double scattering of the integral equation in co-polarization, and all orders of h: fields, limits, and the table."""

import math

import numpy as np
import pytest
import rayleigh_reference as rayleigh
import scattering_reference as reference
from conftest import MEASURED
from double_reference import complementary, double, waves
from perturbation_reference import Perturbation, _meeting, backscatter

THETA, EPS = math.radians(40.0), 9 - 2.5j
C, S = math.cos(THETA), math.sin(THETA)


@pytest.mark.parametrize("polarization", ["VV", "HH"])
@pytest.mark.parametrize(("case", "up"), [(1, -1), (2, 1)])
def test_fields_along_the_two_waves_are_those_of_single_scattering(polarization: str, case: int, up: int) -> None:
    """Where the wave leaves no pole: the coefficients are printed with it multiplied out."""
    expected = reference.above_and_below(polarization, THETA, EPS, case, up)
    u = np.array([-S if case == 1 else S])
    for one, below in zip(expected, (False, True), strict=True):
        q = np.sqrt(EPS - S * S) if below else C
        way = np.array([up * q])
        field = complementary(polarization, THETA, EPS, u, 0 * u, way, way, below=below)[0] / q
        assert field * (C - way[0] if case == 1 else C + way[0]) == pytest.approx(one, rel=1e-12)


def test_hv_has_the_published_field() -> None:
    """Fung, Li and Chen 1992, equation A28: slopes without the wave's own phase, and the mean of up and down."""
    u, v = np.random.default_rng(0).normal(size=(2, 40))
    r_v, r_h = reference.fresnel(THETA, EPS)
    r = (r_v - r_h) / 2
    q, below = np.sqrt(1 - u * u - v * v - 1e-4j), np.sqrt(EPS - u * u - v * v)
    p, m = 1 + r, 1 - r
    expected = (m / q - p / below) * (1 - 3 * r) - (m / q - p / below / EPS) * p
    expected = expected + (p / q - m / below) * (1 + 3 * r) - (p / q - m / below * EPS) * m
    [(found, _phase)] = waves("HV", THETA, EPS, u, v, own_phases=False)
    np.testing.assert_allclose(found / 2, expected * u * v / C, rtol=1e-10)


def test_hv_is_the_published_integral() -> None:
    """Within what the kernels' loss below the surface takes: this one has that of eps alone."""
    for eps, kh, kl in ((3 - 1j, 0.26, 1.0), (9 - 2.5j, 0.5, 3.0), (30 - 4.5j, 1.0, 5.0)):
        kirchhoff, alone = double("HV", THETA, eps, kh, kl, rings=400, spokes=48)
        assert kirchhoff == 0
        assert 1 < alone / reference.i2em_hv(THETA, eps, kh, kl) < 1.15


def parts(eps: complex, kh: float, kl: float) -> np.ndarray:
    """Fourth order of h over Bragg's power: of waves twice scattered, and of Bragg's wave with the third order."""
    p0, u = np.array([S, 0.0]), np.array([-S, 0.0])
    second = Perturbation(complex(eps.real, -eps.imag), p0)
    bragg, whole = backscatter(THETA, eps, kh, kl, 8.0)
    along = np.linspace(-6, 6, 121) + 0.013
    x, y = (one.ravel() for one in np.meshgrid(along, along, indexing="ij"))
    p, there = np.stack([x, y], -1), u + 0 * np.stack([x, y], -1)
    one, two = second.k2(there, p), second.k2(there, u + p0 - p)

    def w(k: np.ndarray) -> np.ndarray:
        return np.asarray((kh * kl) ** 2 / (2 * np.pi) * (1 + kl**2 * (k**2).sum(-1)) ** -1.5)

    power = (one * np.conj(one) + one * np.conj(two)).real * (w(u - p) * w(p - p0))[:, None, None]
    twice = 4 * math.pi * C**2 * power.sum(0) * (along[1] - along[0]) ** 2
    return np.array([[twice[i, i], (whole - bragg - twice)[i, i]] / bragg[i, i] for i in (1, 0)])


@pytest.mark.full
@pytest.mark.parametrize("eps", [3 - 1j, 9 - 2.5j, 30 - 4.5j])
def test_against_the_fourth_order(eps: complex) -> None:
    """docs/scattering-checks.md: its loops help H as the theory does, but what the theory takes is not in it.

    The theory takes more from VV than from HH, by Bragg's wave with the third order. The published terms of that kind
    (`rest`) give to VV.
    """
    kh, kl = 0.13, 0.52
    (loops_v, third_v), (loops_h, third_h) = parts(eps, kh, kl)
    assert third_v < third_h < 0 < loops_v < loops_h
    sums = {}
    for polarization in ("VV", "HH"):
        bragg = reference.i2em(polarization, THETA, eps, 1e-3, kl) * (kh / 1e-3) ** 2
        loops = sum(double(polarization, THETA, eps, kh, kl, lowest=True))
        whole = sum(double(polarization, THETA, eps, kh, kl, lowest=True, rest=True))
        sums[polarization] = np.array([loops, whole - loops]) / bragg
    assert 0 < sums["VV"][0] < sums["HH"][0]
    assert sums["HH"][1] < sums["VV"][1]


@pytest.mark.full
def test_the_kirchhoff_part_makes_powers_of_rough_surfaces_negative() -> None:
    surface = THETA, EPS, 1.32, 1.32 * 7
    assert reference.i2em("HH", *surface) + sum(double("HH", *surface)) < 0
    assert reference.aiem("HH", *surface) + sum(double("HH", *surface, own_phases=True, rest=True)) < 0
    assert reference.aiem("HH", *surface) + sum(double("HH", *surface, own_phases=True)) > 0


def test_waves_below_take_more_from_aiem_than_the_theory_does() -> None:
    """VV - HH of a wet surface at kh 0.13: the fourth order takes 0.1 to 0.25 dB, AIEM some 1 dB."""
    kh, kl, eps = 0.13, 1.3, 30 - 4.5j
    second, fourth = (10 * np.log10(one[1, 1] / one[0, 0]) for one in backscatter(THETA, eps, kh, kl, 32.0))
    apart = [
        10 * math.log10(model("VV", THETA, eps, kh, kl) / model("HH", THETA, eps, kh, kl))
        for model in (reference.i2em, reference.aiem)
    ]
    assert 0.1 < second - fourth < 0.25
    assert abs(apart[0] - fourth) < 0.15
    assert fourth - apart[1] > 0.7


@pytest.fixture(scope="module")
def period() -> rayleigh.Period:
    return rayleigh.Period(4, 2.2, EPS, THETA)


def test_a_flat_surface_sends_nothing_back_at_any_height(period: rayleigh.Period) -> None:
    for height in (0.0, 0.4):
        found, _first = period.backscatter(np.full((32, 32), height))
        assert np.abs(found).max() < 1e-12


def test_a_smooth_surface_has_the_first_order(period: rayleigh.Period) -> None:
    found, first = rayleigh.powers(period, 1e-3, 1e-2, 1.5, 2, 64)
    for i in (0, 1):
        np.testing.assert_allclose(found[..., i, i], first[..., i, i], rtol=2e-3)


@pytest.mark.slow
def test_all_orders_begin_with_the_fourth(period: rayleigh.Period) -> None:
    """kh 0.13 and kl 1, without waves beyond 1.5 k: to a tenth of a decibel. HV is VH, which no equation of it says."""
    found, first = rayleigh.powers(period, 0.13, 1.0, 1.5, 24, 64)
    over, error = rayleigh.decibels(found, first)
    second, fourth = backscatter(math.asin(period.sine), EPS, 0.13, 1.0, 1.5)
    change = 10 * np.log10(np.diag(fourth) / np.diag(second))
    assert (error < 0.05).all()
    np.testing.assert_allclose(over, (change[1], change[0], change[1] - change[0]), atol=0.1)
    mean = found.mean((0, 1))
    assert mean[0, 1] == pytest.approx(mean[1, 0], rel=0.02)


def test_the_matrix_of_a_flat_surface_is_fresnels(period: rayleigh.Period) -> None:
    """Its diagonal blocks are those that perturbation_reference.py solves for the reflected wave."""
    i = int(period.incident[0])
    p = (period.at[i] + 0.5) / 4
    eps = complex(EPS.real, -EPS.imag)
    np.testing.assert_allclose(period.scattered[i, i], _meeting(p, p, eps, 1)[0], atol=1e-13)


@pytest.mark.measured
def test_loops_bring_aiem_near_the_table_but_not_within_1_db() -> None:
    """docs/scattering-checks.md, other published models: the nearest of them."""
    table = np.loadtxt(MEASURED / "nmm3d" / "NMM3D_LUT_NRCS_40degree.dat")
    off = []
    for incidence, ratio, re, im, height, vv, hh, _hv in table:
        row = np.radians(incidence), re - 1j * im, 2 * np.pi * height, 2 * np.pi * height * ratio
        pair = [reference.aiem(p, *row) + sum(double(p, *row, own_phases=True)) for p in ("VV", "HH")]
        off.append(10 * np.log10(pair) - (vv, hh))
    rms = np.sqrt(np.mean(np.square(off), axis=0))
    np.testing.assert_allclose(rms, (0.72, 1.12), atol=0.006)
    apart = np.array(off) @ (1, -1)
    means = [apart[table[:, 4] == h].mean() for h in np.unique(table[:, 4])]
    np.testing.assert_allclose(means, (0.99, -0.03, -0.68, -1.00, -1.13, -1.00, -0.02), atol=0.006)


@pytest.mark.measured
def test_i2em_is_nearer_to_the_theory_than_the_table_is() -> None:
    """Mean VV - HH of the table's 48 smooth surfaces: why the bar of 1 dB is not for a model to meet there."""
    table = np.loadtxt(MEASURED / "nmm3d" / "NMM3D_LUT_NRCS_40degree.dat")
    for height in (0.021, 0.042):
        apart = []
        for incidence, ratio, re, im, _height, vv, hh, _hv in table[table[:, 4] == height]:
            row = np.radians(incidence), re - 1j * im, 2 * np.pi * height, 2 * np.pi * height * ratio
            theory = backscatter(*row, 8.0, 80, 24)[1]
            model = 10 * math.log10(reference.i2em("VV", *row) / reference.i2em("HH", *row))
            apart.append((10 * math.log10(theory[1, 1] / theory[0, 0]), model, vv - hh))
        theory_db, model_db, table_db = np.mean(apart, axis=0)
        assert abs(model_db - theory_db) < 0.1
        assert theory_db - table_db > 1.5
