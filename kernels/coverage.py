"""Exact coverage: which area of each visible face lies in each pixel, without rays.

Seen across the look direction a face is a triangle in (azimuth a, elevation e), and its slant range is a plane over
(a, e). A column of pixels is cut into slabs of azimuth, at every vertex and wherever an outline crosses an edge. Inside
a slab the order of the edges does not change. Each visible stretch of a face is then a trapezoid with straight sides,
whose area in every row of the image has a closed form.
"""

import warp as wp

from warpsar.kernels.geometry import (
    RayGrid,
    cos2_azimuth_of,
    cos_incidence_of,
    cos_twist_of,
    look_direction,
    normal_of,
    point_on,
)

REAL = wp.float64
NEAR = wp.constant(wp.float64(1.0e-9))  # [m]: stretches and slabs shorter than this are nothing
TOUCH = wp.constant(wp.float64(1.0e-8))  # [m] in range: surfaces nearer than this touch
LINES = wp.constant(5)  # that the middle of a piece is taken over
FLAT = wp.constant(wp.float64(1.0e-6))  # rows: a stretch with less extent in range lies in one


@wp.struct
class Edges:
    """Edges in (azimuth, elevation, range) [m], the end of lesser azimuth first: shape (n, 3) each."""

    start: wp.array2d(dtype=wp.float64)
    end: wp.array2d(dtype=wp.float64)


@wp.struct
class Faces:
    """Faces across the look direction: corners by ascending azimuth [m], and `plane` p; shape (n, 3) each.

    The slant range on a face is p0 + p1 a + p2 e.
    """

    azimuth: wp.array2d(dtype=wp.float64)
    elevation: wp.array2d(dtype=wp.float64)
    plane: wp.array2d(dtype=wp.float64)


@wp.struct
class Stretches:
    """Room for the faces that cross a slab: both borders at the slab's ends, shape (candidates,) each.

    `order` lists them by their lower border.
    """

    order: wp.array(dtype=int)
    face: wp.array(dtype=int)
    place: wp.array(dtype=int)
    low_start: wp.array(dtype=wp.float64)
    low_end: wp.array(dtype=wp.float64)
    high_start: wp.array(dtype=wp.float64)
    high_end: wp.array(dtype=wp.float64)


@wp.struct
class Cells:
    """The pixels that each candidate may cover: `first_row` and `start` (its first cell), shape (candidates,).

    `area` [m^2], and its first moments in azimuth and elevation, shape (cells,).
    """

    first_row: wp.array(dtype=int)
    start: wp.array(dtype=int)
    area: wp.array(dtype=wp.float64)
    azimuth: wp.array(dtype=wp.float64)
    elevation: wp.array(dtype=wp.float64)


LOW = wp.constant(-1)  # a border is the low side of a face
HIGH = wp.constant(-2)  # or its high side
NONE = wp.constant(-1)  # or nothing that moves


@wp.struct
class Pieces:
    """Visible trapezoids, shape (n,): of a `face`, in a `column`, from azimuth `start` to `end` [m].

    `low` and `high`, (n, 2), are their elevations there [m]. `low_by` and `high_by`, (n, 2), say what the borders are:
    a side of a face (face, LOW or HIGH), the line where two faces meet (face, face), or NONE. `first`, (columns,), is
    where each column's pieces begin; `count`, (columns,), how many it has. Without room they are only counted.
    """

    face: wp.array(dtype=int)
    column: wp.array(dtype=int)
    start: wp.array(dtype=wp.float64)
    end: wp.array(dtype=wp.float64)
    low: wp.array2d(dtype=wp.float64)
    high: wp.array2d(dtype=wp.float64)
    low_by: wp.array2d(dtype=int)
    high_by: wp.array2d(dtype=int)
    first: wp.array(dtype=int)
    count: wp.array(dtype=int)


@wp.func
def between(x0: wp.float64, y0: wp.float64, x1: wp.float64, y1: wp.float64, x: wp.float64) -> wp.float64:
    """y at x on a line; the same number for whichever face asks for the edge."""
    return y0 + (y1 - y0) * ((x - x0) / (x1 - x0))


