"""What a body returns by detail that its mesh does not have."""

import warp as wp


@wp.kernel
def detail_kernel(
    # In:
    p: wp.array(dtype=float),  # level, spread [m]
    face_material: wp.array(dtype=int),
    has_detail: wp.array(dtype=int),  # by material
    face: wp.array(dtype=int),
    cos_incidence: wp.array(dtype=float),
    # Out:
    sigma_out: wp.array(dtype=float),
):
    """The same cross-section for every square metre that the radar sees, seen across its look direction."""
    i = wp.tid()
    value = float(0.0)
    if has_detail[face_material[face[i]]] != 0:
        value = p[0] * cos_incidence[i]
    sigma_out[i] = value
