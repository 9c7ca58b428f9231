"""The loop on an MSTAR chip: SLICY, one view, learned and diagnosed; what was found against what its header states.

    python benchmarks/slicy.py DATA -o OUT [--figures docs/figures] [--write]

DATA is a folder of public releases. It holds slicy/HB14931.015, of the MSTAR public release. The scene is data/slicy;
its shapes were read off the chip. OUT gets slicy.json and slicy.md; what lies there already is not made again. There is
no second view, so nothing here is tested on another image.
"""

from __future__ import annotations

import argparse
import re
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.runtime import devices

sys.path.insert(0, str(Path(__file__).resolve().parent))

import tables
from measured_loop import (
    best_width,
    decibels,
    diagnosed,
    effect_widths,
    half_power_width,
    kept,
    pixel_kernel,
    rounded,
    written,
)

from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.models.refit import descend
from warpsar.evaluation import command as evaluation
from warpsar.formats import registry
from warpsar.formats.base.data import ImageChip
from warpsar.io.figures import new, save
from warpsar.learning.problem import FitProblem
from warpsar.measured.importer import import_measured
from warpsar.scene.scene import Scene
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.taper import taper

MAKE_SCENE = Path(__file__).resolve().parent.parent / "data" / "slicy" / "make_scene.py"
VIEW = "hb14931"
FINER = 16  # times, to measure widths
# Places in azimuth and slant range [m], by eye: the three brightest points; the middle of the shadow, a metre from the
# light on either side; and grass, left and right of everything.
POINTS = ((1.4, 0.0), (0.15, -0.25), (0.8, 0.4))
SHADOW = ((-1.1, 3.2), (0.6, 4.6))
GRASS_BEYOND_M = 3.0
HEADER = (
    "RangeResolution",
    "CrossRangeResolution",
    "Range3dBWidth",
    "CrossRange3dBWidth",
    "RangeWeighting",
    "CrossRangeWeighting",
    "AdditiveNoise",
    "MultiplicativeNoise",
    "Bandwidth",
)


def source(data: Path) -> Path:
    return data / "slicy" / "HB14931.015"


def header(data: Path) -> dict[str, str]:
    """The fields that are compared, as they stand."""
    text = source(data).read_bytes()[:4096].decode("latin-1")
    found = dict(re.findall(r"^(\w+)= *(.*?) *$", text, re.MULTILINE))
    return {name: found[name] for name in HEADER}


def prepare(data: Path, out: Path, device: str | None = None) -> Path:
    path: Path = runpy.run_path(str(MAKE_SCENE))["write"](out)
    import_measured([source(data)], path, VIEW, device=device)
    return path


