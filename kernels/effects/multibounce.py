"""Paths of rays over several surfaces: traced and merged once; then their power, by the surfaces that they meet."""

import warp as wp

from warpsar.kernels.codes import Coordinate, Polarization
from warpsar.kernels.geometry import (
    Band,
    RayGrid,
    Triangles,
    azimuth_of,
    elevation_of,
    intersect,
    jitter_of,
    look_direction,
    ray_direction,
    ray_origin,
    slant_range_of,
)
from warpsar.kernels.scattering import bistatic_geometric_optics, fresnel_h, fresnel_v

wp.set_module_options({"max_unroll": 1})  # a border's halvings hold BVH queries: copies of them take minutes to compile

# Every ray of a dihedral has the range of its foot. Where this is the edge between two bins, rounding in float32 would
# choose the bin of each ray. So a range beyond an edge by this share of a bin, or less, stays on the near side.
EDGE = wp.constant(1.0e-3)

# Slope variance that even a smooth surface has: it keeps the lobe of a mirror wide enough for a mesh's facets.
LEAST_SLOPE_VARIANCE = wp.constant(1.0e-4)

STRETCHES = wp.constant(8)
"""Of a line across a cell, in each of which what rays meet may change once."""
HALVINGS = wp.constant(14)
"""Of a stretch: a hundredth of a radian where the phase turns by two hundred circles in a cell, as on a wall nearly
along the line of sight."""
FINEST = wp.constant(32)
"""Parts of a strip, into which it is cut at most where a corner lies in it."""
SEEK = wp.constant(0.2)
"""Radians between both sides of a tube that goes on from a curved surface: a body that looks smaller from there may be
missed."""
PRIME = wp.constant(wp.uint64(1099511628211))
"""Of the hash FNV-1a."""


SURFACES = wp.constant(5)
"""That a way may have: one more than an image may ask for, which tells what is left out."""
faces_met = wp.types.vector(length=int(SURFACES), dtype=wp.int32)
"""By the bounces of a way: face + 1, in their order, and 0 after the last."""
along_way = wp.types.vector(length=int(SURFACES), dtype=wp.float32)
"""A number for each bounce of a way."""

changes = wp.types.vector(length=int(STRETCHES), dtype=wp.float32)
"""Places along a line."""
marks = wp.types.vector(length=int(STRETCHES) + 1, dtype=wp.uint64)
"""Of rays before, between and after the changes of a line."""
SIDE = wp.constant(int(STRETCHES) + 1)
"""Rays along each side of a cell that is looked at, from edge to edge."""
looks = wp.types.vector(length=int(SIDE) * int(SIDE) + 4, dtype=wp.uint64)
"""Marks of rays all over a cell, and in the middles of the four beside it."""


@wp.struct
class PathRecords:
    """One record per ray and return to the radar, in any order.

    `count` may exceed the length of the arrays: then the rays are traced again with more room.
    """

    bin: wp.array(dtype=int)
    bounces: wp.array(dtype=int)
    faces: wp.array(dtype=faces_met)
    second: wp.array(dtype=along_way)  # barycentric weights of the faces' second vertices
    third: wp.array(dtype=along_way)
    weight: wp.array(dtype=float)  # dA_perp / pixel area
    point: wp.array(dtype=wp.vec3)  # where one bounce would have the same range, azimuth and mean elevation
    ray: wp.array(dtype=wp.vec4)  # azimuth and elevation of the middle of the ray's tube; its sides, in grid cells
    ends: wp.array(
        dtype=wp.vec3
    )  # the axis of its strip, and how far its ends are farther along at the strip's far side
    count: wp.array(dtype=int)
    area: wp.array(
        dtype=float
    )  # of the rays that meet two surfaces, and of those that go on after all bounces [pixels]
    wide: wp.array2d(
        dtype=wp.uint8
    )  # cells (azimuth, elevation) whose tubes curved surfaces spread; empty if not asked


