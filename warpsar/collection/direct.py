"""Direct images: each scatterer times the system's response, deposited on a fine grid and brought through the band.

An image is made in tiles, as large as memory allows. The response ends `MARGIN` cells from a point, and a tile's grid
is wider than the tile by that: so tiles are the same image as the whole, to the rounding of sums.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy import fft

from warpsar.coherent.patches import PatchesOnDevice
from warpsar.coherent.records import upload
from warpsar.coherent.sweep import POLARIZATIONS
from warpsar.collection import places
from warpsar.collection.bodies import TILE_BYTES, Bodies
from warpsar.collection.history import beam_of, spread_transform_at
from warpsar.collection.plan import Plan
from warpsar.collection.response import band_weights
from warpsar.collection.scatterers import FAR_FIELD, Scatterers, Stream, rough_sight
from warpsar.collection.slc import Slc
from warpsar.errors import InputError
from warpsar.kernels import collection as kernels
from warpsar.measured.ground import pixel_centres
from warpsar.runtime import threads
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import Grid

F64 = NDArray[np.float64]
MARGIN = 32
"""Cells about a point at which its response ends. It fades over the last quarter."""
_BORDER = 8
"""Samples of a tile's grid beyond the response: deposits that are cut off there are outside of it."""
SAMPLE_BYTES = 16
"""Of a sample of a tile's grid, in one polarization, with what the response makes of it."""
_COUNTERS = 4096
_ROWS_TOGETHER = 256
"""Rows that go through the response together on the CPU."""


def refuse_direct(plan: Plan, name: str) -> None:
    """Raise InputError where the system's response is not one for the whole image."""
    why = None
    if plan.track.straight is None:
        why = "a track that is not straight, or two antennas"
    elif plan.table.squint_deg:
        why = "a squint"
    elif plan.table.velocity_m_s:
        why = "a moving object"
    elif plan.table.azimuth_ambiguities:
        why = "azimuth_ambiguities"
    elif plan.pattern is not None and plan.stripmap:
        why = "a measured pattern along a stripmap"
    elif plan.table.errors is not None and plan.table.errors.of_pulses:
        why = "errors of track, timing or frequency"
    elif plan.stripmap and plan.phase_error is not None:
        why = "a phase error along a stripmap"
    elif (cells := plan.smeared_cells) > MARGIN / 2:
        why = f"a phase error that moves power by {cells:.3g} cells"
    if why is not None:
        raise InputError(f'{name}: collection.focus: found "direct" with {why}; must be "backprojection" there')


@dataclass(frozen=True)
class _Axis:
    """One axis of a direct image: how fine its grid is, and the system's response."""

    first_m: float
    """Of the image's first pixel."""
    step_m: float
    every: int
    """Samples from pixel to pixel."""
    taps: NDArray[np.complex64]
    """From the furthest sample before a pixel to the furthest one behind it."""

    @classmethod
    def of(
        cls, pixels_m: F64, spacing_m: float, cell_m: float, at: F64, weight: F64, phase: F64 | None = None
    ) -> _Axis:
        """`at`: frequencies [1/m] of the samples with their `weight` and `phase` [rad], ascending."""
        every = int(np.ceil(spacing_m / (0.5 * cell_m)))
        step = spacing_m / every
        half = int(np.ceil(MARGIN * cell_m / step))
        count = fft.next_fast_len(16 * half)
        own = fft.fftfreq(count, step)
        # The mean over each step of frequency: the ends of the band seldom lie between two.
        total = np.concatenate([[0.0], np.cumsum(0.5 * (weight[1:] + weight[:-1]) * np.diff(at))])
        reach = 0.5 / (count * step)
        inside = (np.interp(own + reach, at, total) - np.interp(own - reach, at, total)) / (2.0 * reach)
        power = float((inside**2).sum() / inside.sum() ** 2) * count * step
        some = inside != 0.0
        inside[some] /= _transform(count)[some] * inside.sum() * np.sqrt(power) / count
        response = fft.ifft(inside if phase is None else inside * np.exp(1j * np.interp(-own, at, phase)))
        order = np.arange(-half, half + 1)
        end = np.clip((np.abs(order) / half - 0.75) / 0.25, 0.0, 1.0)
        # What lies behind a pixel comes to it through the response before a point.
        taps = (response[-order] * np.cos(0.5 * np.pi * end) ** 2).astype(np.complex64)
        return cls(float(pixels_m[0]), step, every, taps)

    @property
    def half(self) -> int:
        return len(self.taps) // 2

    @property
    def pad(self) -> int:
        """Samples of a tile's grid before its first pixel."""
        return self.half + _BORDER

    def samples(self, pixels: int) -> int:
        """Of the grid of so many pixels."""
        return (pixels - 1) * self.every + 1 + 2 * self.pad

    def start_m(self, pixel: int) -> float:
        """Of the grid of a tile that begins at a pixel."""
        return self.first_m + (pixel * self.every - self.pad) * self.step_m


