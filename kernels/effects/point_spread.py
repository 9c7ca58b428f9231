"""Separable convolution with a kernel whose width is a parameter."""

from typing import Any

import warp as wp

from warpsar.kernels.wide import sum_of_lanes

SINC = wp.constant(0)
TAYLOR = wp.constant(1)
GAUSSIAN = wp.constant(2)

# Full widths at half maximum of the squared transforms of windows of length 1.
SINC_WIDTH = wp.constant(0.8858929413789)
TAYLOR_WIDTH = wp.constant(1.1874775859198)

# Taylor's window for sidelobes at -35 dB, nbar = 5: 1 + 2 sum F_m cos(2 pi m t).
F1 = wp.constant(0.34434990953661)
F2 = wp.constant(-0.01519488855396)
F3 = wp.constant(0.00427830763157)
F4 = wp.constant(-0.00073455164987)

# Narrower than this share of a pixel counts as this: the kernel is 1 and 0 there to float32.
NARROWEST = wp.constant(1.0e-5)

# Pixels of a line that a thread takes at once: as many as the CPU has in a register or two. On CUDA one each, so that
# neighbouring threads read neighbouring pixels.
Stretch = wp.types.vector(length=16, dtype=float)
Pixel = wp.types.vector(length=1, dtype=float)


@wp.struct
class SpreadAxis:
    """The axis of an image along which power is spread, and by which kernel."""

    window: int
    index: int  # of the width in p
    spacing: float  # of pixels [m]
    cols: int  # of the image
    count: int  # pixels along the axis
    stride: int  # from one to the next


READ = """
    for (int k = 0; k < %d; ++k)
        none[k] = array.data[i + k];
    return none;
"""


# Overloads of one function, as Warp has them.
@wp.func_native(READ % 16)
def read(array: wp.array(dtype=float), i: int, none: Stretch) -> Stretch: ...  # type: ignore[empty-body]


@wp.func_native(READ % 1)  # type: ignore[no-redef]
def read(array: wp.array(dtype=float), i: int, none: Pixel) -> Pixel: ...  # type: ignore[empty-body]  # noqa: F811


@wp.func
def sinc(x: float) -> float:
    t = wp.pi * x
    value = 1.0 - t * t / 6.0
    if wp.abs(t) > 0.01:
        value = wp.sin(t) / t
    return value


@wp.func
def pair(x: float, m: float) -> float:
    return sinc(x - m) + sinc(x + m)


@wp.func
def power(window: int, x: float) -> float:
    """Point spread of power at `x` full widths at half maximum, 1 at 0."""
    value = float(0.0)
    if window == GAUSSIAN:
        # Beyond: 0 in float32 with its derivative, and no overflow on the way.
        if wp.abs(x) < 8.0:
            value = wp.exp(-2.772588722239781 * x * x)
    elif window == SINC:
        a = sinc(SINC_WIDTH * x)
        value = a * a
    else:
        y = TAYLOR_WIDTH * x
        b = sinc(y) + F1 * pair(y, 1.0) + F2 * pair(y, 2.0) + F3 * pair(y, 3.0) + F4 * pair(y, 4.0)
        value = b * b
    return value


@wp.kernel
def sample_kernel(
    # In:
    axis: SpreadAxis,
    p: wp.array(dtype=float),
    # Out:
    weight_out: wp.array(dtype=float),  # by distance in pixels
    total_out: wp.array(dtype=float),  # of both sides
):
    """The point spread at pixel centres, and its sum."""
    k = wp.tid()
    width = wp.max(p[axis.index] / axis.spacing, NARROWEST)
    w = power(axis.window, float(k) / width)
    weight_out[k] = w
    if k == 0:
        wp.atomic_add(total_out, 0, w)
    else:
        wp.atomic_add(total_out, 0, 2.0 * w)


@wp.kernel
def normalise_kernel(
    # In:
    weight: wp.array(dtype=float),
    total: wp.array(dtype=float),
    # Out:
    weight_out: wp.array(dtype=float),
):
    i = wp.tid()
    weight_out[i] = weight[i] / total[0]


