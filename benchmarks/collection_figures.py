"""Figures of docs/collections.md: a complex image with its spectrum and histogram, and an interferogram.

python benchmarks/collection_figures.py [-o docs/figures] [--device cpu]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import warpsar
from warpsar.collection.slc import Slc
from warpsar.io.figures import new, save

ROOT = Path(__file__).resolve().parent.parent
SCENE = ROOT / "data" / "collection" / "scene.toml"
BASELINE = 0.06
"""Between two passes, as an angle of incidence [deg]: a fringe is then 10 m of height."""


def image_figure(path: Path, made: Slc, ground: np.ndarray) -> None:
    """Power in dB; the spectrum in dB; and a histogram of power over its mean on even `ground`, beside exp(-x)."""
    (image,) = made.images.values()
    figure, axes = new(11.0, 3.6, ncols=3)
    power = np.abs(image) ** 2
    extent = (*made.azimuth_m[[0, -1]], *made.range_m[[-1, 0]])
    level = 10 * np.log10(power + 1e-12)
    axes[0].imshow(level, extent=extent, cmap="gray", vmin=-35, vmax=0)
    axes[0].set(xlabel="azimuth [m]", ylabel="slant range [m]", title="beta0 of one image [dB]")
    spectrum = np.abs(np.fft.fftshift(np.fft.fft2(image))) ** 2
    steps = [axis[1] - axis[0] for axis in (made.range_m, made.azimuth_m)]
    ends = (-0.5 / steps[1], 0.5 / steps[1], 0.5 / steps[0], -0.5 / steps[0])
    shown = 10 * np.log10(spectrum / spectrum.max() + 1e-9)
    axes[1].imshow(shown, extent=ends, cmap="viridis", vmin=-50, vmax=0)
    axes[1].set(xlabel="azimuth frequency [1/m]", ylabel="range frequency [1/m]", title="spectrum [dB]")
    seen = power[ground] / power[ground].mean()
    axes[2].hist(seen, bins=40, range=(0, 6), density=True, color="0.7")
    x = np.linspace(0, 6, 100)
    axes[2].plot(x, np.exp(-x), "k", lw=1)
    axes[2].set(xlabel="power over its mean", ylabel="density", yscale="log", title="lawn, and exp(-x)")
    save(figure, path)


def interferogram_figure(path: Path, one: Slc, two: Slc) -> None:
    """Phase of two passes without the level plane's, and their coherence over 5 x 5 pixels."""
    from scipy.ndimage import uniform_filter

    first, second = (next(iter(made.images.values())).astype(complex) for made in (one, two))
    plane = []
    for made in (one, two):  # a point of the level plane at one slant range of the first pass
        slant = one.range_m[:, None]
        outward = np.array([*one.plan.geometry.d[:2], 0.0]) / np.hypot(*one.plan.geometry.d[:2]) ** 2
        points = slant[..., None] * outward + one.azimuth_m[None, :, None] * one.plan.geometry.u
        ways = made.plan.track.centre().ranges_less_reference(points.reshape(-1, 3), np.array([0]))[0]
        plane.append(ways.reshape(first.shape))
    turns = 2.0 * one.plan.centre_hz / 299792458.0 * (plane[0] - plane[1])
    product = first * second.conj() * np.exp(2j * np.pi * turns)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray(uniform_filter(values.real, 5) + 1j * uniform_filter(values.imag, 5))

    smooth = mean(product)
    coherence = np.abs(smooth) / np.sqrt(mean(np.abs(first) ** 2).real * mean(np.abs(second) ** 2).real)
    extent = (*one.azimuth_m[[0, -1]], *one.range_m[[-1, 0]])
    figure, axes = new(8.4, 3.9, ncols=2)
    shown = axes[0].imshow(np.angle(smooth), extent=extent, cmap="twilight", vmin=-np.pi, vmax=np.pi)
    figure.colorbar(shown, ax=axes[0], label="phase [rad]")
    shown = axes[1].imshow(coherence, extent=extent, cmap="gray", vmin=0, vmax=1)
    figure.colorbar(shown, ax=axes[1], label="coherence")
    for axis in axes:
        axis.set(xlabel="azimuth [m]", ylabel="slant range [m]")
    save(figure, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "docs" / "figures")
    parser.add_argument("--device")
    options = parser.parse_args()
    scene = warpsar.Scene.load(SCENE)
    (one,) = warpsar.slc(scene, device=options.device)
    layers = warpsar.simulate(scene, device=options.device, layers=True)[0].layers
    names = list(scene.mesh.materials)
    even = np.isin(layers["material"], [names.index("lawn")]) & (layers["layover"] == 1)
    image_figure(options.out / "collection_slc.png", one, even)
    view = scene.views[0]
    other = view.model_copy(update={"name": "again", "stated_incidence_deg": view.incidence_deg + BASELINE})
    first, second = warpsar.slc(replace(scene, views=[view, other]), device=options.device)
    interferogram_figure(options.out / "collection_interferogram.png", first, second)


if __name__ == "__main__":
    main()
