"""Amplitudes of plates, corners, a sphere, a cylinder, a cone and a duct against their closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from bodies import (
    ALL,
    DIAGONAL,
    WAVELENGTH,
    K,
    amplitudes,
    cross_section,
    decibels,
    dihedral,
    plate,
    rectangles,
    scene,
    square_trihedral,
    triangular_trihedral,
)

import warpsar

PO = {"terms": ("single", "multibounce")}


def test_plate_at_normal_incidence_and_its_pattern() -> None:
    """4 pi A^2 / lambda^2, and sinc (k a sin) cos: the phase integral over a polygon is exact."""
    a, b = 5 * WAVELENGTH, 7 * WAVELENGTH
    turned = np.array([0.0, 3.0, 17.0, 44.0, 80.0])
    found = amplitudes(plate(a, b), 90.0 - turned, 90.0, terms=("single",))[:, 0]
    angle = np.deg2rad(turned)
    x = K * a * np.sin(angle)
    expected = -1j * K / (2 * np.pi) * a * b * np.cos(angle) * np.sinc(x / np.pi)
    for name in ("HH", "VV"):
        assert found[:, ALL.index(name)] == pytest.approx(expected, abs=1e-12)
    assert np.abs(found[:, [1, 2]]).max() < 1e-12
    assert decibels(cross_section(found[0, 0])) == pytest.approx(decibels(4 * np.pi * (a * b / WAVELENGTH) ** 2))


def test_the_phase_is_that_of_the_way_there_and_back() -> None:
    """A plate 3 m nearer to the radar: e^{+2jk 3 m}, at the reference point zero."""
    near = plate(0.1, 0.1)
    moved = warpsar.Mesh.of(near.vertices + np.array([3.0, 0.0, 0.0]), near.faces)
    one, other = (amplitudes(mesh, 90.0, 90.0, terms=("single",))[0, 0, 0] for mesh in (near, moved))
    assert other / one == pytest.approx(np.exp(2j * K * 3.0), abs=1e-9)
    shifted = amplitudes(moved, 90.0, 90.0, terms=("single",), reference=(3.0, 0.0, 0.0))[0, 0, 0]
    assert shifted == pytest.approx(one, abs=1e-12)


@pytest.mark.parametrize("distance_m", [10.0, 1e3, 1e5])
def test_the_phase_of_a_small_target_against_its_range(distance_m: float) -> None:
    """To 1e-5 degrees in float64. In float32 a way of 1e5 m is known to 8 mm: half a wavelength."""
    corner = plate(0.01, 0.01)
    position = np.array([distance_m, 0.0, 0.0])
    moved = warpsar.Mesh.of(corner.vertices + position, corner.faces)
    steps = np.array([0.0, 1e-3, 7e-3])
    found = [amplitudes(moved, 90.0, 90.0, terms=("single",), reference=(-d, 0.0, 0.0))[0, 0, 0] for d in steps]
    # The closed form with the distances as float64 holds them.
    expected = np.exp(2j * K * ((moved.vertices[:, 0].mean() + steps) - (moved.vertices[:, 0].mean() + steps[0])))
    error = np.rad2deg(np.angle(np.array(found) / found[0] / expected))
    assert np.abs(error).max() < max(1e-5, 4 * np.rad2deg(2 * K * np.spacing(distance_m)))


def test_dihedral() -> None:
    """8 pi a^2 b^2 / lambda^2 by two bounces; it turns the polarization: S_HH = -S_VV."""
    a, b = 10 * WAVELENGTH, 8 * WAVELENGTH
    found = amplitudes(dihedral(a, b), 45.0, 90.0, terms=("multibounce",))[0, 0]
    expected = decibels(8 * np.pi * (a * b / WAVELENGTH) ** 2)
    assert decibels(cross_section(found[[0, 3]])) == pytest.approx(expected, abs=0.02)
    assert found[0] == pytest.approx(-found[3], rel=1e-9)
    whole = amplitudes(dihedral(a, b), 45.0, 90.0, **PO)[0, 0]
    assert decibels(cross_section(whole[[0, 3]])) == pytest.approx(expected, abs=0.25)  # both plates' own sidelobes


@pytest.mark.parametrize(
    ("make", "factor", "finer", "allowed"),
    [
        (square_trihedral, 12 * np.pi, 10, 0.10),
        (square_trihedral, 12 * np.pi, 40, 0.04),
        (triangular_trihedral, 4 * np.pi / 3, 10, 0.17),
        (triangular_trihedral, 4 * np.pi / 3, 40, 0.17),
    ],
)
def test_trihedral(make, factor: float, finer: int, allowed: float) -> None:
    """12 pi a^4 / lambda^2 and 4 pi a^4 / (3 lambda^2); one and two bounces add to the triangle's border."""
    a = 10 * WAVELENGTH
    found = amplitudes(make(a), 45.0, DIAGONAL, finer=finer, **PO)[0, 0]
    expected = decibels(factor * a**4 / WAVELENGTH**2)
    assert decibels(cross_section(found[[0, 3]])) == pytest.approx(expected, abs=allowed)
    assert np.abs(found[[1, 2]]).max() < 0.05 * np.abs(found[0])


