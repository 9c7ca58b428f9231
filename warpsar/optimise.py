"""The two ways down: Levenberg-Marquardt for a handful of parameters, Adam (warp.optim) for fields.

Both are written as one step from a state to the next, and the state is all there is: saved and loaded, a run goes on
to the bit as if it had never stopped.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from warpsar.fit import FitProblem

LARGEST_STEP = 1.0  # of a log coordinate in one Levenberg-Marquardt step: a factor e
FLAT = 2e-3  # predicted gain in log-likelihood at which Levenberg-Marquardt has arrived: 1/16 of a standard deviation
BEND_STEP = 0.1  # of a step, over which the images' second derivative along it is measured
MOST_BEND = 0.75  # the largest correction, relative to the step, that is trusted
PLATEAU_WINDOW, PLATEAU_GAIN = 50, 1e-5  # Adam: relative gain of the best loss over so many iterations
SETTLING = 30.0  # Adam's step shrinks after so many iterations: a constant one rattles in total variation's kinks
SPREAD = 0.7  # standard deviation of the starts after the first, in log coordinates


@dataclass(frozen=True)
class FitState:
    """Where a fit stands. `start` counts starts, `iteration` iterations over all of them."""

    x: np.ndarray
    loss: float
    best_x: np.ndarray
    best_loss: float
    start: int = 0
    iteration: int = 0
    since_start: int = 0
    damping: float = 1e-3
    first_moment: np.ndarray | None = None
    second_moment: np.ndarray | None = None
    recent: np.ndarray | None = None  # Adam: best loss after each of the last iterations
    arrived: bool = False

    def arrays(self) -> dict[str, np.ndarray]:
        return {f.name: np.asarray(v) for f in fields(self) if (v := getattr(self, f.name)) is not None}

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


def _better(state: FitState, x: np.ndarray, loss: float) -> FitState:
    if loss < state.best_loss:
        return replace(state, x=x, loss=loss, best_x=x, best_loss=loss)
    return replace(state, x=x, loss=loss)


def levenberg_marquardt(problem: FitProblem, state: FitState, moving: np.ndarray | None = None) -> FitState:
    """One step of Levenberg-Marquardt with geodesic acceleration (Transtrum and Sethna, arXiv:1201.5885).

    Gradient from the tape, curvature from central differences of the images (Fisher scoring for the gamma
    likelihood). The valleys are narrow and bent (eps_r against h against l), so a step is corrected by the images'
    second derivative along it. Elements at a bound that the gradient pushes outward stay there, and so do those that
    `moving`, shape (p,), leaves out.
    """
    x = state.x
    _, gradient = problem.gradient(x)
    modelled = problem.modelled(x)
    loss = problem.value(modelled) + problem.penalty()
    curvatures, jacobians = problem.curvatures(modelled), problem.jacobian(x)
    weighted = [c.weight[:, None] * j for j, c in zip(jacobians, curvatures, strict=True)]
    hessian = sum(j.T @ w for j, w in zip(jacobians, weighted, strict=True))
    low, high = problem.bounds
    free = ~((x <= low) & (gradient > 0) | (x >= high) & (gradient < 0))
    if moving is not None:
        free &= moving
    scale = np.diag(hessian) + 1e-12 * max(float(np.trace(hessian)), 1e-300)
    flat = [np.log(mu) for mu in modelled]
    damping, growth, new_x, new_loss, predicted = state.damping, 4.0, x, loss, np.inf
    for _ in range(12):
        damped = (hessian + np.diag(damping * scale))[np.ix_(free, free)]
        step = np.zeros_like(x)
        step[free] = -np.linalg.solve(damped, gradient[free])
        predicted = -float(gradient @ step + 0.5 * step @ hessian @ step)
        if predicted < FLAT:
            break
        step *= min(1.0, LARGEST_STEP / float(np.abs(step).max()))
        ahead = problem.modelled(np.clip(x + BEND_STEP * step, low, high))
        bend = [
            2.0 / BEND_STEP * ((np.log(a) - m) / BEND_STEP - j @ step)
            for a, m, j in zip(ahead, flat, jacobians, strict=True)
        ]
        correction = np.zeros_like(x)
        push = sum(w.T @ b for w, b in zip(weighted, bend, strict=True))
        correction[free] = -0.5 * np.linalg.solve(damped, push[free])
        if 2.0 * np.linalg.norm(correction) <= MOST_BEND * np.linalg.norm(step):
            trial = np.clip(x + step + correction, low, high)
            value = problem.value(problem.modelled(trial)) + problem.penalty()
            if value <= loss:
                new_x, new_loss, damping = trial, value, max(damping / 10.0, 1e-12)
                break
        damping *= growth
        growth *= 2.0  # far from the minimum the damping may have to rise by many decades
    state = _better(state, new_x, new_loss)
    return replace(
        state,
        damping=min(damping, 1e6),
        iteration=state.iteration + 1,
        since_start=state.since_start + 1,
        arrived=predicted < FLAT or new_x is x,  # float32 images tell no lower point
    )


def eased(rate: float, iteration: int) -> float:
    """Adam's step at an iteration: `rate` at first, then falling as 1 / sqrt(iteration)."""
    return float(rate / np.sqrt(1.0 + iteration / SETTLING))


