"""An antenna that sends and receives less away from its boresight."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import EffectParameter
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels.effects import antenna_pattern as kernels
from warpsar.world.world import World


def _pair(unit: str, low: float, high: float, start: float, fit_high: float) -> tuple[EffectParameter, EffectParameter]:
    where = "for a strip-map" if unit == "deg" else "for a plane wave"
    return (
        EffectParameter(
            f"beamwidth_{unit}",
            unit,
            math.inf,
            low,
            math.inf,
            start,
            description=f"One-way 3 dB width of the beam, {where}.",
            scale="log",
            fit_low=low,
            fit_high=fit_high,
        ),
        EffectParameter(
            f"boresight_{unit}",
            unit,
            math.nan,
            -high,
            high,
            0.0,
            description=f"Middle of the beam, {where}.",
            span=start / 4,
            fit_low=-high,
            fit_high=high,
        ),
    )


class AntennaPattern(Effect):
    """Two-way power gain exp(-4 ln 2 (phi - phi0)^2 / B^2)^2 of a Gaussian beam of one-way 3 dB width B.

    In a strip-map scene, phi [deg] is the elevation angle from the direction to the reference point; it is larger for
    a steeper depression. A plane wave has no such angle: there phi is the elevation coordinate X . v [m].
    """

    name = "antenna_pattern"
    stage = "gain"
    acts_on = ("beta0", "slc", "phase-history")
    order = 10
    summary = "two-way elevation pattern of the antenna"
    example: ClassVar[dict[str, Any]] = {"beamwidth_m": 45.0, "boresight_m": 8.0}
    rate_case: ClassVar[dict[str, Any]] = {"beamwidth_m": 40.0, "boresight_m": 4.0}
    parameters = (*_pair("deg", 1e-3, 90.0, 20.0, 1e3), *_pair("m", 1e-3, 1e7, 100.0, 1e7))

    def check(self, scene: World, table: Mapping[str, Any]) -> str | None:
        for unit, other, kind in (("deg", "m", "plane-wave"), ("m", "deg", "strip-map")):
            used = [key for key in (f"beamwidth_{unit}", f"boresight_{unit}") if key in table]
            strips = [scene.slant_range_m(view) is not None for view in scene.views]
            if used and not any(strip == (unit == "deg") for strip in strips):
                allowed = f"beamwidth_{other} and boresight_{other}"
                return f".{used[0]}: found in a {kind} scene; allowed there are {allowed}"
        return None

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """Its gain goes by the place in the beam, whatever surface lies there."""
        return image.by_material()

    def trials(self, context: Context) -> list[Trial]:
        """Two steps, since ln gain = c1 x + c2 x^2 + ...

        The linear term comes from a beam turned to either side, the square term from a beam on the middle.
        """
        ranges = [context.scene.slant_range_m(view) for view in context.scene.views]
        strip = all(r is not None for r in ranges)
        extent = context.extent_m
        if strip:
            extent = math.degrees(math.atan2(extent, min(r for r in ranges if r is not None)))
        unit = "deg" if strip else "m"

        def table(width: float, boresight: float) -> dict[str, float]:
            return {f"beamwidth_{unit}": width, f"boresight_{unit}": boresight}

        # At the edge the square term is 0.02, the linear one with the beam turned to the edge 0.04.
        curvature = 0.02 / extent**2
        width = math.sqrt(8.0 * math.log(2.0) / curvature)
        linear = ScoreStep("linear", 2.0 * curvature * extent, table(width, extent), table(width, -extent))
        square = ScoreStep("square", curvature, table(width, 0.0), one_sided=True)
        starts = tuple(table(4.0 * extent, turned * extent) for turned in (0.0, 0.5, -0.5))
        return [Trial((linear, square), starts)]

    def gain(self, render: Recorder, p: wp.array, sigma: wp.array, points: wp.array) -> wp.array:
        geometry = render.geometry
        return render.program.mapped(
            kernels.antenna_kernel,
            sigma,
            [p, geometry.slant_range_m or 0.0, wp.vec3(*geometry.d), wp.vec3(*geometry.v), points, sigma],
        )


EFFECT = AntennaPattern()