@pytest.mark.parametrize("off_deg", [-10.0, 10.0])
def test_square_trihedral_off_its_axis(off_deg: float) -> None:
    """Its equivalent area with the cosines l <= m <= n: a^2 l (4 - n / m) where m >= n / 2, else 4 a^2 l m / n.

    Spencer, Optical theory of the corner reflector (MIT Radiation Laboratory report 433, 1944).
    """
    a = 20 * WAVELENGTH
    incidence = DIAGONAL + off_deg
    tilt = np.deg2rad(incidence)
    low, middle, high = np.sort([np.sin(tilt) * np.sqrt(0.5), np.sin(tilt) * np.sqrt(0.5), np.cos(tilt)])
    area = a**2 * (low * (4 - high / middle) if middle >= high / 2 else 4 * low * middle / high)
    found = amplitudes(square_trihedral(a), 45.0, incidence, terms=("multibounce",))[0, 0]
    # The form is that of optics, without the plates' sidelobes: they are 25 dB down for 20 wavelengths.
    assert decibels(cross_section(found[0])) == pytest.approx(decibels(4 * np.pi * area**2 / WAVELENGTH**2), abs=0.4)


def test_sphere() -> None:
    """Physical optics: A = -jk INT_0^a z e^{2jkz} dz.

    The border of light alone gives 1 / (2 ka) of it, 0.07 dB; cells of a twentieth of a wavelength leave it uncertain.
    """
    radius = 10 * WAVELENGTH
    ball = trimesh.creation.icosphere(6, radius=radius)
    found = amplitudes(warpsar.Mesh.of(ball), 20.0, 70.0, finer=20.0)[0, 0]
    x = 2j * K
    closed = -1j * K * (radius * np.exp(x * radius) / x - (np.exp(x * radius) - 1) / x**2)
    assert decibels(cross_section(found[[0, 3]])) == pytest.approx(decibels(cross_section(closed)), abs=0.03)
    assert decibels(cross_section(closed)) == pytest.approx(decibels(np.pi * radius**2), abs=0.02)
    assert np.abs(np.angle(found[0] / closed)) < 0.05


def test_cylinder_from_its_side() -> None:
    """k a L^2: stationary phase, in ka to a part in 8 ka."""
    radius, length = 8 * WAVELENGTH, 10 * WAVELENGTH
    tube = trimesh.creation.cylinder(radius=radius, height=length, sections=720)
    found = amplitudes(warpsar.Mesh.of(tube), 33.0, 90.0, finer=20.0, **PO)[0, 0]
    assert decibels(cross_section(found[[0, 3]])) == pytest.approx(decibels(K * radius * length**2), abs=0.15)


