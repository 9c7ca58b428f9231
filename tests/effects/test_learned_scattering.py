"""The learned backscatter law: its shape over incidence, and a fit through the renderer."""

from dataclasses import replace

import numpy as np
import pytest
from effect_worlds import ROUNDING, Case, hits_of, plane, with_effect
from scipy.interpolate import BSpline
from worlds import view

from warpsar import learn, simulate
from warpsar.effects.learned_scattering import ANGLES_DEG, CHANNELS, shape_db

ALL = {f"{c.lower()}_{a}": 0.5 + 0.3 * k for k, (c, a) in enumerate((c, a) for c in CHANNELS for a in ANGLES_DEG)}
WORKING = [Case(ALL)]


def test_learned_scattering_is_a_spline_in_decibels() -> None:
    """Cubic B-splines, 2/3 high by themselves; against SciPy's."""
    table = {"hh_20": 1.0, "hh_40": -2.0, "hh_60": 3.0}
    heights = 1.5 * np.array([0.0, 0.0, 0.0, *table.values(), 0.0, 0.0, 0.0])
    spline = BSpline(np.arange(-80.0, 180.0, 20.0), heights, 3, extrapolate=False)
    angles = np.linspace(0.0, 90.0, 200)
    np.testing.assert_allclose(shape_db(table, "HH", angles), spline(angles), atol=1e-12)
    _, without, with_it = hits_of(plane(), "learned_scattering", table)
    gain = 10 ** (float(spline(40.0)) / 10)
    assert with_it / without == pytest.approx(gain, rel=ROUNDING)
    assert not shape_db(table, "VV", angles).any()


def test_its_heights_are_learned_through_the_renderer() -> None:
    """Three incidences of flat ground, HH and VV: six heights from six levels, with the surface held."""
    views = [view(20.0, angle, name=f"at{angle}") for angle in (25, 40, 55)]
    scene = replace(plane(views=views, polarizations=("HH", "VV")))
    truth = {"hh_20": -2.0, "hh_40": 0.5, "hh_60": 3.0, "vv_20": 1.0, "vv_40": -1.0, "vv_60": 2.0}
    images = {one.name: one.beta0 for one in simulate(with_effect(scene, "learned_scattering", truth), device="cpu")}
    seen = [one.model_copy(update={"images": images[one.name], "looks": 100.0}) for one in views]
    held = {"soil": scene.materials["soil"].model_copy(update={"learn": ()})}
    begun = replace(with_effect(scene, "learned_scattering", dict.fromkeys(truth, 0.1)), views=seen, materials=held)
    found = learn(begun, device="cpu").scene.effects["learned_scattering"]
    for key, value in truth.items():
        assert found[key] == pytest.approx(value, abs=0.02), key
