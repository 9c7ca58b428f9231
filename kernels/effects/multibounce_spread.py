"""Tubes that curved mirrors spread: halved until their phase is even enough, and handed on as fields.

Where a way leads over a curved surface to another one, or over a curved one between two surfaces, no flat piece tells
how wide a tube gets. Here a tube has the normals of the smooth surface and its own differentials, as in complex images
(`kernels/coherent/tubes.py`): its field falls by the root of its cross-section, and its currents have no gaps.

The phase over a footprint is quadratic, and its sides tell both parts. A tube far from where the phase stands still
sends nothing: its neighbours cancel it. So only tubes about that place are halved and kept, with a weight that falls
from 1 to 0 where the phase turns fast.
"""

import warp as wp

from warpsar.kernels.coherent.tubes import Meeting, Tube, bounced, crossings, hit_of, met, way_to
from warpsar.kernels.effects.multibounce import (
    EDGE,
    SEEK,
    PathRays,
    PathRecords,
    along_way,
    apparent_point,
    faces_met,
)
from warpsar.kernels.effects.multibounce_cells import (
    FOUR_PI,
    HALF,
    ONE,
    TWO,
    ZERO,
    ResolutionCells,
    TubeEnd,
    TubeFields,
    keep_tube,
    sight_of,
)
from warpsar.kernels.geometry import look_direction, slant_range_of

wp.set_module_options({"max_unroll": 1})  # as in multibounce.py: copies of BVH queries take minutes to compile

TURN = wp.constant(wp.float64(0.15))
"""Radians by which the normal of a surface may turn over a tube's footprint: curvature may change over as much."""
FAN = wp.constant(wp.float64(0.1))
"""Radians between both sides of a tube that goes on from a curved surface, and may return from the next."""
FAINT = wp.constant(wp.float64(0.1))
"""Radar cross-section by geometric optics, in squares of the wavelength, below which nothing is sent; from twice this
on all of it is."""
BEND = wp.constant(wp.float64(0.7))
"""Second derivative of the phase over a tube, along its sides [rad]: in the mean 0.03 rad beside a linear one."""
EVEN_BEND = wp.constant(wp.float64(0.2))
STRONG_BEND = wp.constant(wp.float64(1.0))
"""The same, over a ray's cell: up to the first no tube is left out for its phase, from the second on all are."""
NEAR_BY = wp.constant(wp.float64(4.5))
FAR_OFF = wp.constant(wp.float64(9.0))
"""Slope of the phase over the root of its second derivative, up to which a tube counts in full, and from which on not
at all: 10 and 40 rad from where it stands still."""
GRAZING = wp.constant(wp.float64(0.05))
"""Cosine of the angle of incidence on the last surface, below which nothing is sent: optics ends at the outline of a
body. From three times this on all of it is."""
NARROW = wp.constant(wp.float64(0.8))
"""Width of a tube times the wavenumber, up to which it is halved for its phase alone: an eighth of a wavelength. At
the outline of a body no tube would be narrow enough."""
NARROWEST = wp.constant(wp.float64(0.03))
"""The same, up to which it is halved at all. A way whose phase turns within a two-hundredth of a wavelength of its
first surface sends next to nothing, and is left out."""
FINEST_PARTS = wp.constant(4096)
"""Of a ray's cell, along one of its sides."""

U_SIDE = wp.constant(1)
V_SIDE = wp.constant(2)


@wp.struct
class SpreadRays:
    """What tubes are followed with: the rays of the view, the mesh in double precision, with the `normals` of the
    corners of its faces on smooth surfaces, (faces, 3), and the resolution cells."""

    rays: PathRays
    vertices: wp.array(dtype=wp.vec3d)  # [m]
    normals: wp.array2d(dtype=wp.vec3d)
    cells: ResolutionCells
    wavenumber: wp.float64  # [rad/m]


