"""What an effect sees of the render that it records on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from warpsar.runtime.program import Program
from warpsar.surface.stage import Stage
from warpsar.trace.hits import Hits
from warpsar.world.frame import ViewGeometry


class Recorder(Protocol):
    """One view's render, while its program is being recorded. `warpsar.render.render.ViewRender` is one.

    `hits` say where power falls, `shaded` what is shaded: one sample per face and pixel. `shape` (rows, cols) and
    `spacing_m` (range, azimuth) are the image's. `settings[name]` are the settings of the effect `name` in this view.
    `layers` takes arrays (rows * cols,) by name: shares of the beta0 that an effect tells apart. `recorded[name]` is
    what the effect `name` recorded for one polarization and uses again for the next.
    """

    program: Program
    stage: Stage
    geometry: ViewGeometry
    hits: Hits
    shaded: Hits
    shape: tuple[int, int]
    spacing_m: tuple[float, float]
    settings: dict[str, Mapping[str, Any]]
    layers: dict[str, Any]
    recorded: dict[str, Any]

    def coordinates(self, face: Any, barycentric: Any, points: Any) -> Any:
        """Record the learned coordinates (vec4) at places on the mesh, with the effects that act on them."""

    def scatter(self, zeta: Any, polarization: int, spectrum: Any = None) -> Any:
        """Record sigma0 of `shaded` for coordinates `zeta`; `spectrum` takes the place of the materials' own."""

    def collect(self, sigma: Any, weight: Any, points: Any, bins: Any, image: Any, sample: Any = None) -> None:
        """Record the gains on `sigma` and its deposit into `image`, an array that is zeroed before each run."""

    def deposit(self, sigma: Any, weight: Any, bins: Any, shift: Any, image: Any) -> None:
        """Record the deposit of the bins of `hits.grid` into `image`, moved by `shift` (rows, columns) pixels."""
