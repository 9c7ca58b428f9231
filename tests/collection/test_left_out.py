"""Whatever a scene declares acts in a product, or the product names it: nothing is left out in silence."""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from effect_worlds import street, with_effect, working
from worlds import box, ground, mesh_of, scene_of, view

import warpsar
from warpsar.cli.main import COMMANDS, main
from warpsar.cli.simulate import PRODUCTS as SIMULATED
from warpsar.coherent.left_out import left_out
from warpsar.effects.base.product import PRODUCTS, Product
from warpsar.effects.registry import acting, get, names
from warpsar.scene.scene import Scene
from warpsar.world.collection import Collection

TABLES: dict[str, dict[str, Any]] = {name: table for name, table, radar in reversed(working()) if not radar}
"""Of every effect, strong enough to change a plane-wave image."""

SPOT = Collection(mode="spotlight", slant_range_m=10e3)
BLUR = {"range_fwhm_m": 1.5, "azimuth_fwhm_m": 1.5, "window": "taylor"}
"""Another one than that of `TABLES`."""
SLAB = {"eps_r": 4.0, "thickness_m": 0.002, "rms_height_m": 0.0}


def rough() -> Scene:
    """What has images and phase: the street of the tests of effects, with a track and a response."""
    terms = street().radar.model_copy(update={"terms": ("rough",)})
    return replace(street(), radar=terms, collection=SPOT, effects={"point_spread": BLUR})


def slabs() -> Scene:
    """What has an RCS and curves of it: two small plates, with the names of the street's views and materials."""
    mesh = mesh_of(soil=ground(0.1), brick=box((0.2, 0.2, 0.0), (0.25, 0.25, 0.05)))
    one, two = view(2.0, 42.0, name="v0"), view(80.0, 50.0, name="v1")
    materials = {"soil": SLAB, "brick": SLAB}
    made = scene_of(mesh, [one, two], materials=materials, shape=(16, 16), frequency_hz=3e9, polarizations=("HH", "VV"))
    return replace(made, radar=made.radar.model_copy(update={"terms": ("single",)}))


def curve_of(path: Path) -> None:
    """A curve of a few angles beside a scene file, declared in it."""
    with (path.parent / "curve.csv").open("w", newline="") as file:
        rows = [(3e9, 42.0, angle, -20.0 + 3.0 * np.cos(angle)) for angle in range(0, 60, 6)]
        csv.writer(file).writerows([("frequency_hz", "theta_deg", "phi_deg", "rcs_dbsm"), *rows])
    text = path.read_text(encoding="utf-8")
    path.write_text(text + '\n[[curves]]\nfile = "curve.csv"\npolarization = "HH"\n', encoding="utf-8")


WITH_CURVES = ("evaluate", "learn", "diagnose")
RUNS: dict[str, tuple[str, ...]] = {
    **{f"simulate --product {product}": ("simulate", "--product", product) for product in SIMULATED},
    "rcs": ("rcs", "--azimuths", "10,50", "--incidences", "42"),
    **{f"{command}, curves": (command,) for command in WITH_CURVES},
}
"""Every command that makes something of a scene's model, and how.

With images, `evaluate`, `learn` and `diagnose` render by the program of `simulate`.
"""
UNEXPLAINED = {"diagnose": 4}
"""The exit status of a run to its end: the curve is invented, no slab gives it, and `diagnose` must say so."""
WITHOUT_A_MODEL = {"new", "materials", "import", "uv", "view", "schema", "reflectors", "twin"}
"""They compute no image, phase or RCS of a scene file."""


def test_every_command_is_here() -> None:
    assert {words[0] for words in RUNS.values()} | WITHOUT_A_MODEL == set(COMMANDS)
    assert not {words[0] for words in RUNS.values()} & WITHOUT_A_MODEL
    assert set(TABLES) == set(names())


def run(scene: Scene, words: tuple[str, ...], folder: Path) -> tuple[str, dict[str, str]]:
    """What a command says, and the arrays and numbers that it writes, each by its digest."""
    folder.mkdir()
    scene.save(folder / "scene.toml")
    if words[0] in WITH_CURVES:
        curve_of(folder / "scene.toml")
    out = folder / "out"
    command, *options = words
    done = CliRunner().invoke(main, [command, str(folder / "scene.toml"), "-o", str(out), *options, "--device", "cpu"])
    assert done.exit_code in (UNEXPLAINED.get(command, 0), 2), done.output
    assert done.exit_code != 2 or not out.exists(), "a refusal left files behind"
    made = [path for path in sorted(out.rglob("*")) if path.suffix in (".exr", ".npz", ".csv")]
    assert made or done.exit_code == 2 or words[0] in WITH_CURVES
    return done.output, {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in made}


