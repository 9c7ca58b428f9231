"""Views that are not focused on, or not cut out about, the same point."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import EffectParameter, Setting
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels.effects import aim_point as kernels
from warpsar.world.frame import ViewGeometry
from warpsar.world.tables import Grid

_REACH_M = 1e4
_ROOM_PX = 4  # pixels beyond the shift that is declared: as far as a fit may go from there without a dark edge


def _metres(name: str) -> EffectParameter:
    meaning = f"Shift in {name.removesuffix('_m')} of each view."
    return EffectParameter(
        name, "m", 0.0, -_REACH_M, _REACH_M, 0.0, description=meaning, per_view=True, fit_low=-100.0, fit_high=100.0
    )


class AimPoint(Effect):
    """Moves each view by a range and an azimuth of its own, before its power is binned; it does not blur.

    Views that the table names no shift of lie up to `reach_m` off, in range and in azimuth. `evaluate` and
    `diagnose --folds` look for their shift within it (`warpsar/compare/aim.py`).
    """

    name = "aim_point"
    stage = "position"
    at_edges = True
    acts_on = ("beta0", "slc", "phase-history")
    order = 20
    summary = "shifts that differ from view to view"
    example: ClassVar[dict[str, Any]] = {"range_m": {"v0": 1.5}, "azimuth_m": {"v0": -1.0}}
    rate_case: ClassVar[dict[str, Any]] = {
        "range_m": {"v0": 0.3, "v1": -0.2, "v2": 0.15, "v3": -0.25},
        "azimuth_m": {"v0": -0.2, "v1": 0.25, "v2": 0.3, "v3": -0.15},
    }
    parameters = (_metres("range_m"), _metres("azimuth_m"))
    settings = (
        Setting(
            "reach_m",
            0.0,
            lambda value: isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= _REACH_M,
            f"a number from 0 to {_REACH_M:g} [m]",
            description="How far views may lie off whose shift is not stated [m]; 0: they lie where they should.",
            schema={"type": "number", "minimum": 0, "maximum": _REACH_M},
        ),
    )
    bins_per_pixel = 4
    contains = ("registration",)
    sets_positions = True

    def needed(self) -> list[EffectParameter | Setting]:
        """Shifts, or a reach: a table with a reach alone says that all shifts are to be found."""
        return [*self.parameters, *self.settings]

    def margin_m(self, grid: Grid, values: np.ndarray) -> float:
        return float(np.abs(values).max() + _ROOM_PX * max(grid.spacing_m))

    def shift_m(self, values: np.ndarray, geometry: ViewGeometry) -> np.ndarray:
        return np.array(values, float)

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """The whole image moves."""
        return image.halves()

    def trials(self, context: Context) -> list[Trial]:
        """A quarter of a pixel of each view alone. A single view's shift is a registration."""
        names = [view.name for view in context.scene.views if view.role == "train"]
        if len(names) < 2:
            return []
        size = 0.25 * min(context.scene.grid.spacing_m)
        steps = tuple(
            ScoreStep(f"{key} of {name}", size, {key: {name: size}}, {key: {name: -size}}, views=(name,))
            for name in names
            for key in ("range_m", "azimuth_m")
        )
        return [Trial(steps, ({key: dict.fromkeys(names, 0.0) for key in ("range_m", "azimuth_m")},))]

    def simpler(self, table: Mapping[str, Any]) -> list[Mapping[str, Any]]:
        """Without the view that lies nearest to where it should."""
        keys = [p.name for p in self.parameters if p.name in table]
        views = list(dict.fromkeys(view for key in keys for view in table[key]))
        if len(views) < 2:
            return []
        nearest = min(views, key=lambda view: float(np.linalg.norm([table[key].get(view, 0.0) for key in keys])))
        return [{**table, **{key: {v: one for v, one in table[key].items() if v != nearest} for key in keys}}]

    def shift(self, render: Recorder, p: wp.array, shift: wp.array) -> wp.array:
        result = render.program.array(2)
        render.program.launch(kernels.aim_kernel, 1, [p, *render.spacing_m, shift], [result])
        return result


EFFECT = AimPoint()
