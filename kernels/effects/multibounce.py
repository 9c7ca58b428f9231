"""Paths of rays over several surfaces: traced and merged once; then their power, by the surfaces that they meet."""

import warp as wp

from warpsar.kernels.codes import Coordinate, Polarization
from warpsar.kernels.geometry import (
    Band,
    RayGrid,
    Triangles,
    intersect,
    look_direction,
    ray_direction,
    ray_origin,
    slant_range_of,
)
from warpsar.kernels.scattering import bistatic_geometric_optics, fresnel_h, fresnel_v

# Every ray of a dihedral has the range of its foot. Where this is the edge between two bins, rounding in float32 would
# choose the bin of each ray. So a range beyond an edge by this share of a bin, or less, stays on the near side.
EDGE = wp.constant(1.0e-3)

# Slope variance that even a smooth surface has: it keeps the lobe of a mirror wide enough for a mesh's facets.
LEAST_SLOPE_VARIANCE = wp.constant(1.0e-4)


@wp.struct
class PathRecords:
    """One record per ray and return to the radar, in any order.

    `count` may exceed the length of the arrays: then the rays are traced again with more room.
    """

    bin: wp.array(dtype=int)
    bounces: wp.array(dtype=int)
    faces: wp.array(dtype=wp.vec4i)  # face + 1, in the order of the bounces; 0 after the last
    second: wp.array(dtype=wp.vec4)  # barycentric weights of the faces' second vertices
    third: wp.array(dtype=wp.vec4)
    weight: wp.array(dtype=float)  # dA_perp / pixel area
    point: wp.array(dtype=wp.vec3)  # where one bounce would have the same range, azimuth and mean elevation
    ray: wp.array(dtype=wp.vec3)  # azimuth and elevation of the middle of the ray's cell; its side, in grid cells
    count: wp.array(dtype=int)
    area: wp.array(
        dtype=float
    )  # of the rays that meet two surfaces, and of those that go on after all bounces [pixels]


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
    cos_incidence: wp.array(dtype=wp.vec4)
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


# Long because one thread walks its rays from entry to return: what is cut out would be handed twelve values and back.
@wp.kernel(enable_backward=False)
def path_kernel(
    # In:
    grid: RayGrid,
    mesh: Triangles,
    band: Band,
    columns: ImageColumns,
    split: wp.array2d(dtype=wp.uint8),
    tree: wp.uint64,
    segment: int,
    max_bounces: int,
    size: float,  # of the mesh: how far a ray may go from one surface to the next [m]
    # Out:
    records_out: PathRecords,
):
    """One thread walks `segment` cells in the column of one azimuth cell. Every surface but the last is a mirror.

    A BVH query starts just off the surface, so that it does not find the same surface again. The point that the ray
    meets is then computed from the surface itself. `split`: into how many parts along each side a cell of the band is
    cut, (azimuth, elevation); whole cells without any.
    """
    i, j = wp.tid()
    cell = band.first_cell + i
    centre_u = grid.azimuth_start + (float(cell) + 0.5) * grid.azimuth_step
    clear = 1.0e-5 * size
    last = wp.min((j + 1) * segment, grid.elevation_cells)
    for k in range(j * segment, last):
        random = wp.rand_init(band.seed, cell * grid.elevation_cells + k)
        parts = int(1)
        if split.shape[0] > 0:
            parts = int(split[i, k])
        part = 1.0 / float(parts)
        for piece in range(parts * parts):
            jitter_u = wp.randf(random) - 0.5
            jitter_v = wp.randf(random) - 0.5
            line = piece / parts
            aside = (float(piece - line * parts) + 0.5) * part - 0.5
            above = (float(line) + 0.5) * part - 0.5
            elevation = grid.elevation_start + (float(k) + 0.5 + (above + part * jitter_v)) * grid.elevation_step
            origin = ray_origin(grid, centre_u + (aside + part * jitter_u) * grid.azimuth_step, elevation)
            direction = ray_direction(grid, elevation)
            weight = part * part * grid.azimuth_step * grid.elevation_step / grid.pixel_area
            met = wp.vec4i(0, 0, 0, 0)
            second = wp.vec4(0.0, 0.0, 0.0, 0.0)
            third = wp.vec4(0.0, 0.0, 0.0, 0.0)
            entry = wp.vec3(0.0, 0.0, 0.0)
            before = wp.vec3(0.0, 0.0, 0.0)
            side = wp.vec3(0.0, 0.0, 0.0)
            between = float(0.0)
            reach = grid.reach
            for bounce in range(max_bounces):
                query = wp.mesh_query_ray(tree, origin + clear * side, direction, reach)
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
                home = -look_direction(grid, point)
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
                        col = int(wp.floor((wp.dot(seen, grid.u) - columns.start) / columns.spacing))
                        if row >= 0 and row < grid.rows and col >= 0 and col < columns.count:
                            back = wp.mesh_query_ray(tree, point + clear * side, home, size)
                            if not back.result:
                                slot = wp.atomic_add(records_out.count, 0, 1)
                                if slot < records_out.bin.shape[0]:
                                    records_out.bin[slot] = row * columns.count + col
                                    records_out.bounces[slot] = bounce + 1
                                    records_out.faces[slot] = met
                                    records_out.second[slot] = second
                                    records_out.third[slot] = third
                                    records_out.weight[slot] = weight
                                    records_out.point[slot] = seen
                                    middle_u = centre_u + aside * grid.azimuth_step
                                    middle_v = grid.elevation_start + (float(k) + 0.5 + above) * grid.elevation_step
                                    records_out.ray[slot] = wp.vec3(middle_u, middle_v, part)
                before = point
                direction = direction - 2.0 * slope * hit.normal
                origin = point
                reach = size
                if bounce == 1:
                    wp.atomic_add(records_out.area, 0, weight)
                if bounce == max_bounces - 1:
                    further = wp.mesh_query_ray(tree, origin + clear * side, direction, reach)
                    if further.result:
                        wp.atomic_add(records_out.area, 1, weight)


@wp.kernel(enable_backward=False)
def sort_key_kernel(
    # In:
    records: PathRecords,
    order: wp.array(dtype=int),
    what: int,  # 0: bounces and bin, 1: first two faces, 2: the other two
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
    second = wp.vec4(0.0, 0.0, 0.0, 0.0)
    third = wp.vec4(0.0, 0.0, 0.0, 0.0)
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


@wp.kernel(enable_backward=False)
def path_geometry_kernel(
    # In:
    grid: RayGrid,
    mesh: Triangles,
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
    cosines = wp.vec4(1.0, 1.0, 1.0, 1.0)
    for k in range(bounces):
        normal = normal_of(mesh, met[k] - 1)
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
    paths: PathRecords,
    angles: PathAngles,
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
