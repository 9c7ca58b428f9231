"""Quick looks: one scale in dB for all pictures of a command, every polarization, axes in metres."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from warpsar.io.quick_look import (
    DEEPEST_DB,
    QuickLook,
    contact_sheet,
    draw,
    draw_together,
    limits_db,
    reduced,
    shades,
)


def look(path: Path, *decibel: np.ndarray, spacing_m: tuple[float, float] = (0.5, 1.0)) -> QuickLook:
    names = ("HH", "VV", "HV")
    images = {name: 10 ** (image / 10) for name, image in zip(names, decibel, strict=False)}
    return QuickLook.of(path, "north", images, spacing_m)


def greys(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"))


def test_the_scale_is_that_of_all_pictures() -> None:
    """2nd and 99.5th percentile of all pixels together, in whole dB outward; counts of processes add up."""
    dark = look(Path("a.png"), np.linspace(-30.2, -20.1, 1000).reshape(20, 50))
    bright = look(Path("b.png"), np.linspace(-10.1, -0.2, 1000).reshape(20, 50), np.full((20, 50), -5.0))
    both = shades([dark, bright])
    np.testing.assert_array_equal(both, shades([dark]) + shades([bright]))
    assert both.sum() == 3000
    assert limits_db(both) == (-30.0, 0.0)
    assert limits_db(shades([bright])) == (-10.0, 0.0)


def test_a_scale_is_bounded_and_never_empty() -> None:
    wide = shades([look(Path("a.png"), np.linspace(-120.0, 0.0, 900).reshape(30, 30))])
    low, high = limits_db(wide)
    assert high - low == DEEPEST_DB
    for value in (0.0, np.nan, 1.0):
        constant = QuickLook.of(Path("a.png"), "a", {"HH": np.full((4, 4), value)}, (1.0, 1.0))
        low, high = limits_db(shades([constant]))
        assert high > low


def test_large_images_are_averaged_in_power() -> None:
    power = np.arange(12.0, dtype=np.float32).reshape(3, 4)
    power[0, 0] = np.nan
    np.testing.assert_array_equal(reduced(power, 4), power)
    np.testing.assert_allclose(reduced(power, 2), [[(1 + 4 + 5) / 3, (2 + 3 + 6 + 7) / 4], [8.5, 10.5]])


def test_every_polarization_has_a_panel(tmp_path: Path) -> None:
    """Half of the picture white, half black, beside it a polarization that is all black."""
    step = np.repeat([[-40.0], [0.0]], 10, axis=0) + np.zeros((20, 20))
    one, two = look(tmp_path / "one.png", step), look(tmp_path / "two.png", step, np.full((20, 20), -40.0))
    for each in (one, two):
        draw(each, (-40.0, 0.0))
    first, second = greys(one.path), greys(two.path)
    assert second.shape[1] > first.shape[1] + 200
    black = [int((picture == 0).all(axis=2).sum()) for picture in (first, second)]
    assert black[1] > 2.5 * black[0]  # half a panel, and one and a half


def test_near_range_is_on_top(tmp_path: Path) -> None:
    """The first row is the brightest, and metres keep their proportion."""
    picture = look(tmp_path / "a.png", np.linspace(0.0, -40.0, 40)[:, None] + np.zeros((40, 20)), spacing_m=(0.5, 0.5))
    draw(picture, (-40.0, 0.0))
    shown = greys(picture.path).astype(float).mean(axis=2)
    middle = shown[:, shown.shape[1] // 3]
    inside = middle[int(0.2 * len(middle)) : int(0.8 * len(middle))]
    assert (np.diff(inside) <= 0).all()
    assert inside[0] - inside[-1] > 100


def test_missing_pixels_are_no_shadow(tmp_path: Path) -> None:
    hole = np.zeros((20, 20))
    hole[5:15, 5:15] = np.nan
    picture = look(tmp_path / "a.png", hole)
    draw_together([picture])
    shown = greys(picture.path).astype(int)
    assert ((shown[..., 2] - shown[..., 0]) > 50).sum() > 1000  # blue


@pytest.mark.parametrize("count", [1, 3, 100])
def test_a_contact_sheet(count: int, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    contact_sheet(tmp_path / "sheet.png", [look(Path(f"{i}"), random.normal(size=(8, 8))) for i in range(count)])
    assert greys(tmp_path / "sheet.png").std() > 10