@wp.struct
class ImageColumns:
    """The columns of the bins: the rays' grid may be wider."""

    start: float  # azimuth [m]
    spacing: float
    count: int


@wp.struct
class PathAngles:
    """Angles along merged paths, as `warpsar.effects.multibounce.Paths` has them; `weight`: over cos(theta_n) too."""

    weight: wp.array(dtype=float)
    cos_incidence: wp.array(dtype=along_way)
    cos_half: wp.array(dtype=float)
    cos_tilt: wp.array(dtype=float)
    arrival: wp.array(dtype=wp.vec3)  # direction of the ray that meets the first surface
    home: wp.array(dtype=wp.vec3)  # from the last surface to the radar


@wp.struct
class Bounce:
    """One bounce of every path, in the arrays that hits have, shape (n,) each."""

    face: wp.array(dtype=int)
    barycentric: wp.array(dtype=wp.vec2)
    point: wp.array(dtype=wp.vec3)
    cos_incidence: wp.array(dtype=float)
    direction: wp.array(dtype=wp.vec3)  # on arrival
    normal: wp.array(dtype=wp.vec3)  # toward the side that the ray comes from


@wp.func
def apparent_point(grid: RayGrid, entry: wp.vec3, exit: wp.vec3, between: float) -> wp.vec3:
    """Range is half the whole path; azimuth and elevation are those of the middle between entry and exit."""
    along = 0.5 * (slant_range_of(grid, entry) + slant_range_of(grid, exit) + between)
    across = 0.5 * (wp.dot(entry, grid.v) + wp.dot(exit, grid.v))
    azimuth = 0.5 * (wp.dot(entry, grid.u) + wp.dot(exit, grid.u))
    if grid.slant_range > 0.0:
        first = wp.atan2(wp.dot(entry, grid.v), grid.slant_range + wp.dot(entry, grid.d))
        last = wp.atan2(wp.dot(exit, grid.v), grid.slant_range + wp.dot(exit, grid.d))
        angle = 0.5 * (first + last)
        half = wp.sin(0.5 * angle)
        across = (grid.slant_range + along) * wp.sin(angle)
        along = along * wp.cos(angle) - 2.0 * half * half * grid.slant_range
    return along * grid.d + azimuth * grid.u + across * grid.v


@wp.struct
class PathRays:
    """What rays of a view are followed with. `plane` numbers what borders lie between: the planes of faces, but for
    small pieces of curved surfaces. `turn` is by how much the normal of each face's smooth surface turns [rad/m], 0 on
    flat ones, and `bend` how far it is from the face's own [rad] (`warpsar.effects.bounces.curved`). `size` [m] is the
    mesh's: how far a ray may go from one surface to the next."""

    grid: RayGrid
    mesh: Triangles
    columns: ImageColumns
    tree: wp.uint64
    plane: wp.array(dtype=int)
    turn: wp.array(dtype=float)
    bend: wp.array(dtype=float)
    max_bounces: int
    size: float


