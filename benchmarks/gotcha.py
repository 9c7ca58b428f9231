"""A real run: AFRL's Gotcha, learned on two views of one degree each, tested on the third, without any effect.

python benchmarks/gotcha.py DATA_FOLDER -o OUT [--figures docs/figures]

DATA_FOLDER holds data_3dsar_pass1_az001_HH.mat to az003. Builds the scene (data/gotcha), imports the views, learns
twice and evaluates: `all`, three numbers per region; `heights`, one rms height per region with everything else, and
grass, held, which is as many numbers as the data can determine. Then compares the test view with simple predictions.
OUT gets it all, and gotcha.json; docs/measured.md says what it means.
"""

from __future__ import annotations

import argparse
import json
import runpy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from warpsar import evaluation, learning
from warpsar.figures import new, save
from warpsar.focus import focus
from warpsar.frame import geometry_of
from warpsar.images import replacing
from warpsar.likelihood import best_gain, deviance, expected_deviance
from warpsar.measured import formats
from warpsar.measured.data import PhaseHistory
from warpsar.measured.ground import pixel_centres, plane_points
from warpsar.measured.importer import import_measured
from warpsar.measured.looks import equivalent_looks
from warpsar.measured.resample import averaged
from warpsar.scene import Scene, View

MAKE_SCENE = Path(__file__).resolve().parent.parent / "data" / "gotcha" / "make_scene.py"
VIEWS = ("az001", "az002", "az003")
WINDOW = "hann"
SAMPLES = (5, 1)  # per pixel of 1 m: what the importer would choose; given, so that pure speckle is averaged alike
REFERENCE = "grass"  # gains are unknown, so brightness is against this region's


def source(data: Path, name: str) -> Path:
    return data / f"data_3dsar_pass1_{name}_HH.mat"


def prepare(data: Path, out: Path, device: str | None = None) -> Path:
    """The scene in `out` with its three views imported; returns its scene.toml."""
    path: Path = runpy.run_path(str(MAKE_SCENE))["write"](out)
    for name in VIEWS:
        import_measured([source(data, name)], path, name, window_range=WINDOW, samples=SAMPLES, device=device)
    return path


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
        history = formats.read([source(data, view.name)])
        assert isinstance(history, PhaseHistory)
        shape = history.samples.shape
        noise = generator.normal(size=shape) + 1j * generator.normal(size=shape)
        history = replace(history, samples=noise.astype(np.complex64))
        points = ground_points(scene, view, samples)
        (image,) = focus(history, points, reference_point_m=np.zeros(3), window_range=WINDOW, device=device)
        images[view.name] = averaged(np.abs(image.astype(complex)) ** 2, samples)
    return images


def regions(scene: Scene, view: View) -> np.ndarray:
    """Index (into the mesh's materials) of the region under each pixel's centre, (rows, cols); -1 off the ground."""
    script = runpy.run_path(str(MAKE_SCENE))
    content = script["table"]()
    names, material = script["cells"](content["regions"], content["size_m"])
    index = np.array([scene.mesh.materials.index(name) for name in names])[material]
    cell = np.floor((ground_points(scene, view)[..., :2] + content["size_m"] / 2.0) / script["CELL_M"]).astype(int)
    inside = ((cell >= 0) & (cell < len(index))).all(axis=-1)
    east, north = np.moveaxis(np.clip(cell, 0, len(index) - 1), -1, 0)
    return np.where(inside, index[north, east], -1)


def heights_only(path: Path) -> Path:
    """The scene with nothing to learn but rms heights, and none of grass; beside the given one."""
    import tomlkit

    document: Any = tomlkit.parse(path.read_text(encoding="utf-8"))
    for name, material in document["materials"].items():
        material["learn"] = [] if name == REFERENCE else ["rms_height_m"]
    held = path.with_name("heights.toml")
    with replacing(held) as temporary:
        temporary.write_text(tomlkit.dumps(document), encoding="utf-8", newline="\n")
    return held


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


