"""Copies of the image in azimuth, where the pulse rate is too low to tell echoes apart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import EffectParameter, amount
from warpsar.effects.base.phase import Copy
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage, Signature, power_in
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels.effects import azimuth_ambiguity as kernels

_NEAREST_PX = 3  # nearer copies are a point spread


class AzimuthAmbiguity(Effect):
    """I'(u) = I(u) + level (I(u - offset) + I(u + offset)), linear between pixels.

    Nothing comes from outside the image. For a strip-map, offset = lambda R PRF / (2 v).
    """

    name = "azimuth_ambiguity"
    stage = "image"
    acts_on = ("beta0", "slc", "phase-history")
    order = 20
    affine = True
    additive = True
    in_image = True
    summary = "faint copies of the image at a distance in azimuth"
    example: ClassVar[dict[str, Any]] = {"level": 0.05, "offset_m": 22.0}
    rate_case: ClassVar[dict[str, Any]] = {"level": 0.05, "offset_m": 9.0}
    parameters = (
        amount("level", "1", 1.0, 0.01, (1e-9, 1.0), "Power of each copy, as a share of the image."),
        EffectParameter("offset_m", "m", math.nan, 0.0, 1e6, 10.0, description="Distance of the copies in azimuth."),
    )

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """There is a copy on either side, of the same strength."""
        pixels = round(table.get("offset_m", 0.0) / image.spacing_m[1])
        cols = image.without.shape[1]
        room = np.pad(image.without, ((0, 0), (pixels, pixels)))
        right, left = room[:, :cols], room[:, 2 * pixels : 2 * pixels + cols]
        return {"the copy on the left": left > right, "the copy on the right": right > left}

    def own_test(self, images: Sequence[SeenImage], table: Mapping[str, Any]) -> Signature:
        """The copies that fall into dark pixels."""
        masks = [one.dark & (one.with_it > 0.0) & (one.without <= 0.1 * one.with_it) for one in images]
        return power_in(images, masks, "the copies", "in dark pixels")

    def trials(self, context: Context) -> list[Trial]:
        """One trial per pixel of offset: linear interpolation finds a copy up to half a pixel away."""
        grid = context.scene.grid
        size = 0.01
        found = []
        for pixels in range(_NEAREST_PX, grid.shape[1]):
            at = {"level": size, "offset_m": pixels * grid.spacing_m[1]}
            found.append(Trial((ScoreStep("level", size, at, one_sided=True),), (at,), f"offset {at['offset_m']:g} m"))
        return found

    def copies(self, values: np.ndarray) -> tuple[Copy, ...]:
        """One on either side. Its echoes come from another part of the Doppler spectrum than those of the image: no
        phase holds between them."""
        level, offset = (float(value) for value in values)
        return Copy(-offset, level), Copy(offset, level)

    def image(self, render: Recorder, p: wp.array, image: wp.array) -> wp.array:
        return render.program.mapped(kernels.ghost_kernel, image, [p, render.spacing_m[1], render.shape[1], image])


EFFECT = AzimuthAmbiguity()