# Long because it walks a ray from entry to return: what is cut out would be handed twelve values and back.
@wp.func
def follow(
    rays: PathRays,
    azimuth: float,
    elevation: float,
    tube: wp.vec4,
    ends: wp.vec3,
    written: bool,
    records: PathRecords,
) -> wp.uint64:
    """Walk the ray at a place. Every surface but the last is a mirror. Returns a number for the planes that it meets,
    in their order, and from which of them it returns: an odd one if it returns at all.

    `tube` and `ends` are of the part of the rays' plane that the ray stands for, as in `PathRecords`; its returns are
    `written` to the records. A BVH query starts just off the surface, so that it does not find the same surface again.
    The point that the ray meets is then computed from the surface itself.
    """
    grid = rays.grid
    mesh = rays.mesh
    clear = 1.0e-5 * rays.size
    origin = ray_origin(grid, azimuth, elevation)
    direction = ray_direction(grid, elevation)
    weight = tube[2] * tube[3] * grid.azimuth_step * grid.elevation_step / grid.pixel_area
    met = faces_met()
    second = along_way()
    third = along_way()
    entry = wp.vec3(0.0, 0.0, 0.0)
    before = wp.vec3(0.0, 0.0, 0.0)
    side = wp.vec3(0.0, 0.0, 0.0)
    between = float(0.0)
    reach = grid.reach
    mark = wp.uint64(0)
    returns = wp.uint64(0)
    bent = int(0)  # curved surfaces before
    inner = int(0)  # those that were not the first
    for bounce in range(rays.max_bounces):
        query = wp.mesh_query_ray(rays.tree, origin + clear * side, direction, reach)
        if not query.result:
            break
        p0 = mesh.vertices[mesh.faces[query.face, 0]]
        p1 = mesh.vertices[mesh.faces[query.face, 1]]
        p2 = mesh.vertices[mesh.faces[query.face, 2]]
        hit = intersect(origin, direction, p0, p1, p2)
        slope = wp.dot(hit.normal, direction)
        if wp.abs(slope) < 1.0e-6:
            break
        point = p0 + hit.b1 * (p1 - p0) + hit.b2 * (p2 - p0)
        side = -wp.sign(slope) * hit.normal  # the one the ray is on
        met[bounce] = query.face + 1
        second[bounce] = hit.b1
        third[bounce] = hit.b2
        if written and records.wide.shape[0] > 0:
            curved = int(0)
            if rays.turn[query.face] > 0.0:
                curved = 1
            spreads = bounce > 0 and (bent + curved >= 2 or inner > 0)
            if curved > 0 and bounce < rays.max_bounces - 1:
                turned = rays.turn[query.face] * grid.azimuth_step / wp.abs(slope)
                spreads = spreads or wp.max(turned, rays.bend[query.face]) > 0.5 * SEEK
            if spreads:
                i = int(wp.floor((tube[0] - grid.azimuth_start) / grid.azimuth_step)) - grid.first_cell
                j = int(wp.floor((tube[1] - grid.elevation_start) / grid.elevation_step))
                records.wide[i, j] = wp.uint8(1)
            bent += curved
            if bounce > 0:
                inner += curved
        home = -look_direction(grid, point)
        returned = int(0)
        if bounce == 0:
            entry = point
            if grid.slant_range > 0.0:
                weight = weight * (slant_range_of(grid, point) + grid.slant_range)
        else:
            between += wp.length(point - before)
            if wp.dot(side, home) > 0.0:
                # the bin first: a ray back to the radar costs more
                seen = apparent_point(grid, entry, point, between)
                row = int(wp.floor((slant_range_of(grid, seen) - grid.range_start) / grid.range_spacing - EDGE))
                col = int(wp.floor((wp.dot(seen, grid.u) - rays.columns.start) / rays.columns.spacing))
                if row >= 0 and row < grid.rows and col >= 0 and col < rays.columns.count:
                    back = wp.mesh_query_ray(rays.tree, point + clear * side, home, rays.size)
                    if not back.result:
                        returned = int(1)
                if returned == 1 and written:
                    slot = wp.atomic_add(records.count, 0, 1)
                    if slot < records.bin.shape[0]:
                        records.bin[slot] = row * rays.columns.count + col
                        records.bounces[slot] = bounce + 1
                        records.faces[slot] = met
                        records.second[slot] = second
                        records.third[slot] = third
                        records.weight[slot] = weight
                        records.point[slot] = seen
                        records.ray[slot] = tube
                        records.ends[slot] = ends
        mark = (mark ^ wp.uint64(2 * rays.plane[query.face] + returned)) * PRIME
        if returned == 1:
            returns = wp.uint64(1)
        before = point
        direction = direction - 2.0 * slope * hit.normal
        origin = point
        reach = rays.size
        if bounce == 1 and written:
            wp.atomic_add(records.area, 0, weight)
        if bounce == rays.max_bounces - 1 and written:
            further = wp.mesh_query_ray(rays.tree, origin + clear * side, direction, reach)
            if further.result:
                wp.atomic_add(records.area, 1, weight)
    return wp.uint64(2) * mark + returns


