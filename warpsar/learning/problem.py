"""A scene's views and measured images as one function of the parameters that may change.

The vector x holds, in this order, the learned surface nodes (ln(eps_r - 1), ln h, ln l, logit tau) and the fit
coordinates of the declared effects' parameters. Both optimisers, the Fisher information and the diagnosis work on it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from warpsar.effects.base.effect import DeclaredEffect
from warpsar.effects.base.parameter import Parameter
from warpsar.effects.registry import declared, get, value_in
from warpsar.errors import InputError
from warpsar.kernels import loss as loss_kernels
from warpsar.kernels import metrics as metrics_kernels
from warpsar.learning.observation import Observation, observe
from warpsar.learning.regularise import TotalVariation
from warpsar.render.bands import BandedRender, stretches
from warpsar.render.render import ViewRender
from warpsar.runtime import console, threads
from warpsar.runtime.distributed import ONE, Ranks, deal
from warpsar.runtime.memory import OutOfMemoryError, default_gib, in_parts, kept_bytes, ran_out
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays, effects_grid
from warpsar.speckle.likelihood import LOSSES, Curvature, best_gain, curvature, log_bias, loss_terms, loss_weight
from warpsar.surface.stage import Stage
from warpsar.surface.surface import KINDS, Surface
from warpsar.world.tables import View

STREAMS = 16  # in which views run side by side on one CUDA device
DIFFERENCE_STEP = 1e-2  # of a log coordinate: truncation and float32 rounding both stay near 1e-4 of a derivative


@dataclass(frozen=True)
class EffectCoordinate:
    """One number of x that belongs to an effect: a parameter, in one view only where it is per view."""

    effect: str
    parameter: Parameter
    index: int  # in the effect's array of values
    view: str | None = None

    @property
    def label(self) -> str:
        where = "" if self.view is None else f"[{self.view}]"
        return f"{self.effect}.{self.parameter.name}{where}"


@dataclass(frozen=True)
class DeviceX:
    """x of a problem without effects' parameters, as the whole surface's `nodes` on the device, of which x is
    `learned`; NumPy makes it an array of the host's, float64, where it needs one."""

    nodes: Any
    learned: np.ndarray | slice

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.nodes.numpy()[self.learned], dtype or float)


class FitView:
    """One view: its program, and the measured pixels of each polarization on the device."""

    def __init__(
        self,
        problem: FitProblem,
        view: View,
        render: ViewRender | BandedRender,
        effects: list[DeclaredEffect],
        observations: list[Observation] | None,
    ) -> None:
        scene, device = problem.scene, problem.device
        self.view, self.effects = view, effects
        self.render = render
        if observations is None:
            self.forward()
            observations = [observe(scene, view, pol, self.render.lit(pol)) for pol in view.images]
            if any(e.effect.additive for e in self.effects):
                observations = [seen.with_dark() for seen in observations]
        self.observations = observations
        self._pixels = [(seen.polarization, seen.pixels, seen.darkest) for seen in observations]
        self.gain = wp.ones(len(observations), dtype=float, device=device)
        self.loss = self.render.program.array(int(loss_kernels.PARTIALS), wp.float64, sum_into=True)
        self.outside = wp.zeros(1, dtype=wp.float64, device=device)
        self._seeds = {self.loss: 1.0}
        if problem.validity > 0:
            self.outside = self.render.program.array(int(loss_kernels.PARTIALS), wp.float64, sum_into=True)
            self._seeds[self.outside] = 1.0
            hits = self.kept.shaded
            strength = problem.validity / float(hits.weight.numpy().sum())
            self.render.program.launch(
                loss_kernels.validity_kernel,
                hits.count,
                [hits.geometry.wavenumber, strength, hits.weight, hits.cos_incidence, self.kept.zeta],
                [self.outside],
            )
        self._compared: list[list[Any]] = []
        for index, (seen, (_, pixels, darkest)) in enumerate(zip(observations, self._pixels, strict=True)):
            compared = [
                wp.array(pixels, dtype=int, device=device),
                wp.array(seen.values.astype(np.float32), dtype=float, device=device),
                self.render.images[seen.polarization],
                wp.array(darkest, dtype=float, device=device),
            ]
            self._compared.append(compared)
            self.render.program.launch(
                loss_kernels.loss_kernel,
                pixels.size,
                [
                    LOSSES[problem.loss],
                    *compared,
                    self.gain,
                    index,
                    seen.looks,
                    problem.weight(seen),
                    log_bias(seen.looks),
                ],
                [self.loss],
            )

    def modelled(self) -> list[np.ndarray]:
        """beta0 of the interior pixels, before any gain, of each observation; after a forward run."""
        images = self.render.images
        return [
            np.maximum(images[polarization].numpy()[pixels].astype(float), darkest)
            for polarization, pixels, darkest in self._pixels
        ]

    def add_moments(self, sums: Sequence[Any]) -> None:
        """Add the sums of kernels/metrics.py over each observation's pixels, as `modelled` gives them, to an array of
        `sums` each."""
        for compared, total in zip(self._compared, sums, strict=True):
            size, device = compared[0].size, self.render.program.device
            wp.launch(metrics_kernels.moments_kernel, size, inputs=compared, outputs=[total], device=device)

    @property
    def kept(self) -> ViewRender:
        """The render, of a view whose hits are kept; InputError where they are not."""
        if isinstance(self.render, BandedRender):
            raise InputError(
                f"view {self.view.name}: its hits are needed all at once, and are more than the memory they may take; "
                f"allowed is a larger --max-memory, or no --validity"
            )
        return self.render

    def pieces(self) -> Iterable[ViewRender]:
        """The renders that hold the view's hits: one, after a forward run; or one after the other for each band."""
        return self.render.pieces() if isinstance(self.render, BandedRender) else [self.render]

    def forward(self, *, gradient: bool = False) -> None:
        self.render.program.forward(gradient=gradient)

    def backward(self, *, zero: bool = True) -> None:
        self.render.program.backward(self._seeds, zero=zero)