@wp.struct
class Walk:
    """`split`: sides along which a tube is to be halved, a sum of U_SIDE and V_SIDE. `reach`: 1 if it meets the last
    surface of a way over which tubes are spread. `fan`: the largest angle between its sides after a curved surface
    [rad], -1 without any."""

    split: int
    reach: int
    fan: wp.float64


@wp.struct
class PhaseOver:
    """The phase over a tube's footprint as a polynomial in places along the sides of a whole ray's cell [rad]."""

    u: wp.float64
    v: wp.float64
    uu: wp.float64
    uv: wp.float64
    vv: wp.float64


@wp.struct
class PhaseWindow:
    """What a tube counts by where its phase turns, and whether some of it may count, 0 or 1."""

    weight: wp.float64
    some: int


@wp.func
def phase_over(k: wp.float64, tube: Tube, at: Meeting, s: wp.vec3d, parts: wp.vec2i) -> PhaseOver:
    """Of the way to the footprint and back to `s`. A convex surface falls away from its tangent plane, and the wave
    that arrives is curved as its directions differ."""
    many_u = wp.float64(parts[0])
    many_v = wp.float64(parts[1])
    slope = tube.d - s
    falls = -wp.dot(slope, at.normal)
    found = PhaseOver()
    found.u = k * wp.dot(slope, at.pu) * many_u
    found.v = k * wp.dot(slope, at.pv) * many_v
    found.uu = k * (wp.dot(tube.du, at.pu) + falls * wp.dot(at.nu, at.pu)) * many_u * many_u
    found.vv = k * (wp.dot(tube.dv, at.pv) + falls * wp.dot(at.nv, at.pv)) * many_v * many_v
    mixed = wp.dot(tube.du, at.pv) + wp.dot(tube.dv, at.pu) + falls * (wp.dot(at.nu, at.pv) + wp.dot(at.nv, at.pu))
    found.uv = HALF * k * mixed * many_u * many_v
    return found


@wp.func
def along_axis(slope: wp.float64, bend: wp.float64, reach: wp.float64) -> PhaseWindow:
    """Along one of the axes about which the phase is even; `reach`: from a tube's middle to its corners."""
    size = wp.abs(bend)
    found = PhaseWindow()
    found.weight = ONE
    found.some = 1
    if size <= EVEN_BEND:
        return found
    part = wp.min((size - EVEN_BEND) / (STRONG_BEND - EVEN_BEND), ONE)
    strong = part * part * (wp.float64(3.0) - TWO * part)
    scale = ONE / wp.sqrt(size)
    away = wp.clamp((FAR_OFF - wp.abs(slope) * scale) / (FAR_OFF - NEAR_BY), ZERO, ONE)
    found.weight = ONE - strong * (ONE - away * away * (wp.float64(3.0) - TWO * away))
    if strong >= ONE and (wp.abs(slope) - size * reach) * scale >= FAR_OFF:
        found.some = 0
    return found


@wp.func
def window_of(phase: PhaseOver, size: wp.float64, far: wp.float64, parts: wp.vec2i) -> PhaseWindow:
    """By the distance from where the phase stands still, along both principal axes of its second derivative; and by the
    radar cross-section there. `size`: a tube's weight across the ray times the square of the wavenumber. Of metal this
    cross-section is size^2 / pi over the determinant of the second derivatives, in squares of the wavelength. The phase
    may stand still `far` from the tube's middle, in diagonals of its sides.
    """
    half = HALF * (phase.uu - phase.vv)
    apart = wp.sqrt(half * half + phase.uv * phase.uv)
    middle = HALF * (phase.uu + phase.vv)
    angle = HALF * wp.atan2(phase.uv, half)
    c = wp.cos(angle)
    n = wp.sin(angle)
    side_u = ONE / wp.float64(parts[0])
    side_v = ONE / wp.float64(parts[1])
    reach = far * wp.sqrt(side_u * side_u + side_v * side_v)
    one = along_axis(c * phase.u + n * phase.v, middle + apart, reach)
    other = along_axis(c * phase.v - n * phase.u, middle - apart, reach)
    found = PhaseWindow()
    found.weight = one.weight * other.weight
    found.some = one.some * other.some
    whole = size / (side_u * side_v)  # of a whole cell, as the phase
    bends = wp.abs(phase.uu * phase.vv - phase.uv * phase.uv)
    strength = whole * whole / (wp.float64(3.14159265358979) * wp.max(bends, wp.float64(1.0e-12)))
    part = wp.clamp(strength / FAINT - ONE, ZERO, ONE)
    found.weight = found.weight * part
    if part <= ZERO:
        found.some = 0
    return found


