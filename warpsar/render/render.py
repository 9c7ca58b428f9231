"""Hits + surface + effects -> images: a program that runs forward, and backward to every parameter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
import warp as wp

from warpsar.effects.base.effect import DeclaredEffect, Effect
from warpsar.effects.registry import response_of
from warpsar.kernels import binning, deposit_lanes, shade, shade_lanes
from warpsar.kernels.codes import PAGE, Layout, Polarization
from warpsar.kernels.wide import LANES
from warpsar.render import models
from warpsar.render.rendered import COVERED
from warpsar.runtime.launches import Launch, LaunchPiece, by_elements, by_stretches
from warpsar.runtime.program import Program, adjoint_of
from warpsar.runtime.structs import assign, fill
from warpsar.surface.samples import shading_samples
from warpsar.surface.spread import Spread
from warpsar.surface.stage import Stage
from warpsar.trace.hits import Hits
from warpsar.trace.merge import starts
from warpsar.world.frame import ViewGeometry
from warpsar.world.tables import View


@dataclass(frozen=True)
class Gathered:
    """Learned coordinates (vec4) that were looked up on the mesh, before any effect; arrays of shape (n,)."""

    face: wp.array
    barycentric: wp.array
    zeta: wp.array
    page: int = 0
    """Which vector it is of the coordinates that models with more than four have"""


@dataclass(frozen=True)
class Deposited:
    """Power `sigma` * `weight` that falls into `bins` of the hits' grid.

    `sample`: which of `sigma` each bin takes; None: its own. `shift`: by how many pixels (rows, columns) the bins are
    moved; None: the bins are pixels. `points` (vec3) and the `faces` of each bounce (int) are those of `sigma`, and
    `term` is "surface" or the path effect.
    """

    sigma: wp.array
    sample: wp.array | None
    weight: wp.array
    bins: wp.array
    shift: wp.array | None
    points: wp.array
    faces: Sequence[wp.array]
    term: str


class ViewRender:
    """One view's images as a function of the surface's nodes and the effects' parameters, with the hits in memory.

    What every render offers is said in `rendered.Rendered`, what effects see of it in `effects.base.recorder.Recorder`.
    `hits` say where power falls; `shaded`, one sample per face and pixel, what is shaded, and `zeta` are its learned
    coordinates (vec4). The stages are coordinates -> sigma0 -> gains -> deposit -> paths -> image. `spacing_m` (range,
    azimuth) is that of the pixels. `gathered` are all coordinates that were looked up. By polarization, `deposited` is
    all power that was put into the image, and `before_image` the sum of it, on which the image stage acts.
    """

    def __init__(
        self,
        stage: Stage,
        view: View,
        hits: Hits,
        shape: tuple[int, int],
        polarizations: tuple[str, ...],
        effects: list[DeclaredEffect],
        nodes: wp.array | None = None,
    ) -> None:
        """`nodes`: one device array that several views share (CUDA); by default each view has its own."""
        self.stage, self.view, self.hits, self.shape = stage, view, hits, shape
        self.geometry: ViewGeometry = hits.geometry
        self.program = Program(stage.target.device)
        self.settings = {e.effect.name: e.settings for e in effects}
        self.nodes = self.program.array(stage.surface.nodes.size) if nodes is None else nodes
        self.effect_values = {e.effect.name: self.program.array(max(1, e.values.size)) for e in effects}
        self.nodes.assign(stage.nodes)
        self.set_parameters(None, {e.effect.name: e.values for e in effects})
        self.images: dict[str, wp.array] = {}
        self.sigma: dict[str, wp.array] = {}
        self._light: dict[str, wp.array] = {}
        self.gathered: list[Gathered] = []
        self.deposited: dict[str, list[Deposited]] = {}
        self.before_image: dict[str, wp.array] = {}
        self.layers: dict[str, wp.array] = {}
        self.remarks: list[str] = []
        self.recorded: dict[str, Any] = {}  # by effect: recorded for one polarization, used again for the next
        self._alone: _OneEffect | None = None
        self.shaded, self._sample = shading_samples(hits)
        fine = hits.grid.bins_per_pixel
        self.spacing_m = (hits.grid.spacing_m[0] * fine, hits.grid.spacing_m[1] * fine)
        pixel = [(side, "none") for side in self.spacing_m]
        along, across = (max(sizes) for sizes in zip(pixel, response_of(effects).cells(), strict=True))
        self.resolution_m, self.taper = (along[0], across[0]), (along[1], across[1])

        self._effects = effects
        at = self._at
        shaded = self.shaded
        pages = range(len(stage.node_maps))
        places = shaded.face, shaded.barycentric, shaded.point
        zeta, *self.more = (self.coordinates(*places, page) for page in pages)
        self.zeta = zeta
        for name in polarizations:
            code = Polarization[name]
            self._deposits = self.deposited[name] = []
            sigma = self.scatter(zeta, code)
            for effect, p in at("surface"):
                sigma = effect.scattering(self, p, zeta, sigma, code)
            self.sigma[name] = sigma
            image = self.program.array(shape[0] * shape[1], sum_into=True)
            self._term = "surface"
            self.collect(sigma, hits.weight, shaded.point, hits.pixel, image, self._sample, [shaded.face])
            self._light[name] = image
            for effect, p in at("path"):
                self._term = effect.name
                image = effect.paths(self, p, image, code)
            self.before_image[name] = image
            for effect, p in at("image"):
                image = effect.image(self, p, image)
            self.images[name] = image

    keeps_hits = True

    @property
    def whole(self) -> ViewRender:
        """The render with all hits of the view: this one."""
        return self

    def pieces(self) -> list[ViewRender]:
        """The renders that hold the view's hits: this one, after a forward run."""
        return [self]

    @property
    def affine(self) -> bool:
        """Whether the image stage takes weighted sums of images to the same sums, up to an image that it adds."""
        return all(effect.affine for effect, _ in self._at("image"))

    def light_gradient(self, polarization: str) -> np.ndarray:
        """What the last backward pass left at the image of single bounces, float64, shape (rows, cols)."""
        return self._light[polarization].grad.numpy().astype(float).reshape(self.shape)

    def lit(self, polarization: str) -> np.ndarray:
        """As `Rendered.lit`."""
        return self._light[polarization].numpy().reshape(self.shape) > 0

    def covered(self, polarization: str) -> np.ndarray:
        """As `Rendered.covered`."""
        return self.lit(polarization) & (self.coverage() >= COVERED)

    def coverage(self) -> np.ndarray:
        """Area of the lit surface in every pixel over the pixel's area, after a forward run, shape (rows, cols)."""
        (bin_rows, bin_cols), (rows, cols) = self.hits.grid.shape, self.shape
        filled = np.bincount(self.hits.pixel.numpy(), self.hits.weight.numpy().astype(float), bin_rows * bin_cols)
        if not self._moves:
            return filled.reshape(self.shape)
        device = self.program.device
        area: wp.array = wp.array(filled.astype(np.float32), dtype=float, device=device)
        image: wp.array = wp.zeros(rows * cols, dtype=float, device=device)
        inputs = [self.bins, self._shift, area]
        wp.launch(binning.slide_kernel, (rows, cols), inputs=inputs, outputs=[image], device=device)
        return image.numpy().reshape(self.shape).astype(float)

    def moved(self, rows: float, cols: float) -> dict[str, np.ndarray]:
        """beta0 by polarization, shape (rows, cols), float32, with all power moved by so many pixels before it is dealt
        to them. The hits' bins must be finer than pixels: within a bin power is spread evenly."""
        assert self._moves
        assign(self._offset, np.array([rows, cols]))
        try:
            return self.forward()
        finally:
            self._offset.zero_()

    @property
    def _moves(self) -> bool:
        """Whether bins are finer or wider than the pixels, or are moved."""
        return bool(self._at("position")) or self.hits.grid.shape != self.shape

    def _at(self, stage: str) -> list[tuple[Effect, wp.array]]:
        return [(e.effect, self.effect_values[e.effect.name]) for e in self._effects if e.effect.stage == stage]

    def coordinates(self, face: wp.array, barycentric: wp.array, points: wp.array, page: int = 0) -> wp.array:
        """Record the learned coordinates (vec4, shape (n,)) at places on the mesh, with the effects that act on them.

        `face` is int, `barycentric` vec2, and `points` vec3 [m] about the reference point, all of shape (n,).
        """
        zeta = self._gather(face, barycentric, page)
        for effect, p in self._at("surface"):
            zeta = effect.coordinates(self, p, zeta, points, page)
        return zeta

    def _gather(self, face: wp.array, barycentric: wp.array, page: int) -> wp.array:
        stage, nodes = self.stage, self.nodes
        n = face.shape[0]
        gathered = self.program.array(n, wp.vec4)
        hits = fill(shade.OnMesh, face=face, barycentric=barycentric)

        @cache
        def spread() -> Launch:  # when a gradient is asked for
            return Spread(stage, face, barycentric, page).adding(gathered.grad, nodes.grad)

        layouts = stage.surface.places[:, page * PAGE : (page + 1) * PAGE, 0]
        lean = self.program.device.is_cpu and not (layouts == Layout.TEXTURE).any()
        free = bool((layouts != Layout.HELD).any()) or page == 0
        self.program.launch(
            shade_lanes.gather_kernel if lean else shade.gather_kernel,
            n,
            [hits, stage.node_maps[page], nodes],
            [gathered],
            adjoint=lambda: spread().launch() if free else None,
            pieces=by_elements([face, barycentric, gathered]),
        )
        self.gathered.append(Gathered(face, barycentric, gathered, page))
        return gathered

    def collect(
        self,
        sigma: wp.array,
        weight: wp.array,
        points: wp.array,
        bins: wp.array,
        image: wp.array,
        sample: wp.array | None = None,
        faces: Sequence[wp.array] = (),
    ) -> None:
        """Record the gains on `sigma` and its deposit into `image`, an array that is zeroed before each run.

        `bins` are row * cols + col of `hits.grid`, `weight` is as in Hits. The power of a path effect goes the same
        way. `sample`: which of `sigma` each bin takes, where several take one. `faces`: of each bounce, as `sigma`.
        """
        for effect, p in self._at("gain"):
            sigma = effect.gain(self, p, sigma, points)
        self._collected = sigma, sample, points, faces
        if not self._moves:
            self._note(weight, bins, None)
            self._deposit(sigma, sample, weight, bins, image)
        else:
            self._deposit_moved(sigma, sample, weight, bins, image)

    def _deposit(
        self, sigma: wp.array, sample: wp.array | None, weight: wp.array, bins: wp.array, image: wp.array
    ) -> None:
        if self.program.device.is_cpu:
            self._deposit_on_cpu(sigma, sample, weight, bins, image)
            return
        if sample is not None:
            taken = self.program.array(bins.shape[0])
            self.program.launch(shade.take_kernel, bins.shape[0], [sample, sigma], [taken])
            sigma = taken
        first, _ = self._stretches(bins)
        self.program.launch(
            shade.deposit_kernel,
            first.shape[0] * LANES,
            [first, bins, weight, sigma, LANES],
            [image],
            adjoint=self._deposit_adjoint(sigma, weight, bins, image),
        )

    def _deposit_on_cpu(
        self, sigma: wp.array, sample: wp.array | None, weight: wp.array, bins: wp.array, image: wp.array
    ) -> None:
        """As `_deposit`: one launch takes sigma0 from the samples, too."""
        device = self.program.device

        @cache
        def back_to_samples() -> Launch:
            inputs = [bins, weight, sample, image.grad]
            return Launch(deposit_lanes.deposit_adjoint_kernel, 1, inputs, [sigma.grad], device)

        own = self._deposit_adjoint(sigma, weight, bins, image)
        (first, pieces), each = self._stretches(bins), deposit_lanes.EACH
        none = wp.empty(0, dtype=int, device=device)
        self.program.launch(
            deposit_lanes.deposit_kernel,
            -(-first.shape[0] // each),
            [first, bins, weight, none if sample is None else sample, sigma],
            [image],
            adjoint=own if sample is None else lambda: back_to_samples().launch(),
            pieces=pieces,
        )

    def _deposit_adjoint(
        self, sigma: wp.array, weight: wp.array, bins: wp.array, image: wp.array
    ) -> Callable[[], None]:
        @cache
        def adjoint() -> Launch:
            pieces = by_elements([bins, weight, sigma.grad])
            inputs, outputs = [bins, weight, image.grad], [sigma.grad]
            return Launch(shade.deposit_adjoint_kernel, sigma.shape[0], inputs, outputs, self.program.device, pieces)

        return lambda: adjoint().launch()

    def _stretches(self, bins: wp.array) -> tuple[wp.array, list[LaunchPiece]]:
        """Where stretches of one bin begin, and pieces of a launch over them; the hits' own are kept with the hits."""
        kept = self.hits.derived if bins is self.hits.pixel else {}
        if "stretches" not in kept:
            first = starts(bins)
            kept["stretches"] = first, by_stretches(first, bins, per_thread=deposit_lanes.EACH)
        found: tuple[wp.array, list[LaunchPiece]] = kept["stretches"]
        return found

    @cached_property
    def bins(self) -> Any:
        """The bins of the hits beside the pixels, as kernels take them."""
        (bin_rows, bin_cols), (rows, cols), fine = self.hits.grid.shape, self.shape, self.hits.grid.bins_per_pixel
        return fill(binning.Bins, bin_rows=bin_rows, bin_cols=bin_cols, bins_per_pixel=fine, rows=rows, cols=cols)

    @cached_property
    def _shift(self) -> wp.array:
        """How far (rows, columns) [pixels] the bins are moved: an offset (`moved`), and what position effects add."""
        movers = self._at("position")
        shift = self._offset = self.program.array(2, grad=bool(movers))
        for effect, p in movers:
            shift = effect.shift(self, p, shift)
        return shift

    def _deposit_moved(
        self, sigma: wp.array, sample: wp.array | None, weight: wp.array, bins: wp.array, image: wp.array
    ) -> None:
        """Record the deposit of bins finer or wider than the pixels, moved by what position effects say."""
        (bin_rows, bin_cols), (rows, cols) = self.hits.grid.shape, self.shape
        shift, device = self._shift, self.program.device
        self._note(weight, bins, shift)
        # where the shift alone changes, no hit is touched
        filled = self.program.array(bin_rows * bin_cols, sum_into=True)
        self._deposit(sigma, sample, weight, bins, filled)
        inputs = [self.bins, shift, filled]
        if not device.is_cpu or self.hits.grid.bins_per_pixel > deposit_lanes.WIDEST:
            self.program.launch(binning.slide_kernel, (rows, cols), inputs, [image])
            return

        @cache
        def adjoint() -> wp.Launch:
            return adjoint_of(binning.slide_kernel, (rows, cols), inputs, [image], device)

        self.program.launch(deposit_lanes.slide_kernel, rows, inputs, [image], adjoint=lambda: adjoint().launch())

    def _note(self, weight: wp.array, bins: wp.array, shift: wp.array | None) -> None:
        sigma, sample, points, faces = self._collected
        self._deposits.append(Deposited(sigma, sample, weight, bins, shift, points, faces, self._term))

    def scatter(self, zeta: wp.array, polarization: int, spectrum: wp.array | None = None) -> wp.array:
        """Record sigma0 of the hits for coordinates `zeta`; `spectrum` takes the place of the materials' own."""
        hits, stage = self.shaded, self.stage
        sigma = self.program.array(hits.count)
        spectra = stage.spectrum if spectrum is None else spectrum
        mesh = any(gathered.zeta is zeta for gathered in self.gathered)
        channel = Polarization(polarization)
        asked = models.ShadeRequest(self.program, stage, hits, channel, spectra, zeta, mesh, self.more)
        models.record(asked, sigma)
        return models.with_term(asked, sigma)

    def set_parameters(self, nodes: np.ndarray | None, effects: Mapping[str, np.ndarray] | None = None) -> None:
        """As `Rendered.set_parameters`."""
        if nodes is not None:
            assign(self.nodes, nodes)
        for name, values in (effects or {}).items():
            if values.size:
                assign(self.effect_values[name], values)

    def image_with(self, effect: DeclaredEffect, image: np.ndarray) -> np.ndarray:
        """As `Rendered.image_with`: only that effect is recorded, on a program of its own, which is kept."""
        settings = {effect.effect.name: effect.settings}
        if self._alone is None or self._alone.settings != settings:
            self._alone = _OneEffect(self, effect)
        return self._alone.image(effect.values, image)

    def forward(self) -> dict[str, np.ndarray]:
        """As `Rendered.forward`."""
        self.program.forward()
        return {name: image.numpy().reshape(self.shape).copy() for name, image in self.images.items()}


class _OneEffect:
    """An effect of the image stage recorded for one view by itself: its `settings`, and what it makes of images."""

    def __init__(self, render: ViewRender, effect: DeclaredEffect) -> None:
        self.settings = {effect.effect.name: effect.settings}
        alone = copy(render)
        alone.settings, alone.recorded, alone.layers = self.settings, {}, {}
        self._program = alone.program = Program(render.program.device)
        self._shape = render.shape
        self._values = alone.program.array(effect.values.size)
        self._given = alone.program.array(render.shape[0] * render.shape[1])
        self._result = effect.effect.image(alone, self._values, self._given)

    def image(self, values: np.ndarray, image: np.ndarray) -> np.ndarray:
        """The image, shape (rows, cols), float32, with the effect at these values of its parameters."""
        assign(self._values, values)
        assign(self._given, image.ravel())
        self._program.forward()
        return self._result.numpy().reshape(self._shape).copy()
