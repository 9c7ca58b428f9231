"""Images of the views as the browser lays them on the surface: what was measured, what the model says, what is left."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from warpsar.diagnosis.models.projection import shift_px
from warpsar.evaluation.command import evaluate
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.simulation.rays import covered_in, trace_view, view_seed
from warpsar.surface.stage import Stage
from warpsar.trace.hits import Hits
from warpsar.viewer.surface import stage_of
from warpsar.world.tables import View
from warpsar.world.world import geometry_of

APART = 3.0
"""Two surfaces in one pixel lie over each other where they are so many pixels apart in elevation."""
SHARE = 0.05
"""Each of them must hold this share of the pixel's lit area, or a sliver at an edge would count."""


@dataclass
class Drape:
    """A view, and its images in dB (beta0; the residual is measured over modelled power), by "quantity polarization",
    each of shape (rows, cols), NaN where there is nothing. `layover` is true where surfaces lie over each other,
    `covered` where one lies at all, lit or hidden."""

    view: View
    axes: NDArray[np.float64]
    """Rows are the unit vectors d (range), u (azimuth), v (elevation), s (to the radar), shape (4, 3)."""
    slant_range_m: float | None
    shift_px: NDArray[np.float64]
    layover: NDArray[np.bool_]
    covered: NDArray[np.bool_]
    images_db: dict[str, NDArray[np.float64]] = field(default_factory=dict)


def drapes(scene: Scene, device: str | None) -> list[Drape]:
    """One for each view, in their order; without images and layover where the surfaces are smooth."""
    stage = stage_of(scene, device)
    found = {view.name: _bare(scene, stage, view, index) for index, view in enumerate(scene.views)}
    if stage is None:
        return list(found.values())
    if any(view.images for view in scene.views):
        for image in evaluate(scene, device=device).images:
            planes = {"measured": image.measured, "modelled": image.simulated}
            for name, plane in planes.items():
                found[image.view.name].images_db[f"{name} {image.polarization}"] = _db(plane)
            residual = np.where(image.interior, image.ratio_db, np.nan)
            found[image.view.name].images_db[f"residual {image.polarization}"] = residual
    else:
        for made in simulate(scene, device=device):
            for polarization, plane in made.beta0.items():
                found[made.name].images_db[f"modelled {polarization}"] = _db(plane)
    return list(found.values())


def _bare(scene: Scene, stage: Stage | None, view: View, index: int) -> Drape:
    axes = geometry_of(scene, view)
    over, there = np.zeros(scene.grid.shape, bool), np.ones(scene.grid.shape, bool)
    if stage is not None:
        there = covered_in(scene, stage, view)
        over = layover(trace_view(scene, stage, view, seed=view_seed(scene.sampling.seed, index), effects=[]))
    return Drape(
        view=view,
        axes=np.stack([axes.d, axes.u, axes.v, axes.s]),
        slant_range_m=axes.slant_range_m,
        shift_px=shift_px(scene, view),
        layover=over,
        covered=there,
    )


def layover(hits: Hits) -> NDArray[np.bool_]:
    """Where two surfaces share a pixel, though they are `APART` pixels from each other in elevation, (rows, cols).

    The hits of a pixel are put in order of elevation. The widest gap divides them, and either side must hold `SHARE` of
    the lit area.
    """
    rows, cols = hits.grid.shape
    pixel, weight = hits.pixel.numpy(), hits.weight.numpy().astype(float)
    elevation = hits.point.numpy().astype(float) @ hits.geometry.v
    order = np.lexsort((elevation, pixel))
    pixel, weight, elevation = pixel[order], weight[order], elevation[order]
    total = np.bincount(pixel, weight, rows * cols)
    before = np.cumsum(weight) - weight
    first = np.searchsorted(pixel, pixel)  # of the hits in the same pixel
    below = (before[1:] - before[first[1:]]) / total[pixel[1:]]
    wide = np.diff(elevation) > APART * max(hits.grid.spacing_m)
    two = (pixel[1:] == pixel[:-1]) & wide & (below > SHARE) & (below < 1.0 - SHARE)
    found = np.zeros(rows * cols, bool)
    found[pixel[1:][two]] = True
    return found.reshape(rows, cols)


def _db(power: NDArray[np.floating]) -> NDArray[np.float64]:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(power > 0, 10.0 * np.log10(power), np.nan), float)
