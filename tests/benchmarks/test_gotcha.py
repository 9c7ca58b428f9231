"""The loops on measured data: their scenes, simple predictions and theory; and, with the data there, the short form of
what docs/measured-record.md says."""

import runpy
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, benchmark
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from warpsar.evaluation.command import evaluate
from warpsar.learning import command as learning
from warpsar.learning.command import LearnOptions
from warpsar.scene.scene import Scene
from warpsar.world.world import geometry_of

# docs/measured-record.md
OVER_GRASS_DB = {"car_park": -1.8, "road": -5.1, "west_strip": 2.3, "cars": 9.1, "targets": 13.3}


@pytest.fixture(scope="module")
def gotcha() -> Any:
    return benchmark("gotcha")


@pytest.fixture(scope="module")
def loop() -> Any:
    return benchmark("measured_loop")


@pytest.fixture(scope="module")
def maker() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "data" / "gotcha" / "make_scene.py"))


@pytest.fixture(scope="module")
def flat(maker: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene.load(maker["write"](tmp_path_factory.mktemp("flat"), flat=True))


@pytest.fixture(scope="module")
def bodies(maker: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene.load(maker["write"](tmp_path_factory.mktemp("bodies")))


@pytest.mark.parametrize("is_flat", [True, False])
def test_the_table_and_the_scene_file_name_the_same_regions(
    maker: dict[str, Any], flat: Scene, bodies: Scene, is_flat: bool
) -> None:
    scene = flat if is_flat else bodies
    content = maker["table"](flat=is_flat)
    assert not scene.warnings
    standing = set() if is_flat else {"vehicle", "reflector"}
    assert {region["material"] for region in content["regions"]} | standing == set(scene.materials)
    for region in content["regions"]:
        assert region["how"].strip()
        for outline in region["outlines"]:
            assert np.abs(outline).max() <= content["size_m"] / 2.0
    assert [view.role for view in scene.views] == ["train", "train", "test"]


@given(arrays(np.int64, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 2)))
def test_rectangles_cover_every_cell_once_with_its_own_material(material: np.ndarray) -> None:
    rectangles = runpy.run_path(str(ROOT / "data" / "gotcha" / "make_scene.py"))["rectangles"]
    count = np.zeros(material.shape, int)
    for west, south, east, north in rectangles(material):
        count[south:north, west:east] += 1
        assert len(np.unique(material[south:north, west:east])) == 1
    assert (count == 1).all()


def test_the_ground_has_its_area_and_looks_up(flat: Scene) -> None:
    corners = flat.mesh.vertices[flat.mesh.faces]
    assert np.all(corners[..., 2] == 0.0)
    east, north = (corners[:, k, :2] - corners[:, 0, :2] for k in (1, 2))
    area = 0.5 * (east[:, 0] * north[:, 1] - east[:, 1] * north[:, 0])
    assert (area > 0).all()
    assert area.sum() == 130.0 * 130.0  # corners are whole metres


def test_each_pixel_has_the_region_under_its_centre(gotcha: Any, flat: Scene) -> None:
    """Against the mesh itself: the triangle that holds the point."""
    view = flat.views[2]
    found = gotcha.regions(flat, view)
    points = gotcha.ground_points(flat, view)[..., :2]
    assert (found >= 0).all()  # the ground reaches 5 m beyond the image
    a, b, c = np.moveaxis(flat.mesh.vertices[flat.mesh.faces][..., :2], 1, 0)
    for row, col in np.random.default_rng(0).integers(0, found.shape, (500, 2)):
        p = points[row, col]
        sides = [
            (v[:, 0] - u[:, 0]) * (p[1] - u[:, 1]) - (v[:, 1] - u[:, 1]) * (p[0] - u[:, 0])
            for u, v in ((a, b), (b, c), (c, a))
        ]
        (holding,) = np.nonzero(np.min(sides, axis=0) >= 0)
        assert found[row, col] in flat.mesh.face_material[holding]


@pytest.mark.parametrize(
    ("east", "north", "material"),
    [
        (0.5, 50.5, "grass"),
        (-15.5, 21.5, "targets"),  # the release's reflectors, where they focus
        (-27.5, 38.5, "targets"),
        (10.5, -33.5, "car_park"),
        (20.5, 10.5, "road"),
        (50.5, -10.5, "road"),
        (-47.5, -30.5, "cars"),
        (32.5, -27.5, "cars"),
        (-56.5, -30.5, "west_strip"),
    ],
)
def test_regions_lie_where_the_pictures_show_them(
    maker: dict[str, Any], east: float, north: float, material: str
) -> None:
    content = maker["table"](flat=True)
    names, index = maker["cells"](content["regions"], content["size_m"])
    row, col = (int((at + content["size_m"] / 2.0) // maker["CELL_M"]) for at in (north, east))
    assert names[index[row, col]] == material


def test_a_later_region_covers_an_earlier_one(maker: dict[str, Any]) -> None:
    whole, part = [[-2, -2], [2, -2], [2, 2], [-2, 2]], [[0, -2], [2, -2], [2, 0], [0, 0]]
    regions = [{"material": "under", "outlines": [whole]}, {"material": "over", "outlines": [part]}]
    names, material = maker["cells"](regions, 4.0)
    assert names == ["under", "over"]
    np.testing.assert_array_equal(material, [[0, 0, 1, 1], [0, 0, 1, 1], [0, 0, 0, 0], [0, 0, 0, 0]])


def test_cars_stand_apart_and_face_the_radar(maker: dict[str, Any], bodies: Scene) -> None:
    size, cars = maker["read"]("rows.toml")["car"], maker["read"]("objects.toml")["cars"]
    boxes = []
    for one in cars:
        quads = np.array(list(maker["car"](one["foot_m"], one["facing"], size["length_m"], size["width_m"])))
        low, high = quads.min(axis=(0, 1)), quads.max(axis=(0, 1))
        lengths = sorted(high - low, reverse=True)
        np.testing.assert_allclose(lengths, [size["length_m"], size["width_m"], maker["TOP_M"]], atol=1e-9)
        assert (high - low)[1 if one["facing"] == "side" else 0] == pytest.approx(size["length_m"])
        assert [high[0], (low[1] + high[1]) / 2.0, low[2]] == pytest.approx([*one["foot_m"], 0.0])
        boxes.append((low, high))
    for (low, high), (other_low, other_high) in combinations(boxes, 2):
        assert np.any((high[:2] < other_low[:2]) | (other_high[:2] < low[:2]))
    faces = bodies.mesh.face_material == bodies.mesh.materials.index("vehicle")
    assert faces.sum() == 20 * len(cars)  # two boxes of five quads


def test_reflectors_are_three_plates_at_right_angles(maker: dict[str, Any]) -> None:
    for one in maker["read"]("objects.toml")["reflectors"]:
        plates = np.array(list(maker["trihedral"](one["corner_m"], one["leg_m"])))
        legs = plates[:, 1] - plates[:, 0]
        np.testing.assert_allclose(legs @ legs.T, one["leg_m"] ** 2 * np.eye(3), atol=1e-9)
        assert (legs.sum(axis=0)[[0, 2]] > 0).all()  # opens to the east and up
        np.testing.assert_allclose(plates[0, 0, :2], one["corner_m"])


def test_region_means_find_brightness_and_gain(gotcha: Any) -> None:
    truth, generator = np.array([1.0, 5.0, 0.2]), np.random.default_rng(0)
    images = []
    for gain, share in ((3.0, [0.8, 0.1, 0.1]), (6.0, [0.1, 0.1, 0.8])):  # unlike enough that gains are not means
        region = generator.choice(3, 60_000, p=share)
        power = gain * truth[region] * generator.gamma(2.0, 0.5, region.size)
        images.append(gotcha.Pixels(power, region, 2.0))
    # 12,000 pixels of 2 looks or more in each region and 60,000 for each gain: 1 % is two standard errors
    np.testing.assert_allclose(gotcha.region_means(images, 3), 3.0 * truth, rtol=0.02)
    exact = [gotcha.Pixels(g * truth[i.region], i.region, 2.0) for g, i in zip((3.0, 6.0), images, strict=True)]
    np.testing.assert_allclose(gotcha.region_means(exact, 4)[:3], 3.0 * truth, rtol=1e-9)
    assert np.isnan(gotcha.region_means(exact, 4)[3])


def test_views_are_laid_on_each_other_through_the_ground(gotcha: Any, flat: Scene) -> None:
    """A picture of the ground's own coordinates: bilinear interpolation keeps linear functions."""
    rows, cols = np.meshgrid(
        *((np.arange(n) + 0.5 - n / 2) * s for n, s in zip(flat.grid.shape, flat.grid.spacing_m, strict=True)),
        indexing="ij",
    )

    def ground(name: str) -> np.ndarray:
        geometry = geometry_of(flat, next(v for v in flat.views if v.name == name))
        # X . d = range, X . u = azimuth and z = 0: three equations, solved as they stand
        axes = np.stack([geometry.d, geometry.u, [0.0, 0.0, 1.0]])
        points: np.ndarray = np.linalg.solve(axes, np.stack([rows.ravel(), cols.ravel(), 0 * rows.ravel()]))
        return points.T.reshape(*rows.shape, 3)

    for axis in (0, 1):
        images = {name: ground(name)[..., axis] for name in ("az001", "az002")}
        found = gotcha.seen_from(flat, images, "az003")
        seen = np.isfinite(found)
        assert seen.mean() > 0.93  # two degrees turn 2 m of the rim out of sight at the far corners
        np.testing.assert_allclose(found[seen], ground("az003")[..., axis][seen], atol=1e-9)


def test_only_heights_are_left_to_learn(gotcha: Any, maker: dict[str, Any], tmp_path: Path) -> None:
    held = Scene.load(gotcha.heights_only(maker["write"](tmp_path, flat=True)))
    learned = {name: tuple(material.learn) for name, material in held.materials.items()}
    assert learned.pop("grass") == ()
    assert set(learned.values()) == {("rms_height_m",)}


def test_the_kernel_of_a_pixel_grid(loop: Any) -> None:
    """Against closed forms: the transform of a constant is a sinc, and a box of samples keeps the second moment."""
    place = loop.pixel_kernel(1.0, "none", 0.5, 1, 0.0)
    pixel = np.arange(-loop.REACH, loop.REACH + 1.0)
    expected = np.sinc(0.5 * pixel) ** 2
    np.testing.assert_allclose(place, expected / expected.sum(), atol=2e-5)  # 400 pulses for a continuous aperture
    # without sidelobes to speak of, variances add: response, place in the pixel, samples
    spacing, samples, cell = 1.0, 3, 1.6
    fine = np.arange(-20.0, 20.0, 0.01)
    response = loop.impulse_response(fine, cell, "taylor")
    variance = float((response * fine**2)[np.abs(fine) < 2 * cell].sum() / response.sum())
    kernel = loop.pixel_kernel(cell, "taylor", spacing, samples)
    near = np.abs(pixel) < 5
    found = float((kernel * pixel**2)[near].sum() / kernel.sum())
    assert found == pytest.approx(variance + 1 / 12 + (1 - 1 / samples**2) / 12, rel=0.1)  # tails are cut differently


@pytest.mark.parametrize("window", ["sinc", "gaussian"])
def test_the_nearest_width_of_a_kernel_of_its_own_kind(loop: Any, window: str) -> None:
    pixel, width = 0.5 * np.arange(-loop.REACH, loop.REACH + 1.0), 1.3
    kernel = np.sinc(0.8858929 * pixel / width) ** 2 if window == "sinc" else 2.0 ** (-4.0 * (pixel / width) ** 2)
    # limits of the search: 1e-5 of its bracket
    assert loop.best_width(kernel / kernel.sum(), 0.5, window) == pytest.approx(width, rel=1e-3)


def test_half_power_width_of_a_gaussian(loop: Any) -> None:
    x = np.arange(-3.0, 3.0, 0.05)
    # linear interpolation of a parabola: curvature / 8 x step^2 against the slope at half power, under 1e-3
    assert loop.half_power_width(2.0 ** (-4.0 * (x / 1.1) ** 2), 0.05) == pytest.approx(1.1, rel=2e-3)


def test_further_degrees_are_test_views(gotcha: Any, tmp_path: Path) -> None:
    for name in ("az001", "az003", "az017", "az004"):
        path = gotcha.source(tmp_path, name)
        path.parent.mkdir(exist_ok=True)
        path.touch()
    assert gotcha.views_in(tmp_path) == ["az001", "az002", "az003", "az004", "az017"]


@pytest.mark.measured
def test_two_views_predict_the_third(gotcha: Any, measured_data: Path, tmp_path: Path) -> None:
    """What must hold of the flat scene, whose learned model can be no more than a constant per region."""
    path = gotcha.heights_only(gotcha.prepare(measured_data, tmp_path, flat=True, device="cpu"))
    learned = learning.run(path, tmp_path / "learned", device="cpu", options=LearnOptions(starts=1))
    fitted = Scene.load(tmp_path / "learned" / "scene.toml")
    found = evaluate(fitted, device="cpu")
    (test,) = (i for i in found.images if i.view.role == "test")
    made = gotcha.simple_predictions(fitted, found) | {"learned": test.simulated}
    mask = test.interior & np.isfinite(made["mean of az001 and az002"])
    left = {name: d.mean() for name, d in gotcha.compare(test, made, mask).deviances.items()}
    # They differ in the pixels that hold two regions, about a tenth of all, where a constant takes one of them.
    assert left["learned"] == pytest.approx(left["one constant per flat region"], rel=0.03)
    assert left["learned"] < 0.8 * left["one constant"]
    assert left["mean of az001 and az002"] < 0.85 * left["learned"]
    over_grass = gotcha.brightness(fitted, found, learned)
    for name, decibel in OVER_GRASS_DB.items():
        assert over_grass[name]["over_grass_db"] == pytest.approx(decibel, abs=0.1), name
    floor = gotcha.speckle_floor(fitted, test, gotcha.pure_speckle(measured_data, fitted, gotcha.SAMPLES, "cpu"), mask)
    assert floor["left"]["one constant"] < left["mean of az001 and az002"]


@pytest.mark.measured
def test_reflectors_have_the_width_that_theory_gives_them(gotcha: Any, measured_data: Path, bodies: Scene) -> None:
    found = gotcha.impulse_response(measured_data, bodies, "cpu")
    for one in found["reflectors"]:
        # 0.3 m of plate are no point: 0.04 m of range spread in quadrature is 1 %; grass 33 dB below, 2 % of amplitude
        assert one["azimuth"]["width_m"] == pytest.approx(one["azimuth"]["theory_m"], rel=0.02)
        assert one["range"]["width_m"] == pytest.approx(one["range"]["theory_m"], rel=0.04)
        for axis in ("range", "azimuth"):
            np.testing.assert_allclose(one[axis]["shares"], one[axis]["theory_shares"], atol=0.05)
