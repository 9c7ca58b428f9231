"""Trihedrals by geometric optics: known values, an independent projection, and the engine."""

from __future__ import annotations

import numpy as np
import pytest

from warpsar.calibration.attitude import Facing, Shape, effective_area_m2, trihedral_rcs_m2
from warpsar.calibration.engine import engine_rcs_m2
from warpsar.world.frame import SPEED_OF_LIGHT

pytestmark = pytest.mark.unit
WAVELENGTH = 0.0555


def look(azimuth_deg: float, incidence_deg: float) -> np.ndarray:
    a, i = np.deg2rad([azimuth_deg, incidence_deg])
    return np.array([np.sin(a) * np.sin(i), np.cos(a) * np.sin(i), np.cos(i)])


def shared_area(shape: Shape, cosines: np.ndarray) -> float:
    """Area that the aperture of leg 1, seen along `cosines`, shares with its inversion: of polygons."""
    shapely = pytest.importorskip("shapely", reason="needs the extra geo")
    n = cosines / np.linalg.norm(cosines)
    u = np.cross(n, [0.0, 0.0, 1.0] if abs(n[2]) < 0.9 else [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    across = np.stack([u, np.cross(n, u)], axis=1)  # to the plane through the corner
    plates = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        a, b = np.eye(3)[[a, b]]
        outline = [0 * a, a, b] if shape == "triangular" else [0 * a, a, a + b, b]
        plates.append(shapely.Polygon(np.array(outline) @ across))
    seen = shapely.union_all(plates)
    return float(seen.intersection(shapely.transform(seen, np.negative)).area)


@pytest.mark.parametrize(("shape", "factor"), [("triangular", 4 * np.pi / 3), ("square", 12 * np.pi)])
def test_on_boresight(shape: Shape, factor: float) -> None:
    """4 pi a^4 / (3 lambda^2), and 12 pi a^4 / lambda^2."""
    facing = Facing(123.0, 7.0)
    found = trihedral_rcs_m2(shape, 1.2, facing, facing.boresight(), WAVELENGTH)
    assert found == pytest.approx(factor * 1.2**4 / WAVELENGTH**2, rel=1e-12)


@pytest.mark.parametrize("shape", ["triangular", "square"])
def test_off_boresight_it_is_what_the_aperture_shares_with_its_inversion(shape: Shape) -> None:
    """20 attitudes, both branches of either formula, beside polygons."""
    cosines = np.abs(np.random.default_rng(2).normal(size=(20, 3)))
    cosines /= np.linalg.norm(cosines, axis=1, keepdims=True)
    low, middle, high = np.sort(cosines, axis=1).T
    assert 3 < (low + middle < high).sum() < 17 or shape == "square"
    assert 3 < (middle < high / 2).sum() < 17 or shape == "triangular"
    found = effective_area_m2(shape, 1.0, cosines)
    expected = [shared_area(shape, each) for each in cosines]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_it_sends_nothing_back_from_behind() -> None:
    facing = Facing(90.0)
    assert trihedral_rcs_m2("square", 1.0, facing, look(270.0, 40.0), WAVELENGTH) == 0.0


@pytest.mark.parametrize(("facing", "incidence"), [(Facing(100.0), 54.7356), (Facing(100.0, 5.0), 49.7356)])
def test_boresight_of_an_upright_one(facing: Facing, incidence: float) -> None:
    np.testing.assert_allclose(facing.boresight(), look(100.0, incidence), atol=1e-6)


def test_boresight_of_a_flipped_one() -> None:
    np.testing.assert_allclose(Facing(100.0, 2.0, True).boresight(), look(100.0, 33.2644), atol=1e-6)


@pytest.mark.parametrize(
    ("azimuth", "elevation", "legs"),
    [
        # ISCE3's test_cr_to_enu: azimuth from east, x, y and z in east, north, up.
        (0.0, 0.0, [[np.sqrt(0.5), -np.sqrt(0.5), 0], [np.sqrt(0.5), np.sqrt(0.5), 0], [0, 0, 1]]),
        (45.0, 0.0, [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        (0.0, 90.0, [[0, -np.sqrt(0.5), np.sqrt(0.5)], [0, np.sqrt(0.5), np.sqrt(0.5)], [-1, 0, 0]]),
        (270.0, 45.0, [[np.sqrt(0.5), 0.5, 0.5], [-np.sqrt(0.5), 0.5, 0.5], [0, -np.sqrt(0.5), np.sqrt(0.5)]]),
    ],
)
def test_legs_are_those_of_isce3(azimuth: float, elevation: float, legs: list[list[float]]) -> None:
    """ISCE3 counts azimuth from east; its published test values of four attitudes."""
    np.testing.assert_allclose(Facing(azimuth + 90.0, elevation).legs(), legs, atol=1e-12)


@pytest.mark.full
@pytest.mark.parametrize("shape", ["triangular", "square"])
def test_the_engine_agrees(shape: Shape) -> None:
    """Legs of 20 wavelengths, up to 15 degrees off boresight: edges and single bounces change some tenths of a dB."""
    leg, facing = 20 * WAVELENGTH, Facing(90.0)
    looks = [(90.0, 54.7), (98.0, 50.0), (85.0, 62.0), (100.0, 47.0)]
    found = engine_rcs_m2(shape, leg, facing, looks, SPEED_OF_LIGHT / WAVELENGTH, "VV", "cpu")
    expected = [float(trihedral_rcs_m2(shape, leg, facing, look(*each), WAVELENGTH)) for each in looks]
    np.testing.assert_allclose(10 * np.log10(found), 10 * np.log10(expected), atol=0.6)
