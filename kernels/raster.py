"""The nearest face of every ray of a view, face by face: rays are a grid, so a face knows which of them can meet it."""

import warp as wp

from warpsar.kernels.geometry import Band, PlaneRay, RayGrid, Triangles, azimuth_of, elevation_of, jitter_of, plane_ray

# A product fused into a sum is rounded otherwise than its twin: two faces would differ about their common edge.
wp.set_module_options({"fuse_fp": False})

BLOCK = 128  # threads of a CUDA block

FAR = wp.constant(1.0e30)

FACE_LANES = 8  # threads that share a face, or a strip of one
SMALL = wp.constant(512)  # cells of a face that are held against it at once; a larger one is cut into strips
STRIP_BITS = wp.constant(36)  # of a number that counts strips; faces are counted above them
NO_FACE = 2**63 - 1  # a distance that no face has, and -1 in the low 32 bits


@wp.struct
class Span:
    low: float
    high: float


@wp.struct
class ProjectedVertices:
    """A mesh as the radar sees it: of every vertex what `project_kernel` finds, and the three of each face."""

    corner: wp.array(dtype=wp.vec4)
    faces: wp.array2d(dtype=int)
    slack: float  # how far a corner may be off [cells]


@wp.struct
class LargeFaces:
    """Faces that are cut into strips of one azimuth cell each.

    `count` has one element, which counts faces and their strips in one number. So strips are numbered in the order of
    the list: the first strip of each `face` is number `begin`.
    """

    count: wp.array(dtype=wp.int64)
    face: wp.array(dtype=int)
    begin: wp.array(dtype=wp.int64)


@wp.kernel(enable_backward=False)
def project_kernel(
    # In:
    grid: RayGrid,
    vertices: wp.array(dtype=wp.vec3),
    # Out:
    corner_out: wp.array(dtype=wp.vec4),
):
    """X . u [m], elevation [cells], X . d [m], X . v [m]."""
    i = wp.tid()
    p = vertices[i]
    along = wp.dot(p, grid.d)
    across = wp.dot(p, grid.v)
    elevation = across
    if grid.slant_range > 0.0:
        elevation = wp.atan2(across, along + grid.slant_range)
    elevation = (elevation - grid.elevation_start) / grid.elevation_step
    corner_out[i] = wp.vec4(wp.dot(p, grid.u), elevation, along, across)


@wp.kernel(enable_backward=False)
def sample_kernel(
    # In:
    grid: RayGrid,
    first_cell: int,
    seed: int,
    # Out:
    sample_out: wp.array(dtype=wp.vec2),
):
    """Azimuth [m] and elevation of the rays of one azimuth cell: what tests and benchmarks hand to other programs."""
    i = wp.tid()
    cell = first_cell + i
    for k in range(grid.elevation_cells):
        jitter = jitter_of(grid, seed, cell, k)
        sample_out[i * grid.elevation_cells + k] = wp.vec2(
            azimuth_of(grid, cell, jitter), elevation_of(grid, k, jitter)
        )


@wp.func
def cells_of(grid: RayGrid, a: wp.vec4, b: wp.vec4, c: wp.vec4, slack: float) -> wp.vec4i:
    """Cells that a face may touch: first and last in azimuth, first and last in elevation; last < first for none."""
    left = (wp.min(wp.min(a[0], b[0]), c[0]) - grid.azimuth_start) / grid.azimuth_step - slack
    right = (wp.max(wp.max(a[0], b[0]), c[0]) - grid.azimuth_start) / grid.azimuth_step + slack
    bottom = wp.min(wp.min(a[1], b[1]), c[1]) - slack
    top = wp.max(wp.max(a[1], b[1]), c[1]) + slack
    # cut before the conversion: an image may be a small part of the mesh
    width = float(grid.cols * grid.cells_per_column)
    height = float(grid.elevation_cells)
    return wp.vec4i(
        int(wp.floor(wp.clamp(left, 0.0, width))),
        int(wp.floor(wp.clamp(right, -1.0, width - 1.0))),
        int(wp.floor(wp.clamp(bottom, 0.0, height))),
        int(wp.floor(wp.clamp(top, -1.0, height - 1.0))),
    )


@wp.kernel(enable_backward=False)
def extent_kernel(
    # In:
    grid: RayGrid,
    mesh: ProjectedVertices,
    # Out:
    cells_out: wp.array(dtype=wp.vec4i),
):
    f = wp.tid()
    a = mesh.corner[mesh.faces[f, 0]]
    b = mesh.corner[mesh.faces[f, 1]]
    c = mesh.corner[mesh.faces[f, 2]]
    cells_out[f] = cells_of(grid, a, b, c, mesh.slack)


