"""Changes of geometry beside the effect that a turn would add: the likeliest of all is added on trial.

Both are judged on all usable pixels above a common floor (`all_pixels.py`), because a change of geometry is told by
what turns dark as much as by what turns bright.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from warpsar.diagnosis.found import Candidate, Turn
from warpsar.diagnosis.geometry.base.change import GeometryCandidate
from warpsar.diagnosis.geometry.registry import changes, coordinates
from warpsar.diagnosis.models.all_pixels import explained, log_likelihood
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.frozen import frozen
from warpsar.diagnosis.models.movable import bodies, may_move, standing
from warpsar.diagnosis.models.refit import Fitted, narrowed_to, refit_as
from warpsar.diagnosis.scores.score import minus_log_p
from warpsar.diagnosis.turn.addition import TOO_LITTLE
from warpsar.effects.registry import effects_at_edges
from warpsar.learning.geometry import still, with_free
from warpsar.learning.pose_search import FoundPoses, find_poses
from warpsar.scene.scene import Scene

LEAST = 0.25
"""Of what is unlike speckle in the pixels that a change of geometry touches, the share that it explains if it is the
cause, or one of a few that meet there."""


def add_the_likeliest(
    setup: FitSetup,
    turn: Turn,
    here: Fitted,
    declared: Scene,
    found: Sequence[GeometryCandidate],
    price: float,
) -> FitSetup:
    """Let each candidate of geometry contend with the effect that the turn has added, or with none.

    Fills in `turn.candidates`, and `turn.added` and `turn.fitted` where a change of geometry is the likeliest. A
    number costs `price` of 2 ln L. One that explains less than `LEAST` of what is unlike speckle where it changes
    anything is not the cause of that, whatever it gains. Scores are -ln p of the gain (Wilks), for all bodies that
    could be tried (Bonferroni). Returns the setup of the pixels that the added model was fitted on.
    """
    start = log_likelihood(setup, here)
    before = turn.added
    tried = np.log(max(len(bodies(declared, here.scene)), 1)) if found else 0.0
    best_worth, best_setup = 0.0, setup
    if turn.fitted is not None:
        gain = 2.0 * (log_likelihood(setup, turn.fitted) - start)
        best_worth = gain - (turn.fitted.size - here.size) * price
    for one in found:
        narrowed, fitted = fitted_beside(setup, one.scene, declared)
        gain = 2.0 * (log_likelihood(setup, fitted) - start)
        score = float(minus_log_p(np.array(max(gain, 0.0)), one.size, 0)) - tried
        candidate = Candidate(
            one.name,
            "testable",
            statistic=gain,
            minus_log_p=score,
            p_value=float(np.exp(-max(score, 0.0))),
            refit_gain=gain,
            refit_size=one.size,
            note="; ".join(one.words),
            table=dict(one.values),
        )
        turn.candidates.append(candidate)
        there = explained(setup, here, fitted)
        lacking = there.before - (there.before - there.after) / LEAST
        if lacking > 0.0:
            candidate.refused = _stands_in(there.share)
            candidate.again_at = start + lacking
        elif gain - one.size * price > best_worth:
            best_worth, best_setup = gain - one.size * price, narrowed
            turn.added, turn.fitted = one.name, fitted
    names = {one.name for one in found}
    for candidate in turn.candidates:
        if candidate.effect != turn.added and candidate.effect in {*names, before} and not candidate.refused:
            worth = candidate.refit_gain is not None and candidate.refit_gain > (candidate.refit_size or 0) * price
            candidate.refused = f"{turn.added} is likelier" if worth and turn.added else TOO_LITTLE
    return best_setup


def _stands_in(share: float) -> str:
    return f"it explains {max(share, 0.0):.0%} of what is unlike speckle where it changes anything: it is not the cause"


def with_all_anew(setup: FitSetup, turn: Turn, declared: Scene) -> FitSetup:
    """Let all changes of the geometry be fitted anew, together, beside what the turn has added.

    What was changed before stands where it was likeliest without the addition: a body that a wrong spacing or a shift
    has pulled aside. Left there, it makes other effects and angles seem likely. Returns the setup of the pixels that
    the model is fitted on.
    """
    if turn.fitted is None or not changes(declared, turn.base.scene):
        return setup
    scene, found = posed_anew(setup, turn.fitted, declared)
    if found is None:
        return setup
    narrowed, fitted = fitted_beside(setup, scene, declared)
    if log_likelihood(setup, fitted) <= log_likelihood(setup, turn.fitted):
        return setup
    turn.fitted = fitted
    return narrowed


def fitted_beside(setup: FitSetup, scene: Scene, declared: Scene) -> tuple[FitSetup, Fitted]:
    """The pixels of the setup that a scene of another geometry lights, too, and its model fitted to those: on from its
    surface, and from the `declared` one, since a body in the wrong place drags its surface anywhere."""
    problem = setup.problem(scene)
    problem.modelled(problem.x0)
    narrowed = narrowed_to(setup, problem)
    return narrowed, refit_as(narrowed, scene, declared)


def on_its_ground(setup: FitSetup, other: FitSetup, fitted: Fitted) -> tuple[FitSetup, Fitted]:
    """The pixels that a model of a new geometry lights, frozen anew for all that follows, and the model fitted to them.

    `other` has the second set of rays. The looks stay those that were known before.
    """
    one, two = (replace(each, observations={}) for each in (setup, other))
    pixels = frozen(one, two, fitted.scene)
    observations = {
        name: [
            replace(seen, looks=before.looks, texture=before.texture)
            for seen, before in zip(found, setup.observations[name], strict=True)
        ]
        for name, found in pixels.items()
    }
    made = replace(setup, observations=observations)
    return made, refit_as(replace(made, bound=fitted.problem.misfit.bound), fitted.scene)


def posed_anew(setup: FitSetup, fitted: Fitted, declared: Scene) -> tuple[Scene, FoundPoses | None]:
    """The model's scene with every object that was changed at its likeliest pose, and size where it was missing, and
    changed angles and spacings, all of them, surface and effects fitted together; as it is, and None, where nothing
    was changed or stands there."""
    moving = coordinates(declared, fitted.scene)
    return _on_all_pixels(setup, fitted, moving) if moving else (fitted.scene, None)


def with_edges(setup: FitSetup, fitted: Fitted, declared: Scene) -> tuple[Fitted, FoundPoses | None]:
    """The model where all pixels have it, edges among them: what was changed of its geometry, as `posed_anew`, and the
    effects that edges tell; the surface then again on its own pixels. As it is, and None, where it has none of these,
    or too many numbers (`may_move`).

    A shift hardly changes pixels away from edges. There it is known to a part of a pixel, and every outline, which
    tells a tenth of that, lies off by what is left.
    """
    moving, effects = coordinates(declared, fitted.scene), effects_at_edges(fitted.scene.effects)
    if (not moving and not effects) or not may_move(fitted.problem):
        return fitted, None
    scene, found = _on_all_pixels(setup, fitted, moving)
    return refit_as(setup, scene, held=effects), found


def _on_all_pixels(setup: FitSetup, fitted: Fitted, moving: Sequence[str]) -> tuple[Scene, FoundPoses]:
    """The model's scene with these parameters of its geometry, surface and effects at their likeliest."""
    views = [view.view.name for view in fitted.problem.views]
    free = with_free(fitted.scene, moving)
    found = find_poses(
        free, setup.device, views=views, observations=setup.observations, search=False, standing=standing(free)
    )
    return still(found.scene), found