@wp.kernel(enable_backward=False)
def path_kernel(
    # In:
    rays: PathRays,
    band: Band,
    cut: wp.array2d(dtype=wp.uint8),
    segment: int,
    # Out:
    records_out: PathRecords,
):
    """One thread walks `segment` cells in the column of one azimuth cell, a ray each.

    `cut`: cells of the band, (azimuth, elevation), that are left to `border_kernel`; rays then start in the middle of
    the others, which lie inside of bodies. None without any.
    """
    i, j = wp.tid()
    grid = rays.grid
    cell = band.first_cell + i
    centre_u = grid.azimuth_start + (float(cell) + 0.5) * grid.azimuth_step
    last = wp.min((j + 1) * segment, grid.elevation_cells)
    for k in range(j * segment, last):
        if cut.shape[0] > 0:
            if cut[i, k] > wp.uint8(0):
                continue
        jitter = wp.vec2()
        if cut.shape[0] == 0:
            jitter = jitter_of(grid, band.seed, cell, k)
        centre_v = grid.elevation_start + (float(k) + 0.5) * grid.elevation_step
        tube = wp.vec4(centre_u, centre_v, 1.0, 1.0)
        follow(rays, azimuth_of(grid, cell, jitter), elevation_of(grid, k, jitter), tube, wp.vec3(), True, records_out)


@wp.func
def unlike(mark: looks, axis: int) -> int:
    """How many of the lines along an axis of a cell meet other things, one after the other, than the one before."""
    found = int(0)
    before = wp.uint64(0)
    for j in range(SIDE):
        met = wp.uint64(0)
        last = wp.uint64(0)
        for i in range(SIDE):
            k = j * SIDE + i
            if axis == 1:
                k = i * SIDE + j
            if i == 0 or mark[k] != last:
                met = (met ^ mark[k]) * PRIME
            last = mark[k]
        if j > 0 and met != before:
            found += 1
        before = met
    return found


@wp.kernel(enable_backward=False)
def survey_kernel(
    # In:
    rays: PathRays,
    cell: wp.array(dtype=wp.vec2i),
    # Out:
    records_out: PathRecords,
    axis_out: wp.array(dtype=int),
    open_out: wp.array(dtype=wp.vec4i),
):
    """How to cut each `cell` (azimuth, elevation), and over which of its sides a border goes on.

    Strips lie along the axis whose lines meet the same: then both of their long sides do. A side is `open` (before and
    beyond in azimuth, before and beyond in elevation) if a ray on it and the one in the middle of the cell beyond meet
    other things, and one of them returns. Where two borders meet at a sharp angle their tip is narrower than a cell,
    and longer than many: no ray in the middle of a cell finds it.
    """
    i = wp.tid()
    grid = rays.grid
    mark = looks()
    for n in range(SIDE * SIDE + 4):
        u = float(n % SIDE) / float(STRETCHES)
        v = float(n / SIDE) / float(STRETCHES)
        if n >= SIDE * SIDE:
            beside = n - SIDE * SIDE
            u = 0.5
            v = 0.5
            if beside < 2:
                u = 2.0 * float(beside) - 0.5
            else:
                v = 2.0 * float(beside - 2) - 0.5
        azimuth = grid.azimuth_start + (float(cell[i][0]) + u) * grid.azimuth_step
        elevation = grid.elevation_start + (float(cell[i][1]) + v) * grid.elevation_step
        mark[n] = follow(rays, azimuth, elevation, wp.vec4(), wp.vec3(), False, records_out)
    opens = wp.vec4i(0, 0, 0, 0)
    for side in range(4):
        other = mark[SIDE * SIDE + side]
        for n in range(SIDE):
            k = n * SIDE + (side % 2) * (SIDE - 1)
            if side >= 2:
                k = n + (side % 2) * (SIDE - 1) * SIDE
            if mark[k] != other and (mark[k] % wp.uint64(2) == wp.uint64(1) or other % wp.uint64(2) == wp.uint64(1)):
                opens[side] = 1
    axis_out[i] = 0
    if unlike(mark, 1) < unlike(mark, 0):
        axis_out[i] = 1
    open_out[i] = opens