@wp.func
def sides_over(along_u: wp.float64, along_v: wp.float64, limit: wp.float64, parts: wp.vec2i) -> int:
    """The sides along which a number is beyond its limit, and which can still be halved."""
    found = int(0)
    if along_u > limit and parts[0] < FINEST_PARTS:
        found += U_SIDE
    if along_v > limit and parts[1] < FINEST_PARTS:
        found += V_SIDE
    return found


@wp.func
def start_of(rays: PathRays, place: wp.vec2d, parts: wp.vec2i) -> Tube:
    """The tube of a part of a ray's cell, about its middle `place` (azimuth, elevation)."""
    grid = rays.grid
    d = wp.vec3d(grid.d)
    u = wp.vec3d(grid.u)
    v = wp.vec3d(grid.v)
    slant_range = wp.float64(grid.slant_range)
    standoff = wp.float64(grid.standoff)
    height = wp.float64(grid.elevation_step) / wp.float64(parts[1])
    tube = Tube()
    tube.d = d
    tube.pu = wp.float64(grid.azimuth_step) / wp.float64(parts[0]) * u
    tube.pv = height * v
    along = -standoff
    across = place[1]
    if slant_range > ZERO:
        half = wp.sin(HALF * place[1])
        along = -TWO * half * half * slant_range - standoff * wp.cos(place[1])
        across = (slant_range - standoff) * wp.sin(place[1])
        tube.d = wp.cos(place[1]) * d + wp.sin(place[1]) * v
        tube.dv = height * (wp.cos(place[1]) * v - wp.sin(place[1]) * d)
        tube.pv = (slant_range - standoff) * tube.dv
    tube.point = place[0] * u + along * d + across * v
    return tube


