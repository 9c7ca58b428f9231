"""Parameters at the hit, and power into the pixel."""

import warp as wp

from warpsar.kernels.codes import Coordinate, Layout
from warpsar.kernels.wide import (
    NODE_LANES,
    read_float,
    read_int,
    read_int64,
    read_row,
    read_vec2,
    read_vec4,
    read_vec4i,
    sum_of_lanes,
    sum_of_node,
    write_vec4,
)


@wp.struct
class OnMesh:
    """Places on a mesh, shape (n,): a face, and the weights of its second and third vertex."""

    face: wp.array(dtype=int)
    barycentric: wp.array(dtype=wp.vec2)


@wp.struct
class NodeMap:
    """Which nodes a place on a mesh has: `places` (layout, offset, width, height) by [material, kind].

    `uv` per vertex, of length 0 where the mesh has none.
    """

    faces: wp.array2d(dtype=int)
    face_material: wp.array(dtype=int)
    uv: wp.array(dtype=wp.vec2)
    places: wp.array2d(dtype=wp.vec4i)


@wp.struct
class HitSurfaces:
    """What sigma0 of a view's hits depends on beside their learned coordinates, in one polarization.

    Of hits, shape (n,): `face` and the cosines, as in `warpsar.trace.hits.Hits`. Of materials: `spectrum`, `eps_im` and
    `aspect`. `local_basis`: 1 where polarizations are those of each facet, which so has no twist. `polarization`,
    `variant` and `spectrum` are codes; `wavenumber` [rad/m].
    """

    polarization: int
    variant: int
    wavenumber: float
    local_basis: int
    face: wp.array(dtype=int)
    face_material: wp.array(dtype=int)
    cos_incidence: wp.array(dtype=float)
    cos_twist: wp.array(dtype=float)
    cos2_azimuth: wp.array(dtype=float)
    spectrum: wp.array(dtype=int)
    eps_im: wp.array(dtype=float)
    aspect: wp.array(dtype=float)


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
def node_value(nodes: wp.array(dtype=float), place: wp.vec4i, corner: wp.vec3i, b: wp.vec3, uv: wp.vec2) -> float:
    """One parameter at one hit, whatever its layout; `b` holds the three barycentric weights.

    `place`: (layout, offset, width, height) of its nodes.
    """
    offset = place[1]
    value = float(0.0)
    if place[0] == Layout.UNIFORM or place[0] == Layout.HELD:
        value = nodes[offset]
    elif place[0] == Layout.VERTEX:
        value = b[0] * nodes[offset + corner[0]] + b[1] * nodes[offset + corner[1]] + b[2] * nodes[offset + corner[2]]
    else:
        value = texture_value(nodes, offset, place[2], place[3], uv)
    return value


@wp.func
def coordinates_at(f: int, b: wp.vec3, node_map: NodeMap, nodes: wp.array(dtype=float)) -> wp.vec4:
    """Learned coordinates on face `f` at barycentric weights `b`."""
    material = read_int(node_map.face_material, f)
    corner = read_row(node_map.faces, f)
    at = wp.vec2(0.0, 0.0)
    if node_map.uv.shape[0] > 0:
        at = b[0] * node_map.uv[corner[0]] + b[1] * node_map.uv[corner[1]] + b[2] * node_map.uv[corner[2]]
    return wp.vec4(
        node_value(nodes, read_vec4i(node_map.places, material, Coordinate.EPS), corner, b, at),
        node_value(nodes, read_vec4i(node_map.places, material, Coordinate.HEIGHT), corner, b, at),
        node_value(nodes, read_vec4i(node_map.places, material, Coordinate.LENGTH), corner, b, at),
        node_value(nodes, read_vec4i(node_map.places, material, Coordinate.FRACTION), corner, b, at),
    )


@wp.struct
class NodeShare:
    """A node, counted from its parameter's first, and its share in the value at a hit."""

    node: int
    share: float