@wp.func
def elevation_between(grid: RayGrid, a: wp.vec4, b: wp.vec4, t: float) -> float:
    if grid.slant_range > 0.0:
        across = a[3] + t * (b[3] - a[3])
        along = a[2] + t * (b[2] - a[2])
        return (wp.atan2(across, along + grid.slant_range) - grid.elevation_start) / grid.elevation_step
    return a[1] + t * (b[1] - a[1])


@wp.func
def widened(grid: RayGrid, a: wp.vec4, b: wp.vec4, left: float, right: float, span: Span) -> Span:
    """`span` with the elevations that the edge a-b has between the azimuths `left` and `right`."""
    low = wp.max(wp.min(a[0], b[0]), left)
    high = wp.min(wp.max(a[0], b[0]), right)
    result = span
    if low <= high:
        at_low = a[1]
        at_high = b[1]
        wide = b[0] - a[0]
        if wide != 0.0:
            at_low = elevation_between(grid, a, b, wp.clamp((low - a[0]) / wide, 0.0, 1.0))
            at_high = elevation_between(grid, a, b, wp.clamp((high - a[0]) / wide, 0.0, 1.0))
        result.low = wp.min(span.low, wp.min(at_low, at_high))
        result.high = wp.max(span.high, wp.max(at_low, at_high))
    return result


@wp.func
def strip_of(
    grid: RayGrid, a: wp.vec4, b: wp.vec4, c: wp.vec4, cell: int, bottom: int, top: int, slack: float
) -> wp.vec2i:
    """Of the elevation cells `bottom` to `top` the first and the last that a face may touch in one azimuth cell."""
    begin = grid.azimuth_start + (float(cell) - slack) * grid.azimuth_step
    end = grid.azimuth_start + (float(cell) + 1.0 + slack) * grid.azimuth_step
    span = Span()
    span.low = FAR
    span.high = -FAR
    span = widened(grid, a, b, begin, end, span)
    span = widened(grid, b, c, begin, end, span)
    span = widened(grid, c, a, begin, end, span)
    low = wp.max(bottom, int(wp.floor(span.low - slack)))
    return wp.vec2i(low, wp.min(top, int(wp.floor(span.high + slack))))


@wp.func
def distance_to(grid: RayGrid, a: wp.vec4, b: wp.vec4, c: wp.vec4, azimuth: float, ray: PlaneRay) -> float:
    """How far along a ray a face lies; infinite where the ray passes it, or meets it edge-on.

    Edges are tested in the plane across the ray, from differences that two faces with a common edge round alike: no ray
    passes between them.
    """
    au = a[0] - azimuth
    bu = b[0] - azimuth
    cu = c[0] - azimuth
    av = a[3] - ray.across
    bv = b[3] - ray.across
    cv = c[3] - ray.across
    if grid.slant_range > 0.0:
        av = av * ray.cosine - (a[2] - ray.along) * ray.sine
        bv = bv * ray.cosine - (b[2] - ray.along) * ray.sine
        cv = cv * ray.cosine - (c[2] - ray.along) * ray.sine
    wa = bu * cv - bv * cu
    wb = cu * av - cv * au
    wc = au * bv - av * bu
    total = wa + wb + wc
    distance = float(wp.inf)
    if total != 0.0 and ((wa >= 0.0 and wb >= 0.0 and wc >= 0.0) or (wa <= 0.0 and wb <= 0.0 and wc <= 0.0)):
        distance = (wa * a[2] + wb * b[2] + wc * c[2]) / total - ray.along
        if grid.slant_range > 0.0:
            v = (wa * a[3] + wb * b[3] + wc * c[3]) / total - ray.across
            distance = distance * ray.cosine + v * ray.sine
    return distance


@wp.func
def draw(
    grid: RayGrid,
    band: Band,
    a: wp.vec4,
    b: wp.vec4,
    c: wp.vec4,
    f: int,
    cell: int,
    k: int,
    nearest: wp.array(dtype=wp.int64),
):
    """A face against one ray: the smallest (distance, face) stays, in whatever order they come."""
    jitter = jitter_of(grid, band.seed, cell, k)
    ray = plane_ray(grid, elevation_of(grid, k, jitter))
    distance = distance_to(grid, a, b, c, azimuth_of(grid, cell, jitter), ray)
    if distance < FAR:
        # the bits of positive numbers are in their order
        bits = wp.int64(wp.cast(wp.max(distance, 0.0), wp.uint32))
        found = (bits << wp.int64(32)) + wp.int64(f)
        at = (cell - band.first_cell) * grid.elevation_cells + k
        if found < nearest[at]:
            wp.atomic_min(nearest, at, found)


