"""The last reflection as a lobe of geometric optics, whatever the roughness; powers add."""

from __future__ import annotations

from collections.abc import Sequence

import warp as wp

from warpsar.effects.base.recorder import Recorder
from warpsar.effects.bounces.tracing import BouncePaths
from warpsar.kernels.effects import multibounce as kernels


def lobe_power(
    render: Recorder, p: wp.array, paths: BouncePaths, zetas: Sequence[wp.array], polarization: int
) -> wp.array:
    """Record what each path returns per unit of its weight, shape (n,): the last surface's lobe times the mirrors."""
    program, stage = render.program, render.stage
    n = paths.weight.shape[0]
    material = [stage.face_material, stage.eps_im]
    power = program.array(n)
    lobe = [p, polarization, paths.bounces[-1].face, *material, paths.cos_half, paths.cos_tilt, zetas[-1]]
    program.launch(kernels.return_kernel, n, lobe, [power])
    for bounce, zeta in zip(paths.bounces[:-1], zetas[:-1], strict=True):
        left = program.array(n)
        mirror = [polarization, render.geometry.wavenumber, bounce.face, *material, bounce.cos_incidence, zeta, power]
        program.launch(kernels.mirror_kernel, n, mirror, [left])
        power = left
    return power