@wp.func
def reach_of(axis: SpreadAxis, width: float) -> int:
    """Number of pixels to each side that get a weight."""
    reach = axis.count - 1
    if axis.window == GAUSSIAN:
        # exp(-4 ln 2 * 9) = 1.5e-11 is left out
        reach = wp.min(reach, int(3.0 * wp.max(width / axis.spacing, 0.0)) + 1)
    return reach


@wp.kernel(enable_backward=False)
def blur_kernel(
    # In:
    axis: SpreadAxis,
    p: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    image: wp.array(dtype=float),
    none: Any,  # Stretch() or Pixel(); an image has at least as many columns
    add: int,
    # Out:
    image_out: wp.array(dtype=float),
):
    """Convolution along one axis. The image is 0 outside its borders, and power that is spread there is lost.

    The kernel is symmetric, so this is also its own adjoint to `image`; `add` then adds to the gradient that is there.
    """
    row, part = wp.tid()
    cols = axis.cols
    count = axis.count
    stride = axis.stride
    n = len(none)
    begin = part * n
    col = wp.min(begin, cols - n)  # the last stretch overlaps with the one before
    i = row * cols + col
    # Places along the axis of the first and last pixel of the stretch.
    low = row
    high = row
    if stride == 1:
        low = col
        high = col + n - 1
    reach = reach_of(axis, p[axis.index])
    value = none
    # Loops of their own: a branch between the two would take `value` through memory.
    first = wp.max(-low, -reach)
    last = wp.min(count - 1 - high, reach)
    for k in range(first, last + 1):
        value += weight[wp.abs(k)] * read(image, i + k * stride, none)
    if stride == 1:  # distances at which some of the stretch meet the image's edge
        for k in range(wp.max(-high, -reach), first):
            for j in range(-k - low, n):
                value[j] += weight[-k] * image[i + k + j]
        for k in range(last + 1, wp.min(count - 1 - low, reach) + 1):
            for j in range(0, count - low - k):
                value[j] += weight[k] * image[i + k + j]
    for j in range(n):
        if col + j >= begin:
            if add != 0:
                value[j] += image_out[i + j]
            image_out[i + j] = value[j]


@wp.kernel(enable_backward=False)
def weight_adjoint_kernel(
    # In:
    axis: SpreadAxis,
    p: wp.array(dtype=float),
    image: wp.array(dtype=float),
    blurred_gradient: wp.array(dtype=float),
    none: Any,
    parts: int,
    lanes: int,
    # Out:
    weight_gradient_out: wp.array(dtype=float),
):
    """Adjoint of `blur_kernel` to the weight at distance k: g_i x_j + g_j x_i over the pairs of pixels so far apart.

    `parts` threads share the rows, and `lanes` (1, or on CUDA LANES) a row.
    """
    k, part, lane = wp.tid()
    if k <= reach_of(axis, p[axis.index]):
        cols = axis.cols
        stride = axis.stride
        n = len(none)
        rows = image.shape[0] // cols
        length = cols
        if stride == 1:
            length -= k
        else:
            rows -= k
        stretches = length // n
        total = none
        rest = float(0.0)
        for row in range(part, rows, parts):
            for s in range(lane, stretches, lanes):
                i = row * cols + s * n
                j = i + k * stride
                total += wp.cw_mul(read(blurred_gradient, i, none), read(image, j, none))
                total += wp.cw_mul(read(blurred_gradient, j, none), read(image, i, none))
            for i in range(row * cols + stretches * n + lane, row * cols + length, lanes):
                j = i + k * stride
                rest += blurred_gradient[i] * image[j] + blurred_gradient[j] * image[i]
        for j in range(n):
            rest += total[j]
        if k == 0:  # a pair is one pixel
            rest *= 0.5
        rest = sum_of_lanes(rest)
        if lane == 0:
            wp.atomic_add(weight_gradient_out, k, rest)


# Both now: the module would be compiled again for the second one, by whichever thread is the first to launch it.
for stretch in (Stretch, Pixel):
    wp.overload(blur_kernel, {"none": stretch})
    wp.overload(weight_adjoint_kernel, {"none": stretch})
