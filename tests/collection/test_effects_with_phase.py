"""Effects on complex images and phase histories: what an effect does to a mean is what it does to the power image.

Both products come from one scene, by two engines that share the effects' tables alone: rays and bins for power,
scatterers with phase for the others. The response is stated once, by `effects.point_spread`.

What is compared is the change, with the effect over without it, on one set of seeds. Means themselves differ by more
than 1 % here: amplitudes fall with the distance as spherical waves do, which is (R0 / R)^4 in power, and see each place
under its own angle; a power image of a plane wave does neither. Over these 128 m that makes 5 % in a plane wave, and
18 % at R0 = 1 km. Both factors are in both images of a ratio.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from collected_scenes import ROUGH, field
from scipy.special import gamma
from worlds import mesh_of, plate

import warpsar
from warpsar.collection.slc import focused
from warpsar.effects.base.product import Product
from warpsar.runtime import devices
from warpsar.world.collection import Collection

PIXEL_M = 1.0
"""As wide as the response: pixels are about as many looks as there can be."""
BLUR = {"range_fwhm_m": PIXEL_M, "azimuth_fwhm_m": PIXEL_M, "window": "taylor"}
EDGE = 8
"""Pixels at a border, or at the edge between two grounds, that are no part of an area: the response's first ones."""
Areas = list[tuple[slice, slice]]


def lawn_and_road(pixels: int) -> warpsar.Mesh:
    """Two grounds side by side in azimuth, wider than the image of a radar in the north at an incidence of 45."""
    wide, deep = 0.6 * pixels * PIXEL_M, 0.8 * pixels * PIXEL_M
    west, east = (plate((x, -deep, 0.0), (wide, 0.0, 0.0), (0.0, 2.0 * deep, 0.0)) for x in (-wide, 0.0))
    return mesh_of(lawn=west, road=east)


def scene(
    pixels: int, effects: dict[str, Any], slant_range_m: float | None = None, away_m: float | None = None
) -> warpsar.Scene:
    """Lawn in the left half of the image, road 6 dB below it in the right one. Effects per view take a second view.

    With `slant_range_m` [m] the power image is a strip-map too; without, it is a plane wave, and the sensor of the
    other products 10 km away, or `away_m`.
    """
    two = any("v0" in value for table in effects.values() for value in table.values() if isinstance(value, dict))
    angles = {"v0": 0.0, **({"v1": 90.0} if two else {})}
    made = warpsar.Radar(frequency_hz=9.6e9, polarizations=("HH",), terms=("rough",), slant_range_m=slant_range_m)
    return warpsar.Scene(
        mesh=lawn_and_road(pixels),
        radar=made,
        grid=warpsar.Grid(shape=(pixels, pixels), spacing_m=(PIXEL_M, PIXEL_M)),
        materials={
            "lawn": warpsar.Material(**ROUGH),
            "road": warpsar.Material(**{**ROUGH, "rms_height_m": 0.5 * ROUGH["rms_height_m"]}),
        },
        views=[warpsar.View(name=name, azimuth_deg=angle, incidence_deg=45.0) for name, angle in angles.items()],
        collection=Collection(
            focus="direct",
            speed_m_s=100.0,
            slant_range_m=None if slant_range_m else away_m or 10e3,
            scatterers_per_cell=4.0,  # amplitudes are Gaussian themselves: the mean takes no more
        ),
        sampling=warpsar.Sampling(rays_per_pixel=64.0),
        effects={"point_spread": BLUR, **effects},
    )


def with_collection(one: warpsar.Scene, more: dict[str, Any]) -> warpsar.Scene:
    """The scene with other keys of `[collection]`."""
    assert one.collection is not None
    return replace(one, collection=one.collection.model_copy(update=more))


def power(one: warpsar.Scene) -> np.ndarray:
    """beta0 of the first view."""
    return warpsar.simulate(one, device="cpu")[0].beta0["HH"].astype(float)


def image(one: warpsar.Scene, seed: int) -> np.ndarray:
    """The complex image of the first view."""
    return warpsar.slc(one, device="cpu", seed=seed)[0].images["HH"].astype(complex)


def image_of_history(one: warpsar.Scene, seed: int) -> np.ndarray:
    """The phase history of the first view, backprojected."""
    found = focused(warpsar.phase_history(one, device="cpu", seed=seed)[0], one.grid, devices.resolve_device("cpu"))
    return found.images["HH"].astype(complex)


