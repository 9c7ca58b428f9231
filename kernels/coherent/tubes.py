"""Ray tubes: rays that are reflected until they leave, each with its path, differentials and caustics.

Ling, Chou, Lee (IEEE TAP 37(2), 1989): tubes. Igehy (SIGGRAPH 1999): differentials, with the curvature of the surface.
"""

import warp as wp


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
class Body:
    """A mesh for rays: float32 in its tree, float64 where they hit."""

    tree: wp.uint64
    vertices: wp.array[wp.vec3d]
    faces: wp.array2d[int]
    normals: wp.array2d[wp.vec3d]  # of the corners of each face, as they are on the smooth surface
    curved: wp.array[int]
    offset: wp.float64  # rays start this far from a face [m]
    reach: float


@wp.struct
class Radar:
    """Where a view's radar stands about the body's middle. `near` is 0 for a plane wave, which has no place."""

    s: wp.vec3d  # unit vector to it, from the reference point
    u: wp.vec3d  # H
    v: wp.vec3d  # V
    place: wp.vec3d  # [m]
    distance: wp.float64  # of the reference point [m]
    near: int


@wp.struct
class Look:
    """The radar as a point of the body sees it."""

    s: wp.vec3d  # unit vector to it
    back: wp.float64  # way to it, less that of the reference point [m]
    spread: wp.float64  # field over that at the reference point's distance
    reach: wp.float64  # of a ray to it [m]


@wp.func
def look(radar: Radar, point: wp.vec3d, reach: float) -> Look:
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
def free(body: Body, radar: Radar, point: wp.vec3d, normal: wp.vec3d) -> int:
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


@wp.kernel
def trace_kernel(
    # In:
    body: Body,
    radar_in: wp.array[Radar],
    view_in: wp.array[int],
    place_in: wp.array[wp.vec2d],
    size_in: wp.array[wp.vec2d],
    standoff: wp.float64,
    wavenumber: wp.float64,
    most: int,
    # Out:
    hits_out: wp.array2d[Hit],
    count_out: wp.array[int],
    span_out: wp.array[wp.float64],
    turn_out: wp.array[wp.float64],
):
    """Each thread follows one ray: up to `most` hits.

    `span_out`: the way from its first to its last hit [m]. `turn_out`: the largest change of phase [rad] over half a
    footprint that the radar sees after a curved surface; plane mirrors keep the phase of a tube linear.

    Longer than other functions: a ray's state is a dozen variables, which would all go in and out of its parts.
    """
    ray = wp.tid()
    zero = wp.float64(0.0)
    two = wp.float64(2.0)
    view = view_in[ray]
    radar = radar_in[view]
    size = size_in[ray]
    pu = size[0] * radar.u
    pv = size[1] * radar.v
    du = wp.vec3d()
    dv = wp.vec3d()
    point = place_in[ray][0] * radar.u + place_in[ray][1] * radar.v
    first_look = look(radar, point, body.reach)
    d = -first_look.s
    path = first_look.back - standoff
    initial = wp.abs(wp.dot(d, wp.cross(pu, pv)))
    if radar.near != 0:  # rays from one place
        initial = initial * first_look.spread * first_look.spread
        distance = wp.length(radar.place - point)
        du = (pu - wp.dot(d, pu) * d) / distance
        dv = (pv - wp.dot(d, pv) * d) / distance
        pu = pu - standoff * du
        pv = pv - standoff * dv
    point = point - standoff * d
    start = point
    caustics = int(0)
    count = int(0)
    bent = int(0)
    first = zero
    turn = zero
    for b in range(most):
        query = wp.mesh_query_ray(body.tree, wp.vec3(start), wp.vec3(d), body.reach)
        if not query.result:
            break
        f = query.face
        p0 = body.vertices[body.faces[f, 0]]
        e1 = body.vertices[body.faces[f, 1]] - p0
        e2 = body.vertices[body.faces[f, 2]] - p0
        plane = wp.cross(e1, e2)
        slope = wp.dot(plane, d)
        if slope == zero:
            break
        t = wp.dot(plane, p0 - point) / slope
        if t <= zero:
            break
        flat = wp.normalize(plane)
        if slope > zero:
            flat = -flat
        area0 = wp.dot(d, wp.cross(pu, pv))
        area1 = wp.dot(d, wp.cross(du, pv) + wp.cross(pu, dv))
        area2 = wp.dot(d, wp.cross(du, dv))
        caustics += crossings(area0, area1, area2, t)
        point = point + t * d
        path += t
        pu = pu + t * du
        pv = pv + t * dv
        pu = pu - (wp.dot(flat, pu) / wp.dot(flat, d)) * d
        pv = pv - (wp.dot(flat, pv) / wp.dot(flat, d)) * d
        area = wp.dot(d, wp.cross(pu, pv))
        n = flat
        nu = wp.vec3d()
        nv = wp.vec3d()
        if body.curved[f] != 0:
            g11 = wp.dot(e1, e1)
            g12 = wp.dot(e1, e2)
            g22 = wp.dot(e2, e2)
            det = g11 * g22 - g12 * g12
            r1 = (g22 * e1 - g12 * e2) / det
            r2 = (g11 * e2 - g12 * e1) / det
            n0 = body.normals[f, 0]
            m1 = body.normals[f, 1] - n0
            m2 = body.normals[f, 2] - n0
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
        cosine = -wp.dot(n, d)
        out = d + two * cosine * n
        if wp.dot(out, flat) <= zero:  # the smooth normal would send it through the facet
            n = flat
            cosine = -wp.dot(n, d)
            out = d + two * cosine * n
        hit = Hit()
        hit.point = point
        hit.normal = n
        hit.d = d
        hit.across_u = pu
        hit.across_v = pv
        hit.path = path
        hit.weight = wp.sqrt(initial * wp.abs(area)) / -wp.dot(flat, d)
        hit.caustics = caustics
        hit.face = f
        s = look(radar, point, body.reach).s
        if wp.dot(flat, s) > zero:
            hit.seen = 1
            if b > 0:
                hit.seen = free(body, radar, point, flat)
        bent = wp.max(bent, body.curved[f])
        if b > 0 and bent != 0 and hit.seen != 0:
            change = wp.float64(0.5) * wavenumber * (s - d)
            turn = wp.max(turn, wp.max(wp.abs(wp.dot(change, pu)), wp.abs(wp.dot(change, pv))))
        if b == 0:
            first = path
        hits_out[ray, b] = hit
        count = b + 1
        nd = wp.dot(n, d)
        next_u = du - two * ((wp.dot(n, du) + wp.dot(nu, d)) * n + nd * nu)
        next_v = dv - two * ((wp.dot(n, dv) + wp.dot(nv, d)) * n + nd * nv)
        du = next_u
        dv = next_v
        d = wp.normalize(out)
        du = du - wp.dot(du, d) * d
        dv = dv - wp.dot(dv, d) * d
        start = point + body.offset * flat
    count_out[ray] = count
    span_out[ray] = path - first
    turn_out[ray] = turn


@wp.kernel
def free_kernel(
    # In:
    body: Body,
    radar_in: wp.array[Radar],
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
