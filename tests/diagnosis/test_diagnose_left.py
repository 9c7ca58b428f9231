"""What is left at the end: dark pixels in the scan, and a description that a person can act on."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparisons import comparison
from learning_scenes import cube_scene, measured, noise_free
from test_diagnose import ANGLES, saved
from test_report import assert_alone
from worlds import view

from warpsar.compare.comparison import Comparison
from warpsar.compare.observation import Observation
from warpsar.diagnosis.command import run
from warpsar.diagnosis.dark.pixels import DarkPixels, impossible
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.left.shape import shape_of
from warpsar.diagnosis.left.summary import moves_with
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.role_metrics import role_metrics
from warpsar.diagnosis.scores.evidence import LARGEST
from warpsar.effects.registry import get
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.speckle.law import Law
from warpsar.speckle.lines import Lines
from warpsar.surface.stage import Stage
from warpsar.world.tables import Sampling

SIZE = 44
LOOKS = 16.0
# of SIZE rows; the cube's ground ends before rows 6 and 37, so that the outer bands lie where nothing is lit
ROWS = {"v0": [[3, 4], [20, 22], [40, 41]], "v1": [[2, 4], [24, 25], [39, 40]], "v2": [[4, 5], [22, 24], [40, 42]]}
LEVEL = 0.05


@dataclass(frozen=True)
class Plane:
    interior: np.ndarray
    looks: float = LOOKS

    @property
    def law(self) -> Law:
        return Law(self.looks)


def white() -> np.ndarray:
    found = np.zeros((13, 13))
    found[6, 6] = 1.0
    return found


def observation(measured: np.ndarray, interior: np.ndarray, dark: np.ndarray, looks: float = LOOKS) -> Observation:
    return Observation(view(10.0, 40.0), "HH", measured, interior, np.zeros_like(dark), dark, looks, False)


# lines of pixels


def test_a_row_adds_up_as_its_pixels() -> None:
    """z of n residuals c: c n / sqrt(n). Only 60 of the row's 64 pixels are judged."""
    mask = np.zeros((64, 64), bool)
    mask[5:30, 2:62] = True
    residual = np.zeros(mask.shape)
    residual[17] = 1.5
    found = Lines([Plane(mask)], white()).strongest([residual[mask]])
    assert (found.kind, found.rows, found.cols) == ("row", (17, 18), (2, 62))
    assert found.z == pytest.approx(1.5 * np.sqrt(60.0))
    turned = Lines([Plane(mask.T)], white()).strongest([residual.T[mask.T]])
    assert (turned.kind, turned.cols, turned.rows) == ("column", (17, 18), (2, 62))


def test_a_few_pixels_of_a_row_are_no_row() -> None:
    mask = np.zeros((64, 64), bool)
    mask[10, :7] = True
    residual = np.full(7, 8.0)
    assert Lines([Plane(mask)], white()).strongest([residual]).z == 0.0


def test_speckle_raises_the_alarm_as_often_as_declared() -> None:
    """-ln p of independent draws is exponential: over 2 with probability e^-2, within 4 standard errors of 400."""
    mask = np.zeros((40, 40), bool)
    mask[3:20, 3:37] = True
    lines = Lines([Plane(mask), Plane(mask.T, 1.0)], white())
    tail = lines.tail(1, LARGEST)
    random = np.random.default_rng(5)
    scores = []
    for _ in range(400):
        drawn = [np.sqrt(n) * (random.gamma(n, 1.0 / n, mask.sum()) - 1.0) for n in (LOOKS, 1.0)]
        found = lines.strongest([np.clip(one, -LARGEST, LARGEST) for one in drawn])
        scores.append(float(tail(abs(found.z))))
    share, expected = np.mean(np.array(scores) > 2.0), np.exp(-2.0)
    # the tail itself comes from 200 draws: twice the variance of 400
    assert abs(share - expected) < 4.0 * np.sqrt(3.0 * expected * (1.0 - expected) / 400)


# dark pixels


