"""Full fits of a model, with an effect more or without, and what views that were left out say of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.diagnosis.evidence import LARGEST
from warpsar.effects import get
from warpsar.fit import FitProblem
from warpsar.likelihood import loss_terms
from warpsar.optimise import FLAT, FitState, begin, levenberg_marquardt
from warpsar.results import learned_scene
from warpsar.surface import Surface

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from warpsar.observation import Observation
    from warpsar.scene import Scene
    from warpsar.simulation import Rays

MOST_ITERATIONS = 40  # of one start
# Where models are only ranked, or start where they belong: iterations of one start, and the promised log-likelihood at
# which it has arrived; verdicts turn on several units.
QUICK_ITERATIONS, QUICK_FLAT = 12, 0.05
KEPT_WITHIN = 0.2  # of a log coordinate, that a fit moves before its images are differentiated again
ROBUST_TURNS = 4
MOST_LEFT_OUT = 0.2  # of all pixels
BLOCK = 8  # columns: what a view's own parameters are fitted on and judged on alternates
VARIES = 0.5  # of a gain, that may be gained again by letting a view's own parameter vary over its columns
HOPELESS = 100.0  # log-likelihood behind the best start, after so many iterations, at which a start is given up
# Log-likelihood of one pixel beyond which a difference counts no more: a few bright pixels would else be all of the
# sum, and all of its error.
LARGEST_DIFFERENCE = 20.0


@dataclass(frozen=True)
class Bench:
    """Rays and frozen pixels that all models are compared on. `observations` by view name."""

    device: Any
    rays: Rays
    observations: Mapping[str, list[Observation]]

    def problem(self, scene: Scene, views: Sequence[str] | None = None, *, dark: bool | None = None) -> FitProblem:
        """The scene's fit problem; its dark pixels are used where it has an additive effect, or as `dark` says."""
        if dark is None:
            dark = any(get(name).additive for name in scene.effects)
        seen = self.observations
        if dark:
            seen = {name: [one.with_dark() for one in found] for name, found in seen.items()}
        return FitProblem(scene, self.device, views=views, rays=self.rays, observations=seen)


@dataclass(frozen=True)
class Fitted:
    """A model at its best: `scene` holds what was learned; `log_likelihood` over the lit interior alone, up to a
    constant that all models share, and `whole` over all pixels that were fitted; `size`, the number of fitted
    parameters."""

    scene: Scene
    problem: FitProblem
    x: np.ndarray
    log_likelihood: float
    whole: float
    iterations: int

    @property
    def size(self) -> int:
        """Parameters that count: of those that sum to zero over the views, one does not."""
        zero_sums = {(c.effect, c.parameter.name) for c in self.problem.effect_coordinates if c.parameter.zero_sum}
        return int(self.x.size) - len(zero_sums)


def descend(
    problem: FitProblem,
    starts: Iterable[np.ndarray],
    moving: np.ndarray | None = None,
    *,
    quick: bool = False,
) -> tuple[np.ndarray, float, int]:
    """The best end of Levenberg-Marquardt from several starts, its loss, and the iterations of all."""
    best, best_loss, iterations = problem.x0, np.inf, 0
    low, high = problem.bounds
    most_iterations, flat = (QUICK_ITERATIONS, QUICK_FLAT) if quick else (MOST_ITERATIONS, FLAT)
    for start in starts:
        inside = np.clip(start, low, high)
        state = FitState(inside, np.inf, inside, np.inf)
        while not state.arrived and state.since_start < most_iterations:
            state = levenberg_marquardt(problem, state, moving, flat=flat, kept_within=KEPT_WITHIN)
            if state.since_start == QUICK_ITERATIONS and state.best_loss > best_loss + HOPELESS:
                break
        iterations += state.iteration
        if state.best_loss < best_loss:
            best, best_loss = state.best_x, state.best_loss
    return best, best_loss, iterations


def fit_model(bench: Bench, scene: Scene, further_starts: int, seed: int) -> Fitted:
    """The scene's model from its own start and others drawn about it."""
    problem = bench.problem(scene)
    starts = [begin(problem, k, seed).x for k in range(further_starts + 1)]
    return fitted_at(bench, problem, *descend(problem, starts))


