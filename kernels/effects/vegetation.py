"""A layer of scatterers over the surface."""

import warp as wp

LEAST_COSINE = wp.constant(1.0e-3)


@wp.kernel
def canopy_kernel(
    # In:
    p: wp.array(dtype=float),  # optical depth, albedo
    cross_polarized: int,
    cos_incidence: wp.array(dtype=float),
    sigma: wp.array(dtype=float),
    # Out:
    sigma_out: wp.array(dtype=float),
):
    i = wp.tid()
    c = wp.max(cos_incidence[i], LEAST_COSINE)
    transmitted = wp.exp(-2.0 * p[0] / c)
    canopy = p[1] * c * (1.0 - transmitted)
    if cross_polarized != 0:
        canopy = 0.0
    sigma_out[i] = transmitted * sigma[i] + canopy
