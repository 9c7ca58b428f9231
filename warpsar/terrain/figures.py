"""Pictures of layers, with axes and scales."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.io import figures
from warpsar.io.bands import bands_of, release
from warpsar.io.grey_scale import GreyScale, in_decibel
from warpsar.runtime.threads import in_threads
from warpsar.terrain.comparison import TerrainComparison
from warpsar.terrain.differences import TerrainDifferences
from warpsar.terrain.layers import Layer, of_image, of_map
from warpsar.terrain.result import SimulatedProduct

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST = 700
"""Pixels along a picture's longer side."""
IN_PICTURE = ("measured", "beta0", "gamma0", "incidence", "shadow")
ON_MAP = ("measured_gamma0", "gamma0", "incidence", "shadow")
SEEN = (("seen once", "#e8e4d8"), ("layover", "#c1440e"), ("shadow", "#1b2a41"), ("layover in part shadow", "#7b4fa0"))
"""What a panel of `shadow` shows together with `layover`."""


def thinned(values: np.ndarray) -> np.ndarray:
    """Means of blocks, so that the longer side has `MOST` at most."""
    step = max(-(-max(values.shape) // MOST), 1)
    rows, columns = (n // step for n in values.shape)
    if step == 1 or not rows or not columns:
        return np.asarray(values)
    means = []
    for band in bands_of((rows * step, values.shape[1]), step):
        cut = np.asarray(values[band, : columns * step]).reshape(-1, step, columns, step)
        known = np.isfinite(cut)
        count = known.sum(axis=(1, 3))
        total = np.where(known, cut, 0.0).sum(axis=(1, 3))
        means.append(np.where(count > 0, total / np.maximum(count, 1), np.nan))
        release(values)
    return np.concatenate(means)


def image_figure(found: SimulatedProduct) -> Figure:
    """Layers on the product's grid."""
    lines, pixels = found.window.lines, found.window.pixels
    ends = (pixels[0] - 0.5, pixels[1] - 0.5, lines[1] - 0.5, lines[0] - 0.5)
    chosen = [of_image(name) for name in IN_PICTURE if name in found.image]
    return _panels(found.image, chosen, ends, ("pixel", "line"), _aspect(found))


def map_figure(found: SimulatedProduct) -> Figure:
    """Layers on the map."""
    affine, crs = found.map_place.affine, found.map_place.crs
    rows, columns = next(iter(found.map.values())).shape
    ends = (affine.c, affine.c + columns * affine.a, affine.f + rows * affine.e, affine.f)
    if found.map_place.askew:
        ends, labels, aspect = (0.0, columns, rows, 0.0), ("column", "row"), 1.0
    elif crs.is_geographic:
        labels, aspect = ("longitude [deg]", "latitude [deg]"), 1.0 / np.cos(np.deg2rad(0.5 * (ends[2] + ends[3])))
    else:
        labels, aspect = (f"east [{crs.linear_units}]", f"north [{crs.linear_units}]"), 1.0
    chosen = [of_map(name) for name in ON_MAP if name in found.map]
    return _panels(found.map, chosen, ends, labels, float(aspect))


def comparison_figure(found: SimulatedProduct, against: TerrainComparison) -> Figure:
    """Cells: measured and simulated on one scale about their medians, and the residual."""
    spread = _spread(against.measured_db - np.nanmedian(against.measured_db))
    panels = [
        (f"{name}, less its median [dB]", values - np.nanmedian(values), "gray", spread)
        for name, values in (("measured", against.measured_db), ("simulated", against.simulated_db))
    ]
    panels.append(("residual, less its median [dB]", against.residual_db, "RdBu_r", spread))
    return _of_cells(found, against.cell, panels)


def differences_figure(found: SimulatedProduct, differs: TerrainDifferences) -> Figure:
    """Cells: measured less the model without and with what was found, on one scale."""
    spread = _spread(differs.before_db)
    panels = [
        (f"measured less model, {name} [dB]", values, "RdBu_r", spread)
        for name, values in (("before", differs.before_db), ("after", differs.after_db))
    ]
    return _of_cells(found, differs.cell, panels)


def _spread(values: np.ndarray) -> float:
    return max(float(np.nanpercentile(np.abs(values), 98)), 1.0)


def _of_cells(
    found: SimulatedProduct, cell: tuple[int, int], panels: list[tuple[str, np.ndarray, str, float]]
) -> Figure:
    """Pictures of cells beside each other: title, values, colours, and the scale's end on both sides of 0."""
    lines, pixels = found.window.lines, found.window.pixels
    rows, columns = panels[0][1].shape
    ends = (
        pixels[0] - 0.5, pixels[0] - 0.5 + columns * cell[1], lines[0] - 0.5 + rows * cell[0], lines[0] - 0.5
    )  # fmt: skip
    aspect = _aspect(found)
    tall = abs(ends[3] - ends[2]) * aspect / abs(ends[1] - ends[0])
    width = 4.2 * len(panels)
    figure, axes = figures.new(width, float(np.clip(2.7 * tall, 1.6, 6.0)) + 0.9, ncols=len(panels))
    for axis, (title, values, colours, spread) in zip(axes, panels, strict=True):
        drawn = axis.imshow(
            values, cmap=colours, vmin=-spread, vmax=spread, extent=ends, aspect=aspect, interpolation="nearest"
        )
        _dress(axis, title)
        axis.set_xlabel("pixel")
        axis.set_ylabel("line")
        figure.colorbar(drawn, ax=axis, label="dB", shrink=0.85)
    return figure


def _aspect(found: SimulatedProduct) -> float:
    """Of a line to a pixel on the ground, by areas: a picture is shown as the ground lies."""
    area = float(np.nanmedian(thinned(found.image["area_sigma"])))
    product = found.product
    middle = [0.5 * (a + b - 1) for a, b in (found.window.lines, found.window.pixels)]
    mean = 0.5 * (found.elevation.lowest_m + found.elevation.highest_m)
    geodetic = np.deg2rad(product.to_ground([middle[0], middle[0] + 1], [middle[1]] * 2, mean)[:, :2])
    north, east = np.diff(geodetic, axis=0)[0]
    line_m = 6.371e6 * np.hypot(north, east * np.cos(geodetic[0, 0]))
    return float(line_m / max(area / line_m, 1e-6))


def _panels(
    layers: dict[str, np.ndarray],
    chosen: list[Layer],
    ends: tuple[float, float, float, float],
    labels: tuple[str, str],
    aspect: float,
) -> Figure:
    columns = 2 if len(chosen) in (2, 4) else min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    tall = abs(ends[3] - ends[2]) * aspect / abs(ends[1] - ends[0])
    height = float(np.clip(2.7 * tall, 1.6, 6.0)) + 0.9
    figure, axes = figures.new(4.2 * columns, height * rows, nrows=rows, ncols=columns, squeeze=False)
    figure.set_layout_engine("compressed")  # else a bar stands apart from a picture that is narrow
    names = [*(one.name for one in chosen), *("layover" for one in chosen if one.name == "shadow")]
    shown = dict(zip(names, in_threads([partial(thinned, layers[name]) for name in names]), strict=True))
    powers = [shown[one.name] for one in chosen if one.kind == "power"]
    scale = GreyScale.of(powers) if powers else None
    for axis, layer in zip(axes.flat, chosen, strict=False):
        if layer.name == "shadow":
            _seen_panel(axis, shown, ends, aspect)
        else:
            _panel(axis, shown[layer.name], layer, ends, aspect, scale)
        axis.set_xlabel(labels[0])
        axis.set_ylabel(labels[1])
    for axis in axes.flat[len(chosen) :]:
        axis.set_visible(False)
    return figure


def _seen_panel(
    axis: Axes, thin: dict[str, np.ndarray], ends: tuple[float, float, float, float], aspect: float
) -> None:
    """Layover and shadow in one picture. A mean of pixels counts for what most of them are."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    layover, shadow = thin["layover"], thin["shadow"]
    shown = np.where(np.isnan(shadow), np.nan, 1.0 * (layover >= 0.5) + 2.0 * (shadow >= 0.5))
    colours = ListedColormap([colour for _, colour in SEEN])
    axis.imshow(shown, cmap=colours, vmin=-0.5, vmax=3.5, extent=ends, aspect=aspect, interpolation="nearest")
    _dress(axis, "layover and shadow")
    there = [one for k, one in enumerate(SEEN) if k in (0, 1, 2) or (shown == k).any()]
    handles = [Patch(facecolor=colour, edgecolor="0.3", label=name) for name, colour in there]
    # below: beside it, the words would widen the column of other panels
    axis.legend(
        handles=handles, fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.16), frameon=False,
        ncols=2, handlelength=1.2, columnspacing=0.9,
    )  # fmt: skip


def _dress(axis: Axes, title: str) -> None:
    axis.set_facecolor("#bcd0e0")
    axis.set_title(title, fontsize=10)
    axis.locator_params(nbins=4)
    axis.ticklabel_format(useOffset=False)
    axis.tick_params(labelsize=7)


def _panel(
    axis: Axes,
    shown: np.ndarray,
    layer: Layer,
    ends: tuple[float, float, float, float],
    aspect: float,
    scale: GreyScale | None,
) -> None:
    options: dict[str, Any] = {"extent": ends, "aspect": aspect, "interpolation": "nearest"}
    label = {"power": f"{layer.name} [dB]", "angle": f"{layer.name} [deg]"}.get(layer.kind, layer.name)
    if layer.kind == "power" and scale is not None:
        drawn = axis.imshow(in_decibel(shown), cmap=scale.colours(), norm=scale.norm(), **options)
    elif layer.kind == "angle":
        drawn = axis.imshow(shown, cmap="viridis", vmin=0.0, vmax=90.0, **options)
    else:
        drawn = axis.imshow(shown, cmap="cividis", vmin=0.0, vmax=1.0, **options)
    _dress(axis, layer.name.replace("_", " "))
    axis.figure.colorbar(drawn, ax=axis, label=label, shrink=0.85)
