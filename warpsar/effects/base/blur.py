"""Convolution of an image along one axis, with a kernel whose width is a parameter of an effect."""

from __future__ import annotations

from functools import cache
from typing import Any

import warp as wp

from warpsar.effects.base.recorder import Recorder
from warpsar.kernels.effects import point_spread as kernels
from warpsar.kernels.wide import LANES
from warpsar.runtime.program import Program
from warpsar.runtime.structs import fill

WINDOWS = {"sinc": 0, "taylor": 1, "gaussian": 2}  # kernels/effects/point_spread.py


def blurred(render: Recorder, window: int, p: wp.array, index: int, image: wp.array, *, axis: int) -> wp.array:
    """Record the convolution of `image`, shape (rows * cols,), along an axis. `p[index]` is the kernel's full width at
    half maximum [m]. The kernel is sampled at pixel centres and normalised to one."""
    program, count = render.program, render.shape[axis]
    cols = render.shape[1]
    along = fill(
        kernels.SpreadAxis,
        window=window,
        index=index,
        spacing=render.spacing_m[axis],
        cols=cols,
        count=count,
        stride=(cols, 1)[axis],
    )
    weight, total, share = program.array(count + 1), program.array(1, sum_into=True), program.array(count + 1)
    program.launch(kernels.sample_kernel, count + 1, [along, p], [weight, total])
    program.launch(kernels.normalise_kernel, count + 1, [weight, total], [share])
    return _convolved(program, along, p, share, image)


def _convolved(program: Program, axis: Any, p: wp.array, weight: wp.array, image: wp.array) -> wp.array:
    """Record the convolution of `image` along an axis (`kernels.SpreadAxis`) with `weight`, by distance in pixels."""
    cols, device = axis.cols, program.device
    rows = image.shape[0] // cols
    stretch = kernels.Stretch()
    none = stretch if device.is_cpu and cols >= len(stretch) else kernels.Pixel()
    dim = (rows, -(-cols // len(none)))
    parts, lanes = (8, 1) if device.is_cpu else (rows, LANES)
    result = program.array(rows * cols)

    @cache
    def commands() -> list[wp.Launch]:  # when a gradient is asked for
        back = (
            (kernels.blur_kernel, dim, [axis, p, weight, result.grad, none, 1], image.grad),
            (
                kernels.weight_adjoint_kernel,
                (axis.count, parts, lanes),
                [axis, p, image, result.grad, none, parts, lanes],
                weight.grad,
            ),
        )
        return [wp.launch(k, d, inputs=i, outputs=[o], device=device, record_cmd=True) for k, d, i, o in back]

    def adjoint() -> None:
        for command in commands():
            command.launch()

    program.launch(kernels.blur_kernel, dim, [axis, p, weight, image, none, 0], [result], adjoint=adjoint)
    return result
