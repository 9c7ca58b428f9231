"""Ray tubes: rays that are reflected until they leave, each with its path, differentials and caustics.

Ling, Chou, Lee (IEEE TAP 37(2), 1989): tubes. Igehy (SIGGRAPH 1999): differentials, with the curvature of the surface.
"""

import warp as wp

from warpsar.kernels.coherent.cells import Cells, TubeEnds
from warpsar.kernels.coherent.numbers import root


@wp.struct
class Hit:
    """Where a tube meets a face."""

    point: wp.vec3d  # [m]
    normal: wp.vec3d  # toward the side that the tube comes from
    d: wp.vec3d  # direction on arrival
    across_u: wp.vec3d  # sides of the tube's footprint on the face [m]
    across_v: wp.vec3d
    path: wp.float64  # [m] from the plane of the reference point across the look direction
    weight: wp.float64  # field times area: sqrt(a0 |a|) / cos [m2]
    caustics: int
    face: int
    seen: int  # by the radar


@wp.struct
class TubeMesh:
    """A mesh for rays: float32 in its tree, float64 where they hit."""

    tree: wp.uint64
    vertices: wp.array[wp.vec3d]
    faces: wp.array2d[int]
    normals: wp.array2d[wp.vec3d]  # of the corners of each face, as they are on the smooth surface
    curved: wp.array[int]
    offset: wp.float64  # rays start this far from a face [m]
    reach: float


@wp.struct
class TubeRadar:
    """Where a view's radar stands about the body's middle. `near` is 0 for a plane wave, which has no place."""

    s: wp.vec3d  # unit vector to it, from the reference point
    u: wp.vec3d  # H
    v: wp.vec3d  # V
    place: wp.vec3d  # [m]
    distance: wp.float64  # of the reference point [m]
    near: int


@wp.struct
class Tube:
    """A tube that is on its way to a face."""

    point: wp.vec3d  # [m]
    d: wp.vec3d
    pu: wp.vec3d  # its sides across d [m]
    pv: wp.vec3d
    du: wp.vec3d  # change of d along either side
    dv: wp.vec3d
    path: wp.float64  # [m] from the plane of the reference point across the look direction
    initial: wp.float64  # cross-section in that plane [m2]


@wp.struct
class Meeting:
    """A tube where it meets a face."""

    point: wp.vec3d  # [m]
    flat: wp.vec3d  # normal of the facet, toward the side that the tube comes from
    normal: wp.vec3d  # of the smooth surface
    nu: wp.vec3d  # its change along either side of the tube
    nv: wp.vec3d
    pu: wp.vec3d  # sides of the footprint on the facet [m]
    pv: wp.vec3d
    out: wp.vec3d  # direction after it, not quite of unit length
    path: wp.float64  # [m]


@wp.struct
class Look:
    """The radar as a point of the body sees it."""

    s: wp.vec3d  # unit vector to it
    back: wp.float64  # way to it, less that of the reference point [m]
    spread: wp.float64  # field over that at the reference point's distance
    reach: wp.float64  # of a ray to it [m]


@wp.func
def look(radar: TubeRadar, point: wp.vec3d, reach: float) -> Look:
    found = Look()
    if radar.near != 0:
        to = radar.place - point
        distance = wp.length(to)
        found.s = to / distance
        found.back = distance - radar.distance
        found.spread = radar.distance / distance
        found.reach = wp.min(distance, wp.float64(reach))
        return found
    found.s = radar.s
    found.back = -wp.dot(radar.s, point)
    found.spread = wp.float64(1.0)
    found.reach = wp.float64(reach)
    return found


@wp.func
def free(body: TubeMesh, radar: TubeRadar, point: wp.vec3d, normal: wp.vec3d) -> int:
    """Whether nothing lies between a point and the radar."""
    seen = look(radar, point, body.reach)
    start = point + body.offset * normal
    if wp.mesh_query_ray_anyhit(body.tree, wp.vec3(start), wp.vec3(seen.s), wp.float32(seen.reach)):
        return 0
    return 1


@wp.func
def crossings(a0: wp.float64, a1: wp.float64, a2: wp.float64, t: wp.float64) -> int:
    """Roots of a0 + a1 x + a2 x^2 between 0 and t, a double one twice: the caustics on a stretch of a tube."""
    zero = wp.float64(0.0)
    count = int(0)
    if wp.abs(a2) * t * t <= wp.float64(1.0e-12) * (wp.abs(a0) + wp.abs(a1) * t):
        if a1 != zero:
            x = -a0 / a1
            if x > zero and x < t:
                count = 1
        return count
    under = a1 * a1 - wp.float64(4.0) * a2 * a0
    if under < zero:
        return 0
    q = -wp.float64(0.5) * (a1 + wp.where(a1 < zero, -wp.sqrt(under), wp.sqrt(under)))
    x = q / a2
    if x > zero and x < t:
        count += 1
    if q != zero:
        y = a0 / q
        if y > zero and y < t:
            count += 1
    return count


