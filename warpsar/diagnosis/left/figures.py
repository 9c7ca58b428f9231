"""Three pictures of what is left: in the worst view, in plan, and as a spectrum with profiles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import uniform_filter

from warpsar.diagnosis.found import Diagnosis
from warpsar.diagnosis.left.summary import Left
from warpsar.evaluation.report_parts import RESIDUAL_COLOURS
from warpsar.io.figures import new

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REACH_SD = 4.0  # ends of the colour scale of a residual, in standard deviations
SMOOTHED = 3  # pixels on a side, over which the residual in plan is averaged
LEAST_DB, MOST_DB = 0.0, 15.0  # colour scale of the spectrum, over speckle


def worst_view(left: Left, spacing_m: Sequence[float]) -> Figure:
    """The residual of the image that shows it best, the rectangle marked."""
    from matplotlib.patches import Rectangle

    figure, axis = new(5.2, 4.4)
    residual = left.residuals[left.number]
    rows, cols = residual.shape
    down, across = spacing_m
    extent = (-cols / 2 * across, cols / 2 * across, rows / 2 * down, -rows / 2 * down)
    shown = axis.imshow(
        np.where(left.masks[left.number], residual, np.nan),
        cmap=_colours(),
        vmin=-REACH_SD,
        vmax=REACH_SD,
        extent=extent,
        aspect="equal",
        interpolation="nearest",
    )
    shape = left.shape
    corner = ((shape.col - shape.cols // 2 - cols / 2) * across, (shape.row - shape.rows // 2 - rows / 2) * down)
    size = (shape.cols * across, shape.rows * down)
    axis.add_patch(Rectangle(corner, *size, fill=False, edgecolor="black", lw=1.6))
    axis.set_xlabel("azimuth about the reference point [m]")
    axis.set_ylabel("slant range about the reference point [m]")
    axis.set_title(left.image, fontsize=9)
    figure.colorbar(shown, ax=axis, label="residual [standard deviations of speckle]")
    return figure


def in_plan(found: Diagnosis, left: Left) -> Figure:
    """The residual where it lies on the surface, seen from above: the mean over all views that see the place."""
    scene = found.final.scene
    cell = 1.5 * float(max(scene.grid.spacing_m))
    rows, cols = scene.grid.shape
    places, values, weights = [], [], []
    for seen, residual, mask in zip(found.observations, left.residuals, left.masks, strict=True):
        hits = found.setup.rays_of(found.final.scene).hits(found.final.scene, seen.view, [])
        pixel = hits.pixel.numpy()
        use = (pixel < rows * cols) & mask.ravel()[np.minimum(pixel, rows * cols - 1)]
        mean = uniform_filter(residual, SMOOTHED) / np.maximum(uniform_filter(mask.astype(float), SMOOTHED), 1e-6)
        places.append(hits.point.numpy()[use, :2].astype(float) + np.asarray(scene.reference_point_m)[:2])
        values.append(mean.ravel()[pixel[use]])
        weights.append(hits.weight.numpy()[use].astype(float))
    at, value, weight = (np.concatenate(parts) for parts in (places, values, weights))
    figure, axis = new(5.2, 4.4)
    low, high = at.min(axis=0), at.max(axis=0)
    edges = [np.arange(a, b + 2 * cell, cell) for a, b in zip(low, high, strict=True)]
    east, north = at.T
    total, light = (np.histogram2d(east, north, edges, weights=w)[0] for w in (value * weight, weight))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / light
    reach = REACH_SD / 2.0
    shown = axis.pcolormesh(*edges, mean.T, cmap=_colours(), vmin=-reach, vmax=reach, rasterized=True)
    axis.set_aspect("equal")
    axis.set_facecolor("0.6")
    axis.set_xlabel("east [m]")
    axis.set_ylabel("north [m]")
    axis.set_title(f"all train views, from above, over {SMOOTHED} x {SMOOTHED} pixels", fontsize=9)
    figure.colorbar(shown, ax=axis, label="mean residual [standard deviations]")
    return figure


def spectrum(left: Left, spacing_m: Sequence[float]) -> Figure:
    """The residual's spectrum over that of speckle, and its mean along range and azimuth."""
    figure, (left_axis, upper, lower) = new(9.6, 3.2, ncols=3)
    found = left.spectrum
    power = 10.0 * np.log10(np.maximum(found.power, 1e-3))
    shown = left_axis.pcolormesh(
        found.per_m_azimuth,
        found.per_m_range,
        power,
        cmap="magma",
        vmin=LEAST_DB,
        vmax=MOST_DB,
        shading="nearest",
        rasterized=True,
    )
    if left.shape.kind == "periodic":
        for sign in (1, -1):
            left_axis.plot(sign * found.peak_azimuth, sign * found.peak_range, "o", mfc="none", mec="c", ms=9)
    left_axis.set_xlabel("azimuth [1/m]")
    left_axis.set_ylabel("range [1/m]")
    left_axis.set_title(left.image, fontsize=9)
    figure.colorbar(shown, ax=left_axis, label="over speckle [dB]")
    residual, mask = left.residuals[left.number], left.masks[left.number]
    for axis, name, along, step in ((upper, "slant range", 1, spacing_m[0]), (lower, "azimuth", 0, spacing_m[1])):
        count = mask.sum(axis=along)
        mean = np.where(count > 0, residual.sum(axis=along) / np.maximum(count, 1), np.nan)
        error = np.where(count > 0, np.sqrt(left.spread / np.maximum(count, 1)), np.nan)
        at = (np.arange(mean.size) + 0.5 - mean.size / 2) * step
        axis.fill_between(at, -2 * error, 2 * error, color="0.85", lw=0, label="speckle, 95 %")
        axis.plot(at, mean, color="C0", lw=1.0)
        axis.set_xlabel(f"{name} [m]")
        axis.set_ylabel("mean residual [standard deviations]")
        axis.grid(alpha=0.3, lw=0.4)
    upper.legend(frameon=False, fontsize=7)
    return figure


def _colours() -> Any:
    """The residual's colour map, grey where nothing is compared."""
    from matplotlib import colormaps

    return colormaps[RESIDUAL_COLOURS].with_extremes(bad="0.6")
