"""Phase history onto the pixels of a plane grid, in float32 about the middles of its blocks.

The way to a pixel is expanded to second order about the middle of its block, once for a block and a pulse, in float64
("TaylorFast" of NVIDIA MatX's `sar_bp` is the same expansion). A pixel is a whole number of steps from the middle, so
the turns of a step count by their fraction alone: float32 then holds the phase to 1e-6 of a turn, where the turns
themselves would be known to 1e-5.
"""

from functools import cache

import warp as wp

from warpsar.kernels.backproject import Pulses

wp.set_module_options({"enable_backward": False, "fast_math": True})

ROWS, COLUMNS = 16, 32
"""Pixels of a block. Columns lie along azimuth, where neighbours read the same range bins."""
EACH = 4
"""Rows of a block that one thread takes."""
TAPS = 12
"""Pixels of a coarse image from which a fine one is interpolated."""
TWO_PI = wp.constant(6.283185307179586)


@wp.struct
class PlaneGrid:
    """Pixels at origin + i row + j column [m]."""

    origin: wp.vec3d
    row: wp.vec3d
    column: wp.vec3d
    rows: int
    columns: int
    block_rows: int
    block_columns: int


@wp.struct
class WayExpansion:
    """The way from a pulse to the pixels of a block, by their steps i and j from its middle."""

    base: int  # whole range bins at the middle
    bins: float  # and what is left of them
    bins_i: float
    bins_j: float
    bins_ii: float
    bins_ij: float
    bins_jj: float
    turns: float  # fractions of turns
    turns_i: float
    turns_j: float
    turns_per_bin: float


@wp.func
def fraction(turns: wp.float64) -> float:
    return float(turns - wp.round(turns))


@wp.func
def bent(u: wp.vec3d, a: wp.vec3d, b: wp.vec3d, distance: wp.float64) -> wp.float64:
    """Second derivative of a distance along two steps."""
    return (wp.dot(a, b) - wp.dot(u, a) * wp.dot(u, b)) / distance


@wp.kernel
def expand_kernel(
    # In:
    grid: PlaneGrid,
    first_block: int,
    pulses: Pulses,
    # Out:
    expansion_out: wp.array2d[WayExpansion],
):
    """Of each block and pulse, (blocks, pulses)."""
    b, p = wp.tid()
    block = first_block + b
    across = (grid.columns + grid.block_columns - 1) / grid.block_columns
    i = wp.float64((block / across) * grid.block_rows + grid.block_rows / 2)
    j = wp.float64((block % across) * grid.block_columns + grid.block_columns / 2)
    middle = grid.origin + i * grid.row + j * grid.column
    to = middle - pulses.position[p]
    way = wp.length(to)
    u = to / way
    ii = bent(u, grid.row, grid.row, way)
    ij = bent(u, grid.row, grid.column, way)
    jj = bent(u, grid.column, grid.column, way)
    if pulses.sender.shape[0] > 0:
        half = wp.float64(0.5)
        other = middle - pulses.sender[p]
        far = wp.length(other)
        v = other / far
        ii = half * (ii + bent(v, grid.row, grid.row, far))
        ij = half * (ij + bent(v, grid.row, grid.column, far))
        jj = half * (jj + bent(v, grid.column, grid.column, far))
        u = half * (u + v)
        way = half * (way + far)
    offset = way - pulses.reference_range[p]
    bins = pulses.bins_per_metre[p]
    turns = pulses.turns_per_metre[p]
    at = offset * bins
    along_i = wp.dot(u, grid.row)
    along_j = wp.dot(u, grid.column)
    made = WayExpansion()
    made.base = int(wp.floor(at))
    made.bins = float(at - wp.floor(at))
    made.bins_i = float(along_i * bins)
    made.bins_j = float(along_j * bins)
    made.bins_ii = float(wp.float64(0.5) * ii * bins)
    made.bins_ij = float(ij * bins)
    made.bins_jj = float(wp.float64(0.5) * jj * bins)
    made.turns = fraction(offset * turns)
    made.turns_i = fraction(along_i * turns)
    made.turns_j = fraction(along_j * turns)
    made.turns_per_bin = float(turns / bins)
    expansion_out[b, p] = made


