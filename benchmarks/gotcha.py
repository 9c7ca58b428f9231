"""The loop on measured data: AFRL's Gotcha, learned on two views of one degree each, diagnosed, tested on others.

    python benchmarks/gotcha.py DATA -o OUT [--figures docs/figures] [--long] [--write]

DATA is a folder of public releases. It holds gotcha/data_3dsar_pass1_az001_HH.mat to az003, of the AFRL Gotcha
volumetric data set; whatever other degrees lie there are test views, too (of an OUT that was begun without them they
are not). Two scenes are built (data/gotcha): `flat`, regions on flat ground, and `objects`, where every car is an
object of its own. Of the cars, brightness, places, sizes and what their bodies lack are learned one after the other
on az001 and az002, and the last model is diagnosed. Every step's prediction of az003 (and of what follows it), which
nothing was read off, fitted to or decided by, is compared with simple ones. OUT gets it all, with gotcha.json and
gotcha.md; what lies there already is not made again. `--long` has the diagnosis fit from two starts and add as many
effects as it may.
"""

from __future__ import annotations

import argparse
import runpy
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import tables
from gotcha_cars import DETAIL, GLINT, Fitted, fit_common, fit_round, kind_of, seen_in, with_effects
from gotcha_glints import with_glints
from gotcha_objects import correlation_area, described, near_side, surveyed, towards_radar
from measured_loop import (
    TURNS,
    best_width,
    decibels,
    diagnosed,
    effect_widths,
    half_power_width,
    kept,
    pixel_kernel,
    rounded,
    turns_of,
    written,
)

from warpsar.compare.comparison import Comparison
from warpsar.compare.evaluation import Evaluation
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.evaluation import command as evaluation
from warpsar.formats import registry
from warpsar.formats.base.data import PhaseHistory
from warpsar.io.figures import new, save
from warpsar.io.images import replacing
from warpsar.learning import command as learning
from warpsar.learning.command import LearnOptions
from warpsar.measured.focus import cell_m, focus
from warpsar.measured.gridding import averaged
from warpsar.measured.ground import pixel_centres, plane_points
from warpsar.measured.importer import import_measured
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import best_gain, deviance, expected_deviance
from warpsar.speckle.looks import equivalent_looks
from warpsar.world.frame import ViewGeometry
from warpsar.world.objects.table import Object
from warpsar.world.tables import View
from warpsar.world.world import geometry_of

MAKE_SCENE = Path(__file__).resolve().parent.parent / "data" / "gotcha" / "make_scene.py"
MAKE_OBJECTS = MAKE_SCENE.with_name("make_objects.py")
TRAIN = ("az001", "az002")
TEST = "az003"
WINDOW = "hann"  # over the band; over the aperture, none
SAMPLES = (3, 2)  # per pixel of 0.5 x 1 m: no fewer than the resolution asks for
REFERENCE = "grass"  # gains are unknown, so brightness is against this region's
NEAR = 3  # pixels from a body within which ground is called `near`: sidelobes, and cars not quite where they are
FEWEST = 30  # pixels of a class that is told apart
TILE = 10  # pixels
FINE_M = 0.05
DIAGNOSE = DiagnoseOptions(starts=1, draws=400)  # the fewest draws that a family error of 1 % allows
SHORT = DiagnoseOptions(starts=0, draws=400, refits=1, most_effects=2)


def source(data: Path, name: str) -> Path:
    return data / "gotcha" / f"data_3dsar_pass1_{name}_HH.mat"


def views_in(data: Path) -> list[str]:
    """The train views, az003, and whatever other degrees lie beside them."""
    prefix, suffix = source(data, "").name.split("__")
    found = (path.name for path in source(data, "").parent.glob(f"{prefix}_az*_{suffix}"))
    others = (name.removeprefix(f"{prefix}_").removesuffix(f"_{suffix}") for name in found)
    return [*TRAIN, TEST, *sorted(set(others) - {*TRAIN, TEST})]


def history(data: Path, name: str) -> PhaseHistory:
    found = registry.read([source(data, name)])
    assert isinstance(found, PhaseHistory)
    return found


def prepare(data: Path, out: Path, *, flat: bool, device: str | None = None) -> Path:
    """A scene in `out`, flat or with objects, with its views imported; returns its scene.toml."""
    views = views_in(data)
    if (out / f"{views[-1]}_HH.exr").exists():
        return out / "scene.toml"
    make = runpy.run_path(str(MAKE_SCENE if flat else MAKE_OBJECTS))["write"]
    path: Path = make(out, flat=True) if flat else make(out)
    for name in views:
        import_measured([source(data, name)], path, name, window_range=WINDOW, samples=SAMPLES, device=device)

    def as_tests(document: Any) -> None:
        for view in document["views"]:
            if view["name"] not in TRAIN:
                view["role"] = "test"

    return rewritten(path, path.name, as_tests)


def ground_points(scene: Scene, view: View, samples: tuple[int, int] = (1, 1)) -> np.ndarray:
    """Points on z = 0 under the centres of a view's pixels, or of `samples` (range, azimuth) in each; (..., 3) [m]."""
    centres = pixel_centres(scene.grid.shape, scene.grid.spacing_m, samples)
    return plane_points(geometry_of(scene, view), np.zeros(3), *centres)


