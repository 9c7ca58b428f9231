"""Power that falls with range."""

import warp as wp


@wp.kernel
def loss_kernel(
    # In:
    p: wp.array(dtype=float),  # exponent, rate [1/m]
    slant_range: float,  # R0; 0 for a plane wave
    d: wp.vec3,
    v: wp.vec3,
    point: wp.array(dtype=wp.vec3),
    sigma: wp.array(dtype=float),
    # Out:
    sigma_out: wp.array(dtype=float),
):
    i = wp.tid()
    along = wp.dot(point[i], d)
    gain = wp.exp(-p[1] * along)
    if slant_range > 0.0:
        # ln (R / R0)
        ahead = 1.0 + along / slant_range
        across = wp.dot(point[i], v) / slant_range
        gain = wp.exp(-0.5 * p[0] * wp.log(ahead * ahead + across * across))
    sigma_out[i] = sigma[i] * gain
