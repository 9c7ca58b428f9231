"""What a phase error over the aperture does to the mean power of an image: power is spread along azimuth."""

import warp as wp

from warpsar.kernels.effects.azimuth_ambiguity import sample


@wp.kernel
def smear_kernel(
    # In:
    p: wp.array(dtype=float),  # phases at the aperture's end: quadratic, cubic, quartic, spline [rad]
    place: wp.array(dtype=float),  # along the aperture, -1 to 1
    share: wp.array(dtype=float),  # of the power
    spline_slope: wp.array(dtype=float),  # of the spline's shape, by place
    pixels_per_slope: float,
    cols: int,
    image: wp.array(dtype=float),
    # Out:
    image_out: wp.array(dtype=float),
):
    i = wp.tid()
    col = i % cols
    total = float(0.0)
    for n in range(place.shape[0]):
        x = place[n]
        slope = 2.0 * p[0] * x + 3.0 * p[1] * x * x + 4.0 * p[2] * x * x * x + p[3] * spline_slope[n]
        total += share[n] * sample(image, i - col, cols, float(col) - pixels_per_slope * slope)
    image_out[i] = total
