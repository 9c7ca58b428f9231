"""Surfaces with more fine structure than a Gaussian correlation has."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from warpsar.effects.base import Context, Effect, Parameter, Step, Trial

if TYPE_CHECKING:
    from warpsar.render import ViewRender


class ExponentialSpectrum(Effect):
    """Roughness spectrum W = (1 - w) W_gauss + w W_exp, of the same height and correlation length, with `weight` w.

    sigma0 is linear in W. Materials whose spectrum is not Gaussian stay as they are.
    """

    name = "exponential_spectrum"
    stage = "surface"
    summary = "a roughness spectrum with a longer tail"
    example: ClassVar[dict[str, Any]] = {"weight": 1.0}
    rate_case: ClassVar[dict[str, Any]] = {"weight": 0.5}
    parameters = (Parameter("weight", "1", 0.0, 0.0, 1.0, 0.5, span=0.3),)

    def trials(self, context: Context) -> list[Trial]:
        if all(material.spectrum != "gaussian" for material in context.scene.materials.values()):
            return []
        size = 0.02
        return [Trial((Step("weight", size, {"weight": size}, one_sided=True),), ({"weight": 0.3}, {"weight": 0.8}))]

    def scattering(self, render: ViewRender, p: Any, zeta: Any, sigma: Any, polarization: int) -> Any:
        import warp as wp

        from warpsar.kernels import effects_exponential_spectrum as kernels
        from warpsar.kernels.scattering import EXPONENTIAL, GAUSSIAN

        own = render.stage.spectrum.numpy()
        own = np.where(own == int(GAUSSIAN), int(EXPONENTIAL), own)
        other = render.scatter(zeta, polarization, wp.array(own, dtype=int, device=render.program.device))
        result = render.program.array(sigma.shape[0])
        render.program.launch(kernels.mix_kernel, sigma.shape[0], [p, sigma, other], [result])
        return result


EFFECT = ExponentialSpectrum()