@cache
def backproject_plane_kernel(each: int, cubic: bool) -> wp.Kernel:
    """The kernel whose threads take `each` rows, with cubic interpolation of the profiles or linear one."""

    @wp.kernel(module="unique", module_options={"enable_backward": False, "fast_math": True})
    def backproject_plane(
        # In:
        grid: PlaneGrid,
        first_block: int,
        expansion_in: wp.array2d[WayExpansion],
        profile_in: wp.array2d[wp.vec2],  # (pulse, bin), a power of two of bins
        # In and out:
        image: wp.array2d[wp.vec2],
    ):
        """A thread sums all pulses at some rows of one column. The threads of a block follow one another."""
        tid = wp.tid()
        threads = grid.block_columns * (grid.block_rows / wp.static(each))
        b = tid / threads
        lane = tid % threads
        block = first_block + b
        across = (grid.columns + grid.block_columns - 1) / grid.block_columns
        column = lane % grid.block_columns
        start = (lane / grid.block_columns) * wp.static(each)
        j = (block % across) * grid.block_columns + column
        i = (block / across) * grid.block_rows + start
        if i >= grid.rows or j >= grid.columns:
            return
        dj = float(column - grid.block_columns / 2)
        di = float(start - grid.block_rows / 2)
        mask = profile_in.shape[1] - 1
        real = wp.vector(length=wp.static(each), dtype=wp.float32)
        imaginary = wp.vector(length=wp.static(each), dtype=wp.float32)
        for p in range(expansion_in.shape[1]):
            way = expansion_in[b, p]
            bins = way.bins + dj * way.bins_j
            turns = way.turns + dj * way.turns_j
            bent_j = dj * dj * way.bins_jj
            for k in range(wp.static(each)):
                d = di + float(k)
                quadratic = d * (d * way.bins_ii + dj * way.bins_ij) + bent_j
                at = bins + d * way.bins_i + quadratic
                turned = turns + d * way.turns_i + way.turns_per_bin * quadratic
                phase = TWO_PI * (turned - wp.rint(turned))
                low = wp.floor(at)
                t = at - low
                n = way.base + int(low)
                echo = wp.vec2()
                if wp.static(cubic):
                    left = profile_in[p, (n - 1) & mask]
                    here = profile_in[p, n & mask]
                    right = profile_in[p, (n + 1) & mask]
                    far = profile_in[p, (n + 2) & mask]
                    # Lagrange's polynomials of four points
                    up = t + 1.0
                    down = t - 1.0
                    over = t - 2.0
                    inner = t * down * (1.0 / 6.0)
                    outer = up * over * 0.5
                    echo = (
                        left * (-inner * over) + here * (outer * down) - right * (outer * t) + far * (inner * up)
                    )  # fmt: skip
                else:
                    here = profile_in[p, n & mask]
                    echo = here + t * (profile_in[p, (n + 1) & mask] - here)
                c = wp.cos(phase)
                s = wp.sin(phase)
                real[k] += echo[0] * c - echo[1] * s
                imaginary[k] += echo[0] * s + echo[1] * c
        for k in range(wp.static(each)):
            if i + k < grid.rows:
                image[i + k, j] = image[i + k, j] + wp.vec2(real[k], imaginary[k])

    return backproject_plane


@wp.kernel
def demodulate_kernel(
    # In:
    grid: PlaneGrid,
    pulses: Pulses,
    pulse: int,
    # In and out:
    image: wp.array2d[wp.vec2],
):
    """Take the phase of a pulse's way off an image."""
    i, j = wp.tid()
    point = grid.origin + wp.float64(i) * grid.row + wp.float64(j) * grid.column
    way = wp.length(point - pulses.position[pulse])
    if pulses.sender.shape[0] > 0:
        way = wp.float64(0.5) * (way + wp.length(point - pulses.sender[pulse]))
    phase = -TWO_PI * fraction((way - pulses.reference_range[pulse]) * pulses.turns_per_metre[pulse])
    c = wp.cos(phase)
    s = wp.sin(phase)
    value = image[i, j]
    image[i, j] = wp.vec2(value[0] * c - value[1] * s, value[0] * s + value[1] * c)


@wp.kernel
def refine_kernel(
    # In:
    grid: PlaneGrid,
    first_block: int,
    expansion_in: wp.array2d[WayExpansion],
    pulse: int,
    coarse_in: wp.array2d[wp.vec2],  # the image of a part of the aperture, without the phase of one pulse
    base_in: wp.array[int],  # the first coarse column that each fine one takes
    weight_in: wp.array2d[float],  # (columns, TAPS)
    # In and out:
    image: wp.array2d[wp.vec2],
):
    """Add a coarse image to a fine one: interpolated along its rows, and with the phase of the pulse again."""
    tid = wp.tid()
    threads = grid.block_columns * grid.block_rows
    b = tid / threads
    lane = tid % threads
    block = first_block + b
    across = (grid.columns + grid.block_columns - 1) / grid.block_columns
    row = lane / grid.block_columns
    column = lane % grid.block_columns
    i = (block / across) * grid.block_rows + row
    j = (block % across) * grid.block_columns + column
    if i >= grid.rows or j >= grid.columns:
        return
    di = float(row - grid.block_rows / 2)
    dj = float(column - grid.block_columns / 2)
    way = expansion_in[b, pulse]
    quadratic = di * (di * way.bins_ii + dj * way.bins_ij) + dj * dj * way.bins_jj
    turned = way.turns + di * way.turns_i + dj * way.turns_j + way.turns_per_bin * quadratic
    phase = TWO_PI * (turned - wp.rint(turned))
    base = base_in[j]
    value = wp.vec2()
    for k in range(wp.static(TAPS)):
        value += weight_in[j, k] * coarse_in[i, base + k]
    c = wp.cos(phase)
    s = wp.sin(phase)
    image[i, j] = image[i, j] + wp.vec2(value[0] * c - value[1] * s, value[0] * s + value[1] * c)