@wp.kernel(enable_backward=False, launch_bounds=(BLOCK, 12))
def draw_kernel(
    # In:
    grid: RayGrid,
    mesh: ProjectedVertices,
    band: Band,
    # In and out:
    nearest: wp.array(dtype=wp.int64),
    large: LargeFaces,
):
    """FACE_LANES threads hold one face against the rays whose cells it may touch, or put it on the list `large`."""
    t = wp.tid()
    f = t // FACE_LANES
    lane = t % FACE_LANES
    a = mesh.corner[mesh.faces[f, 0]]
    b = mesh.corner[mesh.faces[f, 1]]
    c = mesh.corner[mesh.faces[f, 2]]
    box = cells_of(grid, a, b, c, mesh.slack)
    first = wp.max(box[0], band.first_cell)
    wide = wp.min(box[1], band.end_cell - 1) - first + 1
    high = box[3] - box[2] + 1
    if wide > 0 and high > 0:
        if wide <= SMALL and high <= SMALL and wide * high <= SMALL:
            for i in range(lane, wide * high, FACE_LANES):
                cell = first + i // high
                k = box[2] + i % high
                draw(grid, band, a, b, c, f, cell, k, nearest)
        elif lane == 0:
            one = wp.int64(1) << wp.int64(STRIP_BITS)
            taken = wp.atomic_add(large.count, 0, one + wp.int64(wide))
            slot = int(taken >> wp.int64(STRIP_BITS))
            large.face[slot] = f
            large.begin[slot] = taken & (one - wp.int64(1))


@wp.kernel(enable_backward=False, launch_bounds=(BLOCK, 10))
def draw_large_kernel(
    # In:
    grid: RayGrid,
    mesh: ProjectedVertices,
    band: Band,
    large: LargeFaces,
    groups: int,
    # In and out:
    nearest: wp.array(dtype=wp.int64),
):
    """The strips of the large faces, shared out to groups of FACE_LANES threads: the host need not count them."""
    t = wp.tid()
    group = t // FACE_LANES
    lane = t % FACE_LANES
    one = wp.int64(1) << wp.int64(STRIP_BITS)
    count = int(large.count[0] >> wp.int64(STRIP_BITS))
    strips = large.count[0] & (one - wp.int64(1))
    each = (strips + wp.int64(groups) - wp.int64(1)) // wp.int64(groups)
    number = wp.int64(group) * each
    last = wp.min(number + each, strips)
    # the last of the list that begins at the first of these strips or before it
    slot = int(0)
    end = count
    while end - slot > 1 and number < last:
        middle = (slot + end) // 2
        if large.begin[middle] <= number:
            slot = middle
        else:
            end = middle
    while number < last:
        until = last
        if slot + 1 < count:
            until = wp.min(last, large.begin[slot + 1])
        f = large.face[slot]
        a = mesh.corner[mesh.faces[f, 0]]
        b = mesh.corner[mesh.faces[f, 1]]
        c = mesh.corner[mesh.faces[f, 2]]
        box = cells_of(grid, a, b, c, mesh.slack)
        begin = wp.max(box[0], band.first_cell) + int(number - large.begin[slot])
        for cell in range(begin, begin + int(until - number)):
            strip = strip_of(grid, a, b, c, cell, box[2], box[3], mesh.slack)
            for k in range(strip[0] + lane, strip[1] + 1, FACE_LANES):
                draw(grid, band, a, b, c, f, cell, k, nearest)
        number = until
        slot += 1


@wp.kernel(enable_backward=False)
def area_kernel(mesh: Triangles, area_out: wp.array(dtype=wp.float64)):
    """Area of every face that is this thread's [m2], summed."""
    t = wp.tid()
    area = wp.float64(0.0)
    for f in range(t, mesh.faces.shape[0], area_out.shape[0]):
        p = mesh.vertices[mesh.faces[f, 0]]
        e1 = mesh.vertices[mesh.faces[f, 1]] - p
        e2 = mesh.vertices[mesh.faces[f, 2]] - p
        area += wp.float64(0.5 * wp.length(wp.cross(e1, e2)))
    area_out[t] = area
