"""Levenberg-Marquardt for a handful of parameters, and the state of a fit, which Adam (adam.py) shares.

Each optimiser is one step from a state to the next. The state holds everything: a run that is saved and loaded goes on
to the bit as if it had never stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpsar.learning.coordinates import DeviceX
from warpsar.learning.problem import FitProblem
from warpsar.learning.roughness import FieldPrior
from warpsar.learning.sparse_quadratic import SparseQuadratic
from warpsar.runtime.deadline import check
from warpsar.runtime.matmul import transposed_times

LARGEST_STEP = 1.0  # of a log coordinate in one Levenberg-Marquardt step: a factor e
FLAT = 2e-3  # predicted gain in log-likelihood at which Levenberg-Marquardt has arrived: 1/16 of a standard deviation
FLAT_FIELD = 0.2  # the same of fields: thousands of nodes gain a little for long; verdicts turn on several units
HARDLY, NOTHING = 1e-3, 1e-2  # damping that counts as none; share of `flat` that no step is tried for
SPREAD = 0.7  # standard deviation of the starts after the first, in log coordinates
BEND_STEP = 0.1  # of a step, over which the images' second derivative along it is measured
MOST_DOUBLED = 3  # of a straight step
MOST_BEND = 0.75  # the largest correction, relative to the step, that is trusted


@dataclass(frozen=True)
class FitState:
    """Where a fit stands. `start` counts starts, `iteration` iterations over all of them.

    Adam on a CUDA device leaves x, best x and moments there, in the arrays that it works on. They hold until its next
    step; the best x holds until a better one has been followed by another step.
    """

    x: Any  # np.ndarray; of Adam on a CUDA device a DeviceX
    loss: float
    best_x: Any  # the same
    best_loss: float
    start: int = 0
    iteration: int = 0
    since_start: int = 0
    damping: float = 1e-3
    differentiated_at: np.ndarray | None = None  # Levenberg-Marquardt: where its Jacobian was made
    first_moment: np.ndarray | wp.array | None = None  # Adam's
    second_moment: np.ndarray | wp.array | None = None
    recent: np.ndarray | None = None  # Adam: best loss after each of the last iterations
    arrived: bool = False

    def arrays(self) -> dict[str, np.ndarray]:
        """The state as arrays of the host, for a checkpoint."""
        values = {f.name: v for f in fields(self) if (v := getattr(self, f.name)) is not None}
        return {name: v.numpy() if hasattr(v, "numpy") else np.asarray(v) for name, v in values.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> FitState:
        """The state that `arrays` gave."""
        kinds: dict[str, Callable[[Any], Any]] = {"start": int, "iteration": int, "since_start": int, "arrived": bool}
        kinds |= {"loss": float, "best_loss": float, "damping": float}
        names = {f.name for f in fields(cls)}
        values: dict[str, Any] = {k: kinds.get(k, np.array)(arrays[k]) for k in arrays if k in names}
        return cls(**values)


def begin(problem: FitProblem, start: int, seed: int, previous: FitState | None = None) -> FitState:
    """The state at the beginning of start number `start`: 0 is the scene's own, others are drawn about it.

    Known elements stay within their tolerance.
    """
    x = problem.x0.copy()
    if start:
        low, high = problem.bounds
        together = problem.moved_together  # a field as a whole
        drawn = np.random.default_rng([seed, start]).normal(0.0, SPREAD, together.size)
        x = x + problem.prior.narrowed(np.repeat(drawn, together), x)
        x = np.clip(x, low + 1e-3, high - 1e-3)
    if previous is None:
        return FitState(x, np.inf, x, np.inf, start)
    return FitState(x, np.inf, previous.best_x, previous.best_loss, start, previous.iteration)


def improved(state: FitState, x: np.ndarray | DeviceX, loss: float) -> FitState:
    """The state at x, which is the best so far where its loss is lower."""
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
    straight: bool = False,
) -> FitState:
    """One step of Levenberg-Marquardt with geodesic acceleration (Transtrum and Sethna, arXiv:1201.5885).

    `straight`: without the acceleration. Where the loss is bounded tightly, weights change along a step more than
    the images bend, and the correction stands in its way.

    Gradient and curvature come from the images' Jacobian (Fisher scoring for the gamma likelihood). With penalties, or
    without hits at hand, the gradient is the adjoint's. The Jacobian is then kept while x moves less than
    `kept_within` of a log coordinate: speckle forgives that, the long flat valleys of noiseless images do not. The
    valleys are narrow and bent (eps_r against h against l), so the images' second derivative along a step corrects it.

    An element at a bound stays there while the gradient pushes it outward. Elements that no pixel depends on stay too,
    and so do those that `moving`, shape (p,), leaves out. The fit has arrived where a Jacobian made on the spot, and a
    step that is hardly damped, promise a gain of less than `flat` in log-likelihood.
    """
    check()
    x = np.asarray(state.x)
    origin = state.differentiated_at
    if origin is None or np.abs(x - origin).max() > kept_within or problem.slopes_tell_all:
        origin = x
    here: _Quadratic | SparseQuadratic
    if isinstance(problem.prior, FieldPrior):
        origin, flat = x, max(flat, FLAT_FIELD)
        here = SparseQuadratic.about(problem, x, moving)
    else:
        here = _Quadratic.about(problem, x, origin, moving)
    damping, growth, new_x, new_loss = state.damping, 4.0, x, here.loss
    arrived = here.step(min(damping, HARDLY)).promised < flat
    for _ in range(0 if arrived else 12):
        step = here.step(damping)
        if step.promised < NOTHING * flat:
            break
        if straight and isinstance(here, _Quadratic):
            trial: np.ndarray | None = here.ahead(step)  # type: ignore[arg-type]  # its own step
        else:
            trial = here.bent(problem, step)  # type: ignore[arg-type]  # each takes the steps that it gave
        if trial is not None:
            value = problem.value(problem.modelled(trial)) + problem.penalty(trial)
            if value <= here.loss:
                new_x, new_loss, damping = trial, value, max(damping / 10.0, 1e-12)
                if straight and isinstance(here, _Quadratic):
                    new_x, new_loss = here.further(problem, step, new_x, new_loss)  # type: ignore[arg-type]
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
        arrived=(stuck and origin is x) or (isinstance(here, SparseQuadratic) and here.loss - new_loss < flat / 4.0),
    )


@dataclass(frozen=True)
class _Step:
    """A damped step of the free elements, and the gain in log-likelihood that it promises; `damped` is the curvature
    that it was solved with."""

    damped: np.ndarray
    step: np.ndarray
    promised: float


@dataclass(frozen=True)
class _Quadratic:
    """The loss about x as a quadratic: gradient and `hessian`, shapes (p,) and (p, p), and `free`, the elements that
    may move. `weighted`: each observation's Jacobian times its weights, shape (p, pixels)."""

    x: np.ndarray
    loss: float
    gradient: np.ndarray
    hessian: np.ndarray
    free: np.ndarray
    modelled: list[np.ndarray]
    weighted: list[np.ndarray]
    bounds: tuple[np.ndarray, np.ndarray]
    decided: Callable[[ArrayLike], np.ndarray]

    @classmethod
    def about(cls, problem: FitProblem, x: np.ndarray, origin: np.ndarray, moving: np.ndarray | None) -> _Quadratic:
        """With the Jacobian of `origin`. That of x gives the gradient too, where there is no penalty."""
        if origin is x and problem.slopes_tell_all:
            modelled, jacobians = problem.linearised(x, moving)
            curvatures = problem.curvatures(modelled)
            loss = problem.value(modelled) + problem.prior.value(x)
            slope = np.zeros(x.size)
            for j, c in zip(jacobians, curvatures, strict=True):
                slope -= transposed_times(j, (c.weight * c.residual)[:, None])[:, 0]
            gradient = problem.over_views(slope) + problem.prior.gradient(x)
        else:
            _, gradient = problem.gradient(x)
            modelled = problem.standing()
            loss = problem.value(modelled) + problem.penalty(x)
            curvatures, (_, jacobians) = problem.curvatures(modelled), problem.linearised(origin, moving)
        weighted = [j.T * c.weight for j, c in zip(jacobians, curvatures, strict=True)]
        hessian = np.zeros((x.size, x.size))
        for j, w in zip(jacobians, weighted, strict=True):
            hessian += transposed_times(w.T, j)
        hessian = problem.over_views(hessian) + problem.prior.information(x)
        low, high = problem.bounds
        free = ~((x <= low) & (gradient > 0) | (x >= high) & (gradient < 0)) & (np.diag(hessian) > 0)
        if moving is not None:
            free &= moving
        return cls(x, loss, gradient, hessian, free, modelled, weighted, (low, high), problem.decided)

    def step(self, damping: float) -> _Step:
        """The step at a damping, which is relative to the diagonal of the curvature."""
        hessian, free = self.hessian, self.free
        scale = np.diag(hessian) + 1e-12 * max(float(np.trace(hessian)), 1e-300)
        damped = (hessian + np.diag(damping * scale))[np.ix_(free, free)]
        step = np.zeros_like(self.x)
        step[free] = -np.linalg.solve(damped, self.gradient[free])
        promised = -float(self.gradient @ step + 0.5 * step @ hessian @ step)
        promised, *whole = self.decided([promised, *step]).tolist()
        return _Step(damped, np.array(whole), promised)

    def ahead(self, planned: _Step, times: float = 1.0) -> np.ndarray:
        """Where so many times the step lead, shortened."""
        step = planned.step * min(times, LARGEST_STEP / float(np.abs(planned.step).max()))
        return np.clip(self.x + step, *self.bounds)

    def further(self, problem: FitProblem, planned: _Step, x: np.ndarray, loss: float) -> tuple[np.ndarray, float]:
        """The best place, and its loss, among the step's end x and twice, four times... the step. A step of reweighted
        least squares is never too long and often too short (Lange, JRSS B 57, 1995)."""
        for doubled in range(1, MOST_DOUBLED + 1):
            trial = self.ahead(planned, 2.0**doubled)
            if np.array_equal(trial, x):
                break
            value = problem.value(problem.modelled(trial)) + problem.penalty(trial)
            if value >= loss:
                break
            x, loss = trial, value
        return x, loss

    def bent(self, problem: FitProblem, planned: _Step) -> np.ndarray | None:
        """Where the step leads, shortened and corrected by the second derivative of ln mu along it.

        None where the correction is too large to be trusted.
        """
        low, high = self.bounds
        step = planned.step * min(1.0, LARGEST_STEP / float(np.abs(planned.step).max()))
        places = [np.clip(self.x + share * step, low, high) for share in (BEND_STEP, 2.0 * BEND_STEP)]
        ahead, further = (problem.modelled(at) for at in places)
        bend = [np.log(b * m / a**2) / BEND_STEP**2 for a, b, m in zip(ahead, further, self.modelled, strict=True)]
        push = np.zeros_like(self.x)
        for w, b in zip(self.weighted, bend, strict=True):
            push += transposed_times(w.T, b[:, None])[:, 0]
        correction = np.zeros_like(self.x)
        push = problem.over_views(push) + problem.prior.push(self.x, places, BEND_STEP)
        correction[self.free] = -0.5 * np.linalg.solve(planned.damped, push[self.free])
        correction = self.decided(correction)
        if 2.0 * np.linalg.norm(correction) > MOST_BEND * np.linalg.norm(step):
            return None
        return np.clip(self.x + step + correction, low, high)
