"""The nearest face of every ray of a view, face by face: rays are a grid, so a face knows which of them can meet it."""

import warp as wp

from warpsar.kernels.geometry import RayGrid
from warpsar.kernels.trace import azimuth_of, elevation_of, jitter_of

FAR = wp.constant(1.0e30)


@wp.struct
class Span:
    low: float
    high: float


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
    """Azimuth [m] and elevation of the rays of one azimuth cell."""
    i = wp.tid()
    cell = first_cell + i
    for k in range(grid.elevation_cells):
        jitter = jitter_of(grid, seed, cell, k)
        sample_out[i * grid.elevation_cells + k] = wp.vec2(
            azimuth_of(grid, cell, jitter), elevation_of(grid, k, jitter)
        )


@wp.kernel(enable_backward=False)
def extent_kernel(
    # In:
    grid: RayGrid,
    corner: wp.array(dtype=wp.vec4),
    faces: wp.array2d(dtype=int),
    slack: float,
    # Out:
    cells_out: wp.array(dtype=wp.vec4i),
):
    """Cells that a face may touch: first and last in azimuth, first and last in elevation; last < first for none."""
    f = wp.tid()
    a = corner[faces[f, 0]]
    b = corner[faces[f, 1]]
    c = corner[faces[f, 2]]
    left = (wp.min(wp.min(a[0], b[0]), c[0]) - grid.azimuth_start) / grid.azimuth_step - slack
    right = (wp.max(wp.max(a[0], b[0]), c[0]) - grid.azimuth_start) / grid.azimuth_step + slack
    bottom = wp.min(wp.min(a[1], b[1]), c[1]) - slack
    top = wp.max(wp.max(a[1], b[1]), c[1]) + slack
    # cut before the conversion: an image may be a small part of the mesh
    width = float(grid.cols * grid.cells_per_column)
    height = float(grid.elevation_cells)
    cells_out[f] = wp.vec4i(
        int(wp.floor(wp.clamp(left, 0.0, width))),
        int(wp.floor(wp.clamp(right, -1.0, width - 1.0))),
        int(wp.floor(wp.clamp(bottom, 0.0, height))),
        int(wp.floor(wp.clamp(top, -1.0, height - 1.0))),
    )


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


@wp.kernel(enable_backward=False)
def raster_kernel(
    # In:
    grid: RayGrid,
    corner: wp.array(dtype=wp.vec4),
    faces: wp.array2d(dtype=int),
    cells: wp.array(dtype=wp.vec4i),
    listed: wp.array(dtype=int),
    sample: wp.array(dtype=wp.vec2),
    first_cell: int,
    last_cell: int,
    slack: float,
    # In and out:
    depth: wp.array(dtype=float),
    nearest: wp.array(dtype=int),
):
    """One face against the rays whose cells it may touch; a launch on the CPU is serial, so nothing is atomic.

    Edges are tested in the plane across each ray, from differences that two faces with a common edge round alike:
    no ray passes between them. `cells` of each face are those of `extent_kernel`, `slack` [cells] is what it had.
    """
    f = listed[wp.tid()]
    a = corner[faces[f, 0]]
    b = corner[faces[f, 1]]
    c = corner[faces[f, 2]]
    box = cells[f]
    first = wp.max(box[0], first_cell)
    last = wp.min(box[1], last_cell)
    bottom = box[2]
    top = box[3]
    slanted = first < last and bottom + 3 < top  # worth cutting into strips of one azimuth cell
    for cell in range(first, last + 1):
        low = bottom
        high = top
        if slanted:
            begin = grid.azimuth_start + (float(cell) - slack) * grid.azimuth_step
            end = grid.azimuth_start + (float(cell) + 1.0 + slack) * grid.azimuth_step
            span = Span()
            span.low = FAR
            span.high = -FAR
            span = widened(grid, a, b, begin, end, span)
            span = widened(grid, b, c, begin, end, span)
            span = widened(grid, c, a, begin, end, span)
            low = wp.max(low, int(wp.floor(span.low - slack)))
            high = wp.min(high, int(wp.floor(span.high + slack)))
        row = (cell - first_cell) * grid.elevation_cells
        for k in range(low, high + 1):
            at = row + k
            azimuth = sample[at][0]
            elevation = sample[at][1]
            # the ray's origin and direction in the plane of d and v, as in `ray_origin`
            cosine = float(1.0)
            sine = float(0.0)
            along = -grid.standoff
            across = elevation
            if grid.slant_range > 0.0:
                cosine = wp.cos(elevation)
                sine = wp.sin(elevation)
                half = wp.sin(0.5 * elevation)
                along = -2.0 * half * half * grid.slant_range - grid.standoff * cosine
                across = (grid.slant_range - grid.standoff) * sine
            au = a[0] - azimuth
            bu = b[0] - azimuth
            cu = c[0] - azimuth
            av = (a[3] - across) * cosine - (a[2] - along) * sine
            bv = (b[3] - across) * cosine - (b[2] - along) * sine
            cv = (c[3] - across) * cosine - (c[2] - along) * sine
            wa = bu * cv - bv * cu
            wb = cu * av - cv * au
            wc = au * bv - av * bu
            if (wa >= 0.0 and wb >= 0.0 and wc >= 0.0) or (wa <= 0.0 and wb <= 0.0 and wc <= 0.0):
                total = wa + wb + wc
                if total != 0.0:  # else edge-on
                    d = (wa * a[2] + wb * b[2] + wc * c[2]) / total - along
                    v = (wa * a[3] + wb * b[3] + wc * c[3]) / total - across
                    distance = d * cosine + v * sine
                    # of two at one distance the first: a matter of the mesh, not of the order they come in
                    if distance < depth[at] or (distance == depth[at] and f < nearest[at]):
                        depth[at] = distance
                        nearest[at] = f