def seen_from(scene: Scene, images: dict[str, np.ndarray], target: str) -> np.ndarray:
    """Mean of the images as they lie on z = 0, on the pixels of view `target`, (rows, cols); NaN off any of them."""
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
        resampled.append(map_coordinates(image.astype(float), places, order=1, cval=np.nan))
    return np.asarray(np.mean(resampled, axis=0))


def predictions(scene: Scene, found: evaluation.Evaluation) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Every prediction of the test view, (rows, cols), and the pixels that all of them have."""
    from scipy.ndimage import uniform_filter

    train = [i for i in found.images if i.view.role == "train"]
    (test,) = (i for i in found.images if i.view.role == "test")
    pixels = [Pixels(i.observation.values, regions(scene, i.view)[i.interior], i.observation.looks) for i in train]
    means = region_means(pixels, len(scene.mesh.materials))
    mean = seen_from(scene, {i.view.name: i.measured for i in train}, test.view.name)
    smooth = np.where(np.isfinite(mean), uniform_filter(np.nan_to_num(mean), 3), np.nan)
    made = {
        "learned model": test.simulated,
        "one constant": np.ones(mean.shape),
        "one constant per region, fitted on train": means[regions(scene, test.view)],
        "mean of az001 and az002": mean,
        "the same, 3 x 3 pixels": smooth,
    }
    return made, test.interior & np.isfinite(mean)


def compare(scene: Scene, found: evaluation.Evaluation, speckle: dict[str, np.ndarray]) -> dict[str, Any]:
    """Deviance over the speckle floor of every prediction of the test view, its one gain fitted: over all compared
    pixels and in each region, whose gains are not fitted again. The floor is that of the looks estimated in the
    picture; what uniform ground itself would leave is told by `speckle`, the views made of nothing else."""
    (test,) = (i for i in found.images if i.view.role == "test")
    made, mask = predictions(scene, found)
    looks, measured = test.observation.looks, test.measured[mask].astype(float)
    region = regions(scene, test.view)[mask]
    floor = expected_deviance(looks)
    table: dict[str, Any] = {}
    for name, image in made.items():
        modelled = image[mask] * best_gain("gamma", measured, image[mask], looks)
        d = deviance(measured, modelled, looks) / floor
        decibel = 10.0 * np.log10(measured / modelled)
        table[name] = {"deviance": float(d.mean()), "rmse_db": float(np.sqrt(np.mean(decibel**2)))} | {
            material: float(d[region == index].mean()) for index, material in enumerate(scene.mesh.materials)
        }
    alone, mean = (speckle[test.view.name], seen_from(scene, {n: speckle[n] for n in VIEWS[:2]}, test.view.name))
    uniform = {}
    for name, image in (("one constant", np.ones(alone.shape)), ("mean of az001 and az002", mean)):
        modelled = image[mask] * best_gain("gamma", alone[mask], image[mask], looks)
        uniform[name] = float(np.mean(deviance(alone[mask], modelled, looks)) / floor)
    return {
        "speckle_looks": {name: float(np.mean(image) ** 2 / np.var(image)) for name, image in speckle.items()},
        "speckle_looks_estimated": {name: equivalent_looks(image) for name, image in speckle.items()},
        "uniform_ground": uniform,
        "pixels": int(mask.sum()),
        "pixels_of": {name: int((region == index).sum()) for index, name in enumerate(scene.mesh.materials)},
        "deviance_over_floor": table,
    }


def brightness(scene: Scene, found: evaluation.Evaluation, learned: dict[str, Any]) -> dict[str, Any]:
    """Each region's modelled beta0 against grass [dB], the median over its pixels, and its 95 % interval: what is
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