@pytest.mark.full
@pytest.mark.parametrize("product", RUNS)
def test_an_effect_acts_or_is_named(product: str, tmp_path: Path) -> None:
    """All effects at once. Those that do not act on the product are named; each of the others changes it."""
    words = RUNS[product]
    made_is = words[-1] if words[0] == "simulate" else "rcs"
    scene = rough() if words[0] == "simulate" else slabs()
    every = scene
    for name, table in TABLES.items():
        every = with_effect(every, name, table)
    said, _ = run(every, words, tmp_path / "every")
    silent = [name for name in names() if f"effects.{name}" not in said]
    assert silent == [name for name in names() if made_is in get(name).acts_on]
    if not silent:
        return
    _, plain = run(scene, words, tmp_path / "plain")
    for name in silent:
        _, made = run(with_effect(scene, name, TABLES[name]), words, tmp_path / name)
        assert made != plain, f"{product}: effects.{name} has neither an effect nor a message"


def slc(scene: Scene) -> list[np.ndarray]:
    return [image for made in warpsar.slc(scene, device="cpu") for image in made.images.values()]


def phase_history(scene: Scene) -> list[np.ndarray]:
    return [made.samples for made in warpsar.phase_history(scene, device="cpu")]


CALLS: dict[Product, Callable[[Scene], list[np.ndarray]]] = {"slc": slc, "phase-history": phase_history}
CALLED = {"slc": "a complex image", "phase-history": "a phase history"}


@cache
def plain(product: Product) -> list[np.ndarray]:
    return CALLS[product](rough())


def same(some: list[np.ndarray], others: list[np.ndarray]) -> bool:
    return all(np.array_equal(one, other) for one, other in zip(some, others, strict=True))


@pytest.mark.parametrize("name", names())
@pytest.mark.parametrize("product", CALLS)
def test_an_effect_acts_on_a_product_with_phase_or_is_refused_by_name(product: Product, name: str) -> None:
    """Its `acts_on` says which; its `in_place` is what the refusal tells to write."""
    scene = with_effect(rough(), name, TABLES[name])
    if product in get(name).acts_on:
        assert left_out(scene, product) == {}
        assert not same(CALLS[product](scene), plain(product))
        return
    says = rf"effects\.{name}: found in a scene for {CALLED[product]}, a product with phase on which it does not act"
    with pytest.raises(warpsar.InputError, match=says) as told:
        CALLS[product](scene)
    assert (get(name).in_place or "must be left out there") in str(told.value)


@pytest.mark.parametrize("product", CALLS)
def test_acts_on_is_what_decides(product: Product, monkeypatch: pytest.MonkeyPatch) -> None:
    """An effect that acts is refused as soon as its class no longer names the product, and nothing else is asked."""
    scene = with_effect(rough(), "view_gain", TABLES["view_gain"])
    assert not same(CALLS[product](scene), plain(product))
    monkeypatch.setattr(type(get("view_gain")), "acts_on", ("beta0",))
    with pytest.raises(warpsar.InputError, match=r"effects\.view_gain: found in a scene for"):
        CALLS[product](scene)


def test_all_effects_act_on_power_and_say_products_that_there_are() -> None:
    for name in names():
        assert "beta0" in get(name).acts_on
        assert set(get(name).acts_on) <= set(PRODUCTS)
        assert not get(name).in_place or set(get(name).acts_on) != set(PRODUCTS)


def test_an_image_of_power_leaves_nothing_out() -> None:
    every = rough()
    for name, table in TABLES.items():
        every = with_effect(every, name, table)
    every = replace(every, radar=every.radar.model_copy(update={"polarization_basis": "local"}))
    assert left_out(every, "beta0") == {}
    assert set(left_out(every, "rcs")) == {f"effects.{name}" for name in names()} | {"radar.polarization_basis"}


def test_what_stands_in_its_place_is_a_key_that_there_is() -> None:
    """Words of the refusals that look like keys of the scene file."""
    keys = {f"collection.{key}" for key in Collection.model_fields}
    keys |= {f"radar.{key}" for key in warpsar.Radar.model_fields}
    for name in names():
        words = get(name).in_place.replace(",", "").split()
        assert {word for word in words if "." in word} <= keys


