"""What is needless beside the rest of a model (an earlier effect, a part of one, numbers that are all alike), and which
settings the rest asks for."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import replace
from statistics import mean
from typing import Any

from warpsar.diagnosis.found import Turn
from warpsar.diagnosis.geometry.registry import changes
from warpsar.diagnosis.models.fit_setup import FitSetup, OtherMeshes
from warpsar.diagnosis.models.refit import HOPELESS, Fitted, refit_as, refit_without
from warpsar.diagnosis.scores.templates import with_effect
from warpsar.diagnosis.turn.screening import WORTH
from warpsar.effects.base.trial import Context
from warpsar.effects.registry import get
from warpsar.learning.pose import FEW_RAYS
from warpsar.scene.scene import Scene

CLEARLY = 10.0
"""Times what few rays cost a model in log-likelihood: another setting's paths may be noisier than its own, by cells in
which fields of few rays add up."""


def prune(setup: FitSetup, turn: Turn, earlier: Sequence[str], price: float) -> None:
    """Drop each of the `earlier` effects whose loss costs less likelihood than its parameters do: `price` of 2 ln L
    each. A blur can stand in for a shift until the shift is found.

    An effect that adds power is there for the dark pixels. It can be needless only beside another one of its kind, and
    dark pixels are counted then.
    """
    for name in earlier:
        assert turn.fitted is not None
        if name not in turn.fitted.scene.effects:
            continue
        adds = get(name).additive
        if adds and not any(get(other).additive for other in turn.fitted.scene.effects if other != name):
            continue
        without = refit_without(setup, turn.fitted, name)
        before, after = ((one.whole if adds else one.log_likelihood) for one in (turn.fitted, without))
        lost = 2.0 * (before - after)
        if lost < (turn.fitted.size - without.size) * price:
            turn.dropped.append(name)
            turn.fitted = without


def trimmed(setup: FitSetup, fitted: Fitted, names: Sequence[str], price: float, declared: Scene) -> Fitted:
    """The model without those parts of the effects `names` (`Effect.simpler`) whose loss costs less than their
    parameters do: `price` of 2 ln L each, dark pixels counted. What a part has hidden may have dragged the surface, so
    fits begin from the `declared` one, too."""
    for name in names:
        trimming = True
        while trimming:
            trimming = False
            for table in get(name).simpler(fitted.scene.effects[name]):
                without = refit_as(setup, with_effect(fitted.scene, name, table), declared)
                if 2.0 * (fitted.whole - without.whole) < max(fitted.size - without.size, 1) * price:
                    fitted, trimming = without, True
                    break
    return fitted


def with_smaller(setup: FitSetup, fitted: Fitted, names: Sequence[str], price: float) -> Fitted:
    """The model with smaller effects in the place of those `names` that contain them (`Effect.contains`), where this
    costs less likelihood than the further numbers do: `price` of 2 ln L each.

    Shifts of single views that are all alike are one shift. Only that one carries over to other views.
    """
    for name in names:
        for smaller in get(name).contains:
            if smaller in fitted.scene.effects or name not in fitted.scene.effects:
                continue
            rest = {other: table for other, table in fitted.scene.effects.items() if other != name}
            start = _means(name, smaller, fitted.scene.effects[name])
            trial = refit_as(setup, with_effect(replace(fitted.scene, effects=rest), smaller, start))
            if 2.0 * (fitted.whole - trial.whole) < (fitted.size - trial.size) * price:
                fitted = trial
    return fitted


def _means(name: str, smaller: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """The smaller effect's table, with the means of the larger one's numbers of single views."""
    own = {p.name for p in get(name).parameters}
    shared = [p.name for p in get(smaller).parameters if p.name in own]  # in one order: a resumed run writes it too
    stated = {key: table[key] for key in shared if key in table}
    return {key: mean(one.values()) if isinstance(one, Mapping) else one for key, one in stated.items()}


def resettled(
    setup: FitSetup, fitted: Fitted, added: Sequence[str], declared: Scene, lost: set[Hashable] | None = None
) -> Fitted:
    """`fitted`, with those settings of the `added` effects that the images ask for; everything is fitted anew with
    each. What the scene file declares stays.

    A setting was chosen when the effect was added, while others were still missing: the window of a blur has hardly
    another shape than what they leave. Asked again, the choice does not depend on the order. Effects of the image are
    asked for all their settings, since what was rendered stays as it is; others for what their trials differ by. These
    begin from the `declared` surface, too: a wrong setting has made up for itself by the surface.

    `lost` holds the models that fell hopelessly behind with the settings that they have. They are not fitted again, and
    more are added. A bounce's other reflection has rays of its own to follow: it costs as much as a turn. So it is
    asked on a few of the rays first (`_far_behind`).
    """
    lost = set() if lost is None else lost
    for name in added:
        surface = declared if get(name).follows_rays else None
        for table in _other_settings(fitted.scene, name):
            scene = replace(fitted.scene, effects={**fitted.scene.effects, name: table})
            model = _settings_of(scene, declared)
            if model in lost:
                continue
            if get(name).follows_rays and _far_behind(setup, fitted, scene, declared):
                lost.add(model)
                continue
            trial = refit_as(setup, scene, surface, fitted.whole)
            if trial.log_likelihood > fitted.log_likelihood + WORTH:
                fitted = trial
            elif trial.log_likelihood < fitted.log_likelihood - HOPELESS:
                lost.add(model)
    return fitted


def _far_behind(setup: FitSetup, fitted: Fitted, scene: Scene, declared: Scene) -> bool:
    """Whether a fit of the `scene`, which differs from `fitted` in a setting, is given up on `FEW_RAYS` already: by
    `CLEARLY` times more than their fewness costs `fitted` itself."""
    few = replace(setup, rays=setup.rays.thinned(FEW_RAYS), others=OtherMeshes())
    problem = few.problem(fitted.scene)
    whole = -problem.value(problem.modelled(problem.x0)) - problem.penalty(problem.x0)
    trial = refit_as(few, scene, declared, whole)
    return trial.whole < whole - max(HOPELESS, CLEARLY * abs(fitted.whole - whole))


def _settings_of(scene: Scene, declared: Scene) -> Hashable:
    """What a model has beside numbers that are fitted: changes of geometry, effects, and their settings."""
    effects = [
        (name, *(f"{setting.name} = {table.get(setting.name, setting.default)}" for setting in get(name).settings))
        for name, table in sorted(scene.effects.items())
    ]
    return tuple(sorted(changes(declared, scene))), tuple(effects)


def _other_settings(scene: Scene, name: str) -> Iterator[dict[str, Any]]:
    """The effect's table with each other value of each setting that has a few."""
    effect, table = get(name), scene.effects[name]
    tried = [trial.starts[0] for trial in effect.trials(Context(scene, 1.0))] if effect.follows_rays else []
    for setting in effect.settings if effect.stage == "image" or tried else ():
        values = dict.fromkeys(start.get(setting.name) for start in tried) if tried else setting.schema.get("enum", [])
        for value in values:
            if value not in (None, table.get(setting.name, setting.default)):
                yield {**table, setting.name: value}
