"""Reflections split by roughness: a coherent share, summed as fields over cells, and what the last surface scatters."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import warp as wp

from warpsar.effects.base.recorder import Recorder
from warpsar.effects.bounces.tracing import BouncePaths, CoherentPaths
from warpsar.kernels.codes import Polarization
from warpsar.kernels.effects import multibounce_ends as kernels
from warpsar.models import registry as models
from warpsar.runtime.structs import fill
from warpsar.surface.bistatic import log_factorials


class Fields:
    """The fields that arrive at the last surface of paths, recorded once for each polarization that the radar sends."""

    def __init__(self, render: Recorder, paths: BouncePaths) -> None:
        self._render, self.paths = render, paths
        self.zetas = [render.coordinates(b.face, b.barycentric, b.point) for b in paths.bounces]
        self._known: dict[bool, Any] = {}

    @cached_property
    def stuff(self) -> Any:
        """`kernels.Stuff` of the mesh."""
        stage = self._render.stage
        has_length = ["correlation_length_m" in models.get(model).keys for model in stage.surface.model]
        return fill(
            kernels.Stuff,
            face_material=stage.face_material,
            eps_im=stage.eps_im,
            spectrum=stage.spectrum,
            aspect=stage.aspect,
            has_length=wp.array(has_length, dtype=int, device=self._render.program.device),
        )

    @cached_property
    def radar(self) -> Any:
        """`kernels.RadarWaves` of the view."""
        of = self._render.geometry
        return fill(kernels.RadarWaves, wavenumber=of.wavenumber, u=wp.vec3(*of.u), v=wp.vec3(*of.v))

    def sent(self, vertical: bool) -> Any:
        """`kernels.Arriving` of the paths where the radar sends 1 V/m in H, or V."""
        if vertical not in self._known:
            self._known[vertical] = self._reflected(vertical)
        return self._known[vertical]

    def _reflected(self, vertical: bool) -> Any:
        program, n = self._render.program, self.paths.weight.shape[0]
        field = [program.array(n, wp.vec3, grad=False), program.array(n, wp.vec3, grad=False)]
        inputs = [self.radar, self.paths.arrival, int(vertical)]
        wp.launch(kernels.incident_kernel, n, inputs=inputs, outputs=field[:1], device=program.device)
        for bounce, zeta in zip(self.paths.bounces[:-1], self.zetas[:-1], strict=True):
            back = [program.array(n, wp.vec3), program.array(n, wp.vec3)]
            mirror = [self.radar, bounce, self.stuff, zeta, _arriving(field)]
            program.launch(kernels.reflect_kernel, n, mirror, back)
            field = back
        return _arriving(field)


def _arriving(field: list[wp.array]) -> Any:
    return fill(kernels.Arriving, re=field[0], im=field[1])


def _verticals(polarization: int) -> tuple[bool, bool]:
    """Whether V is received, and whether it is sent."""
    name = Polarization(polarization).name
    return name[0] == "V", name[1] == "V"


def diffuse_power(render: Recorder, p: wp.array, fields: Fields, polarization: int) -> wp.array:
    """Record what each path returns per unit of its weight, shape (n,), where its last surface scatters."""
    program, paths, n = render.program, fields.paths, fields.paths.weight.shape[0]
    received, sent = _verticals(polarization)
    power = program.array(n)
    ends = [int(received), int(sent), paths.bounces[-1], paths.home, fields.stuff]
    orders = log_factorials(str(program.device))
    inputs = [p, fields.radar, *ends, orders, fields.zetas[-1], fields.sent(sent), fields.sent(received)]
    program.launch(kernels.diffuse_kernel, n, inputs, [power])
    return power


def coherent_power(
    render: Recorder, p: wp.array, coherent: CoherentPaths, fields: Fields, polarization: int
) -> wp.array:
    """Record the power of each sample of the cells over 4 pi [m2], at the first of its paths, shape (n,)."""
    program, paths, samples = render.program, coherent.paths, coherent.samples
    n, count = samples.coupling.shape[0], samples.first.shape[0] - 1
    received, sent = _verticals(polarization)
    amplitude, field, power = program.array(n, wp.vec2), program.array(count, wp.vec2), program.array(n)
    ends = [int(received), int(sent), paths.bounces[-1], paths.home, fields.stuff, fields.zetas[-1]]
    inputs = [fields.radar, *ends, fields.sent(sent), fields.sent(received)]
    program.launch(kernels.radiate_kernel, n, inputs, [amplitude])
    program.launch(kernels.sample_kernel, count, [samples.first, samples.coupling, amplitude], [field])
    program.launch(kernels.cell_power_kernel, n, [p, samples.first, samples.sample, field], [power])
    return power
