"""The README's picture: the example's three views in dB.  python benchmarks/example_figure.py --out docs/figures"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import warpsar
from warpsar.io.figures import new, save

HERE = Path(__file__).resolve().parent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--device")
    options = parser.parse_args()
    scene = warpsar.Scene.load(HERE.parent / "data" / "example" / "scene.toml")
    views = warpsar.simulate(scene, device=options.device)
    figure, axes = new(10.0, 3.9, ncols=len(views), sharey=True)
    for axis, view, declared in zip(axes, views, scene.views, strict=True):
        speckled = view.beta0["HH"] * np.random.default_rng(0).gamma(4.0, 0.25, view.beta0["HH"].shape)
        with np.errstate(divide="ignore"):
            decibel = 10.0 * np.log10(speckled)
        extent = (*_ends(view.azimuth_m), *_ends(view.range_m)[::-1])
        drawn = axis.imshow(np.maximum(decibel, -40.0), cmap="gray", vmin=-35.0, vmax=0.0, extent=extent)
        axis.set_title(f"{view.name}: azimuth {declared.azimuth_deg:g}°, incidence {declared.incidence_deg:g}°", size=9)
        axis.set_xlabel("azimuth [m]")
    axes[0].set_ylabel("slant range [m]")
    figure.colorbar(drawn, ax=axes, label="beta0, HH, 4 looks [dB]", shrink=0.8)
    save(figure, options.out / "example.png")


def _ends(centres: np.ndarray) -> tuple[float, float]:
    half = (centres[1] - centres[0]) / 2.0
    return float(centres[0] - half), float(centres[-1] + half)


if __name__ == "__main__":
    main()