# Long because it walks a tube from entry to return, as `follow` does.
@wp.func
def walk(
    spread: SpreadRays,
    place: wp.vec2d,
    parts: wp.vec2i,
    written: bool,
    records: PathRecords,
    tubes: TubeFields,
) -> Walk:
    """Walk the tube about a place. Its returns are `written`, or else only looked at."""
    rays = spread.rays
    grid = rays.grid
    k = spread.wavenumber
    clear = 1.0e-5 * rays.size
    d = wp.vec3d(grid.d)
    u = wp.vec3d(grid.u)
    v = wp.vec3d(grid.v)
    tube = start_of(rays, place, parts)
    broad = sides_over(k * wp.length(tube.pu), k * wp.length(tube.pv), NARROW, parts)
    wide = sides_over(k * wp.length(tube.pu), k * wp.length(tube.pv), NARROWEST, parts)
    found = Walk()
    found.fan = -ONE
    side = wp.vec3()
    entry = wp.vec3d()
    enters_u = wp.vec3d()
    enters_v = wp.vec3d()
    chain = faces_met()
    second = along_way()
    third = along_way()
    reach = grid.reach
    between = wp.float64(0.0)
    caustics = int(0)
    bent = int(0)  # curved surfaces before
    inner = int(0)  # those that were not the first
    pending = int(0)  # sides to be halved if the tube returns from another surface
    for bounce in range(rays.max_bounces):
        query = wp.mesh_query_ray(rays.tree, wp.vec3(tube.point) + clear * side, wp.vec3(tube.d), reach)
        if not query.result:
            break
        f = query.face
        t = way_to(tube, spread.vertices, rays.mesh.faces, f)
        if t <= ZERO:
            break
        area0 = wp.dot(tube.d, wp.cross(tube.pu, tube.pv))
        area1 = wp.dot(tube.d, wp.cross(tube.du, tube.pv) + wp.cross(tube.pu, tube.dv))
        area2 = wp.dot(tube.d, wp.cross(tube.du, tube.dv))
        if bounce > 0:
            caustics += crossings(area0, area1, area2, t)
            between += t
        curved = int(0)
        if rays.turn[f] > 0.0:
            curved = 1
        at = met(tube, t, spread.vertices, rays.mesh.faces, spread.normals, curved, f)
        slope = wp.dot(at.flat, tube.d)
        if wp.abs(slope) < wp.float64(1.0e-6):
            break
        if bounce == 0:
            entry = ONE * at.point
            enters_u = ONE * at.pu
            enters_v = ONE * at.pv
            tube.initial = wp.abs(wp.dot(tube.d, wp.cross(at.pu, at.pv)))
        p0 = spread.vertices[rays.mesh.faces[f, 0]]
        e1 = spread.vertices[rays.mesh.faces[f, 1]] - p0
        e2 = spread.vertices[rays.mesh.faces[f, 2]] - p0
        g11 = wp.dot(e1, e1)
        g12 = wp.dot(e1, e2)
        g22 = wp.dot(e2, e2)
        det = g11 * g22 - g12 * g12
        chain[bounce] = f + 1
        second[bounce] = float(wp.dot(g22 * e1 - g12 * e2, at.point - p0) / det)
        third[bounce] = float(wp.dot(g11 * e2 - g12 * e1, at.point - p0) / det)
        last = bounce == rays.max_bounces - 1
        ends = bounce > 0 and (bent + curved >= 2 or inner > 0)
        coarse = int(pending)
        if curved > 0:
            coarse = coarse | (broad & sides_over(wp.length(at.nu), wp.length(at.nv), TURN, parts))
        if ends:
            found.reach = 1
            point = wp.vec3(at.point)
            flat = wp.vec3(at.flat)
            home = -look_direction(grid, point)
            row = int(-1)
            col = int(-1)
            seen = wp.vec3()
            if wp.dot(flat, home) > 0.0:
                seen = apparent_point(grid, wp.vec3(entry), point, float(between))
                row = int(wp.floor((slant_range_of(grid, seen) - grid.range_start) / grid.range_spacing - EDGE))
                col = int(wp.floor((wp.dot(seen, grid.u) - rays.columns.start) / rays.columns.spacing))
            if row >= 0 and row < grid.rows and col >= 0 and col < rays.columns.count:
                sight = sight_of(at.point, d, v, wp.float64(grid.slant_range))
                phase = phase_over(k, tube, at, -sight.direction, parts)
                weight = hit_of(tube, at).weight
                reach_of = wp.float64(0.75)  # half as far again as a corner
                if coarse > 0:
                    reach_of = TWO
                window = window_of(phase, k * k * weight * wp.abs(slope), reach_of, parts)
                grazing = wp.clamp((wp.abs(slope) - GRAZING) / (TWO * GRAZING), ZERO, ONE)
                window.weight *= grazing
                if grazing <= ZERO:
                    window.some = 0
                if window.some > 0:
                    back = wp.mesh_query_ray(rays.tree, point + clear * flat, home, rays.size)
                    if not back.result:
                        many_u = wp.float64(parts[0])
                        many_v = wp.float64(parts[1])
                        mixed = wp.abs(phase.uv) / (many_u * many_v)
                        bend_u = wp.max(wp.abs(phase.uu) / (many_u * many_u), mixed)
                        bend_v = wp.max(wp.abs(phase.vv) / (many_v * many_v), mixed)
                        bends = sides_over(bend_u, bend_v, BEND, parts)
                        found.split = found.split | coarse | (wide & bends)
                        if written and coarse == 0 and bends == 0 and window.weight > wp.float64(1.0e-3):
                            slot = wp.atomic_add(records.count, 0, 1)
                            if slot < records.bin.shape[0]:
                                records.bin[slot] = row * rays.columns.count + col
                                records.bounces[slot] = bounce + 1
                                records.faces[slot] = chain
                                records.second[slot] = second
                                records.third[slot] = third
                                records.weight[slot] = float(window.weight)
                                records.point[slot] = seen
                                records.ray[slot] = wp.vec4(
                                    float(place[0]), float(place[1]), float(ONE / many_u), float(ONE / many_v)
                                )
                                records.ends[slot] = wp.vec3()
                                first = sight_of(entry, d, v, wp.float64(grid.slant_range))
                                end = TubeEnd()
                                end.along = HALF * (first.distance + between + sight.distance)
                                end.azimuth = HALF * wp.dot(u, entry + at.point)
                                end.turn = -HALF * (sight.direction + tube.d)
                                end.foot_u = at.pu
                                end.foot_v = at.pv
                                end.enters_u = enters_u
                                end.enters_v = enters_v
                                end.ahead = wp.float64(caustics) * wp.float64(1.5707963267948966)
                                end.size = k / FOUR_PI * weight * window.weight
                                keep_tube(tubes, slot, spread.cells, u, k, end)
        if last:
            break
        side = wp.vec3(at.flat)
        tube = bounced(tube, at)
        bent += curved
        if bounce > 0:
            inner += curved
        if bent > 0:
            along_u = wp.length(tube.du)
            along_v = wp.length(tube.dv)
            found.fan = wp.max(found.fan, wp.max(along_u, along_v))
            found.split = found.split | (broad & sides_over(along_u, along_v, wp.float64(SEEK), parts))
            pending = pending | (broad & sides_over(along_u, along_v, FAN, parts))
        reach = rays.size
    return found


