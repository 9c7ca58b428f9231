"""The two ways down: Levenberg-Marquardt for a handful of parameters, Adam for fields.

Both are written as one step from a state to the next, and the state is all there is: saved and loaded, a run goes on
to the bit as if it had never stopped.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from warpsar.learning.coordinates import DeviceX
from warpsar.learning.problem import FitProblem

LARGEST_STEP = 1.0  # of a log coordinate in one Levenberg-Marquardt step: a factor e


FLAT = 2e-3  # predicted gain in log-likelihood at which Levenberg-Marquardt has arrived: 1/16 of a standard deviation


HARDLY, NOTHING = 1e-3, 1e-2  # damping that counts as none; share of `flat` that no step is tried for


SPREAD = 0.7  # standard deviation of the starts after the first, in log coordinates


BEND_STEP = 0.1  # of a step, over which the images' second derivative along it is measured


MOST_BEND = 0.75  # the largest correction, relative to the step, that is trusted


@dataclass(frozen=True)
class FitState:
    """Where a fit stands. `start` counts starts, `iteration` iterations over all of them. Adam on a CUDA device leaves
    what is as long as x there, in the arrays it works on: they hold until its next step, the best x until a better one
    has been followed by another step."""

    x: Any
    loss: float
    best_x: Any
    best_loss: float
    start: int = 0
    iteration: int = 0
    since_start: int = 0
    damping: float = 1e-3
    differentiated_at: np.ndarray | None = None  # Levenberg-Marquardt: where its Jacobian was made
    first_moment: Any = None  # Adam's
    second_moment: Any = None
    recent: np.ndarray | None = None  # Adam: best loss after each of the last iterations
    arrived: bool = False

    def arrays(self) -> dict[str, np.ndarray]:
        values = {f.name: v for f in fields(self) if (v := getattr(self, f.name)) is not None}
        return {name: v.numpy() if hasattr(v, "numpy") else np.asarray(v) for name, v in values.items()}

    @classmethod
    def from_arrays(cls, arrays: Any) -> FitState:
        kinds: dict[str, Any] = {"start": int, "iteration": int, "since_start": int, "arrived": bool}
        kinds |= {"loss": float, "best_loss": float, "damping": float}
        names = {f.name for f in fields(cls)}
        values: dict[str, Any] = {k: kinds.get(k, np.array)(arrays[k]) for k in arrays if k in names}
        return cls(**values)


def begin(problem: FitProblem, start: int, seed: int, previous: FitState | None = None) -> FitState:
    """The state at the beginning of start number `start`: 0 is the scene's own, others are drawn about it."""
    x = problem.x0.copy()
    if start:
        low, high = problem.bounds
        x = x + np.random.default_rng([seed, start]).normal(0.0, SPREAD, x.size)
        x = np.clip(x, low + 1e-3, high - 1e-3)
    if previous is None:
        return FitState(x, np.inf, x, np.inf, start)
    return FitState(x, np.inf, previous.best_x, previous.best_loss, start, previous.iteration)


def improved(state: FitState, x: np.ndarray | DeviceX, loss: float) -> FitState:
    if loss < state.best_loss:
        return replace(state, x=x, loss=loss, best_x=x, best_loss=loss)
    return replace(state, x=x, loss=loss)


def levenberg_marquardt(
    problem: FitProblem,
    state: FitState,
    moving: np.ndarray | None = None,
    *,
    flat: float = FLAT,
    kept_within: float = 0.0,
) -> FitState:
    """One step of Levenberg-Marquardt with geodesic acceleration (Transtrum and Sethna, arXiv:1201.5885).

    Gradient from the tape, curvature from central differences of the images (Fisher scoring for the gamma
    likelihood); these may be kept while x moves less than `kept_within` of a log coordinate, which speckle forgives and
    the long flat valleys of noiseless images do not. The valleys are narrow and bent (eps_r
    against h against l), so a step is corrected by the images' second derivative along it. Elements at a bound that the
    gradient pushes outward stay there, and so do those that no pixel depends on and that `moving`, shape (p,), leaves
    out. The fit has arrived where a Jacobian made on the spot, and a step that is hardly damped, promise less than
    `flat` in log-likelihood.
    """
    x = state.x
    origin = state.differentiated_at
    if origin is None or np.abs(x - origin).max() > kept_within:
        origin = x
    _, gradient = problem.gradient(x)
    modelled = problem.modelled(x)
    loss = problem.value(modelled) + problem.penalty()
    curvatures, jacobians = problem.curvatures(modelled), problem.jacobian_at(origin, moving)
    weighted = [c.weight[:, None] * j for j, c in zip(jacobians, curvatures, strict=True)]
    hessian = np.zeros((x.size, x.size))
    for j, w in zip(jacobians, weighted, strict=True):
        hessian += j.T @ w
    hessian = problem.ranks.sum(hessian)
    low, high = problem.bounds
    free = ~((x <= low) & (gradient > 0) | (x >= high) & (gradient < 0)) & (np.diag(hessian) > 0)
    if moving is not None:
        free &= moving
    scale = np.diag(hessian) + 1e-12 * max(float(np.trace(hessian)), 1e-300)
    damping, growth, new_x, new_loss = state.damping, 4.0, x, loss

    def damped_by(factor: float) -> tuple[np.ndarray, np.ndarray, float]:
        """The damped curvature, the step, and the gain in log-likelihood that it promises."""
        damped = (hessian + np.diag(factor * scale))[np.ix_(free, free)]
        step = np.zeros_like(x)
        step[free] = -np.linalg.solve(damped, gradient[free])
        promised = -float(gradient @ step + 0.5 * step @ hessian @ step)
        # hosts of different kinds may round a solution differently, and none may go another way
        promised, *whole = problem.ranks.same([promised, *step]).tolist()
        return damped, np.array(whole), promised

    there = damped_by(min(damping, HARDLY))[2] < flat
    for _ in range(0 if there else 12):
        damped, step, promised = damped_by(damping)
        if promised < NOTHING * flat:
            break
        step *= min(1.0, LARGEST_STEP / float(np.abs(step).max()))
        ahead = problem.modelled(np.clip(x + BEND_STEP * step, low, high))
        further = problem.modelled(np.clip(x + 2.0 * BEND_STEP * step, low, high))
        bend = [np.log(b * m / a**2) / BEND_STEP**2 for a, b, m in zip(ahead, further, modelled, strict=True)]
        correction = np.zeros_like(x)
        push = np.zeros_like(x)
        for w, b in zip(weighted, bend, strict=True):
            push += w.T @ b
        correction[free] = -0.5 * np.linalg.solve(damped, problem.ranks.sum(push)[free])
        correction = problem.ranks.same(correction)
        if 2.0 * np.linalg.norm(correction) <= MOST_BEND * np.linalg.norm(step):
            trial = np.clip(x + step + correction, low, high)
            value = problem.value(problem.modelled(trial)) + problem.penalty()
            if value <= loss:
                new_x, new_loss, damping = trial, value, max(damping / 10.0, 1e-12)
                break
        damping *= growth
        growth *= 2.0  # far from the minimum the damping may have to rise by many decades
    state = improved(state, new_x, new_loss)
    stuck = new_x is x  # arrived, or float32 images tell no lower point
    return replace(
        state,
        damping=HARDLY if stuck else min(damping, 1e6),  # a new Jacobian gets every chance
        differentiated_at=None if stuck else origin,
        iteration=state.iteration + 1,
        since_start=state.since_start + 1,
        arrived=stuck and origin is x,
    )
