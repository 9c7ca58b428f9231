"""Apertures are found in meshes, and the directions that see them."""

from __future__ import annotations

import numpy as np
import pytest

import warpsar
from warpsar.curves.angles import independent_deg, weights, width_m
from warpsar.curves.sectors import apertures, sectors

pytestmark = pytest.mark.unit


def box(faces: int) -> warpsar.Mesh:
    """A cube of 1 m without some of its six sides, the first of which is the one to +X."""
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    sides = [(4, 6, 7, 5), (0, 1, 3, 2), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)][6 - faces :]
    return warpsar.Mesh.of(corners, np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]))


def test_a_closed_body_has_no_aperture_and_is_all_away() -> None:
    assert len(apertures(box(6))) == 0
    found = sectors(apertures(box(6)), np.arange(0.0, 360.0, 10.0), np.full(36, 90.0))
    assert found["away"].all()
    assert not found["aperture"].any()


def test_an_open_side_is_seen_from_its_own_half() -> None:
    normals = apertures(box(5))
    np.testing.assert_allclose(normals, [[1.0, 0.0, 0.0]], atol=1e-6)
    phi = np.arange(0.0, 181.0, 15.0)
    found = sectors(normals, 90.0 - phi, np.full(len(phi), 90.0))
    assert phi[found["aperture"]].tolist() == [0.0, 15.0, 30.0, 45.0, 60.0]
    assert phi[found["away"]].tolist() == [90.0, 105.0, 120.0, 135.0, 150.0, 165.0, 180.0]


def test_a_flat_sheet_has_no_aperture() -> None:
    sheet = warpsar.Mesh.of(np.array([[0.0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]]), np.array([[0, 1, 2], [0, 2, 3]]))
    assert apertures(sheet).shape == (0, 3)


def test_width_and_weights() -> None:
    azimuth = np.arange(0.0, 90.0)
    assert width_m(box(6), azimuth, np.full(90, 90.0)) == pytest.approx(np.sqrt(2.0), abs=1e-3)
    assert independent_deg(0.5, 299792458.0) == pytest.approx(np.rad2deg(1.0))
    np.testing.assert_allclose(weights(azimuth, 5.0).sum(), 90.0 / 5.0)
    np.testing.assert_allclose(weights(np.array([3.0, 1.0, 2.0]), 0.5), 1.0)