@wp.func
def site_of(place: wp.vec4i, corner: wp.vec3i, b: wp.vec3, uv: wp.vec2, index: int) -> NodeShare:
    """Node number `index` of those that `node_value` mixes."""
    site = NodeShare()
    site.node = 0
    site.share = 1.0
    if place[0] == Layout.VERTEX:
        site.node = corner[index]
        site.share = b[index]
    elif place[0] == Layout.TEXTURE:
        x = uv[0] * float(place[2]) - 0.5
        y = (1.0 - uv[1]) * float(place[3]) - 0.5
        right = index % 2
        down = index // 2
        fx = x - wp.floor(x)
        fy = y - wp.floor(y)
        column = wp.clamp(int(wp.floor(x)) + right, 0, place[2] - 1)
        row = wp.clamp(int(wp.floor(y)) + down, 0, place[3] - 1)
        site.node = row * place[2] + column
        site.share = wp.where(right == 1, fx, 1.0 - fx) * wp.where(down == 1, fy, 1.0 - fy)
    return site


@wp.func
def site_at(hit: int, term: int, hits: OnMesh, node_map: NodeMap, terms: wp.array2d(dtype=wp.vec2i)) -> NodeShare:
    """The node (in all of `nodes`) and share that a term of a hit's coordinates has; no node (-1) for no such term."""
    f = hits.face[hit]
    material = node_map.face_material[f]
    kind = terms[material, term][0]
    site = NodeShare()
    site.node = -1
    if kind >= 0:
        corner = wp.vec3i(node_map.faces[f, 0], node_map.faces[f, 1], node_map.faces[f, 2])
        b12 = hits.barycentric[hit]
        b = wp.vec3(1.0 - b12[0] - b12[1], b12[0], b12[1])
        at = wp.vec2(0.0, 0.0)
        if node_map.uv.shape[0] > 0:
            at = b[0] * node_map.uv[corner[0]] + b[1] * node_map.uv[corner[1]] + b[2] * node_map.uv[corner[2]]
        site = site_of(node_map.places[material, kind], corner, b, at, terms[material, term][1])
        site.node += node_map.places[material, kind][1]
    return site


