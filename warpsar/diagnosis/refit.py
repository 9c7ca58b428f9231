"""Full fits of a model, with an effect more or without."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.diagnosis.evidence import LARGEST
from warpsar.effects import get
from warpsar.fit import FitProblem
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
HOPELESS = 100.0  # log-likelihood behind the best start, after so many iterations, at which a start is given up


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
