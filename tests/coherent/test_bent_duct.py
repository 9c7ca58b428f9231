"""Concave walls: a bent duct against its exact modes. Tubes pass caustics there, and must count them."""

from __future__ import annotations

import math

import duct_modes as modes
import numpy as np
import pytest
from bodies import WAVELENGTH, K, amplitudes, rectangles
from numpy.typing import NDArray

import warpsar

WIDTH = 2 * WAVELENGTH
PO = {"terms": ("single", "multibounce")}


def profile(duct, low_m: float) -> NDArray[np.float64]:
    """Points of the lower and the upper wall in the plane of the bend, (2, n, 2) [m], arcs in steps of 0.2 degrees."""
    at, turned, h = np.array([0.0, low_m]), 0.0, duct.height_m
    lower, upper = [at], [at + np.array([0.0, h])]

    def add(point: NDArray[np.float64], angle: float) -> None:
        lower.append(point)
        upper.append(point + h * np.array([-math.sin(angle), math.cos(angle)]))

    for piece in duct.pieces:
        if not piece.radius_m:
            at = at - piece.length * np.array([math.cos(turned), math.sin(turned)])
            add(at, turned)
            continue
        sign = 1.0 if piece.down else -1.0
        up = np.array([-math.sin(turned), math.cos(turned)])
        centre = at - sign * piece.radius_m * up
        for angle in (
            turned + sign * piece.length * np.linspace(0.0, 1.0, math.ceil(math.degrees(piece.length) / 0.2))[1:]
        ):
            at = centre + sign * piece.radius_m * np.array([-math.sin(angle), math.cos(angle)])
            add(at, angle)
        turned += sign * piece.length
    return np.array([lower, upper])


def body(duct, low_m: float, lid: bool) -> warpsar.Mesh:
    """The duct with its bend in the plane z = 0, its mouth at x = 0; with a lid over the mouth."""
    lower, upper = profile(duct, low_m)
    half = duct.width_m / 2

    def at(points: NDArray[np.float64], z: float) -> NDArray[np.float64]:
        return np.column_stack([points, np.full(len(points), z)])

    strips = [(at(lower, -half), at(lower, half)), (at(upper, -half), at(upper, half))]
    strips += [(at(lower, z), at(upper, z)) for z in (-half, half)]
    quads = [[a[i], a[i + 1], b[i + 1], b[i]] for a, b in strips for i in range(len(a) - 1)]
    ends = (0, -1) if lid else (-1,)
    quads += [[strips[0][0][i], strips[0][1][i], strips[1][1][i], strips[1][0][i]] for i in ends]
    return rectangles(*quads)


def lid_sends(duct, low_m: float, phi: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Physical optics of the lid."""
    x = 2.0 * K * np.sin(phi)
    middle = low_m + duct.height_m / 2
    pattern = np.exp(1j * x * middle) * np.sinc(x * duct.height_m / 2 / np.pi)
    return -1j * K / (2 * np.pi) * duct.width_m * duct.height_m * np.cos(phi) * pattern


def bend(scale: float):
    """A bend by 60 degrees, 12.3 wavelengths wide; concave walls of 18.3 wavelengths focus what they reflect."""
    size = scale * WAVELENGTH
    pieces = modes.Piece(size), modes.Piece(math.radians(60.0), 6 * size), modes.Piece(size)
    return modes.Duct(WIDTH, 12.3 * size, pieces)


def double_bend():
    size = 3 * WAVELENGTH
    arcs = [modes.Piece(math.radians(25.0), 20 * size, down=down) for down in (True, False)]
    return modes.Duct(WIDTH, 12.3 * size, (modes.Piece(size), arcs[0], modes.Piece(size), arcs[1], modes.Piece(size)))


def test_the_modes_of_a_straight_duct_are_the_closed_ones() -> None:
    """Every mode comes back with -e^{-2j beta depth}."""
    width, depth = 5.3 * WAVELENGTH, 9 * WAVELENGTH
    rho, beta = modes.reflection(modes.Duct(WIDTH, width, (modes.Piece(depth),)), True, K**2, 14)
    kz = np.arange(1, 15) * np.pi / width
    expected = np.sqrt(np.where(kz < K, 1.0, -1.0) * np.abs(K**2 - kz**2) + 0j)
    assert np.where(beta.imag < 0, -1, 1) * beta == pytest.approx(expected)
    assert rho == pytest.approx(np.diag(-np.exp(-2j * beta * depth)), abs=1e-9)


@pytest.mark.parametrize("electric", [True, False])
def test_a_bend_returns_what_enters(electric: bool) -> None:
    """The flux of a mode goes as beta |a|^2. So the scaled matrix is unitary, and by reciprocity symmetric."""
    rho, beta = modes.reflection(bend(1.0), electric, (0.9 * K) ** 2, 60)
    some = np.flatnonzero(beta.real > 1e-9)
    assert len(some) > 20
    root = np.sqrt(beta[some].real)
    flux = root[:, None] * rho[np.ix_(some, some)] / root
    assert flux @ flux.conj().T == pytest.approx(np.eye(len(some)), abs=1e-6)
    assert flux == pytest.approx(flux.T, abs=1e-6)


@pytest.mark.full
@pytest.mark.parametrize(
    ("make", "coherence"),
    [
        (lambda: bend(1.0), 0.88),
        (lambda: bend(3.0), 0.93),
        pytest.param(double_bend, 0.89, marks=pytest.mark.slow),
    ],
)
def test_a_bent_duct_against_its_modes(make, coherence: float) -> None:
    """Found: 0.903, 0.949, 0.911 for Fresnel numbers of 5, 15, 9: rays hold the better the wider the duct is.

    Without the caustics' e^{j pi / 2} it is 0.73, 0.80, 0.70; with e^{-j pi / 2} 0.82, 0.88, 0.60.
    """
    duct = make()
    low, turned = -duct.height_m / 2, np.linspace(2.0, 50.0, 49)
    phi = np.deg2rad(turned)
    opened, closed = (amplitudes(body(duct, low, lid), 90.0 - turned, 90.0, **PO)[:, 0, 3] for lid in (False, True))
    inside = opened - (closed - lid_sends(duct, low, phi))
    exact = modes.in_bend(duct, phi, K, low)
    overlap = np.vdot(exact, inside) / np.linalg.norm(exact) / np.linalg.norm(inside)
    assert abs(overlap) > coherence
    assert abs(np.angle(overlap)) < 0.25
    assert np.linalg.norm(inside) == pytest.approx(np.linalg.norm(exact), rel=0.15)
