"""Quick looks: one scale in dB for all pictures of a command, every polarization, axes in metres."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from warpsar.io.grey_scale import DARKEST_DB, GREYS, WITHOUT_POWER, GreyScale
from warpsar.io.quick_look import QuickLook, contact_sheet, draw, draw_together, reduced, shades

FORTY = GreyScale((-40.0, -22.0, -6.0, 0.0))


def look(path: Path, *decibel: np.ndarray, spacing_m: tuple[float, float] = (0.5, 1.0)) -> QuickLook:
    names = ("HH", "VV", "HV")
    images = {name: 10 ** (image / 10) for name, image in zip(names, decibel, strict=False)}
    return QuickLook.of(path, "north", images, spacing_m)


def greys(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"))


def test_the_scale_is_that_of_all_pictures() -> None:
    """2nd, 50th and 98th percentile of all pixels together, and the strongest; counts of processes add up."""
    dark = look(Path("a.png"), np.linspace(-30.2, -20.1, 1000).reshape(20, 50))
    bright = look(Path("b.png"), np.linspace(-10.1, -0.2, 1000).reshape(20, 50), np.full((20, 50), -5.0))
    both = shades([dark, bright])
    np.testing.assert_array_equal(both, shades([dark]) + shades([bright]))
    assert both.sum() == 3000
    assert GreyScale.of_counts(both).levels_db == (-30.0, -5.0, 1.0, 4.0)  # bright is 6 dB over ground, at least


def test_ground_is_mid_grey_and_a_strong_point_is_told_from_a_bright_roof() -> None:
    """Grass at -8.6 dB, a roof at 2 dB, and four pixels in 10,000 of a double bounce at 24.8 dB. A scale that ends at a
    percentile shows roof and bounce alike."""
    image = np.full((100, 100), -8.6)
    image[:20, :25] = 2.0
    image[50, 50:54] = 24.8
    scale = GreyScale.of([10.0 ** (image / 10.0)])
    grass, roof, bounce = scale.grey([-8.6, 2.0, 24.8])
    assert 0.4 < grass < 0.46
    assert roof - grass > 0.2
    assert bounce - roof > 0.15
    assert bounce > 0.98
    assert scale.grey(-300.0) == 0.0


def test_greys_rise_and_a_bar_is_linear_in_db() -> None:
    scale = GreyScale((-30.0, -12.0, 3.0, 25.0))
    levels = np.linspace(-30.0, 25.0, 221)
    greys = scale.grey(levels)
    assert (np.diff(greys) > 0).all()
    np.testing.assert_allclose(scale.grey(scale.levels_db), GREYS)
    bar = scale.colours()(scale.norm()(levels))  # of 1024 steps
    np.testing.assert_allclose(bar[:, :3], greys[:, None] * np.ones(3), atol=0.42 / 12.0 * 55.0 / 1024.0)
    np.testing.assert_allclose(scale.along(56), scale.grey(np.arange(-30.0, 26.0)))
    assert np.isnan(scale.grey(np.nan))


def test_a_scale_is_bounded_and_never_empty() -> None:
    wide = shades([look(Path("a.png"), np.linspace(-120.0, 0.0, 900).reshape(30, 30))])
    black, ground, *_ = GreyScale.of_counts(wide).levels_db
    assert ground - black == DARKEST_DB
    for value in (0.0, np.nan, 1.0):
        constant = QuickLook.of(Path("a.png"), "a", {"HH": np.full((4, 4), value)}, (1.0, 1.0))
        assert (np.diff(GreyScale.of_counts(shades([constant])).levels_db) > 0).all()


def test_shadow_stands_apart_from_speckle() -> None:
    """Of four looks, 1 % of the pixels in shadow at a noise 25 dB below ground: few speckles are nearly as dark."""
    random = np.random.default_rng(3)
    power = random.gamma(4.0, 0.25, (200, 200))
    power[:2] *= 10.0**-2.5
    scale = GreyScale.of([power])
    shadow, ground = (scale.grey(10.0 * np.log10(part)) for part in (power[:2], power[2:]))
    assert np.median(shadow) == 0.0
    assert (ground < 0.1).mean() < 0.002
    assert 0.4 < np.median(ground) < 0.46


def test_shadow_is_black_and_beyond_the_mesh_it_is_blue() -> None:
    """No power in both halves; power beyond the mesh, of a blur or a floor, still shows, and counts for no scale."""
    power = np.zeros((8, 8))
    power[6:] = 1.0
    covered = np.ones((8, 8), bool)
    covered[:, 4:] = False
    one = QuickLook.of(Path("a.png"), "a", {"HH": power}, (1.0, 1.0), covered)
    rgb = one.rgb("HH", GreyScale.of_counts(shades([one])))
    assert (rgb[:6, :4] == 0.0).all()
    assert (rgb[:6, 4:, 2] - rgb[:6, 4:, 0] > 0.15).all()
    assert rgb[7, 6].mean() > rgb[0, 6].mean() + 0.2
    assert shades([one]).sum() == 8


def test_a_single_strong_pixel_of_a_large_image_is_seen(tmp_path: Path) -> None:
    """One in three million, 40 dB over the ground: a picture has fewer pixels than the image."""
    image = np.full((1500, 2000), -10.0)
    image[700, 900] = 30.0
    one = look(tmp_path / "a.png", image, spacing_m=(1.0, 1.0))
    draw_together([one])
    shown = greys(one.path).astype(int)
    height, width = shown.shape[:2]
    inside = shown[int(0.2 * height) : int(0.8 * height), int(0.2 * width) : int(0.7 * width)].min(axis=2)
    assert inside.max() > np.median(inside) + 60


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
        draw(each, FORTY)
    first, second = greys(one.path), greys(two.path)
    assert second.shape[1] > first.shape[1] + 200
    black = [int((picture == 0).all(axis=2).sum()) for picture in (first, second)]
    assert black[1] > 2.5 * black[0]  # half a panel, and one and a half


def test_near_range_is_on_top(tmp_path: Path) -> None:
    """The first row is the brightest, and metres keep their proportion."""
    picture = look(tmp_path / "a.png", np.linspace(0.0, -40.0, 40)[:, None] + np.zeros((40, 20)), spacing_m=(0.5, 0.5))
    draw(picture, FORTY)
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


def test_a_picture_says_where_no_mesh_is(tmp_path: Path) -> None:
    """A dark blue field below the picture, and only where the picture has that colour."""
    blue = np.round(255.0 * np.array(WITHOUT_POWER))

    def shown(covered: np.ndarray) -> int:
        path = tmp_path / "a.png"
        draw(QuickLook.of(path, "a", {"HH": np.ones((8, 8))}, (1.0, 1.0), covered), FORTY)
        picture = greys(path).astype(float)
        below = picture[int(0.9 * len(picture)) :]
        return int((np.abs(below - blue).max(axis=2) < 3.0).sum())

    covered = np.ones((8, 8), bool)
    assert shown(covered) == 0
    covered[:, 4:] = False
    assert shown(covered) > 100


@pytest.mark.full
@pytest.mark.parametrize("count", [1, 3, 100])
def test_a_contact_sheet(count: int, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    contact_sheet(tmp_path / "sheet.png", [look(Path(f"{i}"), random.normal(size=(8, 8))) for i in range(count)])
    assert greys(tmp_path / "sheet.png").std() > 10
