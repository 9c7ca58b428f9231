"""The gallery's scenes: each loads as written, and one is simulated and drawn."""

import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from conftest import ROOT, benchmark
from PIL import Image

from warpsar.io.images import read_channel
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.world.library.surfaces import SURFACES

PICTURES = ROOT / "docs" / "figures" / "gallery"


@pytest.fixture(scope="module")
def gallery() -> ModuleType:
    return benchmark("gallery")


NAMES = ["city_block", "airport", "ship", "vehicle", "terrain"]
NAMES += ["trihedrals", "forest", "bridge", "tank_farm", "wind_turbine"]


@pytest.mark.full
@pytest.mark.parametrize("name", NAMES)
def test_a_scene_is_whole(name: str, gallery: ModuleType, tmp_path: Path) -> None:
    """It loads; every material is one of the library, in the domain of its model; most of the mesh lies in the image
    (of the vehicle's lawn the middle)."""
    shot = gallery.SCENES[name](tmp_path)
    (tmp_path / "scene.toml").write_text(gallery.scene_text(shot, 4.0))
    scene = Scene.load(tmp_path / "scene.toml")
    assert all(material.library in SURFACES for material in scene.materials.values())
    assert {"point_spread", "noise_floor"} <= set(scene.effects)
    k = 2.0 * np.pi * 9.6e9 / 299792458.0
    for one in scene.materials.values():  # docs/scattering.md
        smooth = one.model == "two_scale" and k * one.rms_height_m < 0.3
        curved = one.model == "i2em" and k * one.rms_height_m < 3.0
        assert smooth or (curved and one.rms_height_m < 0.4 * one.correlation_length_m)
    (view,) = scene.views
    a, i = np.deg2rad([view.azimuth_deg, view.incidence_deg])
    at = scene.mesh.vertices[np.unique(scene.mesh.faces)] - scene.reference_point_m
    away = -at @ [np.sin(a) * np.sin(i), np.cos(a) * np.sin(i), np.cos(i)]
    across = at @ [np.cos(a), -np.sin(a), 0.0]
    half = np.array(scene.grid.shape) * scene.grid.spacing_m / 2.0
    assert ((np.abs(away) < half[0]) & (np.abs(across) < half[1])).mean() > 0.6


@pytest.mark.full
def test_the_corner_reflectors_are_corners(gallery: ModuleType, tmp_path: Path) -> None:
    """Three legs at right angles: a first try had walls at another angle, and hardly any echo of three bounces."""
    shot = gallery.SCENES["trihedrals"](tmp_path)
    (tmp_path / "scene.toml").write_text(gallery.scene_text(shot, 16.0))
    scene = Scene.load(tmp_path / "scene.toml")
    legs = [one.size_m[2] for one in scene.objects if one.size_m is not None]
    for one, leg in zip(scene.objects, legs, strict=True):
        assert one.size_m == pytest.approx((leg * 2**0.5, leg * 2**0.5, leg), abs=1e-4)
    image = simulate(scene, device="cpu")[0].beta0["HH"]
    assert image.max() > 1000 * np.median(image)


@pytest.mark.full
def test_one_command_makes_scene_images_and_picture(
    gallery: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["gallery.py", "bridge", "--out", str(tmp_path), "--rays-per-pixel", "2"])
    gallery.main()
    assert read_channel(tmp_path / "bridge" / "view_looks4.exr", "HH").shape == (260, 440)
    with Image.open(tmp_path / "bridge.webp") as picture:
        assert picture.width > 900


def test_pictures_are_small(gallery: ModuleType) -> None:
    assert sorted(gallery.SCENES) == sorted(NAMES) == sorted(path.stem for path in PICTURES.iterdir())
    assert all(path.stat().st_size < 100_000 for path in PICTURES.iterdir())


def test_no_words_are_cut(gallery: ModuleType) -> None:
    """Two rows and columns of white around every picture: title and axes end before the border."""
    for path in PICTURES.iterdir():
        with Image.open(path) as picture:
            pixels = np.asarray(picture.convert("L"))
        border = np.concatenate(
            [pixels[:2].ravel(), pixels[-2:].ravel(), pixels[:, :2].ravel(), pixels[:, -2:].ravel()]
        )
        assert border.min() > 200, path.name
