"""Amplitudes with all that is discrete held, for reverse mode: vertices and materials are inputs.

Held are the rays, the faces that they meet and in which order, what the radar sees, and how many scatterers there are.
A tube is followed by one launch for each bounce: a loop would lose the states that an adjoint needs. Values are those
of the kernels of the sweep, by the same functions.
"""

import warp as wp

from warpsar.kernels.coherent.coated_edges import diffracted_of
from warpsar.kernels.coherent.edges import Edge, diffracted
from warpsar.kernels.coherent.numbers import sinc, turned
from warpsar.kernels.coherent.radiate import (
    Four,
    Pair,
    bounced_fields,
    flat_sent,
    sent,
    slab_sent,
    tube_factor,
)
from warpsar.kernels.coherent.reflection import Face
from warpsar.kernels.coherent.rough import RoughSurface, Scatterer, scattered
from warpsar.kernels.coherent.tubes import (
    Hit,
    Tube,
    TubeMesh,
    TubeRadar,
    bounced,
    hit_of,
    look,
    met,
    start_tube,
    way_to,
)

PI = wp.constant(wp.float64(3.141592653589793))


@wp.func
def add(amplitude: wp.array3d[wp.vec2d], slot: int, f: int, four: Four):
    wp.atomic_add(amplitude, slot, f, 0, four.hh)
    wp.atomic_add(amplitude, slot, f, 1, four.hv)
    wp.atomic_add(amplitude, slot, f, 2, four.vh)
    wp.atomic_add(amplitude, slot, f, 3, four.vv)


# Normals of smooth surfaces


@wp.kernel
def fans_kernel(
    # In:
    vertices_in: wp.array[wp.vec3d],
    faces_in: wp.array2d[int],
    some_in: wp.array[int],
    fan_in: wp.array2d[int],
    # Out:
    total_out: wp.array[wp.vec3d],
):
    """Weighted normals at the corners of curved faces (Max 1999), added up over those that share one."""
    f = some_in[wp.tid()]
    for i in range(3):
        p = vertices_in[faces_in[f, i]]
        e1 = vertices_in[faces_in[f, (i + 1) % 3]] - p
        e2 = vertices_in[faces_in[f, (i + 2) % 3]] - p
        wp.atomic_add(total_out, fan_in[f, i], wp.cross(e1, e2) / (wp.dot(e1, e1) * wp.dot(e2, e2)))


@wp.kernel
def normals_kernel(
    # In:
    total_in: wp.array[wp.vec3d],
    some_in: wp.array[int],
    fan_in: wp.array2d[int],
    # Out:
    normals_out: wp.array2d[wp.vec3d],
):
    f = some_in[wp.tid()]
    for i in range(3):
        normals_out[f, i] = wp.normalize(total_in[fan_in[f, i]])


# Tubes, bounce by bounce


@wp.func
def weights_on(e1: wp.vec3d, e2: wp.vec3d, x: wp.vec3d) -> wp.vec2d:
    """x as a sum of two sides of a triangle, for x in its plane."""
    g11 = wp.dot(e1, e1)
    g12 = wp.dot(e1, e2)
    g22 = wp.dot(e2, e2)
    a = wp.dot(e1, x)
    b = wp.dot(e2, x)
    return wp.vec2d(g22 * a - g12 * b, g11 * b - g12 * a) / (g11 * g22 - g12 * g12)


@wp.func
def cast(radar: TubeRadar, x: wp.vec3d, dx: wp.vec3d) -> wp.vec3d:
    """How the place in the plane across `s` moves whose ray meets x, as x moves by dx."""
    if radar.near == 0:
        return dx
    to = x - radar.place
    height = wp.dot(radar.place, radar.s)
    ratio = -height / wp.dot(to, radar.s)
    return ratio * (dx - (wp.dot(dx, radar.s) / wp.dot(to, radar.s)) * to)


