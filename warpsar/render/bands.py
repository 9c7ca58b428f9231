"""Views whose hits are too many to keep: traced again, band by band, for every image and every gradient.

A first pass over the bands makes the light: the image before effects of the image stage. These effects and the loss
mix pixels of several bands, so they act on the whole light. Their adjoint is an image too, and a second pass over the
bands carries it into the parameters. Only the hits of one band at a time are in memory.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from warpsar.effects.base.effect import DeclaredEffect, Effect
from warpsar.effects.base.recorder import Recorder
from warpsar.errors import InputError
from warpsar.kernels import binning
from warpsar.kernels.codes import Polarization
from warpsar.render.render import ViewRender
from warpsar.render.rendered import COVERED
from warpsar.runtime.program import Program
from warpsar.runtime.structs import assign
from warpsar.surface.stage import Stage
from warpsar.trace.hits import BinGrid, Hits
from warpsar.world.tables import View


def stretches(grid: BinGrid, count: int) -> list[tuple[int, int]]:
    """The columns of `grid` in at most `count` stretches of about the same number of whole pixels."""
    fine = grid.bins_per_pixel
    pixels = grid.shape[1] // fine
    edges = np.unique(np.linspace(0, pixels, max(1, min(count, pixels)) + 1).round().astype(int))
    return [(fine * int(a), fine * int(b)) for a, b in itertools.pairwise(edges)]


class _Given(Effect):
    """Light that was made elsewhere, in place of that of a render's own hits."""

    name, stage = "given", "path"

    def __init__(self, light: Mapping[int, wp.array]) -> None:
        self.light = light

    def paths(self, render: Recorder, p: wp.array, image: wp.array, polarization: int) -> wp.array:
        return self.light[polarization]


