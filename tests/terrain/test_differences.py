"""What differs between measured and simulated pixels, on images that are made with one thing wrong, and with none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from product_files import Band, write_safe
from terrain_files import dem, landcover

import warpsar
from warpsar.terrain.differences import AZIMUTH, HEIGHT, RANGE, TerrainDifferences, differences
from warpsar.terrain.result import SimulatedProduct

SHAPE = (128, 384)


def twin(folder: Path, heights: np.ndarray, classes: np.ndarray, name: str) -> SimulatedProduct:
    """Grass and dry soil over hills."""
    folder = folder / name
    folder.mkdir()
    band = Band(lines=SHAPE[0], pixels=SHAPE[1], centre=(63.5, 191.5))
    safe = write_safe(folder, np.zeros(SHAPE, np.complex64), band)
    cover = landcover(folder, classes)
    return warpsar.twin(
        safe, dem(folder, heights), geoid_offset_m=0.0, landcover=cover, landcover_table="worldcover", device="cpu"
    )


@pytest.fixture(scope="module")
def ground() -> tuple[np.ndarray, np.ndarray]:
    from scipy.ndimage import gaussian_filter

    rough = gaussian_filter(np.random.default_rng(3).standard_normal((161, 161)), 2.0)
    classes = np.full((401, 401), 10, np.uint8)
    for top in range(0, 401, 80):
        for left in range(40 * (top // 80 % 2), 401, 80):
            classes[top : top + 80, left : left + 40] = 40
    return 250.0 + 15.0 * rough / rough.std(), classes


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory, ground: tuple[np.ndarray, np.ndarray]) -> SimulatedProduct:
    return twin(tmp_path_factory.mktemp("town"), *ground, "declared")


def asked(found: SimulatedProduct, power: np.ndarray, seed: int = 1) -> TerrainDifferences:
    """Single-look speckle on `power`."""
    measured = power * np.random.default_rng(seed).exponential(size=power.shape)
    answer = differences(replace(found, image={**found.image, "measured": measured.astype(np.float32)}))
    assert isinstance(answer, TerrainDifferences)
    return answer


def whole(found: SimulatedProduct) -> np.ndarray:
    return np.asarray(found.image["beta0"] + found.image["noise"], np.float64)


def named(answer: TerrainDifferences) -> list[str]:
    return [one.name for one in answer.found if one.named]


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_named_where_nothing_differs(simulated: SimulatedProduct, seed: int) -> None:
    assert not asked(simulated, whole(simulated), seed).found


def test_a_calibration_is_measured(simulated: SimulatedProduct) -> None:
    answer = asked(simulated, 10.0**0.5 * whole(simulated))
    assert named(answer) == ["calibration"]
    (one,) = answer.found
    assert one.low < 5.0 < one.high
    assert one.high - one.low < 0.5
    assert answer.deviance[1] < 0.5 * answer.deviance[0]


def test_the_noise_is_measured(simulated: SimulatedProduct) -> None:
    """Twenty dB: the annotated noise is 24 dB below the ground here, and double of it cannot be seen."""
    image = simulated.image
    assert not asked(simulated, np.asarray(image["beta0"] + 2.0 * image["noise"], np.float64)).found
    answer = asked(simulated, np.asarray(image["beta0"] + 100.0 * image["noise"], np.float64))
    assert named(answer) == ["noise"]
    assert answer.found[0].low < 20.0 < answer.found[0].high


def test_a_level_within_its_spread_has_no_name(simulated: SimulatedProduct) -> None:
    image = simulated.image
    for db, names in ((3.0, []), (9.0, ["level of grass"])):
        factor = np.where(image["cover"] == 0.0, 10.0 ** (db / 10.0), 1.0)
        answer = asked(simulated, np.asarray(image["beta0"] * factor + image["noise"], np.float64))
        (one,) = answer.found
        assert one.name == "level of grass"
        assert one.low < db < one.high
        assert named(answer) == names


def test_a_wrong_height_of_the_elevation_model_is_measured_and_tied(
    simulated: SimulatedProduct, ground: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    """Range timing does the same to an image: 12 m times the cosine of the incidence."""
    heights, classes = ground
    answer = asked(simulated, whole(twin(tmp_path, heights + 12.0, classes, "raised")))
    (one,) = answer.found
    assert one.named
    assert {one.name, *one.tied} == {HEIGHT, RANGE}
    cosine = np.cos(np.deg2rad(np.nanmean(simulated.image["ellipsoid_incidence"])))
    raised = one.value if one.name == HEIGHT else -one.value / cosine
    assert raised == pytest.approx(12.0, abs=0.5)  # five standard deviations; the slope of cosines over the image


def test_a_shift_along_the_flight_is_measured(simulated: SimulatedProduct) -> None:
    answer = asked(simulated, np.roll(whole(simulated), 1, axis=0))
    (one,) = answer.found
    assert named(answer) == [AZIMUTH]
    assert one.low < 13.7 < one.high  # a line, `product_files.Band`


def test_other_land_cover_of_a_field_is_found(
    simulated: SimulatedProduct, ground: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    """The file says grass where there is water."""
    heights, classes = ground
    lake = classes.copy()
    lake[160:240, 200:240] = 80
    answer = asked(simulated, whole(twin(tmp_path, heights, lake, "lake")))
    (one,) = (each for each in answer.found if each.named)
    assert one.name.startswith("region ")
    assert one.name.endswith("of grass")
    assert "46.000" in one.words
    assert "12.00" in one.words
    assert "water_calm" in one.words


@pytest.mark.full
def test_fields_that_differ_by_nature_have_no_name_and_intervals_hold(simulated: SimulatedProduct) -> None:
    """Levels that wander by 1 dB over some cells, one calibration in common: named never, held in 95 %."""
    from scipy.ndimage import gaussian_filter

    held = 0
    for seed in range(40):
        random = np.random.default_rng(seed)
        field = gaussian_filter(random.standard_normal(SHAPE), (10.0, 20.0))
        texture = np.exp(0.23 * field / field.std())
        db = random.uniform(-3.0, 3.0)
        answer = asked(simulated, whole(simulated) * texture / texture.mean() * 10.0 ** (db / 10.0), seed)
        assert not named(answer)
        mine = [one for one in answer.found if one.name == "calibration"]
        low, high = (mine[0].low, mine[0].high) if mine else (-abs(db), abs(db))
        held += low <= db <= high
    assert held >= 34  # 38 are meant; 33 or fewer come by chance in 1 of 100


@pytest.mark.full
@pytest.mark.parametrize("seed", range(1, 4))
def test_a_lake_is_named_in_other_worlds_and_noise_is_not(tmp_path: Path, seed: int) -> None:
    """The lake fills few squares of the checkerboard; noise that runs off to nothing fits it a little, too."""
    from scipy.ndimage import gaussian_filter

    rough = gaussian_filter(np.random.default_rng(100 + seed).standard_normal((161, 161)), 2.0)
    heights, classes = 250.0 + 15.0 * rough / rough.std(), np.full((401, 401), 10, np.uint8)
    for top in range(0, 401, 80):
        for left in range(40 * (top // 80 % 2), 401, 80):
            classes[top : top + 80, left : left + 40] = 40
    lake = classes.copy()
    lake[160:240, 200:240] = 80
    declared = twin(tmp_path, heights, classes, "declared")
    answer = asked(declared, whole(twin(tmp_path, heights, lake, "lake")), seed)
    (one,) = answer.found
    assert one.named
    assert one.name.endswith("of grass")
    assert "water_calm" in one.words