@wp.kernel
def begin_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    view_in: wp.array[int],
    vertices_in: wp.array[wp.vec3d],
    held: TubeMesh,
    face_in: wp.array[int],
    place_in: wp.array[wp.vec2d],
    side_u_in: wp.array[wp.vec2d],
    side_v_in: wp.array[wp.vec2d],
    standoff: wp.float64,
    # Out:
    tube_out: wp.array[Tube],
):
    """Tubes where they start.

    A tube that meets a curved surface first belongs to a place of its first face, and moves with the vertices: at the
    silhouette the way changes without bounds for a tube that stays. `held`: the mesh without a gradient.
    """
    i = wp.tid()
    radar = radar_in[view_in[i]]
    f = face_in[i]
    known = start_tube(radar, place_in[i], side_u_in[i], side_v_in[i], standoff, held.reach)
    if held.curved[f] == 0:
        tube_out[i] = known
        return
    at = met(known, way_to(known, held.vertices, held.faces, f), held.vertices, held.faces, held.normals, 0, f)
    q0 = held.vertices[held.faces[f, 0]]
    q1 = held.vertices[held.faces[f, 1]] - q0
    q2 = held.vertices[held.faces[f, 2]] - q0
    here = weights_on(q1, q2, at.point - q0)
    along_u = weights_on(q1, q2, at.pu)
    along_v = weights_on(q1, q2, at.pv)
    p0 = vertices_in[held.faces[f, 0]]
    e1 = vertices_in[held.faces[f, 1]] - p0
    e2 = vertices_in[held.faces[f, 2]] - p0
    x = p0 + here[0] * e1 + here[1] * e2
    xu = cast(radar, x, along_u[0] * e1 + along_u[1] * e2)
    xv = cast(radar, x, along_v[0] * e1 + along_v[1] * e2)
    if radar.near != 0:
        to = x - radar.place
        x = radar.place - (wp.dot(radar.place, radar.s) / wp.dot(to, radar.s)) * to
    place = wp.vec2d(wp.dot(x, radar.u), wp.dot(x, radar.v))
    side_u = wp.vec2d(wp.dot(xu, radar.u), wp.dot(xu, radar.v))
    side_v = wp.vec2d(wp.dot(xv, radar.u), wp.dot(xv, radar.v))
    tube_out[i] = start_tube(radar, place, side_u, side_v, standoff, held.reach)


@wp.kernel
def meet_kernel(
    # In:
    vertices_in: wp.array[wp.vec3d],
    faces_in: wp.array2d[int],
    normals_in: wp.array2d[wp.vec3d],
    curved_in: wp.array[int],
    face_in: wp.array[int],
    caustics_in: wp.array[int],
    tube_in: wp.array[Tube],
    # Out:
    hit_out: wp.array[Hit],
    tube_out: wp.array[Tube],
):
    """Tubes on their next faces, and after them."""
    i = wp.tid()
    f = face_in[i]
    tube = tube_in[i]
    at = met(tube, way_to(tube, vertices_in, faces_in, f), vertices_in, faces_in, normals_in, curved_in[f], f)
    hit = hit_of(tube, at)
    hit.face = f
    hit.caustics = caustics_in[i]
    hit_out[i] = hit
    tube_out[i] = bounced(tube, at)


@wp.kernel
def radiate_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    wavenumber_in: wp.array[wp.float64],
    stuff_in: wp.array2d[Face],
    material_in: wp.array[int],
    view_in: wp.array[int],
    counts_in: wp.array[int],
    slot_in: wp.array[int],
    hit_in: wp.array[Hit],
    fields_in: wp.array2d[Pair],
    # Out:
    fields_out: wp.array2d[Pair],
    amplitude_out: wp.array3d[wp.vec2d],
):
    """The fields of tubes after a bounce, shape (tubes, frequencies), and what the bounce sends to the radar."""
    i, f = wp.tid()
    k = wavenumber_in[f]
    hit = hit_in[i]
    fields = fields_in[i, f]
    back = bounced_fields(stuff_in[f, material_in[hit.face]], k, fields, hit.d, hit.normal)
    fields_out[i, f] = back
    if counts_in[i] != 0:
        radar = radar_in[view_in[i]]
        sight = look(radar, hit.point, 0.0)
        factor = tube_factor(k, hit, sight)
        four = sent(factor, fields, back, hit.d, hit.normal, sight.s, radar.u, radar.v)
        add(amplitude_out, slot_in[i], f, four)


