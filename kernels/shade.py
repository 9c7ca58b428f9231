"""Parameters at the hit, sigma0 of the hit, power into the pixel."""

import warp as wp

from warpsar.kernels.scattering import sigma0

# Layouts of a parameter, and where its nodes stand: one row of (layout, offset, width, height) per material and kind.
UNIFORM = wp.constant(0)
VERTEX = wp.constant(1)
TEXTURE = wp.constant(2)
HELD = wp.constant(3)  # uniform, and not learned

# Learned coordinates, the four components of `zeta`.
EPS = wp.constant(0)  # ln(eps_r - 1)
HEIGHT = wp.constant(1)  # ln h
LENGTH = wp.constant(2)  # ln l
FRACTION = wp.constant(3)  # logit tau

# From here outward tau is 0 or 1 to the bit: its slope is below float32, and the sigmoid's adjoint would be inf * 0.
FRACTION_LIMIT = wp.constant(40.0)


@wp.func
def texel(nodes: wp.array(dtype=float), offset: int, width: int, height: int, x: int, y: int) -> float:
    return nodes[offset + wp.clamp(y, 0, height - 1) * width + wp.clamp(x, 0, width - 1)]


@wp.func
def texture_value(nodes: wp.array(dtype=float), offset: int, width: int, height: int, uv: wp.vec2) -> float:
    """Bilinear between texel centres, v up, clamped."""
    x = uv[0] * float(width) - 0.5
    y = (1.0 - uv[1]) * float(height) - 0.5
    x0 = int(wp.floor(x))
    y0 = int(wp.floor(y))
    fx = x - wp.floor(x)
    fy = y - wp.floor(y)
    top = (
        texel(nodes, offset, width, height, x0, y0) * (1.0 - fx) + texel(nodes, offset, width, height, x0 + 1, y0) * fx
    )
    bottom = (
        texel(nodes, offset, width, height, x0, y0 + 1) * (1.0 - fx)
        + texel(nodes, offset, width, height, x0 + 1, y0 + 1) * fx
    )
    return top * (1.0 - fy) + bottom * fy


@wp.func
def held_value(nodes: wp.array(dtype=float), index: int) -> float:
    """A node without a gradient: on CUDA every hit would else add into one address, and nobody asks for the sum."""
    return nodes[index]


@wp.func_grad(held_value)
def adjoint_held_value(nodes: wp.array(dtype=float), index: int, adjoint: float):
    pass


@wp.func
def node_value(nodes: wp.array(dtype=float), place: wp.vec4i, corner: wp.vec3i, b: wp.vec3, uv: wp.vec2) -> float:
    """One parameter at one hit, whatever its layout; `b` holds the three barycentric weights."""
    offset = place[1]
    value = float(0.0)
    if place[0] == UNIFORM:
        value = nodes[offset]
    elif place[0] == HELD:
        value = held_value(nodes, offset)
    elif place[0] == VERTEX:
        value = b[0] * nodes[offset + corner[0]] + b[1] * nodes[offset + corner[1]] + b[2] * nodes[offset + corner[2]]
    else:
        value = texture_value(nodes, offset, place[2], place[3], uv)
    return value


@wp.func
def coordinates_at(
    f: int,
    b: wp.vec3,
    faces: wp.array2d(dtype=int),
    face_material: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    places: wp.array2d(dtype=wp.vec4i),
    nodes: wp.array(dtype=float),
) -> wp.vec4:
    """Learned coordinates on face `f` at barycentric weights `b`; `places` and `uv` as in `gather_kernel`."""
    material = face_material[f]
    corner = wp.vec3i(faces[f, 0], faces[f, 1], faces[f, 2])
    at = wp.vec2(0.0, 0.0)
    if uv.shape[0] > 0:
        at = b[0] * uv[corner[0]] + b[1] * uv[corner[1]] + b[2] * uv[corner[2]]
    return wp.vec4(
        node_value(nodes, places[material, EPS], corner, b, at),
        node_value(nodes, places[material, HEIGHT], corner, b, at),
        node_value(nodes, places[material, LENGTH], corner, b, at),
        node_value(nodes, places[material, FRACTION], corner, b, at),
    )


@wp.kernel
def gather_kernel(
    # In:
    face: wp.array(dtype=int),
    barycentric: wp.array(dtype=wp.vec2),
    faces: wp.array2d(dtype=int),
    face_material: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    places: wp.array2d(dtype=wp.vec4i),
    nodes: wp.array(dtype=float),
    # Out:
    zeta_out: wp.array(dtype=wp.vec4),
):
    """`places` [material, kind]; `uv` per vertex, of length 0 where the mesh has none."""
    i = wp.tid()
    b12 = barycentric[i]
    b = wp.vec3(1.0 - b12[0] - b12[1], b12[0], b12[1])
    zeta_out[i] = coordinates_at(face[i], b, faces, face_material, uv, places, nodes)


@wp.func
def fraction_of(logit: float) -> float:
    value = float(0.0)
    if logit >= FRACTION_LIMIT:
        value = 1.0
    elif logit > -FRACTION_LIMIT:
        value = 1.0 / (1.0 + wp.exp(-logit))
    return value


@wp.func
def sigma0_of(
    polarization: int,
    spectrum: int,
    variant: int,
    wavenumber: float,
    cos_incidence: float,
    cos_twist: float,
    cos2_azimuth: float,
    eps_im: float,
    aspect: float,
    zeta: wp.vec4,
) -> float:
    """sigma0 from the learned coordinates; `aspect` is l_y / l_x of the separable spectrum."""
    length = wp.exp(zeta[LENGTH])
    return sigma0(
        polarization,
        spectrum,
        variant,
        wavenumber,
        cos_incidence,
        cos_twist,
        1.0 + wp.exp(zeta[EPS]),
        eps_im,
        wp.exp(zeta[HEIGHT]),
        length,
        aspect * length,
        cos2_azimuth,
        fraction_of(zeta[FRACTION]),
    )


@wp.kernel
def scatter_kernel(
    # In:
    polarization: int,
    variant: int,
    wavenumber: float,
    local_basis: int,
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    cos_incidence: wp.array(dtype=float),
    cos_twist: wp.array(dtype=float),
    cos2_azimuth: wp.array(dtype=float),
    spectrum: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    aspect: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    # Out:
    sigma_out: wp.array(dtype=float),
):
    i = wp.tid()
    material = face_material[face[i]]
    twist = cos_twist[i]
    if local_basis != 0:
        twist = 1.0
    sigma_out[i] = sigma0_of(
        polarization,
        spectrum[material],
        variant,
        wavenumber,
        cos_incidence[i],
        twist,
        cos2_azimuth[i],
        eps_im[material],
        aspect[material],
        zeta[i],
    )


@wp.kernel
def deposit_kernel(
    # In:
    pixel: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    sigma: wp.array(dtype=float),
    # Out:
    image_out: wp.array(dtype=float),
):
    """beta0: sigma0 dA_perp / cos(theta) / pixel area, added up where it falls (equation 34 with its area)."""
    i = wp.tid()
    wp.atomic_add(image_out, pixel[i], sigma[i] * weight[i])