@cache
def _transform(count: int) -> F64:
    """Of the deposit's weights, at the frequencies of a transform of so many samples."""
    return spread_transform_at(fft.fftfreq(count))


@dataclass(frozen=True)
class DeviceScatterers:
    """Scatterers on a device, as the middle of the track sees them."""

    point: wp.array
    """(n,), vec3d, about the reference point [m]."""
    amplitude: wp.array
    """(n, columns), vec2."""
    columns: tuple[int, ...]
    """Of each polarization."""
    scale: float
    """Of the amplitudes, so that a scatterer's power is its RCS."""


Tile = tuple[slice, slice]
"""Rows and columns of an image."""
Seen = Callable[[Any, F64, F64], Iterable[DeviceScatterers]]
"""Of a tile: its frame, and the least and the largest range and azimuth (2,) [m] from which something reaches it."""


def direct(
    plan: Plan,
    scatterers: Scatterers | Stream,
    polarizations: tuple[str, ...],
    grid: Grid,
    device: wp.Device,
    tile_bytes: int = TILE_BYTES,
    rough: Seen | None = None,
) -> Slc:
    """Each scatterer at its slant range and azimuth, times the response of band and aperture.

    `rough`: those of rough faces, where `scatterers` has none. Scatterers of a stream are made again for each tile.
    """
    columns = tuple(range(len(polarizations)))

    def seen(frame: Any, low: F64, high: F64) -> Iterator[DeviceScatterers]:
        for part in scatterers.parts:
            values = np.ascontiguousarray(part.amplitude.T).view(np.float32).reshape(-1, len(columns), 2)
            place, amplitude = upload(part.point, wp.vec3d, device), upload(values, wp.vec2, device)
            yield DeviceScatterers(place, amplitude, columns, 1.0)
        if rough is not None:
            yield from rough(frame, low, high)

    return image_of_seen(plan, seen, polarizations, grid, device, tile_bytes)


def direct_of_rough(bodies: Bodies, plan: Plan, progress: Any = None) -> Slc:
    """The direct image of a world with the term "rough" alone. Its scatterers never leave the device."""
    world, seen = bodies.world, rough_of(bodies, plan, progress)
    return image_of_seen(
        plan, seen, tuple(world.radar.polarizations), world.grid, bodies.device, bodies.tile_bytes
    )  # fmt: skip


def rough_of(bodies: Bodies, plan: Plan, progress: Any = None) -> Seen:
    """The scatterers of rough faces that reach a tile, placed and seen on the device when they are asked for.

    `progress` counts tiles, by fractions.
    """
    world, body, patches = bodies.world, bodies.of(plan), bodies.patches(plan)
    worker, radar = bodies.rough_worker(plan), rough_sight(plan, body, plan.middle)
    columns = tuple(POLARIZATIONS.index(name[::-1]) for name in world.radar.polarizations)

    def seen(frame: Any, low: F64, high: F64) -> Iterator[DeviceScatterers]:
        there = within(patches, frame, low, high)
        left = 1.0
        for part in places.rough_seen(worker, radar, there, slice(0, len(there)), bodies.together):
            yield DeviceScatterers(part.placed.site, part.amplitude, columns, FAR_FIELD)
            if progress is not None:
                progress.update(len(part.placed) / len(there))
            left -= len(part.placed) / len(there)
        if progress is not None:
            progress.update(left)

    return seen


def within(patches: PatchesOnDevice, frame: Any, low: F64, high: F64) -> PatchesOnDevice:
    """The patches that reach a tile."""
    count, device = patches.arrays.start.shape[0], patches.device
    reaches = wp.empty(count, dtype=wp.uint8, device=device)
    inputs = [frame, patches.arrays, wp.vec2d(*low), wp.vec2d(*high)]
    wp.launch(kernels.patch_reaches_kernel, count, inputs=inputs, outputs=[reaches], device=device)
    return patches.chosen(reaches.numpy() != 0)