def test_cone_from_its_tip() -> None:
    """Physical optics over a cone of half angle t: -jk tan^2 t INT_0^h z e^{-2jkz} dz about its tip."""
    height, slope = 8 * WAVELENGTH, np.tan(np.deg2rad(30.0))
    cone = trimesh.creation.cone(radius=height * slope, height=height, sections=360)
    mesh = warpsar.Mesh.of(cone.vertices, cone.faces)
    found = amplitudes(mesh, 0.0, 0.0, finer=30.0, reference=(0.0, 0.0, height), **PO)[0, 0]
    x = -2j * K
    closed = -1j * K * slope**2 * (height * np.exp(x * height) / x - (np.exp(x * height) - 1) / x**2)
    assert decibels(cross_section(found[[0, 3]])) == pytest.approx(decibels(cross_section(closed)), abs=0.2)


def _modes(width: float, height: float, depth: float, angle: np.ndarray) -> np.ndarray:
    """A of a rectangular duct open to +X, shorted at its end, by its TE_m0 modes; E along z, width along y.

    Each mode takes of the plane wave over the aperture what its E and H ask for, comes back from the short, and
    radiates from the aperture. Phase zero in the middle of the aperture.
    """
    sine, cosine = np.sin(angle), np.cos(angle)
    total = np.zeros(angle.shape, complex)
    for m in range(1, int(2 * width / WAVELENGTH) + 1):
        kx = m * np.pi / width
        beta = np.sqrt(complex(K**2 - kx**2))
        y = (np.arange(4000) + 0.5) / 4000 * width
        overlap = (np.sin(kx * y) * np.exp(1j * K * sine[:, None] * (y - width / 2))).mean(axis=1) * width
        into = 2.0 / width * overlap * (K * cosine + beta) / (2 * beta)
        out = -into * np.exp(-2j * beta * depth)
        total += 1j * K / (4 * np.pi) * height * (beta / K + cosine) * out * overlap
    return total


def test_straight_duct_against_its_modes() -> None:
    """20 wavelengths wide and deep: coherence 0.997 and a phase of -0.02 rad by an independent program."""
    width, depth = 20.3 * WAVELENGTH, 20 * WAVELENGTH  # at 20 the last mode would be at its cutoff
    height = 2 * WAVELENGTH
    y, z = width / 2, height / 2
    back = [[-depth, -y, -z], [-depth, y, -z], [-depth, y, z], [-depth, -y, z]]
    left = [[-depth, -y, -z], [0, -y, -z], [0, -y, z], [-depth, -y, z]]
    right = [[-depth, y, -z], [0, y, -z], [0, y, z], [-depth, y, z]]
    floor = [[-depth, -y, -z], [0, -y, -z], [0, y, -z], [-depth, y, -z]]
    roof = [[-depth, -y, z], [0, -y, z], [0, y, z], [-depth, y, z]]
    turned = np.linspace(5.0, 55.0, 41)
    found = amplitudes(rectangles(back, left, right, floor, roof), 90.0 - turned, 90.0, **PO)[:, 0, 3]
    outside = amplitudes(rectangles(right), 90.0 - turned, 90.0, **PO)[:, 0, 3]  # of the wall next to the radar
    inside = found - outside
    modes = _modes(width, height, depth, np.deg2rad(turned))
    coherent = np.vdot(modes, inside) / np.linalg.norm(modes) / np.linalg.norm(inside)
    assert abs(coherent) > 0.99
    assert abs(np.angle(coherent)) < 0.05
    assert np.abs(decibels(cross_section(inside)) - decibels(cross_section(modes))).mean() < 1.5


def test_errors_fall_with_the_ray_spacing() -> None:
    """A corner off its axis: first order, as the border of its aperture lies somewhere in a cell."""
    mesh = triangular_trihedral(6 * WAVELENGTH)
    found = {n: amplitudes(mesh, [40.0, 47.0, 51.0], 50.0, finer=n, **PO)[:, 0, 0] for n in (4, 10, 25, 64)}
    error = [np.linalg.norm(found[n] - found[64]) for n in (4, 10, 25)]
    assert error[0] > 1.5 * error[1] > 1.5 * 1.2 * error[2]


