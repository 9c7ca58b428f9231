"""The curves that a scene declares, each beside the terms of the scene's model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.curves.amplitudes import amplitudes
from warpsar.curves.angles import independent_deg, width_m
from warpsar.curves.metrics import decibels
from warpsar.curves.noise import share_of
from warpsar.curves.observed import ObservedCurve
from warpsar.world.curve import Curve
from warpsar.world.mesh import read_mesh
from warpsar.world.world import World

PER_DIRECTION = 8.0
"""Rows used for an independent direction: more say nothing new."""


def observe(
    world: World,
    *,
    cache: Path | None = None,
    device: str | None = None,
    thin: bool = True,
    per_direction: float = PER_DIRECTION,
) -> list[ObservedCurve]:
    """Every curve of a scene with the engine's terms, in the scene's order.

    `thin` leaves out rows that say nothing new: about `per_direction` stay for an independent direction.
    """
    seen = [_observe(world, curve, cache, device, per_direction if thin else None) for curve in world.curves]
    return _leveled(seen, world)


def _leveled(seen: list[ObservedCurve], world: World) -> list[ObservedCurve]:
    """Curves without an absolute level times one factor: the median of model over measurement on the train curves."""
    known = [curve.profiles is None for curve in world.curves]
    loose = [one for one, absolute in zip(seen, known, strict=True) if not absolute]
    if not loose:
        return seen
    told = [one for one in loose if one.role == "train"] or loose
    ratio = [decibels(np.abs(one.amplitude(world.radar.terms)) ** 2) - decibels(one.measured_m2) for one in told]
    level = float(np.median(np.concatenate(ratio)))
    return [
        one if absolute else replace(one, measured_m2=one.measured_m2 * 10.0 ** (level / 10.0), fitted_level_db=level)
        for one, absolute in zip(seen, known, strict=True)
    ]


def _observe(world: World, curve: Curve, cache: Path | None, device: str | None, most: float | None) -> ObservedCurve:
    table = curve.rows()
    if curve.mesh is not None:
        mesh = read_mesh(curve.mesh)
        world = replace(world, mesh=mesh, materials={name: world.materials[name] for name in mesh.materials})
    used = table.used(curve.mask)
    azimuth, incidence = table.azimuth_deg[used], table.incidence_deg[used]
    frequency, pol = float(np.median(table.frequency_hz)), table.polarization[0]
    step = independent_deg(width_m(world.mesh, azimuth, incidence), frequency)
    bare = ObservedCurve(
        name=f"{curve.file.stem} {frequency / 1e9:.4g} GHz {pol}",
        frequency_hz=frequency,
        polarization=pol,
        role=curve.role,
        azimuth_deg=azimuth,
        incidence_deg=incidence,
        measured_m2=table.rcs_m2[used],
        terms={},
        step_deg=step,
        background_m2=None if curve.background_dbsm is None else 10.0 ** (curve.background_dbsm / 10.0),
        share=None if curve.error_db is None else share_of(curve.error_db),
    )
    bare = bare if most is None else bare.thinned(most)
    bandwidth = 0.0 if curve.profiles is None else curve.profiles.bandwidth_hz
    return bare.beside(_terms(world, bare, cache, device, bandwidth))


def _terms(
    world: World, one: ObservedCurve, cache: Path | None, device: str | None, bandwidth_hz: float
) -> dict[str, NDArray[np.complex128]]:
    """The terms in the curve's directions; those of one incidence are found together."""
    found: dict[str, NDArray[np.complex128]] = {}
    for incidence in np.unique(one.incidence_deg):
        rows = np.flatnonzero(one.incidence_deg == incidence)
        azimuth, place = np.unique((one.azimuth_deg[rows] + 180.0) % 360.0 - 180.0, return_inverse=True)
        made = amplitudes(
            world,
            azimuth,
            float(incidence),
            one.frequency_hz,
            cache=cache,
            device=device,
            bandwidth_hz=bandwidth_hz,
        )
        for name, term in made.of(one.polarization).items():
            found.setdefault(name, np.zeros(len(one.azimuth_deg), np.complex128))[rows] = term[place]
    return found
