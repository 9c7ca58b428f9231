"""Quick looks: an image of every polarization in dB, with axes in metres and a bar, all pictures on one scale.

Black is no power: shadow, or what reflects away. What no surface fills is dark blue: the mesh ends there. What was not
measured is bright blue.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.io import figures
from warpsar.io.grey_scale import EDGES_DB, UNMEASURED, WITHOUT_POWER, GreyScale, count, in_decibel, tinted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LARGEST = 960
"""Pixels along a side of a picture: larger images are averaged in power over blocks, so no strong point is left out."""
MOST_ON_A_SHEET = 64
_PANEL, _ROOM = 4.4, (1.5, 1.1)  # inches: the longer side of an image, at least; room for words, across and down
_PER_INCH = 100.0  # pixels of an image: fewer than a figure has (`figures.save`)


@dataclass(frozen=True)
class QuickLook:
    """A picture to be drawn at `path`: `power` of every polarization, linear, (rows, cols), of `size_m` in range and
    azimuth about the reference point. `covered`: where a surface lies, lit or hidden, (rows, cols); None where nobody
    says. It is small, so many may wait for their common scale."""

    path: Path
    title: str
    power: dict[str, NDArray[np.float32]]
    size_m: tuple[float, float]
    covered: NDArray[np.bool_] | None = None

    @classmethod
    def of(
        cls,
        path: Path,
        title: str,
        beta0: Mapping[str, ArrayLike],
        spacing_m: tuple[float, float],
        covered: NDArray[np.bool_] | None = None,
    ) -> QuickLook:
        """`beta0`: linear power by polarization, shape (rows, cols), near range in row 0; NaN where there is none."""
        arrays = {name: np.asarray(image, np.float32) for name, image in beta0.items()}
        rows, cols = next(iter(arrays.values())).shape
        size = (rows * spacing_m[0], cols * spacing_m[1])
        if covered is not None:
            covered = reduced(covered.astype(np.float32), LARGEST) > 0.5
        return cls(path, title, {name: reduced(image, LARGEST) for name, image in arrays.items()}, size, covered)

    def rgb(self, polarization: str, scale: GreyScale) -> NDArray[np.float64]:
        """Colours, 0 to 1, shape (rows, cols, 3); NaN where nothing was measured."""
        grey = scale.grey(in_decibel(self.power[polarization]))[..., None] * np.ones(3)
        return grey if self.covered is None else tinted(grey, self.covered)


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
    """How many pixels on a surface have which dB: counts that add up over pictures and over processes."""
    counts = np.zeros(EDGES_DB.size - 1, np.int64)
    for look in looks:
        for power in look.power.values():
            counts += count(power if look.covered is None else power[look.covered])
    return counts


def draw(look: QuickLook, scale: GreyScale) -> None:
    """Write the PNG: a panel for each polarization; range runs down from the radar, azimuth across."""
    deep, wide = look.size_m
    inches = max(_PANEL, max(next(iter(look.power.values())).shape) / _PER_INCH) / max(deep, wide)
    across, down = max(wide * inches, 1.2), max(deep * inches, 1.2)
    count = len(look.power)
    figure, axes = figures.new(
        count * across + _ROOM[0], down + _ROOM[1], ncols=count, sharex=True, sharey=True, squeeze=False
    )
    for name, axis in zip(look.power, axes[0], strict=True):
        _imshow(axis, look, name, scale)
        axis.set_title(name, fontsize=9)
        axis.set_xlabel("azimuth [m]", fontsize=9)
        axis.tick_params(labelsize=8)
    axes[0, 0].set_ylabel("slant range [m], radar above", fontsize=9)
    add_bar(figure, scale, 9, ax=axes.ravel().tolist(), shrink=0.9)
    add_legend(figure, [look], 8)
    figure.suptitle(look.title, fontsize=10)
    figures.save(figure, look.path)


def add_bar(figure: Figure, scale: GreyScale, size: float, **where: Any) -> None:
    """A bar of greys, linear in dB; `size` of its label in points, `where` as `Figure.colorbar` has it."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.ticker import MaxNLocator

    greys = ScalarMappable(scale.norm(), scale.colours())
    bar = figure.colorbar(greys, ticks=MaxNLocator(9, steps=[1, 2, 5, 10], integer=True), **where)
    bar.set_label("beta0 [dB]", fontsize=size)
    bar.ax.tick_params(labelsize=size - 1)


