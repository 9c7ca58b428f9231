"""Measured against modelled beta0, pixel by pixel, and the price of rough parameter fields."""

import warp as wp

GAMMA = wp.constant(0)
MSE = wp.constant(1)
LOG = wp.constant(2)

# Partial sums of a loss: float64, spread over as many cells so that CUDA atomics seldom meet.
PARTIALS = wp.constant(256)

# A modelled pixel darker than this is as dark as this: keeps ln(mu) finite where sigma0 underflows.
DARKEST = wp.constant(1.0e-30)


@wp.kernel
def loss_kernel(
    # In:
    kind: int,
    pixel: wp.array(dtype=int),
    measured: wp.array(dtype=float),
    image: wp.array(dtype=float),
    gain: wp.array(dtype=float),
    gain_index: int,
    looks: float,
    weight: float,
    bias: float,
    # Out:
    loss_out: wp.array(dtype=wp.float64),
):
    """GAMMA: L (I / mu - 1 - ln(I / mu)), half the deviance; MSE: (I - mu)^2 / 2 (equation 38);
    LOG: (ln I - ln mu - bias)^2 / 2, bias = psi(L) - ln L. Each times `weight`."""
    i = wp.tid()
    mu = wp.max(gain[gain_index] * image[pixel[i]], DARKEST)
    observed = measured[i]
    value = float(0.0)
    if kind == GAMMA:
        ratio = observed / mu
        value = looks * (ratio - 1.0 - wp.log(ratio))
    elif kind == MSE:
        value = 0.5 * (observed - mu) * (observed - mu)
    else:
        difference = wp.log(observed) - wp.log(mu) - bias
        value = 0.5 * difference * difference
    wp.atomic_add(loss_out, i % PARTIALS, wp.float64(weight * value))


@wp.kernel
def variation_kernel(
    # In:
    first: wp.array(dtype=int),
    second: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    nodes: wp.array(dtype=float),
    rounding: float,
    # Out:
    loss_out: wp.array(dtype=wp.float64),
):
    """Total variation over pairs of neighbouring nodes, in their log coordinates (equation 39):
    weight * (sqrt(difference^2 + rounding^2) - rounding)."""
    i = wp.tid()
    difference = nodes[first[i]] - nodes[second[i]]
    value = weight[i] * (wp.sqrt(difference * difference + rounding * rounding) - rounding)
    wp.atomic_add(loss_out, i % PARTIALS, wp.float64(value))
