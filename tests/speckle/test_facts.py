"""Looks and texture from even ground: right by name, with an interval, and nothing where nothing is wrong."""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import polygamma

from warpsar.runtime.distributed.travel import packed, unpacked
from warpsar.speckle.even import even_ground
from warpsar.speckle.facts import Scatter, speckle_fact
from warpsar.speckle.law import Law

EVERYWHERE = np.ones((120, 120), bool)
ROWS, COLS = np.mgrid[:120, :120]


def correlated(random: np.random.Generator, looks: int, sigma: float, side: int) -> np.ndarray:
    """Mean of `looks` intensities of complex Gaussian fields that are blurred by `sigma` pixels."""
    total = np.zeros((side + 20, side + 20))
    for _ in range(2 * looks):
        total += gaussian_filter(random.normal(size=total.shape), sigma, mode="wrap") ** 2
    kernel = gaussian_filter(np.eye(1, total.size).reshape(total.shape), sigma, mode="wrap")
    return total[10:-10, 10:-10] / (2.0 * looks * np.sum(kernel**2))


def area(sigma: float) -> float:
    """Correlation area of intensity, pixels."""
    return float(np.exp(-(np.hypot(*np.mgrid[-8:9, -8:9]) ** 2) / (2.0 * sigma**2)).sum())


# ---- even ground ----


@pytest.mark.parametrize("looks", [1.0, 4.0, 16.0])
def test_cumulants_are_those_of_the_law_and_their_errors_hold(looks: float) -> None:
    random = np.random.default_rng(int(looks))
    away = []
    for _ in range(60):
        found = even_ground(random.standard_gamma(looks, (48, 48)) / looks, EVERYWHERE[:48, :48])
        assert found is not None
        errors = np.sqrt(np.diag(found.covariance))
        away.append((np.array([found.second, found.third]) - [polygamma(1, looks), polygamma(2, looks)]) / errors)
    # of 60 values of unit variance: mean 0 +- 0.13, deviation 1 +- 0.09
    assert np.abs(np.mean(away, axis=0)).max() < 0.5
    assert np.abs(np.std(away, axis=0) - 1.0).max() < 0.35


@pytest.mark.parametrize("sigma", [0.5, 0.7, 1.0, 1.2])
@pytest.mark.parametrize("looks", [1, 4])
def test_correlated_speckle_has_the_same_cumulants(sigma: float, looks: int) -> None:
    random = np.random.default_rng([looks, int(10 * sigma)])
    found = [even_ground(correlated(random, looks, sigma, 120), EVERYWHERE, area(sigma)) for _ in range(8)]
    second = np.mean([one.second for one in found if one is not None])
    third = np.mean([one.third for one in found if one is not None])
    assert second == pytest.approx(polygamma(1, looks), rel=0.04)
    assert third == pytest.approx(polygamma(2, looks), rel=0.2)  # a quarter is what matters (facts.SKEWED)


def test_slopes_and_things_that_stand_there_are_no_scatter() -> None:
    random = np.random.default_rng(0)
    image = random.standard_gamma(16.0, (120, 120)) / 16.0
    image *= 10.0 ** ((ROWS + COLS) / 240.0)  # 10 dB from corner to corner
    image[30:36, 40:46] *= 20.0
    found = even_ground(image, EVERYWHERE)
    assert found is not None
    assert found.looks == pytest.approx(16.0, rel=0.05)
    assert found.left_out >= 1
    assert even_ground(image, np.zeros_like(EVERYWHERE)) is None


# ---- what is found ----


def images(
    true: list[Law], declared: list[float | None], seed: int = 0, power: float = 1.0, texture: float = math.inf
) -> list[Scatter]:
    random = np.random.default_rng(seed)
    found = []
    for k, (law, looks) in enumerate(zip(true, declared, strict=True)):
        drawn = law.draw(random, (120, 120)) ** power
        found.append(Scatter(f"v{k} HH", looks, texture, even_ground(drawn / drawn.mean(), EVERYWHERE)))
    return found


@pytest.mark.parametrize("looks", [1.0, 2.0, 4.0, 16.0, 64.0])
def test_declared_looks_that_are_right_are_left_alone(looks: float) -> None:
    for seed in range(4):
        found = speckle_fact(images([Law(looks)] * 5, [looks] * 5, seed))
        assert (found.kind, found.names, found.departs) == ("declared", [], False)


@pytest.mark.parametrize(("true", "declared"), [(3.0, 6.0), (6.0, 3.0), (1.0, 2.0), (2.0, 1.0), (16.0, 8.0)])
def test_wrong_looks_are_found(true: float, declared: float) -> None:
    found = speckle_fact(images([Law(true)] * 5, [declared] * 5))
    assert (found.kind, found.names, found.common) == ("looks", ["looks"], True)
    for estimate in found.looks.values():
        # 70,000 pixels tell looks to half a percent; 2.6 standard errors
        assert abs(math.log(estimate.value / true)) < 2.6 / 1.96 * math.log(estimate.high / estimate.value)


def test_looks_of_single_views() -> None:
    found = speckle_fact(images([Law(3.0)] * 3 + [Law(6.0)] * 2, [6.0] * 5))
    assert (found.kind, found.common) == ("looks", False)
    assert [round(one.value) for one in found.looks.values()] == [3, 3, 3, 6, 6]


