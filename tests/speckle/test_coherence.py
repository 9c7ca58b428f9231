"""Coherence of two complex images: an image with itself, nothing alike, a known share, and what is refused."""

import numpy as np
import pytest

import warpsar
from warpsar import InputError

pytestmark = pytest.mark.unit
WINDOW = (7, 7)
INNER = np.s_[4:-4, 4:-4]


def noise(seed: int) -> np.ndarray:
    """Circular Gaussian, of mean power 1."""
    real, imaginary = np.random.default_rng(seed).normal(size=(2, 200, 200)) / np.sqrt(2.0)
    return real + 1j * imaginary


def test_an_image_with_itself_turned() -> None:
    one = noise(0)
    np.testing.assert_allclose(warpsar.coherence(one, 3.0 * one * np.exp(0.7j), WINDOW), np.exp(-0.7j), rtol=1e-6)


@pytest.mark.parametrize("window", [(5, 5), (7, 9)])
def test_where_nothing_is_alike_it_is_that_of_the_samples(window: tuple[int, int]) -> None:
    """sqrt(pi / 4L): 1 % of the law's own next order, and of 200 x 200 pixels in windows of L."""
    found = np.abs(warpsar.coherence(noise(1), noise(2), window))[INNER].mean()
    assert found == pytest.approx(np.sqrt(np.pi / (4.0 * np.prod(window))), rel=0.03)


def test_a_known_share_and_phase() -> None:
    """The mean over all pixels has 800 independent windows: an error of (1 - g^2) / sqrt(2 x 49 x 800)."""
    share = 0.8 * np.exp(0.4j)
    one = noise(3)
    other = np.conj(share) * one + np.sqrt(1.0 - abs(share) ** 2) * noise(4)
    assert warpsar.coherence(one, other, WINDOW)[INNER].mean() == pytest.approx(share, abs=0.01)


def test_a_window_with_a_bad_sample_has_none() -> None:
    one = noise(5)
    one[50, 60] = np.nan
    lost = ~np.isfinite(warpsar.coherence(one, noise(6), (3, 5)))
    assert lost.sum() == 15
    assert lost[49:52, 58:63].all()


@pytest.mark.parametrize(
    ("other", "window", "message"),
    [
        (np.ones((4, 5)), (3, 3), "must be one shape"),
        (np.ones((4, 4)), (2, 3), "must be two odd numbers"),
        (np.ones((4, 4)), (3, -1), "must be two odd numbers"),
    ],
)
def test_what_is_refused(other: np.ndarray, window: tuple[int, int], message: str) -> None:
    with pytest.raises(InputError, match=message):
        warpsar.coherence(np.ones((4, 4)), other, window)
