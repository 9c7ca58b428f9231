"""Views that are not calibrated alike."""

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
from warpsar.kernels.effects import view_gain as kernels

_GAIN = EffectParameter(
    "gain_db",
    "dB",
    0.0,
    -100.0,
    100.0,
    0.0,
    description="Gain of each view; the mean over the views is taken off.",
    per_view=True,
    zero_sum=True,
    span=3.0,
    fit_low=-30.0,
    fit_high=30.0,
)


class ViewGain(Effect):
    """A gain per view, in dB.

    Rougher surfaces look like a gain that all views share. So only differences from the mean over the scene's views
    act. Where all train views have a gain of their own, the surface's law of incidence is hardly known: they look from
    different incidences. So a few views that differ from all the others are asked for.
    """

    name = "view_gain"
    stage = "gain"
    acts_on = ("beta0", "slc", "phase-history")
    by_incidence = True
    order = 30
    summary = "gains that differ from view to view"
    example: ClassVar[dict[str, Any]] = {"gain_db": {"v0": 6.0, "v1": -6.0}}
    rate_case: ClassVar[dict[str, Any]] = {"gain_db": {"v0": 1.2, "v1": -1.0, "v2": 0.6, "v3": -0.8}}
    parameters = (_GAIN,)

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """It is one number for a view, whatever surface lies there."""
        return image.by_material()

    def trials(self, context: Context) -> list[Trial]:
        names = [view.name for view in context.scene.views if view.role == "train"]
        if len(names) < 2 or not context.scene.grid.calibrated:
            return []
        size = 0.2

        def table(name: str, gain: float) -> dict[str, dict[str, float]]:
            """One view up and the last one down: the others stay."""
            return {"gain_db": {name: gain, names[-1]: -gain}}

        steps = tuple(
            ScoreStep(f"gain of {name}", size, table(name, size), table(name, -size), views=(name, names[-1]))
            for name in names[:-1]
        )
        return [Trial(steps, ({"gain_db": dict.fromkeys(names, 0.0)},))]

    def simpler(self, table: Mapping[str, Any]) -> list[Mapping[str, Any]]:
        """Gains of a few views against all the others: of the one that is furthest from the median, of two..."""
        gains = table["gain_db"]
        middle = float(np.median(list(gains.values())))
        ordered = sorted(gains, key=lambda name: -abs(gains[name] - middle))
        return [
            {**table, "gain_db": {name: gains[name] - middle for name in gains if name in ordered[:few]}}
            for few in range(1, len(gains) - 1)
        ]

    def gain(self, render: Recorder, p: wp.array, sigma: wp.array, points: wp.array) -> wp.array:
        return render.program.mapped(kernels.gain_kernel, sigma, [p, sigma])


EFFECT = ViewGain()
