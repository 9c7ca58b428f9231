"""Exact coverage: which area of each visible face lies in each pixel, without rays.

Seen across the look direction a face is a triangle in (azimuth a, elevation e), and its slant range is a plane over
(a, e). A column of pixels is cut into slabs of azimuth, at every vertex and wherever an outline crosses an edge. Inside
a slab the order of the edges does not change. Each visible stretch of a face is then a trapezoid with straight sides,
whose area in every row of the image has a closed form.
"""

import warp as wp

from warpsar.kernels.geometry import (
    RayGrid,
    Triangles,
    cos2_azimuth_of,
    cos_incidence_of,
    cos_twist_of,
    look_direction,
    normal_of,
    point_on,
)
from warpsar.kernels.trace import HitArrays

REAL = wp.float64
NEAR = wp.constant(wp.float64(1.0e-9))  # [m]: stretches and slabs shorter than this are nothing
TOUCH = wp.constant(wp.float64(1.0e-8))  # [m] in range: surfaces nearer than this touch
LINES = wp.constant(5)  # that the middle of a piece is taken over
FLAT = wp.constant(wp.float64(1.0e-6))  # rows: a stretch with less extent in range lies in one


@wp.struct
class CoverageEdges:
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
class Rows:
    """The image's rows: how many, and where in range they start [m]."""

    count: int
    start: wp.float64
    spacing: wp.float64


@wp.struct
class Columns:
    """What each column of pixels meets, one column after the other, in each of its bands of elevation.

    Band b of column c is element j = c * bands + b. It has the `candidates` (faces) from `first_candidate` [j] to
    [j + 1], and the borders of its slabs (`events`, azimuths [m]) from `first_event` [j] to [j + 1]. It reaches from
    `limits` [b] to [b + 1], elevations [m].
    """

    candidates: wp.array(dtype=int)
    first_candidate: wp.array(dtype=int)
    events: wp.array(dtype=wp.float64)
    first_event: wp.array(dtype=int)
    limits: wp.array(dtype=wp.float64)


@wp.struct
class EdgesInColumns:
    """The edges that reach into each band of a column, as in `Columns`: outlines, and `others`, which an outline may
    pass.

    `border`, (columns + 1,), are the columns' own borders [m]; each has `bands`.
    """

    outlines: wp.array(dtype=int)
    first_outline: wp.array(dtype=int)
    others: wp.array(dtype=int)
    first_other: wp.array(dtype=int)
    border: wp.array(dtype=wp.float64)
    bands: int


