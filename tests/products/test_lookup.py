"""Values between the vectors of an annotation, against a plane."""

from __future__ import annotations

import numpy as np
import pytest

from warpsar.products.lookup import LineTable

pytestmark = pytest.mark.unit


def test_a_plane_comes_back_at_points_and_in_windows() -> None:
    """Vectors at uneven lines and pixels say 3 line + pixel; linear between them, that is everywhere inside."""
    lines = np.array([0.0, 10.0, 40.0])
    pixels = tuple(np.array(each) for each in ([0.0, 60.0, 100.0], [0.0, 100.0], [0.0, 30.0, 31.0, 100.0]))
    table = LineTable(lines, pixels, tuple(3.0 * at + each for at, each in zip(lines, pixels, strict=True)))
    line, pixel = np.arange(-2.0, 44.0)[:, None], np.arange(-5.0, 110.0, 2.5)[None, :]
    expected = 3.0 * np.clip(line, 0.0, 40.0) + np.clip(pixel, 0.0, 100.0)  # the outer values hold beyond
    np.testing.assert_allclose(table.at(line, pixel), expected, rtol=1e-12)
    np.testing.assert_allclose(table.at(*np.broadcast_arrays(line, pixel)), expected, rtol=1e-12)
    np.testing.assert_allclose(table.at(line[:, 0], 20.0), expected[:, 10], rtol=1e-12)


def test_one_vector_holds_for_all_lines() -> None:
    table = LineTable(np.array([7.0]), (np.array([0.0, 10.0]),), (np.array([0.0, 10.0]),))
    np.testing.assert_allclose(table.at(np.arange(3.0)[:, None], np.arange(4.0)[None, :]), [[0.0, 1.0, 2.0, 3.0]] * 3)
