"""What a body returns by detail that its mesh does not have."""

import warp as wp


@wp.kernel
def detail_kernel(
    # In:
    p: wp.array(dtype=float),  # level, spread [m], share of each material
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
    material = face_material[face[i]]
    if has_detail[material] != 0:
        value = p[0] * p[2 + material] * cos_incidence[i]
    sigma_out[i] = value
