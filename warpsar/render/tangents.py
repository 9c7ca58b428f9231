"""Forward mode: how a view's images change with the nodes of its surface.

A hit's power depends on its own coordinates alone. So one reverse pass from the power of all hits, each with a seed of
1, gives every hit its own slopes. They fall into the image as the power itself does. The image stage then acts on these
tangents: exactly where it is affine, and otherwise by central differences of the image stage alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from scipy.sparse import coo_array, csc_array, csr_array, hstack

from warpsar.kernels import deposit_lanes
from warpsar.kernels import tangents as kernels
from warpsar.kernels.codes import PAGE, Layout
from warpsar.render.render import Deposited, Gathered, ViewRender
from warpsar.runtime.structs import fill
from warpsar.surface.spread import Spread

STEP = 1e-2  # of a log coordinate: the difference of image stages that are not affine, as in learning/problem.py
SMALLEST = 1e-6  # of a sparse column's largest element: what is smaller is left out


class Tangents:
    """Derivatives of one view's images to the surface's nodes.

    They hold for the parameters of the last forward run, which must have been one with `gradient`.
    """

    def __init__(self, render: ViewRender) -> None:
        self._render = render
        zetas = [g.zeta for g in render.gathered]
        self._slopes = {
            pol: render.program.part([d.sigma for d in deposits], zetas) for pol, deposits in render.deposited.items()
        }
        self._met = {pol: self._meetings(deposits) for pol, deposits in render.deposited.items()}
        self._launches: dict[tuple[str, bytes], tuple[wp.array, list[wp.Launch]]] = {}
        self._spreads: dict[int, Spread] = {}

    def _meetings(self, deposits: list[Deposited]) -> list[tuple[Deposited, Gathered]]:
        """Each deposit with the coordinates that its power depends on."""
        part = self._render.program.part
        return [(d, g) for d in deposits for g in self._render.gathered if part([d.sigma], [g.zeta]).runs]

    def _find_slopes(self, polarization: str) -> None:
        """d sigma / d zeta of every hit, into the gradients of `gathered`."""
        seeds = {d.sigma: 1.0 for d in self._render.deposited[polarization]}
        self._slopes[polarization].backward(seeds)

    def uniform(self, polarization: str, row: np.ndarray, count: int) -> wp.array:
        """d beta0 / d node before the image stage, for nodes of uniform layout, shape (count, pixels), on the device.

        `row` has the row of each of the surface's nodes, -1 for those that are left out. The array is used again.
        """
        key = polarization, row.tobytes()
        if key not in self._launches:
            self._launches[key] = self._record(polarization, row, count)
        found, launches = self._launches[key]
        found.zero_()
        if launches:
            self._find_slopes(polarization)
        for launch in launches:
            launch.launch()
        return found

    def _record(self, polarization: str, row: np.ndarray, count: int) -> tuple[wp.array, list[wp.Launch]]:
        render, stage = self._render, self._render.stage
        device = render.program.device
        found: wp.array = wp.zeros((count, render.shape[0] * render.shape[1]), dtype=float, device=device)
        places = stage.surface.places
        rows = np.where(places[:, :, 0] == Layout.UNIFORM, row[places[:, :, 1]], -1).astype(np.int32)
        pages = [np.ascontiguousarray(page) for page in np.split(rows, rows.shape[1] // PAGE, axis=1)]
        column: list[wp.array] = [wp.array(page, dtype=wp.vec4i, device=device) for page in pages]
        launches = []
        render.program.make_gradients()
        for d, g in self._met[polarization]:
            deposits = fill(
                kernels.Deposits,
                sample=d.sample,
                bin=d.bins,
                weight=d.weight,
                face=g.face,
                face_material=stage.face_material,
                column=column[g.page],
                slopes=g.zeta.grad,
            )
            launches += self._adding(d, deposits, found)
        return found, launches

    def _adding(self, d: Deposited, deposits: Any, found: wp.array) -> list[wp.Launch]:
        """The launches that add a deposit's slopes."""
        render = self._render
        device, n = render.program.device, d.bins.shape[0]
        if not device.is_cpu:
            if d.shift is None:
                return _recorded(kernels.tangent_kernel, n, [deposits], [found], device)
            return _recorded(kernels.moved_tangent_kernel, n, [render.bins, d.shift, deposits], [found], device)
        threads = -(-n // deposit_lanes.EACH)
        if d.shift is None:
            return _recorded(deposit_lanes.tangent_kernel, threads, [deposits], [found], device)
        places = sum(render.hits.grid.shape)
        placed = [wp.empty(places, dtype=dtype, device=device) for dtype in (int, wp.vec2)]
        inputs = [render.bins, *placed, deposits]
        return [
            *_recorded(deposit_lanes.place_kernel, 1, [render.bins, d.shift], placed, device),
            *_recorded(deposit_lanes.moved_tangent_kernel, threads, inputs, [found], device),
        ]

    def matrix(self, polarization: str) -> csc_array:
        """d beta0 / d node before the image stage, shape (pixels, nodes), float64, whatever the layouts."""
        render = self._render
        shape = render.shape[0] * render.shape[1], render.stage.surface.nodes.size
        self._find_slopes(polarization)
        found = csc_array(shape, dtype=float)
        for d, g in self._met[polarization]:
            slopes = g.zeta.grad.numpy().astype(float)
            if id(g) not in self._spreads:
                self._spreads[id(g)] = Spread(render.stage, g.face, g.barycentric, g.page)
            hit, share, target = self._spreads[id(g)].entries()
            entry, k = np.nonzero(target >= 0)
            at = hit[entry], target[entry, k]
            of_nodes = coo_array((share[entry] * slopes[hit[entry], k], at), (len(slopes), shape[1]))
            found = found + self._falls(d) @ of_nodes
        return csc_array(found)

    def powers(self, polarization: str, kind: np.ndarray, count: int) -> np.ndarray:
        """beta0 before the image stage that samples of each of `count` kinds bring, shape (count + 1, pixels), float32.

        `kind`: of each shading sample, shape (n,), -1 for none. The last row is what comes over several surfaces.
        """
        first, *others = self._render.deposited[polarization]
        mine = np.flatnonzero(kind >= 0)
        sigma = first.sigma.numpy().astype(float)
        of_kinds = coo_array((sigma[mine], (mine, kind[mine])), (sigma.size, count + 1))
        found = (self._falls(first) @ of_kinds).toarray()
        for d in others:
            found[:, count] += self._falls(d) @ d.sigma.numpy().astype(float)
        return np.asarray(found.T, np.float32)

    def _falls(self, d: Deposited) -> csr_array:
        """Where the power of each sample falls, shape (pixels, samples)."""
        rows, cols = self._render.shape
        bins, weight = d.bins.numpy(), d.weight.numpy().astype(float)
        sample = np.arange(bins.size) if d.sample is None else d.sample.numpy()
        shape = rows * cols, d.sigma.shape[0]
        if d.shift is None:
            return coo_array((weight, (bins, sample)), shape).tocsr()
        grid, (down, right) = self._render.hits.grid, d.shift.numpy().astype(float)
        fine, parts = grid.bins_per_pixel, []
        row, col = np.divmod(bins, grid.shape[1])
        row = (2 * row - grid.shape[0] + rows * fine) * 0.5 / fine + down
        col = (2 * col - grid.shape[1] + cols * fine) * 0.5 / fine + right
        for a in range(2):
            for b in range(2):
                r, c = np.floor(row).astype(int) + a, np.floor(col).astype(int) + b
                share = _overlap(row, 1.0 / fine, r) * _overlap(col, 1.0 / fine, c) * weight
                ok = (share > 0) & (r >= 0) & (r < rows) & (c >= 0) & (c < cols)
                parts.append((share[ok], r[ok] * cols + c[ok], sample[ok]))
        share, pixel, sample = (np.concatenate(each) for each in zip(*parts, strict=True))
        return coo_array((share, (pixel, sample)), shape).tocsr()

    def through_image(self, polarization: str, tangents: wp.array) -> np.ndarray:
        """`through_image` along each of `tangents`, shape (n, pixels), float32."""
        return through_image(self._render, polarization, np.asarray(tangents.numpy()))

    def sparse_through_image(self, polarization: str, columns: csc_array) -> csc_array:
        """`through_image` of sparse columns, shape (pixels, n), in pieces; elements under `SMALLEST` are left out."""
        render = self._render
        if render.images[polarization] is render.before_image[polarization]:
            return columns
        found = []
        for first in range(0, columns.shape[1], 64):
            dense = columns[:, first : first + 64].toarray().T.astype(np.float32)
            given: wp.array = wp.array(dense, dtype=float, device=render.program.device)
            moved = self.through_image(polarization, given)
            moved[np.abs(moved) <= SMALLEST * np.abs(moved).max(axis=1, keepdims=True)] = 0.0
            found.append(csc_array(moved.T.astype(float)))
        return csc_array(hstack(found)) if found else columns


def _recorded(kernel: wp.Kernel, dim: int, inputs: list[Any], outputs: list[Any], device: wp.Device) -> list[wp.Launch]:
    """The launch, to be replayed; none without threads."""
    launch = wp.launch(kernel, dim, inputs=inputs, outputs=outputs, device=device, record_cmd=True)
    return [] if launch is None else [launch]


def through_image(render: ViewRender, polarization: str, moves: np.ndarray) -> np.ndarray:
    """The image stage's derivative along each of `moves`, images before it, shape (n, pixels), float32.

    It leaves images that stand for nothing: bring them up to date from `before_image` on.
    """
    before, image = render.before_image[polarization], render.images[polarization]
    if image is before:
        return moves
    part = render.program.part([image], [before])
    on_host = render.program.device.is_cpu  # its arrays are NumPy's: a copy by Warp takes longer than a blur
    standing = before.numpy().copy()
    given, made = (before.numpy(), image.numpy()) if on_host else (None, None)

    def after(values: np.ndarray) -> np.ndarray:
        if given is None:
            before.assign(values)
        else:
            given[:] = values
        part.forward()
        return image.numpy() if made is None else made

    found = np.empty(moves.shape, np.float32)
    if render.affine:
        added = after(np.zeros_like(standing)).copy()
        for k, move in enumerate(moves):
            np.subtract(after(move), added, out=found[k])
    else:
        for k, move in enumerate(moves):
            above = after(standing + STEP * move).astype(float)
            found[k] = (above - after(standing - STEP * move)) / (2.0 * STEP)
    before.assign(standing)
    return found


def _overlap(first: np.ndarray, width: float, pixel: np.ndarray) -> np.ndarray:
    """As in kernels/binning.py."""
    return np.maximum(np.minimum(first + width, pixel + 1) - np.maximum(first, pixel), 0.0) / width
