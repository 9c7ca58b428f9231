"""Three pictures of what is left: in the worst view, in plan, and as a spectrum with profiles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter

from warpsar.diagnosis.found import Diagnosis
from warpsar.diagnosis.left.summary import Left
from warpsar.evaluation.report_parts import residual_rgb
from warpsar.io import html_image
from warpsar.io.figures import new
from warpsar.io.html_image import ImageAxis

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REACH_SD = 4.0  # ends of the colour scale of a residual, in standard deviations
SMOOTHED = 3  # pixels on a side, over which the residual in plan is averaged
LEAST_DB, MOST_DB = 0.0, 15.0  # colour scale of the spectrum, over speckle


def worst_view(left: Left) -> np.ndarray:
    """RGB of the residual of the image that shows it best, the rectangle framed; shape (rows, cols, 3)."""
    residual = np.where(left.masks[left.number], left.residuals[left.number], np.nan)
    return html_image.framed(residual_rgb(residual, REACH_SD), left.shape.rectangle)


def in_plan(diagnosis: Diagnosis, left: Left) -> tuple[np.ndarray, ImageAxis, ImageAxis]:
    """RGB of the residual where it lies on the surface, north up, and its axes: the mean over all views that see it."""
    scene = diagnosis.final.scene
    cell = 1.5 * float(max(scene.grid.spacing_m))
    rows, cols = scene.grid.shape
    places, values, weights = [], [], []
    for seen, residual, mask in zip(diagnosis.observations, left.residuals, left.masks, strict=True):
        hits = diagnosis.setup.rays_of(diagnosis.final.scene).hits(diagnosis.final.scene, seen.view, [])
        pixel = hits.pixel.numpy()
        use = (pixel < rows * cols) & mask.ravel()[np.minimum(pixel, rows * cols - 1)]
        mean = uniform_filter(residual, SMOOTHED) / np.maximum(uniform_filter(mask.astype(float), SMOOTHED), 1e-6)
        places.append(hits.point.numpy()[use, :2].astype(float) + np.asarray(scene.reference_point_m)[:2])
        values.append(mean.ravel()[pixel[use]])
        weights.append(hits.weight.numpy()[use].astype(float))
    at, value, weight = (np.concatenate(parts) for parts in (places, values, weights))
    low, high = at.min(axis=0), at.max(axis=0)
    edges = [np.arange(a, b + 2 * cell, cell) for a, b in zip(low, high, strict=True)]
    east, north = at.T
    total, light = (np.histogram2d(north, east, edges[::-1], weights=w)[0] for w in (value * weight, weight))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / light
    down, along = ImageAxis("north [m]", edges[1][-1], edges[1][0]), ImageAxis("east [m]", edges[0][0], edges[0][-1])
    return residual_rgb(mean[::-1], REACH_SD / 2.0), down, along


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
