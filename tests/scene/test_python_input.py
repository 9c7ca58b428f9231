"""What the Python API takes in a scene's place, and that bad values end in one InputError."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import SOIL, box, ground, mesh_of, scene_of, view

import warpsar
from warpsar.world.library.fill import material
from warpsar.world.tables import Table

pytestmark = pytest.mark.unit

ROOT = Path(__file__).resolve().parents[2]
TABLES = [warpsar.Radar, warpsar.Grid, warpsar.Sampling, warpsar.Material, warpsar.View]


def small(**changed: Any) -> warpsar.Scene:
    mesh = mesh_of(lawn=ground(6.0), shed=box((-1, -1, 0), (1, 1, 1)))
    return replace(scene_of(mesh, [view(0.0, 40.0, name="one")], shape=(8, 8), rays_per_pixel=4.0), **changed)


TAKES_A_SCENE = {
    "simulate": {},
    "learn": {},
    "evaluate": {},
    "diagnose": {},
    "slc": {},
    "phase_history": {},
    "rcs": {"azimuths_deg": [0.0]},
    "rcs_gradients": {"azimuths_deg": [0.0], "parameters": ["soil.eps_r"]},
    "renderer": {},
}


def test_every_function_of_a_scene_is_here() -> None:
    functions = {name: getattr(warpsar, name) for name in warpsar.__all__ if inspect.isfunction(getattr(warpsar, name))}
    assert {name for name, one in functions.items() if "scene" in inspect.signature(one).parameters} == set(
        TAKES_A_SCENE
    )


@pytest.mark.parametrize("name", TAKES_A_SCENE)
def test_a_path_stands_for_its_scene(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The file is opened: what is wrong in it is said. What is neither a scene nor a path is refused."""
    call: Callable[..., Any] = getattr(warpsar, name)
    (tmp_path / "scene.toml").write_text("[radar]\n")
    for path in (tmp_path / "scene.toml", str(tmp_path / "scene.toml")):
        with pytest.raises(warpsar.InputError, match=r"scene\.toml: .*things are wrong"):
            call(path, device="cpu", **TAKES_A_SCENE[name])
    with pytest.raises(warpsar.InputError, match=r"scene: found 3; must be a warpsar\.Scene, or the path"):
        call(3, device="cpu", **TAKES_A_SCENE[name])


def test_a_path_gives_the_images_of_its_scene(tmp_path: Path) -> None:
    small().save(tmp_path / "scene.toml")
    (by_path,) = warpsar.simulate(str(tmp_path / "scene.toml"), device="cpu")
    (by_scene,) = warpsar.simulate(warpsar.Scene.load(tmp_path / "scene.toml"), device="cpu")
    assert np.array_equal(by_path.beta0["HH"], by_scene.beta0["HH"])


def test_a_surface_of_the_library_goes_by_its_name(tmp_path: Path) -> None:
    scene = small(materials={"lawn": "grass", "shed": warpsar.Material(**SOIL)})
    assert scene.materials["lawn"] == material("grass", scene.radar.frequency_hz)
    scene.save(tmp_path / "scene.toml")
    assert 'library = "grass"' in (tmp_path / "scene.toml").read_text()
    assert warpsar.Scene.load(tmp_path / "scene.toml").materials == scene.materials
    with pytest.raises(warpsar.InputError, match=r"materials\.lawn: library: found 'gras'; .*did you mean grass"):
        replace(scene, materials={**scene.materials, "lawn": "gras"})
    low = scene.radar.model_copy(update={"frequency_hz": 2e8})
    said = small(radar=low, materials={"lawn": "water_calm", "shed": "grass"}).warnings
    assert any("extrapolation" in one for one in said)


