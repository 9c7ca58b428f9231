"""Spreading loss that the processor has not taken out."""

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
from warpsar.kernels.effects import range_loss as kernels
from warpsar.world.world import World


class RangeLoss(Effect):
    """Power times (R / R0)^-`exponent` in a strip-map scene, R0 the slant range of the reference point.

    The exponent is 3 for a focused image, and 4 for one that was not compensated at all. A plane wave comes from
    infinitely far: there the factor is exp(-`per_m` X . d). Over a small scene, exponent = per_m R0.
    """

    name = "range_loss"
    stage = "gain"
    acts_on = ("beta0", "slc", "phase-history")
    order = 20
    summary = "power falling with slant range"
    example: ClassVar[dict[str, Any]] = {"per_m": 0.05}
    rate_case: ClassVar[dict[str, Any]] = {"per_m": 0.02}
    parameters = (
        EffectParameter(
            "exponent", "1", 0.0, -20.0, 20.0, 3.0, span=5.0, description="Power of R / R0, for a strip-map."
        ),
        EffectParameter(
            "per_m", "1/m", 0.0, -10.0, 10.0, 0.01, span=0.02, description="Decay per metre of range, for a plane wave."
        ),
    )

    def check(self, scene: World, table: Mapping[str, Any]) -> str | None:
        strips = [scene.slant_range_m(view) is not None for view in scene.views]
        if "exponent" in table and not any(strips):
            return ".exponent: found in a plane-wave scene, where R0 is infinite; allowed there is per_m"
        if "per_m" in table and all(strips):
            return ".per_m: found in a strip-map scene; allowed there is exponent"
        return None

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """It goes by range, whatever surface lies there."""
        return image.by_material()

    def trials(self, context: Context) -> list[Trial]:
        ranges = [context.scene.slant_range_m(view) for view in context.scene.views]
        key, size = "per_m", 0.02 / context.extent_m
        if all(r is not None for r in ranges):
            steepest = self.parameters[0].fit_bounds[1] / 2.0  # over a small scene far away no exponent is steep enough
            key, size = "exponent", min(size * min(r for r in ranges if r is not None), steepest)
        return [Trial((ScoreStep(key, size, {key: size}, {key: -size}),), ({key: 0.0},))]

    def gain(self, render: Recorder, p: wp.array, sigma: wp.array, points: wp.array) -> wp.array:
        geometry = render.geometry
        return render.program.mapped(
            kernels.loss_kernel,
            sigma,
            [p, geometry.slant_range_m or 0.0, wp.vec3(*geometry.d), wp.vec3(*geometry.v), points, sigma],
        )


EFFECT = RangeLoss()