@wp.func
def start_tube(
    radar: TubeRadar, place: wp.vec2d, side_u: wp.vec2d, side_v: wp.vec2d, standoff: wp.float64, reach: float
) -> Tube:
    """The tube of a cell of the plane across `s`: its middle and its sides along u and v [m]."""
    point = place[0] * radar.u + place[1] * radar.v
    sight = look(radar, point, reach)
    d = -sight.s
    pu = side_u[0] * radar.u + side_u[1] * radar.v
    pv = side_v[0] * radar.u + side_v[1] * radar.v
    tube = Tube()
    tube.d = d
    tube.path = sight.back - standoff
    initial = wp.abs(wp.dot(d, wp.cross(pu, pv)))
    if radar.near != 0:  # rays from one place
        initial = initial * sight.spread * sight.spread
        distance = wp.length(radar.place - point)
        du = (pu - wp.dot(d, pu) * d) / distance
        dv = (pv - wp.dot(d, pv) * d) / distance
        tube.du = du
        tube.dv = dv
        pu = pu - standoff * du
        pv = pv - standoff * dv
    tube.pu = pu
    tube.pv = pv
    tube.point = point - standoff * d
    tube.initial = initial
    return tube


@wp.func
def way_to(tube: Tube, vertices: wp.array[wp.vec3d], faces: wp.array2d[int], f: int) -> wp.float64:
    """Way of a tube to the plane of a face [m]; 0 where it runs along it."""
    p0 = vertices[faces[f, 0]]
    plane = wp.cross(vertices[faces[f, 1]] - p0, vertices[faces[f, 2]] - p0)
    slope = wp.dot(plane, tube.d)
    if slope == wp.float64(0.0):
        return wp.float64(0.0)
    return wp.dot(plane, p0 - tube.point) / slope


@wp.func
def met(
    tube: Tube,
    t: wp.float64,
    vertices: wp.array[wp.vec3d],
    faces: wp.array2d[int],
    normals: wp.array2d[wp.vec3d],
    curved: int,
    f: int,
) -> Meeting:
    """A tube on a face at the end of a way `t`, with the normal of the smooth surface there."""
    zero = wp.float64(0.0)
    two = wp.float64(2.0)
    d = tube.d
    p0 = vertices[faces[f, 0]]
    e1 = vertices[faces[f, 1]] - p0
    e2 = vertices[faces[f, 2]] - p0
    plane = wp.cross(e1, e2)
    flat = wp.normalize(plane)
    if wp.dot(plane, d) > zero:
        flat = -flat
    point = tube.point + t * d
    pu = tube.pu + t * tube.du
    pv = tube.pv + t * tube.dv
    pu = pu - (wp.dot(flat, pu) / wp.dot(flat, d)) * d
    pv = pv - (wp.dot(flat, pv) / wp.dot(flat, d)) * d
    n = flat
    nu = wp.vec3d()
    nv = wp.vec3d()
    if curved != 0:
        g11 = wp.dot(e1, e1)
        g12 = wp.dot(e1, e2)
        g22 = wp.dot(e2, e2)
        det = g11 * g22 - g12 * g12
        r1 = (g22 * e1 - g12 * e2) / det
        r2 = (g11 * e2 - g12 * e1) / det
        n0 = normals[f, 0]
        m1 = normals[f, 1] - n0
        m2 = normals[f, 2] - n0
        at = point - p0
        mean = n0 + wp.dot(r1, at) * m1 + wp.dot(r2, at) * m2
        length = wp.length(mean)
        n = mean / length
        nu = (wp.dot(r1, pu) * m1 + wp.dot(r2, pu) * m2) / length
        nv = (wp.dot(r1, pv) * m1 + wp.dot(r2, pv) * m2) / length
        nu = nu - wp.dot(n, nu) * n
        nv = nv - wp.dot(n, nv) * n
        if wp.dot(n, flat) < zero:
            n = -n
            nu = -nu
            nv = -nv
        if wp.dot(n, d) >= -wp.float64(1.0e-6):
            n = flat
    out = d - two * wp.dot(n, d) * n
    if wp.dot(out, flat) <= zero:  # the smooth normal would send it through the facet
        n = flat
        out = d - two * wp.dot(n, d) * n
    found = Meeting()
    found.point = point
    found.flat = flat
    found.normal = n
    found.nu = nu
    found.nv = nv
    found.pu = pu
    found.pv = pv
    found.out = out
    found.path = tube.path + t
    return found


@wp.func
def bounced(tube: Tube, at: Meeting) -> Tube:
    """The tube after a reflection."""
    two = wp.float64(2.0)
    n = at.normal
    nd = wp.dot(n, tube.d)
    du = tube.du - two * ((wp.dot(n, tube.du) + wp.dot(at.nu, tube.d)) * n + nd * at.nu)
    dv = tube.dv - two * ((wp.dot(n, tube.dv) + wp.dot(at.nv, tube.d)) * n + nd * at.nv)
    d = wp.normalize(at.out)
    found = Tube()
    found.point = at.point
    found.d = d
    found.pu = at.pu
    found.pv = at.pv
    found.du = du - wp.dot(du, d) * d
    found.dv = dv - wp.dot(dv, d) * d
    found.path = at.path
    found.initial = tube.initial
    return found