@wp.struct
class Line:
    """A line across a cell: `count` places where what rays meet changes, from -0.5 to 0.5, and the marks of rays."""

    count: int
    at: changes
    mark: marks


@wp.func
def place_in(rays: PathRays, cell: wp.vec4i, along: float, across: float) -> wp.vec2:
    """The place (azimuth, elevation) in a cell, from -0.5 to 0.5 along the axis of its strips, and across it."""
    u = along
    v = across
    if cell[2] == 1:
        u = across
        v = along
    return wp.vec2(
        rays.grid.azimuth_start + (float(cell[0]) + 0.5 + u) * rays.grid.azimuth_step,
        rays.grid.elevation_start + (float(cell[1]) + 0.5 + v) * rays.grid.elevation_step,
    )


@wp.func
def mark_at(rays: PathRays, cell: wp.vec4i, along: float, across: float, records: PathRecords) -> wp.uint64:
    place = place_in(rays, cell, along, across)
    return follow(rays, place[0], place[1], wp.vec4(), wp.vec3(), False, records)


@wp.func
def line_of(rays: PathRays, cell: wp.vec4i, across: float, records: PathRecords) -> Line:
    """A change is found by halving, one in each stretch. The loop asks at one place in the code, since each such place
    holds its own copies of the BVH queries: first where the line begins, then at the end of each stretch."""
    line = Line()
    mark = wp.uint64(0)
    for n in range(STRETCHES + 1):
        low = float(n - 1) / float(STRETCHES) - 0.5
        high = float(n) / float(STRETCHES) - 0.5
        along = float(high)
        beyond = wp.uint64(0)
        for half in range(HALVINGS + 1):
            met = mark_at(rays, cell, along, across, records)
            if half == 0:
                beyond = met
            elif met == mark:
                low = along
            else:
                high = along
            if n == 0 or beyond == mark:
                break
            along = 0.5 * (low + high)
        if n > 0 and beyond != mark:
            line.at[line.count] = along
            line.count += 1
        line.mark[line.count] = beyond
        mark = beyond
    return line


@wp.func
def beside(line: Line, other: Line) -> Line:
    """The line with as many changes as the other one has, if it has none: the border leaves by an end of the strip."""
    found = Line()
    found.count = line.count
    found.at = 1.0 * line.at
    for n in range(line.count + 1):
        found.mark[n] = line.mark[n]
    if line.count == 0 and other.count == 1:
        if line.mark[0] == other.mark[0]:
            found.at[0] = 0.5
            found.count = 1
        elif line.mark[0] == other.mark[1]:
            found.at[0] = -0.5
            found.count = 1
        if found.count == 1:
            found.mark[0] = other.mark[0]
            found.mark[1] = other.mark[1]
    return found


@wp.func
def alike(line: Line, other: Line) -> bool:
    """Whether rays along two lines meet the same, one after the other."""
    same = line.count == other.count
    for n in range(line.count + 1):
        if line.mark[n] != other.mark[n]:
            same = False
    return same