def fit_robustly(base: Fitted, declared: Scene, bench: Bench) -> Fitted:
    """Where scores are taken: `base` fitted again without the pixels that it misses by more than `LARGEST` standard
    deviations, until none comes or goes. A few pixels a thousand times too bright would else drag the surface to where
    the effect that made them leaves no trace. `base` itself where nothing stands out, or a fifth of everything does.
    """
    problem, x, pixels = base.problem, base.x, base.problem.observations
    kept: list[np.ndarray] = []
    for _ in range(ROBUST_TURNS):
        modelled = base.problem.modelled(x)
        now = []
        for seen, mu, gain in zip(pixels, modelled, base.problem.gains(modelled), strict=True):
            interior = seen.interior.copy()
            interior[seen.interior] = np.abs(np.sqrt(seen.looks) * (seen.values / (gain * mu) - 1.0)) <= LARGEST
            now.append(interior)
        left = sum(int(k.sum()) for k in now)
        every = sum(int(seen.interior.sum()) for seen in pixels)
        if left == every or left < (1.0 - MOST_LEFT_OUT) * every:
            break
        if kept and all((a == b).all() for a, b in zip(kept, now, strict=True)):
            break
        kept = now
        reduced: dict[str, list[Observation]] = {}
        for seen, keep in zip(pixels, kept, strict=True):
            reduced.setdefault(seen.view.name, []).append(replace(seen, interior=keep))
        problem = replace(bench, observations=reduced).problem(base.scene, dark=False)
        start = problem.x0.copy()
        start[: problem.learned.size] = Surface.of(declared).nodes[problem.learned]
        x, _, _ = descend(problem, [x, start], quick=True)
    return base if problem is base.problem else replace(base, scene=learned_scene(problem, x), x=x)


def settle(bench: Bench, screened: Fitted, further_starts: int, seed: int) -> Fitted:
    """The screened model at its best: on from where it stands, and from surfaces drawn anew about it."""
    problem = screened.problem
    starts = [screened.x]
    for k in range(1, further_starts + 1):
        start = begin(problem, k, seed).x
        start[problem.learned.size :] = screened.x[problem.learned.size :]  # the effect stays where it was found
        starts.append(start)
    return fitted_at(bench, problem, *descend(problem, starts))


def refit_without(bench: Bench, fitted: Fitted, name: str) -> Fitted:
    """The model without one of its effects, fitted on from where it stands."""
    effects = {other: table for other, table in fitted.scene.effects.items() if other != name}
    problem = bench.problem(replace(fitted.scene, effects=effects))
    return fitted_at(bench, problem, *descend(problem, [problem.x0], quick=True))


def narrow(bench: Bench, fitted: Fitted) -> tuple[Bench, Fitted]:
    """The pixels that are lit, with all their neighbours, by `fitted` too, and the model fitted to those.

    An effect that moves light leaves pixels at its edge where the model's share of light is next to nothing, and
    whatever they measure would look like one more effect. All models of a turn see the same pixels.
    """
    from scipy.ndimage import minimum_filter

    fitted.problem.modelled(fitted.x)
    observations: dict[str, list[Observation]] = {}
    for view in fitted.problem.views:
        for seen in bench.observations[view.view.name]:
            lit = view.render.lit(seen.polarization).astype(np.uint8)
            inner = minimum_filter(lit, size=3, mode="constant") > 0
            kept = replace(seen, interior=seen.interior & inner, silent=seen.silent & inner)
            observations.setdefault(view.view.name, []).append(kept)
    pairs = [(a, b) for name in observations for a, b in zip(observations[name], bench.observations[name], strict=True)]
    if all((a.interior == b.interior).all() for a, b in pairs):
        return bench, fitted
    narrowed = replace(bench, observations=observations)
    problem = narrowed.problem(fitted.scene)
    return narrowed, fitted_at(narrowed, problem, *descend(problem, [problem.x0], quick=True))


def fitted_at(bench: Bench, problem: FitProblem, x: np.ndarray, loss: float, iterations: int) -> Fitted:
    """A problem's model at x, where its loss is `loss`."""
    scene = learned_scene(problem, x)
    bare = problem if not any(get(n).additive for n in scene.effects) else bench.problem(scene, dark=False)
    value = bare.value(bare.modelled(x))
    return Fitted(scene, problem, x, -value, -loss, iterations)


@dataclass(frozen=True)
class LeftOut:
    """Log-likelihood of views that were left out, with an effect less without it: sum and standard error."""

    gain: float
    error: float
    views: int

    @property
    def passed(self) -> bool:
        """More than two standard errors above zero; with a single view nothing can be left out."""
        return self.views < 2 or self.gain > 2.0 * self.error


