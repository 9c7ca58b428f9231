"""Full fits of a model, with an effect more or without."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.ndimage import minimum_filter

from warpsar.compare.modelled import known_by_rays
from warpsar.compare.observation import Observation
from warpsar.diagnosis.models.change import as_declared
from warpsar.diagnosis.models.fit_setup import FitSetup, image_of
from warpsar.effects.registry import get
from warpsar.learning.optimise import FLAT, FitState, begin, levenberg_marquardt
from warpsar.learning.problem import FitProblem
from warpsar.learning.results import learned_scene
from warpsar.runtime import once
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import deviance
from warpsar.surface.surface import KEYS, Surface, kinds_of
from warpsar.world.pixels import Pixels
from warpsar.world.tables import Material

MOST_ITERATIONS = 40  # of one start
# Where models are only ranked, or start where they belong: iterations of one start, and the promised log-likelihood at
# which it has arrived; verdicts turn on several units.
QUICK_ITERATIONS, QUICK_FLAT = 12, 0.05
GLANCE = 4  # iterations after which candidates are compared for the first time
KEPT_WITHIN = 0.2  # of a log coordinate, that a fit moves before its images are differentiated again
# Log-likelihood from which on a pixel's cost is bounded where candidates are compared: a pixel of speckle costs 1.
BOUND = 20.0
# Log-likelihood behind the best, at which a fit is given up: of starts of one model after the quick iterations, and of
# candidates at their present pace.
HOPELESS = 100.0
# Starts of one model are compared after so many iterations, too; one that is not the best by the quick iterations, and
# has gained less than `STANDS` in log-likelihood since, goes along a flat valley: that is left to the best alone.
PACE_FROM, STANDS = 9, 0.5


@dataclass(frozen=True)
class Fitted:
    """A model at its best: `scene` holds what was learned; `log_likelihood` over the lit interior alone, up to a
    constant that all models share, and `whole` over all pixels that were fitted, both of what the scene knows to a
    tolerance too; `size`, the number of fitted parameters. Both are bounded as the setup's losses are, on which the
    model was fitted."""

    scene: Scene
    problem: FitProblem
    x: np.ndarray
    log_likelihood: float
    whole: float
    iterations: int

    @property
    def size(self) -> int:
        """Parameters that count: of those that sum to zero over the views, one does not."""
        return int(self.x.size) - len(self.problem.zero_sums)

    def content(self) -> dict[str, Any]:
        """Where the fit began and where it ended, for a checkpoint (JSON's types) and for other processes."""
        start = self.problem.scene
        return {
            "materials": surface_content(start),
            "effects": start.effects,
            "x": self.x.tolist(),
            "log_likelihood": self.log_likelihood,
            "whole": self.whole,
            "iterations": self.iterations,
        }

    @classmethod
    def of(cls, setup: FitSetup, scene: Scene, content: Mapping[str, Any]) -> Fitted:
        """The model of which `content` is; `scene` is of the same mesh and views."""
        start = replace(with_surface(scene, content["materials"]), effects=content["effects"])
        problem, x = setup.problem(start), np.array(content["x"])
        return cls(
            learned_scene(problem, x), problem, x, content["log_likelihood"], content["whole"], content["iterations"]
        )


def surface_content(scene: Scene) -> dict[str, dict[str, Any]]:
    """What a fit may change of each material, in JSON's types."""
    return {name: _values(material) for name, material in scene.materials.items()}


def with_surface(scene: Scene, about: Mapping[str, Mapping[str, Any]]) -> Scene:
    """The scene with the values that `surface_content` gave."""
    materials = {}
    for name, material in scene.materials.items():
        values = {k: _value(v) for k, v in about[name].items()}
        # what stands at its default stays unstated
        changed = {k: v for k, v in values.items() if v != getattr(material, k)}
        materials[name] = material.model_copy(update=changed)
    return replace(scene, materials=materials)


def _values(material: Material) -> dict[str, Any]:
    """What its fit may change, by key, in JSON's types."""
    keys = dict.fromkeys((*KEYS, *(kind.key for kind in kinds_of(material.model))))
    return {key: _plain(getattr(material, key)) for key in keys}


def _plain(value: Any) -> Any:
    """A material's value in JSON's types."""
    return {"pixels": value.values.tolist()} if isinstance(value, Pixels) else value


def _value(plain: Any) -> Any:
    """The value of which `_plain` made JSON's types."""
    if isinstance(plain, Mapping):
        return Pixels(plain["pixels"])
    return tuple(plain) if isinstance(plain, list) else plain


def descend(
    problem: FitProblem,
    starts: Iterable[np.ndarray],
    moving: np.ndarray | None = None,
    *,
    quick: bool = False,
    limit: float = -np.inf,
) -> tuple[np.ndarray, float, int]:
    """The best end of Levenberg-Marquardt from several starts, its loss and all iterations. The starts race; the
    hopeless are given up, and those that no longer gain on the best; `limit` as in `onward`. Processes share them."""
    flat = QUICK_FLAT if quick else FLAT

    def on(state: FitState, until: int) -> FitState:
        return onward(problem, state, until, limit, moving, flat=flat)

    def all_on(states: Sequence[FitState], untils: Sequence[int]) -> list[FitState]:
        return once.share([partial(on, state, until) for state, until in zip(states, untils, strict=True)])

    states = [standing_at(problem, start) for start in starts]
    if not quick:
        states = all_on(states, [PACE_FROM] * len(states))
    before = [state.best_loss for state in states]
    states = all_on(states, [QUICK_ITERATIONS] * len(states))
    if not quick:
        losses = [state.best_loss for state in states]
        worth = _worth_more(before, losses)
        states = all_on(states, [MOST_ITERATIONS if more else 0 for more in worth])
    best = min(states, key=lambda state: state.best_loss)
    return best.best_x, best.best_loss, sum(state.iteration for state in states)


def _worth_more(before: Sequence[float], losses: Sequence[float]) -> list[bool]:
    """Which starts go on: the best, and what is not hopeless and gained on the way to its loss."""
    best = min(losses)
    return [
        k == losses.index(best) or (loss <= best + HOPELESS and was - loss > STANDS)
        for k, (was, loss) in enumerate(zip(before, losses, strict=True))
    ]


def onward(
    problem: FitProblem,
    state: FitState,
    until: int,
    limit: float = -np.inf,
    moving: np.ndarray | None = None,
    *,
    flat: float = QUICK_FLAT,
) -> FitState:
    """On to iteration `until`, or to where the log-likelihood `limit` is out of reach at the present pace."""
    while not state.arrived and state.since_start < until:
        before = state.best_loss
        state = levenberg_marquardt(problem, state, moving, flat=flat, kept_within=KEPT_WITHIN)
        reached = state.best_loss - (before - state.best_loss) * (until - state.since_start)
        if state.since_start >= GLANCE and reached > HOPELESS - limit:
            break
    return state


def standing_at(problem: FitProblem, x: np.ndarray) -> FitState:
    """A fit that begins at x, or where the bounds are nearest to it."""
    inside = np.clip(x, *problem.bounds)
    return FitState(inside, np.inf, inside, np.inf)


def fit_model(
    setup: FitSetup, scene: Scene, further_starts: int, seed: int, started: np.ndarray | None = None
) -> Fitted:
    """The scene's model from its own start, or where it has `started`, and others drawn about the scene's own."""
    problem = setup.problem(scene)
    starts = [begin(problem, k, seed).x for k in range(further_starts + 1)]
    return _fit(setup, problem, starts if started is None else [started, *starts[1:]])


def _fit(
    setup: FitSetup,
    problem: FitProblem,
    starts: Iterable[np.ndarray],
    moving: np.ndarray | None = None,
    *,
    quick: bool = False,
    limit: float = -np.inf,
) -> Fitted:
    return fitted_at(setup, problem, *descend(problem, starts, moving, quick=quick, limit=limit))


def on_bounded_ground(setup: FitSetup, base: Fitted, declared: Scene) -> tuple[FitSetup, Fitted]:
    """Where scores are taken and candidates are compared: the setup that bounds what a pixel can cost, and `base`
    fitted again on it.

    A few pixels a thousand times too bright would else drag the surface to where the effect that made them leaves no
    trace, and would hide every other effect that is missing. Where no pixel stands out, speckle alone makes the losses,
    nothing is bounded, and this is `setup` with `base` as it is.
    """
    plain = replace(setup, bound=0.0)
    if not once.decide(float(_stands_out(base))):
        if base.problem.misfit.bound == 0.0:
            return plain, base
        return plain, _fit(plain, plain.problem(base.scene), [base.x], quick=True)
    bounded = replace(setup, bound=BOUND)
    problem = bounded.problem(base.scene)
    return bounded, _fit(bounded, problem, [base.x, _with_declared_surface(problem, base.x, declared)], quick=True)


def _with_declared_surface(problem: FitProblem, x: np.ndarray, declared: Scene) -> np.ndarray:
    """x with the surface of the scene file: what is missing may have dragged the fitted one to where no descent leads
    back from."""
    start = x.copy()
    start[: problem.learned.size] = Surface.of(as_declared(declared, problem.scene)).nodes[problem.learned]
    return start


def _stands_out(base: Fitted) -> bool:
    """Whether the model misses any pixel by more than `BOUND`: speckle does so in
    less than one pixel in 1e8, from 1 to 64 looks."""
    problem = base.problem
    modelled = problem.modelled(base.x)
    pairs = zip(problem.observations, modelled, problem.gains(modelled), strict=True)
    return any((deviance(seen.values, gain * mu, seen.looks) > 2.0 * BOUND).any() for seen, mu, gain in pairs)


def settle(setup: FitSetup, screened: Fitted, further_starts: int, seed: int) -> Fitted:
    """The screened model at its best: on from where it stands, and from surfaces drawn anew about it."""
    problem = setup.problem(screened.scene)
    starts = [problem.x0]
    for k in range(1, further_starts + 1):
        start = begin(problem, k, seed).x
        start[problem.learned.size :] = problem.x0[problem.learned.size :]  # the effects stay where they were found
        starts.append(start)
    return _fit(setup, problem, starts)


def refit_without(setup: FitSetup, fitted: Fitted, name: str) -> Fitted:
    """The model without one of its effects, fitted on from where it stands."""
    effects = {other: table for other, table in fitted.scene.effects.items() if other != name}
    return refit_as(setup, replace(fitted.scene, effects=effects))


def refit_as(
    setup: FitSetup,
    scene: Scene,
    declared: Scene | None = None,
    limit: float = -np.inf,
    held: Collection[str] = (),
) -> Fitted:
    """The model that starts as the scene stands, fitted on from there; and from the surface that is `declared`. A fit
    that does not reach the log-likelihood `limit` at its pace is given up (`onward`). `held`: effects that stay."""
    problem = setup.problem(scene)
    further = [] if declared is None else [_with_declared_surface(problem, problem.x0, declared)]
    moving = np.ones(problem.x0.size, bool) if held else None
    if moving is not None:
        moving[problem.of_effects] = [c.effect not in held for c in problem.effect_coordinates]
    return _fit(setup, problem, [problem.x0, *further], moving, quick=True, limit=limit)


def narrow(setup: FitSetup, other: FitSetup, fitted: Fitted) -> tuple[FitSetup, Fitted]:
    """The pixels that are lit, with all their neighbours, by `fitted` too, and the model fitted to those.

    An effect that moves light leaves pixels at its edge where the model's share of light is next to nothing, and
    whatever they measure would look like one more effect. Ways over several surfaces get few rays: pixels that they
    leave open beside speckle are left out, by `other`, which has the second set. All models of a turn see the same
    pixels.
    """
    fitted.problem.modelled(fitted.x)
    narrowed = narrowed_to(setup, fitted.problem)
    if any(get(name).follows_rays for name in fitted.scene.effects):
        narrowed = _known_by_rays(narrowed, other, fitted)
    if narrowed is setup:
        return setup, fitted
    return narrowed, refit_as(replace(narrowed, bound=fitted.problem.misfit.bound), fitted.scene)


def narrowed_to(setup: FitSetup, problem: FitProblem) -> FitSetup:
    """The setup with those of its pixels that a problem, which has run, lights with all their neighbours."""
    observations: dict[str, list[Observation]] = {}
    for view in problem.views:
        for seen in setup.observations[view.view.name]:
            lit = view.render.covered(seen.polarization).astype(np.uint8)
            inner = once.decide(minimum_filter(lit, size=3, mode="constant")) > 0
            kept = replace(seen, interior=seen.interior & inner, silent=seen.silent & inner)
            observations.setdefault(view.view.name, []).append(kept)
    return _with(setup, observations)


def _with(setup: FitSetup, observations: Mapping[str, list[Observation]]) -> FitSetup:
    """The setup with other observations; the same where the pixels are."""
    pairs = [(a, b) for name in observations for a, b in zip(observations[name], setup.observations[name], strict=True)]
    if all((a.interior == b.interior).all() for a, b in pairs):
        return setup
    return replace(setup, observations=observations)


def _known_by_rays(setup: FitSetup, other: FitSetup, fitted: Fitted) -> FitSetup:
    """The setup with those of its pixels that two sets of rays know well enough; the model, of the first, has run."""
    again = replace(other, observations=setup.observations).problem(fitted.problem.scene)
    again.modelled(fitted.x)
    observations: dict[str, list[Observation]] = {}
    for one, two in zip(fitted.problem.views, again.views, strict=True):
        for seen in setup.observations[one.view.name]:
            image, other_image = (image_of(each, seen.polarization) for each in (one, two))
            known = once.decide(known_by_rays(image, other_image, seen.looks)) > 0
            observations.setdefault(one.view.name, []).append(replace(seen, interior=seen.interior & known))
    return _with(setup, observations)


def fitted_at(setup: FitSetup, problem: FitProblem, x: np.ndarray, loss: float, iterations: int) -> Fitted:
    """A problem's model at x, where its loss is `loss`."""
    scene, value, misfit = learned_scene(problem, x), problem.prior.value(x), problem.misfit
    bare = problem.observations
    if any(get(name).additive for name in scene.effects):  # which have pixels that the others do not light
        bare = [seen for view in problem.views for seen in setup.observations[view.view.name]]
    for lit, seen, mu in zip(bare, problem.observations, problem.modelled(x), strict=True):
        value += misfit.weight(lit) * float(misfit.terms(lit, mu[lit.interior[seen.interior]]).sum())
    return Fitted(scene, problem, x, -float(once.decide(value)), -loss, iterations)