def test_monostatic_reciprocity() -> None:
    """HV = VH, of a dihedral turned by 30 degrees about the line of sight."""
    a = 8 * WAVELENGTH
    mesh = dihedral(a, a)
    turn = trimesh.transformations.rotation_matrix(np.deg2rad(30.0), [1.0, 1.0, 0.0])[:3, :3]
    found = amplitudes(warpsar.Mesh.of(mesh.vertices @ turn.T, mesh.faces), [42.0, 45.0, 49.0], 90.0, finer=20.0)[:, 0]
    assert np.abs(found[:, 1]).min() > 0.2 * np.abs(found).max(axis=1).min()
    assert np.abs(found[:, 1] - found[:, 2]).max() < 0.03 * np.abs(found).max()


@pytest.mark.parametrize(
    "material",
    [
        {"eps_r": (4.0, -1.0), "rms_height_m": 0.0},
        {"eps_r": (4.0, -1.0), "rms_height_m": 0.0, "thickness_m": 0.004},
        {"eps_r": (5.0, -1.0), "rms_height_m": 0.001, "correlation_length_m": 0.01},
    ],
)
def test_monostatic_reciprocity_of_materials(material) -> None:
    """HV = VH of each face and scatterer by itself. Tubes with several hits hold it to a few percent of the largest
    amplitude: the currents of the last hit are those of its own angle, not of the way back."""
    found = warpsar.rcs(
        scene(square_trihedral(6 * WAVELENGTH), material=material),
        [20.0, 33.0, 60.0], [40.0, 70.0], device="cpu", rays_per_wavelength=20.0,
    )  # fmt: skip
    for term, allowed in (("single", 1e-12), ("edges", 1e-12), ("rough", 1e-12), ("multibounce", 0.07)):
        difference = np.abs(found.terms_m[term][..., 1] - found.terms_m[term][..., 2]).max()
        assert difference <= allowed * np.abs(found.terms_m["multibounce"]).max(), term


@pytest.mark.parametrize(("make", "incidence", "bounces"), [(dihedral, 90.0, 2), (square_trihedral, DIAGONAL, 3)])
def test_each_number_of_bounces_by_itself(make, incidence: float, bounces: int) -> None:
    """On its axis a dihedral returns what has met two faces, a trihedral what has met three."""
    sides = (10 * WAVELENGTH, 8 * WAVELENGTH)[: 2 if make is dihedral else 1]
    found = warpsar.rcs(scene(make(*sides)), [45.0, 52.0], incidence, device="cpu", layers=True)
    assert sum(found.bounces_m.values()) == pytest.approx(found.terms_m["multibounce"], abs=1e-12)
    whole = np.abs(found.terms_m["multibounce"][0, 0, 0, [0, 3]])
    assert np.abs(found.bounces_m[bounces][0, 0, 0, [0, 3]]) == pytest.approx(whole, rel=0.02)
    alone = warpsar.rcs(scene(make(*sides)), [45.0, 52.0], incidence, device="cpu")
    assert np.array_equal(alone.terms_m["single"], found.terms_m["single"])
    assert alone.bounces_m == {}


def test_terms_add_up_and_are_chosen() -> None:
    mesh = dihedral(0.2, 0.2)
    found = warpsar.rcs(scene(mesh), [30.0, 45.0], 80.0, device="cpu")
    assert sum(found.terms_m.values()) == pytest.approx(found.amplitude_m)
    alone = warpsar.rcs(scene(mesh, terms=("edges",)), [30.0, 45.0], 80.0, device="cpu")
    assert list(alone.terms_m) == ["edges"]
    assert alone.amplitude_m == pytest.approx(found.terms_m["edges"])