def dark_image() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(measured, lit, dark): lit in the middle at 1, dark above and below."""
    lit = np.zeros((40, 40), bool)
    lit[14:26] = True
    dark = np.zeros_like(lit)
    dark[2:7, 2:38] = dark[33:38, 2:38] = True
    return np.where(lit, 1.0, 0.0), lit, dark


def test_power_where_the_model_has_none_is_impossible() -> None:
    image, lit, dark = dark_image()
    image[4] += 0.5
    image[35, 10] += 1e-4  # a sidelobe
    one = DarkPixels.of(observation(image, lit, dark), np.where(lit, 1.0, 0.0))
    assert one.allowed == pytest.approx(0.1)
    power = impossible([one])[one.seen.view.name]
    assert np.isnan(power[~dark]).all()
    assert (power[4, 2:38] == 0.5).all()
    assert power[35, 10] == 0.0
    assert Lines([one], white()).strongest([one.residual]).rows == (4, 5)


def test_the_far_tail_of_a_smear_is_no_floor() -> None:
    """A Gaussian is nowhere 0: 12 rows from what is lit, exp(-r^2 / 2) is 1e-31 of it. A floor 60 dB down is power."""
    image, lit, dark = dark_image()
    rows = np.arange(40)[:, None]
    tail = np.exp(-0.5 * (np.maximum(np.abs(rows - 19.5) - 6.0, 0.0) / 1.0) ** 2)
    smeared = DarkPixels.of(
        observation(np.where(lit, 1.0, tail * np.ones((40, 40))), lit, dark), np.where(lit, 1.0, 0.0)
    )
    assert (smeared.measured[smeared.empty] > 0).all()
    assert not smeared.measures_power.any()
    floored = DarkPixels.of(observation(image + 1e-6, lit, dark), np.where(lit, 1.0, 0.0))
    assert np.array_equal(floored.measures_power, floored.empty)


def test_what_a_models_sidelobes_explain_is_no_unexplained_power() -> None:
    """Sidelobes of 4 dB more than the model has, 40 dB down: a response is not known better. Twenty times is power."""
    _, lit, dark = dark_image()
    modelled = np.where(lit, 1.0, 1e-4)
    for factor, share in ((2.5, 0.0), (20.0, 1.0)):
        one = DarkPixels.of(observation(np.where(lit, 1.0, factor * modelled), lit, dark), modelled)
        assert one.measures_power.sum() == dark.sum()  # a floor is not ruled out by zeros
        assert one.unexplained.sum() == share * dark.sum()


def test_a_floor_that_the_model_has_is_judged_by_its_speckle() -> None:
    """sqrt(L) (I - mu) / mu, and no more than a trace where the floor is fainter."""
    image, lit, dark = dark_image()
    for level, unit in ((0.4, 0.4), (0.02, 0.1)):
        modelled = np.where(lit, 1.0, level)
        one = DarkPixels.of(observation(image + 1.5 * modelled - image, lit, dark), modelled)
        assert one.residual == pytest.approx(np.sqrt(LOOKS) * 0.5 * level / unit)
        assert not one.empty.any()


def of(seen: Observation, modelled: np.ndarray) -> Comparison:
    return replace(comparison(seen.measured, modelled, border=0), seen=seen)


def test_metrics_count_dark_pixels() -> None:
    image, lit, dark = dark_image()
    image[4] += 0.5
    random = np.random.default_rng(1)
    image = np.where(lit, random.gamma(LOOKS, 1.0 / LOOKS, image.shape), image)
    seen = observation(image, lit, dark)
    found = role_metrics([of(seen, np.where(lit, 1.0, 0.0))])
    assert found is not None
    assert (found["dark_pixels"], found["dark_impossible"]) == (360, 36)
    assert found["dark_measured"] == pytest.approx(0.05)
    assert found["dark_modelled"] == 0.0
    assert found["dark_deviance"] is None
    modelled = np.where(lit, 1.0, 0.0)
    modelled[4] = 0.5
    after = role_metrics([of(seen, modelled)])
    assert after is not None
    assert (after["dark_impossible"], after["dark_modelled"]) == (0, pytest.approx(0.05))
    assert after["dark_deviance"] == pytest.approx(0.0)  # measured is modelled, to the bit
    assert after["deviance"] == found["deviance"]
    without = role_metrics([of(replace(seen, dark=np.zeros_like(dark)), modelled)])
    assert without is not None
    assert (without["dark_pixels"], without["dark_measured"]) == (0, None)


# rows that dark pixels know


def power_of(rows: list[int], *, looks: float = 1.0, known: slice = slice(2, 38)) -> dict[str, np.ndarray]:
    random = np.random.default_rng(3)
    image = np.full((40, 40), np.nan)
    for row in [*range(2, 9), *range(30, 38)]:
        image[row, known] = random.gamma(looks, 0.3 / looks, 36) if row in rows else 0.0
    return {"v0": image}


def test_rows_with_power_from_end_to_end_are_proposed() -> None:
    scene = cube_scene([view(10.0, 40.0, name="v0")], shape=40)
    table = {"level": {"v0": 0.1}, "rows": {"v0": [[7, 10], [20, 22]]}}
    found = get("interference").placed_in_the_dark(scene, table, power_of([4, 7, 33, 34]))
    assert found is not None
    # rows 8 and 9: one is known to be empty; what nothing is known of stays
    assert found["rows"] == {"v0": [[4, 5], [7, 8], [9, 10], [20, 22], [33, 35]]}
    assert found["level"]["v0"] == pytest.approx(0.3, rel=4.0 / np.sqrt(4 * 36))
    assert get("interference").check(scene, found) is None


def test_what_stands_in_a_part_of_a_row_is_no_row() -> None:
    scene = cube_scene([view(10.0, 40.0, name="v0")], shape=40)
    power = power_of([])
    power["v0"][3:6, 10:30] = 0.3  # an object over 20 of 36 pixels
    assert get("interference").placed_in_the_dark(scene, {}, power) is None
    assert get("noise_floor").placed_in_the_dark(scene, {}, power_of([4])) is None


# shapes


def field_of(kind: str) -> np.ndarray:
    random = np.random.default_rng(7)
    field = random.standard_normal((64, 64))
    if kind == "a point":
        field[20:23, 30:33] += 4.0
    elif kind == "a patch":
        field[20:29, 30:39] += 1.5
    elif kind == "a streak along azimuth":
        field[20, 10:43] += 2.5
    elif kind == "a streak along range":
        field[10:43, 20] += 2.5
    elif kind == "broad":
        field[10:50, 10:50] += 0.5
    elif kind == "periodic":
        field += 0.8 * np.cos(2.0 * np.pi * np.arange(64) / 8.0)[:, None]
    return field


@pytest.mark.parametrize(
    "kind", ["a point", "a patch", "a streak along azimuth", "a streak along range", "broad", "periodic"]
)
def test_shapes_are_told_apart(kind: str) -> None:
    shape, spectrum = shape_of(field_of(kind), np.ones((64, 64), bool), white(), (0.5, 0.25))
    assert shape.kind == kind
    if kind == "periodic":  # 8 pixels of 0.5 m
        assert spectrum.period_m == pytest.approx(4.0)
        assert (spectrum.peak_range, spectrum.peak_azimuth) == (pytest.approx(0.25), pytest.approx(0.0))
    if kind == "a patch":
        assert abs(shape.row - 24) <= 1
        assert abs(shape.col - 34) <= 1
        assert (shape.range_m, shape.azimuth_m) == (shape.rows * 0.5, shape.cols * 0.25)


def test_speckle_is_not_periodic() -> None:
    random = np.random.default_rng(2)
    found = [
        shape_of(np.sqrt(4.0) * (random.gamma(4.0, 0.25, (48, 48)) - 1.0), np.ones((48, 48), bool), white(), (1, 1))
        for _ in range(40)
    ]
    assert not any(spectrum.periodic for _, spectrum in found)


# surface or image


def residuals_of(folder: Path, more: Any) -> tuple[FitSetup, Scene, list[Observation], list[np.ndarray]]:
    """The truth's residuals, `more(name, image)` added to the noise-free image of each view."""
    views = [view(a, i, name=f"v{k}") for k, (a, i, _) in enumerate(ANGLES[:3])]
    truth = replace(cube_scene(views, polarizations=("HH",), shape=SIZE), sampling=Sampling(rays_per_pixel=256.0))
    images = noise_free(truth)
    for one, image in zip(truth.views, images, strict=True):
        image["HH"] = more(one.name, image["HH"])
    scene = measured(truth, folder, images=images)
    device = devices.resolve_device("cpu")
    setup = FitSetup(device, Rays(Stage.of(scene, device), scene.sampling.density_per_m2(scene.grid), 0), {})
    problem = FitProblem(scene, device, rays=setup.rays)
    found = []
    for seen, mu in zip(problem.observations, problem.modelled_as_declared(), strict=True):
        plane = np.zeros(seen.interior.shape)
        plane[seen.interior] = np.clip(np.sqrt(seen.looks) * (seen.values / mu - 1.0), -8.0, 8.0)
        found.append(plane)
    return setup, scene, problem.observations, found


