"""Power seen through an antenna's elevation pattern, out and back."""

import warp as wp

HALF_POWER = wp.constant(4.0 * 0.6931471805599453)  # 4 ln 2: a Gaussian of full width 1 at half maximum
DEGREES = wp.constant(57.29577951308232)


@wp.func
def off_axis(coordinate: float, boresight: float, width: float) -> float:
    """Squared angle from boresight in beam widths; 0, and no gradient to anything, for an infinite width."""
    t = (coordinate - boresight) / width
    return t * t


@wp.kernel
def antenna_kernel(
    # In:
    p: wp.array(dtype=float),  # width and boresight [deg], width and boresight [m]
    slant_range: float,  # 0 for a plane wave
    d: wp.vec3,
    v: wp.vec3,
    point: wp.array(dtype=wp.vec3),
    sigma: wp.array(dtype=float),
    # Out:
    sigma_out: wp.array(dtype=float),
):
    i = wp.tid()
    across = wp.dot(point[i], v)
    exponent = float(0.0)
    if slant_range > 0.0:
        angle = DEGREES * wp.atan2(across, slant_range + wp.dot(point[i], d))
        exponent = off_axis(angle, p[1], p[0])
    else:
        exponent = off_axis(across, p[3], p[2])
    sigma_out[i] = sigma[i] * wp.exp(-2.0 * HALF_POWER * exponent)
