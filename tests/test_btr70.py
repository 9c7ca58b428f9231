"""What benchmarks/btr70.py measures with, on images whose truth is known; and its lists, on the chips."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

import btr70  # noqa: E402
import btr70_classes as classes  # noqa: E402
import btr70_ladder as ladder  # noqa: E402
import btr70_measures as measures  # noqa: E402
import btr70_parts as parts  # noqa: E402
import btr70_shape as shapes  # noqa: E402
import btr70_speckle as speckle  # noqa: E402

from warpsar.errors import InputError  # noqa: E402
from warpsar.world.mesh import read_mesh  # noqa: E402
from warpsar.world.taper import taper  # noqa: E402

pytestmark = pytest.mark.unit


def truth() -> np.ndarray:
    """A bright block with a shadow behind it, on even ground, (128, 128)."""
    image = np.ones((128, 128))
    image[55:66, 50:80] = 12.0
    image[66:85, 50:80] = 0.05
    return gaussian_filter(image, 0.7)


def speckled(shift: tuple[int, int] = (0, 0), seed: int = 0) -> np.ndarray:
    return np.roll(truth(), shift, (0, 1)) * np.random.default_rng(seed).gamma(1.0, 1.0, (128, 128)) * 3600.0


@pytest.mark.parametrize("shift", [(0, 0), (4, -2), (-7, 5)])
def test_both_shifts_are_found(shift: tuple[int, int]) -> None:
    """Of one look, in a block of 30 x 11 pixels: to a pixel."""
    chip = speckled(shift)
    assert np.abs(np.subtract(measures.own_shift(chip, truth()), shift)).max() <= 1
    assert np.abs(np.subtract(measures.best_shift(chip, truth())[1], shift)).max() <= 1


def test_deviance_is_one_for_speckle_and_does_not_know_the_gain() -> None:
    """Mean of 6400 pixels, whose variance is (pi^2 / 6 - 1) 4: 0.02 of the mean."""
    chip, model = measures.middle(speckled()), measures.middle(truth())
    found = measures.terms(chip, model)
    assert found.mean() / measures.EXPECTED == pytest.approx(1.0, abs=0.06)
    np.testing.assert_allclose(found, measures.terms(chip, 1e-3 * model), rtol=1e-6)


def test_correlation_of_an_image_with_itself_is_one() -> None:
    chip = speckled()
    found, shift = measures.best_shift(chip, chip)
    assert found == pytest.approx(1.0)
    assert shift == (0, 0)


def test_the_lit_edge_is_where_the_block_begins() -> None:
    body = truth() > 6.0
    assert measures.lit_edge(truth(), body) == pytest.approx(55, abs=1)
    assert measures.lit_edge(np.roll(truth(), 3, 0), body) == pytest.approx(58, abs=1)


def test_a_column_in_shadow_has_no_edge() -> None:
    body = truth() > 6.0
    image = truth()
    image[:, 50:60] = np.where(body.any(axis=1)[:, None], 0.05, 1.0)
    image[40:85, 50:60] = 0.05  # darker than the ground from top to bottom
    assert measures.lit_edge(image, body) == pytest.approx(55, abs=1)
    assert np.isnan(measures.lit_edge(np.where(body, 0.01, 0.01 + 0.0 * image), body))


def test_turned_chips_have_the_aspect_asked_for() -> None:
    """A point in front of the middle, seen from the north, lies on the right when seen from the west, and the other way
    round where the vehicle is mirrored."""
    power = np.zeros((128, 128))
    power[20:24, 62:66] = 1.0  # near the radar, which stands in the north
    north = measures.Chip("n", 0.0, 17.0, power)

    def place(image: np.ndarray) -> np.ndarray:
        weight = image / image.sum()
        return np.array([(weight.sum(1) * np.arange(128)).sum(), (weight.sum(0) * np.arange(128)).sum()]) - 63.5

    # from the west azimuth grows southwards: z x d with d to the east is north, so the picture's right is north
    west = place(measures.turned(north, 270.0))
    assert west[1] == pytest.approx(42.0, abs=1.0)
    assert abs(west[0]) < 1.0
    assert place(measures.turned(north, 90.0, mirror=True))[1] == pytest.approx(-42.0, abs=1.0)


def test_a_parabola_has_its_minimum() -> None:
    """Of a mean of chips' parabolas; the jackknife of a mean is its standard error, sd / sqrt(n)."""
    places, draws = np.linspace(0.8, 1.0, 5), np.random.default_rng(0)
    truth = 0.93 + 0.01 * draws.standard_normal(30)
    at, sd, half = shapes.likeliest(places.tolist(), (places[:, None] - truth) ** 2)
    assert at == pytest.approx(truth.mean(), abs=1e-6)
    assert sd == pytest.approx(truth.std(ddof=1) / np.sqrt(30), rel=1e-3)
    assert half == pytest.approx(2.045 * sd, rel=1e-3)  # Student's t of 29 degrees of freedom
    # a prior as sharp as the images: half way. 0.5 SIZE^2 / AREA_PX scores are a log-likelihood
    curve = shapes.AREA_PX / shapes.SIZE**2 / 30 * np.repeat(((places - 0.9) / 0.1)[:, None] ** 2, 30, axis=1)
    assert shapes.likeliest(places.tolist(), curve, 0.1)[0] == pytest.approx(0.95)


