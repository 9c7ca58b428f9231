"""Calibration of the tests that name a term, and the verdicts on synthetic curves."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import AZIMUTH, curve, field

from warpsar.curves.noise import fit
from warpsar.curves.observed import independent
from warpsar.curves.search import search

DRAWS = 80
CASES = (("VV", 5e9, "train"), ("HH", 5e9, "train"), ("VV", 7e9, "test"), ("HH", 7e9, "test"))


def curves(seed: int, shown: list[str], edges: float = 0.3) -> list:
    rng = np.random.default_rng(seed)
    found = []
    for pol, frequency, role in CASES:
        terms = {"single": 1.0 * field(rng, frequency), "edges": edges * field(rng, frequency)}
        found.append(curve(rng, terms, shown, frequency_hz=frequency, polarization=pol, role=role))
    return found


def test_independent_directions_are_those_of_the_bandwidth() -> None:
    """Power of a field from a width D decorrelates over lambda / 2D: the variance of a mean tells the count."""
    rng = np.random.default_rng(0)
    means = [np.mean(np.abs(field(rng, 5e9, 120)) ** 2) for _ in range(400)]
    rng = np.random.default_rng(0)
    one = curve(rng, {"single": field(rng, 5e9)}, ["single"])
    assert 1.0 / np.var(means) == pytest.approx(independent([one]), rel=0.25)  # 400 draws: 7 %, and the two ends


@pytest.mark.slow
def test_p_values_of_a_term_that_is_not_there_are_calibrated() -> None:
    """Under the null the statistic is chi-square with one degree of freedom, though neighbours are correlated."""
    statistic = []
    for seed in range(DRAWS):
        some = curves(seed, ["single"])[:2]
        without, free = fit(some, ["single"]), fit(some, ["single"], "edges")
        statistic.append(2.0 * (free.log_likelihood - without.log_likelihood))
    alarms = np.mean(np.array(statistic) > 3.84)
    assert alarms < 0.05 + 3 * np.sqrt(0.05 * 0.95 / DRAWS)
    assert 0.5 < np.mean(statistic) < 1.5  # 1 by theory; 80 draws: +-0.16


@pytest.mark.full
@pytest.mark.parametrize("seed", range(3))
def test_a_term_that_is_there_is_added_with_its_factor(seed: int) -> None:
    found = search(curves(seed, ["single", "edges"]))
    assert found.verdict == ("edge_diffraction",)
    (asked,) = [one for one in found.asked if one.effect == "edge_diffraction"]
    assert asked.factor == pytest.approx(1.0, abs=0.25)  # 60 independent directions at 20 dB


@pytest.mark.parametrize("seed", range(3))
def test_a_term_that_is_not_there_is_refused(seed: int) -> None:
    found = search(curves(seed, ["single"]))
    assert found.verdict == ()
    assert {one.effect: one.outcome for one in found.asked} == {
        "edge_diffraction": "refused",
        "multibounce": "not testable",
    }


def test_a_term_whose_phase_is_wrong_tells_the_level_alone() -> None:
    """What comes back is as strong as the term, and another: the level is right, the pattern is not."""
    rng = np.random.default_rng(8)
    found = []
    for pol, frequency, role in CASES:
        terms = {"single": 0.1 * field(rng, frequency), "multibounce": field(rng, frequency)}
        terms["truth"] = field(rng, frequency)
        found.append(curve(rng, terms, ["truth"], frequency_hz=frequency, polarization=pol, role=role))
    done = search(found)
    assert done.verdict == ()
    assert done.level_only == ("multibounce",)


def test_thinning_keeps_the_number_of_independent_directions() -> None:
    rng = np.random.default_rng(2)
    thin = curve(rng, {"single": field(rng, 5e9)}, ["single"])
    assert len(thin.azimuth_deg) < len(AZIMUTH)
    assert independent([thin]) == pytest.approx(120.0 / thin.step_deg, rel=0.1)