@wp.kernel(enable_backward=False)
def border_kernel(
    # In:
    rays: PathRays,
    cell: wp.array(dtype=wp.vec4i),
    # Out:
    records_out: PathRecords,
):
    """A border of bodies crosses each `cell`: azimuth, elevation, the axis along which it is cut into strips, and how
    many these are.

    The parts of a strip end where the rays in it begin to meet other planes, on both of its long sides: they have the
    area and the phase of what they stand for. Rays at random places would leave to chance what fields that cancel add
    up to. A strip whose sides meet other things has a corner in it, and is halved, down to `FINEST` pieces.
    """
    i, j = wp.tid()
    one = cell[i]
    if j >= one[3]:
        return
    strip = 1.0 / float(one[3])
    at = int(0)
    parts = int(FINEST)  # of the strip, that the next piece has
    side = line_of(rays, one, float(j) * strip - 0.5, records_out)
    while at < FINEST:
        width = strip * float(parts) / float(FINEST)
        low = (float(j) + float(at) / float(FINEST)) * strip - 0.5
        beyond = line_of(rays, one, low + width, records_out)
        same = alike(side, beyond)
        if not same and parts > 1:
            parts = parts / 2
        else:
            middle = low + 0.5 * width
            near = beside(side, beyond)
            far = beside(beyond, side)
            if not alike(near, far):
                near = line_of(rays, one, middle, records_out)
                far = near
            begin = float(-0.5)
            slant = float(0.0)
            for n in range(near.count + 1):
                end = float(0.5)
                further = float(0.0)
                if n < near.count:
                    end = 0.5 * (near.at[n] + far.at[n])
                    further = far.at[n] - near.at[n]
                length = end - begin
                if length > 1.0e-6:
                    place = place_in(rays, one, 0.5 * (begin + end), middle)
                    tube = wp.vec4(place[0], place[1], length, width)
                    if one[2] == 1:
                        tube = wp.vec4(place[0], place[1], width, length)
                    ends = wp.vec3(float(one[2]), slant / length, further / length)
                    follow(rays, place[0], place[1], tube, ends, True, records_out)
                    begin = end
                    slant = further
            side = beyond
            at += parts
            while parts < FINEST and at % (2 * parts) == 0:
                parts = 2 * parts


@wp.kernel(enable_backward=False)
def sort_key_kernel(
    # In:
    records: PathRecords,
    order: wp.array(dtype=int),
    what: int,  # 0: bounces and bin, 1: first two faces, 2: the next two, 3: the last
    # Out:
    key_out: wp.array(dtype=wp.int64),
):
    i = wp.tid()
    at = order[i]
    high = records.bounces[at]
    low = records.bin[at]
    if what == 1:
        high = records.faces[at][0]
        low = records.faces[at][1]
    if what == 2:
        high = records.faces[at][2]
        low = records.faces[at][3]
    if what == 3:
        high = records.faces[at][4]
        low = 0
    key_out[i] = (wp.int64(high) << wp.int64(32)) + wp.int64(low)


@wp.kernel(enable_backward=False)
def mark_path_starts_kernel(
    # In:
    records: PathRecords,
    order: wp.array(dtype=int),
    # Out:
    start_out: wp.array(dtype=int),
):
    """1 where a new (bin, faces of the path) begins."""
    i = wp.tid()
    new = int(1)
    if i > 0:
        a = order[i - 1]
        b = order[i]
        if records.bin[a] == records.bin[b] and records.faces[a] == records.faces[b]:
            new = 0
    start_out[i] = new


@wp.kernel(enable_backward=False)
def reduce_paths_kernel(
    # In:
    records: PathRecords,
    order: wp.array(dtype=int),
    first: wp.array(dtype=int),
    total: int,
    # Out:
    merged_out: PathRecords,
):
    """Weights summed, places averaged with them."""
    i = wp.tid()
    begin = first[i]
    end = total
    if i + 1 < first.shape[0]:
        end = first[i + 1]
    weight = float(0.0)
    second = along_way()
    third = along_way()
    point = wp.vec3(0.0, 0.0, 0.0)
    for k in range(begin, end):
        at = order[k]
        w = records.weight[at]
        weight += w
        second += w * records.second[at]
        third += w * records.third[at]
        point += w * records.point[at]
    merged_out.bin[i] = records.bin[order[begin]]
    merged_out.bounces[i] = records.bounces[order[begin]]
    merged_out.faces[i] = records.faces[order[begin]]
    merged_out.weight[i] = weight
    merged_out.second[i] = second / weight
    merged_out.third[i] = third / weight
    merged_out.point[i] = point / weight
    merged_out.ray[i] = records.ray[order[begin]]
    merged_out.ends[i] = records.ends[order[begin]]