def add_legend(figure: Figure, looks: Iterable[QuickLook], size: float) -> None:
    """What the colours mean that are no grey, of those that pictures have, below them."""
    from matplotlib.patches import Patch

    looks = list(looks)
    meanings: dict[str, tuple[str | tuple[float, float, float], bool]] = {
        "no mesh there": (WITHOUT_POWER, any(one.covered is not None and not one.covered.all() for one in looks)),
        "not measured": (UNMEASURED, any(np.isnan(power).any() for one in looks for power in one.power.values())),
    }
    shown = [Patch(facecolor=colour, edgecolor="black", lw=0.5, label=name)
             for name, (colour, there) in meanings.items() if there]  # fmt: skip
    if shown:
        figure.legend(handles=shown, loc="outside lower right", ncols=len(shown), fontsize=size, frameon=False)


def _imshow(axis: Axes, look: QuickLook, polarization: str, scale: GreyScale) -> None:
    deep, wide = look.size_m
    rgb = look.rgb(polarization, scale)
    axis.set_facecolor(UNMEASURED)
    seen = np.isfinite(rgb[..., :1])
    extent = (-wide / 2.0, wide / 2.0, deep / 2.0, -deep / 2.0)
    axis.imshow(np.concatenate([np.nan_to_num(rgb), seen], axis=2), extent=extent, interpolation="nearest")


def draw_together(looks: list[QuickLook]) -> None:
    """Draw pictures of one command on their common scale."""
    scale = GreyScale.of_counts(shades(looks))
    for look in looks:
        draw(look, scale)


def contact_sheet(path: Path, looks: list[QuickLook]) -> None:
    """Write one PNG of many pictures of one polarization, `MOST_ON_A_SHEET` at most, evenly chosen; on one scale."""
    chosen = [looks[i] for i in np.unique(np.linspace(0, len(looks) - 1, MOST_ON_A_SHEET).astype(int))]
    scale = GreyScale.of_counts(shades(looks))
    across = int(np.ceil(np.sqrt(len(chosen))))
    down = -(-len(chosen) // across)
    figure, axes = figures.new(1.3 * across + 1.2, 1.4 * down + 0.5, nrows=down, ncols=across, squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
    for look, axis in zip(chosen, axes.flat, strict=False):
        (polarization,) = look.power
        _imshow(axis, look, polarization, scale)
        axis.set_title(look.title.partition(":")[0].removesuffix(", measured"), fontsize=6)
    add_bar(figure, scale, 8, ax=axes.ravel().tolist(), shrink=0.9)
    add_legend(figure, chosen, 8)
    few = "" if len(chosen) == len(looks) else f"{len(chosen)} of {len(looks)} views, each "
    deep, wide = chosen[0].size_m
    figure.suptitle(f"{few}{deep:g} m in slant range (down) by {wide:g} m in azimuth", fontsize=8)
    figures.save(figure, path)


def draw_blank(polarizations: Iterable[str], shape: tuple[int, int], spacing_m: tuple[float, float]) -> None:
    """Draw what takes as long as a picture of an image of `shape`, and keep nothing of it."""
    power = {name: np.ones([min(n, LARGEST) for n in shape], np.float32) for name in polarizations}
    with TemporaryDirectory() as folder:
        draw_together([QuickLook.of(Path(folder) / "quick_look.png", "", power, spacing_m)])