MAKE: dict[Product, Callable[[warpsar.Scene, int], np.ndarray]] = {"slc": image, "phase-history": image_of_history}


@cache
def without_effects(
    product: Product, pixels: int, draws: int, slant_range_m: float | None, two: bool, away_m: float | None
) -> Any:
    """Mean power over draws, and the power image, without an effect."""
    plain = scene(pixels, {"view_gain": {"gain_db": {"v0": 0.0}}} if two else {}, slant_range_m, away_m)
    return mean(product, plain, draws), power(plain)


def mean(product: Product, one: warpsar.Scene, draws: int) -> np.ndarray:
    """Mean power over draws of the surface and of what effects draw."""
    return np.mean([np.abs(MAKE[product](one, seed)) ** 2 for seed in range(draws)], axis=0)


@dataclass(frozen=True)
class Pair:
    """Mean power of the product, and the power image, with and without an effect."""

    made: np.ndarray
    expected: np.ndarray
    made_without: np.ndarray
    expected_without: np.ndarray

    @classmethod
    def of(
        cls,
        product: Product,
        name: str,
        table: dict[str, Any],
        *,
        pixels: int,
        draws: int,
        slant: float | None = None,
        away_m: float | None = None,
    ) -> Pair:
        """`slant`: as in `scene`. `away_m`: how far away the sensor of the product with phase is, in a plane wave."""
        found = scene(pixels, {name: table}, slant, away_m)
        without = without_effects(product, pixels, draws, slant, len(found.views) == 2, away_m)
        return cls(mean(product, found, draws), power(found), *without)

    def changes(self, area: tuple[slice, slice], before: tuple[slice, slice] | None = None) -> tuple[float, float]:
        """What the effect does to the mean of an area: in the product, in the power image. `before`: where that power
        was without the effect."""
        was = before or area
        made = self.made[area].mean() / self.made_without[was].mean()
        return float(made), float(self.expected[area].mean() / self.expected_without[was].mean())


def halves(pixels: int, rows: slice | None = None) -> Areas:
    """The inside of the lawn, and that of the road; all rows but those at the border, or some."""
    inside, middle = rows or slice(EDGE, pixels - EDGE), pixels // 2
    return [(inside, slice(EDGE, middle - EDGE)), (inside, slice(middle + EDGE, pixels - EDGE))]


def bands(pixels: int) -> Areas:
    """The halves, cut by range: a gain hardly changes over a few rows, so speckle weighs its values alike."""
    return [one for first in range(EDGE, pixels - EDGE, 8) for one in halves(pixels, slice(first, first + 8))]


# ---- gains: the speckle of both images is the same, so few draws will do ----

LARGE, SMALL = 128, 48
GAINS: dict[str, tuple[str, dict[str, Any], float | None]] = {
    "view_gain": ("view_gain", {"gain_db": {"v0": 2.0, "v1": -2.0}}, None),
    "antenna_pattern, plane wave": ("antenna_pattern", {"beamwidth_m": 200.0, "boresight_m": 20.0}, None),
    "antenna_pattern, strip-map": ("antenna_pattern", {"beamwidth_deg": 0.8, "boresight_deg": 0.1}, 10e3),
    "range_loss, plane wave": ("range_loss", {"per_m": 0.01}, None),
    "range_loss, strip-map": ("range_loss", {"exponent": 10.0}, 1e3),
}


@pytest.mark.full
@pytest.mark.parametrize("case", GAINS)
def test_a_gain_on_complex_images(case: str) -> None:
    name, table, slant = GAINS[case]
    pair = Pair.of("slc", name, table, pixels=LARGE, draws=4, slant=slant)
    changes = [pair.changes(area) for area in bands(LARGE)]
    assert max(abs(np.log(expected)) for _, expected in changes) > 0.3  # there is something to see
    for made, expected in changes:
        assert made == pytest.approx(expected, rel=0.01)


def test_a_gain_of_a_view_keeps_phases() -> None:
    """4 dB between two views are +2 dB in the first: its samples times 10^(2 / 20), to float32."""
    neutral, gain = ({"view_gain": {"gain_db": {"v0": value}}} for value in (0.0, 4.0))
    plain, found = image(scene(SMALL, neutral), 5), image(scene(SMALL, gain), 5)
    assert np.abs(found - 10.0**0.1 * plain).max() < 1e-4 * np.abs(plain).max()


