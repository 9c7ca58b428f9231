"""`models.scatter_kernel` on the CPU, for all models: sixteen hits at once.

The equations are those of kernels/models.py, written out by kernels/lanes.py; only loads and stores are by hand.
"""

import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.models import modelled_of

HITS = 16  # of a block

_MODEL = lanes.source(HITS, {modelled_of: ("model", "polarization", "wavenumber")})

_SCATTER = """
    typedef Lanes::V V;
    // the block's hits side by side; beyond the last one, its copies
    const int begin = block * 16, count = wp::min(mine.shape[0] - begin, 16);
    int at[16];
    V cosine, twist, loss;
    Lanes::I spectra;
    Lanes::V4 z;
    for (int k = 0; k < 16; ++k) {
        const int i = at[k] = mine.data[begin + wp::min(k, count - 1)];
        const int material = face_material.data[face.data[i]];
        cosine[k] = cos_incidence.data[i];
        twist[k] = local_basis ? 1.0f : cos_twist.data[i];
        spectra[k] = spectrum.data[material];
        loss[k] = eps_im.data[material];
        for (int j = 0; j < 4; ++j)
            z.c[j][k] = zeta.data[i].c[j];
    }
    if (!slopes_out.shape[0]) {
        const V sigma = Lanes::modelled_of(model, polarization, spectra, wavenumber, cosine, twist, loss, z).c[0];
        for (int k = 0; k < count; ++k)
            sigma_out.data[at[k]] = sigma[k];
        return;
    }
    const Lanes::V5 found = Lanes::modelled_of(model, polarization, spectra, wavenumber, cosine, twist, loss, z);
    for (int k = 0; k < count; ++k) {
        sigma_out.data[at[k]] = found.c[0][k];
        slopes_out.data[at[k]] = {found.c[1][k], found.c[2][k], found.c[3][k], found.c[4][k]};
    }
"""


@wp.func_native(_MODEL + _SCATTER)
def scatter_block(
    block: int,
    model: int,
    polarization: int,
    mine: wp.array(dtype=int),
    wavenumber: float,
    local_basis: int,
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    cos_incidence: wp.array(dtype=float),
    cos_twist: wp.array(dtype=float),
    spectrum: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    sigma_out: wp.array(dtype=float),
    slopes_out: wp.array(dtype=wp.vec4),
): ...


@wp.kernel(enable_backward=False)
def scatter_kernel(
    # In:
    model: int,
    polarization: int,
    mine: wp.array(dtype=int),
    wavenumber: float,
    local_basis: int,
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    cos_incidence: wp.array(dtype=float),
    cos_twist: wp.array(dtype=float),
    spectrum: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    # Out:
    sigma_out: wp.array(dtype=float),
    slopes_out: wp.array(dtype=wp.vec4),
):
    """sigma0 of HITS of the hits `mine`; with `slopes_out` not empty its slopes too."""
    scatter_block(
        wp.tid(),
        model,
        polarization,
        mine,
        wavenumber,
        local_basis,
        face,
        face_material,
        cos_incidence,
        cos_twist,
        spectrum,
        eps_im,
        zeta,
        sigma_out,
        slopes_out,
    )
