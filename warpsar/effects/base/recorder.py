"""What an effect sees of the render that it records on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import warp as wp

from warpsar.runtime.program import Program
from warpsar.surface.stage import Stage
from warpsar.trace.hits import Hits
from warpsar.world.frame import ViewGeometry


class Recorder(Protocol):
    """One view's render, while its program is recorded. `warpsar.render.render.ViewRender` is one.

    | member | what it is |
    |---|---|
    | `program` | takes the launches, and makes their arrays |
    | `stage` | mesh and materials on the device |
    | `geometry` | the view's axes and slant range |
    | `hits` | where power falls |
    | `shaded` | what is shaded: one sample per face and pixel |
    | `more` | the learned coordinates of `shaded` beyond the first four (vec4 each), of models that have them |
    | `shape`, `spacing_m` | (rows, cols) and (range, azimuth) of the image |
    | `resolution_m`, `taper` | (range, azimuth) of a cell of the declared band and aperture, at least a pixel |
    | `settings[name]` | the settings of the effect `name` in this view |
    | `layers` | by name, shares of the beta0 that an effect keeps apart, shape (rows * cols,) |
    | `before_image` | by polarization, the beta0 before the image stage, shape (rows * cols,) |
    | `remarks` | what a user should be told of this view's image, sentences |
    | `recorded[name]` | what an effect worked out for one polarization and needs for the next |
    """

    program: Program
    stage: Stage
    geometry: ViewGeometry
    hits: Hits
    shaded: Hits
    more: list[wp.array]
    shape: tuple[int, int]
    spacing_m: tuple[float, float]
    resolution_m: tuple[float, float]
    taper: tuple[str, str]
    settings: dict[str, Mapping[str, Any]]
    layers: dict[str, Any]
    before_image: dict[str, wp.array]
    remarks: list[str]
    recorded: dict[str, Any]

    def coordinates(self, face: wp.array, barycentric: wp.array, points: wp.array) -> wp.array:
        """Record the learned coordinates (vec4) at places on the mesh, with the effects that act on them."""

    def scatter(self, zeta: wp.array, polarization: int, spectrum: wp.array | None = None) -> wp.array:
        """Record sigma0 of `shaded` for coordinates `zeta`; `spectrum` takes the place of the materials' own."""

    def collect(
        self,
        sigma: wp.array,
        weight: wp.array,
        points: wp.array,
        bins: wp.array,
        image: wp.array,
        sample: wp.array | None = None,
        faces: Sequence[wp.array] = (),
    ) -> None:
        """Record the gains on `sigma` and its deposit into `image`, an array that is zeroed before each run. `faces`:
        of each bounce, for lists of scatterers."""


def lit_pixels(render: Recorder) -> np.ndarray:
    """Which pixels of the image the hits fall into, shape (rows * cols,), bool; without any shift."""
    lit = np.zeros(render.shape, bool)
    row, col, inside = pixels_of(render, render.hits.pixel.numpy())
    lit[row[inside], col[inside]] = True
    return lit.ravel()


def pixels_of(render: Recorder, bins: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row and column of the pixel that each bin of the hits' grid lies in, without any shift, and whether the image has
    it: a grid has a margin; (n,) each."""
    grid = render.hits.grid
    row, col = (
        (at - (have - want * grid.bins_per_pixel) // 2) // grid.bins_per_pixel
        for at, have, want in zip(np.divmod(bins, grid.shape[1]), grid.shape, render.shape, strict=True)
    )
    return row, col, (row >= 0) & (row < render.shape[0]) & (col >= 0) & (col < render.shape[1])
