"""The curves that a scene declares, each beside the terms of the scene's model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.curves.amplitudes import amplitudes
from warpsar.curves.angles import independent_deg, width_m
from warpsar.curves.noise import share_of
from warpsar.curves.observed import ObservedCurve
from warpsar.io import curves
from warpsar.world.curve import Curve
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
    return [_observe(world, curve, cache, device, per_direction if thin else None) for curve in world.curves]


def _observe(world: World, curve: Curve, cache: Path | None, device: str | None, most: float | None) -> ObservedCurve:
    table = curves.read(curve.file).select(curve.frequency_hz, curve.polarization)
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
    return bare.beside(_terms(world, bare, cache, device))


def _terms(
    world: World, one: ObservedCurve, cache: Path | None, device: str | None
) -> dict[str, NDArray[np.complex128]]:
    """The terms in the curve's directions; those of one incidence are found together."""
    found: dict[str, NDArray[np.complex128]] = {}
    for incidence in np.unique(one.incidence_deg):
        rows = np.flatnonzero(one.incidence_deg == incidence)
        azimuth, place = np.unique((one.azimuth_deg[rows] + 180.0) % 360.0 - 180.0, return_inverse=True)
        made = amplitudes(world, azimuth, float(incidence), one.frequency_hz, cache=cache, device=device)
        for name, term in made.of(one.polarization).items():
            found.setdefault(name, np.zeros(len(one.azimuth_deg), np.complex128))[rows] = term[place]
    return found
