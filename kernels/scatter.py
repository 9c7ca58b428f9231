"""sigma0 of hits by the backscatter model of their material: a kernel for each model, made from its functions."""

from functools import cache
from importlib import import_module
from typing import Any

import warp as wp

from warpsar.kernels.codes import PAGE, Polarization
from warpsar.kernels.shade import HitSurfaces
from warpsar.kernels.wide import read_float, read_int, read_vec4, write_vec4


def functions_of(model: str) -> Any:
    """The module of a model's device functions (kernels/models/__init__.py)."""
    return import_module(f"warpsar.kernels.models.{model}")


def places_of(model: str) -> int:
    """How many learned coordinates its functions take: a multiple of `PAGE`."""
    found: int = getattr(functions_of(model), "PLACES", PAGE)
    return found


@cache
def sigma0_of(model: str) -> wp.Function:
    """The function of a model's sigma0 alone."""
    module = functions_of(model)
    if hasattr(module, "sigma0_of"):
        found: wp.Function = module.sigma0_of
        return found
    both = module.sigma0_and_slopes_of

    @wp.func
    def first_of_all(
        polarization: int,
        spectrum: int,
        variant: int,
        wavenumber: Any,
        cos_incidence: Any,
        cos_twist: Any,
        cos2_azimuth: Any,
        eps_im: Any,
        aspect: Any,
        zeta: Any,
    ):
        found = both(
            polarization,
            spectrum,
            variant,
            wavenumber,
            cos_incidence,
            cos_twist,
            cos2_azimuth,
            eps_im,
            aspect,
            zeta,
        )
        return found[0]

    return first_of_all


@cache
def scatter_kernel(
    model: str, slopes: bool, polarization: Polarization | None = None, *, some: bool = True
) -> wp.Kernel:
    """The kernel of sigma0 for the hits `mine`, whose materials have `model`; with `slopes` of its slopes too.

    With `polarization` it is for that one, whatever it is given: HV of I2EM takes so many registers that a kernel for
    all would be three times slower on a GPU. Without `some` it is for all hits, and `mine` is not read.
    """
    function = functions_of(model).sigma0_and_slopes_of if slopes else sigma0_of(model)
    channel = -1 if polarization is None else int(polarization)
    bounds = getattr(functions_of(model), "LAUNCH_BOUNDS", None) if slopes else None
    places = places_of(model)
    several = places > PAGE
    coordinates = wp.types.vector(length=places, dtype=float) if several else wp.vec4

    # Series are loops: unrolled they would take minutes to compile.
    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1}, launch_bounds=bounds)
    def scatter_kernel(
        # In:
        mine: wp.array(dtype=int),
        hits: HitSurfaces,
        zeta: wp.array(dtype=coordinates),
        # Out:
        sigma_out: wp.array(dtype=float),
        slopes_out: wp.array(dtype=coordinates),
    ):
        if wp.static(some):
            i = read_int(mine, wp.tid())
        else:
            i = wp.tid()
        code = hits.polarization
        if wp.static(channel >= 0):
            code = wp.static(channel)
        material = read_int(hits.face_material, read_int(hits.face, i))
        twist = read_float(hits.cos_twist, i)
        if hits.local_basis != 0:
            twist = 1.0
        if wp.static(several):
            own = zeta[i]
        else:
            own = read_vec4(zeta, i)
        found = function(
            code,
            read_int(hits.spectrum, material),
            hits.variant,
            hits.wavenumber,
            read_float(hits.cos_incidence, i),
            twist,
            read_float(hits.cos2_azimuth, i),
            read_float(hits.eps_im, material),
            read_float(hits.aspect, material),
            own,
        )
        if wp.static(slopes):
            sigma_out[i] = found[0]
            if wp.static(several):
                for k in range(wp.static(places)):
                    own[k] = found[k + 1]
                slopes_out[i] = own
            else:
                write_vec4(slopes_out, i, wp.vec4(found[1], found[2], found[3], found[4]))
        else:
            sigma_out[i] = found

    return scatter_kernel


@cache
def page_kernels(places: int) -> tuple[wp.Kernel, wp.Kernel]:
    """Of a model with more than one vector of coordinates: the kernel that joins them, and its adjoint's."""
    coordinates = wp.types.vector(length=places, dtype=float)

    @wp.kernel(enable_backward=False, module="unique")
    def join_kernel(
        # In:
        page: int,
        part: wp.array(dtype=wp.vec4),
        # Out:
        zeta_out: wp.array(dtype=coordinates),
    ):
        """Put the vector number `page` into the whole."""
        i = wp.tid()
        whole = zeta_out[i]
        some = read_vec4(part, i)
        for k in range(PAGE):
            whole[PAGE * page + k] = some[k]
        zeta_out[i] = whole

    @wp.kernel(enable_backward=False, module="unique")
    def part_adjoint_kernel(
        # In:
        mine: wp.array(dtype=int),
        page: int,
        slopes: wp.array(dtype=coordinates),
        sigma_gradient: wp.array(dtype=float),
        # Out:
        part_gradient_out: wp.array(dtype=wp.vec4),
    ):
        """Add the gradient of the vector number `page`, for the hits `mine`."""
        i = read_int(mine, wp.tid())
        some = read_vec4(part_gradient_out, i)
        whole = slopes[i]
        for k in range(PAGE):
            some[k] += sigma_gradient[i] * whole[PAGE * page + k]
        write_vec4(part_gradient_out, i, some)

    return join_kernel, part_adjoint_kernel
