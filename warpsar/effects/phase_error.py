"""A phase error over slow time, which the processor has not taken out: the image is defocused in azimuth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import EffectParameter, Setting
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.slow_time import FEWEST_KNOTS, phase_at, spline
from warpsar.effects.base.trial import Context, Trial
from warpsar.kernels.effects import phase_error as kernels
from warpsar.world.taper import taper
from warpsar.world.world import World

_NODES = 64
"""Places of the aperture at which an image of power looks at the slope of the phase."""


def _phase(name: str, what: str) -> EffectParameter:
    meaning = f"{what} [rad], for each view."
    return EffectParameter(name, "rad", 0.0, -1e3, 1e3, 1.0, description=meaning, per_view=True, span=3.0)


def _is_shape(value: Any) -> bool:
    numbers = isinstance(value, list | tuple) and len(value) >= FEWEST_KNOTS
    return numbers and all(type(one) in (int, float) and abs(one) <= 1e3 for one in value)


_SHAPE = Setting(
    "spline_shape",
    {},
    _is_shape,
    f"a list of at least {FEWEST_KNOTS} numbers within 1000",
    description="Phases at equidistant places from one end of the aperture to the other, for each view; "
    "`spline_rad` multiplies them.",
    schema={"type": "array", "items": {"type": "number", "minimum": -1e3, "maximum": 1e3}, "minItems": FEWEST_KNOTS},
    per_view=True,
)


class PhaseError(Effect):
    """Samples times exp(j phi(x)): phi(x) = `quadratic_rad` x^2 + `cubic_rad` x^3 + `quartic_rad` x^4 + a spline.

    x is the place of the antenna along azimuth, -1 to 1 over the whole aperture. The spline is natural and cubic,
    `spline_rad` times `spline_shape`.

    Products with phase have it in the samples themselves: each pulse of a phase history is turned, and with it the
    response of a complex image. The mean power of an image is convolved in azimuth with the shares of power by the
    shift phi'(x) cell / pi. That is the method of stationary phase: the centroid and the second moment of the response
    are exact for any phi, its shape for strong ones. The cell and the taper are those of `point_spread`.
    """

    name = "phase_error"
    stage = "image"
    acts_on = ("beta0", "slc", "phase-history")
    order = 15
    affine = True
    in_image = True
    of_phase = True
    summary = "phase error over slow time, which defocuses in azimuth"
    example: ClassVar[dict[str, Any]] = {"quadratic_rad": {"v0": 20.0, "v1": 20.0}}
    rate_case: ClassVar[dict[str, Any]] = {"quadratic_rad": {"v0": 4.0, "v1": 4.0, "v2": 4.0, "v3": 4.0}}
    parameters = (
        _phase("quadratic_rad", "Quadratic phase at the ends of the aperture"),
        _phase("cubic_rad", "Cubic phase at the end of the aperture that lies along azimuth"),
        _phase("quartic_rad", "Quartic phase at the ends of the aperture"),
        _phase("spline_rad", "Factor on the phases of `spline_shape`"),
    )
    settings = (_SHAPE,)

    def trials(self, context: Context) -> list[Trial]:
        """None: power alone cannot tell it from `point_spread`. `diagnose` asks the phase of complex images."""
        return []

    def check(self, scene: World, table: Mapping[str, Any]) -> str | None:
        shapes = table.get("spline_shape", {})
        for view in table.get("spline_rad", {}):
            if view not in shapes:
                return f".spline_rad.{view}: found without spline_shape.{view}, which has the phases; must have both"
        return None

    def phase(self, values: np.ndarray, settings: Mapping[str, Any], place: NDArray[np.float64]) -> np.ndarray:
        return phase_at(place, values[:3], float(values[3]), settings["spline_shape"])

    def image(self, render: Recorder, p: wp.array, image: wp.array) -> wp.array:
        program, device = render.program, render.program.device
        place = (np.arange(_NODES) + 0.5) / _NODES * 2.0 - 1.0
        share = taper(render.taper[1], 0.5 * place) ** 2
        shape = render.settings[self.name]["spline_shape"]
        slope = np.zeros(_NODES) if shape is None else spline(shape)(place, 1)
        nodes: list[wp.array] = [
            wp.array(one, dtype=float, device=device) for one in (place, share / share.sum(), slope)
        ]
        pixels = render.resolution_m[1] / (np.pi * render.spacing_m[1])
        return program.mapped(kernels.smear_kernel, image, [p, *nodes, pixels, render.shape[1], image])


EFFECT = PhaseError()