class Adam:
    """warp.optim.Adam on the whole of x, with bounds; on CUDA the image, loss and gradient are one captured graph."""

    def __init__(self, problem: FitProblem, state: FitState, rate: float) -> None:
        import warp as wp
        from warp.optim import Adam as WarpAdam

        self.problem, self.rate = problem, rate
        self.x: Any = wp.array(state.x.astype(np.float32), dtype=float, device=problem.device)
        self.gradient = wp.zeros_like(self.x)
        self.optimiser = WarpAdam([self.x], lr=rate)
        if state.first_moment is not None:
            self.optimiser.m[0].assign(state.first_moment)
            self.optimiser.v[0].assign(state.second_moment)
            self.optimiser.t = state.since_start

    def step(self, state: FitState) -> FitState:
        """One iteration."""
        problem = self.problem
        x = self.x.numpy().astype(float)
        loss, gradient = problem.gradient(x)
        self.gradient.assign(gradient.astype(np.float32))
        self.optimiser.lr = eased(self.rate, state.since_start)
        self.optimiser.step([self.gradient])
        low, high = problem.bounds
        moved = np.clip(self.x.numpy(), low.astype(np.float32), high.astype(np.float32))
        self.x.assign(moved)
        state = _better(state, x, loss)
        recent = np.append([] if state.recent is None else state.recent, state.best_loss)[-PLATEAU_WINDOW - 1 :]
        gained = (recent[0] - recent[-1]) / max(abs(recent[-1]), 1e-300)
        return replace(
            state,
            x=moved.astype(float),
            first_moment=self.optimiser.m[0].numpy(),
            second_moment=self.optimiser.v[0].numpy(),
            recent=recent,
            iteration=state.iteration + 1,
            since_start=state.since_start + 1,
            arrived=recent.size > PLATEAU_WINDOW and gained < PLATEAU_GAIN,
        )


class GraphAdam:
    """Adam where nothing leaves the CUDA device: image, loss and gradients of all views replayed as one captured
    graph, then warp.optim's update, for `STRIDE` iterations between two looks at the loss."""

    STRIDE = 10

    def __init__(self, problem: FitProblem, state: FitState, rate: float) -> None:
        import warp as wp
        from warp.optim import Adam as WarpAdam

        self.problem, self.rate = problem, rate
        device = problem.device
        self.nodes = problem.shared_nodes
        self.nodes.assign(problem.nodes(state.x).astype(np.float32))
        kept = np.zeros(self.nodes.size, np.float32)
        kept[problem.learned] = 1.0
        low, high = np.full(kept.size, -np.inf, np.float32), np.full(kept.size, np.inf, np.float32)
        low[problem.learned], high[problem.learned] = problem.bounds
        self.kept: Any = wp.array(kept, dtype=float, device=device)
        self.low: Any = wp.array(low, dtype=float, device=device)
        self.high: Any = wp.array(high, dtype=float, device=device)
        self.gradient = wp.zeros_like(self.nodes, requires_grad=False)
        self.optimiser = WarpAdam([self.nodes], lr=rate)
        if state.first_moment is not None:
            self.optimiser.m[0].assign(state.first_moment)
            self.optimiser.v[0].assign(state.second_moment)
            self.optimiser.t = state.since_start
        self._iterate()  # loads every kernel, which a capture cannot
        with wp.ScopedCapture(device) as capture:
            self._iterate()
        self.graph = capture.graph

    def _iterate(self) -> None:
        import warp as wp

        from warpsar.kernels import loss as kernels

        self.problem.run_on_device()
        wp.launch(
            kernels.keep_kernel,
            self.nodes.size,
            inputs=[self.kept, self.nodes.grad],
            outputs=[self.gradient],
            device=self.problem.device,
        )

    def step(self, state: FitState) -> FitState:
        """`STRIDE` iterations; the loss is that of the last one."""
        import warp as wp

        from warpsar.kernels import loss as kernels

        x = state.x
        for turn in range(self.STRIDE):
            wp.capture_launch(self.graph)
            if turn == self.STRIDE - 1:
                loss = self.problem.loss_on_device()
                x = self.nodes.numpy()[self.problem.learned].astype(float)
            self.optimiser.lr = eased(self.rate, state.since_start + turn)
            self.optimiser.step([self.gradient])
            wp.launch(
                kernels.clamp_kernel,
                self.nodes.size,
                inputs=[self.low, self.high],
                outputs=[self.nodes],
                device=self.problem.device,
            )
        state = _better(state, x, loss)
        recent = np.append([] if state.recent is None else state.recent, state.best_loss)
        recent = recent[-PLATEAU_WINDOW // self.STRIDE - 1 :]
        gained = (recent[0] - recent[-1]) / max(abs(recent[-1]), 1e-300)
        return replace(
            state,
            x=self.nodes.numpy()[self.problem.learned].astype(float),
            first_moment=self.optimiser.m[0].numpy(),
            second_moment=self.optimiser.v[0].numpy(),
            recent=recent,
            iteration=state.iteration + self.STRIDE,
            since_start=state.since_start + self.STRIDE,
            arrived=recent.size > PLATEAU_WINDOW // self.STRIDE and gained < PLATEAU_GAIN,
        )