class BandedRender:
    """A `Rendered` that keeps no hits: the images and gradients of `ViewRender`, to the order of summation.

    `trace` gives the hits of a stretch of columns of the hits' grid; for the empty stretch (0, 0) its hits tell the
    grid. `bands` are stretches that together cover all columns. Raises InputError for effects that start from all hits
    of a view at once.
    """

    def __init__(
        self,
        stage: Stage,
        view: View,
        trace: Callable[[tuple[int, int]], Hits],
        bands: Sequence[tuple[int, int]],
        shape: tuple[int, int],
        polarizations: tuple[str, ...],
        effects: list[DeclaredEffect],
        nodes: wp.array | None = None,
    ) -> None:
        for e in effects:
            if e.effect.needs_all_hits:
                raise InputError(
                    f"effects.{e.effect.name}: starts from all hits of view {view.name} at once, which are more "
                    f"than the memory they may take; allowed is a larger --max-memory, fewer rays or pixels, or a "
                    f"scene without it"
                )
        self.stage, self.view, self.shape, self.bands = stage, view, shape, bands
        self._trace, self._polarizations = trace, polarizations
        device: wp.Device = stage.target.device

        def parameters(size: int) -> wp.array:
            return wp.zeros(size, dtype=float, device=device, requires_grad=True)

        self.nodes = parameters(stage.surface.nodes.size) if nodes is None else nodes
        self.light = {pol: parameters(shape[0] * shape[1]) for pol in polarizations}
        given = DeclaredEffect(_Given({Polarization[pol]: light for pol, light in self.light.items()}), np.zeros(0))
        after = [e for e in effects if e.effect.stage == "image"]
        self._tail = ViewRender(stage, view, trace((0, 0)), shape, polarizations, [given, *after], nodes=self.nodes)
        self.images = self._tail.images
        self._before = [e for e in effects if e.effect.stage != "image"]
        self.effect_values = {e.effect.name: self._tail.effect_values[e.effect.name] for e in after}
        self.effect_values |= {e.effect.name: parameters(max(1, e.values.size)) for e in self._before}
        self._node_values = stage.surface.nodes
        self.set_parameters(stage.surface.nodes, {e.effect.name: e.values for e in effects})
        self.program = _BandedProgram(self, self._tail.program)

    keeps_hits = False

    @property
    def whole(self) -> ViewRender:
        """Raises InputError: the hits of the whole view are not kept."""
        raise InputError(
            f"view {self.view.name}: its hits are needed all at once, and are more than the memory they may take; "
            f"allowed is a larger --max-memory, or no --validity"
        )

    def lit(self, polarization: str) -> np.ndarray:
        """As `Rendered.lit`."""
        return self.light[polarization].numpy().reshape(self.shape) > 0

    def covered(self, polarization: str) -> np.ndarray:
        """As `Rendered.covered`: every band is traced once more."""
        area = sum((piece.coverage() for piece in self.pieces()), np.zeros(self.shape))
        return self.lit(polarization) & (area >= COVERED)

    def set_parameters(self, nodes: np.ndarray | None, effects: Mapping[str, np.ndarray] | None = None) -> None:
        """As `Rendered.set_parameters`."""
        if nodes is not None:
            self._node_values = nodes
            assign(self.nodes, nodes)
        for name, values in (effects or {}).items():
            if values.size:
                assign(self.effect_values[name], values)

    def forward(self) -> dict[str, np.ndarray]:
        """As `Rendered.forward`."""
        self.program.forward()
        return {name: image.numpy().reshape(self.shape).copy() for name, image in self.images.items()}

    def image_with(self, effect: DeclaredEffect, image: np.ndarray) -> np.ndarray:
        """As `Rendered.image_with`."""
        return self._tail.image_with(effect, image)

    def pieces(self) -> Iterator[ViewRender]:
        """The render of each band's hits in turn, at the parameters as they stand, after its forward run.

        Its images are the band's light.
        """
        stage = replace(self.stage, surface=replace(self.stage.surface, nodes=self._node_values))
        effects = [
            replace(e, values=self.effect_values[e.effect.name].numpy()[: e.values.size].astype(float))
            for e in self._before
        ]
        for band in self.bands:
            piece = ViewRender(
                stage, self.view, self._trace(band), self.shape, self._polarizations, effects, nodes=self.nodes
            )
            piece.program.forward()
            yield piece

    def make_light(self) -> None:
        """The first pass: the light of all bands, added up."""
        for light in self.light.values():
            light.zero_()
        for piece in self.pieces():
            for name, light in self.light.items():
                wp.launch(
                    binning.add_kernel,
                    light.size,
                    inputs=[light, piece.images[name]],
                    outputs=[light],
                    device=light.device,
                )

    def zero_gradients(self) -> None:
        """Zero the gradients of the light and of the effects' parameters."""
        for array in (*self.light.values(), *self.effect_values.values()):
            array.grad.zero_()

    def spread(self) -> None:
        """The second pass: add the light's gradient, carried through each band, to those of the parameters."""
        for piece in self.pieces():
            seeds = {piece.images[name]: light.grad for name, light in self.light.items()}
            piece.program.backward(seeds, zero=False)
            for name, array in piece.effect_values.items():
                own = self.effect_values[name].grad
                own.assign(own.numpy() + array.grad.numpy())


class _BandedProgram:
    """The `rendered.Replayed` of a banded view: its launches run between the two passes over the bands."""

    def __init__(self, render: BandedRender, tail: Program) -> None:
        self._render, self._tail = render, tail
        self.device, self.array, self.launch = tail.device, tail.array, tail.launch

    def forward(self, *, gradient: bool = False) -> None:
        self._render.make_light()
        self._tail.forward(gradient=gradient)

    def zero_gradients(self) -> None:
        self._tail.zero_gradients()
        self._render.zero_gradients()

    def backward(self, seeds: dict[Any, Any], *, zero: bool = True) -> None:
        if zero:
            self.zero_gradients()
            self._render.nodes.grad.zero_()
        self._tail.backward(seeds, zero=False)
        self._render.spread()
