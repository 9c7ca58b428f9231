"""The adjoint of exact coverage: how a sum over the image changes as the faces' corners move.

Over azimuth a and elevation e the sum is an integral of `worth` over the visible pieces. It changes where their borders
move: sides of faces, lines where two faces meet, and borders of rows, which move over a face as its range changes.
Borders of slabs and columns stay (Reynolds' transport theorem, piece by piece). A side along elevation would jump from
one slab to the next; callers turn the view by a hair, so that there is none.
"""

import warp as wp

from warpsar.kernels.coverage import LOW, NONE, REAL, Faces, Pieces, Rows, range_on, row_on, side_of

CONTACT = wp.constant(wp.float64(1.0e-7))  # [m] in range: an edge nearer than this to a surface stands on it
PARALLEL = wp.constant(wp.float64(1.0e-9))  # slope between two planes: less has no line where they meet


@wp.struct
class Worth:
    """What a square metre of a face counts in a pixel: the sum of `image` (k, rows, cols) times `power` (k, faces)."""

    image: wp.array3d(dtype=wp.float64)
    power: wp.array2d(dtype=wp.float64)
    first_column: int


@wp.struct
class CoverageSlopes:
    """Derivatives of the sum: to the `corners` by ascending azimuth, (faces, 6), azimuth before elevation, and to
    `plane`, (faces, 3)."""

    corners: wp.array2d(dtype=wp.float64)
    plane: wp.array2d(dtype=wp.float64)


@wp.struct
class Border:
    """A border of a piece: azimuth s0 to s1, elevation e0 to e1 [m]."""

    s0: wp.float64
    s1: wp.float64
    e0: wp.float64
    e1: wp.float64


@wp.func
def border_of(s0: wp.float64, s1: wp.float64, e0: wp.float64, e1: wp.float64) -> Border:
    border = Border()
    border.s0 = s0
    border.s1 = s1
    border.e0 = e0
    border.e1 = e1
    return border


@wp.func
def worth_of(worth: Worth, f: int, row: int, column: int) -> wp.float64:
    found = REAL(0.0)
    if row >= 0 and row < worth.image.shape[1]:
        for k in range(worth.image.shape[0]):
            found += worth.image[k, row, worth.first_column + column] * worth.power[k, f]
    return found


@wp.func
def along_border(worth: Worth, f: int, column: int, x0: wp.float64, x1: wp.float64) -> wp.vec2d:
    """Integrals of worth (1 - t) and worth t over t from 0 to 1, where the row goes evenly from x0 to x1."""
    total = wp.vec2d(REAL(0.0), REAL(0.0))
    first = int(wp.floor(wp.max(wp.min(x0, x1), REAL(-1.0))))
    last = int(wp.floor(wp.min(wp.max(x0, x1), REAL(worth.image.shape[1]))))
    for row in range(first, last + 1):
        t0 = REAL(0.0)
        t1 = REAL(1.0)
        if wp.abs(x1 - x0) > REAL(1.0e-12):
            p = (REAL(row) - x0) / (x1 - x0)
            q = (REAL(row + 1) - x0) / (x1 - x0)
            t0 = wp.clamp(wp.min(p, q), REAL(0.0), REAL(1.0))
            t1 = wp.clamp(wp.max(p, q), REAL(0.0), REAL(1.0))
        here = worth_of(worth, f, row, column)
        later = REAL(0.5) * (t1 * t1 - t0 * t0)
        total += wp.vec2d(here * (t1 - t0 - later), here * later)
    return total


@wp.func
def corners_of(faces: Faces, f: int, side: int, s0: wp.float64, s1: wp.float64) -> wp.vec2i:
    """Which two corners of a face, by azimuth, end its LOW or HIGH side over a slab."""
    middle = REAL(0.5) * (s0 + s1)
    far = side_of(faces, f, middle, s0, True) + side_of(faces, f, middle, s1, True)
    near = side_of(faces, f, middle, s0, False) + side_of(faces, f, middle, s1, False)
    if (far <= near) == (side == LOW):
        return wp.vec2i(0, 2)
    if middle < faces.azimuth[f, 1]:
        return wp.vec2i(0, 1)
    return wp.vec2i(1, 2)


