"""Sums over the compared pixels of an image, of which its metrics are made (warpsar/likelihood.py)."""

import warp as wp

# Partial sums, spread over as many cells so that CUDA atomics seldom meet.
PARTIALS = wp.constant(64)
SUMS = wp.constant(9)


@wp.kernel(enable_backward=False)
def moments_kernel(
    # In:
    pixel: wp.array(dtype=int),
    measured: wp.array(dtype=float),
    image: wp.array(dtype=float),
    darkest: wp.array(dtype=float),
    # Out:
    sums_out: wp.array2d(dtype=wp.float64),
):
    """I, I^2, mu, mu^2, I mu, (I - mu)^2; and where both are positive, 1, ln(I / mu)^2 and I / mu - 1 - ln(I / mu)."""
    i = wp.tid()
    cell = i % PARTIALS
    mu = wp.float64(wp.max(image[pixel[i]], darkest[wp.min(i, darkest.shape[0] - 1)]))
    observed = wp.float64(measured[i])
    zero, one = wp.float64(0.0), wp.float64(1.0)
    wp.atomic_add(sums_out, cell, 0, observed)
    wp.atomic_add(sums_out, cell, 1, observed * observed)
    wp.atomic_add(sums_out, cell, 2, mu)
    wp.atomic_add(sums_out, cell, 3, mu * mu)
    wp.atomic_add(sums_out, cell, 4, observed * mu)
    wp.atomic_add(sums_out, cell, 5, (observed - mu) * (observed - mu))
    if observed > zero and mu > zero:
        ratio = observed / mu
        logarithm = wp.log(ratio)
        wp.atomic_add(sums_out, cell, 6, one)
        wp.atomic_add(sums_out, cell, 7, logarithm * logarithm)
        wp.atomic_add(sums_out, cell, 8, ratio - one - logarithm)