@pytest.mark.parametrize("product", CALLS)
def test_a_neutral_effect_is_none_of_them(product: Product) -> None:
    scene = with_effect(rough(), "noise_floor", {"level": 0.0})
    scene = with_effect(scene, "view_gain", {"gain_db": {"v0": 0.0}})
    scene = with_effect(scene, "two_scale", {"slope_variance": 0.0})
    assert acting(scene) == ["point_spread"]
    assert left_out(scene, product) == {}
    assert same(CALLS[product](scene), plain(product))


def test_rcs_lists_them_in_its_json_and_goes_on(tmp_path: Path) -> None:
    scene = with_effect(with_effect(slabs(), "noise_floor", {"level": 5.0}), "view_gain", TABLES["view_gain"])
    words = RUNS["rcs"]
    _, plain = run(slabs(), words, tmp_path / "plain")
    said, made = run(scene, words, tmp_path / "declared")
    assert "warning: not applied" in said
    assert made["rcs.csv"] == plain["rcs.csv"]
    content = json.loads((tmp_path / "declared" / "out" / "rcs.json").read_text())
    assert content["not_applied"] == ["effects.view_gain", "effects.noise_floor"]
    assert any("effects.noise_floor" in one for one in content["warnings"])


# ---- other tables ----

RADAR = {
    "frequency_hz": 9.5e9,
    "polarizations": ("VV",),
    "slant_range_m": 5e3,
    "polarization_basis": "local",
    "terms": ("single",),
    "max_bounces": 2,
    "variant": "as_printed",
}
"""Another value for each key of [radar]."""
OF_A_TERM = {"max_bounces"}
"""Acts where several bounces are asked for alone."""
VIEW = {
    "azimuth_deg": 10.0,
    "stated_incidence_deg": 50.0,
    "frequency_hz": 9.5e9,
    "slant_range_m": 5e3,
}
"""Of a view, what says how it is made."""
FITTED = {"learn", "tolerance"}
"""Of [radar] and of a view, what says which angles a fit moves, and how well they are known; no image changes by it."""
OF_A_VIEW = {"depression_deg", "grazing_deg"}
"""Other words for the incidence."""
MEASURED = {"name", "images", "slc", "mask", "looks", "looks_estimated", "texture", "clipped_at", "role"}
"""Of a view, what says how its measured images are read and compared; nothing of how an image is made."""


def test_every_key_of_radar_and_views_is_here() -> None:
    assert {*RADAR, *FITTED} == set(warpsar.Radar.model_fields)
    assert {*VIEW, *OF_A_VIEW, *MEASURED, *FITTED} == set(warpsar.View.model_fields)


def changed(key: str, **table: Any) -> Scene:
    scene = rough()
    scene = replace(scene, collection=SPOT.model_copy(update={"slant_range_m": None}), views=scene.views[:1])
    base = scene.radar.model_copy(update={"slant_range_m": 10e3})
    if "radar" in table:
        return replace(scene, radar=base.model_copy(update={key: table["radar"]}))
    views = [one.model_copy(update={key: table["view"]}) for one in scene.views] if "view" in table else scene.views
    return replace(scene, radar=base, views=views)


@pytest.mark.parametrize(
    ("where", "key"),
    [*(("radar", key) for key in RADAR if key not in OF_A_TERM), *(("view", key) for key in VIEW)],
)
def test_a_key_acts_on_a_complex_image_or_is_named(where: str, key: str) -> None:
    value = {"radar": RADAR, "view": VIEW}[where][key]
    (plain,) = warpsar.slc(changed("", none=None), device="cpu")
    other = changed(key, **{where: value})
    if f"{where}.{key}" in left_out(other, "slc"):
        with pytest.raises(warpsar.InputError, match=rf"{where}\.{key}: found"):
            warpsar.slc(other, device="cpu")
        return
    (made,) = warpsar.slc(other, device="cpu")
    alike = made.images.keys() == plain.images.keys() and all(
        np.array_equal(made.images[pol], plain.images[pol]) for pol in plain.images
    )
    assert not alike, f"{where}.{key} has neither an effect nor a message"


@pytest.mark.parametrize("where", ["radar", "view"])
def test_what_says_what_is_fitted_changes_no_complex_image(where: str) -> None:
    tables = {"learn": ("azimuth_deg",), "tolerance": {"azimuth_deg": 0.5}}
    assert set(tables) == FITTED
    (before,) = warpsar.slc(changed("", none=None), device="cpu")
    for key, value in tables.items():
        other = changed(key, **{where: value})
        assert left_out(other, "slc") == {}
        (after,) = warpsar.slc(other, device="cpu")
        assert all(np.array_equal(after.images[pol], before.images[pol]) for pol in before.images)
