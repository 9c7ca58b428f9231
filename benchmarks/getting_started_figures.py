"""The pictures of docs/getting-started.md: the example scene, and what the page's commands leave in out/; README's
picture joins these.

python benchmarks/getting_started_figures.py out --pictures docs/figures/getting-started
"""

from __future__ import annotations

import argparse
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

import warpsar
from warpsar.compare.comparison import Comparison
from warpsar.io import figures
from warpsar.io.figures import new

EXAMPLE = Path(__file__).resolve().parent.parent / "data" / "example" / "scene.toml"
LIMITS_DB = (-35.0, 0.0)


def shown(figure: Figure, axis: Any, image: Comparison, values: np.ndarray, title: str, residual: bool) -> None:
    """One image of the view, in metres."""
    r, a = image.range_m, image.azimuth_m
    low, high, colours = (-10.0, 10.0, "RdBu_r") if residual else (*LIMITS_DB, "gray")
    drawn = axis.imshow(values, colours, vmin=low, vmax=high, extent=(a[0], a[-1], r[-1], r[0]))
    axis.set_title(title, fontsize=9)
    axis.set_xlabel("azimuth [m]", fontsize=8)
    axis.tick_params(labelsize=7)
    bar = figure.colorbar(drawn, ax=axis, shrink=0.8, extend="both")
    bar.set_label("measured / modelled [dB]" if residual else "beta0 [dB]", fontsize=8)
    bar.ax.tick_params(labelsize=7)


def save(figure: Figure, path: Path) -> None:
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=95)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.open(stream).convert("RGB").save(path, quality=65, method=6)
    print(path)


def step(path: Path, scenes: list[tuple[str, Path]], measured: bool) -> None:
    """The test view `west`: the measured image where asked for, and the residual of every scene."""
    found = [(words, warpsar.evaluate(warpsar.Scene.load(scene))) for words, scene in scenes]
    figure, axes = new(4.2 * (len(found) + measured), 3.4, ncols=len(found) + measured, squeeze=False)
    for index, (words, evaluation) in enumerate(found):
        (image,) = [one for one in evaluation.images if one.view.name == "west"]
        if measured and index == 0:
            decibel = 10.0 * np.log10(np.maximum(image.measured, 1e-30))
            shown(figure, axes[0, 0], image, decibel, "the measured image of the view west", False)
        ratio = 10.0 * np.log10(np.maximum(image.measured, 1e-30) / np.maximum(image.simulated, 1e-12))
        shown(figure, axes[0, index + measured], image, ratio, words, True)
    axes[0, 0].set_ylabel("slant range [m], radar above", fontsize=8)
    save(figure, path)


def example(path: Path) -> None:
    """The example's three views [dB], of 4 looks."""
    scene = warpsar.Scene.load(EXAMPLE)
    views = warpsar.simulate(scene)
    figure, axes = new(10.0, 3.9, ncols=len(views), sharey=True)
    for axis, view, declared in zip(axes, views, scene.views, strict=True):
        speckled = view.beta0["HH"] * np.random.default_rng(0).gamma(4.0, 0.25, view.beta0["HH"].shape)
        with np.errstate(divide="ignore"):
            decibel = np.maximum(10.0 * np.log10(speckled), -40.0)
        extent = (*_ends(view.azimuth_m), *_ends(view.range_m)[::-1])
        drawn = axis.imshow(decibel, "gray", vmin=LIMITS_DB[0], vmax=LIMITS_DB[1], extent=extent)
        axis.set_title(f"{view.name}: azimuth {declared.azimuth_deg:g}°, incidence {declared.incidence_deg:g}°", size=9)
        axis.set_xlabel("azimuth [m]")
    axes[0].set_ylabel("slant range [m]")
    figure.colorbar(drawn, ax=axes, label="beta0, HH, 4 looks [dB]", shrink=0.8)
    figures.save(figure, path)


def _ends(centres: np.ndarray) -> tuple[float, float]:
    half = (centres[1] - centres[0]) / 2.0
    return float(centres[0] - half), float(centres[-1] + half)


def loop(pictures: Path, path: Path) -> None:
    """README's picture: the measured image and its residual, the effect that is named, and what is left beside it."""
    before, after = (Image.open(pictures / name).convert("RGB") for name in ("measured.webp", "diagnosed.webp"))
    heading, third = 34, before.width // 2
    joined = Image.new("RGB", (before.width + after.width, before.height + heading), "white")
    joined.paste(before, (0, heading))
    joined.paste(after, (before.width, heading))
    words = ("1  measured", "2  residual: shadows are too bright", "3  noise_floor added: speckle is left")
    for index, each in enumerate(words):
        ImageDraw.Draw(joined).text((index * third + 14, 9), each, "black", font_size=17)
    joined.save(path, quality=65, method=6)
    print(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--pictures", type=Path, required=True)
    options = parser.parse_args()
    declared, learned = (options.out / name / "scene.toml" for name in ("measured", "learned"))
    step(options.pictures / "measured.webp", [("before any fit", declared)], True)
    step(options.pictures / "learned.webp", [("measured over learned surfaces", learned)], False)
    diagnosed = options.out / "diagnosed" / "scene.toml"
    step(options.pictures / "diagnosed.webp", [("measured over the diagnosed scene", diagnosed)], False)
    example(options.pictures.parent / "example.png")
    loop(options.pictures, options.pictures.parent / "loop.webp")


if __name__ == "__main__":
    main()
