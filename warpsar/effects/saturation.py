"""A receiver driven beyond its linear range."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import EffectParameter, Setting
from warpsar.effects.base.phase import ComplexImage
from warpsar.effects.base.recorder import Recorder, lit_pixels
from warpsar.effects.base.signature import FEWEST, SURE, SeenImage, Signature, looks_on
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels.effects import saturation as kernels

_TOP = 1e-3  # below the largest value: what counts as equal to it
_PILE, _PILE_SHARE = 8, 2e-3  # pixels at the largest value, and their share, from which an image is clipped
_LOSES = 0.7  # of the looks in dim pixels, that bright ones have at least
_TURNS = 4  # of eight bits each: a number's 32


def _pivot(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return value == "median" or (number and value > 0.0 and math.isfinite(value))


_PIVOT = {"anyOf": [{"type": "number", "exclusiveMinimum": 0.0}, {"enum": ["median"]}]}


class Saturation(Effect):
    """I' = p (I / p)^`exponent` about the pivot p: an exponent under 1 lifts what is below p and dims what is above.

    `pivot` is a beta0 or "median". The median is over the pixels that rays meet, in each image by itself. It is taken
    again whenever parameters change, with its derivative.
    """

    name = "saturation"
    stage = "image"
    acts_on = ("beta0", "slc")
    of_numbers = True
    in_place = "--product slc: it compresses the samples of an image"
    order = 50
    needs_all_hits = True
    summary = "power compressed about its median"
    example: ClassVar[dict[str, Any]] = {"exponent": 0.6}
    rate_case: ClassVar[dict[str, Any]] = {"exponent": 0.8}
    parameters = (
        EffectParameter(
            "exponent", "1", 1.0, 0.01, 10.0, 0.9, fit_low=0.1, fit_high=4.0, description="Exponent of the compression."
        ),
    )
    settings = (
        Setting(
            "pivot",
            "median",
            _pivot,
            'a positive beta0 or "median"',
            description="Power that stays as it is; the median of the image by default.",
            schema=_PIVOT,
        ),
    )

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """One exponent holds for dim and bright pixels."""
        bright = image.without > np.median(image.without[image.lit])
        return {"the dim half": image.lit & ~bright, "the bright half": image.lit & bright}

    def own_test(self, images: Sequence[SeenImage], table: Mapping[str, Any]) -> Signature:
        """What compression does to speckle on even ground, and whether the images have a top level.

        An exponent g that acts on measured power makes L looks L / g^2. One that acts on the mean leaves them.
        """
        for one in images:
            values = one.measured[one.lit]
            most = float(values.max())
            top = int((values >= (1.0 - _TOP) * most).sum())
            if top >= max(_PILE, _PILE_SHARE * values.size):
                text = f"{top} pixels of {one.view.name} measure the largest value, {most:.4g}: they are clipped"
                return Signature("against", text, {"clipped_pixels": float(top), "top_level": most})
        halves = [self.parts(one, table) for one in images]
        masks = [[half[name] & one.even for half, one in zip(halves, images, strict=True)] for name in halves[0]]
        (dim, error), (bright, other) = (looks_on(images, mask) for mask in masks)
        if not math.isfinite(error + other):
            return Signature("none", f"under {FEWEST} pixels of even ground, dim or bright: no test of its speckle")
        ratio, spread = bright / dim, math.hypot(error, other)
        numbers = {"looks_dim": dim, "looks_bright": bright, "log_error": spread}
        facts = f"even ground has {dim:.2f} (dim) and {bright:.2f} (bright) times the declared looks"
        if math.log(ratio) + SURE * spread < math.log(_LOSES):
            return Signature("against", f"{facts}: compression takes no looks from the bright half", numbers)
        expected = 1.0 / table.get("exponent", 1.0) ** 2
        declared = not any(one.looks_estimated for one in images)
        found = 0.5 * (math.log(dim) + math.log(bright))
        apart = abs(math.log(expected)) > SURE * spread
        if declared and apart and abs(found - math.log(expected)) < SURE * spread < abs(found):
            return Signature("confirmed", f"{facts}: the exponent makes {expected:.2f}", numbers)
        return Signature(
            "none", f"{facts}: this neither confirms a compression of the measured power nor refutes it", numbers
        )

    def trials(self, context: Context) -> list[Trial]:
        size = 0.01
        step = ScoreStep("exponent - 1", size, {"exponent": 1.0 + size}, {"exponent": 1.0 - size})
        return [Trial((step,), ({"exponent": 0.9}, {"exponent": 1.1}))]

    def samples(
        self, image: ComplexImage, values: np.ndarray, settings: Mapping[str, Any], samples: np.ndarray
    ) -> np.ndarray:
        """Each sample by itself; its phase stays. The pivot is that of the image of power, "median" too.

        The mean over draws is then gamma(1 + `exponent`) times the compressed mean, where samples are of one look.
        """
        pivot = settings["pivot"]
        if pivot == "median":
            power, met = image.power(self.name)
            pivot = float(np.median(power[met])) if met.any() else 0.0
        share = np.abs(samples) ** 2 / np.float32(pivot) if pivot > 0.0 else np.zeros(samples.shape, np.float32)
        factor = np.power(share, np.float32(0.5 * (values[0] - 1.0)), out=np.ones_like(share), where=share > 0.0)
        return samples * factor

    def image(self, render: Recorder, p: wp.array, image: wp.array) -> wp.array:
        chosen = render.settings[self.name]["pivot"]
        if chosen == "median":
            pivot = self._median(render, image)
        else:
            pivot = wp.array([chosen], dtype=float, device=render.program.device)
        return render.program.mapped(kernels.compress_kernel, image, [p, pivot, image])

    def _median(self, render: Recorder, image: wp.array) -> wp.array:
        """Record the median of the pixels that rays meet: a radix selection of the two numbers in the middle."""
        program, n = render.program, image.shape[0]
        mask = lit_pixels(render)
        lit: wp.array = wp.array(mask.astype(np.int32), dtype=int, device=program.device)
        count = int(mask.sum())
        middle = []
        for rank in (max(0, (count - 1) // 2), count // 2):
            prefix, passed = (program.array(_TURNS + 1, int, grad=False) for _ in range(2))
            histogram = program.array((_TURNS, int(kernels.DIGITS)), int, grad=False, sum_into=True)
            for turn in range(_TURNS):
                program.launch(kernels.count_digit_kernel, n, [turn, lit, image, prefix], [histogram])
                program.launch(kernels.pick_digit_kernel, 1, [turn, rank, histogram], [prefix, passed])
            middle.append(prefix)
        equal = program.array(2, int, grad=False, sum_into=True)
        median = program.array(1, sum_into=True)
        program.launch(kernels.count_equal_kernel, n, [lit, image, *middle], [equal])
        program.launch(kernels.median_kernel, n, [lit, image, *middle, equal], [median])
        return median


EFFECT = Saturation()
