"""One view of a fit: its render, the measured pixels on the device, and the loss between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from scipy.special import gammaln

from warpsar.compare.observation import Observation, observe
from warpsar.effects.base.effect import DeclaredEffect
from warpsar.kernels import loss as loss_kernels
from warpsar.kernels import metrics as metrics_kernels
from warpsar.learning.misfit import Misfit
from warpsar.render.rendered import Rendered, Replayed
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
        images = self.render.images
        return [
            np.maximum(images[polarization].numpy()[pixels].astype(float), darkest)
            for polarization, pixels, darkest in self.compared
        ]

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
        has changed run again.
        """
        images, last, program = self._images, self._standing, self.render.program
        if at is not None and last is not None and at[0] == last[0] and isinstance(program, Program) and not gradient:
            moved = [name for name, values in at[1].items() if not np.array_equal(values, last[1][name])]
            changed = [self.render.effect_values[name] for name in moved]
            images = program.part([*self.render.images.values(), self.outside], changed)
        images.forward(gradient=gradient)
        self._standing = at

    def forward(self, *, gradient: bool = False) -> None:
        """Run the images and the loss; `gradient` as in `Program.forward`."""
        self._standing = None
        self.render.program.forward(gradient=gradient)

    def backward(self, *, zero: bool = True) -> None:
        """Gradients of the loss and of the soft constraint; `zero` as in `Program.backward`."""
        self.render.program.backward(self._seeds, zero=zero)
