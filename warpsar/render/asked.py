"""What a launch of sigma0 is recorded for, and the kernels and inputs that it has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import warp as wp

from warpsar.kernels.codes import Polarization
from warpsar.runtime.program import Program
from warpsar.surface.stage import Stage
from warpsar.trace.hits import Hits


@dataclass(frozen=True)
class ShadeRequest:
    """What sigma0 is recorded for: coordinates `zeta` of the hits of a view, in one polarization.

    `of_the_mesh`: no effect has changed the coordinates, so they are the same all over a uniform material.
    """

    program: Program
    stage: Stage
    hits: Hits
    polarization: Polarization
    spectrum: wp.array
    zeta: wp.array
    of_the_mesh: bool
    more: Sequence[wp.array] = ()
    """Coordinates beyond the first four, vec4 each, where a model of the scene has them"""

    @cached_property
    def surfaces(self) -> Any:
        """The `kernels.HitSurfaces` that all kernels of sigma0 read."""
        return self.stage.hit_surfaces(self.hits, self.polarization, self.spectrum)


@dataclass(frozen=True)
class Way:
    """A launch for some hits: the kernel of sigma0, and the one that stores its slopes too.

    `also`, where there is one, runs in the backward pass: it makes an adjoint that is not of the coordinates, for the
    launch's array of sigma0.
    """

    kernel: wp.Kernel
    keeping: wp.Kernel
    inputs: list[Any]
    also: Callable[[wp.array], Callable[[], None]] | None = None
    in_lanes: bool = True
    """Whether the CPU takes many hits at once (kernels/lane_kernels.py): its kernels are such as can be written so"""
    slopes: Callable[[], wp.array] | None = None
    """Where `keeping` stores slopes, if it has more than four of a hit: then `also` brings them to the coordinates"""
    coordinates: Any = wp.vec4
    """Type of a hit's coordinates, and of its slopes"""
