"""Backprojection onto a plane grid: fast ways to the image of `focus`, each with what it loses stated.

The way from a pulse to the pixels of a block is expanded about the block's middle, and the sum is in float32. On the
CPU a long aperture is first cut into parts. The image of a part, less the phase of its middle pulse, is narrow in
azimuth: it is made on a coarse grid and interpolated onto the fine one (fast factorised backprojection in one stage:
Yegulalp, IEEE Radar Conference 1999).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from warpsar.formats.base.data import PhaseHistory
from warpsar.kernels.backproject_plane import (
    COLUMNS,
    EACH,
    ROWS,
    TAPS,
    PlaneGrid,
    WayExpansion,
    backproject_plane_kernel,
    demodulate_kernel,
    expand_kernel,
    refine_kernel,
)
from warpsar.measured.focus import (
    PROFILE_BYTES,
    centred,
    cross_range_cosine,
    focus,
    profile_bins,
    uploaded,
)
from warpsar.runtime import console, devices, threads
from warpsar.runtime.structs import fill
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.taper import taper

_BLOCKS_PER_TASK = 1 << 6
_PULSES_TOGETHER = 256
"""Pulses whose profiles stay in a GPU's cache."""
_EXPANSION_BYTES = 2**30
EXPANDED_TURNS = 2e-5
"""Of phase, which an expansion may leave out at the corners of a block: 79 dB there, and 90 dB in the mean."""
_SIZES = ((ROWS, COLUMNS), (ROWS // 2, COLUMNS // 2), (ROWS // 4, COLUMNS // 4))
"""Of blocks: near ranges and large pixels need small ones, and an expansion costs as much as ten pixels."""
FLAT_M = 1e-6
"""How far a plane grid may be from one in the frame of a history [m]."""
_OVERSAMPLING = 2.0
"""Of a coarse image: `TAPS` taps then hold it to 72 dB."""
_BETA = 7.0
"""Of the Kaiser window of the taps: 56 dB are left at 11, and 70 at 6."""
_REFINED = 2.0
"""What a pixel costs to interpolate, over what a pulse costs it."""


def focus_plane(
    history: PhaseHistory,
    plane: Plane,
    *,
    reference_point_m: np.ndarray,
    window_range: str = "none",
    window_azimuth: str = "none",
    device: str | None = None,
) -> np.ndarray:
    """The complex64 image (rows, columns) of all pulses on a plane grid, as `focus` makes it.

    The way is expanded to second order about the middles of blocks of pixels, and summed in float32, where that is as
    good as the exact way: `block_size`. Elsewhere, and where a swath does not reach, it is `focus` itself.
    On the CPU long apertures are cut into parts: 70 dB against the exact way.
    """
    target = devices.resolve_device(device)
    own = plane.in_frame(history)
    size = None if own is None else block_size(history, own)
    if own is None or size is None or not _reached(history, own.ends()):
        (image,) = focus(
            history,
            plane.points(),
            reference_point_m=reference_point_m,
            window_range=window_range,
            window_azimuth=window_azimuth,
            device=device,
        )
        return image
    cosine = cross_range_cosine(history, reference_point_m)
    weights = taper(window_azimuth, centred(cosine))
    total: wp.array = wp.zeros(plane.shape, dtype=wp.vec2, device=target)
    devices.load_kernels(target, alone=[backproject_plane_kernel(EACH, True), expand_kernel])
    part = part_of(history, own) if target.is_cpu else None
    most = max(1, PROFILE_BYTES // (8 * profile_bins(history)))
    step = min(_PULSES_TOGETHER, most) if part is None or part.pulses > most else part.pulses
    pulses = np.arange(len(weights))
    with console.progress(len(pulses), "focusing", "pulse") as bar:
        for first in range(0, len(pulses), step):
            chosen = pulses[first : first + step]
            there = uploaded(history, chosen, weights[chosen], window_range, target)
            if part is None or part.pulses > most:
                add_blocks(grid_of(own, *size), there, total, target)
            else:
                _add_part(own, part, size, there, total, target)
            bar.update(chosen.size)
    scale = np.float32(1.0 / weights.sum())
    return np.ascontiguousarray(total.numpy()).view(np.complex64)[..., 0] * scale


def block_size(history: PhaseHistory, plane: Plane) -> tuple[int, int] | None:
    """Rows and columns of the largest blocks that leave out no more than `EXPANDED_TURNS`; None where none does."""
    for size in _SIZES:
        if plane.expanded_turns(history, *size) <= EXPANDED_TURNS:
            return size
    return None


@dataclass(frozen=True)
class _Part:
    """A part of an aperture: its pulses, and how many fine columns a coarse one stands for."""

    pulses: int
    every: int


def part_of(history: PhaseHistory, plane: Plane) -> _Part | None:
    """The parts that take the least work; None where none takes less than the whole aperture at once.

    The phase of a pulse less that of its part's middle turns along a row by 2 f / c times the change of the line of
    sight. Of the ends of the band it turns by half the band, 2 B / 2 c, times the line of sight itself. Both together
    are the width of the part's spectrum.
    """
    count, columns = history.position_m.shape[0], plane.shape[1]
    places = [history.position_m if history.transmitter_m is None else history.transmitter_m, history.position_m]
    points = np.concatenate([plane.ends(), plane.ends().mean(axis=0)[None]])
    along = np.zeros((count, len(points)))
    for place in places:
        to = points[None] - place[:, None]
        along += 0.5 * (to @ plane.column_m) / np.linalg.norm(to, axis=2)
    step = history.frequency_step_hz * history.samples.shape[0]
    turns = 2.0 * (history.frequency_start_hz + step).max() / SPEED_OF_LIGHT
    ends = float(step.max()) / SPEED_OF_LIGHT * float(np.abs(along).max())
    best, least = None, 0.9
    for pulses in (16, 32, 64, 128, 256, 512):
        if pulses > count // 2:
            break
        wide = 0.0
        for first in range(0, count, pulses):
            mine = along[first : first + pulses]
            wide = max(wide, float(np.abs(mine - mine[len(mine) // 2]).max()))
        every = min(int(1.0 / (_OVERSAMPLING * 2.0 * max(wide * turns + ends, 1e-12))), columns)
        work = (1.0 / every + (TAPS + 1) / columns) + _REFINED / pulses if every > 1 else 1.0
        if work < least:
            best, least = _Part(pulses, every), work
    return best


def _add_part(
    plane: Plane, part: _Part, size: tuple[int, int], pulses: Any, image: wp.array, device: wp.Device
) -> None:
    """Add the image of a part of the aperture, by a coarse grid. `size`: of blocks."""
    rows, columns = plane.shape
    count = -(-columns // part.every) + TAPS
    start = -(TAPS // 2 - 1)  # the coarse column that lies this far from the first fine one
    coarse = replace(
        plane,
        origin_m=plane.origin_m + start * part.every * plane.column_m,
        column_m=part.every * plane.column_m,
        shape=(rows, count),
    )
    made, middle = wp.zeros(coarse.shape, dtype=wp.vec2, device=device), pulses.position.shape[0] // 2
    narrow = grid_of(coarse, size[0], 1)  # blocks as small as fine ones, about which the way may be expanded
    add_blocks(narrow, pulses, made, device)
    wp.launch(demodulate_kernel, coarse.shape, inputs=[narrow, pulses, middle], outputs=[made], device=device)
    base, rest = np.divmod(np.arange(columns), part.every)
    at = np.arange(TAPS) - (TAPS // 2 - 1) - (rest / part.every)[:, None]
    window = np.i0(_BETA * np.sqrt(np.maximum(1.0 - (2.0 * at / TAPS) ** 2, 0.0))) / np.i0(_BETA)
    weights: wp.array = wp.array((np.sinc(at) * window).astype(np.float32), dtype=float, device=device)
    first_column: wp.array = wp.array(base.astype(np.int32), dtype=int, device=device)
    fine = grid_of(plane, *size)
    blocks, lanes = _blocks(fine), fine.block_rows * fine.block_columns
    together = _BLOCKS_PER_TASK * ROWS * COLUMNS // lanes if device.is_cpu else blocks
    one = _alone(pulses, middle)

    def add(first: int) -> None:
        some = min(together, blocks - first)
        expansion = wp.empty((some, 1), dtype=WayExpansion, device=device)
        wp.launch(expand_kernel, (some, 1), inputs=[fine, first, one], outputs=[expansion], device=device)
        inputs = [fine, first, expansion, 0, made, first_column, weights]
        wp.launch(refine_kernel, some * lanes, inputs=inputs, outputs=[image], device=device)

    for _ in threads.ordered([partial(add, first) for first in range(0, blocks, together)], device):
        pass


def _alone(pulses: Any, index: int) -> Any:
    """One of some pulses."""
    made = type(pulses)()
    for name in ("position", "sender", "reference_range", "turns_per_metre", "bins_per_metre", "half_swath"):
        values = getattr(pulses, name)
        setattr(made, name, values[index : index + 1] if values.shape[0] else values)
    made.profile = pulses.profile[index : index + 1]
    return made


def grid_of(plane: Plane, rows: int = ROWS, columns: int = COLUMNS) -> Any:
    """As the kernels know it, in blocks of so many pixels."""
    places = {"origin": plane.origin_m, "row": plane.row_m, "column": plane.column_m}
    return fill(
        PlaneGrid,
        **{name: wp.vec3d(*at) for name, at in places.items()},
        rows=plane.shape[0],
        columns=plane.shape[1],
        block_rows=rows,
        block_columns=columns,
    )


def _blocks(grid: Any) -> int:
    return -(-grid.rows // grid.block_rows) * -(-grid.columns // grid.block_columns)


def add_blocks(
    grid: Any, pulses: Any, image: wp.array, device: wp.Device, each: int = EACH, cubic: bool = True
) -> None:
    """Add what pulses hold to the blocks of a plane grid, so many at a time as memory allows."""
    kernel, count, blocks = backproject_plane_kernel(each, cubic), pulses.position.shape[0], _blocks(grid)
    lanes = grid.block_columns * grid.block_rows // each
    together = max(1, _EXPANSION_BYTES // (count * 48))
    if device.is_cpu:
        together = min(together, _BLOCKS_PER_TASK * ROWS * COLUMNS // (grid.block_rows * grid.block_columns))

    def add(first: int) -> None:
        some = min(together, blocks - first)
        expansion = wp.empty((some, count), dtype=WayExpansion, device=device)
        wp.launch(expand_kernel, (some, count), inputs=[grid, first, pulses], outputs=[expansion], device=device)
        inputs = [grid, first, expansion, pulses.profile]
        wp.launch(kernel, some * lanes, inputs=inputs, outputs=[image], device=device, block_dim=lanes)

    for _ in threads.ordered([partial(add, first) for first in range(0, blocks, together)], device):
        pass


@dataclass(frozen=True)
class Plane:
    """Pixels of a plane at origin + i row + j column, world or the frame of a history [m]."""

    origin_m: np.ndarray
    row_m: np.ndarray
    column_m: np.ndarray
    shape: tuple[int, int]

    def points(self) -> np.ndarray:
        """(rows, columns, 3)."""
        i, j = (np.arange(n)[..., None] for n in self.shape)
        return self.origin_m + (i * self.row_m)[:, None] + (j * self.column_m)[None]

    def ends(self) -> np.ndarray:
        """The corner pixels, (4, 3)."""
        last = [n - 1 for n in self.shape]
        return np.array(
            [self.origin_m + i * self.row_m + j * self.column_m for i in (0, last[0]) for j in (0, last[1])]
        )

    def in_frame(self, history: PhaseHistory) -> Plane | None:
        """The same in a history's own frame; None where it is no plane there."""
        ends = history.in_frame(self.ends())
        i, j = (max(n - 1, 1) for n in self.shape)
        row, column = (ends[2] - ends[0]) / i, (ends[1] - ends[0]) / j
        if not self.shape[0] > 1 < self.shape[1]:
            return None
        made = Plane(ends[0], row, column, self.shape)
        middle = np.array([0.5 * i, 0.5 * j])
        own = history.in_frame((self.origin_m + middle[0] * self.row_m + middle[1] * self.column_m)[None])[0]
        there = made.origin_m + middle[0] * row + middle[1] * column
        flat = np.abs(ends[3] - (made.origin_m + i * row + j * column)).max(), np.abs(own - there).max()
        return made if max(flat) < FLAT_M else None

    def expanded_turns(self, history: PhaseHistory, rows: int = ROWS, columns: int = COLUMNS) -> float:
        """Turns of phase that the expansion about blocks of so many pixels leaves out at most: s q / 2 R^2, of third
        order."""
        reach = 0.5 * np.hypot(rows * np.linalg.norm(self.row_m), columns * np.linalg.norm(self.column_m))
        nearest = np.inf
        for place in (history.position_m, history.transmitter_m):
            if place is not None:
                middle = self.ends().mean(axis=0)
                half = np.linalg.norm(self.ends()[0] - middle)
                nearest = min(nearest, float(np.linalg.norm(place - middle, axis=1).min() - half))
        if nearest <= reach:
            return np.inf
        # s q is largest where s^2 is a third of |d|^2: 2 / (3 sqrt 3) |d|^3
        return float(reach**3 / (3.0 * np.sqrt(3.0) * nearest**2) * 2.0 * history.centre_frequency_hz / SPEED_OF_LIGHT)


def _reached(history: PhaseHistory, ends: np.ndarray) -> bool:
    """Whether the unambiguous swath of every pulse holds the corners of a plane, with all that is between them."""
    half = SPEED_OF_LIGHT / (4.0 * history.frequency_step_hz)
    senders = history.position_m if history.transmitter_m is None else history.transmitter_m
    for end in ends:
        ways = (np.linalg.norm(place - end, axis=1) for place in (history.position_m, senders))
        if (np.abs(0.5 * sum(ways) - history.reference_range_m) > half).any():
            return False
    return True
