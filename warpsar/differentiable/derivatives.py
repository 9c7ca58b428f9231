"""Images of a scene as a function of its parameters, and their derivatives, with NumPy arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.differentiable.parameters import (
    GeometryParameters,
    RenderParameter,
    known_name,
    learned_tables,
    render_parameters,
)
from warpsar.differentiable.vertex_slopes import vertex_slopes
from warpsar.effects.registry import declared
from warpsar.errors import InputError
from warpsar.parameters.tree import Named
from warpsar.render.render import ViewRender
from warpsar.runtime import threads
from warpsar.scene.scene import Scene
from warpsar.simulation.exact_rays import ExactRays
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.world.tables import View

Values = Mapping[str, Any]
"""Parameters by name: numbers or arrays in the units of scene.toml. What is left out is as the scene declares it."""
Images = dict[str, dict[str, NDArray[np.float32]]]
"""beta0, linear power, shape (rows, cols), by view and polarization."""

STEP = 1e-2  # of a learned coordinate, as in a fit's Jacobian
MOVE_M = 0.2  # that the farthest vertex moves where a learned coordinate moves by 1: 2 mm in a difference


class Derivatives:
    """Images of a scene's views as a function of its parameters, and their derivatives.

    Where nothing of the geometry is free, rays are traced once, and a call shades their hits anew. Poses, sizes and
    vertices that are free take images of exact areas instead (`trace.exact`), which a call makes anew where they have
    moved; derivatives to them hold what silhouettes and shadows do. One renderer serves one thread at a time.
    """

    def __init__(self, scene: Scene, device: Any, seed: int, max_memory_gib: float, *, vertices: bool = False) -> None:
        self.scene, self.device = scene, device
        self._seed, self._memory = seed, max_memory_gib
        self.moves = GeometryParameters(scene, vertices)
        """What of the geometry may change."""
        self.renders: dict[str, ViewRender] = {}
        """By view."""
        self._effects = {view.name: declared(scene, view, neutral=True) for view in scene.views}
        self.declared: dict[str, dict[str, NDArray[np.float64]]] = {
            view: {e.effect.name: np.array(e.values, float) for e in effects} for view, effects in self._effects.items()
        }
        """The effects' values as the scene has them, by view and effect."""
        self.last_run: object = None
        self._at: dict[bytes, object] = {}
        self._tabled = bool(learned_tables(scene))
        self._placed: dict[str, NDArray[np.float64]] | None = None
        self.place({})
        self.parameters = render_parameters(scene, self.stage.surface, self.stage.tables, self.moves.parameters)
        """What may change, by name."""

    @property
    def values(self) -> dict[str, NDArray[np.float64]]:
        """The parameters as the scene declares them: copies, to be changed and given back."""
        return Named(self.parameters, {name: parameter.value.copy() for name, parameter in self.parameters.items()})

    def __call__(self, values: Values | None = None) -> Images:
        """The images for `values`: beta0 by view and polarization, shape (rows, cols), float32.

        Raises InputError for names that are not in `parameters`, and for shapes and numbers that are not allowed.
        """
        self._run(self.checked(values), gradient=False)
        return {
            name: {p: image.numpy().reshape(render.shape).copy() for p, image in render.images.items()}
            for name, render in self.renders.items()
        }

    def vjp(self, values: Values | None, cotangents: Mapping[str, Mapping[str, Any]]) -> dict[str, NDArray[np.float64]]:
        """Gradients, at `values`, of the sum of cotangent x image over all pixels: one reverse pass of the program.

        `cotangents`: arrays (rows, cols) by view and polarization; what is left out is 0. Returns an array in each
        parameter's shape and unit (per unit of beta0). The adjoint is exact, computed in float32. Raises InputError as
        a call does, for cotangents that fit no image, and for a declared value at which no derivative can be taken.
        """
        given = self.checked({**self.values, **(values or {})})
        self.place(given)
        seeds = self._seeds(cotangents)
        self._run(given, gradient=True)
        self.backward(seeds)
        nodes = np.zeros(self.start.size)
        for name in seeds:
            nodes += np.concatenate([array.grad.numpy().ravel() for array in self.arrays(self.renders[name])])
        moved = self.moved_gradients(seeds)
        effects = {
            name: {e: p.grad.numpy().astype(float) for e, p in self.renders[name].effect_values.items()}
            for name in seeds
        }
        plain = {name: p for name, p in self.parameters.items() if not p.moves}
        found = {name: self._gradient(p, given, nodes, effects) for name, p in plain.items()} | moved
        return Named(self.parameters, found)

    def jvp(self, values: Values | None, tangents: Values) -> Images:
        """How the images change along `tangents` (by parameter, in its unit): central differences of two renders.

        The program has no forward mode. The step is 0.01 of the learned coordinate (ln h, ln(eps_r - 1) and so on; of
        an effect's parameter 0.01 of its own scale) that moves most, and its error about 2e-4 of the derivative, part
        of it float32 rounding. Raises InputError as a call does, for tangents that are all 0, and where a step would
        leave what a parameter may be: there it cannot be taken.
        """
        given = self.checked({**self.values, **(values or {})})
        moves = {self.known(name): self._tangent(self.known(name), tangent) for name, tangent in tangents.items()}
        largest = max((self._size(name, given, move) for name, move in moves.items()), default=0.0)
        if not 0.0 < largest < np.inf:
            raise InputError(f"tangents: found {', '.join(moves) or 'none'}, all 0; must move at least one parameter")
        step = STEP / largest
        ends = []
        for sign in (1.0, -1.0):
            moved = {name: self._moved(name, given, sign * step * move) for name, move in moves.items()}
            ends.append(self({**given, **moved}))
        return {
            view: {p: (ends[0][view][p] - ends[1][view][p]) / np.float32(2.0 * step) for p in ends[0][view]}
            for view in ends[0]
        }

    # What the faces for other libraries share

    def place(self, given: Mapping[str, NDArray[np.float64]]) -> None:
        """Make the views' programs for the geometry among the `given` values, unless they are there."""
        moved = {name: p.value for name, p in self.moves.parameters.items()}
        moved |= {name: value for name, value in given.items() if name in moved}
        if self._placed is not None and all(np.array_equal(moved[name], self._placed[name]) for name in moved):
            return
        scene = self.moves.scene_at(moved) if given else self.scene
        self.stage = Stage.of(scene, self.device)
        rays = (ExactRays if moved else Rays)(self.stage, seed=self._seed)
        for view in scene.views:
            effects = self._effects[view.name]
            hits = rays.trace(scene, view, effects, max_memory_gib=self._memory)
            tables = self.stage.tables
            own = replace(self.stage, tables=tables.copied()) if tables is not None and self._tabled else self.stage
            its = ViewRender(own, view, hits, scene.grid.shape, scene.radar.polarizations, effects)
            self.renders[view.name] = its
        self._placed, self.last_run = moved, None

    @property
    def start(self) -> NDArray[np.float64]:
        """The surface's nodes as declared, and behind them, where any table is learned, the values of all tables."""
        tables = self.stage.tables
        values = [] if tables is None or not self._tabled else [tables.sigma0_db.numpy().astype(float).ravel()]
        return np.concatenate([self.stage.surface.nodes, *values])

    def arrays(self, render: ViewRender) -> list[Any]:
        """A view's own arrays on the device that hold what `start` does, in its order."""
        tables = render.stage.tables
        return [render.nodes] if tables is None or not self._tabled else [render.nodes, tables.sigma0_db]

    def places(self, column: NDArray[np.int64]) -> NDArray[np.int64]:
        """Where the values of a table's column stand in `start`."""
        return np.asarray(self.stage.surface.nodes.size + column)

    def moved_gradients(self, views: Iterable[str]) -> dict[str, NDArray[np.float64]]:
        """Gradients to the geometry's parameters, after `backward` has run for these views."""
        if not self.moves.parameters:
            return {}
        to_vertices = np.zeros(self.scene.mesh.vertices.shape)
        for view in views:
            to_vertices += vertex_slopes(self.renders[view], self._effects[view])
        assert self._placed is not None
        return self.moves.pulled(self._placed, to_vertices)

    def checked(self, values: Values | None) -> dict[str, NDArray[np.float64]]:
        """The given values in full shape, float64. Raises InputError."""
        found = {}
        for called, value in (values or {}).items():
            name = self.known(called)
            found[name] = self.parameters[name].checked(value)
        return found

    def known(self, name: str) -> str:
        """The name of a parameter, which may be called by its old one. Raises InputError for what has no derivative."""
        return known_name(self.scene, self.parameters, name)

    def share(self, parameter: RenderParameter, view: View) -> float:
        """d (the effect's value in a view) / d (the parameter): 1 of a number for all views; where each view has its
        own, 1 in that view, less the mean over all where only differences act."""
        if parameter.layout != "per view":
            return 1.0
        return float(parameter.entry == view.name) - (1.0 / len(self.scene.views) if parameter.zero_sum else 0.0)

    def run(self, set_parameters: Callable[[ViewRender], None], *, gradient: bool) -> object:
        """Run every view's program with the parameters that `set_parameters` gives it. Returns what `last_run` is from
        now on."""
        self.last_run = None

        def one(render: ViewRender) -> None:
            set_parameters(render)
            render.program.forward(gradient=gradient)

        for _ in threads.ordered([partial(one, render) for render in self.renders.values()], self.device):
            pass
        self.last_run = object()
        return self.last_run

    def backward(self, seeds: Mapping[str, Mapping[Any, Any]]) -> None:
        """Carry gradients of the views' images (by array of the program) into the `.grad` of nodes and effects."""
        tasks = [partial(self.renders[name].program.backward, dict(seed)) for name, seed in seeds.items()]
        for _ in threads.ordered(tasks, self.device):
            pass

    # Inside

    def _run(self, given: dict[str, NDArray[np.float64]], *, gradient: bool) -> None:
        """Run the programs, unless they have just run at these values."""
        key = b"".join(name.encode() + value.tobytes() for name, value in sorted(given.items()))
        if self.last_run is not None and self.last_run is self._at.get(key):
            return
        self.place(given)
        nodes = self.start
        for name, value in given.items():
            parameter = self.parameters[name]
            if (block := parameter.block) is not None:
                used = np.atleast_1d(value)[parameter.used].ravel()
                nodes[block.start : block.stop] = parameter.transform.to_coordinate(used)
            elif parameter.column is not None:
                nodes[self.places(parameter.column)] = value[:, None]

        def set_parameters(render: ViewRender) -> None:
            effects = {name: values.copy() for name, values in self.declared[render.view.name].items()}
            for name, value in given.items():
                parameter = self.parameters[name]
                if parameter.index is not None:
                    effects[parameter.owner][parameter.index] += self.share(parameter, render.view) * float(
                        value - parameter.value
                    )
            render.set_parameters(nodes[: render.nodes.size], effects)
            for table in self.arrays(render)[1:]:
                table.assign(nodes[render.nodes.size :].reshape(table.shape))

        self._at = {key: self.run(set_parameters, gradient=gradient)}

    def _seeds(self, cotangents: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[Any, Any]]:
        """Arrays of the views' programs with the gradients that come into them."""
        found = {}
        for name, images in cotangents.items():
            if name not in self.renders:
                raise InputError(f"cotangents: found view {name!r}; must be one of {', '.join(self.renders)}")
            render, seeds = self.renders[name], {}
            for polarization, cotangent in images.items():
                where = f"cotangents of {name}"
                if polarization not in render.images:
                    raise InputError(f"{where}: found {polarization!r}; must be one of {', '.join(render.images)}")
                array = np.asarray(cotangent, np.float32)
                if array.shape != render.shape:
                    raise InputError(f"{where} {polarization}: found shape {array.shape}; must be {render.shape}")
                seeds[render.images[polarization]] = np.ascontiguousarray(array).ravel()
            found[name] = seeds
        return found

    def _gradient(
        self, parameter: RenderParameter, given: Values, nodes: NDArray[np.float64], effects: Mapping[str, Any]
    ) -> NDArray[np.float64]:
        value = np.atleast_1d(given[parameter.name])
        if (block := parameter.block) is not None:
            gradient, used = np.zeros(value.shape), value[parameter.used]
            along = nodes[block.start : block.stop].reshape(used.shape)
            gradient[parameter.used] = along / parameter.transform.slope_at(used)
            return gradient.reshape(parameter.shape)
        if parameter.column is not None:
            return np.asarray(nodes[self.places(parameter.column)].sum(axis=1))
        parts = [
            self.share(parameter, self.renders[view].view) * found[parameter.owner][parameter.index]
            for view, found in effects.items()
        ]
        return np.array(sum(parts))

    def _tangent(self, name: str, tangent: Any) -> NDArray[np.float64]:
        move, shape = np.asarray(tangent, float), self.parameters[name].shape
        if move.shape != shape or not np.isfinite(move).all():
            raise InputError(f"tangents: {name}: found shape {move.shape}; must be finite numbers of shape {shape}")
        return move

    def _size(self, name: str, given: Values, move: NDArray[np.float64]) -> float:
        """The largest step of a move, in the coordinate that a fit moves."""
        parameter = self.parameters[name]
        if parameter.moves:
            values = {each: given[each] for each in self.moves.parameters}
            return float(np.linalg.norm(self.moves.displacement(values, {name: move}), axis=1).max()) / MOVE_M
        value = np.atleast_1d(given[name])[parameter.used]
        move = np.abs(np.atleast_1d(move)[parameter.used])
        if parameter.column is not None:
            per_unit = np.full(value.shape, np.log(10.0) / 10.0)  # of ln(sigma0)
        else:
            per_unit = 1.0 / np.maximum(parameter.transform.slope_at(value), 1e-300)
        return float(np.max(np.where(move > 0.0, move * per_unit, 0.0), initial=0.0))

    def _moved(self, name: str, given: Values, move: NDArray[np.float64]) -> NDArray[np.float64]:
        parameter = self.parameters[name]
        try:
            return parameter.checked(given[name] + move)
        except InputError as error:
            raise InputError(f"tangents: {name} is too close to its bound for a central difference: {error}") from error
