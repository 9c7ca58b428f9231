"""sigma0 times the exponential of a smooth function of the incidence."""

import warp as wp

NODES = wp.constant(3)  # of each channel
FIRST_DEG = wp.constant(20.0)
STEP_DEG = wp.constant(20.0)


@wp.func
def bump(x: float) -> float:
    """Cubic B-spline over its height at 0: 1 there, 0 with two derivatives from |x| = 2 on."""
    a = wp.abs(x)
    value = float(0.0)
    if a < 1.0:
        value = 1.0 + a * a * (0.75 * a - 1.5)
    elif a < 2.0:
        value = 0.25 * (2.0 - a) * (2.0 - a) * (2.0 - a)
    return value


@wp.func
def growth(p: wp.array(dtype=float), channel: int, cosine: float) -> float:
    """Decibels at an incidence: a function of its own, so that Warp's adjoint knows the loop's sum."""
    angle = wp.acos(wp.clamp(cosine, 0.0, 1.0)) * 57.29577951308232
    total = float(0.0)
    for j in range(NODES):
        total += p[channel * NODES + j] * bump((angle - FIRST_DEG) / STEP_DEG - float(j))
    return total


@wp.kernel
def growth_kernel(
    # In:
    p: wp.array(dtype=float),
    channel: int,  # of HH, VV, HV
    cos_incidence: wp.array(dtype=float),
    sigma: wp.array(dtype=float),
    # Out:
    sigma_out: wp.array(dtype=float),
):
    i = wp.tid()
    sigma_out[i] = sigma[i] * wp.exp(0.23025850929940458 * growth(p, channel, cos_incidence[i]))  # ln 10 / 10
