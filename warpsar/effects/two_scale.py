"""Undulations larger than the roughness and smaller than the mesh."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import Parameter
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels.effects import two_scale as kernels

_NODES = 5  # Gauss-Hermite points per slope: exact for a ninth-degree polynomial


class TwoScale(Effect):
    """sigma0 averaged over normally distributed tilts of the facet, `slope_variance` per axis.

    To first order this is sigma + (s^2 / 2) (sigma'' + cot(theta) sigma'). The tilts also turn the facet's basis,
    which gives HV on level ground. Slopes are tangents. Tilts that turn away from the radar return nothing.
    """

    name = "two_scale"
    stage = "surface"
    order = 30
    summary = "large-scale slopes under the roughness"
    example: ClassVar[dict[str, Any]] = {"slope_variance": 0.02}
    rate_case: ClassVar[dict[str, Any]] = {"slope_variance": 0.03}
    parameters = (
        Parameter(
            "slope_variance",
            "1",
            0.0,
            0.0,
            1.0,
            0.005,
            scale="log",
            fit_low=1e-7,
            fit_high=0.3,
            description="Slope variance per axis.",
        ),
    )

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """Every polarization must show it."""
        return {image.polarization: image.lit}

    def trials(self, context: Context) -> list[Trial]:
        size = 5e-4
        return [
            Trial(
                (ScoreStep("slope variance", size, {"slope_variance": size}, one_sided=True),),
                ({"slope_variance": 0.003}, {"slope_variance": 0.03}),
            )
        ]

    def scattering(self, render: Recorder, p: wp.array, zeta: wp.array, sigma: wp.array, polarization: int) -> wp.array:
        stage, hits, geometry, device = render.stage, render.shaded, render.geometry, render.program.device
        x, w = np.polynomial.hermite_e.hermegauss(_NODES)
        w = w / w.sum()
        tilts = [[a, b, wa * wb] for a, wa in zip(x, w, strict=True) for b, wb in zip(x, w, strict=True)]
        plain = render.scatter(zeta, polarization)
        result = render.program.array(sigma.shape[0])
        render.program.launch(
            kernels.tilt_kernel,
            sigma.shape[0],
            [
                p,
                wp.array(np.array(tilts, np.float32), dtype=wp.vec3, device=device),
                polarization,
                stage.variant,
                geometry.wavenumber,
                int(stage.local_basis),
                geometry.slant_range_m or 0.0,
                *(wp.vec3(*axis) for axis in (geometry.d, geometry.u, geometry.v)),
                stage.target.vertices,
                stage.target.faces,
                hits.face,
                hits.point,
                stage.face_material,
                stage.spectrum,
                stage.eps_im,
                stage.aspect,
                zeta,
                plain,
                sigma,
            ],
            [result],
        )
        return result


EFFECT = TwoScale()