@wp.kernel(enable_backward=False)
def spread_kernel(
    # In:
    spread: SpreadRays,
    place: wp.array(dtype=wp.vec2d),
    parts: wp.array(dtype=wp.vec2i),
    # Out:
    split_out: wp.array(dtype=int),
    records_out: PathRecords,
    tubes_out: TubeFields,
):
    """Each thread has a tube, a part of a ray's cell: its middle `place` in cells, and how many `parts` the cell has.

    `split_out`: the sides along which it is to be halved; if none, its returns are in the records, with their fields. A
    tube whose middle misses the surfaces over which it might return is halved if this helps one about its corners.
    """
    i = wp.tid()
    grid = spread.rays.grid
    step = wp.vec2d(wp.float64(grid.azimuth_step), wp.float64(grid.elevation_step))
    start = wp.vec2d(wp.float64(grid.azimuth_start), wp.float64(grid.elevation_start))
    many = parts[i]
    split = int(0)
    reach = int(0)
    for look in range(6):
        at = place[i]
        if look >= 1 and look < 5:
            at += wp.vec2d(
                (wp.float64((look - 1) % 2) - HALF) / wp.float64(many[0]),
                (wp.float64((look - 1) / 2) - HALF) / wp.float64(many[1]),
            )
        here = start + wp.vec2d(at[0] * step[0], at[1] * step[1])
        if look == 0 or look == 5 or reach == 0:
            seen = walk(spread, here, many, look == 5, records_out, tubes_out)
            split = split | seen.split
            if look == 0:
                reach = seen.reach
                if many[0] * many[1] == 1 and seen.fan >= ZERO and seen.fan < wp.float64(0.25) * FAN:
                    reach = 1  # its neighbours tell what is about it
        if split > 0 or (look == 4 and reach == 0):
            break
    split_out[i] = split