class FitProblem:
    """Views of the given roles, traced and observed, and everything that a fit may ask of them.

    `total_variation`: weight per parameter key, in log-likelihood per unit of log difference; `validity`: weight of
    the models' domains as soft constraints (corrected equations 9, 12, 19).
    `views` names those of them that are used; `rays` and `observations` (by view name) are shared with other
    problems, so that models are compared on the same rays and pixels. Raises InputError for views without measured
    images and for parameters that cannot be learned.

    Of several `ranks` each holds its own share of the views, dealt by their merged hits: `views`, `observations`,
    `modelled` and whatever is per observation are of this rank alone, sums and x are of all (`chosen`).
    `max_memory_gib` bounds what the hits of this rank's views take (by default `memory.default_gib`): views beyond it
    are traced again, in bands, whenever their image is asked for.
    """

    def __init__(
        self,
        scene: Scene,
        device: Any,
        *,
        loss: str = "gamma",
        roles: Sequence[str] = ("train",),
        views: Sequence[str] | None = None,
        rays: Rays | None = None,
        total_variation: Mapping[str, float] | None = None,
        validity: float = 0.0,
        observations: Mapping[str, list[Observation]] | None = None,
        ranks: Ranks = ONE,
        max_memory_gib: float | None = None,
    ) -> None:
        self.scene, self.device, self.loss, self.validity = scene, device, loss, validity
        self.ranks = ranks
        rays = rays or Rays(Stage.of(scene, device), seed=scene.sampling.seed)
        self.surface = Surface.of(scene)
        self.stage = replace(rays.stage, surface=self.surface)
        chosen = [v for v in scene.views if v.role in roles and v.images and (views is None or v.name in views)]
        if not chosen:
            raise InputError(f"{scene.path}: views: none with role {' or '.join(roles)} has measured images")
        self.chosen = chosen
        mine, self.bands = self._dealt(rays, max_memory_gib)
        squares = [np.nanmean(scene.measured(v, p).astype(float) ** 2) for v in mine for p in v.images]
        total, count = ranks.sum([np.sum(squares), len(squares)])
        self._mean_square = float(total / count)
        # CUDA: all views read and differentiate one array; CPU: a copy each, so that threads never share a gradient
        self.shared_nodes: Any = (
            None if device.is_cpu else wp.zeros(self.surface.nodes.size, dtype=float, device=device, requires_grad=True)
        )
        self.views: list[FitView] = ranks.agree(
            lambda: [self._fit_view(rays, view, (observations or {}).get(view.name)) for view in mine]
        )
        # once for all ranks
        variation = (total_variation or {}) if ranks.first else {}
        self.variation = TotalVariation(self.surface, scene.mesh, variation, device, self.shared_nodes)
        self.learned = self.surface.learned
        self._nodes = self.surface.nodes.astype(np.float32)  # as the device has them
        # the same as one stretch where it is one: a field of a million nodes is several times as fast to take so
        whole = self.learned.size and self.learned[-1] + 1 - self.learned[0] == self.learned.size
        self._learned: Any = slice(self.learned[0], self.learned[-1] + 1) if whole else self.learned
        self.effect_coordinates = self._effect_coordinates()
        self._tables: dict[str, dict[str, Any]] = {name: dict(table) for name, table in scene.effects.items()}
        self._jacobian: tuple[bytes, list[np.ndarray]] | None = None
        self._streams: list[Any] = []
        self.x0 = np.concatenate([self.surface.nodes[self.learned], self._effect_values(self.scene.effects)])
        if not np.isfinite(self.x0).all():
            bad = [self.labels[i] for i in np.flatnonzero(~np.isfinite(self.x0))[:5]]
            raise InputError(
                f"{scene.path}: {', '.join(bad)}: found a dead start (eps_r = 1: no reflection, and every derivative "
                f"is exactly 0); allowed is eps_r >= {KINDS[0].low:g}"
            )

    # Which views are held here, and how

    def _dealt(self, rays: Rays, max_memory_gib: float | None) -> tuple[list[View], dict[str, int]]:
        """The views of this rank, and for those whose hits are not kept the number of bands they are traced in."""
        scene, ranks = self.scene, self.ranks
        effects = {v.name: declared(scene, v, neutral=True) for v in self.chosen}
        budget = (default_gib(self.device) if max_memory_gib is None else max_memory_gib) * 2**30

        def size(view: View, hits: int) -> int:
            return kept_bytes(hits, len(view.images), len(effects[view.name]))

        if ranks.size > 1:
            own = self.chosen[ranks.rank :: ranks.size]
            most = sum(size(v, rays.most_hits(scene, v, effects[v.name])) for v in own)

            def count(view: View) -> int:
                # a GPU takes a column as long as an image
                if self.device.is_cuda and most <= budget:
                    return rays.hits(scene, view, effects[view.name]).count
                return rays.expected_hits(scene, view, effects[view.name])

            counted = ranks.agree(lambda: {v.name: count(v) for v in own})
            hits = {name: count for part in ranks.gather(counted) for name, count in part.items()}
            costs = [hits[v.name] * len(v.images) for v in self.chosen]
            mine = [self.chosen[i] for i in deal(costs, ranks.size)[ranks.rank]]
            for view in own:
                if view not in mine:
                    rays.forget(view)
        else:
            mine = self.chosen
            hits = {v.name: rays.most_hits(scene, v, effects[v.name]) for v in mine}
            if sum(size(v, hits[v.name]) for v in mine) > budget:
                hits = {v.name: rays.expected_hits(scene, v, effects[v.name]) for v in mine}
        banded, left = {}, budget
        for view in sorted(mine, key=lambda v: hits[v.name]):
            taken = size(view, hits[view.name])
            if taken <= left:
                left -= taken
            else:
                # half for the kept ones' sake and the rounding of the estimate
                banded[view.name] = max(2, math.ceil(taken / (budget / 2)))
        if banded:
            console.say(
                f"memory: the hits of {len(banded)} of {len(mine)} views would take more than "
                f"{budget / 2**30:.3g} GiB; they are traced again in every iteration, in up to "
                f"{max(banded.values())} bands"
            )
        return mine, banded

    def _fit_view(self, rays: Rays, view: View, observations: list[Observation] | None) -> FitView:
        scene, effects = self.scene, declared(self.scene, view, neutral=True)
        shape, polarizations = scene.grid.shape, tuple(view.images)
        if view.name not in self.bands:
            try:
                hits = rays.hits(scene, view, effects)
                render = ViewRender(self.stage, view, hits, shape, polarizations, effects, nodes=self.shared_nodes)
                return FitView(self, view, render, effects, observations)
            except (MemoryError, RuntimeError, OutOfMemoryError) as error:
                if not ran_out(error):
                    raise
            rays.forget(view)
            console.say(f"view {view.name}: out of memory for its hits; they are traced again in every iteration")

        def banded(parts: int) -> FitView:
            bands = stretches(effects_grid(scene, effects), self.bands.get(view.name, 2) * parts)
            render = BandedRender(
                self.stage,
                view,
                partial(rays.trace, scene, view, effects),
                bands,
                shape,
                polarizations,
                effects,
                nodes=self.shared_nodes,
            )
            return FitView(self, view, render, effects, observations)

        return in_parts(banded, f"view {view.name}")

    # What x is

    def _effect_coordinates(self) -> list[EffectCoordinate]:
        found = []
        for name, table in self.scene.effects.items():
            for index, parameter in enumerate(get(name).parameters):
                if parameter.name not in table:
                    continue
                if parameter.per_view:
                    names = [v.name for v in self.chosen if v.name in table[parameter.name]]
                    found += [EffectCoordinate(name, parameter, index, view) for view in names]
                else:
                    found.append(EffectCoordinate(name, parameter, index))
        return found

    def _effect_values(self, tables: Mapping[str, Mapping[str, Any]]) -> np.ndarray:
        """The effects' part of x that stands in `tables`."""
        values = []
        for c in self.effect_coordinates:
            value = tables[c.effect][c.parameter.name]
            values.append(c.parameter.to_coordinate(value[c.view] if c.view else value))
        return np.array(values, float)

    def follow(self, other: FitProblem, x: np.ndarray | DeviceX) -> np.ndarray | DeviceX:
        """x of a fit to other views of the scene, as x of these; an effect's numbers of these views alone stay as
        declared."""
        self._tables = other.effect_tables(x)
        if isinstance(x, DeviceX):
            if not self.effect_coordinates:
                return x
            x = np.asarray(x)
        return np.concatenate([x[: other.learned.size], self._effect_values(self._tables)])

    @property
    def labels(self) -> list[str]:
        """A name for every element of x: material.key, with the node's number where there are many."""
        names = []
        for block in self.surface.blocks:
            if block.learn:
                name = f"{block.material}.{block.kind.key}"
                names += [name] if block.size == 1 else [f"{name}[{i}]" for i in range(block.size)]
        return names + [c.label for c in self.effect_coordinates]

    @property
    def uniform(self) -> bool:
        """Whether x is a handful of numbers, not a field."""
        return all(block.size == 1 for block in self.surface.blocks if block.learn)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of x."""
        ends, sizes = [], []
        for block in self.surface.blocks:
            if block.learn:
                ends.append([float(block.kind.to_coordinate(end)) for end in (block.kind.low, block.kind.high)])
                sizes.append(block.size)
        for c in self.effect_coordinates:
            ends.append(sorted(c.parameter.to_coordinate(v) for v in c.parameter.fit_bounds))
            sizes.append(1)
        low, high = np.repeat(np.reshape(ends, (-1, 2)), sizes, axis=0).T
        return low.copy(), high.copy()

    def nodes(self, x: np.ndarray) -> np.ndarray:
        """The whole surface's nodes with x in place, float64."""
        return self._with(x, self.surface.nodes)

    def _with(self, x: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        found = nodes.copy()
        found[self._learned] = x[: self.learned.size]
        return found

    def on_device(self, nodes: Any) -> DeviceX:
        """The x that stands in `nodes`, an array of the device's as long as the whole surface's."""
        return DeviceX(nodes, self._learned)

    def effect_tables(self, x: np.ndarray | DeviceX) -> dict[str, dict[str, Any]]:
        """The tables `[effects.*]` with x in place."""
        tables = {
            name: {k: dict(v) if isinstance(v, dict) else v for k, v in t.items()} for name, t in self._tables.items()
        }
        values = () if isinstance(x, DeviceX) else x[self.learned.size :]
        for c, value in zip(self.effect_coordinates, values, strict=True):
            number = float(c.parameter.from_coordinate(value))
            if c.view is None:
                tables[c.effect][c.parameter.name] = number
            else:
                tables[c.effect][c.parameter.name][c.view] = number
        # only differences act: with no mean over the views that are fitted, those that are not stay as they are
        for (effect, name), views in self._zero_sums().items():
            mean = sum(tables[effect][name][view] for view in views) / len(views)
            for view in views:
                tables[effect][name][view] -= mean
        return tables

    def _zero_sums(self) -> dict[tuple[str, str], list[str]]:
        """Fitted views of every per-view parameter whose values sum to zero; a view by itself is free, beside others
        that are known."""
        found: dict[tuple[str, str], list[str]] = {}
        for c in self.effect_coordinates:
            if c.parameter.zero_sum and c.view is not None:
                found.setdefault((c.effect, c.parameter.name), []).append(c.view)
        return {key: views for key, views in found.items() if len(views) > 1}

    # What x gives

    def _share(self, x: np.ndarray | DeviceX) -> np.ndarray | None:
        """The nodes that views have still to be given: where they read one array it is filled here, once for all. Views
        in bands make their renders anew, and need them on the host."""
        if self.shared_nodes is not None:
            if isinstance(x, DeviceX):
                if x.nodes is not self.shared_nodes:
                    wp.copy(self.shared_nodes, x.nodes)
            else:
                self.shared_nodes.assign(self._with(x, self._nodes))
            if not any(isinstance(view.render, BandedRender) for view in self.views):
                return None
        return self._with(np.asarray(x), self._nodes)

    def _set(self, view: FitView, nodes: np.ndarray | None, tables: Mapping[str, Mapping[str, Any]]) -> None:
        values = {}
        for e in view.effects:
            table = tables[e.effect.name]
            values[e.effect.name] = np.array(
                [value_in(view.view, p, table, self.scene.views) for p in e.effect.parameters], float
            )
        view.render.set_parameters(nodes, values)

    def _run(self, x: np.ndarray | DeviceX) -> None:
        nodes, tables = self._share(x), self.effect_tables(x)

        def one(view: FitView) -> None:
            self._set(view, nodes, tables)
            view.forward()

        for _ in threads.ordered([partial(one, view) for view in self.views], self.device):
            pass

    def modelled(self, x: np.ndarray | DeviceX) -> list[np.ndarray]:
        """beta0 of every observation's interior pixels, before gains; the order of `observations`."""
        self._run(x)
        return [mu for view in self.views for mu in view.modelled()]

    def moments(self, x: DeviceX) -> np.ndarray:
        """Sums over the pixels of every observation before gains, shape (observations, kernels.metrics.SUMS), float64:
        what metrics need of `modelled`, and no image leaves the device for."""
        self._run(x)
        shape = (len(self.observations), int(metrics_kernels.PARTIALS), int(metrics_kernels.SUMS))
        sums: Any = wp.zeros(shape, dtype=wp.float64, device=self.device)
        start = 0
        for view in self.views:
            end = start + len(view.observations)
            view.add_moments([sums[k] for k in range(start, end)])
            start = end
        return np.asarray(sums.numpy()).sum(axis=1)

    def modelled_as_declared(self) -> list[np.ndarray]:
        """`modelled` of the scene exactly as it stands, be its effects within a fit's bounds or not."""
        for view in self.views:
            view.forward()
        return [mu for view in self.views for mu in view.modelled()]

    @property
    def keeps_hits(self) -> bool:
        """Whether every rank holds the hits of all its views."""
        return not self.ranks.largest(sum(isinstance(view.render, BandedRender) for view in self.views))

    @property
    def observations(self) -> list[Observation]:
        return [seen for view in self.views for seen in view.observations]

    def weight(self, seen: Observation) -> float:
        return loss_weight(self.loss, seen.looks, self._mean_square)

    def gains(self, modelled: Sequence[np.ndarray]) -> np.ndarray:
        """The best gain of each observation; 1 where the images are calibrated."""
        pairs = zip(self.observations, modelled, strict=True)
        return np.array([self.gain(seen, mu) for seen, mu in pairs])

    def gain(self, seen: Observation, mu: np.ndarray) -> float:
        return 1.0 if self.scene.grid.calibrated else best_gain(self.loss, seen.values, mu, seen.looks)

    def curvatures(self, modelled: Sequence[np.ndarray]) -> list[Curvature]:
        """Residuals and weights of every observation, at its best gain."""
        gains = self.gains(modelled)
        return [
            curvature(self.loss, seen.values, gain * mu, seen.looks, self.weight(seen))
            for seen, mu, gain in zip(self.observations, modelled, gains, strict=True)
        ]

    def value(self, modelled: Sequence[np.ndarray]) -> float:
        """The loss, float64, from modelled pixels (without penalties)."""
        pairs = zip(self.observations, self.terms(modelled), strict=True)
        return float(self.ranks.sum(sum(self.weight(seen) * float(terms.sum()) for seen, terms in pairs)))

    def terms(self, modelled: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The loss of every pixel of each observation, float64, before its weight, at its best gain."""
        pairs = zip(self.observations, modelled, self.gains(modelled), strict=True)
        return [loss_terms(self.loss, seen.values, gain * mu, seen.looks) for seen, mu, gain in pairs]

    def gradient(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Loss (float64 sums) and its gradient to x, by the tape's adjoint.

        Gains are at their best, so by the envelope theorem they add nothing to the gradient.
        """
        self._run_with_losses(x, gradient=True)
        variation = self.variation
        if self.shared_nodes is not None:
            self._backward_shared()
            self.ranks.sum_on_device(self.shared_nodes.grad)
            surface = self.shared_nodes.grad.numpy()[self._learned].astype(float)
        else:
            parts = [view.render.nodes.grad for view in self.views]
            if variation.count:
                self._run_variation(x)
                variation.program.backward({variation.loss: 1.0})
                parts.append(variation.nodes.grad)
            surface = parts[0].numpy()[self._learned].astype(float) if parts else np.zeros(self.learned.size)
            for part in parts[1:]:
                surface += part.numpy()[self._learned]
            surface = self.ranks.sum(surface)
        loss = self.loss_on_device()
        effects = []
        for c, coordinate in zip(self.effect_coordinates, x[self.learned.size :], strict=True):
            slopes = {
                view.view.name: float(view.render.effect_values[c.effect].grad.numpy()[c.index]) for view in self.views
            }
            slope = sum(slopes.values()) if c.view is None else slopes.get(c.view, 0.0)
            if c.view is not None and c.parameter.zero_sum:
                views = self._zero_sums().get((c.effect, c.parameter.name), [])
                slope -= sum(slopes.get(view, 0.0) for view in views) / max(len(views), 1)
            effects.append(slope * float(c.parameter.slope(coordinate)))
        return loss, np.concatenate([surface, self.ranks.sum(effects)]) if effects else surface

    def loss_at(self, x: np.ndarray) -> float:
        """The loss at x as `gradient` gives it, its penalties in it, for the cost of the images."""
        self._run_with_losses(x, gradient=False)
        if self.variation.count:
            self._run_variation(x)
        return self.loss_on_device()

    def _run_with_losses(self, x: np.ndarray, *, gradient: bool) -> None:
        """Images, and losses at their best gains; with `gradient` what it needs, and where views share no array of
        nodes that of each."""
        nodes, tables = self._share(x), self.effect_tables(x)
        calibrated = self.scene.grid.calibrated

        def one(view: FitView) -> None:
            self._set(view, nodes, tables)
            view.forward(gradient=gradient and calibrated)
            if not calibrated:
                pairs = zip(view.observations, view.modelled(), strict=True)
                view.gain.assign(np.array([self.gain(seen, mu) for seen, mu in pairs], np.float32))
                view.forward(gradient=gradient)
            if gradient and self.shared_nodes is None:
                view.backward()

        for _ in threads.ordered([partial(one, view) for view in self.views], self.device):
            pass

    def _run_variation(self, x: np.ndarray) -> None:
        if self.shared_nodes is None:
            self.variation.nodes.assign(self._with(x, self._nodes))
        self.variation.program.forward()

    def _backward_shared(self) -> None:
        """Adjoint of every view into the one array of nodes they share."""
        self._side_by_side([view.render.program.zero_gradients for view in self.views])
        self._add_gradients()

    def _add_gradients(self) -> None:
        self.shared_nodes.grad.zero_()
        self._side_by_side([partial(view.backward, zero=False) for view in self.views])
        if self.variation.count:
            self.variation.program.forward()
            self.variation.program.backward({self.variation.loss: 1.0}, zero=False)

    def run_images(self) -> None:
        """Images and losses for the nodes as they stand in `shared_nodes`, as `run_on_device` makes them."""
        self._side_by_side([view.forward for view in self.views])

    def run_on_device(self) -> None:
        """Images, losses and gradient for the nodes as they stand in `shared_nodes`; nothing is copied to the host,
        so that a CUDA graph can capture it. The gradient, of this rank's views, is in `shared_nodes.grad`."""
        clearing = [view.render.program.zero_gradients for view in self.views]
        self._side_by_side([partial(view.forward, gradient=True) for view in self.views] + clearing)
        self._add_gradients()

    def _side_by_side(self, tasks: Sequence[Callable[[], None]]) -> None:
        """Independent tasks in CUDA streams of their own: one small view does not fill the device, and clearing memory
        leaves its arithmetic idle."""
        if not self._streams:
            self._streams = [wp.Stream(self.device) for _ in range(min(2 * len(self.views), STREAMS))]
        for task, stream in zip(tasks, itertools.cycle(self._streams), strict=False):
            with wp.ScopedStream(stream):  # which waits for what came before
                task()
        for stream in self._streams[: len(tasks)]:
            wp.wait_stream(stream)

    def loss_on_device(self) -> float:
        """The loss of the last run with its penalties, from the kernels' float64 partial sums."""
        if self.device.is_cuda:
            total = wp.zeros(1, dtype=wp.float64, device=self.device)
            self.add_losses(total)
            return float(self.ranks.sum(total.numpy()[0]))
        return float(self.ranks.sum(sum(float(loss.numpy().sum()) for loss in self._losses())))

    def add_losses(self, total: Any) -> None:
        """Add the loss of the last run of this rank's views, with its penalties, to `total`, shape (1,), float64, on
        the device; nothing is copied to the host, so that a CUDA graph can capture it."""

        def add(loss: Any) -> None:
            wp.launch(loss_kernels.add_up_kernel, loss.size, inputs=[loss], outputs=[total], device=self.device)

        self._side_by_side([partial(add, loss) for loss in self._losses()])

    def _losses(self) -> list[Any]:
        """Partial sums of the last run."""
        return [*(loss for view in self.views for loss in (view.loss, view.outside)), self.variation.loss]

    def penalty(self) -> float:
        """The validity constraints' part of the last run (total variation is zero for uniform materials)."""
        return float(self.ranks.sum(sum(float(view.outside.numpy().sum()) for view in self.views)))

    def jacobian_at(self, x: np.ndarray, moving: np.ndarray | None = None) -> list[np.ndarray]:
        """`jacobian` with a column for all of x, 0 where `moving`, shape (p,), is false; kept until it is asked for
        elsewhere."""
        key = x.tobytes() + (b"" if moving is None else moving.tobytes())
        if self._jacobian is None or self._jacobian[0] != key:
            columns = np.arange(x.size) if moving is None else np.flatnonzero(moving)
            found = [np.zeros((seen.values.size, x.size)) for seen in self.observations]
            for whole, part in zip(found, self.jacobian(x, columns.tolist()), strict=True):
                whole[:, columns] = part
            self._jacobian = key, found
        return self._jacobian[1]

    def jacobian(self, x: np.ndarray, columns: Sequence[int] | None = None) -> list[np.ndarray]:
        """d ln(mu) / dx of every observation, shape (pixels, len(columns)), by central differences of the images.

        Where gains are unknown their tangent is projected out, in the weights of the loss.
        """
        columns = range(x.size) if columns is None else columns
        low, high = self.bounds
        parts: list[list[np.ndarray]] = [[] for _ in self.observations]
        for column in columns:
            up, down = x.copy(), x.copy()
            up[column] = min(x[column] + DIFFERENCE_STEP, high[column])
            down[column] = max(x[column] - DIFFERENCE_STEP, low[column])
            above, below = self.modelled(up), self.modelled(down)
            for part, a, b in zip(parts, above, below, strict=True):
                part.append(np.log(a / b) / (up[column] - down[column]))
        found = [np.stack(part, axis=1) if part else np.zeros((0, 0)) for part in parts]
        if not self.scene.grid.calibrated:
            weights = [c.weight for c in self.curvatures(self.modelled(x))]
            found = [j - np.average(j, axis=0, weights=w) for j, w in zip(found, weights, strict=True)]
        return found