@pytest.mark.full
@pytest.mark.parametrize("case", [case for case in GAINS if "strip-map" not in case])
def test_a_gain_on_phase_histories(case: str) -> None:
    name, table, slant = GAINS[case]
    pair = Pair.of("phase-history", name, table, pixels=SMALL, draws=2, slant=slant)
    changes = [pair.changes(area) for area in bands(SMALL)]
    assert max(abs(np.log(expected)) for _, expected in changes) > 0.1
    for made, expected in changes:
        assert made == pytest.approx(expected, rel=0.01)


# ---- positions: whole pixels, so that all power of an area was in one area before ----

SHIFTS: dict[str, tuple[dict[str, Any], tuple[int, int]]] = {
    # At azimuth 0, u is east: a metre of the world adds to the azimuth.
    "registration": ({"range_m": 3.0, "azimuth_m": -3.0, "east_m": 1.0}, (3, -2)),
    "aim_point": ({"range_m": {"v0": -2.0, "v1": 1.0}, "azimuth_m": {"v0": 3.0}}, (-2, 3)),
}


def across_the_edge(pixels: int, moved: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """The columns that get lawn for road, or road for lawn, where a shift changes the mean; and where they were."""
    first, last = sorted((pixels // 2, pixels // 2 + moved[1]))
    after = (slice(EDGE, pixels - EDGE), slice(first, last))
    before = tuple(slice(one.start - by, one.stop - by) for one, by in zip(after, moved, strict=True))
    return after, (before[0], before[1])


@pytest.mark.full
@pytest.mark.parametrize(
    ("product", "pixels", "draws"), [("slc", LARGE, 4), ("phase-history", SMALL, 2)], ids=["slc", "phase-history"]
)
@pytest.mark.parametrize("name", SHIFTS)
def test_a_shift_moves_power_as_in_the_power_image(name: str, product: Product, pixels: int, draws: int) -> None:
    """The sensor is 1,000 km away. From 10 km a phase history sees what is moved by 3 m from another side: its
    coherence with what it was is 0.98, so 128 looks of the strip would differ by 0.7 % in one standard error."""
    table, moved = SHIFTS[name]
    pair = Pair.of(product, name, table, pixels=pixels, draws=draws, away_m=1e6)
    after, before = across_the_edge(pixels, moved)
    made, expected = pair.changes(after, before)
    assert expected == pytest.approx(1.0, abs=1e-3)  # the power image moves whole pixels as they are
    assert made == pytest.approx(expected, rel=0.002)
    assert abs(np.log(pair.changes(after)[1])) > 0.3  # unmoved it is another mean
    assert abs(np.log(pair.changes(after)[0])) > 0.3


# ---- what is added: its own speckle, so looks count ----


@pytest.mark.full
def test_a_noise_floor_on_complex_images() -> None:
    """1 % is 3 to 4 standard errors of 20 draws."""
    pair = Pair.of("slc", "noise_floor", {"level": 0.003}, pixels=LARGE, draws=20)
    for area in halves(LARGE):
        made, expected = pair.changes(area)
        assert expected > 1.2
        assert made == pytest.approx(expected, rel=0.01)


@pytest.mark.full
def test_interference_on_complex_images() -> None:
    """In its rows and in no others. 1 % is 3 standard errors of 20 draws."""
    hit = slice(40, 100)
    table = {"level": {"v0": 0.003}, "rows": {"v0": [[hit.start, hit.stop]]}}
    pair = Pair.of("slc", "interference", table, pixels=LARGE, draws=20)
    for area in halves(LARGE, hit):
        made, expected = pair.changes(area)
        assert expected > 1.2
        assert made == pytest.approx(expected, rel=0.01)
    assert np.array_equal(pair.made[: hit.start], pair.made_without[: hit.start])
    assert np.array_equal(pair.made[hit.stop :], pair.made_without[hit.stop :])


@pytest.mark.full
def test_azimuth_ambiguities_on_complex_images() -> None:
    """A copy from either side. 1 % is 6 standard errors of 10 draws, in an area that all of a copy reaches."""
    pair = Pair.of("slc", "azimuth_ambiguity", {"level": 0.2, "offset_m": 20.0}, pixels=LARGE, draws=10)
    for area in halves(LARGE):
        made, expected = pair.changes(area)
        assert expected > 1.2
        assert made == pytest.approx(expected, rel=0.01)


def test_a_noise_floor_on_phase_histories_where_nothing_sends_back() -> None:
    """Beside a small field there is the floor alone, in both products. 4 standard errors, of one look a pixel."""
    level, draws = 0.004, 8
    made = scene(LARGE, {"noise_floor": {"level": level}})
    made = replace(made, mesh=field(8.0, 8.0), materials={"default": warpsar.Material(**ROUGH)})
    dark = np.ones((LARGE, LARGE), bool)
    dark[LARGE // 2 - 16 : LARGE // 2 + 16] = False
    assert power(made)[dark] == pytest.approx(level, rel=1e-3)  # the sidelobes of the field add 1e-5
    found = mean("phase-history", made, draws)[dark]
    assert found.mean() == pytest.approx(level, rel=4.0 / np.sqrt(draws * dark.sum()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "table"),
    [("noise_floor", {"level": 0.003}), ("azimuth_ambiguity", {"level": 0.2, "offset_m": 12.0})],
    ids=["noise_floor", "azimuth_ambiguity"],
)
def test_what_is_added_on_phase_histories(name: str, table: dict[str, Any]) -> None:
    """1 % is 3 standard errors or more of 60 draws."""
    pixels = 64
    pair = Pair.of("phase-history", name, table, pixels=pixels, draws=60)
    for area in halves(pixels):
        made, expected = pair.changes(area)
        assert expected > 1.1
        assert made == pytest.approx(expected, rel=0.01)


# ---- saturation: single samples ----


@pytest.mark.parametrize("focus", ["direct", "backprojection"])
def test_saturation_compresses_samples_and_keeps_their_phase(focus: str) -> None:
    """|s|^2 becomes p (|s|^2 / p)^e, by its formula; to float32."""
    exponent, pivot = 0.7, 0.005
    plain, found = (
        image(with_collection(scene(SMALL, effects), {"focus": focus}), 3)
        for effects in ({}, {"saturation": {"exponent": exponent, "pivot": pivot}})
    )
    share = np.abs(plain) ** 2 / pivot
    assert np.abs(found) ** 2 == pytest.approx(pivot * share**exponent, rel=1e-4)
    assert np.abs(np.angle(found * plain.conj())).max() < 1e-5


@pytest.mark.full
def test_saturation_of_one_look_lowers_the_mean_by_gamma() -> None:
    """E |s|^2e = gamma(1 + e) E(|s|^2)^e of one look: 0.9086 at 0.7 of what the power image says.

    The pivot is the power image's median, not that of the samples, which is 1.6 dB lower at one look. The same
    samples are in both means: the standard error of their ratio is 0.12 / sqrt(looks), under 0.1 % of 30,000 looks.
    """
    exponent = 0.7
    assert gamma(1.0 + exponent) == pytest.approx(0.9086, abs=1e-4)
    pixels, draws = 96, 12
    # Scatterers lie at random places, so the local mean varies: that lowers the compressed mean by 0.7 % of 4 in a
    # cell, and by 0.2 % of 16.
    dense = {"scatterers_per_cell": 16.0}
    plain, pressed = (
        with_collection(scene(pixels, effects), dense) for effects in ({}, {"saturation": {"exponent": exponent}})
    )
    made_without, made = (mean("slc", one, draws) for one in (plain, pressed))
    expected_without, expected = power(plain), power(pressed)
    for area in halves(pixels):
        # The compressed means, where the means differ beforehand (see above): by the power of their ratio.
        level = (made_without[area].mean() / expected_without[area].mean()) ** exponent
        found = made[area].mean() / (level * expected[area].mean())
        assert found == pytest.approx(gamma(1.0 + exponent), rel=0.005)


# ---- one name for the response, one for the noise ----

TEXT = """
[scene]
mesh = "field.obj"

[radar]
frequency_hz = 9.6e9
polarizations = ["HH"]
terms = ["rough"]

[image]
shape = [24, 24]
spacing_m = [0.5, 0.5]

[collection]
focus = "{focus}"
slant_range_m = 10e3
speed_m_s = 100.0
{collection}

[materials.default]
eps_r = 6.0
rms_height_m = 0.0012
correlation_length_m = 0.01

[[views]]
name = "one"
azimuth_deg = 30.0
incidence_deg = 40.0
{effects}
"""
OLD = "resolution_m = [0.7, 0.9]\nnoise_beta0 = 0.002"
SPREAD = '[effects.point_spread]\nrange_fwhm_m = 0.7\nazimuth_fwhm_m = 0.9\nwindow = "taylor"\n'
NOISE = "[effects.noise_floor]\nlevel = 0.002\n"


def written(folder: Path, collection: str, effects: str, focus: str = "direct") -> Path:
    path = folder / "scene.toml"
    (folder / "field.obj").write_text("v -8 -8 0\nv 8 -8 0\nv 8 8 0\nv -8 8 0\nf 1 2 3\nf 1 3 4\n")
    path.write_text(TEXT.format(focus=focus, collection=collection, effects=effects))
    return path


@pytest.mark.parametrize("focus", ["direct", "backprojection"])
def test_old_names_mean_the_new_ones(focus: str, tmp_path: Path) -> None:
    """Both products are the same to the bit. The power image is not: the old names act on products with phase."""
    with pytest.warns(FutureWarning) as told:
        old = warpsar.Scene.load(written(tmp_path, OLD, "", focus))
    said = [str(one.message) for one in told if one.category is FutureWarning]
    assert any("collection.resolution_m: is [effects.point_spread] now" in one for one in said)
    assert any("collection.noise_beta0: is [effects.noise_floor] now" in one for one in said)
    with warnings.catch_warnings():
        warnings.simplefilter("error", FutureWarning)
        new = warpsar.Scene.load(written(tmp_path, "", SPREAD + NOISE, focus))
    assert np.array_equal(image(old, 2), image(new, 2))
    histories = [warpsar.phase_history(one, device="cpu", seed=2)[0].samples for one in (old, new)]
    assert np.array_equal(*histories)
    assert power(old).min() == 0.0 or not np.allclose(power(old), power(new))


DOUBLES = {
    "resolution_m": ("resolution_m = [0.7, 0.9]", SPREAD, "point_spread"),
    "noise_beta0": ("resolution_m = [0.7, 0.9]\nnoise_beta0 = 0.002", NOISE, "noise_floor"),
}


@pytest.mark.parametrize("key", DOUBLES)
def test_what_is_stated_twice_is_refused(key: str, tmp_path: Path) -> None:
    collection, effects, name = DOUBLES[key]
    says = rf"collection\.{key}: found beside \[effects\.{name}\], which says the same"
    with pytest.warns(FutureWarning), pytest.raises(warpsar.InputError, match=says):
        warpsar.Scene.load(written(tmp_path, collection, effects))


@pytest.mark.parametrize("key", DOUBLES)
def test_what_is_stated_twice_in_memory_is_refused(key: str) -> None:
    stated = {"resolution_m": (0.7, 0.9), "noise_beta0": 0.002}[key]
    twice = with_collection(scene(SMALL, {"noise_floor": {"level": 0.002}}), {key: stated})
    for product in (warpsar.slc, warpsar.phase_history):
        with pytest.raises(warpsar.InputError, match=rf"collection\.{key}: found beside"):
            product(twice, device="cpu")


FINER = {"range": {"bandwidth_hz": 6e8}, "azimuth": {"aperture_deg": 3.0}}
"""c w / 2 B and lambda w / 2 aperture, w = 1.187 of Taylor's taper of -35 dB: 0.297 m and 0.354 m."""


@pytest.mark.parametrize("axis", FINER)
def test_a_width_that_the_track_does_not_have_is_refused(axis: str) -> None:
    """The power image would have another response than the complex one."""
    made = with_collection(scene(SMALL, {}), FINER[axis])
    (key,) = FINER[axis]
    held = {"range": "0.297", "azimuth": "0.354"}[axis]
    says = rf"effects\.point_spread\.{axis}_fwhm_m: found 1 m beside collection\.{key}, which holds {held} m; must be"
    for product in (warpsar.slc, warpsar.phase_history):
        with pytest.raises(warpsar.InputError, match=says):
            product(made, device="cpu")
    image(replace(made, effects={"point_spread": BLUR | {f"{axis}_fwhm_m": float(held)}}), 0)
