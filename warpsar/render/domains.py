"""How much of the lit surface lies outside the domain of its model (equations 9, 12, 19, corrected)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import warp as wp

from warpsar.kernels import domains as kernels
from warpsar.kernels.codes import Polarization, Spectrum
from warpsar.models import registry
from warpsar.render.rendered import RenderPiece
from warpsar.surface.stage import Stage
from warpsar.surface.surface import Surface
from warpsar.world import sigma0_table


def lit_areas(stage: Stage, renders: Iterable[RenderPiece]) -> np.ndarray:
    """Per material, shape (materials, 4): lit area where small perturbation is in use (tau < 1) and where geometric
    optics is (tau > 0), and of each what lies outside its domain. Of renders that have run, in any one unit."""
    device = stage.target.device
    cells = wp.zeros((int(kernels.PARTIALS), len(stage.surface.materials), 4), dtype=wp.float64, device=device)
    for render in renders:
        hits = render.shaded
        wp.launch(
            kernels.area_kernel,
            hits.count,
            inputs=[
                hits.geometry.wavenumber,
                hits.face,
                stage.face_material,
                hits.weight,
                hits.cos_incidence,
                render.zeta,
            ],
            outputs=[cells],
            device=device,
        )
    return np.asarray(cells.numpy().sum(axis=0))


def model_areas(stage: Stage, renders: Iterable[RenderPiece]) -> np.ndarray:
    """Per material, shape (materials, 2): lit area, and what of it lies outside the domain of the material's model.

    For materials with another model than the default, of renders that have run, in any one unit.
    """
    device, surface = stage.target.device, stage.surface
    by_crossed = {crossed: _domains(surface, device, crossed=crossed) for crossed in (False, True)}
    cells = wp.zeros((int(kernels.PARTIALS), len(surface.materials), 2), dtype=wp.float64, device=device)
    for render in renders:
        hits = render.shaded
        domains = by_crossed[any(Polarization[name].crossed for name in render.images)]
        inputs = [hits.geometry.wavenumber, domains, hits.face, stage.face_material, hits.weight]
        inputs += [hits.cos_incidence, render.zeta]
        wp.launch(kernels.model_area_kernel, hits.count, inputs=inputs, outputs=[cells], device=device)
    return np.asarray(cells.numpy().sum(axis=0))


def _domains(surface: Surface, device: wp.Device, *, crossed: bool) -> wp.array:
    """The domain of each material's model, (materials,); `crossed`: where there are images of HV or VH."""
    record: Any = kernels.KernelDomain
    domains: Any = np.zeros(len(surface.materials), record.numpy_dtype())
    for m, (name, file) in enumerate(zip(surface.model, surface.sigma0, strict=True)):
        stated = registry.get(name).domain
        for key in ("incidence_deg", "kh", "kl", "moisture", "slope"):
            domains[key][m] = getattr(stated, key)
        if file is not None:
            angles = sigma0_table.read(file).incidence_deg
            domains["incidence_deg"][m] = angles[0], angles[-1]
        if crossed and surface.spectrum[m] == Spectrum.GAUSSIAN:
            domains["kl"][m] = stated.crossed_gaussian_kl
    return wp.array(domains, dtype=record, device=device)
