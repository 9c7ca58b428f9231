"""One view of a fit: its render, the measured pixels on the device, the loss between them, and d ln(mu) / dx: forward
mode for the surface's nodes, central differences for effects' parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import warp as wp
from scipy.sparse import csc_array, csr_array
from scipy.special import gammaln

from warpsar.compare.observation import Observation, observe
from warpsar.effects.base.effect import DeclaredEffect
from warpsar.kernels import loss as loss_kernels
from warpsar.kernels import metrics as metrics_kernels
from warpsar.kernels.codes import Layout
from warpsar.learning.device_values import STEP, DeviceBlock, DeviceValues
from warpsar.learning.misfit import Misfit
from warpsar.render.render import ViewRender
from warpsar.render.rendered import Rendered, Replayed
from warpsar.render.tangents import Tangents
from warpsar.runtime.program import Program, ProgramPart
from warpsar.runtime.structs import fill
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import LOSSES, log_bias
from warpsar.world.tables import View

FLOAT_MAX = float(np.finfo(np.float32).max)
Standing = tuple[bytes, Mapping[str, np.ndarray]]
"""Where images were made: the surface, as bytes that tell it from any other, and the values of each effect."""


class FitView:
    """One view: its render, and on the render's program the loss of each polarization's measured pixels.

    `observations` are made from the scene's images and the lit pixels of the render where none are given. `validity`
    is the weight of the models' domains as soft constraints. `loss` and `outside` are partial sums on the device,
    float64, of the loss and of that constraint; `gain` has one number for each observation. `compared` has the
    polarization of each observation, its pixels' flat indices, and their lower bounds of beta0.
    """

    def __init__(
        self,
        scene: Scene,
        view: View,
        render: Rendered,
        effects: list[DeclaredEffect],
        observations: list[Observation] | None,
        misfit: Misfit,
        validity: float,
    ) -> None:
        self.view, self.effects, self.render = view, effects, render
        if observations is None:
            render.program.forward()
            observations = [observe(scene, view, pol, self.render.covered(pol)) for pol in view.images]
            if any(e.effect.additive for e in self.effects):
                observations = [seen.with_dark() for seen in observations]
        self.observations = observations
        device = render.program.device
        self.compared = [(seen.polarization, seen.pixels, seen.darkest) for seen in observations]
        self.gain: wp.array = wp.ones(len(observations), dtype=float, device=device)
        self.loss = self._partial_sums()
        self._seeds = {self.loss: 1.0}
        self.outside: wp.array = wp.zeros(1, dtype=wp.float64, device=device)
        self._standing: Standing | None = None  # what the images were made at; None: not known
        if validity > 0:
            self.outside = self._partial_sums()
            self._seeds[self.outside] = 1.0
            self._record_validity(validity)
        self._on_device: list[list[Any]] = []  # of each observation what its kernels take first
        for index, seen in enumerate(observations):
            self._record_loss(index, seen, misfit)

    def _partial_sums(self) -> wp.array:
        return self.render.program.array(int(loss_kernels.PARTIALS), wp.float64, sum_into=True)

    def _record_validity(self, validity: float) -> None:
        piece = self.render.whole
        hits = piece.shaded
        strength = validity / float(hits.weight.numpy().sum())
        self.render.program.launch(
            loss_kernels.validity_kernel,
            hits.count,
            [hits.geometry.wavenumber, strength, hits.weight, hits.cos_incidence, piece.zeta],
            [self.outside],
        )

    def _record_loss(self, index: int, seen: Observation, misfit: Misfit) -> None:
        observed = seen.on(self.render.program.device)
        constants = fill(
            loss_kernels.LossConstants,
            kind=LOSSES[misfit.loss],
            looks=seen.looks,
            weight=misfit.weight(seen),
            bias=log_bias(seen.looks),
            bound=misfit.bound,
            top=min(seen.top, FLOAT_MAX),
            log_gamma=float(gammaln(seen.looks)),
        )
        image = self.render.images[seen.polarization]
        self._on_device.append([observed, image])
        self.render.program.launch(
            loss_kernels.loss_kernel,
            seen.pixels.size,
            [constants, observed, image, self.gain, index],
            [self.loss],
        )

    def modelled(self) -> list[np.ndarray]:
        """beta0 of each observation's interior pixels before any gain, shape (n,), float64, after a forward run."""
        images, found = self.render.images, []
        for polarization, pixels, darkest in self.compared:
            # clipping checks no index, and these are the pixels of this very image
            mu = images[polarization].numpy().take(pixels, mode="clip").astype(float)
            found.append(np.maximum(mu, darkest, out=mu))
        return found

    def add_moments(self, sums: Sequence[wp.array]) -> None:
        """Add the sums of kernels/metrics.py over each observation's pixels, as `modelled` gives them, to one array of
        `sums` each."""
        for compared, total in zip(self._on_device, sums, strict=True):
            size, device = compared[0].pixel.size, self.render.program.device
            wp.launch(metrics_kernels.moments_kernel, size, inputs=compared, outputs=[total], device=device)

    @cached_property
    def _images(self) -> ProgramPart | Replayed:
        program = self.render.program
        return program.part([*self.render.images.values(), self.outside]) if isinstance(program, Program) else program

    def run_images(self, *, gradient: bool = False, at: Standing | None = None) -> None:
        """Run the images and the soft constraint; `gradient` as in `Program.forward`.

        `at`: the parameters that were set. Where the surface is that of the last run, only launches behind what else
        has changed run again, and a backward run makes by itself what gradients need.
        """
        images, last, program = self._images, self._standing, self.render.program
        if at is not None and last is not None and at[0] == last[0] and isinstance(program, Program):
            moved = [name for name, values in at[1].items() if not np.array_equal(values, last[1][name])]
            changed = [self.render.effect_values[name] for name in moved]
            images = program.part([*self.render.images.values(), self.outside], changed)
            gradient = False
        images.forward(gradient=gradient)
        self._standing = at

    def leave(self) -> None:
        """Let the images stand for nothing: others were made in their place."""
        self._standing = None

    def forward(self, *, gradient: bool = False) -> None:
        """Run the images and the loss; `gradient` as in `Program.forward`."""
        self._standing = None
        self.render.program.forward(gradient=gradient)

    def backward(self, *, zero: bool = True) -> None:
        """Gradients of the loss and of the soft constraint; `zero` as in `Program.backward`."""
        self.render.program.backward(self._seeds, zero=zero)


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
    """A column of an effect's parameter: the view's values of its effect with it `up` and `down`, `width` apart."""

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
        self._seen_values: dict[tuple[str, str], np.ndarray] = {}  # by material and key
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
        view.leave()
        found = [np.zeros((count, mu.size)) for mu in modelled]
        stale: list[wp.array] = []
        if nodes.nodes.size:
            for (polarization, pixels, darkest), mu, rows in zip(view.compared, modelled, found, strict=True):
                tangents = self._tangents.through_image(polarization, self._at_nodes(polarization, nodes))
                seen = np.where(mu > darkest, 1.0 / mu, 0.0)  # no darker pixel changes
                taken = np.empty(mu.size, np.float32)
                for column, tangent in zip(nodes.columns, tangents, strict=True):
                    # clipping checks no index: a third of the time
                    np.multiply(tangent.take(pixels, out=taken, mode="clip"), seen, out=rows[column])
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

    def to_values(self, values: DeviceValues, z: np.ndarray) -> list[np.ndarray]:
        """d ln(mu) / dz of each observation, shape (n, z), float64: differences of the images by each value that the
        view sees, at all other parameters as they stand.

        The images stand for nothing after a call; the stage's values are those of z.
        """
        view, stage = self._view, self._render.stage
        found = [np.zeros((seen.count, z.size)) for seen in view.observations]
        seen_values = [self._seen(block) for block in values.blocks]
        view.leave()
        self._render.program.part(self._render.images.values()).forward()
        for (block, part), seen_ones in zip(values.parts, seen_values, strict=True):
            array, at = block.array(stage), block.values(z[part])
            images = self._render.program.part(self._render.images.values(), [array])
            own = [np.zeros((seen.count, *at.shape)) for seen in view.observations]
            steps = STEP * np.linalg.norm(block.unit, axis=1)
            for channel, row in zip(*np.nonzero(seen_ones), strict=True):
                ends = []
                for sign in (1.0, -1.0):
                    moved = at.copy()
                    moved[channel, row] += sign * steps[row]
                    block.put(stage, moved)
                    images.forward()
                    ends.append(view.modelled())
                for slopes, up, down in zip(own, *ends, strict=True):
                    slopes[:, channel, row] = np.log(up / down) / (2.0 * steps[row])
            block.put(stage, at)
            images.forward()
            for whole, slopes in zip(found, own, strict=True):
                whole[:, part] = (slopes @ block.unit).reshape(len(slopes), -1)
        return found

    def _seen(self, block: DeviceBlock) -> np.ndarray:
        """Which of a block's values the view's images depend on, (channels, n) bool: not one at an incidence that no
        hit has."""
        if (block.material, block.key) not in self._seen_values:
            program = self._render.program
            program.forward(gradient=True)
            program.backward(dict.fromkeys(self._render.images.values(), 1.0))
            self._seen_values[block.material, block.key] = block.gradient(self._render.stage) != 0.0
        return self._seen_values[block.material, block.key]

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