@wp.kernel(enable_backward=False)
def crossing_kernel(
    # In:
    edges: Edges,
    outlines: wp.array(dtype=int),
    first_outline: wp.array(dtype=int),
    others: wp.array(dtype=int),
    first_other: wp.array(dtype=int),
    border: wp.array(dtype=wp.float64),
    first_out: wp.array(dtype=int),
    # Out:
    count_out: wp.array(dtype=int),
    azimuth_out: wp.array(dtype=wp.float64),
):
    """Azimuths in each column at which an outline passes in front of another edge.

    Without room in `azimuth_out` they are only counted.
    """
    column = wp.tid()
    begin = border[column]
    end = border[column + 1]
    found = int(0)
    for i in range(first_outline[column], first_outline[column + 1]):
        p = outlines[i]
        for j in range(first_other[column], first_other[column + 1]):
            q = others[j]
            x0 = wp.max(wp.max(edges.start[p, 0], edges.start[q, 0]), begin)
            x1 = wp.min(wp.min(edges.end[p, 0], edges.end[q, 0]), end)
            if p != q and x1 - x0 > NEAR:
                p0 = between(edges.start[p, 0], edges.start[p, 1], edges.end[p, 0], edges.end[p, 1], x0)
                p1 = between(edges.start[p, 0], edges.start[p, 1], edges.end[p, 0], edges.end[p, 1], x1)
                q0 = between(edges.start[q, 0], edges.start[q, 1], edges.end[q, 0], edges.end[q, 1], x0)
                q1 = between(edges.start[q, 0], edges.start[q, 1], edges.end[q, 0], edges.end[q, 1], x1)
                if (p0 - q0) * (p1 - q1) < REAL(0.0):
                    x = x0 + (x1 - x0) * (p0 - q0) / (p0 - q0 - p1 + q1)
                    rp = between(edges.start[p, 0], edges.start[p, 2], edges.end[p, 0], edges.end[p, 2], x)
                    rq = between(edges.start[q, 0], edges.start[q, 2], edges.end[q, 0], edges.end[q, 2], x)
                    if rp < rq + TOUCH:
                        if azimuth_out.shape[0] > 0:
                            azimuth_out[first_out[column] + found] = x
                        found += 1
    count_out[column] = found


@wp.func
def above(y0: wp.float64, y1: wp.float64, t: wp.float64) -> wp.float64:
    """Mean of max(0, y - t) for y that goes evenly from y0 to y1."""
    p = wp.max(y0, y1) - t
    q = wp.min(y0, y1) - t
    if p <= REAL(0.0):
        return REAL(0.0)
    if q >= REAL(0.0):
        return REAL(0.5) * (p + q)
    return REAL(0.5) * p * p / (p - q)


@wp.func
def range_on(faces: Faces, f: int, a: wp.float64, e: wp.float64) -> wp.float64:
    return faces.plane[f, 0] + faces.plane[f, 1] * a + faces.plane[f, 2] * e


@wp.func
def inside_row(
    faces: Faces,
    f: int,
    s0: wp.float64,
    s1: wp.float64,
    low0: wp.float64,
    low1: wp.float64,
    high0: wp.float64,
    high1: wp.float64,
    row: wp.float64,
    range_start: wp.float64,
    range_spacing: wp.float64,
) -> wp.vec2d:
    """About the middle (azimuth, elevation) of what a row cuts out of a trapezoid: the mean over `LINES` lines."""
    weight = REAL(0.0)
    azimuth = REAL(0.0)
    place = REAL(0.0)
    for i in range(LINES):
        t = REAL(i) / REAL(LINES - 1)
        begin = wp.max(low0 + (low1 - low0) * t, row)
        end = wp.min(high0 + (high1 - high0) * t, row + REAL(1.0))
        length = wp.max(end - begin, REAL(0.0)) + REAL(1.0e-300)
        weight += length
        azimuth += length * t
        place += length * REAL(0.5) * (begin + end)
    a = s0 + (s1 - s0) * azimuth / weight
    e = place / weight * range_spacing + range_start - faces.plane[f, 0] - faces.plane[f, 1] * a
    return wp.vec2d(a, e / faces.plane[f, 2])


