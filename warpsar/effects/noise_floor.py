"""The receiver's own noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import Parameter
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage, Signature, power_in
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels.effects import noise_floor as kernels


class NoiseFloor(Effect):
    """I' = I + level in every pixel, lit or not: it makes shadows grey. `level` is the noise-equivalent beta0."""

    name = "noise_floor"
    stage = "image"
    order = 30
    affine = True
    additive = True
    is_floor = True
    summary = "noise of the receiver, the same in every pixel"
    with_phase = "collection.noise_beta0"
    example: ClassVar[dict[str, Any]] = {"level": 0.002}
    rate_case: ClassVar[dict[str, Any]] = {"level": 0.004}
    parameters = (
        Parameter(
            "level",
            "beta0",
            0.0,
            0.0,
            1e9,
            1e-3,
            scale="log",
            fit_low=1e-12,
            fit_high=1e6,
            description="Power added to every pixel.",
        ),
    )

    def own_test(self, images: Sequence[SeenImage], table: Mapping[str, Any]) -> Signature:
        """A floor is seen in shadows."""
        return power_in(images, [one.dark for one in images], "the floor", "in shadows")

    def trials(self, context: Context) -> list[Trial]:
        size = 0.1 * context.level
        return [Trial((ScoreStep("level", size, {"level": size}, one_sided=True),), ({"level": size},))]

    def image(self, render: Recorder, p: wp.array, image: wp.array) -> wp.array:
        result = render.program.array(image.shape[0])
        render.program.launch(kernels.noise_kernel, image.shape[0], [p, image], [result])
        return result


EFFECT = NoiseFloor()
