"""The loop on an MSTAR chip: SLICY, one view, learned and diagnosed; what was found against what its header states.

python benchmarks/slicy.py DATA_FOLDER -o OUT [--figures docs/figures]

DATA_FOLDER holds slicy/HB14931.015. The scene is data/slicy; its shapes were read off the chip. OUT gets slicy.json and
slicy.md; docs/measured.md says what it means. There is no second view, so nothing here is tested on another image.
"""

from __future__ import annotations

import argparse
import json
import re
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.runtime import devices

sys.path.insert(0, str(Path(__file__).resolve().parent))

from measured_loop import best_width, decibels, diagnosed, effect_widths, half_power_width, kept, markdown, pixel_kernel

from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.refit import descend
from warpsar.evaluation import command as evaluation
from warpsar.io.figures import new, save
from warpsar.io.images import replacing
from warpsar.learning.problem import FitProblem
from warpsar.measured import formats
from warpsar.measured.data import ImageChip
from warpsar.measured.focus import taper
from warpsar.measured.importer import import_measured
from warpsar.scene.scene import Scene
from warpsar.world.frame import SPEED_OF_LIGHT

MAKE_SCENE = Path(__file__).resolve().parent.parent / "data" / "slicy" / "make_scene.py"
VIEW = "hb14931"
FINER = 16  # times, to measure widths
# Places in azimuth and slant range [m], by eye: the three brightest points; the middle of the shadow, a metre from the
# light on either side; and grass, left and right of everything.
POINTS = ((-1.4, 0.0), (-0.15, -0.25), (-0.8, 0.4))
SHADOW = ((-0.6, 3.2), (1.1, 4.6))
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