class DirectImage:
    """The image of one view, and its tiles."""

    def __init__(self, plan: Plan, polarizations: tuple[str, ...], grid: Grid, device: wp.Device) -> None:
        self.plan, self.polarizations, self.grid, self.device = plan, polarizations, grid, device
        self.range_m, self.azimuth_m = pixel_centres(grid.shape, grid.spacing_m, (1, 1))
        self.axes = _axes(plan, self.range_m, self.azimuth_m, grid)
        self._beam = beam_of(plan, device)
        self._calibrated = 1.0 if plan.pattern is None else float(plan.beam_gain[plan.middle])
        """As a backprojected image is: over the antenna's amplitude toward the reference point."""

    def tiles(self, tile_bytes: int) -> list[Tile]:
        """Rows and columns of the tiles: as few as the memory of one allows, and of much the same size."""
        shape, cuts = self.grid.shape, [1, 1]
        while True:
            sizes = [-(-n // cut) for n, cut in zip(shape, cuts, strict=True)]
            samples = [axis.samples(size) for axis, size in zip(self.axes, sizes, strict=True)]
            if SAMPLE_BYTES * len(self.polarizations) * samples[0] * samples[1] <= tile_bytes or sizes == [1, 1]:
                break
            cut = int(samples[1] >= samples[0])
            cuts[cut if sizes[cut] > 1 else 1 - cut] += 1
        parts = [[slice(i, min(i + n, end)) for i in range(0, end, n)] for n, end in zip(sizes, shape, strict=True)]
        return [(rows, columns) for rows in parts[0] for columns in parts[1]]

    def samples(self, tile: Tile) -> tuple[int, int]:
        """Rows and columns of a tile's grid."""
        rows, columns = (axis.samples(some.stop - some.start) for axis, some in zip(self.axes, tile, strict=True))
        return rows, columns

    def reach(self, tile: Tile) -> tuple[F64, F64]:
        """Least and largest range and azimuth from which something reaches a tile, (2,) [m] each."""
        start = np.array([axis.start_m(some.start) for axis, some in zip(self.axes, tile, strict=True)])
        steps = [axis.step_m * n for axis, n in zip(self.axes, self.samples(tile), strict=True)]
        return start, start + steps

    def made(self, tile: Tile, seen: Seen) -> tuple[NDArray[np.complex64], int]:
        """A tile, (polarizations, rows, columns), and how many scatterers lie in it."""
        device = self.device
        rows, columns = self.samples(tile)
        out = wp.zeros((len(self.polarizations), rows, columns + columns % 2), dtype=wp.vec2, device=device)
        counts = wp.zeros(_COUNTERS, dtype=int, device=device)
        frame = self.frame(tile)
        for one in seen(frame, *self.reach(tile)):
            chosen = upload(np.array(one.columns, np.int32), int, device)
            inputs = [frame, one.point, one.amplitude, chosen, one.scale / self._calibrated]
            outputs = [out, counts]
            wp.launch(
                kernels.image_deposit_kernel, one.point.shape[0], inputs=inputs, outputs=outputs, device=device
            )  # fmt: skip
        pixels = [some.stop - some.start for some in tile]
        return responded(out, self.axes, pixels), int(counts.numpy().sum())

    def frame(self, tile: Tile) -> Any:
        """Where the kernel finds a scatterer's row and column in a tile, and its phase."""
        plan, centre = self.plan, self.plan.track.centre().receiver_m[0]
        frame: Any = kernels.ImageFrame()
        frame.place = wp.vec3d(*(plan.slant_range_m * plan.geometry.s))
        frame.slant = plan.slant_range_m
        frame.centre = wp.vec3d(*centre)
        frame.centre_slant = float(np.linalg.norm(centre))
        frame.u = wp.vec3d(*plan.geometry.u)
        frame.start = wp.vec2d(*(axis.start_m(some.start) for axis, some in zip(self.axes, tile, strict=True)))
        frame.step = wp.vec2d(*(axis.step_m for axis in self.axes))
        core = [
            axis.pad - 0.5 * axis.every + np.array([0.0, axis.every * (some.stop - some.start)])
            for axis, some in zip(self.axes, tile, strict=True)
        ]
        frame.core = wp.vec4d(*np.concatenate(core))
        frame.turns_per_metre = 2.0 * plan.centre_hz / SPEED_OF_LIGHT
        frame.stripmap = int(plan.stripmap)
        frame.beam = self._beam
        frame.receiver = wp.vec3d(*plan.track.receiver_m[plan.middle])
        frame.pulse = plan.middle
        return frame


def image_of_seen(
    plan: Plan,
    seen: Seen,
    polarizations: tuple[str, ...],
    grid: Grid,
    device: wp.Device,
    tile_bytes: int = TILE_BYTES,
) -> Slc:
    """The image of scatterers that are on the device, tile by tile."""
    made = DirectImage(plan, polarizations, grid, device)
    whole = np.empty((len(polarizations), *grid.shape), np.complex64)
    count = 0
    for tile in made.tiles(tile_bytes):
        whole[:, tile[0], tile[1]], mine = made.made(tile, seen)
        count += mine
    return Slc(plan, dict(zip(polarizations, whole, strict=True)), made.range_m, made.azimuth_m, count)


def responded(grid: wp.array, axes: tuple[_Axis, _Axis], pixels: list[int]) -> NDArray[np.complex64]:
    """A tile's grid (polarizations, rows, columns) through the system's response, at its pixels: by sums on CUDA, by
    FFT on the CPU."""
    device = grid.device
    assert device is not None
    if device.is_cpu:
        return _by_fft(np.ascontiguousarray(grid.numpy()).view(np.complex64)[..., 0], axes, pixels)
    for along in (1, 0):
        axis, shape = axes[along], list(grid.shape)
        shape[1 + along] = pixels[along]
        out = wp.empty(tuple(shape), dtype=wp.vec2, device=device)
        taps = upload(axis.taps.view(np.float32).reshape(-1, 2), wp.vec2, device)
        inputs = [grid, _BORDER, axis.every, taps, along]
        wp.launch(kernels.respond_kernel, out.shape, inputs=inputs, outputs=[out], device=device)
        grid = out
    found: NDArray[np.complex64] = np.ascontiguousarray(grid.numpy()).view(np.complex64)[..., 0]
    return found


def _by_fft(grid: NDArray[np.complex64], axes: tuple[_Axis, _Axis], pixels: list[int]) -> NDArray[np.complex64]:
    for along in (1, 0):
        axis = axes[along]
        length = fft.next_fast_len(grid.shape[1 + along])
        # A sum over taps from a sample on is a product with the conjugate of their transform's mirror image.
        padded = np.zeros(length, np.complex64)
        padded[-np.arange(len(axis.taps)) % length] = axis.taps
        weights = fft.fft(padded)
        kept = slice(_BORDER, _BORDER + (pixels[along] - 1) * axis.every + 1, axis.every)
        lines = grid if along == 1 else grid.swapaxes(1, 2)
        out = np.empty((*lines.shape[:2], pixels[along]), np.complex64)
        for p in range(len(lines)):
            for first in range(0, lines.shape[1], _ROWS_TOGETHER):
                some = slice(first, first + _ROWS_TOGETHER)
                block = fft.fft(lines[p, some], length, axis=1, workers=threads.thread_count())
                block *= weights
                block = fft.ifft(block, axis=1, workers=threads.thread_count(), overwrite_x=True)
                out[p, some] = block[:, kept]
        grid = out if along == 1 else out.swapaxes(1, 2)
    return grid


def _axes(plan: Plan, range_m: F64, azimuth_m: F64, grid: Grid) -> tuple[_Axis, _Axis]:
    """Both axes: the band's frequencies about its centre, and those of the aperture."""
    number: F64 = np.arange(plan.frequencies, dtype=np.float64) - 0.5 * (plan.frequencies - 1)
    band = 2.0 * number * plan.step_hz / SPEED_OF_LIGHT
    weights = band_weights(plan.windows[0], plan.frequencies)
    rows = _Axis.of(range_m, grid.spacing_m[0], plan.cells_m[0], *_edged(band, weights))
    along = 2.0 * plan.centre_hz / SPEED_OF_LIGHT * (plan.track.towards() @ plan.geometry.u)
    order = np.argsort(along)
    at, weights = _edged(along[order], plan.azimuth_weights[order])
    turn = plan.phase_error
    if turn is not None:
        turn = turn[order]
        turn = np.concatenate([np.full(2, turn[0]), turn, np.full(2, turn[-1])])
    columns = _Axis.of(azimuth_m, grid.spacing_m[1], plan.cells_m[1], at, weights, turn)
    return rows, columns


def _edged(at: F64, weight: F64) -> tuple[F64, F64]:
    """With both ends half a step further out, where the band ends."""
    step = np.diff(at)[[0, -1]]
    tiny = 1e-6 * step
    low, high = at[0] - 0.5 * step[0], at[-1] + 0.5 * step[1]
    return (
        np.concatenate([[low - tiny[0], low], at, [high, high + tiny[1]]]),
        np.concatenate([[0.0, weight[0]], weight, [weight[-1], 0.0]]),
    )