@pytest.mark.parametrize(("looks", "width"), [(4.0, 2.0), (4.0, 3.0), (16.0, 2.0), (16.0, 3.0), (16.0, 4.0)])
def test_clumps_are_no_texture(looks: float, width: float) -> None:
    random, found = np.random.default_rng(0), []
    for k in range(5):
        field = gaussian_filter(random.standard_normal((120, 120)), width)
        drawn = Law(looks).draw(random, field.shape) * np.exp(0.45 * field / field.std())
        found.append(Scatter(f"v{k} HH", looks, math.inf, even_ground(drawn / drawn.mean(), EVERYWHERE)))
    told = speckle_fact(found)
    assert (told.kind, told.names) == ("none of them", [])
    assert "clumps" in told.words


@pytest.mark.parametrize("sigma", [0.8, 1.2])
@pytest.mark.parametrize("shape", [math.inf, 4.0])
def test_a_response_is_no_clump(shape: float, sigma: float) -> None:
    """Pixels share what the response spreads, with texture and without."""
    random = np.random.default_rng(1)
    beyond = []
    for _ in range(8):
        drawn = correlated(random, 4, sigma, 120)
        drawn *= Law(shape).draw(random, drawn.shape) if math.isfinite(shape) else 1.0
        found = even_ground(drawn, EVERYWHERE, area(sigma))
        assert found is not None
        beyond.append((found.shared[0] - 0.01) / found.shared[1])
    assert max(beyond) < 3.0
    assert np.mean(beyond) < 0.0


@pytest.mark.parametrize(("looks", "shape"), [(1.0, 2.0), (4.0, 4.0), (16.0, 6.0), (16.0, 2.0)])
def test_texture_is_found(looks: float, shape: float) -> None:
    found = speckle_fact(images([Law(looks, shape)] * 5, [looks] * 5))
    if found.kind == "texture":
        assert found.texture is not None
        assert found.texture.value == pytest.approx(shape, rel=0.1)
    else:  # with looks and shape alike the two cannot be told from each other's change
        assert found.kind == "looks and texture"
        assert looks == shape


def test_weak_texture_at_one_look_is_found() -> None:
    """A shape of 5 is 13 % of the second cumulant of one look, but 20 % of the power's own variance."""
    for seed in range(3):
        found = speckle_fact(images([Law(1.0, 5.0)] * 3, [1.0] * 3, seed))
        assert found.names == ["texture"]
        assert found.texture is not None
        assert found.texture.low < 5.0 < found.texture.high


def test_what_scatters_more_is_no_saturation() -> None:
    """Compression makes power scatter less. A power law that makes it scatter more had explained strong texture."""
    for seed in range(3):
        found = speckle_fact(images([Law(16.0, 5.2)] * 3, [16.0] * 3, seed))
        assert (found.kind, found.rivals) == ("texture", [])


def test_a_texture_common_to_views_of_other_looks() -> None:
    """Without declared looks, the shape that all views share is the texture."""
    true = [Law(looks, 5.0) for looks in (1.0, 2.0, 4.0, 8.0, 16.0)]
    found = speckle_fact(images(true, [None] * 5))
    assert found.kind == "texture"
    assert found.texture is not None
    assert found.texture.value == pytest.approx(5.0, rel=0.3)


def test_a_declared_texture_is_what_is_declared() -> None:
    found = speckle_fact(images([Law(16.0, 6.0)] * 4, [16.0] * 4, texture=6.0))
    assert found.kind == "declared"


def test_both_wrong_are_listed_both_ways_round() -> None:
    found = speckle_fact(images([Law(8.0, 20.0)] * 8, [5.0] * 8))
    assert found.kind in ("looks and texture", "texture")
    if found.kind == "looks and texture":
        assert "the other way round" in found.words


def test_compression_is_no_looks() -> None:
    """A power law of 0.7 makes 0.49 and 0.34 of the cumulants; more looks of the same variance would make 0.25."""
    found = speckle_fact(images([Law(1.0)] * 5, [1.0] * 5, power=0.7))
    assert (found.kind, found.names, found.departs) == ("none of them", [], True)
    assert "saturation" in found.words


def test_less_than_a_tenth_is_nothing() -> None:
    assert speckle_fact(images([Law(4.2)] * 8, [4.0] * 8)).kind == "declared"
    assert speckle_fact(images([Law(4.0, 80.0)] * 8, [4.0] * 8)).kind == "declared"


@pytest.mark.full
def test_intervals_hold() -> None:
    """Of 60 intervals of 95 %, 50 or fewer hold in one case in 10^4."""
    inside = 0
    for seed in range(30):
        looks = speckle_fact(images([Law(3.0)] * 3, [6.0] * 3, seed)).looks["v0 HH"]
        texture = speckle_fact(images([Law(16.0, 6.0)] * 3, [16.0] * 3, seed)).texture
        assert texture is not None
        inside += looks.low < 3.0 < looks.high
        inside += texture.low < 6.0 < texture.high
    assert inside > 50


def test_no_even_ground_tells_nothing() -> None:
    found = speckle_fact([Scatter("v0 HH", 4.0, math.inf, None)])
    assert (found.kind, found.departs) == ("not told", False)


def test_a_fact_travels_as_json() -> None:
    for found in (speckle_fact(images([Law(3.0)], [6.0])), speckle_fact(images([Law(16.0, 6.0)] * 3, [16.0] * 3))):
        assert unpacked(packed(found)) == found