@wp.func
def place_on(mesh: Triangles, face: int, b1: float, b2: float) -> wp.vec3:
    p0 = mesh.vertices[mesh.faces[face, 0]]
    e1 = mesh.vertices[mesh.faces[face, 1]] - p0
    e2 = mesh.vertices[mesh.faces[face, 2]] - p0
    return p0 + b1 * e1 + b2 * e2


@wp.func
def normal_of(mesh: Triangles, face: int) -> wp.vec3:
    p0 = mesh.vertices[mesh.faces[face, 0]]
    e1 = mesh.vertices[mesh.faces[face, 1]] - p0
    e2 = mesh.vertices[mesh.faces[face, 2]] - p0
    return wp.normalize(wp.cross(e1, e2))


@wp.struct
class SmoothFaces:
    """Faces of curved surfaces: `turn` as in `PathRays`, and `normals` of the corners of each face, (faces, 3). Both
    are empty where paths were followed over flat faces."""

    turn: wp.array(dtype=float)
    normals: wp.array2d(dtype=wp.vec3d)


@wp.func
def spread_over(turn: wp.array(dtype=float), met: faces_met, bounces: int) -> bool:
    """Whether a way leads over several curved surfaces, or over one that is neither the first nor the last."""
    curved = int(0)
    inner = int(0)
    for k in range(bounces):
        if turn.shape[0] > 0:
            if turn[met[k] - 1] > 0.0:
                curved += 1
                if k > 0 and k < bounces - 1:
                    inner += 1
    return curved >= 2 or inner > 0


@wp.func
def arrival_at(mesh: Triangles, paths: PathRecords, i: int, k: int) -> wp.vec3:
    """The direction of a path from one of its places, k - 1, to the next."""
    met = paths.faces[i]
    second = paths.second[i]
    third = paths.third[i]
    before = place_on(mesh, met[k - 1] - 1, second[k - 1], third[k - 1])
    return wp.normalize(place_on(mesh, met[k] - 1, second[k], third[k]) - before)


@wp.func
def smooth_normal(smooth: SmoothFaces, face: int, b1: float, b2: float) -> wp.vec3:
    n0 = smooth.normals[face, 0]
    mean = n0 + wp.float64(b1) * (smooth.normals[face, 1] - n0) + wp.float64(b2) * (smooth.normals[face, 2] - n0)
    return wp.vec3(wp.normalize(mean))


@wp.kernel(enable_backward=False)
def path_geometry_kernel(
    # In:
    grid: RayGrid,
    mesh: Triangles,
    smooth: SmoothFaces,
    paths: PathRecords,
    bounces: int,
    # Out:
    angles_out: PathAngles,
):
    """Angles along the path, from its first point and the faces that it meets."""
    i = wp.tid()
    met = paths.faces[i]
    second = paths.second[i]
    third = paths.third[i]
    direction = look_direction(grid, place_on(mesh, met[0] - 1, second[0], third[0]))
    angles_out.arrival[i] = direction
    cosines = along_way(1.0)
    spread = spread_over(smooth.turn, met, bounces)
    for k in range(bounces):
        normal = normal_of(mesh, met[k] - 1)
        if spread:
            if k > 0:
                direction = arrival_at(mesh, paths, i, k)
            if k < bounces - 1:
                normal = wp.normalize(arrival_at(mesh, paths, i, k + 1) - direction)
            else:
                normal = smooth_normal(smooth, met[k] - 1, second[k], third[k])
        slope = wp.dot(normal, direction)
        cosines[k] = wp.min(wp.abs(slope), 1.0)
        if k == bounces - 1:
            home = -look_direction(grid, place_on(mesh, met[k] - 1, second[k], third[k]))
            half = wp.normalize(home - direction)
            angles_out.home[i] = home
            angles_out.cos_half[i] = wp.clamp(-wp.dot(half, direction), 0.0, 1.0)
            angles_out.cos_tilt[i] = wp.min(wp.abs(wp.dot(half, normal)), 1.0)
        direction = direction - 2.0 * slope * normal
    angles_out.cos_incidence[i] = cosines
    angles_out.weight[i] = paths.weight[i] / wp.max(cosines[bounces - 1], 1.0e-6)


