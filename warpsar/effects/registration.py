"""Images that lie beside the place where the scene puts them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import EffectParameter
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels.effects import registration as kernels
from warpsar.world.frame import ViewGeometry
from warpsar.world.tables import Grid

_REACH_M = 1e4
_ROOM_PX = 4  # pixels beyond the shift that is declared: as far as a fit may go from there without a dark edge


def _metres(name: str) -> EffectParameter:
    axis, image = name.removesuffix("_m"), name in ("range_m", "azimuth_m")
    meaning = f"Shift in {axis}, in every view." if image else f"Shift of the world {axis}."
    return EffectParameter(
        name, "m", 0.0, -_REACH_M, _REACH_M, 0.0, description=meaning, fit_low=-100.0, fit_high=100.0
    )


class Registration(Effect):
    """Moves the power before it is binned; it does not blur.

    `range_m` and `azimuth_m` hold in every view. A shift of the world moves a view's image by d . shift in range and
    u . shift in azimuth. Both add. Power is kept, except for what leaves the image.
    """

    name = "registration"
    stage = "position"
    at_edges = True
    acts_on = ("beta0", "slc", "phase-history")
    order = 10
    summary = "the scene lies shifted in the images"
    example: ClassVar[dict[str, Any]] = {"range_m": 1.5, "azimuth_m": -1.0}
    rate_case: ClassVar[dict[str, Any]] = {"range_m": 0.15, "azimuth_m": -0.2}
    parameters = tuple(_metres(name) for name in ("range_m", "azimuth_m", "east_m", "north_m", "up_m"))
    bins_per_pixel = 4

    def margin_m(self, grid: Grid, values: np.ndarray) -> float:
        return float(np.abs(values[:2]).max() + np.linalg.norm(values[2:]) + _ROOM_PX * max(grid.spacing_m))

    def shift_m(self, values: np.ndarray, geometry: ViewGeometry) -> np.ndarray:
        range_m, azimuth_m, *world = values
        return np.array([range_m + geometry.d @ np.array(world), azimuth_m + geometry.u @ np.array(world)])

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """The whole image moves."""
        return image.halves()

    def trials(self, context: Context) -> list[Trial]:
        pixel = min(context.scene.grid.spacing_m)
        size = 0.25 * pixel

        def trial(label: str, *names: str) -> Trial:
            steps = tuple(ScoreStep(name, size, {name: size}, {name: -size}) for name in names)
            return Trial(steps, (dict.fromkeys(names, 0.0),), label, dict.fromkeys(names, 2.0 * pixel))

        return [trial("all views alike", "range_m", "azimuth_m"), trial("world", "east_m", "north_m", "up_m")]

    def shift(self, render: Recorder, p: wp.array, shift: wp.array) -> wp.array:
        result = render.program.array(2)
        d, u = (wp.vec3(*axis) for axis in (render.geometry.d, render.geometry.u))
        render.program.launch(kernels.shift_kernel, 1, [p, d, u, *render.spacing_m, shift], [result])
        return result


EFFECT = Registration()