def of_the_chip(data: Path) -> dict[str, Any]:
    """What the complex chip says by itself, without a model: widths of bright points, the taper in its spectrum, power
    in shadow and grass."""
    chip = formats.read([source(data)])
    assert isinstance(chip, ImageChip)
    assert chip.spacing_m is not None
    power = np.abs(chip.samples.astype(complex)) ** 2
    rows, cols = power.shape
    range_m = (np.arange(rows) + 0.5 - rows / 2) * chip.spacing_m[0]
    azimuth_m = (np.arange(cols) + 0.5 - cols / 2) * chip.spacing_m[1]
    fine = finer(chip.samples.astype(complex), FINER)
    widths = []
    for azimuth, slant in POINTS:
        at = [
            round((place / step + (n - 1) / 2) * FINER)
            for place, step, n in zip((slant, azimuth), chip.spacing_m, power.shape, strict=True)
        ]
        box = fine[at[0] - FINER : at[0] + FINER, at[1] - FINER : at[1] + FINER]
        peak = np.unravel_index(int(np.argmax(box)), box.shape)
        row, col = at[0] - FINER + int(peak[0]), at[1] - FINER + int(peak[1])
        reach = 3 * FINER
        widths.append(
            {
                "azimuth_m": azimuth,
                "slant_range_m": slant,
                "range_width_m": half_power_width(fine[row - reach : row + reach, col], chip.spacing_m[0] / FINER),
                "azimuth_width_m": half_power_width(fine[row, col - reach : col + reach], chip.spacing_m[1] / FINER),
            }
        )
    spectrum = np.abs(np.fft.fftshift(np.fft.fft2(chip.samples.astype(complex)))) ** 2
    bandwidth = 1e9 * float(header(data)["Bandwidth"].split()[0])
    cell = SPEED_OF_LIGHT / (2.0 * bandwidth)
    tapers = {}
    for axis, label in enumerate(("range", "azimuth")):
        mean = spectrum.mean(axis=1 - axis)
        n = mean.size
        share = chip.spacing_m[axis] / cell  # of the sampled band that is used
        place = (np.arange(n) - n // 2) / n / share
        inner, outer = np.abs(place) < 0.1, (np.abs(place) > 0.4) & (np.abs(place) < 0.5)
        tapers[label] = {"edge_over_middle_db": float(10.0 * np.log10(mean[outer].mean() / mean[inner].mean()))} | {
            name: float(
                10.0 * np.log10(np.mean(taper(name, place[outer]) ** 2) / np.mean(taper(name, place[inner]) ** 2))
            )
            for name in ("none", "taylor", "hann")
        }
    (left, near), (right, far) = SHADOW
    shadow = power[(range_m > near) & (range_m < far)][:, (azimuth_m > left) & (azimuth_m < right)]
    grass = power[:, np.abs(azimuth_m) > GRASS_BEYOND_M]
    # Power that sigma0 = 1 on level ground would have, if a pixel's power is the cross-section in m^2 of what focuses
    # there: the integral of the impulse response, in the slant plane, over the cosine to the ground's normal.
    place = (np.arange(1000) + 0.5) / 1000 - 0.5
    weight = taper("taylor", place)
    area = (cell * np.mean(weight**2) / np.mean(weight) ** 2) ** 2
    view = runpy.run_path(str(MAKE_SCENE))["read"]("scene.toml")["views"][0]
    unit = area / np.sin(np.radians(view["incidence_deg"]))
    return {
        "cell_m": cell,
        "points": widths,
        "taylor_width_m": 1.1875 * cell,
        "taper": tapers,
        "shadow_db": float(10.0 * np.log10(shadow.mean())),
        "shadow_pixels": int(shadow.size),
        "grass_db": float(10.0 * np.log10(grass.mean())),
        "sigma0_1_db": float(10.0 * np.log10(unit)),
        "point_spread_m": {
            window: [
                best_width(pixel_kernel(cell, "taylor", spacing, 1, place), spacing, window)
                for spacing in chip.spacing_m
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
    scene = out / "scene" / "scene.toml"
    if not scene.exists():
        prepare(data, scene.parent, device)
    content = {
        "header": header(data),
        "chip": kept(out / "chip.json", lambda: of_the_chip(data)),
        "diagnosis": kept(
            out / "diagnosis.json", lambda: diagnosed(scene, out / "diagnosis", DiagnoseOptions(), device)
        ),
    }
    content["windows"] = kept(out / "windows.json", lambda: windows(out / "diagnosis" / "scene.toml", device))
    content["point_spread_found"] = effect_widths(content["diagnosis"])
    figure(out, figure_folder or out, device)
    for name, text in (("slicy.json", json.dumps(content, indent=1) + "\n"), ("slicy.md", tables(content))):
        with replacing(out / name) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    return content


def tables(content: dict[str, Any]) -> str:
    """What docs/measured.md quotes."""
    chip, diagnosis = content["chip"], content["diagnosis"]
    parts = ["## Header\n", markdown(["field", "value"], list(content["header"].items()))]
    parts.append("## Half-power widths\n")
    rows: list[list[Any]] = [
        [f"chip, point at ({p['azimuth_m']}, {p['slant_range_m']})", p["range_width_m"], p["azimuth_width_m"]]
        for p in chip["points"]
    ]
    rows.append(["theory, Taylor of -35 dB over the header's band", chip["taylor_width_m"], chip["taylor_width_m"]])
    for window, (r_any, r_middle, a_any, a_middle) in chip["point_spread_m"].items():
        rows.append([f"point_spread nearest to it, {window}: points anywhere in a pixel", r_any, a_any])
        rows.append([f"point_spread nearest to it, {window}: points in pixels' middles", r_middle, a_middle])
    if content["point_spread_found"]:
        said = [
            f"{v['value_m']:.3g} ({v['low_m']:.3g} to {v['high_m']:.3g})"
            for v in content["point_spread_found"].values()
        ]
        rows.append([f"point_spread found, {diagnosis['effects']['point_spread'].get('window', 'gaussian')}", *said])
    for window, table in content["windows"].items():
        if isinstance(table, dict):
            label = f"fitted again with {window}: 2 ln L {-table['behind']:.0f} against the best"
            rows.append([label, table["range_fwhm_m"], table["azimuth_fwhm_m"]])
    parts.append(markdown(["", "range [m]", "azimuth [m]"], rows))
    parts.append("## Taper: mean spectrum, outer tenth of the band over its middle [dB]\n")
    parts.append(
        markdown(
            ["axis", "chip", "none", "taylor", "hann"],
            [[a, t["edge_over_middle_db"], t["none"], t["taylor"], t["hann"]] for a, t in chip["taper"].items()],
        )
    )
    parts.append("## Power [dB, of the chip's own unit, magnitude squared]\n")
    unit = chip["sigma0_1_db"]
    parts.append(
        markdown(
            ["", "chip's unit", "as sigma0, if that unit is m^2 of cross-section"],
            [
                ["grass", chip["grass_db"], chip["grass_db"] - unit],
                [f"shadow, {chip['shadow_pixels']} pixels", chip["shadow_db"], chip["shadow_db"] - unit],
            ],
        )
    )
    parts.append("## Diagnosis\n")
    rows = [["declared", "", "", diagnosis["before"]["train"]["deviance"]]]
    rows += [
        [
            s["effect"],
            ", ".join(f"{k} {v if isinstance(v, str) else f'{v:.3g}'}" for k, v in s["parameters"].items()),
            s["refit_gain"],
            s["train_deviance"],
        ]
        for s in diagnosis["steps"]
    ]
    parts.append(markdown(["added", "parameters", "2 ln L", "train deviance"], rows))
    floor = [next(c for c in turn["candidates"] if c["effect"] == "noise_floor") for turn in diagnosis["turns"]]
    parts.append(
        "noise_floor, -ln p of every turn (threshold): "
        + ", ".join(
            f"{c['minus_log_p']:.1f} ({t['threshold']:.1f})" for c, t in zip(floor, diagnosis["turns"], strict=True)
        )
        + f"; left at the end: -ln p {diagnosis['left_at_the_end']['minus_log_p']:.1f}, unexplained: "
        + f"{diagnosis['unexplained']}\n"
    )
    return "\n".join(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--figures", type=Path, help="folder of the picture; default: OUT")
    parser.add_argument("--device")
    options = parser.parse_args()
    print(tables(run(options.data, options.out, figure_folder=options.figures, device=options.device)))


if __name__ == "__main__":
    main()
