"""Adam: steps of a fixed length along a smoothed gradient."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp

from warpsar.kernels import adam as kernels
from warpsar.learning.optimise import FitState, improved
from warpsar.learning.problem import FitProblem

PLATEAU_WINDOW, PLATEAU_GAIN = 50, 1e-5  # a smaller relative gain of the best loss over so many iterations ends a run
SETTLING = 30.0  # iterations after which the step shrinks: a constant one rattles in total variation's kinks


def eased(rate: float, iteration: int) -> float:
    """Adam's step at an iteration: `rate` at first, then falling as 1 / sqrt(iteration)."""
    return float(rate / np.sqrt(1.0 + iteration / SETTLING))


def counted(state: FitState, iterations: int) -> FitState:
    """`state` after `iterations` more: it has arrived where the best loss has reached a plateau."""
    window = PLATEAU_WINDOW // iterations
    recent = np.append([] if state.recent is None else state.recent, state.best_loss)[-window - 1 :]
    gained = (recent[0] - recent[-1]) / max(abs(recent[-1]), 1e-300)
    return replace(
        state,
        recent=recent,
        iteration=state.iteration + iterations,
        since_start=state.since_start + iterations,
        arrived=recent.size > window and gained < PLATEAU_GAIN,
    )


class Adam:
    """warp.optim.Adam on the whole of x, with bounds, driven from the host (Kingma and Ba, arXiv:1412.6980)."""

    def __init__(self, problem: FitProblem, state: FitState, rate: float) -> None:
        from warp.optim import Adam as WarpAdam

        self.problem, self.rate = problem, rate
        self.x: wp.array = wp.array(state.x.astype(np.float32), dtype=float, device=problem.device)
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
        return replace(
            counted(improved(state, x, loss), 1),
            x=moved.astype(float),
            first_moment=self.optimiser.m[0].numpy(),
            second_moment=self.optimiser.v[0].numpy(),
        )


class GraphAdam:
    """Adam on a CUDA device: nothing leaves it but the loss, which is looked at once in `STRIDE` iterations.

    Images, loss and gradients of all views and the update are one captured graph that is replayed. Where the
    views are shared there are two graphs, and the gradients are summed over all views between them.
    """

    STRIDE = 10

    def __init__(self, problem: FitProblem, state: FitState, rate: float) -> None:
        self.problem, self.rate = problem, rate
        device = problem.device
        assert problem.shared_nodes is not None
        self.nodes = problem.shared_nodes
        start = problem.nodes(np.asarray(state.x)).astype(np.float32)
        low, high = start.copy(), start.copy()
        low[problem.learned], high[problem.learned] = problem.bounds

        def put(values: np.ndarray, dtype: type = float) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        self.nodes.assign(start)
        self.low, self.high = put(low), put(high)
        self.first, self.second = (wp.zeros_like(self.nodes, requires_grad=False) for _ in range(2))
        if state.first_moment is not None:
            self.first.assign(state.first_moment)
            self.second.assign(state.second_moment)
        self.done, self.size = put(np.array([state.since_start]), int), put(np.zeros(2))
        self.loss = put(np.zeros(1), wp.float64)
        self.seen, self.spare = (wp.zeros_like(self.first) for _ in range(2))
        problem.run_on_device()  # loads every kernel, which a capture cannot
        problem.add_losses(self.loss)
        wp.load_module(kernels, device=device)
        alone = problem.holds_all
        self.graphs = []
        for tasks in [(problem.run_on_device, self._update)] if alone else [(problem.run_on_device,), (self._update,)]:
            with wp.ScopedCapture(device) as capture:
                for task in tasks:
                    task()
            self.graphs.append(capture.graph)
        with wp.ScopedCapture(device) as capture:
            self.loss.zero_()
            problem.add_losses(self.loss)
            if problem.prior_on_device.count:
                problem.add_up(problem.prior_on_device.loss, self.loss)
        self.look = capture.graph

    def _update(self) -> None:
        device = self.problem.device
        wp.launch(kernels.tick_kernel, 1, inputs=[self.rate, SETTLING], outputs=[self.done, self.size], device=device)
        wp.launch(
            kernels.adam_kernel,
            self.nodes.size,
            inputs=[self.nodes.grad, self.size, self.low, self.high],
            outputs=[self.first, self.second, self.nodes],
            device=device,
        )

    def iterate(self) -> None:
        """One iteration; the host does not wait for it."""
        wp.capture_launch(self.graphs[0])
        for graph in self.graphs[1:]:
            self.problem.over_views_on_device(self.nodes.grad)
            wp.capture_launch(graph)

    def step(self, state: FitState) -> FitState:
        """`STRIDE` iterations; the loss is taken at the last one."""
        problem = self.problem
        for _ in range(self.STRIDE - 1):
            self.iterate()
        wp.copy(self.seen, self.nodes)
        self.iterate()
        wp.capture_launch(self.look)
        problem.over_views_on_device(self.loss)
        loss = float(self.loss.numpy()[0])  # the same to the bit wherever views are; nothing else waits for the device
        better = loss < state.best_loss
        state = improved(state, problem.on_device(self.seen), loss)
        if better:
            self.seen, self.spare = self.spare, self.seen
        return replace(
            counted(state, self.STRIDE),
            x=problem.on_device(self.nodes),
            first_moment=self.first,
            second_moment=self.second,
        )
