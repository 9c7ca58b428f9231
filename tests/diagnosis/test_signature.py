"""An effect's name is earned: its own test confirms it where it is right, and refuses what only looks like it."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learning_scenes import cube_scene, measured, noise_free, speckle
from scipy.ndimage import gaussian_filter1d
from test_diagnose import ANGLES, SIZE
from worlds import view

from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.frozen import frozen
from warpsar.diagnosis.models.refit import Fitted, fit_model
from warpsar.diagnosis.turn.signature import scaled, signature
from warpsar.effects.base.signature import SeenImage, Signature, looks_on, of_all, power_in
from warpsar.effects.registry import get, names
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.world.tables import Sampling

Change = Callable[[str, np.ndarray], np.ndarray]
BLUR = {"range_fwhm_m": 1.0, "azimuth_fwhm_m": 1.0, "window": "gaussian"}
ROWS = {"level": {"v0": 0.05}, "rows": {"v0": [[3, 4], [20, 22], [40, 41]]}}


def of(name: str, table: Mapping[str, Any], folder: Path, change: Change | None = None, *, looks: float = 16.0) -> Any:
    """The signature of an effect in images that hold it, or `change(view, image)` of images that do not.

    The surface is known and the effect is fitted: a test that needs more than that could not refuse a name.
    """
    views = [view(a, i, name=f"v{k}") for k, (a, i, _) in enumerate(ANGLES[:3])]
    bare = replace(cube_scene(views, polarizations=("HH",), shape=SIZE), sampling=Sampling(rays_per_pixel=256.0))
    truth = bare if change is not None else replace(bare, effects={name: dict(table)})
    images = noise_free(truth)
    if change is not None:
        images = [{"HH": change(one.name, image["HH"])} for one, image in zip(views, images, strict=True)]
    scene = replace(measured(truth, folder, looks=looks, images=images), effects={})
    return asked(scene, name, table, fit=change is not None)


def asked(scene: Scene, name: str, table: Mapping[str, Any], *, fit: bool = False) -> Signature:
    device = devices.resolve_device("cpu")
    stage, density = Stage.of(scene, device), scene.sampling.density_per_m2(scene.grid)
    one, two = (FitSetup(device, Rays(stage, density, seed), {}) for seed in (0, 1))
    setup = replace(one, observations=frozen(one, two, scene))
    with_it = replace(scene, effects={name: dict(table)})
    if fit:
        with_it = fit_model(setup, with_it, 0, 0).scene
    base, fitted = (Fitted(each, setup.problem(each), np.zeros(0), 0.0, 0.0, 0) for each in (scene, with_it))
    return signature(setup, base, fitted, name)


def test_a_blur_is_confirmed_by_its_edges(tmp_path: Path) -> None:
    found = of("point_spread", BLUR, tmp_path)
    assert found.outcome != "against"
    assert found.numbers["edges: value"] == pytest.approx(1.0, abs=4.0 * found.numbers["edges: error"])


def test_a_blur_of_far_range_alone_is_no_point_spread(tmp_path: Path) -> None:
    """Sharp in the nearest two fifths, and a Gaussian of 3 pixels (standard deviation) along azimuth beyond them."""

    def defocused(name: str, image: np.ndarray) -> np.ndarray:
        far = image[2 * SIZE // 5 :]
        far[:] = gaussian_filter1d(far, 3.0, axis=1)
        return image

    found = of("point_spread", BLUR, tmp_path, defocused, looks=64.0)
    assert found.outcome == "against"
    assert "near range holds" in found.text


def test_a_floor_is_confirmed_in_shadows(tmp_path: Path) -> None:
    found = of("noise_floor", {"level": 0.02}, tmp_path)
    assert found.outcome == "confirmed"
    assert found.numbers["share"] == pytest.approx(1.0, abs=4.0 * found.numbers["error"])


def test_power_in_the_light_alone_is_no_floor(tmp_path: Path) -> None:
    """What brightens the lit pixels and leaves shadows black is another thing."""
    found = of("noise_floor", {"level": 0.02}, tmp_path, lambda name, image: image + 0.02 * (image > 0))
    assert found.outcome == "against"
    assert found.numbers["share"] == 0.0
    assert "in shadows" in found.text


def test_rows_go_on_in_the_dark(tmp_path: Path) -> None:
    assert of("interference", ROWS, tmp_path).outcome == "confirmed"


def test_half_a_row_is_no_interference(tmp_path: Path) -> None:
    def half(name: str, image: np.ndarray) -> np.ndarray:
        if name == "v0":
            image[20:22, : SIZE // 2] += 0.5
        return image

    found = of("interference", {"level": {"v0": 0.2}, "rows": {"v0": [[20, 22]]}}, tmp_path, half)
    assert found.outcome == "against"
    assert "half" in found.text


def test_a_shift_of_one_half_is_no_registration(tmp_path: Path) -> None:
    def shifted(name: str, image: np.ndarray) -> np.ndarray:
        image[:, SIZE // 2 :] = np.roll(image[:, SIZE // 2 :], 1, axis=0)
        return image

    found = of("registration", {"range_m": 0.2, "azimuth_m": 0.0}, tmp_path, shifted)
    assert found.outcome == "against"
    whole = of("registration", {"range_m": 0.2, "azimuth_m": 0.1}, tmp_path)
    assert whole.outcome == "confirmed"


def test_a_clip_is_no_compression(tmp_path: Path) -> None:
    """Clipped after speckle: the images have a top level."""
    scene = compressed(tmp_path, lambda power: np.minimum(power, np.percentile(power[power > 0], 90.0)))
    found = asked(scene, "saturation", {"exponent": 0.8})
    assert found.outcome == "against"
    assert "clipped" in found.text
    assert found.numbers["clipped_pixels"] > 20


def test_compression_of_measured_power_is_confirmed_by_its_speckle(tmp_path: Path) -> None:
    """Power to the g has L / g^2 looks; g = 0.4 makes 6.25 times as many."""
    scene = compressed(
        tmp_path, lambda power: np.where(power > 0, power, 0.0) ** 0.4 * np.median(power[power > 0]) ** 0.6
    )
    found = asked(scene, "saturation", {"exponent": 0.4})
    assert found.outcome == "confirmed"
    assert found.numbers["looks_dim"] == pytest.approx(0.4**-2, rel=4.0 * found.numbers["log_error"])


def test_compression_before_speckle_is_neither_confirmed_nor_refused(tmp_path: Path) -> None:
    found = of("saturation", {"exponent": 0.7}, tmp_path)
    assert found.outcome == "none"
    assert found.numbers["looks_dim"] == pytest.approx(1.0, rel=4.0 * found.numbers["log_error"])


def compressed(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> Scene:
    """Speckled images, changed as a receiver changes them."""
    views = [view(a, i, name=f"v{k}") for k, (a, i, _) in enumerate(ANGLES[:3])]
    bare = replace(cube_scene(views, polarizations=("HH",), shape=SIZE), sampling=Sampling(rays_per_pixel=256.0))
    random = np.random.default_rng(4)
    images = [{"HH": change(one["HH"] * speckle(random, one["HH"].shape, 16.0))} for one in noise_free(bare)]
    return measured(bare, folder, images=images, noise=lambda random, shape, looks: np.ones(shape))


@pytest.mark.parametrize("name", names())
def test_scaling_an_effect_goes_through_neutral(name: str) -> None:
    """Amplitude 1 is the table itself; 0 is neutral; what has no neutral value stays."""
    table = get(name).rate_case
    assert scaled(name, table, 1.0) == pytest.approx(table) if not _nested(table) else scaled(name, table, 1.0) == table
    if any(np.isinf(p.neutral) for p in get(name).parameters):
        return  # a beam: amplitude 0 is an infinite width
    finite = {p.name: p for p in get(name).parameters if np.isfinite(p.neutral) and p.name in table}
    for key, value in scaled(name, table, 0.0).items():
        if key in finite:
            values = value.values() if finite[key].keyed_by else [value]
            assert all(one == finite[key].neutral for one in values)


def _nested(table: Mapping[str, Any]) -> bool:
    return any(isinstance(value, Mapping | str | list) for value in table.values())


def flat(ratio: np.ndarray, looks: float) -> SeenImage:
    ones = np.ones(ratio.shape)
    full = np.ones(ratio.shape, bool)
    return SeenImage(
        view(10.0, 40.0), "HH", looks, False, (0.5, 0.5), ratio, ones, ones, full, full, full.astype(int), ("ground",)
    )


@pytest.mark.parametrize("looks", [1.0, 4.0, 16.0])
def test_looks_of_even_ground_are_found(looks: float) -> None:
    """Twice the declared looks are found as 2, within 4 of their stated errors."""
    ratio = np.random.default_rng(1).gamma(2.0 * looks, 0.5 / looks, (80, 80))
    one = flat(ratio, looks)
    found, error = looks_on([one], [one.lit])
    assert error < 0.2
    assert np.log(found / 2.0) == pytest.approx(0.0, abs=4.0 * error)


def test_a_few_bright_pixels_do_not_refuse_a_floor() -> None:
    ratio = np.random.default_rng(1).gamma(1.0, 1.0, (40, 40))
    ratio[:6] += 50.0  # bounces in 15 % of the shadow
    one = flat(ratio, 1.0)
    assert power_in([one], [one.dark], "the floor", "in shadows").outcome == "confirmed"
    empty = flat(0.2 * ratio, 1.0)
    assert power_in([empty], [empty.dark], "the floor", "in shadows").outcome == "against"


def test_what_speaks_against_a_name_decides() -> None:
    tests = [Signature(outcome, outcome) for outcome in ("confirmed", "none", "against")]
    assert of_all(tests).outcome == "against"
    assert of_all(tests[:2]) == Signature("confirmed", "confirmed")
    assert of_all([]).outcome == "none"