# Flat faces, edges, scatterers


@wp.func
def triangle_integral(p0: wp.vec3d, p1: wp.vec3d, p2: wp.vec3d, n: wp.vec3d, k: wp.float64, s: wp.vec3d) -> wp.vec2d:
    """INT e^{2jk s.r} dS over a triangle with the unit normal n (Gordon 1975), as `radiate.phase_integral`."""
    two_k = wp.float64(2.0) * k
    half = wp.float64(0.5)
    w = two_k * (s - wp.dot(s, n) * n)
    size = wp.dot(w, w)
    a = p1 - p0
    b = p2 - p1
    c = p0 - p2
    reach = wp.max(wp.length(a), wp.max(wp.length(b), wp.length(c)))
    if size * reach * reach < wp.float64(1.0e-8):
        area = half * wp.dot(n, wp.cross(a, b))
        return area * turned(two_k * wp.dot(s, (p0 + p1 + p2) / wp.float64(3.0)))
    total = wp.dot(w, wp.cross(a, n)) * sinc(half * wp.dot(w, a)) * turned(two_k * wp.dot(s, half * (p0 + p1)))
    total += wp.dot(w, wp.cross(b, n)) * sinc(half * wp.dot(w, b)) * turned(two_k * wp.dot(s, half * (p1 + p2)))
    total += wp.dot(w, wp.cross(c, n)) * sinc(half * wp.dot(w, c)) * turned(two_k * wp.dot(s, half * (p2 + p0)))
    return wp.vec2d(total[1], -total[0]) / size


@wp.kernel
def facets_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    wavenumber_in: wp.array[wp.float64],
    stuff_in: wp.array2d[Face],
    material_in: wp.array[int],
    vertices_in: wp.array[wp.vec3d],
    faces_in: wp.array2d[int],
    view_in: wp.array[int],
    some_in: wp.array[int],
    slabs: int,
    # Out:
    amplitude_out: wp.array3d[wp.vec2d],
):
    """The faces of flat regions that are lit as a whole, each by its own border; `slabs` as in `regions_kernel`."""
    i, f = wp.tid()
    face = some_in[i]
    k = wavenumber_in[f]
    view = view_in[i]
    radar = radar_in[view]
    p0 = vertices_in[faces_in[face, 0]]
    p1 = vertices_in[faces_in[face, 1]]
    p2 = vertices_in[faces_in[face, 2]]
    n = wp.normalize(wp.cross(p1 - p0, p2 - p0))
    integral = triangle_integral(p0, p1, p2, n, k, radar.s)
    stuff = stuff_in[f, material_in[face]]
    if slabs != 0:
        add(amplitude_out, view, f, slab_sent(stuff, k, integral, n, radar.s, radar.u, radar.v))
    else:
        add(amplitude_out, view, f, flat_sent(stuff, k, integral, n, radar.s, radar.u, radar.v))


@wp.struct
class Seam:
    """A piece of a wedge's edge, by the vertices that it hangs on."""

    first: int  # vertices of the edge
    last: int
    begin: wp.float64  # where on the way between them the piece begins and ends, 0 to 1
    end: wp.float64
    face: int  # its two faces
    other: int
    into_face: wp.float64  # signs that turn the vectors of `wedge_of` as shape.py has them
    into_other: wp.float64
    up_face: wp.float64
    up_other: wp.float64
    sheet: int
    share: wp.float64


@wp.func
def normal_of(vertices: wp.array[wp.vec3d], faces: wp.array2d[int], f: int) -> wp.vec3d:
    p = vertices[faces[f, 0]]
    return wp.normalize(wp.cross(vertices[faces[f, 1]] - p, vertices[faces[f, 2]] - p))


@wp.kernel
def surfaces_kernel(
    # In:
    vertices_in: wp.array[wp.vec3d],
    faces_in: wp.array2d[int],
    some_in: wp.array[int],
    surface_in: wp.array[int],
    # Out:
    total_out: wp.array[wp.vec4d],
):
    """The faces' middles times their areas, and their areas, added up over each surface."""
    f = some_in[wp.tid()]
    a = vertices_in[faces_in[f, 0]]
    b = vertices_in[faces_in[f, 1]]
    c = vertices_in[faces_in[f, 2]]
    area = wp.float64(0.5) * wp.length(wp.cross(b - a, c - a))
    x = area * (a + b + c) / wp.float64(3.0)
    wp.atomic_add(total_out, surface_in[f], wp.vec4d(x[0], x[1], x[2], area))


