"""Echoes that a pulse rate too low cannot tell from their neighbours'."""

from __future__ import annotations

import math
from typing import Any

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import Parameter
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels.effects import azimuth_ambiguity as kernels

_NEAREST_PX = 3  # nearer copies are a point spread


class AzimuthAmbiguity(Effect):
    """I'(u) = I(u) + level (I(u - offset) + I(u + offset)), linear between pixels; nothing comes from outside the
    image. For a strip-map, offset = lambda R PRF / (2 v)."""

    name = "azimuth_ambiguity"
    stage = "image"
    order = 20
    additive = True
    in_image = True
    summary = "faint copies of the image at a distance in azimuth"
    parameters = (
        Parameter("level", "1", 0.0, 0.0, 1.0, 0.01, scale="log", fit_low=1e-9, fit_high=1.0),
        Parameter("offset_m", "m", math.nan, 0.0, 1e6, 10.0),
    )

    def trials(self, context: Context) -> list[Trial]:
        """One trial per pixel of offset: half a pixel beside it, linear interpolation still finds the copy."""
        grid = context.scene.grid
        size = 0.01
        found = []
        for pixels in range(_NEAREST_PX, grid.shape[1]):
            at = {"level": size, "offset_m": pixels * grid.spacing_m[1]}
            found.append(Trial((ScoreStep("level", size, at, one_sided=True),), (at,), f"offset {at['offset_m']:g} m"))
        return found

    def image(self, render: Recorder, p: Any, image: Any) -> Any:
        result = render.program.array(image.shape[0])
        render.program.launch(
            kernels.ghost_kernel, image.shape[0], [p, render.spacing_m[1], render.shape[1], image], [result]
        )
        return result


EFFECT = AzimuthAmbiguity()