@pytest.mark.parametrize("table", TABLES)
def test_a_bad_key_of_a_table_is_an_input_error(table: type[Table]) -> None:
    with pytest.raises(warpsar.InputError, match=rf"(?s){table.__name__}: .*colour: unknown key; must be one of"):
        table(colour="green")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: warpsar.Radar(frequency_hz="x", polarizations=("HH",)), "frequency_hz: found 'x'"),
        (lambda: warpsar.Radar(polarizations=("HH",)), "frequency_hz: missing"),
        (lambda: warpsar.Grid(shape=(0, 3), spacing_m=(1.0, 1.0)), r"shape\.0: found 0"),
        (lambda: warpsar.View(name="a", azimuth_deg=0, incidence_deg=40, looks="four"), "looks: found 'four'"),
        (lambda: warpsar.View(name="a", azimuth_deg=0, incidence_deg=40, images={"HH": 3}), "images.HH: found 3"),
        (lambda: warpsar.Sampling(rays_per_pixel=1.0, rays_per_m2=1.0), "found both"),
        (lambda: small(mesh="scene.obj"), "mesh: found 'scene.obj'; must be a warpsar.Mesh"),
        (lambda: small(radar={"frequency_hz": 1e9}), "radar: found .*; must be a warpsar.Radar"),
        (lambda: small(grid=(8, 8)), "grid: found"),
        (lambda: small(sampling=4), "sampling: found 4"),
        (lambda: small(materials=["grass"]), "materials: found"),
        (lambda: small(materials={"lawn": 3, "shed": "grass"}), "materials: found"),
        (lambda: small(views=None), "views: found None"),
        (lambda: small(views=["one"]), "views: found"),
        (lambda: small(effects=["noise_floor"]), "effects: found"),
        (lambda: small(effects={"fog": {}}), r"effects\.fog"),
        (lambda: small(effects={"noise_floor": {"depth": 1.0}}), r"effects\.noise_floor\.depth: unknown key"),
        (lambda: small(effects={"noise_floor": {}}), r"effects\.noise_floor: found no key"),
        (lambda: small(reference_point_m=(0.0, 0.0)), "reference_point_m: found"),
        (lambda: small(reference_point_m="here"), "reference_point_m: found"),
        (lambda: small(accuracy_m=-1.0), "accuracy_m: found -1.0"),
        (lambda: small(origin=(48.0, 11.0)), "origin: found"),
        (lambda: small(collection={"mode": "spotlight"}), "collection: found"),
        (lambda: small(objects=[3]), "objects: found"),
        (lambda: warpsar.Scene.load(3), "path: found 3"),  # type: ignore[arg-type]
        (lambda: small().save(3), "path: found 3"),  # type: ignore[arg-type]
        (lambda: warpsar.simulate(small(), device="cpu", seed="x"), "seed: found 'x'; must be a whole number"),  # type: ignore[arg-type]
        (lambda: warpsar.simulate(small(), device="cpu", seed=-1), "seed: found -1"),
        (lambda: warpsar.simulate(small(), device="cpu", max_memory_gib=0), "max_memory_gib: found 0"),
        (lambda: warpsar.rcs(small(), "north", device="cpu"), "azimuths: found 'north'; must be one or more numbers"),
        (lambda: warpsar.LearnOptions(starts="two"), "--starts: found 'two'"),  # type: ignore[arg-type]
        (lambda: warpsar.LearnOptions(iterations=0), "--iterations: found 0"),
        (lambda: warpsar.DiagnoseOptions(most_effects=1.5), "--most-effects: found 1.5"),  # type: ignore[arg-type]
        (lambda: warpsar.learn(small(), device="cpu", options={"starts": 1}), "options: found"),  # type: ignore[arg-type]
        (lambda: warpsar.diagnose(small(), device="cpu", options=3), "options: found 3"),  # type: ignore[arg-type]
        (lambda: warpsar.coherence("one", "two"), "coherence: found 'one'"),  # type: ignore[arg-type]
    ],
)
def test_a_bad_value_is_an_input_error(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(warpsar.InputError, match=message):
        make()