@wp.func
def reach_of(total: wp.vec4d, place: wp.vec3d, into: wp.vec3d) -> wp.float64:
    """How far a surface goes from an edge, as `Wedges.reach`, by what `surfaces_kernel` adds up."""
    middle = wp.vec3d(total[0], total[1], total[2]) / total[3]
    return wp.float64(2.0) * wp.max(wp.dot(middle - place, into), wp.float64(0.0))


@wp.func
def edge_of(
    seam: Seam,
    vertices: wp.array[wp.vec3d],
    faces: wp.array2d[int],
    surface: wp.array[int],
    total: wp.array[wp.vec4d],
) -> Edge:
    """The piece of an edge with its faces' directions, normals, lengths and outer angle."""
    a = vertices[seam.first]
    way = vertices[seam.last] - a
    along = wp.normalize(way)
    first = seam.into_face * wp.normalize(wp.cross(normal_of(vertices, faces, seam.face), along))
    second = seam.into_other * wp.normalize(wp.cross(normal_of(vertices, faces, seam.other), along))
    normal = seam.up_face * wp.cross(along, first)
    other = -normal
    outer = wp.float64(2.0)
    if seam.sheet == 0:
        other = seam.up_other * wp.cross(along, second)
        between = wp.atan2(wp.length(wp.cross(first, second)), wp.dot(first, second))
        outer = wp.float64(2.0) - between / PI
    edge = Edge()
    edge.middle = a + wp.float64(0.5) * (seam.begin + seam.end) * way
    edge.along = (seam.end - seam.begin) * way
    edge.first = first
    edge.second = second
    edge.normal_first = normal
    edge.normal_second = other
    edge.outer = outer
    edge.share = seam.share
    edge.reach_first = reach_of(total[surface[seam.face]], edge.middle, first)
    edge.reach_second = reach_of(total[surface[seam.other]], edge.middle, second)
    return edge


@wp.kernel
def seams_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    wavenumber_in: wp.array[wp.float64],
    vertices_in: wp.array[wp.vec3d],
    faces_in: wp.array2d[int],
    surface_in: wp.array[int],
    total_in: wp.array[wp.vec4d],
    view_in: wp.array[int],
    which_in: wp.array[int],
    seam_in: wp.array[Seam],
    # Out:
    amplitude_out: wp.array3d[wp.vec2d],
):
    """Fringe currents of pieces of edges: `which_in` each view sees."""
    i, f = wp.tid()
    view = view_in[i]
    edge = edge_of(seam_in[which_in[i]], vertices_in, faces_in, surface_in, total_in)
    add(amplitude_out, view, f, diffracted(radar_in[view], wavenumber_in[f], edge))


@wp.kernel(module="unique")
def coated_seams_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    wavenumber_in: wp.array[wp.float64],
    vertices_in: wp.array[wp.vec3d],
    faces_in: wp.array2d[int],
    surface_in: wp.array[int],
    total_in: wp.array[wp.vec4d],
    view_in: wp.array[int],
    which_in: wp.array[int],
    seam_in: wp.array[Seam],
    stuff_in: wp.array2d[Face],
    material_in: wp.array[int],
    # Out:
    amplitude_out: wp.array3d[wp.vec2d],
):
    """As `seams_kernel`, with coats."""
    i, f = wp.tid()
    view = view_in[i]
    seam = seam_in[which_in[i]]
    edge = edge_of(seam, vertices_in, faces_in, surface_in, total_in)
    edge.material_first = material_in[seam.face]
    edge.material_second = material_in[seam.other]
    add(amplitude_out, view, f, diffracted_of(radar_in[view], wavenumber_in[f], edge, stuff_in, f))


