"""The lattice of dipoles of benchmarks/rcs_dipoles.py against Mie's series."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from test_transmission import mie

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
import rcs_dipoles as dipoles


@pytest.mark.parametrize(("eps", "size"), [(2.5 + 0.08j, 1.0), (2.5 + 0.08j, 2.0), (4.0 + 0.0j, 0.5)])
def test_a_dielectric_ball_is_that_of_mie(eps: complex, size: float) -> None:
    """`size` is ka; 13 cubes to the radius. 4 % of RCS: the steps of the surface, which fall as one over the cubes."""
    count = 13
    axis = np.arange(2 * count) - count + 0.5
    inside = sum(each**2 for each in np.meshgrid(axis, axis, axis)) <= count**2
    step = (4 * np.pi / 3 / inside.sum()) ** (1 / 3)  # the volume of the unit ball
    made = dipoles.Lattice(inside, step, size, eps)
    expected = np.pi * mie(size, np.sqrt(eps)) ** 2
    for to_radar, pol in (((1, 0, 0), (0, 1, 0)), ((0.6, 0.8, 0), (0, 0, 1))):
        assert made.rcs_m2(np.array(to_radar, float), np.array(pol, float)) == pytest.approx(expected, rel=0.04)