def test_rows_of_the_image_stay_in_the_image(tmp_path: Path) -> None:
    def more(name: str, image: np.ndarray) -> np.ndarray:
        image[20:22] += np.median(image[image > 0])
        return image

    found = moves_with(*residuals_of(tmp_path, more), 1.0)
    assert found.way == "image"
    assert found.z_image > 2.0 * abs(found.z_surface)


def test_a_brighter_material_moves_with_the_surface(tmp_path: Path) -> None:
    def more(name: str, image: np.ndarray) -> np.ndarray:
        return image

    setup, scene, seen, residuals = residuals_of(tmp_path, more)
    # a patch of ground east of the cube, brighter by half
    for one, residual in zip(seen, residuals, strict=True):
        hits = setup.rays.hits(scene, one.view, [])
        points, pixel = hits.point.numpy(), hits.pixel.numpy()
        patch = (abs(points[:, 0] - 5.0) < 1.2) & (abs(points[:, 1] - 4.0) < 1.2) & (points[:, 2] < 0.01)
        lit = np.isin(np.arange(residual.size), pixel[patch]).reshape(residual.shape) & one.interior
        residual[lit] += 0.5 * np.sqrt(one.looks)
    found = moves_with(setup, scene, seen, residuals, 1.0)
    assert found.way == "surface"
    assert moves_with(setup, scene, seen[:1], residuals[:1], 1.0).way == "one view"