@wp.func
def to_side(faces: Faces, f: int, i: int, j: int, border: Border, g: wp.vec2d, slopes: CoverageSlopes):
    """Add the derivatives of g0 e(s0) + g1 e(s1), where e is the elevation of a side from corner i to corner j."""
    width = faces.azimuth[f, j] - faces.azimuth[f, i]
    tilt = (faces.elevation[f, j] - faces.elevation[f, i]) / width
    t0 = (border.s0 - faces.azimuth[f, i]) / width
    t1 = (border.s1 - faces.azimuth[f, i]) / width
    to_j = g[0] * t0 + g[1] * t1
    to_i = g[0] + g[1] - to_j
    wp.atomic_add(slopes.corners, f, 2 * i, -tilt * to_i)
    wp.atomic_add(slopes.corners, f, 2 * i + 1, to_i)
    wp.atomic_add(slopes.corners, f, 2 * j, -tilt * to_j)
    wp.atomic_add(slopes.corners, f, 2 * j + 1, to_j)


@wp.func
def to_plane(f: int, g: wp.float64, ga: wp.float64, ge: wp.float64, slopes: CoverageSlopes):
    wp.atomic_add(slopes.plane, f, 0, g)
    wp.atomic_add(slopes.plane, f, 1, ga)
    wp.atomic_add(slopes.plane, f, 2, ge)


@wp.func
def to_meeting(faces: Faces, f: int, h: int, border: Border, g: wp.vec2d, slopes: CoverageSlopes):
    """Add the derivatives of g0 e(s0) + g1 e(s1), where e is the elevation at which the planes of f and h meet."""
    per_e = faces.plane[f, 2] - faces.plane[h, 2]
    if wp.abs(per_e) > PARALLEL:
        total = -(g[0] + g[1]) / per_e
        along = -(g[0] * border.s0 + g[1] * border.s1) / per_e
        across = -(g[0] * border.e0 + g[1] * border.e1) / per_e
        to_plane(f, total, along, across, slopes)
        to_plane(h, -total, -along, -across, slopes)


@wp.func
def stands_on(
    faces: Faces,
    corner_id: wp.array2d(dtype=int),
    f: int,
    i: int,
    j: int,
    other: int,
    s: wp.float64,
    e: wp.float64,
) -> bool:
    """Whether a side of face f, from corner i to j, lies on the face `other`, which does not end there itself."""
    shared = int(0)
    for k in range(3):
        if corner_id[other, k] == corner_id[f, i] or corner_id[other, k] == corner_id[f, j]:
            shared += 1
    apart = wp.abs(range_on(faces, f, s, e) - range_on(faces, other, s, e))
    tilted = wp.abs(faces.plane[f, 2] - faces.plane[other, 2]) > PARALLEL
    return shared < 2 and apart < CONTACT and tilted


@wp.func
def to_border(
    faces: Faces,
    corner_id: wp.array2d(dtype=int),
    by: wp.vec2i,
    across: int,
    border: Border,
    g: wp.vec2d,
    slopes: CoverageSlopes,
):
    """Add the derivatives of a border's elevations times g. `across` is the face beyond it, or NONE.

    An edge that stands on a surface opens a gap where it rises, and sinks in where it falls. Half of each is taken, as
    a central difference does.
    """
    f = by[0]
    if f != NONE:
        if by[1] >= 0:
            to_meeting(faces, f, by[1], border, g, slopes)
        else:
            ends = corners_of(faces, f, by[1], border.s0, border.s1)
            share = REAL(1.0)
            if across != NONE:
                s = REAL(0.5) * (border.s0 + border.s1)
                e = REAL(0.5) * (border.e0 + border.e1)
                if stands_on(faces, corner_id, f, ends[0], ends[1], across, s, e):
                    share = REAL(0.5)
                    to_meeting(faces, f, across, border, share * g, slopes)
            to_side(faces, f, ends[0], ends[1], border, share * g, slopes)