@wp.func
def add_piece(
    faces: Faces,
    cells: Cells,
    rows: int,
    range_start: wp.float64,
    range_spacing: wp.float64,
    f: int,
    k: int,
    s0: wp.float64,
    s1: wp.float64,
    l0: wp.float64,
    l1: wp.float64,
    h0: wp.float64,
    h1: wp.float64,
):
    """Add a trapezoid of face f, candidate k: azimuth s0 to s1, elevation from l to h at either end."""
    area = REAL(0.5) * (s1 - s0) * ((h0 - l0) + (h1 - l1))
    if area > REAL(0.0):
        low0 = (range_on(faces, f, s0, l0) - range_start) / range_spacing
        low1 = (range_on(faces, f, s1, l1) - range_start) / range_spacing
        high0 = (range_on(faces, f, s0, h0) - range_start) / range_spacing
        high1 = (range_on(faces, f, s1, h1) - range_start) / range_spacing
        slope = faces.plane[f, 2] / range_spacing
        if slope < REAL(0.0):
            swap0 = low0
            swap1 = low1
            low0 = high0
            low1 = high1
            high0 = swap0
            high1 = swap1
        least = wp.min(low0, low1)
        most = wp.max(high0, high1)
        first = wp.max(int(wp.floor(wp.max(least, REAL(-1.0)))), 0)
        last = wp.min(int(wp.floor(wp.min(most, REAL(rows)))), rows - 1)
        flat = wp.max(high0 - low0, high1 - low1) < FLAT
        middle = REAL(0.5) * (s0 + s1)
        for row in range(first, last + 1):
            upper = REAL(row)
            lower = REAL(row + 1)
            share = REAL(0.0)
            if flat:
                # constant in range along elevation: rows share it by azimuth
                if most - least < FLAT:
                    share = wp.where(row == int(wp.floor(REAL(0.5) * (least + most))), area, REAL(0.0))
                else:
                    share = area * (wp.min(most, lower) - wp.max(least, upper)) / (most - least)
            else:
                share = (above(high0, high1, upper) - above(high0, high1, lower)) - (
                    above(low0, low1, upper) - above(low0, low1, lower)
                )
                share = share * (s1 - s0) / wp.abs(slope)
            if share > REAL(0.0):
                place = wp.vec2d(middle, REAL(0.25) * (l0 + l1 + h0 + h1))
                if not flat:
                    place = inside_row(faces, f, s0, s1, low0, low1, high0, high1, upper, range_start, range_spacing)
                cell = cells.start[k] + row - cells.first_row[k]
                cells.area[cell] = cells.area[cell] + share
                cells.azimuth[cell] = cells.azimuth[cell] + share * place[0]
                cells.elevation[cell] = cells.elevation[cell] + share * place[1]


@wp.func
def side_of(faces: Faces, f: int, middle: wp.float64, s: wp.float64, long_side: bool) -> wp.float64:
    """Elevation at azimuth s of the side from the first to the last corner, or of the other one over `middle`."""
    i = int(0)
    j = int(2)
    if not long_side:
        if middle < faces.azimuth[f, 1]:
            j = 1
        else:
            i = 1
    return between(faces.azimuth[f, i], faces.elevation[f, i], faces.azimuth[f, j], faces.elevation[f, j], s)