def finer(samples: np.ndarray, times: int) -> np.ndarray:
    """Power of a complex image on a grid `times` as fine, by zeros about its spectrum."""
    rows, cols = samples.shape
    spectrum = np.fft.fftshift(np.fft.fft2(samples))
    whole = np.zeros((rows * times, cols * times), complex)
    top, left = (n * times // 2 - n // 2 for n in (rows, cols))
    whole[top : top + rows, left : left + cols] = spectrum
    return np.asarray(np.abs(np.fft.ifft2(np.fft.ifftshift(whole)) * times**2) ** 2)


def point_widths(samples: np.ndarray, spacing_m: tuple[float, float]) -> list[dict[str, float]]:
    """Half-power widths of the brightest points, on a finer grid."""
    fine = finer(samples, FINER)
    widths = []
    for azimuth, slant in POINTS:
        at = [
            round((place / step + (n - 1) / 2) * FINER)
            for place, step, n in zip((slant, azimuth), spacing_m, samples.shape, strict=True)
        ]
        box = fine[at[0] - FINER : at[0] + FINER, at[1] - FINER : at[1] + FINER]
        peak = np.unravel_index(int(np.argmax(box)), box.shape)
        row, col = at[0] - FINER + int(peak[0]), at[1] - FINER + int(peak[1])
        reach = 3 * FINER
        widths.append(
            {
                "azimuth_m": azimuth,
                "slant_range_m": slant,
                "range_width_m": half_power_width(fine[row - reach : row + reach, col], spacing_m[0] / FINER),
                "azimuth_width_m": half_power_width(fine[row, col - reach : col + reach], spacing_m[1] / FINER),
            }
        )
    return widths


def tapers(samples: np.ndarray, spacing_m: tuple[float, float], cell_m: float) -> dict[str, dict[str, float]]:
    """Edge of the mean spectrum over its middle [dB], along each axis, and what tapers would have."""
    spectrum = np.abs(np.fft.fftshift(np.fft.fft2(samples))) ** 2
    found = {}
    for axis, label in enumerate(("range", "azimuth")):
        mean = spectrum.mean(axis=1 - axis)
        n = mean.size
        share = spacing_m[axis] / cell_m  # of the sampled band that is used
        place = (np.arange(n) - n // 2) / n / share
        inner, outer = np.abs(place) < 0.1, (np.abs(place) > 0.4) & (np.abs(place) < 0.5)
        found[label] = {"edge_over_middle_db": float(10.0 * np.log10(mean[outer].mean() / mean[inner].mean()))} | {
            name: float(
                10.0 * np.log10(np.mean(taper(name, place[outer]) ** 2) / np.mean(taper(name, place[inner]) ** 2))
            )
            for name in ("none", "taylor", "hann")
        }
    return found


def powers(power: np.ndarray, spacing_m: tuple[float, float], cell_m: float) -> dict[str, Any]:
    """Mean power of shadow and grass [dB], and that of a sigma0 of 1 if a pixel's power is a cross-section in m^2."""
    rows, cols = power.shape
    range_m = (np.arange(rows) + 0.5 - rows / 2) * spacing_m[0]
    azimuth_m = (np.arange(cols) + 0.5 - cols / 2) * spacing_m[1]
    (left, near), (right, far) = SHADOW
    shadow = power[(range_m > near) & (range_m < far)][:, (azimuth_m > left) & (azimuth_m < right)]
    grass = power[:, np.abs(azimuth_m) > GRASS_BEYOND_M]
    # What focuses in a pixel: the integral of the impulse response, in the slant plane, over the cosine to the normal
    # of level ground.
    weight = taper("taylor", (np.arange(1000) + 0.5) / 1000 - 0.5)
    area = (cell_m * np.mean(weight**2) / np.mean(weight) ** 2) ** 2
    view = runpy.run_path(str(MAKE_SCENE))["read"]("scene.toml")["views"][0]
    unit = area / np.sin(np.radians(view["incidence_deg"]))
    return {
        "shadow_db": float(10.0 * np.log10(shadow.mean())),
        "shadow_pixels": int(shadow.size),
        "grass_db": float(10.0 * np.log10(grass.mean())),
        "sigma0_1_db": float(10.0 * np.log10(unit)),
    }


def of_the_chip(data: Path) -> dict[str, Any]:
    """What the complex chip says by itself, without a model: widths of bright points, the taper in its spectrum, power
    in shadow and grass."""
    chip = registry.read([source(data)])
    assert isinstance(chip, ImageChip)
    assert chip.spacing_m is not None
    samples, spacing_m = chip.samples.astype(complex), chip.spacing_m
    cell = SPEED_OF_LIGHT / (2.0 * 1e9 * float(header(data)["Bandwidth"].split()[0]))
    return {
        "cell_m": cell,
        "points": point_widths(samples, spacing_m),
        "taylor_width_m": 1.1875 * cell,
        "taper": tapers(samples, spacing_m, cell),
        **powers(np.abs(samples) ** 2, spacing_m, cell),
        "point_spread_m": {
            window: [
                best_width(pixel_kernel(cell, "taylor", spacing, 1, place), spacing, window)
                for spacing in spacing_m
                for place in (None, 0.0)
            ]
            for window in ("sinc", "taylor", "gaussian")
        },
    }


def windows(path: Path, device: str | None) -> dict[str, Any]:
    """The final model fitted again with each window of the point spread: widths, and 2 ln L behind the best one."""
    scene = Scene.load(path)
    found: dict[str, Any] = {}
    for window in ("sinc", "taylor", "gaussian") if "point_spread" in scene.effects else ():
        effects = {**scene.effects, "point_spread": {**scene.effects["point_spread"], "window": window}}
        problem = FitProblem(replace(scene, effects=effects), devices.resolve_device(device))
        x, loss, _ = descend(problem, [problem.x0])
        table = problem.effect_tables(x)["point_spread"]
        found[window] = {"loss": loss, "range_fwhm_m": table["range_fwhm_m"], "azimuth_fwhm_m": table["azimuth_fwhm_m"]}
    for table in found.values():
        table["behind"] = 2.0 * (table["loss"] - min(t["loss"] for t in found.values()))
    return found


def figure(out: Path, folder: Path, device: str | None) -> None:
    """The chip, and the models before and after."""
    images = [
        evaluation.evaluate(Scene.load(out / "diagnosis" / name), device=device).images[0]
        for name in ("step0.toml", "scene.toml")
    ]
    scene = Scene.load(out / "scene" / "scene.toml")
    half = [n * s / 2.0 for n, s in zip(scene.grid.shape, scene.grid.spacing_m, strict=True)]
    place: dict[str, Any] = {"extent": (-half[1], half[1], half[0], -half[0]), "interpolation": "nearest"}
    reference = float(np.median(images[0].measured))
    folder.mkdir(parents=True, exist_ok=True)
    drawing, axes = new(10.0, 3.4, ncols=3, sharey=True)
    panels = (
        ("measured", images[0].measured),
        ("declared, fitted", images[0].simulated),
        ("with the effects found", images[1].simulated),
    )
    for axis, (title, image) in zip(axes, panels, strict=True):
        drawn = axis.imshow(decibels(image, reference), cmap="gray", vmin=-10, vmax=40, **place)
        axis.set_title(title, size=9)
        axis.set_xlabel("azimuth [m]")
        drawing.colorbar(drawn, ax=axis, label="dB to the median", shrink=0.8)
    axes[0].set_ylabel("slant range [m]")
    save(drawing, folder / "measured_slicy_run.png")


def run(data: Path, out: Path, *, figure_folder: Path | None = None, device: str | None = None) -> dict[str, Any]:
    """All of it; returns what slicy.json holds."""
    out.mkdir(parents=True, exist_ok=True)
    made = kept(out / "made.json", tables.made)
    scene = out / "scene" / "scene.toml"
    if not scene.exists():
        prepare(data, scene.parent, device)
    content = {
        "made": made,
        "header": header(data),
        "chip": kept(out / "chip.json", lambda: of_the_chip(data)),
        "diagnosis": kept(
            out / "diagnosis.json", lambda: diagnosed(scene, out / "diagnosis", DiagnoseOptions(), device)
        ),
    }
    content["windows"] = kept(out / "windows.json", lambda: windows(out / "diagnosis" / "scene.toml", device))
    content["point_spread_found"] = effect_widths(content["diagnosis"])
    figure(out, figure_folder or out, device)
    written(out, "slicy", content, tables_of(content))
    return content


def widths(content: dict[str, Any]) -> str:
    chip = content["chip"]
    rows: list[list[Any]] = [
        ["header, resolution", content["header"]["RangeResolution"], content["header"]["CrossRangeResolution"]],
        ["header, 3 dB width", content["header"]["Range3dBWidth"], content["header"]["CrossRange3dBWidth"]],
        ["theory, Taylor of -35 dB over the header's band", chip["taylor_width_m"], chip["taylor_width_m"]],
    ]
    for point in chip["points"]:
        place = f"({point['azimuth_m']}, {point['slant_range_m']})"
        rows.append([f"chip, point at {place}", point["range_width_m"], point["azimuth_width_m"]])
    for window, (r_any, r_middle, a_any, a_middle) in chip["point_spread_m"].items():
        rows.append([f"point_spread nearest to theory, {window}: points anywhere in a pixel", r_any, a_any])
        rows.append([f"point_spread nearest to theory, {window}: points in pixels' middles", r_middle, a_middle])
    if content["point_spread_found"]:
        window = content["diagnosis"]["effects"]["point_spread"].get("window", "gaussian")
        values = content["point_spread_found"].values()
        said = [f"{v['value_m']:.3g} ({v['low_m']:.3g} to {v['high_m']:.3g})" for v in values]
        rows.append([f"point_spread found, {window}", *said])
    for window, table in content["windows"].items():
        if isinstance(table, dict):
            label = f"fitted again with {window}: {table['behind']:.0f} of 2 ln L behind the best"
            rows.append([label, table["range_fwhm_m"], table["azimuth_fwhm_m"]])
    return rounded(["half-power widths", "range [m]", "azimuth [m]"], rows)


def steps(diagnosis: dict[str, Any]) -> str:
    rows = [["declared", "", "", diagnosis["before"]["train"]["deviance"]]]
    for step in diagnosis["steps"]:
        values = [f"{k} {f'{v:.3g}' if isinstance(v, float) else v}" for k, v in step["parameters"].items()]
        rows.append([step["effect"], ", ".join(values), step["refit_gain"], step["train_deviance"]])
    return rounded(["added", "parameters", "2 ln L", "train deviance"], rows)


def noise(diagnosis: dict[str, Any]) -> str:
    """-ln p of `noise_floor` in every turn."""
    rows = []
    for number, turn in enumerate(diagnosis["turns"], 1):
        floor = next(c for c in turn["candidates"] if c["effect"] == "noise_floor")
        rows.append([number, floor["testability"].replace("_", " "), f"{floor['minus_log_p']:.1f}"])
        rows[-1].append(f"{turn['threshold']:.1f}")
    return rounded(["turn", "noise_floor is", "-ln p", "asked"], rows)


def tables_of(content: dict[str, Any]) -> dict[str, str]:
    """The tables of docs/measured-record.md."""
    chip, diagnosis = content["chip"], content["diagnosis"]
    edges = [[axis, t["edge_over_middle_db"], t["none"], t["taylor"], t["hann"]] for axis, t in chip["taper"].items()]
    levels = [
        ["grass", chip["grass_db"], chip["grass_db"] - chip["sigma0_1_db"]],
        [f"shadow, {chip['shadow_pixels']} pixels", chip["shadow_db"], chip["shadow_db"] - chip["sigma0_1_db"]],
    ]
    return {
        "slicy.steps": steps(diagnosis),
        "slicy.widths": widths(content),
        "slicy.taper": rounded(["edge of the spectrum over its middle [dB]", "chip", "none", "taylor", "hann"], edges),
        "slicy.power": rounded(["power [dB]", "chip's unit", "as sigma0, if that unit is m^2"], levels),
        "slicy.noise": noise(diagnosis),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--figures", type=Path, help="folder of the picture; default: OUT")
    parser.add_argument("--device")
    tables.add_write(parser)
    options = parser.parse_args()
    content = run(options.data, options.out, figure_folder=options.figures, device=options.device)
    tables.publish(tables_of(content), content, options.write)


if __name__ == "__main__":
    main()
