"""A backscatter law that no model here has, learned from the images."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import EffectParameter
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels.codes import Polarization
from warpsar.kernels.effects import learned_scattering as kernels

CHANNELS = ("HH", "VV", "HV")
ANGLES_DEG = (20, 40, 60)


def _height(channel: str, angle: int) -> EffectParameter:
    return EffectParameter(
        f"{channel.lower()}_{angle}",
        "dB",
        0.0,
        -30.0,
        30.0,
        0.0,
        span=1.0,
        fit_low=-20.0,
        fit_high=20.0,
        description=f"Height of the bump of {channel} at {angle} degrees.",
    )


class LearnedScattering(Effect):
    """sigma0 times 10^(g / 10), with g [dB] a smooth function of the local incidence for each polarization.

    g is a sum of bumps, cubic B-splines 80 degrees wide. Its heights are learned through the renderer. It leaves sigma0
    positive, HV and VH share it, and it is 0 where no height was learned. It is the same for all materials.
    """

    name = "learned_scattering"
    stage = "surface"
    by_incidence = True
    last_resort = True
    order = 50
    summary = "backscatter that no model has, as a function of incidence"
    example: ClassVar[dict[str, Any]] = {"hh_20": -3.0, "hh_40": 1.0, "hh_60": 4.0}
    rate_case: ClassVar[dict[str, Any]] = {"hh_20": -2.0, "hh_60": 3.0, "vv_20": -2.0, "vv_60": 3.0}
    parameters = tuple(_height(channel, angle) for channel in CHANNELS for angle in ANGLES_DEG)

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """Every polarization must show it."""
        return {image.polarization: image.lit}

    def law_db(self, table: Mapping[str, Any], incidence_deg: np.ndarray) -> Mapping[str, np.ndarray]:
        """g of each polarization of which `table` states a height."""
        stated = [one for one in CHANNELS if any(key.startswith(f"{one.lower()}_") for key in table)]
        return {channel: shape_db(table, channel, incidence_deg) for channel in stated}

    def trials(self, context: Context) -> list[Trial]:
        channels = {"HV" if one in ("HV", "VH") else one for one in context.scene.radar.polarizations}
        size = 0.1
        heights = [p.name for p in self.parameters if p.name.split("_")[0].upper() in channels]
        steps = tuple(ScoreStep(name, size, {name: size}, {name: -size}) for name in heights)
        return [Trial(steps, (dict.fromkeys(heights, 0.0),))]

    def scattering(self, render: Recorder, p: wp.array, zeta: wp.array, sigma: wp.array, polarization: int) -> wp.array:
        channel = CHANNELS.index("HV" if Polarization(polarization).crossed else Polarization(polarization).name)
        inputs = [p, channel, render.shaded.cos_incidence, sigma]
        return render.program.mapped(kernels.growth_kernel, sigma, inputs)


def shape_db(values: Mapping[str, float], channel: str, incidence_deg: np.ndarray) -> np.ndarray:
    """g [dB] of a channel at incidences (n,), for the heights that an effect's table states."""
    total = np.zeros(np.shape(incidence_deg))
    for angle in ANGLES_DEG:
        a = np.abs(np.asarray(incidence_deg, float) - angle) / 20.0
        bump = np.where(a < 1, 1 + a * a * (0.75 * a - 1.5), 0.25 * np.maximum(2 - a, 0) ** 3)
        total += values.get(f"{channel.lower()}_{angle}", 0.0) * bump
    return total


EFFECT = LearnedScattering()
