"""Scenes as users have them: every model of the ground, images of other polarizations, looks, spacings and frequencies.
Each is tried with nothing wrong, with a floor and with a box that are not declared."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from learning_scenes import measured
from one_body import BODY, BOX, town, views
from worlds import SOIL

from warpsar.diagnosis.command import run
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene

ROUGH = {"eps_r": 8.0, "rms_height_m": 0.005}
Made = Callable[[Path], Scene]


def by_table(folder: Path) -> Scene:
    table = folder / "sigma0.csv"
    table.write_text("incidence_deg,HH\n20,-8\n30,-10\n40,-12\n50,-14\n60,-16\n", encoding="utf-8")
    return town(soil={"model": "facet", "sigma0": table})


def two_frequencies(folder: Path) -> Scene:
    odd = [one.model_copy(update={"frequency_hz": 5.4e9 if k % 2 else 9.6e9}) for k, one in enumerate(views())]
    return town(odd)


MADE: dict[str, Made] = {
    "a table": by_table,
    "oh": lambda _: town(soil={"model": "oh", **ROUGH}),
    "dubois": lambda _: town(soil={"model": "dubois", **ROUGH}),
    "i2em": lambda _: town(
        soil={
            "model": "i2em",
            "eps_r": 8.0,
            "rms_height_m": 0.003,
            "correlation_length_m": 0.03,
            "spectrum": "exponential",
        }
    ),
    "two_scale": lambda _: town(soil={"model": "two_scale", **SOIL}),
    "a loss": lambda _: town(soil={**SOIL, "eps_r": (20.0, -6.0)}),
    "two lengths": lambda _: town(soil={**SOIL, "spectrum": "separable", "correlation_length_m": (0.02, 0.008)}),
    "all polarizations": lambda _: town(polarizations=("HH", "HV", "VH", "VV")),
    "oblong pixels": lambda _: town(shape=(88, 20), spacing_m=(0.25, 1.0)),
    "spherical waves": lambda _: town(views(slant_range_m=300.0)),
    "two frequencies": two_frequencies,
}


def verdict(scene: Scene, truth: Scene, folder: Path) -> tuple[list[str], bool]:
    """What `warpsar diagnose` says of images of another truth."""
    seen = {one.name: one for one in measured(truth, folder, looks=16.0, seed=3).views}
    given = [one.model_copy(update={"images": seen[one.name].images, "looks": 16.0}) for one in scene.views]
    replace(scene, views=given).save(folder / "scene.toml")
    content = run(folder / "scene.toml", folder / "out", device="cpu")
    return content["verdict"], content["unexplained"]


@pytest.mark.slow
@pytest.mark.parametrize("name", list(MADE))
def test_nothing_is_missing(name: str, tmp_path: Path) -> None:
    scene = MADE[name](tmp_path)
    assert verdict(scene, scene, tmp_path) == ([], False)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(MADE))
def test_a_floor_is_named(name: str, tmp_path: Path) -> None:
    scene = MADE[name](tmp_path)
    truth = replace(scene, effects={"noise_floor": {"level": 0.02}})
    assert verdict(scene, truth, tmp_path) == (["noise_floor"], False)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in MADE if name != "a table"])
def test_a_missing_box_is_named(name: str, tmp_path: Path) -> None:
    """On a ground of a table alone saturation is found beside the box, and the test views take it back: the answer is
    then `unexplained`, with the box."""
    scene = MADE[name](tmp_path)
    truth = with_objects(scene, [BOX], {"it": BODY})
    assert verdict(scene, truth, tmp_path) == (["missing_object"], False)