@wp.struct
class Trapezoid:
    """A visible stretch of a face in a slab: azimuth s0 to s1, and elevation from l to h at either end [m]."""

    s0: wp.float64
    s1: wp.float64
    l0: wp.float64
    l1: wp.float64
    h0: wp.float64
    h1: wp.float64


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
class CandidateCells:
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

    `low` and `high` are their elevations there [m]. `low_by` and `high_by` say what the borders are:
    a side of a face (face, LOW or HIGH), the line where two faces meet (face, face), or NONE. `first`, (columns,), is
    where each column's pieces begin; `count`, (columns,), how many it has. Without room they are only counted.
    """

    face: wp.array(dtype=int)
    column: wp.array(dtype=int)
    start: wp.array(dtype=wp.float64)
    end: wp.array(dtype=wp.float64)
    low: wp.array(dtype=wp.vec2d)
    high: wp.array(dtype=wp.vec2d)
    low_by: wp.array(dtype=wp.vec2i)
    high_by: wp.array(dtype=wp.vec2i)
    first: wp.array(dtype=int)
    count: wp.array(dtype=int)


@wp.func
def between(x0: wp.float64, y0: wp.float64, x1: wp.float64, y1: wp.float64, x: wp.float64) -> wp.float64:
    """y at x on a line; the same number for whichever face asks for the edge."""
    return y0 + (y1 - y0) * ((x - x0) / (x1 - x0))


@wp.kernel(enable_backward=False)
def crossing_kernel(
    # In:
    edges: CoverageEdges,
    columns: EdgesInColumns,
    first: wp.array(dtype=int),  # where each column's azimuths begin
    # Out:
    count_out: wp.array(dtype=int),
    azimuth_out: wp.array(dtype=wp.float64),
):
    """Azimuths in each band of a column at which an outline passes in front of another edge.

    Without room in `azimuth_out` they are only counted.
    """
    column = wp.tid()
    begin = columns.border[column // columns.bands]
    end = columns.border[column // columns.bands + 1]
    found = int(0)
    for i in range(columns.first_outline[column], columns.first_outline[column + 1]):
        p = columns.outlines[i]
        for j in range(columns.first_other[column], columns.first_other[column + 1]):
            q = columns.others[j]
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
                            azimuth_out[first[column] + found] = x
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
    faces: Faces, rows: Rows, f: int, row: wp.float64, piece: Trapezoid, low: wp.vec2d, high: wp.vec2d
) -> wp.vec2d:
    """About the middle (azimuth, elevation) of what a row cuts out of a trapezoid: the mean over `LINES` lines.

    `low` and `high`: the rows of its borders at either end.
    """
    weight = REAL(0.0)
    azimuth = REAL(0.0)
    place = REAL(0.0)
    for i in range(LINES):
        t = REAL(i) / REAL(LINES - 1)
        begin = wp.max(low[0] + (low[1] - low[0]) * t, row)
        end = wp.min(high[0] + (high[1] - high[0]) * t, row + REAL(1.0))
        length = wp.max(end - begin, REAL(0.0)) + REAL(1.0e-300)
        weight += length
        azimuth += length * t
        place += length * REAL(0.5) * (begin + end)
    a = piece.s0 + (piece.s1 - piece.s0) * azimuth / weight
    e = place / weight * rows.spacing + rows.start - faces.plane[f, 0] - faces.plane[f, 1] * a
    return wp.vec2d(a, e / faces.plane[f, 2])


@wp.func
def row_on(faces: Faces, rows: Rows, f: int, a: wp.float64, e: wp.float64) -> wp.float64:
    """Where in the rows a place on a face lies."""
    return (range_on(faces, f, a, e) - rows.start) / rows.spacing


@wp.func
def add_piece(faces: Faces, rows: Rows, f: int, k: int, piece: Trapezoid, cells: CandidateCells):
    """Add a trapezoid of face f, candidate k."""
    s0 = piece.s0
    s1 = piece.s1
    area = REAL(0.5) * (s1 - s0) * ((piece.h0 - piece.l0) + (piece.h1 - piece.l1))
    if area > REAL(0.0):
        low0 = row_on(faces, rows, f, s0, piece.l0)
        low1 = row_on(faces, rows, f, s1, piece.l1)
        high0 = row_on(faces, rows, f, s0, piece.h0)
        high1 = row_on(faces, rows, f, s1, piece.h1)
        slope = faces.plane[f, 2] / rows.spacing
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
        last = wp.min(int(wp.floor(wp.min(most, REAL(rows.count)))), rows.count - 1)
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
                place = wp.vec2d(middle, REAL(0.25) * (piece.l0 + piece.l1 + piece.h0 + piece.h1))
                if not flat:
                    place = inside_row(faces, rows, f, upper, piece, wp.vec2d(low0, low1), wp.vec2d(high0, high1))
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
def gathered(faces: Faces, columns: Columns, column: int, s0: wp.float64, s1: wp.float64, room: Stretches) -> int:
    """The faces that cross the slab, into `room` from the column's first candidate on; how many.

    Their borders end at the band's limits. A side that passes a limit has an event there, so it stays straight.
    """
    middle = REAL(0.5) * (s0 + s1)
    begin = columns.first_candidate[column]
    band = column % (columns.limits.shape[0] - 1)
    least = columns.limits[band]
    most = columns.limits[band + 1]
    n = int(0)
    for k in range(begin, columns.first_candidate[column + 1]):
        f = columns.candidates[k]
        if faces.azimuth[f, 0] < middle and faces.azimuth[f, 2] > middle:
            a0 = side_of(faces, f, middle, s0, True)
            a1 = side_of(faces, f, middle, s1, True)
            b0 = side_of(faces, f, middle, s0, False)
            b1 = side_of(faces, f, middle, s1, False)
            first = a0 + a1 <= b0 + b1
            low0 = wp.where(first, a0, b0)
            low1 = wp.where(first, a1, b1)
            high0 = wp.where(first, b0, a0)
            high1 = wp.where(first, b1, a1)
            if low0 + low1 >= REAL(2.0) * most or high0 + high1 <= REAL(2.0) * least:
                continue
            at = begin + n
            room.face[at] = f
            room.place[at] = k
            room.low_start[at] = wp.max(low0, least)
            room.low_end[at] = wp.max(low1, least)
            room.high_start[at] = wp.min(high0, most)
            room.high_end[at] = wp.min(high1, most)
            low = room.low_start[at] + room.low_end[at]
            free = at
            while free > begin and room.low_start[room.order[free - 1]] + room.low_end[room.order[free - 1]] > low:
                room.order[free] = room.order[free - 1]
                free -= 1
            room.order[free] = at
            n += 1
    return n


@wp.func
def keep_piece(face: int, column: int, piece: Trapezoid, low_by: wp.vec2i, high_by: wp.vec2i, at: int, pieces: Pieces):
    pieces.low_by[at] = low_by
    pieces.high_by[at] = high_by
    pieces.face[at] = face
    pieces.column[at] = column
    pieces.start[at] = piece.s0
    pieces.end[at] = piece.s1
    pieces.low[at] = wp.vec2d(piece.l0, piece.l1)
    pieces.high[at] = wp.vec2d(piece.h0, piece.h1)


# Long because it is one sweep: what ends a visible stretch is looked for among all others.
@wp.kernel(enable_backward=False)
def coverage_kernel(
    # In:
    faces: Faces,
    columns: Columns,
    rows: Rows,
    # Room:
    room: Stretches,
    # Out:
    cells_out: CandidateCells,
    pieces_out: Pieces,
):
    """One thread takes a band of a column of pixels: slab by slab, from the least elevation to the largest.

    The adjoint needs the `pieces_out` (`coverage_adjoint`); an image alone gives them no arrays.
    """
    column = wp.tid()
    keeps = pieces_out.count.shape[0] > 0
    seen = int(0)
    begin = columns.first_candidate[column]
    for event in range(columns.first_event[column], columns.first_event[column + 1] - 1):
        s0 = columns.events[event]
        s1 = columns.events[event + 1]
        n = int(0)
        if s1 - s0 > NEAR:
            n = gathered(faces, columns, column, s0, s1, room)
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
                piece = Trapezoid()
                piece.s0 = s0
                piece.s1 = s1
                piece.l0 = here0
                piece.l1 = here1
                piece.h0 = next0
                piece.h1 = next1
                add_piece(faces, rows, f, room.place[front], piece, cells_out)
                if keeps and next0 - here0 + next1 - here1 > REAL(0.0):
                    if pieces_out.face.shape[0] > 0:
                        keep_piece(f, column, piece, here_by, next_by, pieces_out.first[column] + seen, pieces_out)
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
        pieces_out.count[column] = seen


@wp.func
def turn_to_radar(grid: RayGrid, normal: wp.vec3, hits: HitArrays, i: int):
    """The angles of hit i, whose facet has this normal."""
    direction = look_direction(grid, hits.point[i])
    hits.cos_incidence[i] = cos_incidence_of(normal, direction)
    hits.cos_twist[i] = cos_twist_of(normal, direction, grid.u)
    hits.cos2_azimuth[i] = cos2_azimuth_of(normal, direction)


@wp.kernel(enable_backward=False)
def facet_kernel(
    # In:
    grid: RayGrid,
    normal: wp.array(dtype=wp.vec3),
    # In and out:
    hits: HitArrays,
):
    """How facets with these normals, at the points of the hits, are turned to the radar."""
    i = wp.tid()
    turn_to_radar(grid, normal[i], hits, i)


@wp.kernel(enable_backward=False)
def lit_point_kernel(
    # In:
    grid: RayGrid,
    mesh: Triangles,
    # In and out:
    hits: HitArrays,
):
    """From their faces and weights to where hits lie, and how their facets are turned to the radar."""
    i = wp.tid()
    f = hits.face[i]
    p0 = mesh.vertices[mesh.faces[f, 0]]
    p1 = mesh.vertices[mesh.faces[f, 1]]
    p2 = mesh.vertices[mesh.faces[f, 2]]
    hits.point[i] = point_on(p0, p1, p2, hits.barycentric[i][0], hits.barycentric[i][1])
    turn_to_radar(grid, normal_of(p0, p1, p2), hits, i)
