"""What a model may lack: effects that the scene does not declare, and more of those that it has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warpsar.diagnosis.scores.templates import with_effect
from warpsar.effects.base.effect import Effect
from warpsar.effects.base.trial import Context
from warpsar.effects.registry import get, names
from warpsar.scene.scene import Scene

MOST_TRIALS = 8
"""An effect with more trials (a copy at any distance, any band of rows) is found by its score, not by fits."""
TRACE = 0.02  # of an amount where a fit begins


@dataclass(frozen=True)
class EffectHypothesis:
    """An effect, or with `extension` more of one that the model has."""

    effect: str
    extension: str = ""

    @property
    def label(self) -> str:
        return f"{self.effect}, {self.extension}" if self.extension else self.effect

    def tables(self, scene: Scene, level: float) -> list[dict[str, Any]]:
        """The effect's tables where fits may begin: the middle start of each of its trials.

        `level`: median beta0 of the model.
        """
        effect = get(self.effect)
        if self.extension:
            return [dict(effect.extensions(scene.effects[self.effect])[self.extension])]
        return [dict(trial.starts[len(trial.starts) // 2]) for trial in effect.trials(Context(scene, level))]

    def trace_of(self, table: Mapping[str, Any]) -> dict[str, Any]:
        """The table with `TRACE` of each amount: so little that what it adds tells by its sign whether it helps."""
        amounts = {one.name for one in get(self.effect).parameters if one.neutral == 0.0 and one.scale == "log"}
        return {key: TRACE * value if key in amounts else value for key, value in table.items()}

    def started(self, scene: Scene, table: Mapping[str, Any], surface: Scene) -> Scene:
        """The scene with the effect, on the surface of `scene` itself or of another one.

        An effect that was missing may have left the fitted surface in a valley that no fit leads out of.
        """
        return with_effect(replace(scene, materials=dict(surface.materials)), self.effect, table)


def hypotheses(scene: Scene, level: float) -> list[EffectHypothesis]:
    """All that fits can tell: effects with few trials and the same numbers for all views, none of which another
    declared effect can do.

    A product that says at which level it was clipped says so how it made its numbers: no compression beside it.
    """
    known = any(view.clipped_at is not None for view in scene.views)
    contained = {name for other in scene.effects for name in get(other).contains}
    found = [
        EffectHypothesis(name)
        for name in names()
        if not (name in scene.effects or name in contained or (known and get(name).of_numbers))
        and _tried(get(name), scene, level)
    ]
    for name, table in scene.effects.items():
        if not table.get("fixed"):
            found += [EffectHypothesis(name, more) for more in get(name).extensions(table)]
    return found


def _tried(effect: Effect, scene: Scene, level: float) -> bool:
    of_views = [one.per_view for one in effect.parameters] + [one.per_view for one in effect.settings]
    if effect.last_resort or any(of_views):
        return False
    return 0 < len(effect.trials(Context(scene, level))) <= MOST_TRIALS


def level_of(images: Sequence[np.ndarray]) -> float:
    """Median of the modelled beta0."""
    return float(np.median(np.concatenate([image.ravel() for image in images])))
