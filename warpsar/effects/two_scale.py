"""Undulations larger than the roughness and smaller than the mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from warpsar.effects.base import Context, Effect, Parameter, Step, Trial

if TYPE_CHECKING:
    from warpsar.render import ViewRender

_NODES = 5  # Gauss-Hermite points per slope: exact for a ninth-degree polynomial


class TwoScale(Effect):
    """sigma0 averaged over normally distributed tilts of the facet, `slope_variance` per axis.

    To first order sigma + (s^2 / 2) (sigma'' + cot(theta) sigma'); the tilts also turn the facet's basis, which
    gives HV on level ground. Slopes are tangents; tilts that turn away from the radar return nothing.
    """

    name = "two_scale"
    stage = "surface"
    summary = "large-scale slopes under the roughness"
    example: ClassVar[dict[str, Any]] = {"slope_variance": 0.02}
    rate_case: ClassVar[dict[str, Any]] = {"slope_variance": 0.03}
    parameters = (Parameter("slope_variance", "1", 0.0, 0.0, 1.0, 0.005, scale="log", fit_low=1e-7, fit_high=0.3),)

    def trials(self, context: Context) -> list[Trial]:
        size = 5e-4
        return [
            Trial(
                (Step("slope variance", size, {"slope_variance": size}, one_sided=True),),
                ({"slope_variance": 0.003}, {"slope_variance": 0.03}),
            )
        ]

    def scattering(self, render: ViewRender, p: Any, zeta: Any, sigma: Any, polarization: int) -> Any:
        import warp as wp

        from warpsar.kernels import effects_two_scale as kernels

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