@wp.func
def across_border(pieces: Pieces, i: int, j: int, f: int, upward: bool) -> int:
    """The face on the other side of a border of piece i that belongs to f: that of piece j, where the two meet."""
    mine = pieces.face[i]
    if f != mine:
        return mine
    if j < 0 or j >= pieces.face.shape[0]:
        return NONE
    if pieces.column[j] != pieces.column[i] or pieces.start[j] != pieces.start[i]:
        return NONE
    if upward and pieces.low[j] == pieces.high[i]:
        return pieces.face[j]
    if not upward and pieces.high[j] == pieces.low[i]:
        return pieces.face[j]
    return NONE


@wp.kernel(enable_backward=False)
def coverage_adjoint_kernel(
    # In:
    faces: Faces,
    corner_id: wp.array2d(dtype=int),
    pieces: Pieces,
    worth: Worth,
    rows: Rows,
    # Out:
    slopes_out: CoverageSlopes,
):
    """One thread takes a piece: its two borders, and the rows' borders inside."""
    i = wp.tid()
    f = pieces.face[i]
    column = pieces.column[i]
    s0 = pieces.start[i]
    s1 = pieces.end[i]
    width = s1 - s0
    l0 = pieces.low[i][0]
    l1 = pieces.low[i][1]
    h0 = pieces.high[i][0]
    h1 = pieces.high[i][1]
    low0 = row_on(faces, rows, f, s0, l0)
    low1 = row_on(faces, rows, f, s1, l1)
    high0 = row_on(faces, rows, f, s0, h0)
    high1 = row_on(faces, rows, f, s1, h1)

    by = pieces.high_by[i]
    across = across_border(pieces, i, i + 1, by[0], True)
    change = width * along_border(worth, f, column, high0, high1)
    to_border(faces, corner_id, by, across, border_of(s0, s1, h0, h1), change, slopes_out)
    by = pieces.low_by[i]
    across = across_border(pieces, i, i - 1, by[0], False)
    change = -width * along_border(worth, f, column, low0, low1)
    to_border(faces, corner_id, by, across, border_of(s0, s1, l0, l1), change, slopes_out)

    per_e = faces.plane[f, 2]
    if wp.abs(per_e) > REAL(1.0e-12):
        if per_e < REAL(0.0):
            swap0 = low0
            swap1 = low1
            low0 = high0
            low1 = high1
            high0 = swap0
            high1 = swap1
        first = wp.max(int(wp.floor(wp.max(wp.min(low0, low1), REAL(-1.0)))) + 1, 0)
        last = wp.min(int(wp.floor(wp.min(wp.max(high0, high1), REAL(rows.count + 1)))), rows.count)
        for row in range(first, last + 1):
            # where low < row < high: an interval of t, because both go evenly
            t0 = REAL(0.0)
            t1 = REAL(1.0)
            for side in range(2):
                y0 = wp.where(side == 0, REAL(row) - low0, high0 - REAL(row))
                y1 = wp.where(side == 0, REAL(row) - low1, high1 - REAL(row))
                if y0 < REAL(0.0) and y1 < REAL(0.0):
                    t1 = REAL(0.0)
                elif y0 < REAL(0.0):
                    t0 = wp.max(t0, y0 / (y0 - y1))
                elif y1 < REAL(0.0):
                    t1 = wp.min(t1, y0 / (y0 - y1))
            if t1 > t0:
                step = worth_of(worth, f, row, column) - worth_of(worth, f, row - 1, column)
                g = step * width * (t1 - t0) / wp.abs(per_e)
                s = s0 + width * REAL(0.5) * (t0 + t1)
                e = (rows.start + REAL(row) * rows.spacing - faces.plane[f, 0] - faces.plane[f, 1] * s) / per_e
                to_plane(f, g, g * s, g * e, slopes_out)
