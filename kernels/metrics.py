"""Sums over the compared pixels of an image, of which its metrics are made (warpsar/likelihood.py)."""

import warp as wp

from warpsar.kernels.loss import ObservedPixels

# Partial sums, spread over as many cells so that CUDA atomics seldom meet.
PARTIALS = wp.constant(64)
SUMS = wp.constant(9)


@wp.kernel(enable_backward=False)
def moments_kernel(
    # In:
    observed: ObservedPixels,
    image: wp.array(dtype=float),
    # Out:
    sums_out: wp.array2d(dtype=wp.float64),
):
    """I, I^2, mu, mu^2, I mu, (I - mu)^2; and where both are positive, 1, ln(I / mu)^2 and I / mu - 1 - ln(I / mu)."""
    i = wp.tid()
    cell = i % PARTIALS
    darkest = observed.darkest[wp.min(i, observed.darkest.shape[0] - 1)]
    mu = wp.float64(wp.max(image[observed.pixel[i]], darkest))
    seen = wp.float64(observed.measured[i])
    zero, one = wp.float64(0.0), wp.float64(1.0)
    wp.atomic_add(sums_out, cell, 0, seen)
    wp.atomic_add(sums_out, cell, 1, seen * seen)
    wp.atomic_add(sums_out, cell, 2, mu)
    wp.atomic_add(sums_out, cell, 3, mu * mu)
    wp.atomic_add(sums_out, cell, 4, seen * mu)
    wp.atomic_add(sums_out, cell, 5, (seen - mu) * (seen - mu))
    if seen > zero and mu > zero:
        ratio = seen / mu
        logarithm = wp.log(ratio)
        wp.atomic_add(sums_out, cell, 6, one)
        wp.atomic_add(sums_out, cell, 7, logarithm * logarithm)
        wp.atomic_add(sums_out, cell, 8, ratio - one - logarithm)
