"""When a reflector stands, and where one is whose place is not known: found where it was put, and not in clutter."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from product_files import SITE, Band
from stacks import DAYS, safe_stack
from test_explain import observed

import warpsar
from warpsar.calibration.attitude import Facing
from warpsar.calibration.presence import levels, presences, rise, standing, step_of
from warpsar.calibration.sites import ReflectorSite
from warpsar.formats import sentinel1

pytestmark = pytest.mark.unit


def clutter(rng: np.random.Generator, dates: int, places: int, looks: float, freedom: float) -> np.ndarray:
    """Gamma speckle of so many looks on levels that are inverse gamma."""
    level = freedom / rng.chisquare(freedom, places)
    return np.asarray(rng.gamma(looks, level / looks, (dates, places)))


@pytest.mark.parametrize(("dates", "looks", "freedom"), [(5, 3.5, 8.0), (8, 1.0, 20.0), (2, 1.0, 200.0)])
def test_clutter_alone_rises_as_often_as_is_said(dates: int, looks: float, freedom: float) -> None:
    """Of 100 images 10 may be called at 10 %, 3 being one standard error; dates are tried, so it is fewer."""
    rng = np.random.default_rng(0)
    chances = [rise(clutter(rng, dates, 1000, looks, freedom), looks, 1000.0)[2] for _ in range(100)]
    assert np.mean(np.array(chances) < 0.1) <= 0.1 + 3 * 0.03
    assert min(chances) > 1e-5


def test_the_levels_of_clutter_are_those_that_were_drawn() -> None:
    rng = np.random.default_rng(1)
    freedom, scale = levels(clutter(rng, 6, 20000, 2.0, 12.0).mean(axis=0), 12.0)
    assert freedom == pytest.approx(12.0, rel=0.1)
    assert scale == pytest.approx(1.0, rel=0.03)


def test_a_rise_is_found_at_its_place_and_date() -> None:
    """20 dB over clutter from the fourth of eight dates on, single look."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        power = clutter(rng, 8, 1000, 1.0, 10.0)
        power[3:, 77] += 100.0
        place, change, chance = rise(power, 1.0, 1000.0)
        assert (place, change.first) == (77, 3)
        assert change.likely[0] <= 3 <= change.likely[1]
        assert chance < 0.01


def test_the_date_of_a_weak_step_has_an_interval() -> None:
    """Of 300 steps of 7 dB the set of 90 % holds the true date in 87 % at least (3 standard errors below 90 %: 85)."""
    rng = np.random.default_rng(3)
    held = 0
    for _ in range(300):
        first = int(rng.integers(2, 9))
        power = rng.exponential(np.where(np.arange(10) < first, 1.0, 5.0))
        change = step_of(power, 1.0)
        held += change.likely[0] <= first <= change.likely[1]
    assert held >= 0.85 * 300


def test_dates_before_a_set_up_explain_nothing() -> None:
    observations = [
        observed("A", 12 * k, 98.0, 38.0, -30.0 if k in (0, 1, 6) else 0.0, status="not seen" if k in (0, 1, 6) else (
            "measured"))
        for k in range(10)
    ]  # fmt: skip
    (found,) = presences(observations)
    assert found.since == ("2024-01-13", "2024-01-25")
    assert found.until is None
    assert "absent or covered at 2024-03-13" in found.words
    made = standing(observations, [found])
    assert [one.stands for one in made] == [False] * 2 + [True] * 8
    stated = [replace(one, site=replace(one.site, start=np.datetime64("2023-01-01"))) for one in observations]
    assert all(one.stands for one in standing(stated, presences(stated)))  # the table is believed


def test_a_reflector_that_is_taken_away() -> None:
    status = ["measured"] * 5 + ["not seen"] * 3
    (found,) = presences([
        observed("A", 12 * k, 98.0, 38.0, 0.0 if word == "measured" else -30.0, status=word)  # type: ignore[arg-type]
        for k, word in enumerate(status)
    ])  # fmt: skip
    assert found.since is None
    assert found.until == ("2024-02-18", "2024-03-01")


def test_a_move_is_found_and_scatter_is_none() -> None:
    """1 m in range at the sixth of twelve dates, in a scatter of 0.2 m; of 20 without, at most 2 are named."""
    rng = np.random.default_rng(4)

    def series(move: float) -> list[warpsar.calibration.ReflectorObservation]:
        return [
            observed("A", 12 * k, 98.0, 38.0, 0.0, offset=(0.05 * rng.normal(), 0.1 * rng.normal() + move * (k >= 5)))
            for k in range(12)
        ]

    (found,) = presences(series(0.5))  # pixels of 2 m
    assert found.moved == ("2024-02-18", "2024-03-01")
    assert found.moved_m is not None
    assert found.moved_m[1] == pytest.approx(1.0, abs=0.3)
    assert sum(bool(presences(series(0.0))) for _ in range(20)) <= 2


@pytest.mark.full
def test_an_unknown_place_is_found_in_images(tmp_path: Path) -> None:
    """Single looks, set up at the third of five dates, 270 m off the place in the table; none without a reflector."""
    line, pixel = Band().centre
    safe_stack(tmp_path, [-20.0, -20.0, 33.0, 33.0, 33.0], (20.0, -60.0))
    products = [sentinel1.products(path, None)[0] for path in sorted(tmp_path.glob("*.SAFE"))]
    site = ReflectorSite("N", *SITE, (Facing(262.0, 3.3),), "triangular", 1.0, search_m=500.0)
    result = warpsar.reflectors(products, [site], engine=False)
    (found,) = result.found
    image = products[0].to_image(found.site.geodetic(np.datetime64("2024-03-05")))
    assert (image.line, image.pixel) == pytest.approx((line + 20.0, pixel - 60.0), abs=0.3)
    assert [str(each)[:10] for each in (found.after, found.before)] == [DAYS[1], DAYS[2]]
    assert found.error_m is not None
    assert max(found.error_m) < 5.0
    assert [one.stands for one in result.observations] == [False, False, True, True, True]
    assert result.geolocation is None  # its place was read off these images
    assert not result.refused
    alone = warpsar.reflectors(products[:2], [site], engine=False)
    assert alone.found == ()
    assert "nothing within 500 m changes" in alone.refused[0]
