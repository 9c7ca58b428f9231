"""95 % intervals by the profile of the likelihood: on a valley that is bent by construction, and on a scene."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from warpsar.learning import profiles
from warpsar.learning.identify import Identified, of_information


class Valley:
    """-ln L = (x0 - bend x1^2)^2 / 2 s^2 + x1^2 / 2: along the valley x0 = bend x1^2, x1 is a standard normal."""

    def __init__(self, bend: float, bounds: float = 50.0) -> None:
        self.bend, self.bounds = bend, (np.full(2, -bounds), np.full(2, bounds))

    def modelled(self, x: np.ndarray) -> list[np.ndarray]:
        return [x]

    def value(self, modelled: list[np.ndarray]) -> float:
        x = modelled[0]
        return float((x[0] - self.bend * x[1] ** 2) ** 2 / (2.0 * 0.1**2) + x[1] ** 2 / 2.0)

    def penalty(self, x: np.ndarray) -> float:
        return 0.0

    def identified(self) -> Identified:
        information = np.diag([1.0 / 0.1**2, 1.0])
        return of_information(["soil.a", "soil.b"], information, information)


def descended(problem: Any, state: Any, moving: np.ndarray, *, flat: float) -> Any:
    """The minimum along the one element that moves, by a search of its whole range."""
    places = np.linspace(-6.0, 6.0, 40001)
    at = int(np.flatnonzero(moving)[0])
    x = np.tile(np.asarray(state.x, float), (places.size, 1))
    x[:, at] = places
    losses = (x[:, 0] - problem.bend * x[:, 1] ** 2) ** 2 / (2.0 * 0.1**2) + x[:, 1] ** 2 / 2.0
    best = int(losses.argmin())
    return SimpleNamespace(best_x=x[best], best_loss=float(losses[best]), arrived=True)


@pytest.fixture
def by_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(profiles, "levenberg_marquardt", descended)


def test_a_straight_valley_has_the_ends_of_its_standard_deviations(by_search: None) -> None:
    problem: Any = Valley(0.0)
    ends = profiles.with_profiles(problem, np.zeros(2), problem.identified()).ends
    assert_allclose(ends, [[-0.196, 0.196], [-1.96, 1.96]], rtol=1e-6)


def test_a_bent_valley_has_the_ends_of_its_profile(by_search: None) -> None:
    """At x0 above 0 the likeliest x1 has bend x1^2 = x0 - s^2 / 2 bend, where -ln L is x0 / 2 bend - s^2 / 8 bend^2."""
    problem: Any = Valley(1.0)
    ends = profiles.with_profiles(problem, np.zeros(2), problem.identified()).ends
    assert ends is not None
    assert ends[0, 0] == pytest.approx(-0.196, rel=0.06)  # an end is found within 5 % of the root
    assert ends[0, 1] == pytest.approx(1.96**2 + 0.1**2 / 4.0, rel=0.12)  # where a root of 5 % is 10 %
    assert_allclose(ends[1], [-1.96, 1.96], rtol=0.06)


def test_an_end_that_no_value_within_the_bounds_refuses_is_open(by_search: None) -> None:
    problem: Any = Valley(1.0, bounds=1.0)
    ends = profiles.with_profiles(problem, np.zeros(2), problem.identified()).ends
    assert ends is not None
    assert ends[0, 1] == np.inf
    assert np.isneginf(ends[1, 0])
    assert ends[0, 0] == pytest.approx(-0.196, rel=0.06)


def test_an_end_is_no_nearer_than_standard_deviations_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit that ends at its start takes a straight step along a bent valley for refused: the interval of standard
    deviations stands. Where these are infinite, both ends are open."""
    monkeypatch.setattr(
        profiles,
        "levenberg_marquardt",
        lambda problem, state, moving, *, flat: SimpleNamespace(
            best_x=np.asarray(state.x), best_loss=problem.value([np.asarray(state.x)]), arrived=True
        ),
    )
    problem: Any = Valley(1.0)
    known = problem.identified()
    ends = profiles.with_profiles(problem, np.zeros(2), known).ends
    assert_allclose(ends, [[-0.196, 0.196], [-1.96, 1.96]], rtol=1e-6)
    silent = np.diag([0.0, 1.0])
    unknown = of_information(["soil.a", "soil.b"], silent, silent)
    ends = profiles.with_profiles(problem, np.zeros(2), unknown).ends
    assert ends is not None
    assert_allclose(ends[0], [-np.inf, np.inf])
    assert_allclose(ends[1], [-1.96, 1.96], rtol=1e-6)


def test_correlated_speckle_widens_the_interval(by_search: None) -> None:
    """Four times the variance of the score: both ends lie twice as far away."""
    problem: Any = Valley(0.0)
    information = np.diag([1.0 / 0.1**2, 1.0])
    told = of_information(["soil.a", "soil.b"], information, 4.0 * information)
    ends = profiles.with_profiles(problem, np.zeros(2), told).ends
    assert_allclose(ends, [[-0.392, 0.392], [-3.92, 3.92]], rtol=1e-6)