@wp.func
def gathered(
    faces: Faces, candidates: wp.array(dtype=int), begin: int, end: int, s0: wp.float64, s1: wp.float64, room: Stretches
) -> int:
    """The faces that cross the slab, into `room` from `begin` on; how many."""
    middle = REAL(0.5) * (s0 + s1)
    n = int(0)
    for k in range(begin, end):
        f = candidates[k]
        if faces.azimuth[f, 0] < middle and faces.azimuth[f, 2] > middle:
            a0 = side_of(faces, f, middle, s0, True)
            a1 = side_of(faces, f, middle, s1, True)
            b0 = side_of(faces, f, middle, s0, False)
            b1 = side_of(faces, f, middle, s1, False)
            at = begin + n
            room.face[at] = f
            room.place[at] = k
            first = a0 + a1 <= b0 + b1
            room.low_start[at] = wp.where(first, a0, b0)
            room.low_end[at] = wp.where(first, a1, b1)
            room.high_start[at] = wp.where(first, b0, a0)
            room.high_end[at] = wp.where(first, b1, a1)
            low = room.low_start[at] + room.low_end[at]
            free = at
            while free > begin and room.low_start[room.order[free - 1]] + room.low_end[room.order[free - 1]] > low:
                room.order[free] = room.order[free - 1]
                free -= 1
            room.order[free] = at
            n += 1
    return n


@wp.func
def keep_piece(
    pieces: Pieces,
    at: int,
    face: int,
    column: int,
    s0: wp.float64,
    s1: wp.float64,
    l0: wp.float64,
    l1: wp.float64,
    h0: wp.float64,
    h1: wp.float64,
):
    pieces.face[at] = face
    pieces.column[at] = column
    pieces.start[at] = s0
    pieces.end[at] = s1
    pieces.low[at, 0] = l0
    pieces.low[at, 1] = l1
    pieces.high[at, 0] = h0
    pieces.high[at, 1] = h1


# Long because it is one sweep: what ends a visible stretch is looked for among all others.
@wp.kernel(enable_backward=False)
def coverage_kernel(
    # In:
    faces: Faces,
    candidates: wp.array(dtype=int),
    first_candidate: wp.array(dtype=int),
    events: wp.array(dtype=wp.float64),
    first_event: wp.array(dtype=int),
    rows: int,
    range_start: wp.float64,
    range_spacing: wp.float64,
    room: Stretches,
    # Out:
    cells: Cells,
    pieces: Pieces,
):
    """One thread takes a column of pixels: slab by slab, from the least elevation to the largest.

    The adjoint needs the `pieces` (`coverage_adjoint`); an image alone gives them no arrays.
    """
    column = wp.tid()
    keeps = pieces.count.shape[0] > 0
    seen = int(0)
    begin = first_candidate[column]
    for event in range(first_event[column], first_event[column + 1] - 1):
        s0 = events[event]
        s1 = events[event + 1]
        n = int(0)
        if s1 - s0 > NEAR:
            n = gathered(faces, candidates, begin, first_candidate[column + 1], s0, s1, room)
        middle = REAL(0.5) * (s0 + s1)
        here0 = REAL(-1.0e300)
        here1 = REAL(-1.0e300)
        here_by = wp.vec2i(NONE, NONE)
        going = n > 0
        first = begin  # of the order: all before end below `here`
        while going:
            here = REAL(0.5) * (here0 + here1) + NEAR
            front = int(-1)
            nearest = REAL(1.0e300)
            next0 = REAL(1.0e300)
            next1 = REAL(1.0e300)
            next_by = wp.vec2i(NONE, NONE)
            at = first
            while at < begin + n:
                i = room.order[at]
                low = REAL(0.5) * (room.low_start[i] + room.low_end[i])
                if low > here:
                    next0 = room.low_start[i]
                    next1 = room.low_end[i]
                    next_by = wp.vec2i(room.face[i], LOW)
                    at = begin + n
                elif REAL(0.5) * (room.high_start[i] + room.high_end[i]) > here:
                    r = range_on(faces, room.face[i], middle, here)
                    if r < nearest:
                        nearest = r
                        front = i
                elif at == first:
                    first += 1
                at += 1
            if front >= 0:
                f = room.face[front]
                next0 = room.high_start[front]
                next1 = room.high_end[front]
                next_by = wp.vec2i(f, HIGH)
                at = first
                while at < begin + n:
                    i = room.order[at]
                    next = REAL(0.5) * (next0 + next1)
                    low = REAL(0.5) * (room.low_start[i] + room.low_end[i])
                    high = REAL(0.5) * (room.high_start[i] + room.high_end[i])
                    at += 1
                    if low >= next:
                        at = begin + n
                    elif i != front and high > here:
                        g = room.face[i]
                        e1 = wp.max(low, here)
                        e2 = wp.min(high, next)
                        d1 = range_on(faces, g, middle, e1) - range_on(faces, f, middle, e1)
                        d2 = range_on(faces, g, middle, e2) - range_on(faces, f, middle, e2)
                        if low > here and d1 < -TOUCH:
                            next0 = room.low_start[i]
                            next1 = room.low_end[i]
                            next_by = wp.vec2i(g, LOW)
                        elif d2 < -TOUCH:
                            e = e1 + (e2 - e1) * wp.max(d1, REAL(0.0)) / (wp.max(d1, REAL(0.0)) - d2)
                            per_e = faces.plane[g, 2] - faces.plane[f, 2]
                            c0 = faces.plane[g, 0] - faces.plane[f, 0]
                            c1 = faces.plane[g, 1] - faces.plane[f, 1]
                            next_by = wp.vec2i(f, g)
                            if wp.abs(per_e) * (s1 - s0) > REAL(0.0):
                                next0 = -(c0 + c1 * s0) / per_e
                                next1 = -(c0 + c1 * s1) / per_e
                            if wp.abs(REAL(0.5) * (next0 + next1) - e) > REAL(10.0) * TOUCH:
                                next0 = e
                                next1 = e
                                next_by = wp.vec2i(NONE, NONE)
                l0 = here0
                l1 = here1
                add_piece(
                    faces, cells, rows, range_start, range_spacing, f, room.place[front], s0, s1, l0, l1, next0, next1
                )
                if keeps and next0 - l0 + next1 - l1 > REAL(0.0):
                    if pieces.face.shape[0] > 0:
                        keep_piece(pieces, pieces.first[column] + seen, f, column, s0, s1, l0, l1, next0, next1)
                        for end in range(2):
                            pieces.low_by[pieces.first[column] + seen, end] = here_by[end]
                            pieces.high_by[pieces.first[column] + seen, end] = next_by[end]
                    seen += 1
            going = next0 < REAL(1.0e299)
            if going and REAL(0.5) * (next0 + next1) <= here:
                next0 = here0 + NEAR
                next1 = here1 + NEAR
                next_by = here_by
            here0 = next0
            here1 = next1
            here_by = next_by
    if keeps:
        pieces.count[column] = seen