def pure_speckle(
    data: Path, scene: Scene, samples: tuple[int, int], device: str | None = None
) -> dict[str, np.ndarray]:
    """Every view as uniform ground would show it: white noise for the phase history, focused and averaged alike."""
    generator = np.random.default_rng(0)
    images = {}
    for view in scene.views:
        measured = history(data, view.name)
        shape = measured.samples.shape
        noise = generator.normal(size=shape) + 1j * generator.normal(size=shape)
        measured = replace(measured, samples=noise.astype(np.complex64))
        points = ground_points(scene, view, samples)
        (image,) = focus(measured, points, reference_point_m=np.zeros(3), window_range=WINDOW, device=device)
        images[view.name] = averaged(np.abs(image.astype(complex)) ** 2, samples)
    return images


# ---- what theory says of the impulse response ----


def cut(seen: PhaseHistory, geometry: ViewGeometry, places_m: np.ndarray, device: str | None) -> np.ndarray:
    """Power at slant ranges and azimuths (n, 2) [m] on a line along either, focused on z = 0, (n,)."""
    points = plane_points(geometry, np.zeros(3), np.unique(places_m[:, 0]), np.unique(places_m[:, 1])).reshape(-1, 3)
    (image,) = focus(seen, points, reference_point_m=np.zeros(3), window_range=WINDOW, device=device)
    return np.asarray(np.abs(image.astype(complex)) ** 2)