@wp.func
def hit_of(tube: Tube, at: Meeting) -> Hit:
    """What is kept of a tube on a face."""
    hit = Hit()
    hit.point = at.point
    hit.normal = at.normal
    hit.d = tube.d
    hit.across_u = at.pu
    hit.across_v = at.pv
    hit.path = at.path
    area = wp.dot(tube.d, wp.cross(at.pu, at.pv))
    hit.weight = root(tube.initial * wp.abs(area)) / -wp.dot(at.flat, tube.d)
    return hit


@wp.kernel(enable_backward=False, cuda_max_registers=128)  # with more a GPU follows too few rays at a time
def trace_kernel(
    # In:
    body: TubeMesh,
    radar_in: wp.array[TubeRadar],
    receiver_in: wp.array[TubeRadar],
    apart: int,
    cells: Cells,
    standoff: wp.float64,
    wavenumber: wp.float64,
    most: int,
    # Out:
    hits_out: wp.array2d[Hit],
    ends_out: TubeEnds,
):
    """Each thread follows one ray: up to `most` hits, (most, rays). An empty cell has none.

    Rays come from `radar_in`, and go back to `receiver_in`: the same, or with `apart` another place, which may not see
    a first hit.

    `ends_out.span`: the way from its first to its last hit [m]. `ends_out.turn`: how wide a tube gets along either of
    its sides after a curved surface [rad]. That is the change of phase over half a footprint that the radar sees, or
    half of the tube's own width times the wavenumber. Plane mirrors keep a tube as it is.
    """
    ray = wp.tid()
    zero = wp.float64(0.0)
    size = cells.size[ray]
    if size[0] == zero and size[1] == zero:
        ends_out.count[ray] = 0
        ends_out.span[ray] = zero
        ends_out.turn[ray] = wp.vec2d()
        return
    radar = radar_in[cells.view[ray]]
    receiver = receiver_in[cells.view[ray]]
    tube = start_tube(radar, cells.place[ray], wp.vec2d(size[0], zero), wp.vec2d(zero, size[1]), standoff, body.reach)
    start = tube.point
    caustics = int(0)
    count = int(0)
    bent = int(0)
    first = tube.path
    turn_u = zero
    turn_v = zero
    half_k = wp.float64(0.5) * wavenumber
    for b in range(most):
        query = wp.mesh_query_ray(body.tree, wp.vec3(start), wp.vec3(tube.d), body.reach)
        if not query.result:
            break
        f = query.face
        t = way_to(tube, body.vertices, body.faces, f)
        if t <= zero:
            break
        area0 = wp.dot(tube.d, wp.cross(tube.pu, tube.pv))
        area1 = wp.dot(tube.d, wp.cross(tube.du, tube.pv) + wp.cross(tube.pu, tube.dv))
        area2 = wp.dot(tube.d, wp.cross(tube.du, tube.dv))
        caustics += crossings(area0, area1, area2, t)
        at = met(tube, t, body.vertices, body.faces, body.normals, body.curved[f], f)
        hit = hit_of(tube, at)
        hit.caustics = caustics
        hit.face = f
        s = look(receiver, at.point, body.reach).s
        if wp.dot(at.flat, s) > zero:
            hit.seen = 1
            if b > 0 or apart != 0:
                hit.seen = free(body, receiver, at.point, at.flat)
        bent = wp.max(bent, body.curved[f])
        if b > 0 and bent != 0:
            turn_u = wp.max(turn_u, half_k * wp.length(wp.cross(tube.d, at.pu)))
            turn_v = wp.max(turn_v, half_k * wp.length(wp.cross(tube.d, at.pv)))
            if hit.seen != 0:
                turn_u = wp.max(turn_u, half_k * wp.abs(wp.dot(s - tube.d, at.pu)))
                turn_v = wp.max(turn_v, half_k * wp.abs(wp.dot(s - tube.d, at.pv)))
        if b == 0:
            first = at.path
        hits_out[b, ray] = hit
        count = b + 1
        tube = bounced(tube, at)
        start = at.point + body.offset * at.flat
    ends_out.count[ray] = count
    ends_out.span[ray] = tube.path - first
    ends_out.turn[ray] = wp.vec2d(turn_u, turn_v)


@wp.kernel(enable_backward=False)
def free_kernel(
    # In:
    body: TubeMesh,
    radar_in: wp.array[TubeRadar],
    point_in: wp.array[wp.vec3d],
    normal_in: wp.array[wp.vec3d],
    both_sides: int,
    # Out:
    seen_out: wp.array2d[wp.uint8],
):
    """Whether the radar sees each point, from each direction; `both_sides`: the normal is turned toward the radar."""
    view, i = wp.tid()
    n = normal_in[i]
    if both_sides != 0 and wp.dot(n, look(radar_in[view], point_in[i], body.reach).s) < wp.float64(0.0):
        n = -n
    seen_out[view, i] = wp.uint8(free(body, radar_in[view], point_in[i], n))