@wp.kernel
def places_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    wavenumber_in: wp.array[wp.float64],
    surface_in: wp.array[RoughSurface],
    variant: int,
    vertices_in: wp.array[wp.vec3d],
    faces_in: wp.array2d[int],
    view_in: wp.array[int],
    scatterer_in: wp.array[Scatterer],
    face_in: wp.array[int],
    at_in: wp.array[wp.vec2d],
    # Out:
    amplitude_out: wp.array3d[wp.vec2d],
):
    """Scatterers of rough faces, which move and turn with their faces."""
    i, f = wp.tid()
    face = face_in[i]
    at = at_in[i]
    p = vertices_in[faces_in[face, 0]]
    e1 = vertices_in[faces_in[face, 1]] - p
    e2 = vertices_in[faces_in[face, 2]] - p
    known = scatterer_in[i]
    place = Scatterer()
    place.point = p + at[0] * e1 + at[1] * e2
    place.normal = wp.normalize(wp.cross(e1, e2))
    place.area = known.area
    place.diffuse = known.diffuse
    place.specular = known.specular
    place.material = known.material
    view = view_in[i]
    surface = surface_in[known.material]
    add(amplitude_out, view, f, scattered(radar_in[view], wavenumber_in[f], surface, variant, place))


# Borders of light: where neighbouring rays meet other faces


@wp.func
def corner_weight(tube: Tube, vertices: wp.array[wp.vec3d], faces: wp.array2d[int], f: int, corner: int) -> wp.vec3d:
    """Where a ray crosses a face's plane: the barycentric weight of a corner, which is 0 on the edge opposite to it.

    Second and third: how it changes along the sides of the tube.
    """
    a = vertices[faces[f, (corner + 1) % 3]]
    b = vertices[faces[f, (corner + 2) % 3]]
    p = vertices[faces[f, corner]]
    plane = wp.cross(b - a, p - a)
    area = wp.dot(plane, plane)
    t = way_to(tube, vertices, faces, f)
    x = tube.point + t * tube.d
    pu = tube.pu + t * tube.du
    pv = tube.pv + t * tube.dv
    pu = pu - (wp.dot(plane, pu) / wp.dot(plane, tube.d)) * tube.d
    pv = pv - (wp.dot(plane, pv) / wp.dot(plane, tube.d)) * tube.d
    across = wp.cross(plane, b - a)
    return wp.vec3d(wp.dot(across, x - a), wp.dot(across, pu), wp.dot(across, pv)) / area


@wp.kernel
def rims_kernel(
    # In:
    vertices_in: wp.array[wp.vec3d],
    faces_in: wp.array2d[int],
    which_in: wp.array[int],
    face_in: wp.array[int],
    corner_in: wp.array[int],
    tube_in: wp.array[Tube],
    # Out:
    weight_out: wp.array[wp.vec3d],
):
    """Where tubes pass the edge of a face that ends what they meet."""
    i = which_in[wp.tid()]
    weight_out[i] = corner_weight(tube_in[i], vertices_in, faces_in, face_in[i], corner_in[i])


@wp.func
def homeward(radar: TubeRadar, hit: Hit) -> Tube:
    """The tube of the ways from a footprint to the radar."""
    sight = look(radar, hit.point, 0.0)
    s = sight.s
    tube = Tube()
    tube.point = hit.point
    tube.d = s
    tube.pu = hit.across_u
    tube.pv = hit.across_v
    if radar.near != 0:
        distance = radar.distance / sight.spread
        tube.du = (wp.dot(s, hit.across_u) * s - hit.across_u) / distance
        tube.dv = (wp.dot(s, hit.across_v) * s - hit.across_v) / distance
    return tube


@wp.kernel
def shades_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    view_in: wp.array[int],
    vertices_in: wp.array[wp.vec3d],
    faces_in: wp.array2d[int],
    which_in: wp.array[int],
    face_in: wp.array[int],
    corner_in: wp.array[int],
    hit_in: wp.array[Hit],
    # Out:
    weight_out: wp.array[wp.vec3d],
):
    """Where the ways from hits back to the radar pass the edge of a face that shades them."""
    i = which_in[wp.tid()]
    tube = homeward(radar_in[view_in[i]], hit_in[i])
    weight_out[i] = corner_weight(tube, vertices_in, faces_in, face_in[i], corner_in[i])