def test_speckle_alone_moves_with_neither(tmp_path: Path) -> None:
    found = moves_with(*residuals_of(tmp_path, lambda name, image: image), 1.0)
    assert found.way == "neither"
    assert max(abs(found.z_surface), abs(found.z_image)) < 4.0


# the whole


def striped(folder: Path) -> Scene:
    """The cube from four sides at the true materials; the images hold three bands of interference a view."""
    views = [view(a, i, name=f"v{k}", role=role) for k, (a, i, role) in enumerate(ANGLES)]
    effects = {"interference": {"level": dict.fromkeys(ROWS, LEVEL), "rows": ROWS}}
    truth = replace(
        cube_scene(views, polarizations=("HH",), shape=SIZE), effects=effects, sampling=Sampling(rays_per_pixel=256.0)
    )
    return replace(measured(truth, folder), sampling=Sampling(rays_per_pixel=64.0))


OPTIONS = DiagnoseOptions(draws=400, starts=0, most_effects=2)


@pytest.mark.parametrize(
    "bodies", [pytest.param(False, marks=pytest.mark.full), pytest.param(True, marks=pytest.mark.slow)]
)
def test_all_rows_are_found_in_the_dark_too(bodies: bool, tmp_path: Path) -> None:
    """Beside bodies that might move, too, whose poses take most of the time."""
    saved(replace(striped(tmp_path), effects={}), tmp_path)
    options = replace(OPTIONS, bodies=bodies)
    content = run(tmp_path / "scene.toml", tmp_path / "out", device="cpu", options=options)
    assert content["verdict"] == ["interference"]
    assert content["unexplained"] is False
    assert content["effects"]["interference"]["rows"] == ROWS
    for value in content["effects"]["interference"]["level"].values():
        assert value == pytest.approx(LEVEL, rel=0.1)
    before, after = (content[when]["train"] for when in ("before", "after"))
    assert before["dark_impossible"] > 200
    assert after["dark_impossible"] == 0
    assert before["dark_pixels"] == after["dark_pixels"]
    assert after["dark_modelled"] == pytest.approx(after["dark_measured"], rel=0.05)
    (step,) = content["steps"]
    assert step["signature"]["outcome"] == "confirmed"
    assert content["left_at_the_end"]["description"]["sentences"][0].startswith("What is left needs no explanation")


@pytest.mark.slow
def test_rows_that_remain_in_the_dark_raise_the_alarm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The scene declares the lit rows alone, and holds them: what lies in dark pixels cannot be explained."""
    scene = striped(tmp_path)
    table = {"level": dict.fromkeys(ROWS, LEVEL), "rows": {**ROWS, "v0": [[20, 22]]}, "fixed": True}
    saved(replace(scene, effects={"interference": table}), tmp_path)
    content = run(tmp_path / "scene.toml", tmp_path / "out", device="cpu", options=OPTIONS)
    assert content["verdict"] == []
    assert content["unexplained"] is True
    left = content["left_at_the_end"]
    assert left["minus_log_p"] < left["threshold"] < left["dark"]["minus_log_p"]
    assert (left["dark"]["kind"], left["dark"]["possible"]) == ("row", False)
    assert tuple(left["dark"]["rows"]) in ((3, 4), (40, 41))
    about = left["description"]
    assert (about["where"], about["image"], about["ratio_db"]) == ("dark", "v0 HH", None)
    assert about["shape"]["kind"] == "a streak along azimuth"
    assert about["shape"]["row"] in (3, 40)
    assert [one["image"] for one in about["in_the_dark"] if one["impossible"]] == ["v0 HH"]
    near = about["nearest"][0]
    assert (near["effect"], near["test"]) == ("interference", "places")
    assert "[3, 4]" in near["against"]
    assert len(about["nearest"]) == 3
    first = about["sentences"][0]
    assert first.startswith("What is left is strongest in dark pixels of v0 HH, a streak along azimuth about row ")
    assert first in capsys.readouterr().err
    text = assert_alone((tmp_path / "out" / "report.html").read_text(encoding="utf-8")).text
    for sentence in about["sentences"]:
        assert sentence in text
    assert near["against"] in text
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text())["left_at_the_end"]["dark"] == {
        **left["dark"],
        "rows": list(left["dark"]["rows"]),
        "cols": list(left["dark"]["cols"]),
    }
