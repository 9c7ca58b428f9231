"""The receiver's own noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import amount
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.sidelobes import beside_sidelobes
from warpsar.effects.base.signature import (
    AT_LEAST,
    AT_MOST,
    FEWEST,
    KNOWN,
    SURE,
    SeenImage,
    Signature,
)
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels.effects import noise_floor as kernels


class NoiseFloor(Effect):
    """I' = I + level in every pixel, lit or not: it makes shadows grey. `level` is the noise-equivalent beta0."""

    name = "noise_floor"
    stage = "image"
    acts_on = ("beta0", "slc", "phase-history")
    order = 30
    affine = True
    additive = True
    is_floor = True
    summary = "noise of the receiver, the same in every pixel"
    example: ClassVar[dict[str, Any]] = {"level": 0.002}
    rate_case: ClassVar[dict[str, Any]] = {"level": 0.004}
    parameters = (amount("level", "beta0", 1e9, 1e-3, (1e-12, 1e6), "Power added to every pixel."),)

    def own_test(self, images: Sequence[SeenImage], table: Mapping[str, Any]) -> Signature:
        """A floor is seen in shadows, and does not fall with distance from what is bright, as sidelobes do."""
        share, error, pixels = beside_sidelobes(images, [one.gain * float(table["level"]) for one in images])
        numbers = {"pixels": float(pixels), "share": share, "error": error}
        if pixels < FEWEST or not math.isfinite(share + error):
            return Signature("none", f"{pixels} pixels in shadows: too few for a test", {"pixels": float(pixels)})
        facts = f"{pixels} pixels in shadows measure {share:.2f} +- {error:.2f} of the floor"
        beside = "beside what falls with distance from bright pixels, as sidelobes do"
        if share + SURE * error < AT_LEAST or share - SURE * error > AT_MOST:
            return Signature("against", f"{facts} {beside}", numbers)
        if error < KNOWN and AT_LEAST < share < AT_MOST:
            return Signature("confirmed", f"{facts} {beside}", numbers)
        return Signature("none", f"{facts}: it cannot be told here from sidelobes of what is bright", numbers)

    def trials(self, context: Context) -> list[Trial]:
        size = 0.1 * context.level
        return [Trial((ScoreStep("level", size, {"level": size}, one_sided=True),), ({"level": size},))]

    def noise_beta0(self, values: np.ndarray) -> float:
        return float(values[0])

    def image(self, render: Recorder, p: wp.array, image: wp.array) -> wp.array:
        return render.program.mapped(kernels.noise_kernel, image, [p, image])


EFFECT = NoiseFloor()
