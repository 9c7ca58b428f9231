"""The receiver's own noise."""

from __future__ import annotations

from typing import Any

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import Parameter
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.trial import Context, Step, Trial
from warpsar.kernels.effects import noise_floor as kernels


class NoiseFloor(Effect):
    """I' = I + level in every pixel, lit or not: what makes a shadow grey. Level is beta0 (noise-equivalent)."""

    name = "noise_floor"
    stage = "image"
    order = 30
    additive = True
    is_floor = True
    summary = "noise of the receiver, the same in every pixel"
    parameters = (Parameter("level", "beta0", 0.0, 0.0, 1e9, 1e-3, scale="log", fit_low=1e-12, fit_high=1e6),)

    def trials(self, context: Context) -> list[Trial]:
        size = 0.1 * context.level
        return [Trial((Step("level", size, {"level": size}, one_sided=True),), ({"level": size},))]

    def image(self, render: Recorder, p: Any, image: Any) -> Any:
        result = render.program.array(image.shape[0])
        render.program.launch(kernels.noise_kernel, image.shape[0], [p, image], [result])
        return result


EFFECT = NoiseFloor()