@wp.kernel(enable_backward=False)
def facet_kernel(
    # In:
    grid: RayGrid,
    point: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    # Out:
    cos_incidence_out: wp.array(dtype=float),
    cos_twist_out: wp.array(dtype=float),
    cos2_azimuth_out: wp.array(dtype=float),
):
    """How facets with these normals are turned to the radar."""
    i = wp.tid()
    direction = look_direction(grid, point[i])
    cos_incidence_out[i] = cos_incidence_of(normal[i], direction)
    cos_twist_out[i] = cos_twist_of(normal[i], direction, grid.u)
    cos2_azimuth_out[i] = cos2_azimuth_of(normal[i], direction)


@wp.kernel(enable_backward=False)
def lit_point_kernel(
    # In:
    grid: RayGrid,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    face: wp.array(dtype=int),
    barycentric: wp.array(dtype=wp.vec2),
    # Out:
    point_out: wp.array(dtype=wp.vec3),
    cos_incidence_out: wp.array(dtype=float),
    cos_twist_out: wp.array(dtype=float),
    cos2_azimuth_out: wp.array(dtype=float),
):
    """Where a hit lies, and how its facet is turned to the radar."""
    i = wp.tid()
    f = face[i]
    p0 = vertices[faces[f, 0]]
    p1 = vertices[faces[f, 1]]
    p2 = vertices[faces[f, 2]]
    point = point_on(p0, p1, p2, barycentric[i][0], barycentric[i][1])
    normal = normal_of(p0, p1, p2)
    direction = look_direction(grid, point)
    point_out[i] = point
    cos_incidence_out[i] = cos_incidence_of(normal, direction)
    cos_twist_out[i] = cos_twist_of(normal, direction, grid.u)
    cos2_azimuth_out[i] = cos2_azimuth_of(normal, direction)
