"""The interval of a whole value: Rice's distribution by its samples, and a ball by Mie's series."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import FREQUENCY, WAVELENGTH, plate, scene

from warpsar.coherent.interval import OF_DUCTS, OF_EDGES, OF_WAVELENGTH, ends_m2, error_m2
from warpsar.coherent.rcs import rcs


@pytest.mark.parametrize("power", [1.0, 100.0, 1e6])
def test_the_ends_hold_95_percent_of_samples(power: float) -> None:
    """An amplitude and complex Gaussian noise of mean power 1; 40,000 draws tell a share of 0.025 to 0.0008."""
    rng = np.random.default_rng(5)
    noise = (rng.normal(size=40_000) + 1j * rng.normal(size=40_000)) / np.sqrt(2.0)
    drawn = np.abs(np.sqrt(power) + noise) ** 2
    low, high = ends_m2(np.array(power), np.array(1.0))
    assert np.mean(drawn < low) == pytest.approx(0.025, abs=0.004)
    assert np.mean(drawn > high) == pytest.approx(0.025, abs=0.004)


def test_the_low_end_takes_the_error_as_small_as_the_value() -> None:
    """Of power alone the 2.5 % point is -ln(0.975) s: nothing computed, and s / 10."""
    low, high = ends_m2(np.array([0.0, 0.3]), np.array([1.0, 1.0]))
    assert [low[0], high[0]] == pytest.approx([-0.1 * np.log(0.975), -np.log(0.025)])
    assert low[1] == pytest.approx(ends_m2(np.array(0.3), np.array(0.3))[0])


def test_the_error_is_of_the_order_of_a_wavelength_and_a_share_of_edges_and_ducts() -> None:
    assert error_m2(0.03, 0.0, 0.0, np.nan) == pytest.approx((OF_WAVELENGTH * 0.03) ** 2)
    assert error_m2(0.0, 5.0, 0.0, np.nan) == pytest.approx(5.0 * OF_EDGES)
    # rays in a duct: as good as chance below the Fresnel number d, a share of d / F above it
    found = [float(error_m2(0.0, 0.0, 1.0, number)) for number in (0.5 * OF_DUCTS, 10.0 * OF_DUCTS)]
    assert found == pytest.approx([1.0, 0.1])


def test_a_value_has_its_interval_and_others_have_none() -> None:
    metal = rcs(scene(plate(5 * WAVELENGTH, 7 * WAVELENGTH)), [90.0, 60.0], 90.0, FREQUENCY, device="cpu")
    low, high = metal.interval_dbsm
    same = [0, 3]
    assert (low[..., same] < metal.rcs_dbsm[..., same]).all()
    assert (metal.rcs_dbsm[..., same] < high[..., same]).all()
    assert np.isnan(low[..., 1:3]).all()
    widths = (high - low)[:, 0, 0, 0]
    assert widths[0] < 1.0 < widths[1]  # the mirror direction is known better than what lies 30 degrees beside it
    bare = scene(plate(WAVELENGTH, WAVELENGTH), terms=("single",))
    slab = scene(plate(WAVELENGTH, WAVELENGTH), material={"eps_r": 3.0, "thickness_m": 0.001, "rms_height_m": 0.0})
    for one in (bare, slab):
        assert np.isnan(rcs(one, 90.0, 90.0, FREQUENCY, device="cpu").model_error_m).all()
