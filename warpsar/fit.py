"""A scene's views and measured images as one function of the parameters that may change.

The vector x holds, in this order, the learned surface nodes (ln(eps_r - 1), ln h, ln l, logit tau) and the fit
coordinates of the declared effects' parameters. Both optimisers, the Fisher information and the diagnosis work on it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar import runtime
from warpsar.effects import declared, get, value_in
from warpsar.errors import InputError
from warpsar.likelihood import LOSSES, Curvature, best_gain, curvature, log_bias, loss_terms, loss_weight
from warpsar.observation import Observation, observe
from warpsar.regularise import TotalVariation
from warpsar.render import Stage, ViewRender
from warpsar.simulation import Rays
from warpsar.surface import KINDS, Surface

if TYPE_CHECKING:
    from warpsar.effects.base import Parameter
    from warpsar.scene import Scene, View
    from warpsar.trace import Hits

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


class FitView:
    """One view: its program, and the measured pixels of each polarization on the device."""

    def __init__(self, problem: FitProblem, view: View, hits: Hits, observations: list[Observation] | None) -> None:
        import warp as wp

        from warpsar.kernels import loss as kernels

        scene, device = problem.scene, problem.device
        self.view = view
        self.effects = declared(scene, view, neutral=True)
        shared = problem.shared_nodes
        self.render = ViewRender(
            problem.stage, view, hits, scene.grid.shape, tuple(view.images), self.effects, nodes=shared
        )
        if observations is None:
            self.forward()
            observations = [observe(scene, view, pol, self.render.lit(pol)) for pol in view.images]
            if any(e.effect.additive for e in self.effects):
                observations = [seen.with_dark() for seen in observations]
        self.observations = observations
        self.gain = wp.ones(len(observations), dtype=float, device=device)
        self.loss = self.render.program.array(int(kernels.PARTIALS), wp.float64, sum_into=True)
        self.outside = self.render.program.array(int(kernels.PARTIALS), wp.float64, sum_into=True)
        self._ones = np.ones(int(kernels.PARTIALS))
        if problem.validity > 0:
            strength = problem.validity / float(hits.weight.numpy().sum())
            self.render.program.launch(
                kernels.validity_kernel,
                hits.count,
                [hits.geometry.wavenumber, strength, hits.weight, hits.cos_incidence, self.render.zeta],
                [self.outside],
            )
        for index, seen in enumerate(observations):
            self.render.program.launch(
                kernels.loss_kernel,
                seen.pixels.size,
                [
                    LOSSES[problem.loss],
                    wp.array(seen.pixels, dtype=int, device=device),
                    wp.array(seen.values.astype(np.float32), dtype=float, device=device),
                    self.render.images[seen.polarization],
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
        from warpsar.kernels.loss import DARKEST

        return [
            np.maximum(self.render.images[seen.polarization].numpy()[seen.pixels].astype(float), DARKEST)
            for seen in self.observations
        ]

    def forward(self) -> None:
        self.render.program.forward()

    def backward(self, *, zero: bool = True) -> None:
        self.render.program.backward({self.loss: self._ones, self.outside: self._ones}, zero=zero)


class FitProblem:
    """Views of the given roles, traced and observed, and everything that a fit may ask of them.

    `total_variation`: weight per parameter key, in log-likelihood per unit of log difference; `validity`: weight of
    the models' domains as soft constraints (corrected equations 9, 12, 19).
    `views` names those of them that are used; `rays` and `observations` (by view name) are shared with other
    problems, so that models are compared on the same rays and pixels. Raises InputError for views without measured
    images and for parameters that cannot be learned.
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
    ) -> None:
        import warp as wp

        self.scene, self.device, self.loss, self.validity = scene, device, loss, validity
        rays = rays or Rays(Stage.of(scene, device), seed=scene.sampling.seed)
        self.surface = Surface.of(scene)
        self.stage = replace(rays.stage, surface=self.surface)
        chosen = [v for v in scene.views if v.role in roles and v.images and (views is None or v.name in views)]
        if not chosen:
            raise InputError(f"{scene.path}: views: none with role {' or '.join(roles)} has measured images")
        self._mean_square = float(
            np.mean([np.nanmean(scene.measured(v, p).astype(float) ** 2) for v in chosen for p in v.images])
        )
        # CUDA: all views read and differentiate one array; CPU: a copy each, so that threads never share a gradient
        self.shared_nodes: Any = (
            None if device.is_cpu else wp.zeros(self.surface.nodes.size, dtype=float, device=device, requires_grad=True)
        )
        self.views = [
            FitView(
                self,
                view,
                rays.hits(scene, view, declared(scene, view, neutral=True)),
                (observations or {}).get(view.name),
            )
            for view in chosen
        ]
        self.variation = TotalVariation(self.surface, scene.mesh, total_variation or {}, device, self.shared_nodes)
        self.learned = self.surface.learned
        self.effect_coordinates = self._effect_coordinates()
        self._tables: dict[str, dict[str, Any]] = {name: dict(table) for name, table in scene.effects.items()}
        self._ones = np.ones(self.variation.loss.size)
        self.x0 = np.concatenate([self.surface.nodes[self.learned], self._effect_values(self.scene.effects)])
        if not np.isfinite(self.x0).all():
            bad = [self.labels[i] for i in np.flatnonzero(~np.isfinite(self.x0))[:5]]
            raise InputError(
                f"{scene.path}: {', '.join(bad)}: found a dead start (eps_r = 1: no reflection, and every derivative "
                f"is exactly 0); allowed is eps_r >= {KINDS[0].low:g}"
            )

    # What x is

    def _effect_coordinates(self) -> list[EffectCoordinate]:
        found = []
        for name, table in self.scene.effects.items():
            for index, parameter in enumerate(get(name).parameters):
                if parameter.name not in table:
                    continue
                if parameter.per_view:
                    names = [v.view.name for v in self.views if v.view.name in table[parameter.name]]
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

    def follow(self, other: FitProblem, x: np.ndarray) -> np.ndarray:
        """x of a fit to other views of the scene, as x of these; an effect's numbers of these views alone stay as
        declared."""
        self._tables = other.effect_tables(x)
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
        low, high = [], []
        for block in self.surface.blocks:
            if block.learn:
                low += [float(block.kind.to_coordinate(block.kind.low))] * block.size
                high += [float(block.kind.to_coordinate(block.kind.high))] * block.size
        for c in self.effect_coordinates:
            ends = sorted(c.parameter.to_coordinate(v) for v in c.parameter.fit_bounds)
            low.append(ends[0])
            high.append(ends[1])
        return np.array(low), np.array(high)

    def nodes(self, x: np.ndarray) -> np.ndarray:
        """The whole surface's nodes with x in place."""
        nodes = self.surface.nodes.copy()
        nodes[self.learned] = x[: self.learned.size]
        return nodes

    def effect_tables(self, x: np.ndarray) -> dict[str, dict[str, Any]]:
        """The tables `[effects.*]` with x in place."""
        tables = {
            name: {k: dict(v) if isinstance(v, dict) else v for k, v in t.items()} for name, t in self._tables.items()
        }
        for c, value in zip(self.effect_coordinates, x[self.learned.size :], strict=True):
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
        """Fitted views of every per-view parameter whose values sum to zero."""
        found: dict[tuple[str, str], list[str]] = {}
        for c in self.effect_coordinates:
            if c.parameter.zero_sum and c.view is not None:
                found.setdefault((c.effect, c.parameter.name), []).append(c.view)
        return found

    # What x gives

    def _set(self, view: FitView, nodes: np.ndarray, tables: Mapping[str, Mapping[str, Any]]) -> None:
        values = {}
        for e in view.effects:
            table = tables[e.effect.name]
            values[e.effect.name] = np.array(
                [value_in(view.view, p, table, self.scene.views) for p in e.effect.parameters], float
            )
        view.render.set_parameters(nodes, values)

    def _run(self, x: np.ndarray) -> None:
        nodes, tables = self.nodes(x), self.effect_tables(x)

        def one(view: FitView) -> None:
            self._set(view, nodes, tables)
            view.forward()

        for _ in runtime.ordered([partial(one, view) for view in self.views], self.device):
            pass

    def modelled(self, x: np.ndarray) -> list[np.ndarray]:
        """beta0 of every observation's interior pixels, before gains; the order of `observations`."""
        self._run(x)
        return [mu for view in self.views for mu in view.modelled()]

    def modelled_as_declared(self) -> list[np.ndarray]:
        """`modelled` of the scene exactly as it stands, be its effects within a fit's bounds or not."""
        for view in self.views:
            view.forward()
        return [mu for view in self.views for mu in view.modelled()]

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
        terms = zip(self.observations, modelled, self.gains(modelled), strict=True)
        return sum(
            self.weight(seen) * float(loss_terms(self.loss, seen.values, gain * mu, seen.looks).sum())
            for seen, mu, gain in terms
        )

    def gradient(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Loss (float64 sums) and its gradient to x, by the tape's adjoint.

        Gains are at their best, so by the envelope theorem they add nothing to the gradient.
        """
        nodes, tables = self.nodes(x), self.effect_tables(x)
        shared = self.shared_nodes is not None

        def one(view: FitView) -> None:
            self._set(view, nodes, tables)
            view.forward()
            if not self.scene.grid.calibrated:
                pairs = zip(view.observations, view.modelled(), strict=True)
                view.gain.assign(np.array([self.gain(seen, mu) for seen, mu in pairs], np.float32))
                view.forward()
            if not shared:
                view.backward()

        for _ in runtime.ordered([partial(one, view) for view in self.views], self.device):
            pass
        variation = self.variation
        if shared:
            self._backward_shared()
            surface = self.shared_nodes.grad.numpy().astype(float)
        else:
            surface = np.sum([view.render.nodes.grad.numpy().astype(float) for view in self.views], axis=0)
            if variation.count:
                variation.nodes.assign(nodes.astype(np.float32))
                variation.program.forward()
                variation.program.backward({variation.loss: self._ones})
                surface += variation.nodes.grad.numpy()
        loss = self.loss_on_device()
        effects = []
        for c, coordinate in zip(self.effect_coordinates, x[self.learned.size :], strict=True):
            slopes = {
                view.view.name: float(view.render.effect_values[c.effect].grad.numpy()[c.index]) for view in self.views
            }
            slope = sum(slopes.values()) if c.view is None else slopes[c.view]
            if c.view is not None and c.parameter.zero_sum:
                views = self._zero_sums()[c.effect, c.parameter.name]
                slope -= sum(slopes[view] for view in views) / len(views)
            effects.append(slope * float(c.parameter.slope(coordinate)))
        return loss, np.concatenate([surface[self.learned], np.array(effects)])

    def _backward_shared(self) -> None:
        """Adjoint of every view into the one array of nodes they share."""
        for view in self.views:
            view.render.program.zero_gradients()
        self.shared_nodes.grad.zero_()
        for view in self.views:
            view.backward(zero=False)
        if self.variation.count:
            self.variation.program.forward()
            self.variation.program.backward({self.variation.loss: self._ones}, zero=False)

    def run_on_device(self) -> None:
        """Images, losses and gradient for the nodes as they stand in `shared_nodes`; nothing is copied to the host,
        so that a CUDA graph can capture it. The gradient is in `shared_nodes.grad`."""
        for view in self.views:
            view.forward()
        self._backward_shared()

    def loss_on_device(self) -> float:
        """The loss of the last run with its penalties, from the kernels' float64 partial sums."""
        losses = [loss for view in self.views for loss in (view.loss, view.outside)]
        return sum(float(loss.numpy().sum()) for loss in [*losses, self.variation.loss])

    def penalty(self) -> float:
        """The validity constraints' part of the last run (total variation is zero for uniform materials)."""
        return sum(float(view.outside.numpy().sum()) for view in self.views)

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