def test_parts_are_the_whole(tmp_path: Path) -> None:
    """A box of 8 x 4 x 2 (length, height, width): its area stays, every part is there, and both sides are alike."""
    corners = np.array([[x, y, z] for x in (0, 8) for y in (0, 4) for z in (-1, 1)], float)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {' '.join(str(k + 1) for k in one)}" for one in faces]
    (tmp_path / "box.obj").write_text("\n".join(lines) + "\n")
    mesh = read_mesh(parts.write(tmp_path / "box.obj", tmp_path / "parts.obj"))
    triangles = mesh.vertices[mesh.faces]
    edges = triangles[:, 1:] - triangles[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2.0
    assert areas.sum() == pytest.approx(2 * (8 * 4 + 8 * 2 + 4 * 2), rel=1e-5)
    assert set(mesh.materials) == set(parts.names())
    left = triangles[:, :, 2].max(axis=1) < -0.99
    right = triangles[:, :, 2].min(axis=1) > 0.99
    for number in range(len(mesh.materials)):
        one = mesh.face_material == number
        assert areas[one & left].sum() == pytest.approx(areas[one & right].sum(), rel=0.05)


def test_folds_leave_out_arcs() -> None:
    chips = [measures.Chip(f"c{k}", 12.0 * k, 17.0, np.zeros((1, 1))) for k in range(30)]
    found = ladder.folds(chips)
    assert sorted(name for fold in found for name in fold) == sorted(chip.name for chip in chips)
    for fold in found:
        left = sorted(int(name[1:]) for name in fold)
        assert int(np.sum(np.diff(left) > 1)) + 1 <= ladder.ARCS


def test_a_template_is_found_though_it_is_shifted() -> None:
    draws = np.random.default_rng(0)
    images = gaussian_filter(draws.random((5, 128, 128)), (0, 6, 6)) ** 8
    asked = np.array([classes.feature(np.roll(image, (4, -2), (0, 1))) for image in images])
    azimuths = np.arange(5.0)
    assert np.array_equal(classes.matched(images, azimuths, asked), azimuths)
    chips = [measures.Chip("", azimuth, 17.0, images[0]) for azimuth in (20.0, 100.0, 200.0, 359.0)]
    said = classes.marks(np.array([21.0, 280.0, 195.0, 1.0]), chips)
    assert said["median_error_deg"] == pytest.approx(3.5)
    assert said["reversed"] == 0.25
    assert said["side_right"] == pytest.approx(2 / 3)  # the last is end-on and does not count


@pytest.mark.measured
def test_train_chips_are_from_other_sectors_and_all_there(measured_data: Path) -> None:
    chips = {chip.name: chip for chip in btr70.chips_of(measured_data)}
    assert len(set(btr70.TRAIN)) == 30
    for name in btr70.TRAIN:
        chip = chips[name]
        assert chip.depression_deg > 16.0
        assert not any(low <= chip.azimuth_deg <= high for low, high in btr70.SECTORS_DEG)


@pytest.mark.parametrize("off", [(0.0, 0.0), (0.4, -0.3), (2.5, 1.25)])
def test_the_aim_point_lies_between_pixels(off: tuple[float, float]) -> None:
    """A chip without speckle, moved by parts of a pixel: the deviance is hardly more than that of no shift at all, and
    a tenth of what the nearest whole pixel leaves."""
    smooth = gaussian_filter(truth(), 1.5)
    chip = 3600.0 * shift(smooth, off, mode="nearest")
    whole = (round(off[0]), round(off[1]))
    left = measures.terms(measures.middle(chip), measures.middle(smooth, whole)).mean()
    assert measures.aimed(chip, smooth) <= 0.1 * left + 1e-4


def test_speckle_tells_the_width_of_a_point() -> None:
    """Complex noise through a Taylor response of 0.34 m (rows) and 0.30 m (columns), at 0.2 m: 24 images give the
    widths to 2 %. The response is built from its aperture, not from the formula of correlations."""
    draws, chips, spacing, size = np.random.default_rng(0), [], 0.2, 256
    windows = []
    for width in (0.34, 0.30):
        place = np.fft.fftfreq(size) / (spacing / (width / 1.18748))
        inside = np.abs(place) < 0.5
        windows.append(np.where(inside, taper("taylor", np.where(inside, place, 0.0)), 0.0))
    for number in range(24):
        white = draws.standard_normal((size, size)) + 1j * draws.standard_normal((size, size))
        field = np.fft.ifft2(np.fft.fft2(white) * np.outer(*windows))
        chips.append(measures.Chip(f"c{number}", 0.0, 17.0, np.abs(field) ** 2))
    for axis, width in ((0, 0.34), (1, 0.30)):
        found, sd = speckle.width_m(chips, axis, spacing)
        assert found == pytest.approx(width, rel=0.02)
        assert abs(found - width) < 4.0 * sd


@pytest.mark.parametrize(
    ("gain", "spread", "noise", "stays"),
    [
        (0.02, 0.01, 0.01, True),  # 30 chips: the standard error is 0.0018
        (0.02, 0.01, 0.019, False),  # above the noise, but by less than its error
        (0.02, 0.2, 0.0, False),  # error 0.037
        (-0.02, 0.01, 0.0, False),
    ],
)
def test_a_trial_stays_only_above_the_noise(gain: float, spread: float, noise: float, stays: bool) -> None:
    gains = gain + spread * np.tile([-1.0, 1.0], 15)
    climbing = ladder.Ladder(Path(), [], 1, [], noise=noise)
    assert climbing.judged("", gains) is stays
    assert climbing.steps[0]["error"] == pytest.approx(spread * np.sqrt(30 / 29) / np.sqrt(30))


def test_a_moved_quantity_moves_alone() -> None:
    """Of five numbers that are moved and two that are asked, each changes itself, and no table but its own."""
    for one in (*shapes.MOVED, *shapes.ASKED):
        moved = one.moved(shapes.START, 0.7)
        assert one.of(moved) == 0.7
        others = [other for other in (*shapes.MOVED, *shapes.ASKED) if (other.body, other.key) != (one.body, one.key)]
        assert all(other.of(moved) == other.of(shapes.START) for other in others)
        assert one.of(shapes.START) != 0.7


def test_a_folder_without_chips_says_what_it_lacks(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no views\.csv"):
        btr70.chips_of(tmp_path)
    (tmp_path / "views.csv").write_text("chip,azimuth\n")
    with pytest.raises(InputError, match="no column azimuth_deg, depression_deg"):
        btr70.chips_of(tmp_path)
    (tmp_path / "views.csv").write_text("chip,azimuth_deg,depression_deg\nA,1.0,17.0\n")
    with pytest.raises(InputError, match="no chip in chips/"):
        btr70.chips_of(tmp_path)
    with pytest.raises(SystemExit, match=r"error: .*no chip in chips/"):
        btr70.main([str(tmp_path), "-o", str(tmp_path / "out")])
