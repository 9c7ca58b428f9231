"""What a fit made worse is said, image by image."""

import numpy as np
import pytest
from comparisons import comparison

from warpsar.compare.comparison import Comparison
from warpsar.learning.trust import worse

pytestmark = pytest.mark.unit

SHAPE = (40, 40)


def pair(factor: np.ndarray | float, name: str = "v0", role: str = "train") -> tuple[Comparison, Comparison]:
    """An image of 16 looks beside its truth, and beside the truth times a factor."""
    random = np.random.default_rng(3)
    truth = 1.0 + np.add.outer(np.linspace(0.0, 4.0, SHAPE[0]), np.zeros(SHAPE[1]))
    measured = truth * random.gamma(16.0, 1.0 / 16.0, SHAPE)
    one, two = (comparison(measured, model, 16.0, name=name, role=role) for model in (truth, truth * factor))
    return one, two


def test_nothing_is_said_where_nothing_got_worse() -> None:
    one, two = pair(1.0)
    assert worse([one], [two]) == []
    one, two = pair(1.02)  # 2 % of the power: the deviance rises by a hundredth, where a tenth counts
    assert worse([one], [two]) == []


@pytest.mark.parametrize("role", ["train", "test"])
def test_an_image_that_lost_its_likeness_is_named(role: str) -> None:
    """One column a thousand times too bright, as by a material that pays for a few black pixels elsewhere."""
    factor = np.ones(SHAPE)
    factor[:, 10] = 1e3
    good, bad = pair(1.0, "v1", role), pair(factor, "v0", role)
    (said,) = worse([good[0], bad[0]], [good[1], bad[1]])
    assert said.startswith(f"v0 HH ({role}) is farther from the measured image than at the start: ")
    for word in ("deviance", "correlation", "nrmse"):
        assert f"{word} " in said
    assert f"{bad[0].metrics['correlation']:.3f} -> {bad[1].metrics['correlation']:.3f}" in said


def test_what_got_better_is_not_told() -> None:
    worst, best = pair(3.0)[::-1]
    assert worse([worst], [best]) == []
