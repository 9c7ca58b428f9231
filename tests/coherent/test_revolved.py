"""The method of moments of benchmarks/rcs_revolved.py against Mie's series."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
import rcs_revolved as revolved


def test_a_sphere_off_its_axis_is_that_of_mie() -> None:
    """ka 5, 12 pieces a wavelength, both polarizations, all modes; 1 % of amplitude, most of it the polygon."""
    size = 5.0
    points = revolved.pieces(revolved.sphere(1.0, 30), 9.0)
    found = revolved.amplitudes(points, size, np.array([0.0, 50.0]))
    assert found == pytest.approx(np.full((2, 2), revolved.mie(size) / 2.0), rel=1e-2)
