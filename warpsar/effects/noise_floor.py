"""The receiver's own noise."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from warpsar.effects.base import Context, Effect, Parameter, Step, Trial

if TYPE_CHECKING:
    from warpsar.render import ViewRender


class NoiseFloor(Effect):
    """I' = I + level in every pixel, lit or not: what makes a shadow grey. Level is beta0 (noise-equivalent)."""

    name = "noise_floor"
    stage = "image"
    additive = True
    summary = "noise of the receiver, the same in every pixel"
    example: ClassVar[dict[str, Any]] = {"level": 0.002}
    rate_case: ClassVar[dict[str, Any]] = {"level": 0.004}
    parameters = (Parameter("level", "beta0", 0.0, 0.0, 1e9, 1e-3, scale="log", fit_low=1e-12, fit_high=1e6),)

    def trials(self, context: Context) -> list[Trial]:
        size = 0.1 * context.level
        return [Trial((Step("level", size, {"level": size}, one_sided=True),), ({"level": size},))]

    def image(self, render: ViewRender, p: Any, image: Any) -> Any:
        from warpsar.kernels import effects_noise_floor as kernels

        result = render.program.array(image.shape[0])
        render.program.launch(kernels.noise_kernel, image.shape[0], [p, image], [result])
        return result


EFFECT = NoiseFloor()
