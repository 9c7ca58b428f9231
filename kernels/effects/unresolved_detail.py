"""What a body returns by detail that its mesh does not have."""

import warp as wp


@wp.kernel
def detail_kernel(
    # In:
    p: wp.array(dtype=float),  # level, spread [m], flash, its half width [deg], share of each material
    face_material: wp.array(dtype=int),
    has_detail: wp.array(dtype=int),  # by material
    face: wp.array(dtype=int),
    cos_incidence: wp.array(dtype=float),
    off_axis: float,  # of the radar's azimuth from the nearest axis of the body [deg]
    # Out:
    sigma_out: wp.array(dtype=float),
):
    """The same cross-section for every square metre that the radar sees, seen across its look direction.

    Corners along the body's axes come in all lengths. Long ones have high and narrow lobes, short ones low and wide
    ones: their sum falls off as Lorentz's curve, not as any one lobe.
    """
    i = wp.tid()
    value = float(0.0)
    material = face_material[face[i]]
    if has_detail[material] != 0:
        off = off_axis / p[3]
        value = p[0] * p[4 + material] * cos_incidence[i] * (1.0 + p[2] / (1.0 + off * off))
    sigma_out[i] = value
