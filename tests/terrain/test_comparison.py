"""Measured beside simulated, on images that are made: terrain under speckle, and speckle alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from terrain_files import dem, product

import warpsar
from warpsar.terrain.comparison import TerrainComparison, compared
from warpsar.terrain.result import SimulatedProduct


@pytest.fixture(scope="module")
def hills(tmp_path_factory: pytest.TempPathFactory) -> SimulatedProduct:
    from scipy.ndimage import gaussian_filter

    folder = tmp_path_factory.mktemp("hills")
    rough = gaussian_filter(np.random.default_rng(3).standard_normal((121, 121)), 2.0)
    path = dem(folder, 250.0 + 12.0 * rough / rough.std())
    return warpsar.twin(product(folder), path, geoid_offset_m=0.0, device="cpu")


def against(found: SimulatedProduct, measured: np.ndarray) -> TerrainComparison:
    answer = compared(replace(found, image={**found.image, "measured": measured.astype(np.float32)}))
    assert isinstance(answer, TerrainComparison)
    return answer


def test_terrain_under_speckle_is_seen(hills: SimulatedProduct) -> None:
    """Four times the simulated power, with single-look speckle: 6 dB, one dB for one dB, nothing left but speckle."""
    power = 4.0 * (hills.image["beta0"] + hills.image["noise"])
    found = against(hills, power * np.random.default_rng(1).exponential(size=power.shape))
    assert found.seen
    # the mean of 4 x 4 pixels of speckle: 1.1 dB, and -0.14 dB on average
    looks = found.cell[0] * found.cell[1]
    assert found.level_db == pytest.approx(6.02, abs=0.3)
    assert found.slope == pytest.approx(1.0, abs=0.15)
    assert found.left_db == pytest.approx(4.34 / np.sqrt(looks), rel=0.15)
    assert found.left_without_db > 1.3 * found.left_db
    assert found.best_shift == (0, 0)
    assert found.bright_shared > 0.3
    assert "terrain is seen" in found.words[-1]


def test_an_image_that_lies_off_is_found(hills: SimulatedProduct) -> None:
    power = hills.image["beta0"] + hills.image["noise"]
    cell = against(hills, power).cell
    found = against(hills, np.roll(power, (cell[0], -2 * cell[1]), (0, 1)))
    assert found.best_shift == (cell[0], -2 * cell[1])


@pytest.mark.parametrize("seed", range(4))
def test_speckle_alone_is_not_terrain(hills: SimulatedProduct, seed: int) -> None:
    shape = hills.image["beta0"].shape
    found = against(hills, 0.1 * np.random.default_rng(seed).exponential(size=shape))
    assert abs(found.correlation) < 0.2
    assert abs(found.slope) < 0.3
    assert found.left_db > 0.97 * found.left_without_db


def test_without_pixels_there_is_nothing_to_compare(hills: SimulatedProduct) -> None:
    assert compared(hills) is None
    few = np.full(hills.image["beta0"].shape, np.nan)
    few[:12, :12] = 1.0
    answer = compared(replace(hills, image={**hills.image, "measured": few}))
    assert answer is not None
    assert "too few to compare" in str(answer)
