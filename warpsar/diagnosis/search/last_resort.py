"""The last resort, where no named effect explains what is left: backscatter that is learned from the images."""

from __future__ import annotations

from dataclasses import replace

from warpsar.diagnosis.found import Candidate
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.left_out import leave_one_view_out
from warpsar.diagnosis.models.refit import Fitted, refit_as
from warpsar.diagnosis.search.confirmation import NOT_ELSEWHERE
from warpsar.diagnosis.turn.addition import TOO_LITTLE
from warpsar.effects.base.trial import Context
from warpsar.effects.registry import get, names

LEAST_VIEWS = 3
"""With two the law of one view would be asked of one other, at one other incidence."""


def learned_law(setup: FitSetup, here: Fitted, price: float) -> tuple[Candidate, Fitted] | None:
    """An effect of the last resort with its fit, and whether views left out bear it (`Candidate.refused`).

    None where the scene has it already, or too few views to leave one out. A parameter costs `price` of 2 ln L.
    """
    offered = [name for name in names() if get(name).last_resort and name not in here.scene.effects]
    if not offered or len({view.view.name for view in here.problem.views}) < LEAST_VIEWS:
        return None
    name = offered[0]
    trial = get(name).trials(Context(here.scene, 1.0))[0]
    scene = replace(here.scene, effects={**here.scene.effects, name: dict(trial.starts[0])})
    fitted = refit_as(setup, scene)
    found = Candidate(name, "testable", note="the last resort: no named effect explains the residual")
    found.refit_gain = 2.0 * (fitted.log_likelihood - here.log_likelihood)
    found.refit_size = fitted.size - here.size
    found.table = fitted.scene.effects[name]
    if found.refit_gain <= found.refit_size * price:
        found.refused = TOO_LITTLE
        return found, fitted
    found.left_out = leave_one_view_out(setup, here, fitted, name)
    found.refused = "" if found.left_out.passed else NOT_ELSEWHERE
    return found, fitted
