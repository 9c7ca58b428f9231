"""One view's d ln(mu) / dx: forward mode for the surface's nodes, central differences for effects' parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import warp as wp
from scipy.sparse import csc_array, csr_array

from warpsar.kernels.codes import Layout
from warpsar.learning.view import FitView
from warpsar.render.render import ViewRender
from warpsar.render.tangents import Tangents

T = TypeVar("T")
Values = Mapping[str, np.ndarray]
"""An effect's name -> the values of its parameters in one view."""


@dataclass(frozen=True)
class Nodes:
    """Columns of a Jacobian that belong to surface nodes: their places among the columns, and the nodes' numbers."""

    columns: np.ndarray
    nodes: np.ndarray


@dataclass(frozen=True)
class Move:
    """A column of an effect's parameter: the view's values of all effects with it `up` and `down`, `width` apart."""

    column: int
    up: Values
    down: Values
    width: float


class ViewJacobian:
    """Jacobians of one view whose hits are at hand; the view's launches are recorded before it is made.

    Its images stand for nothing after a call, its parameters for what they were.
    """

    def __init__(self, view: FitView, render: ViewRender) -> None:
        self._view, self._render = view, render
        self._tangents = Tangents(render)
        places = render.stage.surface.places
        self._uniform = np.zeros(render.stage.surface.nodes.size, bool)
        self._uniform[places[places[:, :, 0] == Layout.UNIFORM][:, 1]] = True

    def dense(
        self, values: Values, nodes: Nodes, moves: Sequence[Move], count: int
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Modelled beta0 and d ln(mu) of each observation, shapes (n,) and (n, `count`), float64.

        The last run's images are those of the parameters as they stand, with what gradients need if there are `nodes`;
        `values` are the effects'.
        """
        view = self._view
        modelled = view.modelled()
        found = [np.zeros((count, mu.size)) for mu in modelled]
        stale: list[wp.array] = []
        if nodes.nodes.size:
            for (polarization, pixels, darkest), mu, rows in zip(view.compared, modelled, found, strict=True):
                tangents = self._tangents.through_image(polarization, self._at_nodes(polarization, nodes))
                seen = np.where(mu > darkest, 1.0 / mu, 0.0)  # no darker pixel changes
                for column, tangent in zip(nodes.columns, tangents, strict=True):
                    np.multiply(tangent[pixels], seen, out=rows[column])
            stale += self._render.before_image.values()
        for move in moves:
            moved = [name for name, up in move.up.items() if not np.array_equal(up, move.down[name])]
            if moved:
                stale += [self._render.effect_values[name] for name in moved]
                above, below = (self._images({n: end[n] for n in moved}, stale) for end in (move.up, move.down))
                for rows, a, b in zip(found, above, below, strict=True):
                    rows[move.column] = np.log(a / b) / move.width
                self._render.set_parameters(None, {n: values[n] for n in moved})
        return modelled, [rows.T for rows in found]

    def _images(self, values: Values, stale: Sequence[wp.array]) -> list[np.ndarray]:
        """Modelled beta0 at other `values`, where the arrays `stale` changed since the last full run."""
        self._render.set_parameters(None, values)
        self._render.program.part(self._render.images.values(), stale).forward()
        return self._view.modelled()

    def _at_nodes(self, polarization: str, nodes: Nodes) -> wp.array:
        """d beta0 / d node before the image stage, shape (nodes, pixels)."""
        row = np.full(self._uniform.size, -1, np.int32)
        row[nodes.nodes] = np.arange(nodes.nodes.size)
        found = self._tangents.uniform(polarization, row, nodes.nodes.size)
        field = ~self._uniform[nodes.nodes]
        if not field.any():
            return found
        whole = found.numpy()
        whole[field] = self._tangents.matrix(polarization)[:, nodes.nodes[field]].toarray().T
        return wp.array(whole, dtype=float, device=found.device)

    def sparse(self, nodes: np.ndarray, *, near: bool = False) -> list[csr_array]:
        """d ln(mu) / d node of each observation, shape (n, nodes), float64, at the parameters as they stand. `near`:
        an effect of the image scales each pixel as it does when the whole image grows."""
        view = self._view
        view.run_images(gradient=True)
        found = []
        for (polarization, pixels, darkest), mu in zip(view.compared, view.modelled(), strict=True):
            columns = csc_array(self._tangents.matrix(polarization)[:, nodes])
            if near:
                moved = csr_array(columns.multiply(self._scales(polarization)[:, None]))[pixels]
            else:
                moved = self._tangents.sparse_through_image(polarization, columns).tocsr()[pixels]
            seen = np.where(mu > darkest, 1.0 / mu, 0.0)
            found.append(csr_array(moved.multiply(seen[:, None])))
            view.run_images(gradient=True)
        return found

    def by_kind(
        self, kinds_of: Callable[[FitView, ViewRender], tuple[T, np.ndarray, int]]
    ) -> tuple[T, list[np.ndarray]]:
        """What `kinds_of` finds, with the kind of each shading sample and their number (`FitProblem.by_kind`), and
        d ln(mu) of each observation by the logarithm of what each kind of sample brings (`Tangents.powers`), shape
        (n, kinds + 1), float64, after a run of the images."""
        what, kind, count = kinds_of(self._view, self._render)
        found = []
        for (polarization, pixels, darkest), mu in zip(self._view.compared, self._view.modelled(), strict=True):
            rows = self._tangents.powers(polarization, kind, count)
            given: wp.array = wp.array(rows, dtype=float, device=self._render.program.device)
            moved = self._tangents.through_image(polarization, given)[:, pixels].astype(float)
            found.append((moved * np.where(mu > darkest, 1.0 / mu, 0.0)).T)
        return what, found

    def _scales(self, polarization: str) -> np.ndarray:
        """How far each pixel grows with the whole image before the image stage, shape (pixels,)."""
        before = self._render.before_image[polarization]
        values = before.numpy().copy()
        given: wp.array = wp.array(values[None], dtype=float, device=before.device)
        (grown,) = self._tangents.through_image(polarization, given)
        return np.where(values > 0, grown / np.where(values > 0, values, 1.0), 0.0)
