"""A scene's views and measured images as one function of the parameters that may change.

Both optimisers, the Fisher information and the diagnosis work on it. `coordinates.py` says what x is, `held.py` which
views a process holds, `view.py` what one view is, `misfit.py` what the loss is.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np
import warp as wp
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, hstack

from warpsar.compare.observation import Observation
from warpsar.effects.base.effect import DeclaredEffect
from warpsar.effects.registry import values_in
from warpsar.errors import InputError
from warpsar.kernels import loss as loss_kernels
from warpsar.kernels import metrics as metrics_kernels
from warpsar.learning.coordinates import DeviceX, EffectCoordinate, SceneCoordinates
from warpsar.learning.device_values import DeviceValues
from warpsar.learning.held import views_held, with_render
from warpsar.learning.misfit import Misfit
from warpsar.learning.prior import Beside, DevicePrior, Prior, refuse_prior
from warpsar.learning.roughness import FieldPrior, Roughness, TotalVariation
from warpsar.learning.view import FitView, Move, Nodes, ViewJacobian
from warpsar.render.render import ViewRender
from warpsar.render.rendered import Rendered
from warpsar.runtime import once, threads
from warpsar.runtime.devices import load_kernels
from warpsar.runtime.structs import assign
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.speckle.likelihood import Curvature
from warpsar.surface.stage import Stage
from warpsar.world.tables import View
from warpsar.world.world import lacks_images

MOST = 16  # streams on one device


class Streams:
    """CUDA streams that are made when first needed and kept.

    One small view does not fill the device, and its arithmetic idles while memory is cleared. `views`: how many there
    are, for two streams each.
    """

    def __init__(self, device: wp.Device, views: int) -> None:
        self._device, self._count = device, min(2 * views, MOST)
        self._streams: list[wp.Stream] = []

    def run(self, tasks: Sequence[Callable[[], None]]) -> None:
        """Queue the tasks; work that is queued after this waits for all of them."""
        if not self._streams:
            self._streams = [wp.Stream(self._device) for _ in range(self._count)]
        for task, stream in zip(tasks, itertools.cycle(self._streams), strict=False):
            with wp.ScopedStream(stream):  # which waits for what came before
                task()
        for stream in self._streams[: len(tasks)]:
            wp.wait_stream(stream)


T = TypeVar("T")

DIFFERENCE_STEP = 1e-2  # of a log coordinate: truncation and float32 rounding both stay near 1e-4 of a derivative


class FitProblem(SceneCoordinates):
    """Views of the given roles, traced and observed, and everything that a fit may ask of them.

    `total_variation`: weight per parameter key, in log-likelihood per unit of log difference. `validity`: weight of
    the models' domains as soft constraints (corrected equations 9, 12, 19).
    `views` names the views that are used. `rays` and `observations` (by view name) are shared with other problems, so
    that models are compared on the same rays and pixels. Raises InputError for views without measured images and for
    parameters that cannot be learned.

    Where they are `shared`, each process of the run holds some of the views. `views`, `observations`, `modelled` and
    whatever is per observation belong to this process alone; sums and x belong to all views (`chosen`). `over_views`
    makes a sum over `observations` one over all views.
    `bound` is that of the gamma loss (`speckle.likelihood.bounded`). `roughness` is expected of the learned fields.
    `values`: tables and learned terms that are a part of x. `beside` makes of x what was measured beside the images.
    `max_memory_gib` bounds what the hits of this process's views take (by default `memory.default_gib`). Views beyond
    it are traced again, in bands, whenever their image is needed; `bands` has their number by view name.
    """

    def __init__(
        self,
        scene: Scene,
        device: wp.Device,
        *,
        loss: str = "gamma",
        roles: Sequence[str] = ("train",),
        views: Sequence[str] | None = None,
        rays: Rays | None = None,
        total_variation: Mapping[str, float] | None = None,
        validity: float = 0.0,
        observations: Mapping[str, list[Observation]] | None = None,
        shared: bool = False,
        max_memory_gib: float | None = None,
        bound: float = 0.0,
        roughness: Roughness | None = None,
        values: DeviceValues | None = None,
        beside: Callable[[SceneCoordinates], Beside] | None = None,
    ) -> None:
        chosen = [v for v in scene.views if v.role in roles and v.images and (views is None or v.name in views)]
        if not chosen:
            raise lacks_images(scene, *roles)
        super().__init__(scene, chosen, values)
        self.prior = Prior.of(self)
        if beside is not None:
            self.prior = Prior(self.prior.known, self.x0.size, self.prior.standard, beside(self))
        if roughness is not None:
            self.prior = FieldPrior(self.prior.known, self.x0.size, roughness, self.prior.standard)
        refuse_prior(self.prior, loss, scene.name)
        self.device, self.loss = device, loss
        self._sharing = sharing = once.join(device) if shared else once.ALONE
        rays = rays or Rays(Stage.of(scene, device), seed=scene.sampling.seed)
        self.stage = self.values.on(replace(rays.stage, surface=self.surface))
        mine, self.bands = views_held(scene, chosen, rays, sharing, max_memory_gib)
        self.misfit = Misfit(loss, self._mean_square(mine), scene.grid.calibrated, bound)
        # CUDA: all views read and differentiate one array; CPU: a copy each, so that threads never share a gradient
        self.shared_nodes: wp.array | None = (
            None if device.is_cpu else wp.zeros(self.surface.nodes.size, dtype=float, device=device, requires_grad=True)
        )
        given = observations or {}
        self._stages: dict[str, Stage] = {}  # of the views

        def opened(view: View) -> FitView:
            def use(render: Rendered, effects: list[DeclaredEffect]) -> FitView:
                return FitView(scene, view, render, effects, given.get(view.name), self.misfit, validity)

            stage = self.values.on(self.stage)  # threads never share a gradient
            self._stages[view.name] = stage
            return with_render(use, scene, stage, rays, view, self.bands.get(view.name), self.shared_nodes)

        self.views: list[FitView] = sharing.agree(lambda: [opened(view) for view in mine])
        # once for all processes
        variation = (total_variation or {}) if sharing.first else {}
        self.variation = TotalVariation(self.surface, scene.mesh, variation, device, self.shared_nodes)
        self.prior_on_device = DevicePrior(self.prior, self, device, counts=sharing.first)
        self._penalised = validity > 0.0 or self.variation.count > 0
        self._linearised: tuple[bytes, list[np.ndarray], list[np.ndarray]] | None = None
        self._standing_values = b""  # the tables and terms on the device
        self._replayed = False  # whether a graph may make images anew without a word
        self.streams = Streams(device, len(self.views))

    def _mean_square(self, mine: Sequence[View]) -> float:
        """Mean square of the measured images of all views: their common scale. Other losses need none."""
        if self.loss != "mse":
            return 1.0
        squares = [np.nanmean(self.scene.measured(v, p).astype(float) ** 2) for v in mine for p in v.images]
        total, count = self._sharing.sum([np.sum(squares), len(squares)])
        return float(total / count)

    def _share(self, x: np.ndarray | DeviceX) -> np.ndarray | None:
        """The nodes that each view must still be given; None where the views read one array, which is filled here.

        Views in bands make their renders anew, and need the nodes on the host.
        """
        if self.values.blocks:
            self._put_values(np.asarray(x)[self.of_values])
        if self.shared_nodes is not None:
            self.fill(self.shared_nodes, x)
            if all(view.render.keeps_hits for view in self.views):
                return None
        return self.float_nodes(x)

    def _put_values(self, z: np.ndarray) -> None:
        """Give all views the tables and terms at z."""
        if z.tobytes() != self._standing_values:
            for stage in (self.stage, *self._stages.values()):
                self.values.put(stage, z)
            self._standing_values = z.tobytes()

    def _values(self, view: FitView, tables: Mapping[str, Mapping[str, Any]]) -> dict[str, np.ndarray]:
        """The values in a view of the parameters of the effects that have a table."""
        effects = [e.effect for e in view.effects if e.effect.name in tables]
        return {one.name: values_in(self.scene, view.view, one, tables[one.name]) for one in effects}

    def _set(self, view: FitView, nodes: np.ndarray | None, tables: Mapping[str, Mapping[str, Any]]) -> None:
        view.render.set_parameters(nodes, self._values(view, tables))

    def _run(self, x: np.ndarray | DeviceX) -> None:
        nodes, tables, surface = self._share(x), self.effect_tables(x), self._surface_at(x)

        def one(view: FitView) -> None:
            self._run_view(view, nodes, self._values(view, tables), surface)

        for _ in threads.ordered([partial(one, view) for view in self.views], self.device):
            pass

    def _surface_at(self, x: np.ndarray | DeviceX) -> bytes | None:
        """What tells the surface from any other; None where images may be made anew without a word."""
        if isinstance(x, DeviceX) or self._replayed:
            return None
        return x[: self.learned.size].tobytes() + x[self.of_values].tobytes()

    def _run_view(
        self,
        view: FitView,
        nodes: np.ndarray | None,
        values: dict[str, np.ndarray],
        surface: bytes | None,
        *,
        gradient: bool = False,
    ) -> None:
        view.render.set_parameters(nodes, values)
        view.run_images(gradient=gradient, at=None if surface is None else (surface, values))

    def modelled(self, x: np.ndarray | DeviceX) -> list[np.ndarray]:
        """beta0 of every observation's interior pixels, before gains; the order of `observations`."""
        self._run(x)
        return self.standing()

    def standing(self) -> list[np.ndarray]:
        """`modelled` of the last run, whether it was for images, losses or a gradient."""
        return [mu for view in self.views for mu in view.modelled()]

    def moments(self, x: DeviceX) -> np.ndarray:
        """Sums over the pixels of every observation before gains, shape (observations, kernels.metrics.SUMS), float64.

        Metrics need no more of `modelled`, and so no image leaves the device.
        """
        self._run(x)
        shape = (len(self.observations), int(metrics_kernels.PARTIALS), int(metrics_kernels.SUMS))
        sums: wp.array = wp.zeros(shape, dtype=wp.float64, device=self.device)
        start = 0
        for view in self.views:
            end = start + len(view.observations)
            view.add_moments([sums[k] for k in range(start, end)])
            start = end
        return np.asarray(sums.numpy()).sum(axis=1)

    def modelled_as_declared(self) -> list[np.ndarray]:
        """`modelled` of the scene exactly as it stands, even where its effects lie outside a fit's bounds."""
        for view in self.views:
            view.run_images()
        return self.standing()

    @property
    def keeps_hits(self) -> bool:
        """Whether the hits of all views are in memory."""
        return not self._sharing.largest(sum(not view.render.keeps_hits for view in self.views))

    @property
    def holds_all(self) -> bool:
        """Whether the views at hand are all of `chosen`, and not a share of them."""
        return self._sharing.alone

    def over_views(self, found: ArrayLike) -> np.ndarray:
        """The sum over all views, float64, of what the views at hand gave; any shape."""
        return self._sharing.sum(found)

    def over_views_on_device(self, found: wp.array) -> None:
        """`over_views` of an array on the device, in place and in the device's stream."""
        self._sharing.sum_on_device(found)

    def decided(self, numbers: ArrayLike) -> np.ndarray:
        """The same numbers for all views' fits: hosts of different kinds may round a solution differently, and all
        must go the same way."""
        return self._sharing.same(numbers)

    def largest(self, value: float) -> float:
        """The largest of what signals or clocks say beside any of the views."""
        return self._sharing.largest(value)

    def of_each(self, about: Callable[[Observation], T]) -> dict[str, T]:
        """What `about` gives (numbers, text, tables of them) for every observation of all views, by "view
        polarization", in order."""
        mine = [(seen.view.name, seen.polarization, about(seen)) for seen in self.observations]
        order = [view.name for view in self.chosen]
        found = sorted(
            (one for part in self._sharing.gather(mine) for one in part), key=lambda one: order.index(one[0])
        )
        return {f"{view} {polarization}": what for view, polarization, what in found}

    def of_all_views(self, found: np.ndarray) -> np.ndarray:
        """What the views at hand gave, shape (n,), with what the others gave: of all views, in no order."""
        return np.concatenate(self._sharing.gather(found))

    @property
    def observations(self) -> list[Observation]:
        return [seen for view in self.views for seen in view.observations]

    def gains(self, modelled: Sequence[np.ndarray]) -> np.ndarray:
        """The best gain of each observation; 1 where the images are calibrated."""
        return np.array([self.misfit.gain(seen, mu) for seen, mu in self._pairs(modelled)])

    def curvatures(self, modelled: Sequence[np.ndarray]) -> list[Curvature]:
        """Residuals and weights of every observation, at its best gain."""
        return [self.misfit.curvature(seen, mu) for seen, mu in self._pairs(modelled)]

    def terms(self, modelled: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The loss of every pixel of each observation, float64, before its weight, at its best gain."""
        return [self.misfit.terms(seen, mu) for seen, mu in self._pairs(modelled)]

    def value(self, modelled: Sequence[np.ndarray]) -> float:
        """The loss, float64, from modelled pixels (without penalties)."""
        pairs = self._pairs(self.terms(modelled))
        return float(self._sharing.sum(sum(self.misfit.weight(seen) * float(terms.sum()) for seen, terms in pairs)))

    def _pairs(self, values: Sequence[np.ndarray]) -> list[tuple[Observation, np.ndarray]]:
        return list(zip(self.observations, values, strict=True))

    def gradient(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """The loss (float64 sums) with the prior, and its gradient to x by the tape's adjoint, shape (p,).

        Gains are at their best, so by the envelope theorem they add nothing to the gradient.
        """
        self._run_with_losses(x, gradient=True)
        surface = self._surface_gradient(x)
        loss = self.loss_on_device()
        rest = np.concatenate([self.effect_slopes(x), *self._value_slopes()])
        whole = np.concatenate([surface, self._sharing.sum(rest)]) if x.size > surface.size else surface
        return loss + self.prior.value(x), whole + self.prior.gradient(x)

    def _surface_gradient(self, x: np.ndarray) -> np.ndarray:
        """The part of the gradient that belongs to the learned nodes, over all views, float64."""
        if self.shared_nodes is not None:
            self.streams.run([view.render.program.zero_gradients for view in self.views])
            self._add_gradients(self.shared_nodes)
            self._sharing.sum_on_device(self.shared_nodes.grad)
            return np.asarray(self.shared_nodes.grad.numpy()[self._learned].astype(float))
        variation = self.variation
        parts = [view.render.nodes.grad for view in self.views]
        if variation.count:
            self._run_variation(x)
            variation.program.backward({variation.loss: 1.0})
            parts.append(variation.nodes.grad)
        surface = parts[0].numpy()[self._learned].astype(float) if parts else np.zeros(self.learned.size)
        for part in parts[1:]:
            surface += part.numpy()[self._learned]
        return self._sharing.sum(surface)

    def effect_slopes(self, x: np.ndarray) -> np.ndarray:
        """The derivative of this process's loss to the effects' part of x, after a backward run of each view."""
        places = zip(self.effect_coordinates, x[self.of_effects], strict=True)
        return np.array([self._effect_slope(c, at) for c, at in places], float)

    def _value_slopes(self) -> list[np.ndarray]:
        """The derivative of this process's loss to the coordinates of tables and terms, after a backward run of each
        view; nothing without any."""
        if not self.values.blocks:
            return []
        slopes = (self.values.slope(self._stages[view.view.name]) for view in self.views)
        return [sum(slopes, np.zeros(self.values.start.size))]

    def _effect_slope(self, c: EffectCoordinate, at: float) -> float:
        """The derivative of this process's loss to one effect's coordinate."""
        slopes = {
            view.view.name: float(view.render.effect_values[c.effect].grad.numpy()[c.index]) for view in self.views
        }
        slope = sum(slopes.values()) if c.view is None else slopes.get(c.view, 0.0)
        if c.view is not None and c.declared.zero_sum:
            views = self.zero_sums.get((c.effect, c.key))
            many = len(self.scene.views if views is None else views)  # that the mean is taken over
            slope -= sum(slopes.get(view, 0.0) for view in views or slopes) / many
        return slope * float(c.declared.slope(at))

    def loss_at(self, x: np.ndarray) -> float:
        """The loss at x with its penalties, as `gradient` gives it, at the cost of the images alone."""
        self._run_with_losses(x, gradient=False)
        if self.variation.count:
            self._run_variation(x)
        return self.loss_on_device() + self.prior.value(x)

    def _run_with_losses(self, x: np.ndarray, *, gradient: bool) -> None:
        """Images, and losses at their best gains.

        With `gradient` also what it needs, and the gradient of each view whose nodes are its own.
        """
        nodes, tables = self._share(x), self.effect_tables(x)
        calibrated = self.scene.grid.calibrated

        def one(view: FitView) -> None:
            self._set(view, nodes, tables)
            if calibrated:
                view.forward(gradient=gradient)
            else:
                view.run_images()
                pairs = zip(view.observations, view.modelled(), strict=True)
                assign(view.gain, np.array([self.misfit.gain(seen, mu) for seen, mu in pairs]))
                view.forward(gradient=gradient)
            if gradient and self.shared_nodes is None:
                view.backward()

        for _ in threads.ordered([partial(one, view) for view in self.views], self.device):
            pass

    def _run_variation(self, x: np.ndarray) -> None:
        if self.shared_nodes is None:
            self.variation.nodes.assign(self.float_nodes(x))
        self.variation.program.forward()

    def _add_gradients(self, nodes: wp.array) -> None:
        """The adjoint of every view, and of total variation, into the gradient of the shared `nodes`."""
        nodes.grad.zero_()
        self.streams.run([partial(view.backward, zero=False) for view in self.views])
        if self.variation.count:
            self.variation.program.forward()
            self.variation.program.backward({self.variation.loss: 1.0}, zero=False)

    def run_on_device(self) -> None:
        """Images, losses and gradient for the nodes as they stand in `shared_nodes`, on a CUDA device.

        Nothing is copied to the host, so that a CUDA graph can capture it. The gradient of the views
        at hand is left in `shared_nodes.grad`.
        """
        assert self.shared_nodes is not None
        self._replayed = True
        clearing = [view.render.program.zero_gradients for view in self.views]
        self.streams.run([partial(view.forward, gradient=True) for view in self.views] + clearing)
        self._add_gradients(self.shared_nodes)
        self.prior_on_device.run(self.shared_nodes)

    def loss_on_device(self) -> float:
        """The loss of the last run with its penalties but the prior, from the kernels' float64 partial sums."""
        if self.device.is_cuda:
            total = wp.zeros(1, dtype=wp.float64, device=self.device)
            self.add_losses(total)
            return float(self._sharing.sum(total.numpy()[0]))
        return float(self._sharing.sum(sum(float(loss.numpy().sum()) for loss in self._losses())))

    def add_losses(self, total: wp.array) -> None:
        """Add the loss of the last run of this process's views, with its penalties but the prior, to `total`.

        `total` has shape (1,), float64, on the device. Nothing is copied to the host, so that a CUDA graph can capture
        it.
        """
        self.streams.run([partial(self.add_up, loss, total) for loss in self._losses()])

    def add_up(self, parts: wp.array, total: wp.array) -> None:
        """Add partial sums to `total`; both are float64, on the device."""
        wp.launch(loss_kernels.add_up_kernel, parts.size, inputs=[parts], outputs=[total], device=self.device)

    def _losses(self) -> list[wp.array]:
        """Partial sums of the last run."""
        return [*(loss for view in self.views for loss in (view.loss, view.outside)), self.variation.loss]

    def penalty(self, x: np.ndarray) -> float:
        """The prior at x, and the validity constraints' part of the last run (uniform materials have no variation)."""
        outside = float(self._sharing.sum(sum(float(view.outside.numpy().sum()) for view in self.views)))
        return outside + self.prior.value(x)

    @cached_property
    def slopes_tell_all(self) -> bool:
        """Whether `linearised` holds all of the loss's gradient, and costs little more than it."""
        return not self._sharing.largest(float(self._makers is None or self._penalised))

    def linearised(self, x: np.ndarray, moving: np.ndarray | None = None) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """`modelled` and `jacobian` at x; columns are 0 where `moving`, shape (p,), is false.

        The last ones are kept: asked for at the same x again, they cost nothing.
        """
        key = x.tobytes() + (b"" if moving is None else moving.tobytes())
        if self._linearised is None or self._linearised[0] != key:
            columns = np.arange(x.size) if moving is None else np.flatnonzero(moving)
            modelled, parts = self._modelled_and_jacobian(x, columns.tolist())
            found = parts
            if columns.size < x.size:
                found = [np.zeros((x.size, part.shape[0])).T for part in parts]
                for whole, part in zip(found, parts, strict=True):
                    whole[:, columns] = part
            self._linearised = key, modelled, found
        return self._linearised[1:]

    def jacobian(self, x: np.ndarray, columns: Sequence[int] | None = None) -> list[np.ndarray]:
        """d ln(mu) / dx of every observation, shape (pixels, len(columns)), float64.

        Columns of surface nodes are exact (render/tangents.py), those of effects' parameters central differences of the
        images. All are such differences where the hits are not at hand. Where gains are unknown their tangent is
        projected out, in the weights of the loss.
        """
        return self._modelled_and_jacobian(x, list(range(x.size) if columns is None else columns))[1]

    def _modelled_and_jacobian(
        self, x: np.ndarray, columns: Sequence[int]
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        makers = self._makers
        if makers is None:
            modelled, found = self.modelled(x), self._differences(x, columns)
        else:
            modelled, found = self._forward_mode(makers, x, columns)
        if not self.scene.grid.calibrated:
            weights = [c.weight for c in self.curvatures(modelled)]
            found = [j - np.average(j, axis=0, weights=w) for j, w in zip(found, weights, strict=True)]
        return modelled, found

    @cached_property
    def _makers(self) -> list[ViewJacobian] | None:
        """What makes each view's Jacobian; None where a view's hits are not at hand."""
        renders = [view.render for view in self.views]
        whole = [render for render in renders if isinstance(render, ViewRender)]
        if len(whole) < len(renders):
            return None
        load_kernels(self.device, "tangents")
        return [ViewJacobian(view, render) for view, render in zip(self.views, whole, strict=True)]

    def _ends(self, x: np.ndarray, column: int) -> tuple[np.ndarray, np.ndarray]:
        """x with an element moved up and down, inside the bounds."""
        (low, high), up, down = self.bounds, x.copy(), x.copy()
        up[column] = min(x[column] + DIFFERENCE_STEP, high[column])
        down[column] = max(x[column] - DIFFERENCE_STEP, low[column])
        return up, down

    def _differences(self, x: np.ndarray, columns: Sequence[int]) -> list[np.ndarray]:
        found = [np.zeros((len(columns), seen.count)) for seen in self.observations]
        for place, column in enumerate(columns):
            up, down = self._ends(x, column)
            above, below = self.modelled(up), self.modelled(down)
            for rows, a, b in zip(found, above, below, strict=True):
                rows[place] = np.log(a / b) / (up[column] - down[column])
        return [rows.T for rows in found]

    def _forward_mode(
        self, makers: Sequence[ViewJacobian], x: np.ndarray, columns: Sequence[int]
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Modelled beta0 and Jacobian of every observation."""
        shared, tables, surface = self._share(x), self.effect_tables(x), self._surface_at(x)
        places = [place for place, column in enumerate(columns) if column < self.learned.size]
        nodes = Nodes(np.array(places, int), self.learned[[columns[place] for place in places]])
        moved = []
        for place, column in enumerate(columns):
            if self.of_effects.start <= column < self.of_effects.stop:
                up, down = self._ends(x, column)
                ends, width = (self.effect_tables(up), self.effect_tables(down)), up[column] - down[column]
                moved.append((place, self.effect_coordinates[column - self.of_effects.start], ends, width))
        z = x[self.of_values]
        of_values = [(place, c - self.of_values.start) for place, c in enumerate(columns) if c >= self.of_values.start]

        def one(view: FitView, maker: ViewJacobian) -> tuple[list[np.ndarray], list[np.ndarray]]:
            values = self._values(view, tables)
            self._run_view(view, shared, values, surface, gradient=bool(places))
            moves = []
            for place, c, ends, width in moved:
                if c.view in (None, view.view.name) or c.declared.zero_sum:
                    up, down = (self._values(view, {c.effect: end[c.effect]}) for end in ends)
                    moves.append(Move(place, up, down, width))
            found = maker.dense(values, nodes, moves, len(columns))
            for where, own in zip(found[1], maker.to_values(self.values, z) if of_values else (), strict=False):
                for place, element in of_values:
                    where[:, place] = own[:, element]
            return found

        tasks = [partial(one, view, maker) for view, maker in zip(self.views, makers, strict=True)]
        found = list(threads.ordered(tasks, self.device))
        return [mu for mus, _ in found for mu in mus], [j for _, js in found for j in js]

    def by_kind(
        self, x: np.ndarray, kinds_of: Callable[[FitView, ViewRender], tuple[T, np.ndarray, int]]
    ) -> list[tuple[T, list[np.ndarray]]] | None:
        """What `kinds_of` finds in each view at x, and d ln(mu) of its observations by the logarithm of the power of
        each kind of sample, shape (pixels, kinds + 1), float64; the last is that of ways over several surfaces.

        `kinds_of` also gives the kind of each shading sample, -1 for none, and their number. None where the hits of all
        views are not at hand. Gains are not projected out.
        """
        if self._makers is None or not self.holds_all:
            return None
        shared, tables = self._share(x), self.effect_tables(x)

        def one(view: FitView, maker: ViewJacobian) -> tuple[T, list[np.ndarray]]:
            self._set(view, shared, tables)
            view.run_images()
            return maker.by_kind(kinds_of)

        tasks = [partial(one, view, maker) for view, maker in zip(self.views, self._makers, strict=True)]
        return list(threads.ordered(tasks, self.device))

    def sparse_jacobian(self, x: np.ndarray, *, near: bool = False) -> list[csr_array]:
        """d ln(mu) / dx of the surface's nodes, for every observation: shape (pixels, p), float64.

        It is for fields: a node touches few pixels, so memory and time grow with the hits, not with pixels times
        nodes. Paths of several bounces count too. The last columns, of effects' parameters, are empty. Gains are not
        projected out.

        An effect of the image stage acts on each column in turn: exactly if it is affine, as in `jacobian` otherwise.
        Elements whose beta0 is below 1e-6 of a column's largest are then left out. A blur makes columns longer, and a
        median pivot (saturation) makes them dense. `near`: such an effect scales each pixel as it does when the whole
        image grows. Raises InputError where the hits are not at hand (max_memory_gib).
        """
        makers = self._makers
        if makers is None:
            raise InputError(
                f"{self.scene.name}: a sparse Jacobian needs the hits of all views at hand; allowed is a larger "
                f"--max-memory"
            )
        shared, tables = self._share(x), self.effect_tables(x)
        rest = x.size - self.learned.size

        def one(view: FitView, maker: ViewJacobian) -> list[csr_array]:
            self._set(view, shared, tables)
            return [
                csr_array(hstack([j, csr_array((j.shape[0], rest))])) if rest else j
                for j in maker.sparse(self.learned, near=near)
            ]

        tasks = [partial(one, view, maker) for view, maker in zip(self.views, makers, strict=True)]
        return [j for js in threads.ordered(tasks, self.device) for j in js]
