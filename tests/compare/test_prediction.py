"""Where a view was aimed, what measured rivals predict, and how far a model is ahead of them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effect_worlds import street
from scipy.ndimage import gaussian_filter

from warpsar.compare.aim import (
    EXPECTED,
    SMOOTHED_PX,
    MeasuredImage,
    Reach,
    best_shift,
    deviances,
    own_shift,
    unaimed,
)
from warpsar.compare.prediction import SURE, Agreement, PredictedImage, advantage, compared, in_sector, summaries
from warpsar.compare.rivals import Seen, rivals, turned
from warpsar.world.tables import View

pytestmark = pytest.mark.unit
REACH = Reach(9, 9)


def truth(narrower_px: int = 0) -> np.ndarray:
    """A bright block with a shadow behind it, on even ground, (98, 98); narrower by so much on either side."""
    image = np.ones((98, 98))
    across = slice(35 + narrower_px, 65 - narrower_px)
    image[40:51, across] = 12.0
    image[51:70, across] = 0.05
    return gaussian_filter(image, 0.7)


def speckled(shift: tuple[int, int] = (0, 0), seed: int = 0) -> np.ndarray:
    return np.roll(truth(), shift, (0, 1)) * np.random.default_rng(seed).gamma(1.0, 1.0, (98, 98)) * 3600.0


def view(name: str, azimuth_deg: float, incidence_deg: float = 73.0) -> View:
    return View(name=name, azimuth_deg=azimuth_deg, incidence_deg=incidence_deg)


@pytest.mark.parametrize("shift", [(0, 0), (4, -2), (-7, 5)])
def test_both_shifts_are_found(shift: tuple[int, int]) -> None:
    """Of one look, in a block of 30 x 11 pixels: to a pixel."""
    chip = speckled(shift)
    assert np.abs(np.subtract(own_shift(chip, truth(), REACH), shift)).max() <= 1
    assert np.abs(np.subtract(best_shift(chip, truth(), REACH)[1], shift)).max() <= 1


def test_no_shift_leads_beyond_the_reach() -> None:
    chip = speckled((14, 0))
    for found in (own_shift(chip, truth(), REACH), best_shift(chip, truth(), REACH)[1]):
        assert REACH.holds(found)


def test_deviance_is_one_for_speckle_and_does_not_know_the_gain() -> None:
    """Mean of 6400 pixels, whose variance is (pi^2 / 6 - 1) 4: 0.02 of the mean."""
    chip, model = REACH.window(speckled()), REACH.window(truth())
    found = deviances(chip, model)
    assert found.mean() / EXPECTED == pytest.approx(1.0, abs=0.06)
    np.testing.assert_allclose(found, deviances(chip, 1e-3 * model), rtol=1e-5)


def test_pixels_that_are_not_used_say_nothing() -> None:
    chip = speckled()
    masked = chip.copy()
    masked[40:45, 40:45] = np.nan
    found = deviances(REACH.window(masked), REACH.window(truth()))
    assert found.size == 80 * 80 - 25
    assert np.isfinite(found).all()
    assert np.isfinite(best_shift(masked, truth(), REACH)[0])


def test_an_aim_point_between_pixels_costs_nothing() -> None:
    """A prediction that lies a third of a pixel off, without speckle: interpolation leaves less than a fifth of what
    the best whole pixel leaves."""
    fine = np.zeros((294, 294))
    fine += 1.0
    fine[120:153, 105:195] = 12.0
    smooth = gaussian_filter(fine, 6.0)
    here, off = (np.roll(smooth, by, 0).reshape(98, 3, 98, 3).mean(axis=(1, 3)) for by in (0, 1))
    whole = min(deviances(REACH.window(off), REACH.window(here, (k, 0))).mean() for k in (-1, 0, 1))
    assert MeasuredImage(off, REACH).deviance(here) < 0.2 * whole


def test_a_chip_turns_as_its_target_does() -> None:
    """A target seen from an azimuth 20 degrees on stands turned in the picture; and mirrored from the other side."""
    picture = np.ones((99, 99))
    picture[20:26, 60:66] = 50.0
    seen = Seen("a", 10.0, 73.0, picture)
    row, col = np.unravel_index(turned(seen, 30.0, (0.2, 0.2)).argmax(), picture.shape)
    before = np.array([23.0 - 49.0, 63.0 - 49.0])
    after = np.array([row - 49.0, col - 49.0])
    angle = np.degrees(np.arctan2(after[1], -after[0]) - np.arctan2(before[1], -before[0]))
    assert angle == pytest.approx(20.0, abs=6.0) or angle == pytest.approx(-20.0, abs=6.0)
    mirrored = turned(seen, -10.0, (0.2, 0.2), mirror=True)
    np.testing.assert_allclose(mirrored, picture[:, ::-1], rtol=1e-6)


def test_rivals_are_the_nearest_views() -> None:
    """Each is marked by its level: the mean of all is of images of median 1."""
    random = np.random.default_rng(0)
    train = [Seen(str(a), a, 73.0, random.gamma(1.0, 1.0, (20, 20))) for a in (0.0, 40.0, 300.0)]
    asked = Seen("x", 38.0, 73.0, train[0].power)
    found = rivals(asked, train, (0.2, 0.2))
    np.testing.assert_allclose(found["nearest"], turned(train[1], 38.0, (0.2, 0.2)))
    np.testing.assert_allclose(found["mirrored"], turned(train[2], 38.0, (0.2, 0.2), mirror=True))
    np.testing.assert_allclose(found["smoothed"], gaussian_filter(found["nearest"], SMOOTHED_PX))
    assert np.median(found["mean"]) == pytest.approx(1.0, abs=0.4)


def test_an_unseen_sector_is_far_from_every_train_view() -> None:
    train = [view("a", 350.0), view("b", 20.0)]
    assert in_sector(view("x", 5.0), train)
    assert not in_sector(view("x", 353.0), train)
    assert not in_sector(view("x", 15.5), train)


def predicted(model: float, rival: float, deviance: float = 1.3) -> list[PredictedImage]:
    random = np.random.default_rng(0)
    return [
        PredictedImage(
            view(f"v{k}", 10.0 * k, 73.0 if k % 2 else 75.0),
            "HH",
            True,
            {
                "model": Agreement(model + 0.01 * random.normal(), model, deviance, (0, 0)),
                "nearest": Agreement(rival, rival, 3.0, (0, 0)),
            },
        )
        for k in range(10)
    ]


def test_a_model_is_ahead_or_not_this_body() -> None:
    good, bad = advantage(predicted(0.89, 0.82)), advantage(predicted(0.80, 0.82))
    assert good is not None
    assert bad is not None
    assert good.ahead
    assert not bad.ahead
    assert "not this body" in bad.words
    worse = advantage(predicted(0.89, 0.82, deviance=4.0))
    assert worse is not None
    assert not worse.ahead, "a correlation alone does not do"
    assert "not this body" in worse.words


def test_a_picture_of_a_neighbour_refuses_no_body() -> None:
    """It has the glints of the view itself. A picture of another sector has not."""
    near = advantage([replace(image, in_sector=False) for image in predicted(0.80, 0.82)])
    assert near is not None
    assert not near.ahead
    assert "between train views are predicted no better than by a picture" in near.words
    assert "not this body" not in near.words


@pytest.mark.parametrize(("narrower_px", "this"), [(0, True), (3, False)])
def test_a_body_of_another_width_is_behind_a_picture_in_both_measures(narrower_px: int, this: bool) -> None:
    """Eight images of one look, and a picture of the same aspect with other speckle. That speckle costs the picture as
    it is three times the deviance of speckle, so it would refuse no body by deviance."""
    images = []
    for seed in range(8):
        seen, other = (Seen(name, 10.0, 73.0, speckled(seed=n)) for name, n in (("v", seed), ("t", 100 + seed)))
        beside = compared(seen, {"model": truth(narrower_px)}, [other], (0.2, 0.2), REACH)
        images.append(PredictedImage(view(f"v{seed}", 10.0), "HH", True, beside))
    found, bare = advantage(images), advantage(images, rivals=("nearest",))
    assert found is not None
    assert bare is not None
    assert bare.deviance > 2.0
    assert found.ahead is this
    assert (found.correlation < -SURE * found.error) is not this
    assert (found.deviance < -SURE * found.deviance_error) is not this


@pytest.mark.parametrize(("behind", "said"), [(0.05, True), (0.5, False)])
def test_a_deviance_within_its_error_does_not_refuse_a_body(behind: float, said: bool) -> None:
    """Ten images of deviances that scatter by 0.2, a mean's error of 0.07: behind by 0.05 is not told, by 0.5 it is."""
    images = predicted(0.89, 0.82, deviance=3.0)
    for image, off in zip(images, np.tile([0.2, -0.2], 5), strict=True):
        model = image.predictions["model"]
        object.__setattr__(
            image, "predictions", {**image.predictions, "model": replace(model, deviance=3.0 + behind + off)}
        )
    found = advantage(images)
    assert found is not None
    assert not found.ahead
    assert found.open is said
    assert ("not told" in found.words) is said
    assert ("not this body" in found.words) is not said


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"reach_m": 1.0}, "2 measured views state no shift"),
        ({"reach_m": 1.0, "range_m": {"v0": 0.2}}, "1 measured views state no shift"),
        ({"reach_m": 1.0, "range_m": {"v0": 0.2}, "azimuth_m": {"v1": 0.1}}, ""),
        ({"range_m": {"v0": 0.2}}, ""),
    ],
)
def test_a_reach_that_is_not_looked_within_is_said(table: dict[str, Any], said: str) -> None:
    views = [view(name, 0.0).model_copy(update={"images": {"HH": Path("x.tif")}}) for name in ("v0", "v1")]
    (found,) = unaimed(replace(street(), views=views, effects={"aim_point": table})) or [""]
    assert said in found
    assert bool(found) == bool(said)


def test_means_are_by_incidence() -> None:
    rows = summaries(predicted(0.89, 0.82))
    assert [(round(row.incidence_deg), row.views, row.prediction) for row in rows] == [
        (73, 5, "model"),
        (73, 5, "nearest"),
        (75, 5, "model"),
        (75, 5, "nearest"),
    ]
