"""One picture per effect: the example scene without it, with it, and the ratio of the two.

    python benchmarks/effect_figures.py --out docs/figures

Each effect says by itself which values its picture has (`Effect.example`). The pictures are committed.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from scenes import example_with

from warpsar import Scene, simulate
from warpsar.effects.registry import get, names


def scene_with(name: str | None) -> Scene:
    """The example seen along its walls, in a second of CPU time; with one effect, or with none."""
    scene = example_with(name, 64.0)
    return dataclasses.replace(
        scene,
        views=[view.model_copy(update={"azimuth_deg": 2.0}) for view in scene.views],
        radar=scene.radar.model_copy(update={"polarizations": ("HH",)}),
    )


def decibels(image: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return 10.0 * np.log10(image.astype(float))


def draw(name: str, without: np.ndarray, out: Path) -> Path:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    scene = scene_with(name)
    with_it = simulate(scene, device="cpu")[0].beta0["HH"]
    half = [n * step / 2 for n, step in zip(scene.grid.shape, scene.grid.spacing_m, strict=True)]
    extent = (-half[1], half[1], half[0], -half[0])
    figure, axes = plt.subplots(1, 3, figsize=(10.5, 3.7), layout="constrained")
    low, high = np.percentile(decibels(without[without > 0]), [2, 99.5])
    for axis, image, title in zip(axes, (without, with_it), ("without", "with"), strict=False):
        axis.set_facecolor("black")  # no power at all
        grey = axis.imshow(decibels(image), cmap="gray", vmin=low - 6, vmax=high + 6, extent=extent)
        axis.set_title(f"{title} {name}")
    figure.colorbar(grey, ax=axes[:2], label="beta0 [dB]", shrink=0.85)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(with_it == without, 0.0, decibels(with_it) - decibels(without))
    largest = np.clip(np.percentile(np.abs(ratio[np.isfinite(ratio)]), 99.5), 1.0, 20.0)
    colours = axes[2].imshow(
        np.clip(ratio, -1e3, 1e3), cmap="RdBu_r", vmin=-largest, vmax=largest, extent=extent, interpolation="nearest"
    )
    axes[2].set_title("with / without")
    figure.colorbar(colours, ax=axes[2], label="[dB]", shrink=0.85)
    axes[0].set_ylabel("slant range [m]")
    for axis in axes:
        axis.set_xlabel("azimuth [m]")
        axis.set_xlim(-35.0, 35.0)
        axis.set_ylim(28.0, -30.0)
    path = out / f"effect_{name}.png"
    figure.savefig(path, dpi=72, pil_kwargs={"optimize": True})
    plt.close(figure)
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the pictures")
    parser.add_argument("names", nargs="*", default=list(names()), help="effects; all by default")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    without = simulate(scene_with(None), device="cpu")[0].beta0["HH"]
    for name in arguments.names:
        print(f"{draw(name, without, arguments.out)}: {get(name).summary}")


if __name__ == "__main__":
    main()
