"""Undulations larger than the roughness and smaller than the mesh."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import amount
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels import shade
from warpsar.kernels.effects import two_scale as kernels
from warpsar.kernels.geometry import RayGrid
from warpsar.kernels.lane_kernels import LANES, at_once
from warpsar.runtime.launches import Launch, by_elements
from warpsar.runtime.program import Program
from warpsar.runtime.structs import fill

_NODES = 5  # Gauss-Hermite points per slope: exact for a ninth-degree polynomial


class TwoScale(Effect):
    """sigma0 averaged over normally distributed tilts of the facet, `slope_variance` per axis.

    To first order this is sigma + (s^2 / 2) (sigma'' + cot(theta) sigma'). The tilts also turn the facet's basis,
    which gives HV on level ground. Slopes are tangents. Tilts that turn away from the radar return nothing.
    """

    name = "two_scale"
    stage = "surface"
    of_surfaces_with = "default"
    order = 30
    summary = "large-scale slopes under the roughness"
    example: ClassVar[dict[str, Any]] = {"slope_variance": 0.02}
    rate_case: ClassVar[dict[str, Any]] = {"slope_variance": 0.03}
    parameters = (amount("slope_variance", "1", 1.0, 0.005, (1e-7, 0.3), "Slope variance per axis."),)

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
        axes = {name: wp.vec3(*getattr(geometry, name)) for name in "duv"}
        plain = render.scatter(zeta, polarization)
        result = render.program.array(sigma.shape[0])
        inputs = [
            p,
            wp.array(np.array(tilts, np.float32), dtype=wp.vec3, device=device),
            fill(RayGrid, slant_range=geometry.slant_range_m or 0.0, **axes),
            stage.target.triangles,
            stage.hit_surfaces(hits, polarization),
            hits.point,
            zeta,
            plain,
            sigma,
        ]
        if device.is_cpu:
            _in_lanes(render.program, inputs, result, [hits.face, hits.point, zeta, plain, sigma, result])
        else:
            none = wp.empty(0, dtype=wp.vec4, device=device)
            render.program.launch(kernels.tilt_kernel(False), sigma.shape[0], inputs, [result, none])
        return result


def _in_lanes(program: Program, inputs: list[Any], result: wp.array, per_hit: list[wp.array]) -> None:
    """Record `tilt_kernel` for many hits at once; `per_hit` are the arrays with an element for each."""
    n, device = result.shape[0], program.device
    p, zeta, plain, sigma = inputs[0], *inputs[-3:]
    dim = -(-n // LANES)
    none = wp.empty(0, dtype=wp.vec4, device=device)

    @cache
    def slopes() -> wp.array:  # when a gradient is asked for
        return wp.empty(n, dtype=wp.vec4, device=device)

    def keeping() -> Launch:
        pieces = by_elements([*per_hit, slopes()], LANES)
        return Launch(at_once(kernels.tilt_kernel(True)), dim, inputs, [result, slopes()], device, pieces)

    @cache
    def to_zeta() -> Launch:
        pieces = by_elements([slopes(), result.grad, zeta.grad])
        return Launch(shade.scatter_adjoint_kernel, n, [slopes(), result.grad], [zeta.grad], device, pieces)

    @cache
    def to_change() -> Launch:
        grads = [result.grad, plain.grad, sigma.grad]
        return Launch(kernels.change_adjoint_kernel, n, grads[:1], grads[1:], device, by_elements(grads))

    @cache
    def to_variance() -> wp.Launch:
        """Warp's own adjoint, whose other results are added up beside."""
        aside = {id(a): wp.zeros_like(a, requires_grad=False) for a in (zeta, plain, sigma)} | {id(p): p.grad}
        recorded: wp.Launch = wp.launch(
            kernels.tilt_kernel(False),
            n,
            inputs=inputs,
            outputs=[result, none],
            adj_inputs=[aside.get(id(a)) if isinstance(a, wp.array) else wp.Tape().get_adjoint(a) for a in inputs],
            adj_outputs=[result.grad, None],
            device=device,
            adjoint=True,
            record_tape=False,
            record_cmd=True,
        )
        return recorded

    program.launch(
        at_once(kernels.tilt_kernel(False)),
        dim,
        inputs,
        [result, none],
        adjoint=[
            (zeta, lambda: to_zeta().launch()),
            (sigma, lambda: to_change().launch()),
            (p, lambda: to_variance().launch()),
        ],
        keeping=keeping,
        pieces=by_elements(per_hit, LANES),
    )


EFFECT = TwoScale()