@wp.kernel(enable_backward=False)
def site_kernel(
    # In:
    hits: OnMesh,
    node_map: NodeMap,
    terms: wp.array2d(dtype=wp.vec2i),
    none: int,
    # Out:
    node_out: wp.array(dtype=int),
    entry_out: wp.array(dtype=int),
):
    """Node of every term of every hit, `none` where there is no such term, and the terms numbered."""
    i = wp.tid()
    site = site_at(i // terms.shape[1], i % terms.shape[1], hits, node_map, terms)
    node_out[i] = wp.where(site.node >= 0, site.node, none)
    entry_out[i] = i


@wp.kernel(enable_backward=False)
def share_kernel(
    # In:
    hits: OnMesh,
    node_map: NodeMap,
    entry: wp.array(dtype=int),
    terms: wp.array2d(dtype=wp.vec2i),
    # Out:
    part_out: wp.array(dtype=wp.int64),
):
    """The hit of an entry, and its share in the low 32 bits: one number, read at once."""
    i = wp.tid()
    hit = entry[i] // terms.shape[1]
    site = site_at(hit, entry[i] % terms.shape[1], hits, node_map, terms)
    part_out[i] = (wp.int64(hit) << wp.int64(32)) + wp.int64(wp.cast(site.share, wp.uint32))


@wp.kernel(enable_backward=False)
def target_kernel(
    # In:
    hits: OnMesh,
    node_map: NodeMap,
    first: wp.array(dtype=int),
    entry: wp.array(dtype=int),
    node: wp.array(dtype=int),
    terms: wp.array2d(dtype=wp.vec2i),
    leader: wp.array2d(dtype=int),
    # Out:
    target_out: wp.array(dtype=wp.vec4i),
):
    """Nodes of the four parameters that a stretch adds to, -1 for none: those laid out as the first one is."""
    s = wp.tid()
    i = first[s]
    material = node_map.face_material[hits.face[entry[i] // terms.shape[1]]]
    kind = terms[material, entry[i] % terms.shape[1]][0]
    target = wp.vec4i(-1, -1, -1, -1)
    for k in range(4):
        if leader[material, k] == kind:
            target[k] = node[i] - node_map.places[material, kind][1] + node_map.places[material, k][1]
    target_out[s] = target


@wp.kernel(enable_backward=False)
def spread_kernel(
    # In:
    first: wp.array(dtype=int),
    target: wp.array(dtype=wp.vec4i),
    part: wp.array(dtype=wp.int64),
    zeta_gradient: wp.array(dtype=wp.vec4),
    # Out:
    nodes_gradient_out: wp.array(dtype=float),
):
    """The adjoint of `gather_kernel` to `nodes`: NODE_LANES threads add up one node's stretch of hits."""
    t = wp.tid()
    s = t // NODE_LANES
    lane = t % NODE_LANES
    end = part.shape[0]
    if s + 1 < first.shape[0]:
        end = read_int(first, s + 1)
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for i in range(read_int(first, s) + lane, end, NODE_LANES):
        entry = read_int64(part, i)
        share = wp.cast(wp.uint32(entry & wp.int64(0xFFFFFFFF)), float)
        total += share * read_vec4(zeta_gradient, int(entry >> wp.int64(32)))
    total = sum_of_node(total)
    node = target[s]
    for k in range(4):
        if lane == 0 and node[k] >= 0:
            wp.atomic_add(nodes_gradient_out, node[k], total[k])


@wp.kernel(enable_backward=False)
def gather_kernel(
    # In:
    hits: OnMesh,
    node_map: NodeMap,
    nodes: wp.array(dtype=float),
    # Out:
    zeta_out: wp.array(dtype=wp.vec4),
):
    """The learned coordinates of places on the mesh."""
    i = wp.tid()
    b12 = read_vec2(hits.barycentric, i)
    b = wp.vec3(1.0 - b12[0] - b12[1], b12[0], b12[1])
    write_vec4(zeta_out, i, coordinates_at(read_int(hits.face, i), b, node_map, nodes))


@wp.kernel(enable_backward=False)
def scatter_adjoint_kernel(
    # In:
    slopes: wp.array(dtype=wp.vec4),
    sigma_gradient: wp.array(dtype=float),
    # Out:
    zeta_gradient_out: wp.array(dtype=wp.vec4),
):
    i = wp.tid()
    gradient = read_float(sigma_gradient, i) * read_vec4(slopes, i)
    write_vec4(zeta_gradient_out, i, read_vec4(zeta_gradient_out, i) + gradient)


@wp.kernel(enable_backward=False)
def deposit_kernel(
    # In:
    first: wp.array(dtype=int),
    pixel: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    sigma: wp.array(dtype=float),
    lanes: int,
    # Out:
    image_out: wp.array(dtype=float),
):
    """beta0: sigma0 dA_perp / cos(theta) / pixel area, added up where it falls (equation 34 with its area).

    Hits lie pixel by pixel, from `first` on: `lanes` threads (1 or LANES) add up a pixel's hits, always in the same
    order, so that a sum is the same to the bit in every run and however the hits are cut into bands.
    """
    t = wp.tid()
    s = t // lanes
    lane = t - s * lanes
    begin = read_int(first, s)
    end = pixel.shape[0]
    if s + 1 < first.shape[0]:
        end = read_int(first, s + 1)
    total = float(0.0)
    for k in range(begin + lane, end, lanes):
        total += read_float(sigma, k) * read_float(weight, k)
    total = sum_of_lanes(total)
    if lane == 0:
        wp.atomic_add(image_out, pixel[begin], total)


@wp.kernel(enable_backward=False)
def deposit_adjoint_kernel(
    # In:
    pixel: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    image_gradient: wp.array(dtype=float),
    # Out:
    sigma_gradient_out: wp.array(dtype=float),
):
    i = wp.tid()
    gradient = read_float(weight, i) * read_float(image_gradient, read_int(pixel, i))
    sigma_gradient_out[i] = sigma_gradient_out[i] + gradient


@wp.kernel
def take_kernel(
    # In:
    sample: wp.array(dtype=int),
    sigma: wp.array(dtype=float),
    # Out:
    taken_out: wp.array(dtype=float),
):
    """sigma0 of every bin, from the one sample that several share."""
    i = wp.tid()
    taken_out[i] = sigma[sample[i]]
