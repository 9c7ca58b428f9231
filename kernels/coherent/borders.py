"""Where neighbouring rays meet other surfaces: marks of what a ray meets, and the place where the mark changes."""

import warp as wp

from warpsar.kernels.coherent.tubes import Hit, Tube, TubeMesh, TubeRadar, bounced, free, look, met, start_tube, way_to

FIRST = wp.constant(wp.uint64(1469598103934665603))
PRIME = wp.constant(wp.uint64(1099511628211))
"""Of the hash FNV-1a."""


@wp.struct
class Marked:
    """What a ray is asked for: the body, the number of each face's surface, how far off the ray begins [m], and after
    how many faces it ends."""

    body: TubeMesh
    surface: wp.array[int]
    standoff: wp.float64
    most: int


@wp.func
def mark_of(marked: Marked, radar: TubeRadar, place: wp.vec2d, size: wp.vec2d) -> wp.uint64:
    """A number for the surfaces that a ray meets, in their order, and which of them the radar sees."""
    body = marked.body
    zero = wp.float64(0.0)
    tube = start_tube(radar, place, wp.vec2d(size[0], zero), wp.vec2d(zero, size[1]), marked.standoff, body.reach)
    start = tube.point
    mark = FIRST
    for b in range(marked.most):
        query = wp.mesh_query_ray(body.tree, wp.vec3(start), wp.vec3(tube.d), body.reach)
        if not query.result:
            break
        f = query.face
        t = way_to(tube, body.vertices, body.faces, f)
        if t <= zero:
            break
        at = met(tube, t, body.vertices, body.faces, body.normals, body.curved[f], f)
        seen = int(0)
        if wp.dot(at.flat, look(radar, at.point, body.reach).s) > zero:
            seen = 1
            if b > 0:
                seen = free(body, radar, at.point, at.flat)
        mark = (mark ^ wp.uint64(2 * marked.surface[f] + seen + 1)) * PRIME
        tube = bounced(tube, at)
        start = at.point + body.offset * at.flat
    return mark


@wp.kernel(enable_backward=False)
def marks_kernel(
    # In:
    marked: Marked,
    radar_in: wp.array[TubeRadar],
    view_in: wp.array[int],
    place_in: wp.array[wp.vec2d],
    size_in: wp.array[wp.vec2d],
    # Out:
    mark_out: wp.array[wp.uint64],
):
    i = wp.tid()
    mark_out[i] = mark_of(marked, radar_in[view_in[i]], place_in[i], size_in[i])


@wp.kernel(enable_backward=False)
def halve_kernel(
    # In:
    marked: Marked,
    radar_in: wp.array[TubeRadar],
    view_in: wp.array[int],
    size_in: wp.array[wp.vec2d],
    mark_in: wp.array[wp.uint64],
    halvings: int,
    # Out:
    low_out: wp.array[wp.vec2d],
    high_out: wp.array[wp.vec2d],
):
    """Bisection between two places: the lower one keeps its mark, the upper one has another."""
    i = wp.tid()
    low = low_out[i]
    high = high_out[i]
    for _ in range(halvings):
        middle = wp.float64(0.5) * (low + high)
        if mark_of(marked, radar_in[view_in[i]], middle, size_in[i]) == mark_in[i]:
            low = middle
        else:
            high = middle
    low_out[i] = low
    high_out[i] = high


@wp.kernel(enable_backward=False)
def blockers_kernel(
    # In:
    body: TubeMesh,
    radar_in: wp.array[TubeRadar],
    view_in: wp.array[int],
    hit_in: wp.array[Hit],
    # Out:
    face_out: wp.array[int],
    point_out: wp.array[wp.vec3d],
):
    """Which face stands between a hit and the radar, and where; -1 where none does."""
    i = wp.tid()
    hit = hit_in[i]
    sight = look(radar_in[view_in[i]], hit.point, body.reach)
    f0 = hit.face
    p = body.vertices[body.faces[f0, 0]]
    flat = wp.normalize(wp.cross(body.vertices[body.faces[f0, 1]] - p, body.vertices[body.faces[f0, 2]] - p))
    if wp.dot(flat, hit.d) > wp.float64(0.0):
        flat = -flat
    face_out[i] = -1
    if wp.dot(flat, sight.s) > wp.float64(0.0):
        start = hit.point + body.offset * flat
        query = wp.mesh_query_ray(body.tree, wp.vec3(start), wp.vec3(sight.s), wp.float32(sight.reach))
        if query.result:
            tube = Tube()
            tube.point = hit.point
            tube.d = sight.s
            face_out[i] = query.face
            point_out[i] = hit.point + way_to(tube, body.vertices, body.faces, query.face) * sight.s
