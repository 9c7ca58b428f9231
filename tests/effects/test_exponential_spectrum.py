"""The mixture of two spectra in closed form."""

import numpy as np
import pytest
import worlds
from effect_worlds import ROUNDING, Case, hits_of, plane

pytestmark = pytest.mark.unit

WORKING = [Case({"weight": 0.4})]


def test_exponential_spectrum_is_a_mixture() -> None:
    _, without, with_it = hits_of(plane(), "exponential_spectrum", {"weight": 0.3})
    kl2 = (2 * worlds.WAVENUMBER * 0.010 * np.sin(np.deg2rad(40.0))) ** 2
    ratio = (2 * (1 + kl2) ** -1.5) / np.exp(-kl2 / 4)  # W_exp / W_gauss, physics.md section 0
    assert with_it / without == pytest.approx(0.7 + 0.3 * ratio, rel=ROUNDING)
