"""Surfaces with more fine structure than a Gaussian correlation has."""

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
from warpsar.kernels.codes import Spectrum
from warpsar.kernels.effects import exponential_spectrum as kernels


class ExponentialSpectrum(Effect):
    """Roughness spectrum W = (1 - w) W_gauss + w W_exp with `weight` w, at one height and one correlation length.

    sigma0 is linear in W. Materials whose spectrum is not Gaussian stay as they are.
    """

    name = "exponential_spectrum"
    stage = "surface"
    by_incidence = True
    order = 20
    summary = "a roughness spectrum with a longer tail"
    in_place = 'spectrum = "exponential" in the materials'
    example: ClassVar[dict[str, Any]] = {"weight": 1.0}
    rate_case: ClassVar[dict[str, Any]] = {"weight": 0.5}
    parameters = (
        EffectParameter("weight", "1", 0.0, 0.0, 1.0, 0.5, span=0.3, description="Share of the exponential spectrum."),
    )

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """Every polarization must show it."""
        return {image.polarization: image.lit}

    def trials(self, context: Context) -> list[Trial]:
        if all(material.spectrum != "gaussian" for material in context.scene.materials.values()):
            return []
        size = 0.02
        return [
            Trial((ScoreStep("weight", size, {"weight": size}, one_sided=True),), ({"weight": 0.3}, {"weight": 0.8}))
        ]

    def scattering(self, render: Recorder, p: wp.array, zeta: wp.array, sigma: wp.array, polarization: int) -> wp.array:
        own = render.stage.spectrum.numpy()
        own = np.where(own == Spectrum.GAUSSIAN, int(Spectrum.EXPONENTIAL), own)
        other = render.scatter(zeta, polarization, wp.array(own, dtype=int, device=render.program.device))
        return render.program.mapped(kernels.mix_kernel, sigma, [p, sigma, other])


EFFECT = ExponentialSpectrum()