def leave_one_view_out(bench: Bench, base: Fitted, fitted: Fitted, inflation: float) -> LeftOut:
    """Each training view in turn is predicted by both models, fitted to the others; pixels are compared in pairs, a
    pixel counting `LARGEST_DIFFERENCE` at most.

    Parameters of the one view (its gain, its interference) cannot come from the others: they are fitted on every other
    block of its columns and judged on the blocks between, all else held. `inflation` is the variance of a sum of
    correlated residuals over that of white ones.
    """
    names = [view.view.name for view in fitted.problem.views]
    if len(names) < 2:
        return LeftOut(0.0, 0.0, len(names))
    differences = []
    for name in names:
        others = [other for other in names if other != name]
        terms = [_predicted(bench, model, others, name) for model in (base, fitted)]
        differences.append(terms[0] - terms[1])
    every = _clipped(np.concatenate(differences))
    error = float(np.sqrt(every.size * every.var() * max(inflation, 1.0)))
    return LeftOut(float(every.sum()), error, len(names))


def varies_over_columns(bench: Bench, base: Fitted, fitted: Fitted, name: str) -> bool:
    """Whether what an effect holds for each view by itself is no property of the view: fitted anew to each block of the
    view's columns, it gains half as much again as it did by being one for all of them. So does something that lies in
    a few columns, such as a mover's smear along a range line."""
    gained = regained = 0.0
    for view in {c.view for c in fitted.problem.effect_coordinates if c.effect == name and c.view is not None}:
        held = bench.problem(fitted.scene, [view], dark=False)
        own = [c.effect == name and c.view == view for c in held.effect_coordinates]
        moving = np.concatenate([np.zeros(held.learned.size, bool), np.array(own, bool)])
        before = _terms(bench.problem(base.scene, [view], dark=False), None)
        gained += sum(_clipped(a - b).sum() for a, b in zip(before, _terms(held, held.x0), strict=True))
        for block in range(-(-held.scene.grid.shape[1] // BLOCK)):
            masks = [s.interior & (np.arange(s.interior.shape[1]) // BLOCK == block) for s in held.observations]
            if not any(mask.any() for mask in masks):
                continue
            pixels = [replace(s, interior=mask) for s, mask in zip(held.observations, masks, strict=True)]
            part = replace(bench, observations={view: pixels}).problem(fitted.scene, [view], dark=False)
            x, _, _ = descend(part, [part.x0], moving, quick=True)
            terms = zip(_terms(part, part.x0), _terms(part, x), strict=True)
            regained += sum(_clipped(a - b).sum() for a, b in terms) - 0.5 * sum(own)
    return regained > VARIES * gained


def _clipped(differences: np.ndarray) -> np.ndarray:
    return np.clip(differences, -LARGEST_DIFFERENCE, LARGEST_DIFFERENCE)


def _predicted(bench: Bench, model: Fitted, others: Sequence[str], name: str) -> np.ndarray:
    """Loss of every interior pixel of view `name` under the model fitted to `others`, shape (n,)."""
    problem = bench.problem(model.scene, others)
    x, _, _ = descend(problem, [problem.x0], quick=True)
    known = dict(zip(problem.labels, x, strict=True))
    held = bench.problem(model.scene, [name], dark=False)
    theirs = np.array([known.get(label, held.x0[i]) for i, label in enumerate(held.labels)])
    own = np.array([c.view == name for c in held.effect_coordinates], bool)
    moving = np.concatenate([np.zeros(held.learned.size, bool), own])
    if not moving.any():
        return np.concatenate(_terms(held, theirs))
    halves = []
    for half in (0, 1):
        fitted_on = [replace(s, interior=s.interior & _blocks(s, half)) for s in held.observations]
        part = replace(bench, observations={name: fitted_on}).problem(model.scene, [name], dark=False)
        x, _, _ = descend(part, [theirs], moving, quick=True)
        judged = zip(held.observations, _terms(held, x), strict=True)
        halves.append([terms[~_blocks(s, half)[s.interior]] for s, terms in judged])
    found = []
    for seen, first, second in zip(held.observations, *halves, strict=True):
        terms, even = np.empty(seen.pixels.size), _blocks(seen, 0)[seen.interior]
        terms[~even], terms[even] = first, second
        found.append(terms)
    return np.concatenate(found)


def _terms(problem: FitProblem, x: np.ndarray | None) -> list[np.ndarray]:
    """Loss of every pixel of each observation; of the scene as it stands where x is None."""
    modelled = problem.modelled_as_declared() if x is None else problem.modelled(x)
    parts = zip(problem.observations, modelled, problem.gains(modelled), strict=True)
    return [loss_terms("gamma", s.values, gain * mu, s.looks) for s, mu, gain in parts]


def _blocks(seen: Observation, half: int) -> np.ndarray:
    """Every other block of columns, shape of the image."""
    columns = np.arange(seen.interior.shape[1]) // BLOCK % 2 == half
    return np.broadcast_to(columns, seen.interior.shape)