def figures(scene: Scene, found: evaluation.Evaluation, folder: Path) -> None:
    """The regions on the train views' mean, and the test view beside what was learned."""
    grid = scene.grid
    half = [n * s / 2.0 for n, s in zip(grid.shape, grid.spacing_m, strict=True)]
    place: dict[str, Any] = {"extent": (-half[1], half[1], half[0], -half[0]), "interpolation": "nearest"}
    first, _, test = found.images
    mean = seen_from(scene, {i.view.name: i.measured for i in found.images[:2]}, first.view.name)
    reference = np.median(mean[np.isfinite(mean)])
    with np.errstate(divide="ignore", invalid="ignore"):
        figure, (left, right) = new(8.0, 3.1, ncols=2, sharey=True)
        drawn = left.imshow(10 * np.log10(mean / reference), cmap="gray", vmin=-8, vmax=16, **place)
        left.set_title("az001 and az002, mean", size=9)
        figure.colorbar(drawn, ax=left, label="dB to the median", shrink=0.8)
        names = scene.mesh.materials
        region = regions(scene, first.view)
        shown = np.where(region < 0, np.nan, region)
        drawn = right.imshow(shown, cmap="Set2", vmin=-0.5, vmax=7.5, **place)
        bar = figure.colorbar(
            drawn, ax=right, ticks=range(len(names)), boundaries=np.arange(len(names) + 1) - 0.5, shrink=0.8
        )
        bar.ax.set_yticklabels(names)
        right.set_title("regions", size=9)
        for axis in (left, right):
            axis.set_xlabel("azimuth [m]")
        left.set_ylabel("slant range [m]")
        save(figure, folder / "measured_gotcha_run_regions.png")

        figure, axes = new(10.0, 2.9, ncols=3, sharey=True)
        panels = (
            ("az003, measured (test)", 10 * np.log10(test.measured / reference), "gray", (-8, 16)),
            ("az003, learned on az001, az002", 10 * np.log10(test.simulated / reference), "gray", (-8, 16)),
            ("measured / learned", test.ratio_db, "RdBu_r", (-12, 12)),
        )
        for axis, (title, values, colours, (low, high)) in zip(axes, panels, strict=True):
            drawn = axis.imshow(values, cmap=colours, vmin=low, vmax=high, **place)
            axis.set_title(title, size=9)
            axis.set_xlabel("azimuth [m]")
            figure.colorbar(drawn, ax=axis, label="dB", shrink=0.8)
        axes[0].set_ylabel("slant range [m]")
        save(figure, folder / "measured_gotcha_run_test.png")


def run(data: Path, out: Path, *, figure_folder: Path | None = None, device: str | None = None) -> dict[str, Any]:
    """All of it; returns what gotcha.json holds."""
    path = prepare(data, out, device)
    speckle = pure_speckle(data, Scene.load(path), SAMPLES, device)
    content: dict[str, Any] = {}
    for name, declared in (("all", path), ("heights", heights_only(path))):
        folder = out / name
        learned = learning.run(declared, folder / "learned", device=device)
        numbers = evaluation.run(folder / "learned" / "scene.toml", folder / "evaluated", device=device)
        scene = Scene.load(folder / "learned" / "scene.toml")
        found = evaluation.evaluate(scene, device=device)
        keys = ("deviance", "deviance_error", "pixels", "rmse_db", "correlation")
        content[name] = {
            "looks": {view["name"]: view["looks"] for view in numbers["views"]},
            "gains": {view["name"]: view["gain"] for view in numbers["views"]},
            **{role: {key: numbers[role][key] for key in keys} for role in ("train", "test")},
            "identifiability": learned["identifiability"]["words"],
            "outside_domain": learned["outside_domain"],
            "materials": learned["materials"],
            "comparison": compare(scene, found, speckle),
        }
    content["heights"]["brightness"] = brightness(scene, found, learned)
    figure_folder = figure_folder or out
    figure_folder.mkdir(parents=True, exist_ok=True)
    figures(scene, found, figure_folder)
    with replacing(out / "gotcha.json") as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return content


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--figures", type=Path, help="folder of the two pictures; default: OUT")
    parser.add_argument("--device")
    options = parser.parse_args()
    content = run(options.data, options.out, figure_folder=options.figures, device=options.device)
    summary = {
        "train": content["heights"]["train"],
        "test": content["heights"]["test"],
        "brightness": content["heights"]["brightness"],
        "all": content["all"]["comparison"],
        "heights": content["heights"]["comparison"],
    }
    print(json.dumps(summary, indent=1))


if __name__ == "__main__":
    main()
