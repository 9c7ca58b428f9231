"""Quick looks: an image of every polarization in dB, with axes in metres and a bar, all pictures on one scale."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.io import figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

LARGEST = 1000
"""Pixels along a side of a picture: larger images are averaged in power over blocks."""
DEEPEST_DB = 45.0
"""The most that one scale spans."""
MOST_ON_A_SHEET = 64
_EDGES_DB = np.arange(-160.0, 100.25, 0.25)
_PANEL, _ROOM = 4.4, (1.5, 1.1)  # inches: the longer side of an image; room for words, across and down


@dataclass(frozen=True)
class QuickLook:
    """A picture to be drawn at `path`: `power` of every polarization, linear, (rows, cols), of `size_m` in range and
    azimuth about the reference point. It is small, so many may wait for their common scale."""

    path: Path
    title: str
    power: dict[str, NDArray[np.float32]]
    size_m: tuple[float, float]

    @classmethod
    def of(cls, path: Path, title: str, beta0: Mapping[str, ArrayLike], spacing_m: tuple[float, float]) -> QuickLook:
        """`beta0`: linear power by polarization, shape (rows, cols), near range in row 0; NaN where there is none."""
        arrays = {name: np.asarray(image, np.float32) for name, image in beta0.items()}
        rows, cols = next(iter(arrays.values())).shape
        size = (rows * spacing_m[0], cols * spacing_m[1])
        return cls(path, title, {name: reduced(image, LARGEST) for name, image in arrays.items()}, size)


def reduced(power: NDArray[np.float32], largest: int) -> NDArray[np.float32]:
    """Means over blocks, so that no side is above `largest` pixels; pixels that are not finite do not count."""
    step = -(-max(power.shape) // largest)
    if step == 1:
        return power
    starts = [np.arange(0, n, step) for n in power.shape]
    finite = np.isfinite(power)

    def blocks(a: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.add.reduceat(np.add.reduceat(a, starts[0], axis=0), starts[1], axis=1)

    with np.errstate(invalid="ignore"):
        found = blocks(np.where(finite, power, np.float32(0.0))) / blocks(finite.astype(np.float32))
    return np.asarray(found, np.float32)


def shades(looks: Iterable[QuickLook]) -> NDArray[np.int64]:
    """How many pixels have which dB: counts that add up over pictures and over processes."""
    counts = np.zeros(_EDGES_DB.size - 1, np.int64)
    for look in looks:
        for power in look.power.values():
            positive = power[np.isfinite(power) & (power > 0)]
            counts += np.histogram(10.0 * np.log10(positive.astype(float)), _EDGES_DB)[0]
    return counts


def limits_db(counts: NDArray[np.int64]) -> tuple[float, float]:
    """Black and white [dB] of all pictures: the 2nd and 99.5th percentile in whole dB, at most `DEEPEST_DB` apart."""
    total = counts.sum()
    if not total:
        return -1.0, 0.0
    share = np.cumsum(counts) / total
    low = float(np.floor(_EDGES_DB[np.searchsorted(share, 0.02)]))
    high = float(np.ceil(_EDGES_DB[np.searchsorted(share, 0.995) + 1]))
    return max(low, high - DEEPEST_DB), high


def draw(look: QuickLook, limits: tuple[float, float]) -> None:
    """Write the PNG: a panel for each polarization; range runs down from the radar, azimuth across."""
    deep, wide = look.size_m
    inches = _PANEL / max(deep, wide)
    across, down = max(wide * inches, 1.2), max(deep * inches, 1.2)
    count = len(look.power)
    figure, axes = figures.new(
        count * across + _ROOM[0], down + _ROOM[1], ncols=count, sharex=True, sharey=True, squeeze=False
    )
    for (name, power), axis in zip(look.power.items(), axes[0], strict=True):
        shown = _imshow(axis, power, look.size_m, limits)
        axis.set_title(name, fontsize=9)
        axis.set_xlabel("azimuth [m]", fontsize=9)
        axis.tick_params(labelsize=8)
    axes[0, 0].set_ylabel("slant range [m], radar above", fontsize=9)
    bar = figure.colorbar(shown, ax=axes.ravel().tolist(), shrink=0.9, extend="both")
    bar.set_label("beta0 [dB]", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    figure.suptitle(look.title, fontsize=10)
    figures.save(figure, look.path)


def _imshow(
    axis: Axes, power: NDArray[np.float32], size_m: tuple[float, float], limits: tuple[float, float]
) -> AxesImage:
    """The image in dB; blue where nothing was measured, which is no shadow."""
    deep, wide = size_m
    with np.errstate(invalid="ignore"):
        decibel = np.where(np.isfinite(power), 10.0 * np.log10(np.maximum(power, 1e-30)), np.nan)
    axis.set_facecolor("tab:blue")
    extent = (-wide / 2.0, wide / 2.0, deep / 2.0, -deep / 2.0)
    return axis.imshow(decibel, "gray", vmin=limits[0], vmax=limits[1], extent=extent, interpolation="nearest")


def draw_together(looks: list[QuickLook]) -> None:
    """Draw pictures of one command on their common scale."""
    limits = limits_db(shades(looks))
    for look in looks:
        draw(look, limits)


def contact_sheet(path: Path, looks: list[QuickLook]) -> None:
    """Write one PNG of many pictures of one polarization, `MOST_ON_A_SHEET` at most, evenly chosen; on one scale."""
    chosen = [looks[i] for i in np.unique(np.linspace(0, len(looks) - 1, MOST_ON_A_SHEET).astype(int))]
    limits = limits_db(shades(looks))
    across = int(np.ceil(np.sqrt(len(chosen))))
    down = -(-len(chosen) // across)
    figure, axes = figures.new(1.3 * across + 1.2, 1.4 * down + 0.5, nrows=down, ncols=across, squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
    for look, axis in zip(chosen, axes.flat, strict=False):
        (power,) = look.power.values()
        shown = _imshow(axis, power, look.size_m, limits)
        axis.set_title(look.title.partition(":")[0].removesuffix(", measured"), fontsize=6)
    bar = figure.colorbar(shown, ax=axes.ravel().tolist(), shrink=0.9, extend="both")
    bar.set_label("beta0 [dB]", fontsize=8)
    few = "" if len(chosen) == len(looks) else f"{len(chosen)} of {len(looks)} views, each "
    deep, wide = chosen[0].size_m
    figure.suptitle(f"{few}{deep:g} m in slant range (down) by {wide:g} m in azimuth", fontsize=8)
    figures.save(figure, path)


def draw_blank(polarizations: Iterable[str], shape: tuple[int, int], spacing_m: tuple[float, float]) -> None:
    """Draw what takes as long as a picture of an image of `shape`, and keep nothing of it."""
    power = {name: np.ones([min(n, LARGEST) for n in shape], np.float32) for name in polarizations}
    with TemporaryDirectory() as folder:
        draw_together([QuickLook.of(Path(folder) / "quick_look.png", "", power, spacing_m)])
