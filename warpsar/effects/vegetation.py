"""Plants between the radar and the ground."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import EffectParameter, amount
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels.codes import Polarization
from warpsar.kernels.effects import vegetation as kernels

_ALBEDOS = (0.01, 0.03, 0.1, 0.3, 1.0)


class Vegetation(Effect):
    """The water-cloud model: sigma = albedo cos(theta) (1 - T) + T sigma of the surface, T = exp(-2 tau / cos(theta)).

    tau is the one-way `optical_depth` along the facet's normal. The layer covers every surface. It returns nothing in
    HV and VH, and has no height.
    """

    name = "vegetation"
    stage = "surface"
    by_incidence = True
    order = 40
    summary = "a layer that dims the surface and scatters by itself"
    example: ClassVar[dict[str, Any]] = {"optical_depth": 0.3, "albedo": 0.05}
    rate_case: ClassVar[dict[str, Any]] = {"optical_depth": 0.8, "albedo": 0.1}
    parameters = (
        amount("optical_depth", "1", 20.0, 0.2, (1e-6, 10.0), "One-way optical depth."),
        EffectParameter(
            "albedo",
            "1",
            math.nan,
            0.0,
            10.0,
            0.1,
            scale="log",
            fit_low=1e-4,
            fit_high=5.0,
            description="Brightness of the layer itself.",
        ),
    )

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """Every polarization must show it."""
        return {image.polarization: image.lit}

    def trials(self, context: Context) -> list[Trial]:
        size = 0.005
        return [
            Trial(
                (ScoreStep("optical depth", size, {"optical_depth": size, "albedo": albedo}, one_sided=True),),
                tuple({"optical_depth": depth, "albedo": albedo} for depth in (0.05, 0.3, 1.0)),
                f"albedo {albedo:g}",
            )
            for albedo in _ALBEDOS
        ]

    def scattering(self, render: Recorder, p: wp.array, zeta: wp.array, sigma: wp.array, polarization: int) -> wp.array:
        crossed = int(Polarization(polarization).crossed)
        return render.program.mapped(kernels.canopy_kernel, sigma, [p, crossed, render.shaded.cos_incidence, sigma])


EFFECT = Vegetation()