def impulse_response(data: Path, scene: Scene, device: str | None = None) -> dict[str, Any]:
    """The two reflectors against theory: half-power widths on a grid of 5 cm in the slant plane; shares of their power
    in the five pixels about them along range and along azimuth; and the widths of `point_spread` that come nearest to
    theory's kernel of this grid for points anywhere in a pixel."""
    objects = runpy.run_path(str(MAKE_SCENE))["read"]("objects.toml")["reflectors"]
    along = np.arange(-3.0, 3.0 + FINE_M / 2, FINE_M)
    tapers = (WINDOW, "none")
    reflectors, cells = [], (0.0, 0.0)
    for name in TRAIN:
        view = next(v for v in scene.views if v.name == name)
        geometry = geometry_of(scene, view)
        seen = history(data, name).with_autofocus()
        cells = cell_m(seen, np.zeros(3))
        for one in objects:
            corner = np.array([*one["corner_m"], 0.0])
            place = np.array([corner @ geometry.d, corner @ geometry.u])
            entry: dict[str, Any] = {"view": name, "corner_m": one["corner_m"]}
            for axis, label in enumerate(("range", "azimuth")):
                way = np.eye(2)[axis]
                profile = cut(seen, geometry, place + along[:, None] * way, device)
                place += along[int(np.argmax(profile))] * way  # the other axis is then cut through the peak
                profile = cut(seen, geometry, place + along[:, None] * way, device)
                spacing, count, half = scene.grid.spacing_m[axis], SAMPLES[axis], scene.grid.shape[axis] / 2.0
                pixel = place[axis] / spacing + half
                middle = (np.floor(pixel) + 0.5 - half) * spacing  # of the pixel that holds the peak
                sample = (np.arange(-2, 3)[:, None] + (np.arange(count) + 0.5) / count - 0.5) * spacing
                offsets = (middle + sample).reshape(-1, 1) - place[axis]
                shares = cut(seen, geometry, place + offsets * way, device).reshape(5, count).mean(axis=1)
                theory = pixel_kernel(cells[axis], tapers[axis], spacing, count, pixel - np.floor(pixel) - 0.5)
                theory = theory[len(theory) // 2 - 2 : len(theory) // 2 + 3]
                entry[label] = {
                    "width_m": half_power_width(profile, FINE_M),
                    "theory_m": cells[axis] * {"none": 0.8859, "hann": 1.4408}[tapers[axis]],
                    "shares": (shares / shares.sum()).round(3).tolist(),
                    "theory_shares": (theory / theory.sum()).round(3).tolist(),
                }
            reflectors.append(entry)
    kernels = [pixel_kernel(cells[k], tapers[k], scene.grid.spacing_m[k], SAMPLES[k]) for k in (0, 1)]
    return {
        "cells_m": cells,
        "reflectors": reflectors,
        "point_spread_m": {
            window: {
                label: best_width(kernels[axis], scene.grid.spacing_m[axis], window)
                for axis, label in enumerate(("range_fwhm_m", "azimuth_fwhm_m"))
            }
            for window in ("sinc", "taylor", "gaussian")
        },
    }


# ---- scenes to learn from ----


def regions(scene: Scene, view: View, *, flat: bool = True) -> np.ndarray:
    """Index (into the mesh's materials) of the region under each pixel's centre, (rows, cols); -1 off the ground."""
    script = runpy.run_path(str(MAKE_SCENE))
    content = script["table"](flat=flat)
    names, material = script["cells"](content["regions"], content["size_m"])
    index = np.array([scene.mesh.materials.index(name) for name in names])[material]
    cell = np.floor((ground_points(scene, view)[..., :2] + content["size_m"] / 2.0) / script["CELL_M"]).astype(int)
    inside = ((cell >= 0) & (cell < len(index))).all(axis=-1)
    east, north = np.moveaxis(np.clip(cell, 0, len(index) - 1), -1, 0)
    return np.where(inside, index[north, east], -1)


def rewritten(path: Path, name: str, change: Callable[[Any], None]) -> Path:
    """A scene file beside the given one, its tables as `change` leaves them."""
    import tomlkit

    document: Any = tomlkit.parse(path.read_text(encoding="utf-8"))
    change(document)
    made = path.with_name(name)
    with replacing(made) as temporary:
        temporary.write_text(tomlkit.dumps(document), encoding="utf-8", newline="\n")
    return made


def heights_only(path: Path) -> Path:
    """The scene with nothing to learn but rms heights, and none of grass; beside the given one."""

    def change(document: Any) -> None:
        for name, table in document["materials"].items():
            table["learn"] = [] if name == REFERENCE else ["rms_height_m"]

    return rewritten(path, "heights.toml", change)


def learned(path: Path, folder: Path, options: LearnOptions, device: str | None) -> dict[str, Any]:
    """Learn and evaluate; what of both is told."""
    found = learning.run(path, folder, device=device, options=options)
    numbers = evaluation.run(folder / "scene.toml", folder / "evaluated", device=device)
    keys = ("deviance", "deviance_error", "deviance_all", "pixels", "rmse_db", "correlation")
    said = {
        "looks": {view["name"]: view["looks"] for view in numbers["views"]},
        **{role: {key: numbers[role][key] for key in keys} for role in ("train", "test")},
        "outside_domain": found.get("outside_domain"),
    }
    if found.get("identifiability"):
        said["identifiability"] = found["identifiability"].get("words")
        said["materials"] = found["materials"]
    return said


# ---- predictions of the test view ----


@dataclass(frozen=True)
class Pixels:
    """The compared pixels of one image, flat: measured power, index of the region, looks."""

    power: np.ndarray
    region: np.ndarray
    looks: float


def region_means(images: Sequence[Pixels], regions: int) -> np.ndarray:
    """One brightness per region, (regions,), of highest gamma likelihood where each image has a gain of its own; the
    first image's gain is 1. NaN for a region without a pixel."""
    gains = np.ones(len(images))
    region = np.concatenate([i.region for i in images])
    weight = np.concatenate([np.full(i.power.size, i.looks) for i in images])
    count = np.bincount(region, weight, regions)
    for _ in range(50):  # each half step is the other's best in closed form; gains differ by a tenth: 50 are plenty
        power = np.concatenate([i.power / g for i, g in zip(images, gains, strict=True)])
        with np.errstate(invalid="ignore"):
            means = np.bincount(region, weight * power, regions) / count
        gains = np.array([np.mean(i.power / means[i.region]) for i in images])
        gains /= gains[0]
    return means


def seen_from(scene: Scene, images: dict[str, np.ndarray], target: str, order: int = 1) -> np.ndarray:
    """Mean of the images as they lie on z = 0, on the pixels of view `target`, (rows, cols); NaN off any of them.

    `order` of the interpolation: 1 is bilinear, 0 takes the nearest pixel, whose speckle it leaves as it is."""
    from scipy.ndimage import map_coordinates

    by_name = {view.name: view for view in scene.views}
    points = ground_points(scene, by_name[target])
    resampled = []
    for name, image in images.items():
        geometry = geometry_of(scene, by_name[name])
        places = [
            points @ axis / step + (size - 1) / 2.0
            for axis, step, size in zip((geometry.d, geometry.u), scene.grid.spacing_m, scene.grid.shape, strict=True)
        ]
        resampled.append(map_coordinates(image.astype(float), places, order=order, cval=np.nan))
    return np.asarray(np.mean(resampled, axis=0))


def smoothed(image: np.ndarray) -> np.ndarray:
    """The mean over 3 x 3 pixels; NaN stays."""
    from scipy.ndimage import uniform_filter

    return np.where(np.isfinite(image), uniform_filter(np.nan_to_num(image), 3), np.nan)


def image_of(found: Evaluation, view: str) -> Comparison:
    """The image of a view."""
    return next(i for i in found.images if i.view.name == view)


def simple_predictions(scene: Scene, found: Evaluation, view: str = TEST) -> dict[str, np.ndarray]:
    """What a user would try for a test view, from the flat scene's regions and the train images; each (rows, cols),
    NaN where it has nothing to say."""
    train, test = [image_of(found, name) for name in TRAIN], image_of(found, view)
    pixels = [Pixels(i.seen.values, regions(scene, i.view)[i.interior], i.seen.looks) for i in train]
    means = region_means(pixels, len(scene.mesh.materials))
    mean = seen_from(scene, {i.view.name: i.measured for i in train}, test.view.name)
    smooth = smoothed(mean)
    return {
        "one constant": np.ones(mean.shape),
        "one constant per flat region": means[regions(scene, test.view)],
        "mean of az001 and az002": mean,
        "the same, 3 x 3 pixels": smooth,
    }


GRASS = ("grass", "lawn", "lawn_west", "verge")
STRIP = ("west_strip", "west_bright")
BODIES = ("car0", "car1", "thing", GLINT, "reflector")  # what names of bodies' materials begin with


def classes(image: Comparison, materials: Sequence[str]) -> dict[str, np.ndarray]:
    """Masks by what the scene with objects lights most in a pixel, and ground within `NEAR` pixels of a body apart."""
    from scipy.ndimage import maximum_filter

    def of(names: Sequence[str]) -> np.ndarray:
        found = np.isin(image.material, [materials.index(name) for name in names])
        return np.asarray(found)

    body = of([name for name in materials if name.startswith(BODIES)])
    near = (maximum_filter(body.astype(np.uint8), size=2 * NEAR + 1) > 0) & ~body
    grass, strip = (of([n for n in names if n in materials]) & ~near for names in (GRASS, STRIP))
    found = {"grass": grass, "asphalt": ~(grass | strip | body | near), "west strip": strip}
    found |= {"objects": body, "near objects": near}
    return found


@dataclass(frozen=True)
class Compared:
    """Predictions of the test image on the same pixels: deviance over the speckle floor of the image's looks, per pixel
    (n,), one gain fitted to each prediction."""

    looks: float
    mask: np.ndarray
    deviances: dict[str, np.ndarray]
    decibels: dict[str, np.ndarray]


def compare(test: Comparison, made: dict[str, np.ndarray], mask: np.ndarray) -> Compared:
    looks, measured = test.seen.looks, test.measured[mask].astype(float)
    floor = expected_deviance(looks)
    found = Compared(looks, mask, {}, {})
    for name, image in made.items():
        modelled = image[mask] * best_gain("gamma", measured, image[mask], looks)
        found.deviances[name] = deviance(measured, modelled, looks) / floor
        found.decibels[name] = 10.0 * np.log10(measured / modelled)
    return found


def ahead(less: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    """Mean of `less`, a difference per pixel of the mask, and its standard deviation from tiles of `TILE` pixels: wider
    than speckle is correlated, and than an object."""
    rows, cols = (i // TILE for i in np.nonzero(mask))
    tile = rows * mask.shape[1] + cols
    count, total = np.bincount(tile), np.bincount(tile, less)
    mean = float(less.mean())
    return {"by": mean, "sd": float(np.sqrt(np.sum((total - mean * count) ** 2)) / less.size)}


def scatter_floor(scene: Scene, found: Evaluation, test: Comparison, mask: np.ndarray) -> float:
    """What the scatter between the two train views would leave of a perfect prediction, in the table's unit: the looks
    that var(ln I1 - ln I2) = 2 psi'(L) gives on the mask's pixels. What glints from view to view counts as noise."""
    from scipy.optimize import brentq
    from scipy.special import digamma, polygamma

    train = [image_of(found, name) for name in TRAIN]
    first, second = (seen_from(scene, {i.view.name: np.log(i.measured)}, test.view.name, 0)[mask] for i in train)
    spread = float(np.var(first - second)) / 2.0
    looks = float(brentq(lambda value: float(polygamma(1, value)) - spread, 1e-2, 1e3))
    stated = test.seen.looks
    return float((np.log(looks) - digamma(looks)) / (np.log(stated) - digamma(stated)))


def speckle_floor(scene: Scene, test: Comparison, speckle: dict[str, np.ndarray], mask: np.ndarray) -> dict[str, Any]:
    """What uniform ground leaves of a constant, and of the mean of two views, in the table's unit: from views made of
    nothing but noise."""
    looks = test.seen.looks
    alone = speckle[test.view.name][mask]
    mean = seen_from(scene, {n: speckle[n] for n in TRAIN}, test.view.name)[mask]
    left = {}
    for name, image in (("one constant", np.ones(alone.shape)), ("mean of az001 and az002", mean)):
        modelled = image * best_gain("gamma", alone, image, looks)
        left[name] = float(np.mean(deviance(alone, modelled, looks)) / expected_deviance(looks))
    return {
        "looks": {name: float(np.mean(image) ** 2 / np.var(image)) for name, image in speckle.items()},
        "looks_estimated": {name: equivalent_looks(image) for name, image in speckle.items()},
        "left": left,
    }


def brightness(scene: Scene, found: Evaluation, learned: dict[str, Any]) -> dict[str, Any]:
    """Each flat region's modelled beta0 against grass [dB], the median over its pixels, and its 95 % interval: what is
    learned of h alone is 20 log10 h, so the interval's half width is 1.96 sd(ln h) 20 / ln 10."""
    level = {}
    for index, name in enumerate(scene.mesh.materials):
        inside = [i.simulated[i.interior & (regions(scene, i.view) == index)] / i.gain for i in found.images]
        level[name] = 10.0 * np.log10(np.median(np.concatenate(inside)))
    table = {}
    for name in scene.mesh.materials:
        entry = learned["materials"][name]["rms_height_m"]
        half = 1.96 * entry["sd_log"] * 20.0 / np.log(10.0) if "sd_log" in entry else 0.0
        table[name] = {
            "over_grass_db": float(level[name] - level[REFERENCE]),
            "half_interval_db": float(half),
            "rms_height_m": entry["value"],
            "interval_95_m": entry.get("interval_95"),
        }
    return table


# ---- the diagnosis ----


def effects_alone(path: Path, out: Path, options: DiagnoseOptions, device: str | None) -> dict[str, Any]:
    """`diagnosed`, with the objects as they were learned: brightness held, none moved, left out or proposed.

    Every number of every object costs a render of the whole scene: 129 objects would take hours."""
    scene = Scene.load(path)
    held = {str(one.material) for one in scene.objects}
    materials = {k: m.model_copy(update={"learn": ()}) if k in held else m for k, m in scene.materials.items()}
    path = path.with_name("diagnosed.toml")
    replace(scene, materials=materials).save(path)
    return diagnosed(path, out, replace(options, bodies=False), device)


# ---- the model with objects, step by step ----

KNOWN_SPREAD = {"range_fwhm_m": 0.608, "azimuth_fwhm_m": 1.48, "window": ["taylor", "sinc"]}  # theory, of this grid
DETAIL_AT = {"level": 0.035, "spread_m": 2.2, "learn": ["level", "spread_m"]}  # where its fit begins
PLACE = ("east", "north")
CAR = (*PLACE, "length", "height", DETAIL)  # brightness, and a glint's three numbers, are fitted always
STEPS = ("read off, one brightness", "+ brightness by object", "+ places", "+ sizes and detail", "+ glints")
FINAL = STEPS[-1]
ROUNDS = 2  # of either of the last steps
BOUNCES = {"strength": 0.3, "max_bounces": 2, "reflection": "lobe"}
"""Where the fit of bounces begins. They are no step: with them one train view foretells the other worse, at every
step (docs/measured-record.md)."""


def alike(scene: Scene) -> Scene:
    """All cars of one brightness and one share of detail, and so all things, and all glints."""
    from warpsar.scene.placing import with_objects

    first: dict[str, Any] = {}
    for one in scene.objects:
        first.setdefault(f"{kind_of(one)}0", scene.materials[str(one.material)])
    objects = [one.model_copy(update={"material": f"{kind_of(one)}0"}) for one in scene.objects]
    effects = {k: dict(table) for k, table in scene.effects.items()}
    if "unresolved_detail" in effects:
        effects["unresolved_detail"] |= {"materials": [name for name in first if name != f"{GLINT}0"], "share": {}}
    return replace(with_objects(replace(scene, effects={}), objects, first), effects=effects)


def with_detail(scene: Scene) -> Scene:
    """Cars and things with detail that their primitives lack."""
    return with_effects(scene, unresolved_detail={**DETAIL_AT, "materials": [str(o.material) for o in scene.objects]})


def without_glints(scene: Scene) -> Scene:
    from warpsar.scene.placing import with_objects

    kept = [one for one in scene.objects if kind_of(one) != GLINT]
    return with_objects(scene, kept, {str(one.material): scene.materials[str(one.material)] for one in kept})


def steps_of(path: Path, views: Sequence[str] = TRAIN) -> tuple[dict[str, Scene], list[Fitted]]:
    """The scene after every step by its name, and what the images tell of every object in the last.

    Every step is kept beside the scene file as it is made, so an interrupted run goes on from there."""
    declared = Scene.load(path)
    declared = with_effects(declared, point_spread=KNOWN_SPREAD, eps_gradient={"per_m_east": 0.0, "per_m_north": 0.0})
    starts, found = declared.objects, {}

    def step(make: Callable[[], Scene]) -> Scene:
        name = STEPS[len(found)]
        file = path.with_name(f"step{len(found)}.toml")
        if not file.exists():
            print(f"{name} ...", file=sys.stderr)
            make().save(file)
        found[name] = Scene.load(file)
        return found[name]

    def rounds(scene: Scene, about: Sequence[Object], keys: Sequence[str], count: int) -> Scene:
        for _ in range(count):
            scene, _ = fit_round(scene, about, views, keys)
            scene = fit_common(scene, views)
        return scene

    def last(scene: Scene) -> Scene:
        more = with_glints(scene, views)
        return rounds(more, (*starts, *more.objects[len(starts) :]), CAR, ROUNDS)

    step(lambda: fit_common(alike(declared), views))
    scene = step(lambda: fit_common(declared, views))
    scene = step(lambda: rounds(scene, starts, PLACE, 1))
    scene = step(lambda: rounds(with_detail(scene), starts, CAR, ROUNDS))
    scene = step(lambda: last(scene))
    _, told = fit_round(scene, (*starts, *scene.objects[len(starts) :]), views, CAR, steps=0, told=True)
    return found, [told[k] for k in range(len(scene.objects))]


def without(scene: Scene, declared: Scene, views: Sequence[str] = TRAIN) -> dict[str, Scene]:
    """The last model less one of its parts, and with bounces; brightness and effects are fitted again."""
    from warpsar.world.world import posed

    count = len(declared.objects)
    pairs, glints = list(zip(scene.objects[:count], declared.objects, strict=True)), scene.objects[count:]
    unshaped = [one.model_copy(update={"size_m": s.size_m}) for one, s in pairs]
    unplaced = [one.model_copy(update={"position_m": s.position_m}) for one, s in pairs]
    effects = {k: table for k, table in scene.effects.items() if k != "unresolved_detail"}
    changed = {
        "last, without brightness by object": alike(scene),
        "last, without places": posed(scene, [*unplaced, *glints]),
        "last, without sizes": posed(scene, [*unshaped, *glints]),
        "last, without detail": replace(scene, effects=effects),
        "last, without glints": without_glints(scene),
        "last, with bounces": with_effects(scene, multibounce=BOUNCES),
    }
    return {name: fit_common(one, views) for name, one in changed.items()}


def fitted(path: Path, out: Path) -> dict[str, Any]:
    """All steps, kept as scenes in OUT/objects, and the objects' table."""
    found, objects = steps_of(path)
    files = {name: f"step{k}.toml" for k, name in enumerate(found)}
    for name, scene in without(found[FINAL], Scene.load(path)).items():
        files[name] = f"step{len(files)}.toml"
        scene.save(out / files[name])
    final = found[FINAL]
    spread, towards = correlation_area(seen_in(final, TRAIN)), towards_radar(final)
    return {
        "files": files,
        "effects": {name: dict(table) for name, table in final.effects.items()},
        "pixels_of_one_speckle": spread,
        "scatter": float(np.median([one.scatter for one in objects])),
        "objects": [described(one, towards, spread) for one in objects if kind_of(one.object) != GLINT],
        "glints": [str(one.object.name) for one in objects if kind_of(one.object) == GLINT],
    }


def compared(data: Path, out: Path, found: dict[str, Evaluation], device: str | None) -> dict[str, dict[str, Any]]:
    """Every prediction of each test view, over all pixels and by class."""
    scene = Scene.load(out / "flat" / "learned" / "scene.toml")
    speckle = pure_speckle(data, scene, SAMPLES, device)
    return {view.name: _compared(view.name, scene, out, found, speckle) for view in scene.views if view.role == "test"}


def _compared(
    view: str, scene: Scene, out: Path, found: dict[str, Evaluation], speckle: dict[str, np.ndarray]
) -> dict[str, Any]:
    flat, last = found["flat, learned"], found[FINAL]
    materials = Scene.load(out / "objects" / f"step{STEPS.index(FINAL)}.toml").mesh.materials
    test, of = (image_of(e, view) for e in (flat, last))
    made = simple_predictions(scene, flat, view) | {name: image_of(e, view).simulated for name, e in found.items()}
    mask = test.interior & np.all([np.isfinite(image) & (image > 0) for image in made.values()], axis=0)
    result = compare(test, made, mask)
    parts = {name: part[mask] for name, part in classes(of, materials).items() if (part & mask).any()}
    table = {
        name: {
            "all": float(each.mean()),
            **{label: float(each[part].mean()) for label, part in parts.items()},
            "rmse_db": float(np.sqrt(np.mean(result.decibels[name] ** 2))),
        }
        for name, each in result.deviances.items()
    }
    best = result.deviances["the same, 3 x 3 pixels"]
    return {
        "looks": result.looks,
        "pixels": {"all": int(mask.sum())} | {label: int(part.sum()) for label, part in parts.items()},
        "deviance_over_floor": table,
        "share_of_pixels_where_better_than_mean3x3": {
            label: float(np.mean(result.deviances[FINAL][part] < best[part]))
            for label, part in {"all": np.ones(best.shape, bool), **parts}.items()
        },
        "ahead_of_mean3x3": ahead(best - result.deviances[FINAL], mask),
        "scatter_floor": {
            label: scatter_floor(scene, flat, test, full & mask)
            for label, full in {"all": mask, **classes(of, materials)}.items()
            if (full & mask).sum() > FEWEST
        },
        "speckle": speckle_floor(scene, test, speckle, mask),
    }


def in_short(predictions: dict[str, Any]) -> dict[str, float]:
    """The five numbers of a view."""
    table = {name: values["all"] for name, values in predictions["deviance_over_floor"].items()}
    return {
        "final": table[FINAL],
        "mean": table["mean of az001 and az002"],
        "mean3x3": table["the same, 3 x 3 pixels"],
        "regions": table["one constant per flat region"],
        "floor": predictions["scatter_floor"]["all"],
    }


# ---- pictures ----


def outlines(scene: Scene, view: View) -> list[np.ndarray]:
    """Footprints of the objects as the view sees them, (5, 2) each: azimuth and slant range [m]."""
    geometry, found = geometry_of(scene, view), []
    for one in scene.objects:
        near, far = (near_side(one, s * towards_radar(scene)) for s in (1.0, -1.0))
        corners = np.column_stack([[*near, *far[::-1], near[0]], np.zeros(5)])
        found.append(np.column_stack([corners @ geometry.u, corners @ geometry.d]))
    return found


def figures(out: Path, found: dict[str, Evaluation], folder: Path) -> None:
    """The objects over the train views' mean; the test view, the model, and what is left of it."""
    from matplotlib.collections import LineCollection

    final = found[FINAL]
    scene = Scene.load(out / "objects" / f"step{STEPS.index(FINAL)}.toml")
    grid = scene.grid
    half = [n * s / 2.0 for n, s in zip(grid.shape, grid.spacing_m, strict=True)]
    place: dict[str, Any] = {"extent": (-half[1], half[1], half[0], -half[0]), "interpolation": "nearest"}
    first = image_of(final, TRAIN[0])
    train = {name: image_of(final, name).measured for name in TRAIN}
    mean = seen_from(scene, train, first.view.name)
    reference = float(np.median(mean[np.isfinite(mean)]))
    folder.mkdir(parents=True, exist_ok=True)
    figure, axis = new(7.0, 4.6)
    drawn = axis.imshow(decibels(mean, reference), cmap="gray", vmin=-8, vmax=20, **place)
    declared = Scene.load(out / "objects" / "scene.toml")
    for of, colour in ((declared, "tab:blue"), (scene, "tab:orange")):
        axis.add_collection(LineCollection(outlines(of, first.view), colors=colour, linewidths=0.5))
    figure.colorbar(drawn, ax=axis, label="dB to the median", shrink=0.8)
    axis.set(xlim=place["extent"][:2], ylim=place["extent"][2:], xlabel="azimuth [m]", ylabel="slant range [m]")
    axis.set_title("az001 and az002, mean; objects as read off (blue) and as learned", size=9)
    save(figure, folder / "measured_gotcha_run_regions.png")

    figure, axes = new(10.0, 5.6, nrows=2, ncols=2, sharex=True, sharey=True)
    before, after = image_of(found[STEPS[0]], TEST), image_of(final, TEST)
    panels = (
        (f"{TEST}, measured (test)", decibels(after.measured, reference), "gray", (-8, 20)),
        ("last model", decibels(after.simulated, reference), "gray", (-8, 20)),
        ("measured / cars as read off", before.ratio_db, "RdBu_r", (-12, 12)),
        ("measured / last model", after.ratio_db, "RdBu_r", (-12, 12)),
    )
    for axis, (title, values, colours, (low, high)) in zip(axes.flat, panels, strict=True):
        drawn = axis.imshow(values, cmap=colours, vmin=low, vmax=high, **place)
        axis.set_title(title, size=9)
        figure.colorbar(drawn, ax=axis, label="dB", shrink=0.8)
    for axis in axes[-1]:
        axis.set_xlabel("azimuth [m]")
    for axis in axes[:, 0]:
        axis.set_ylabel("slant range [m]")
    save(figure, folder / "measured_gotcha_run_test.png")


# ---- all of it ----


def run(
    data: Path,
    out: Path,
    *,
    figure_folder: Path | None = None,
    device: str | None = None,
    options: DiagnoseOptions = SHORT,
) -> dict[str, Any]:
    """All of it; returns what gotcha.json holds."""
    out.mkdir(parents=True, exist_ok=True)
    made = kept(out / "made.json", tables.made)
    flat = prepare(data, out / "flat", flat=True, device=device)
    path = prepare(data, out / "objects", flat=False, device=device)
    theory = kept(out / "impulse_response.json", lambda: impulse_response(data, Scene.load(path), device))

    def of_flat() -> dict[str, Any]:
        said = learned(heights_only(flat), out / "flat" / "learned", LearnOptions(starts=1), device)
        scene = Scene.load(out / "flat" / "learned" / "scene.toml")
        return said | {"brightness": brightness(scene, evaluation.evaluate(scene, device=device), said)}

    plain = kept(out / "flat.json", of_flat)
    objects = kept(out / "objects.json", lambda: fitted(path, out / "objects"))
    final = out / "objects" / objects["files"][FINAL]
    diagnosis = kept(out / "diagnosis.json", lambda: effects_alone(final, out / "diagnosis", options, device))
    scenes = {"flat, learned": out / "flat" / "learned" / "scene.toml"}
    scenes |= {name: out / "objects" / file for name, file in objects["files"].items()}
    if diagnosis["verdict"]:
        scenes["last, with what the diagnosis adds"] = out / "diagnosis" / "scene.toml"
    found = {name: evaluation.evaluate(Scene.load(file), device=device) for name, file in scenes.items()}
    predictions = compared(data, out, found, device)
    survey = data / "gotcha" / "surveyed_vehicles.csv"
    content = {
        "made": made,
        "comparison": {view: in_short(table) for view, table in predictions.items()},
        "objects": objects["objects"],
        "verdict": diagnosis["verdict"],
        "effects": objects["effects"],
        "pixels_of_one_speckle": objects["pixels_of_one_speckle"],
        "scatter": objects["scatter"],
        "survey": surveyed(survey, objects["objects"], towards_radar(Scene.load(final))),
        "predictions": predictions,
        "impulse_response": theory,
        "flat": plain,
        "diagnosis": diagnosis,
        "point_spread_found": effect_widths(diagnosis),
    }
    figures(out, found, figure_folder or out)
    written(out, "gotcha", content, tables_of(content))
    return content


def reflectors(theory: dict[str, Any]) -> str:
    rows = []
    for one in theory["reflectors"]:
        for axis in ("range", "azimuth"):
            found = one[axis]
            apart = max(abs(a - b) for a, b in zip(found["shares"], found["theory_shares"], strict=True))
            rows.append([str(one["corner_m"]), one["view"], axis, found["width_m"], found["theory_m"], apart])
    return rounded(["reflector at", "view", "axis", "width [m]", "theory [m]", "shares of five pixels differ by"], rows)


def widths(content: dict[str, Any]) -> str:
    rows = [
        [w, t["range_fwhm_m"], t["azimuth_fwhm_m"]] for w, t in content["impulse_response"]["point_spread_m"].items()
    ]
    if content["point_spread_found"]:
        values = content["point_spread_found"].values()
        window = content["diagnosis"]["effects"]["point_spread"].get("window", "gaussian")
        window = window if isinstance(window, str) else " and ".join(window)
        rows.append(
            [f"found, {window}", *(f"{v['value_m']:.3g} ({v['low_m']:.3g} to {v['high_m']:.3g})" for v in values)]
        )
    return rounded(["window", "range [m]", "azimuth [m]"], rows)


def brightness_table(flat: dict[str, Any]) -> str:
    found = {name: one for name, one in flat["brightness"].items() if name != REFERENCE}
    said = [f"{one['over_grass_db']:+.1f} ± {one['half_interval_db']:.1f}" for one in found.values()]
    return rounded(["flat scene", *found], [["beta0 against grass, 95 % interval [dB]", *said]])


def comparison_table(comparison: dict[str, Any]) -> str:
    """Deviance of every prediction over the floor of its looks."""
    labels = ["all", *(label for label, n in comparison["pixels"].items() if label != "all" and n > FEWEST)]
    rows = [
        [name, *(values[label] for label in labels), values["rmse_db"]]
        for name, values in comparison["deviance_over_floor"].items()
    ]
    rows.append(["*view-to-view scatter*", *(comparison["scatter_floor"].get(label, "") for label in labels), ""])
    rows += [[f"*uniform ground: {k}*", v, *[""] * len(labels)] for k, v in comparison["speckle"]["left"].items()]
    rows.append(["pixels", *(comparison["pixels"][label] for label in labels), ""])
    better = comparison["share_of_pixels_where_better_than_mean3x3"]
    rows.append(["last model better than 3 x 3, share of pixels", *(better[label] for label in labels), ""])
    return rounded(["prediction", *labels, "error [dB]"], rows)


def survey_table(rows: list[dict[str, Any]]) -> str:
    """Near side and heading of each surveyed vehicle: learned less surveyed, with 95 % intervals."""

    def said(row: dict[str, Any], off: str, sd: str) -> str:
        return "" if row.get(sd) is None else f"{row[off]:+.2f} ± {1.96 * row[sd]:.2f}"

    head = ["vehicle", "object", "near side's line [m]", "along it [m]", "heading [deg]"]
    return rounded(
        head,
        [
            [
                row["vehicle"],
                row["object"] or "none",
                said(row, "line_off_m", "line_sd_m"),
                said(row, "along_off_m", "along_sd_m"),
                said(row, "heading_off_deg", "heading_sd_deg"),
            ]
            for row in rows
        ],
    )


def told_table(objects: list[dict[str, Any]]) -> str:
    """Of how many cars each number is told, its median standard deviation, and what it trades with."""
    cars = [one for one in objects if one["primitive"] == "car"]
    rows = []
    for key in (*CAR, "brightness"):
        trades: dict[str, int] = {}
        for one in cars:
            for a, b, _ in one["trade"]:
                if key in (a, b):
                    other = b if key == a else a
                    trades[other] = trades.get(other, 0) + 1
        ordered = sorted(trades.items(), key=lambda pair: -pair[1])
        rows.append(
            [
                key,
                f"{sum(key in one['told'] for one in cars)} of {len(cars)}",
                ", ".join(f"{k} ({n})" for k, n in ordered),
            ]
        )
    return rounded(["number of a car", "told", "trades with (cars)"], rows)


def tables_of(content: dict[str, Any]) -> dict[str, str]:
    """The tables of docs/measured-record.md, and one for each further test view."""
    return {
        "gotcha.reflectors": reflectors(content["impulse_response"]),
        "gotcha.widths": widths(content),
        "gotcha.brightness": brightness_table(content["flat"]),
        "gotcha.survey": survey_table(content["survey"]),
        "gotcha.told": told_table(content["objects"]),
        "gotcha.turns": rounded(TURNS, turns_of(content["diagnosis"])),
        **{f"gotcha.{view}": comparison_table(found) for view, found in content["predictions"].items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--figures", type=Path, help="folder of the two pictures; default: OUT")
    parser.add_argument("--long", action="store_true", help="a diagnosis of more starts, refits and effects")
    parser.add_argument("--device")
    tables.add_write(parser)
    given = parser.parse_args()
    options = DIAGNOSE if given.long else SHORT
    content = run(given.data, given.out, figure_folder=given.figures, device=given.device, options=options)
    found = tables_of(content)
    further = {f"gotcha.{view}" for view in content["predictions"]} - {f"gotcha.{TEST}"}  # no page has these
    tables.publish({name: body for name, body in found.items() if name not in further}, content, given.write)
    tables.publish({name: found[name] for name in sorted(further)}, content, False)


if __name__ == "__main__":
    main()
