"""Ground that grows wetter in one direction."""

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
from warpsar.kernels.effects import eps_gradient as kernels


def _slope(name: str) -> EffectParameter:
    toward = name.removeprefix("per_m_")
    meaning = f"Growth of ln(eps_r - 1) per metre {toward}."
    return EffectParameter(name, "1/m", 0.0, -10.0, 10.0, 0.0, span=0.05, description=meaning)


class EpsGradient(Effect):
    """ln(eps_r - 1) of every surface grows by `per_m_east` and `per_m_north` per metre; zero at the reference point.

    It is fixed to the world. An antenna's pattern is fixed to the radar: views from two sides tell them apart.
    """

    name = "eps_gradient"
    stage = "surface"
    of_surfaces_with = "eps_r"
    order = 10
    summary = "permittivity changing across the scene"
    example: ClassVar[dict[str, Any]] = {"per_m_east": 0.04, "per_m_north": 0.02}
    rate_case: ClassVar[dict[str, Any]] = {"per_m_east": 0.03, "per_m_north": -0.02}
    parameters = (_slope("per_m_east"), _slope("per_m_north"))

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """It lies on the surface, so every view must show it."""
        return {f"view {image.view.name}": image.lit}

    def trials(self, context: Context) -> list[Trial]:
        size = 0.05 / context.extent_m
        names = [p.name for p in self.parameters]
        steps = tuple(ScoreStep(name, size, {name: size}, {name: -size}) for name in names)
        return [Trial(steps, (dict.fromkeys(names, 0.0),))]

    def coordinates(self, render: Recorder, p: wp.array, zeta: wp.array, points: wp.array, page: int) -> wp.array:
        if page:  # the permittivity is the first coordinate
            return zeta
        return render.program.mapped(kernels.slope_kernel, zeta, [p, points, zeta])


EFFECT = EpsGradient()
