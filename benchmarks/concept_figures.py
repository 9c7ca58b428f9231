"""The drawings of docs/concepts.md: a building in slant range, and speckle by its looks.

python benchmarks/concept_figures.py docs/figures
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from warpsar.io.figures import new

INCIDENCE = np.radians(45.0)
WIDTH_M, HEIGHT_M = 10.0, 8.0  # of the building, whose wall stands at x = 0
NEAR_M, FAR_M = -16.0, 28.0
COLOURS = {"ground": "#5a8f4f", "wall": "#b5523b", "roof": "#4a6fa5", "corner": "#c98a00", "shadow": "#333333"}


def slant_range(x: Any, z: Any) -> Any:
    """Of a point of the drawing about the foot of the wall [m]; a plane wave comes from the upper left."""
    return x * np.sin(INCIDENCE) - z * np.cos(INCIDENCE)


def section(axis: Any) -> None:
    """The building from the side, coloured by what each part becomes in the image."""
    shadow_end = WIDTH_M + HEIGHT_M * np.tan(INCIDENCE)
    axis.fill_between([0, WIDTH_M], 0, HEIGHT_M, color="#eeeeee")
    axis.fill([WIDTH_M, WIDTH_M, shadow_end], [HEIGHT_M, 0, 0], color="#dddddd")
    for xs in ([NEAR_M, 0.0], [shadow_end, FAR_M]):
        axis.plot(xs, [0, 0], color=COLOURS["ground"], lw=4)
    axis.plot([WIDTH_M, shadow_end], [0, 0], color=COLOURS["shadow"], lw=4)
    axis.plot([0, 0], [0, HEIGHT_M], color=COLOURS["wall"], lw=4)
    axis.plot([0, WIDTH_M], [HEIGHT_M, HEIGHT_M], color=COLOURS["roof"], lw=4)
    axis.plot([WIDTH_M, WIDTH_M], [0, HEIGHT_M], color=COLOURS["shadow"], lw=2)
    axis.plot(0, 0, "o", color=COLOURS["corner"], ms=9, zorder=5)
    along, front = np.array([np.sin(INCIDENCE), -np.cos(INCIDENCE)]), np.array([np.cos(INCIDENCE), np.sin(INCIDENCE)])
    for distance in (-slant_range(0, HEIGHT_M) * np.array([-1.0, 0.0])).tolist():  # through the eaves, through the foot
        ends = np.array([along * distance + front * t for t in (-22.0, 22.0)])
        axis.plot(*ends.T, "--", color="#888888", lw=1)
    for start in ((-14.0, 17.0), (-10.0, 17.0), (-6.0, 17.0)):
        axis.annotate("", np.array(start) + 4 * along, start, arrowprops={"arrowstyle": "->", "color": "#555555"})
    axis.text(-15.5, 13.2, "from\nthe radar", fontsize=8, color="#555555", va="top")
    axis.text(5, 4, "building", ha="center", fontsize=9)
    axis.text(WIDTH_M + 2.2, 1.6, "shadow", fontsize=9)
    axis.text(12.5, 10.0, "dashed: all points of one slant range", fontsize=8, color="#555555")
    axis.text(0.5, -2.6, "corner: two bounces", fontsize=8, color=COLOURS["corner"])
    axis.set(xlim=(NEAR_M, FAR_M), ylim=(-4, 18), xlabel="ground range [m]", ylabel="height [m]", aspect="equal")
    axis.set_title("the building from the side", fontsize=10)


def row(axis: Any) -> None:
    """What of it falls into which slant range."""
    shadow_end = WIDTH_M + HEIGHT_M * np.tan(INCIDENCE)
    parts = [
        ("roof", slant_range(0, HEIGHT_M), slant_range(WIDTH_M, HEIGHT_M)),
        ("wall", slant_range(0, HEIGHT_M), slant_range(0, 0)),
        ("ground", slant_range(NEAR_M, 0), slant_range(0, 0)),
        ("ground", slant_range(shadow_end, 0), slant_range(FAR_M, 0)),
        ("shadow", slant_range(WIDTH_M, HEIGHT_M), slant_range(shadow_end, 0)),
    ]
    heights = {"ground": 0, "wall": 1, "roof": 2, "shadow": 0}
    for name, start, end in parts:
        fill = {"facecolor": "white", "hatch": "////"} if name == "shadow" else {"facecolor": COLOURS[name]}
        axis.barh(heights[name], end - start, left=start, height=0.7, edgecolor=COLOURS[name], **fill)
    axis.barh(3, 0.6, left=-0.3, height=0.7, color=COLOURS["corner"])
    axis.text(0.6, 3, "bright line at the foot of the wall", fontsize=8, va="center")
    left, right = slant_range(0, HEIGHT_M), 0.0
    axis.axvspan(left, right, color="#f3e3c0", zorder=0)
    axis.text((left + right) / 2, 3.75, "layover", ha="center", fontsize=9)
    axis.text(slant_range(WIDTH_M + 3, HEIGHT_M / 2), 0.55, "shadow: nothing comes back", fontsize=8)
    axis.set_yticks([0, 1, 2, 3], ["ground", "wall", "roof", "corner"])
    axis.set(xlim=(slant_range(NEAR_M, 0), slant_range(FAR_M, 0)), ylim=(-0.6, 4.4))
    axis.set_xlabel("slant range about the foot of the wall [m]; pixels are cut along it")
    axis.set_title("where its parts lie in the image", fontsize=10)


def speckle(figure: Figure, axes: Any) -> None:
    """The same even ground with 1, 4 and 16 looks."""
    random = np.random.default_rng(3)
    for axis, looks in zip(axes, (1, 4, 16), strict=True):
        decibel = 10.0 * np.log10(random.gamma(looks, 1.0 / looks, (48, 48)))
        drawn = axis.imshow(decibel, "gray", vmin=-15.0, vmax=6.0)
        axis.set_title(f"{looks} look{'s' if looks > 1 else ''}", fontsize=10)
        axis.set_xlabel("azimuth [pixels]", fontsize=8)
        axis.tick_params(labelsize=7)
    axes[0].set_ylabel("slant range [pixels]", fontsize=8)
    figure.colorbar(drawn, ax=list(axes), shrink=0.8, extend="both").set_label("power over its mean [dB]", fontsize=8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    figure, axes = new(7.6, 6.6, nrows=2, gridspec_kw={"height_ratios": [3, 2]})
    section(axes[0])
    row(axes[1])
    figure.savefig(folder / "concept_building.png", dpi=100)
    figure, axes = new(8.4, 3.0, ncols=3)
    speckle(figure, axes)
    figure.savefig(folder / "concept_looks.png", dpi=100)


if __name__ == "__main__":
    main()