@wp.kernel(enable_backward=False)
def bounce_kernel(
    # In:
    mesh: Triangles,
    smooth: SmoothFaces,
    paths: PathRecords,
    angles: PathAngles,
    bounces: int,
    k: int,
    # Out:
    bounce_out: Bounce,
):
    """Bounce k of every path, in the arrays that hits have."""
    i = wp.tid()
    face = paths.faces[i][k] - 1
    b1 = paths.second[i][k]
    b2 = paths.third[i][k]
    bounce_out.face[i] = face
    bounce_out.barycentric[i] = wp.vec2(b1, b2)
    bounce_out.point[i] = place_on(mesh, face, b1, b2)
    bounce_out.cos_incidence[i] = angles.cos_incidence[i][k]
    direction = angles.arrival[i]
    normal = normal_of(mesh, face)
    for before in range(k):
        mirror = normal_of(mesh, paths.faces[i][before] - 1)
        direction = direction - 2.0 * wp.dot(mirror, direction) * mirror
    if spread_over(smooth.turn, paths.faces[i], bounces):
        if k > 0:
            direction = arrival_at(mesh, paths, i, k)
        if k < bounces - 1:
            normal = wp.normalize(arrival_at(mesh, paths, i, k + 1) - direction)
        else:
            normal = smooth_normal(smooth, face, b1, b2)
    if wp.dot(normal, direction) > 0.0:
        normal = -normal
    bounce_out.direction[i] = direction
    bounce_out.normal[i] = normal


@wp.kernel
def return_kernel(
    # In:
    p: wp.array(dtype=float),  # strength
    polarization: int,
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    cos_half: wp.array(dtype=float),
    cos_tilt: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    # Out:
    power_out: wp.array(dtype=float),
):
    """The last surface returns the ray with its bistatic lobe."""
    i = wp.tid()
    h = wp.exp(zeta[i][Coordinate.HEIGHT] - zeta[i][Coordinate.LENGTH])
    slope_variance = 2.0 * h * h + LEAST_SLOPE_VARIANCE
    eps_re = 1.0 + wp.exp(zeta[i][Coordinate.EPS])
    power_out[i] = p[0] * bistatic_geometric_optics(
        polarization, cos_half[i], cos_tilt[i], eps_re, eps_im[face_material[face[i]]], slope_variance
    )


@wp.kernel
def mirror_kernel(
    # In:
    polarization: int,
    wavenumber: float,
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    cos_incidence: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    power: wp.array(dtype=float),
    # Out:
    power_out: wp.array(dtype=float),
):
    """A surface before the last: Fresnel's reflectivity, less what roughness takes from the coherent wave."""
    i = wp.tid()
    c = cos_incidence[i]
    eps_re = 1.0 + wp.exp(zeta[i][Coordinate.EPS])
    loss = eps_im[face_material[face[i]]]
    reflectivity = float(0.0)
    if polarization == Polarization.HH:
        reflectivity = fresnel_h(c, eps_re, loss)
    else:
        reflectivity = fresnel_v(c, eps_re, loss)
    phase = 2.0 * wavenumber * wp.exp(zeta[i][Coordinate.HEIGHT]) * c
    power_out[i] = power[i] * reflectivity * wp.exp(-phase * phase)
