"""Fields of ray tubes that end at the radar, and their sums over resolution cells.

A tube of area A on its last surface sends the radar (k / 4 pi) A exp(-2jkr) times what a unit of area answers, r being
half the way: physical optics, as in `kernels/coherent/radiate.py`. The cells are the samples of a complex image: sample
n has the weight h(x - n) on a field at x, in cells of the band and of the aperture. h is the response, sinc where these
have no taper. Over all samples the squares of these weights add up to 1, wherever x is, and those of a long field to
the mean of its pattern over band and aperture, by the squares of their tapers (Parseval).
"""

import warp as wp

from warpsar.kernels.coherent.numbers import product, sinc, turned
from warpsar.kernels.coherent.radiate import FOUR_PI
from warpsar.kernels.effects.multibounce import PathRecords, faces_met, spread_over
from warpsar.kernels.geometry import RayGrid, Triangles

HALF = wp.constant(wp.float64(0.5))
TWO = wp.constant(wp.float64(2.0))
ONE = wp.constant(wp.float64(1.0))
ZERO = wp.constant(wp.float64(0.0))
STEP = wp.constant(wp.float64(1.0e-3))
"""Of a phase [rad], for slopes of fields."""
STEPS = wp.constant(128)
"""Of a cell, in the table of the response."""
REACH = wp.constant(16)
"""Cells on each side that the table has."""
NEAR = wp.constant(12)
"""Samples on each side of a field that may get a share of it."""
EVEN = wp.constant(32)
"""Places in a cell along each axis in the table of what makes all shares' squares add up to 1."""
LONG = wp.constant(wp.float64(0.3))
"""Cells that a tube may have along a side, and more than it has across the line of sight by 16 rays per cell: beyond it
the response along a tube is told by its ends."""

WHOLE = wp.constant(1.0)
FADED = wp.constant(4.0)
"""Products of the distances in range and azimuth [cells] between which the response fades to nothing."""

along_an_axis = wp.types.vector(length=2 * int(NEAR), dtype=wp.float64)
"""Numbers of the samples about one, from `1 - NEAR` to `NEAR`."""


@wp.struct
class ResolutionCells:
    """Cells of `size` (range, azimuth) [m] about the reference point, and the bins of the records among them.

    `offset`: the samples about a bin that get a share of a field in it. `response`: (2, 2 REACH STEPS + 1), of range
    and azimuth, each with its derivatives [1/cells, 1/cells^2]. `even`: (EVEN + 1, EVEN + 1), the factor by which the
    shares of a field at a place in a cell, from edge to edge, get squares of sum 1.
    """

    size: wp.vec2d
    bin_start: wp.vec2d  # [m]
    bin_size: wp.vec2d  # [m]
    bin_cols: int
    offset: wp.array(dtype=wp.vec2i)
    response: wp.array2d(dtype=wp.vec3d)
    even: wp.array2d(dtype=wp.float64)


@wp.struct
class TubeFields:
    """Fields of tubes, shape (n,): `place` x (range, azimuth) [cells] of the middle, and `field` [m].

    `side_u`, `side_v`: by how much the place changes from end to end along both sides of a tube [cells]. `by_u`, `by_v`
    and `by_uu`, `by_vv` [m]: first and second moments of the field over it, from -1/2 to 1/2 along these sides. `size`
    [m]: what the field would be if it had one phase in the whole tube.
    """

    place: wp.array(dtype=wp.vec2d)
    side_u: wp.array(dtype=wp.vec2d)
    side_v: wp.array(dtype=wp.vec2d)
    size: wp.array(dtype=wp.float64)
    field: wp.array(dtype=wp.vec2d)
    by_u: wp.array(dtype=wp.vec2d)
    by_v: wp.array(dtype=wp.vec2d)
    by_uu: wp.array(dtype=wp.vec2d)
    by_vv: wp.array(dtype=wp.vec2d)


@wp.struct
class LineOfSight:
    """Range of a point about the reference point [m], and the direction of the ray to it."""

    distance: wp.float64
    direction: wp.vec3d


@wp.func
def sight_of(point: wp.vec3d, d: wp.vec3d, v: wp.vec3d, slant_range: wp.float64) -> LineOfSight:
    """As `slant_range_of` and `look_direction` of kernels/geometry.py, in double precision."""
    along = wp.dot(point, d)
    found = LineOfSight()
    found.distance = along
    found.direction = d
    if slant_range > wp.float64(0.0):
        across = wp.dot(point, v)
        r = wp.sqrt((slant_range + along) * (slant_range + along) + across * across)
        found.distance = (TWO * slant_range * along + along * along + across * across) / (r + slant_range)
        found.direction = wp.normalize((slant_range + along) * d + across * v)
    return found


@wp.func
def tilted(a: wp.float64) -> wp.float64:
    """(sin a - a cos a) / (2 a^2): the first moment of a field whose phase turns by 2 a over a tube, over j."""
    if wp.abs(a) < wp.float64(1.0e-3):
        return a / wp.float64(6.0)
    return (wp.sin(a) - a * wp.cos(a)) / (TWO * a * a)


@wp.func
def curved(a: wp.float64) -> wp.float64:
    """Integral of s^2 cos(2 a s) over s from -1/2 to 1/2: the second moment of a field whose phase turns by 2 a."""
    if wp.abs(a) < wp.float64(1.0e-2):
        return ONE / wp.float64(12.0) - a * a / wp.float64(40.0)
    return wp.sin(a) / (wp.float64(4.0) * a) + (a * wp.cos(a) - wp.sin(a)) / (TWO * a * a * a)


@wp.func
def moment_of(behind: wp.vec2d, ahead: wp.vec2d) -> wp.vec2d:
    """A field's first moment, from its values at `STEP` less and more phase: its slope over 2j."""
    return (wp.float64(0.25) / STEP) * wp.vec2d(ahead[1] - behind[1], behind[0] - ahead[0])


@wp.func
def second_of(behind: wp.vec2d, middle: wp.vec2d, ahead: wp.vec2d) -> wp.vec2d:
    """A field's second moment, from such values: its curvature over -4."""
    return (wp.float64(-0.25) / (STEP * STEP)) * (ahead - TWO * middle + behind)


@wp.func
def slanted(along: wp.float64, across: wp.float64, begin: wp.float64, end: wp.float64) -> wp.vec2d:
    """Integral of exp(2j (along s + across t)) over t from -1/2 to 1/2, and s from -1/2 + begin t to 1/2 + end t."""
    first = sinc(across + along * begin)
    last = sinc(across + along * end)
    step = tilted(across + HALF * along * (begin + end)) * (begin - end)
    if wp.abs(along) > wp.float64(1.0e-4):
        step = HALF * (last - first) / along
    return wp.vec2d(HALF * (first + last) * sinc(along), -step * wp.cos(along))


@wp.func
def cell_of(cells: ResolutionCells, bin: int) -> wp.vec2i:
    """The sample below the middle of a bin (range, azimuth)."""
    row = bin / cells.bin_cols
    col = bin - row * cells.bin_cols
    along = cells.bin_start[0] + (wp.float64(row) + HALF) * cells.bin_size[0]
    across = cells.bin_start[1] + (wp.float64(col) + HALF) * cells.bin_size[1]
    return wp.vec2i(int(wp.floor(along / cells.size[0])), int(wp.floor(across / cells.size[1])))


@wp.func
def footprint(side: wp.vec3d, normal: wp.vec3d, direction: wp.vec3d) -> wp.vec3d:
    """The side of a tube on a face."""
    return side - (wp.dot(normal, side) / wp.dot(normal, direction)) * direction


@wp.func
def read(table: wp.array2d(dtype=wp.vec3d), axis: int, distance: wp.float64) -> wp.vec3d:
    """The response at a distance [cells], and its derivatives; 0 beyond the table."""
    at = (distance + wp.float64(REACH)) * wp.float64(STEPS)
    # asked before it becomes a whole number: what a number that is too large becomes depends on the device
    if not (at >= ZERO and at < wp.float64(table.shape[1] - 1)):
        return wp.vec3d()
    low = int(wp.floor(at))
    part = at - wp.float64(low)
    return (ONE - part) * table[axis, low] + part * table[axis, low + 1]


@wp.func
def faded(x: wp.float64, y: wp.float64) -> wp.vec3d:
    """What is left of the response at distances x, y [cells], and its slopes along both. Where it ended with a step,
    fields that cancel would leave a power there that no body sends."""
    product_of = wp.abs(x * y)
    if product_of <= wp.float64(WHOLE):
        return wp.vec3d(ONE, ZERO, ZERO)
    if product_of >= wp.float64(FADED):
        return wp.vec3d()
    width = wp.float64(FADED) - wp.float64(WHOLE)
    part = (wp.float64(FADED) - product_of) / width
    slope = wp.float64(-6.0) * part * (ONE - part) / width
    return wp.vec3d(
        part * part * (wp.float64(3.0) - TWO * part), slope * wp.sign(x) * wp.abs(y), slope * wp.sign(y) * wp.abs(x)
    )


@wp.func
def evened(cells: ResolutionCells, place: wp.vec2d) -> wp.float64:
    """`ResolutionCells.even` at a place [cells]."""
    x = (place[0] - wp.floor(place[0])) * wp.float64(EVEN)
    y = (place[1] - wp.floor(place[1])) * wp.float64(EVEN)
    row = wp.min(int(wp.floor(x)), int(EVEN) - 1)
    col = wp.min(int(wp.floor(y)), int(EVEN) - 1)
    down = x - wp.float64(row)
    across = y - wp.float64(col)
    near = (ONE - across) * cells.even[row, col] + across * cells.even[row, col + 1]
    far = (ONE - across) * cells.even[row + 1, col] + across * cells.even[row + 1, col + 1]
    return (ONE - down) * near + down * far


@wp.func
def evenness(cells: ResolutionCells, place: wp.vec2d, side: wp.vec2d, middle: wp.float64) -> wp.vec2d:
    """The change of `evened` along a side of a tube, and the factor of the square: a parabola through both ends."""
    ahead = evened(cells, place + HALF * side)
    behind = evened(cells, place - HALF * side)
    return wp.vec2d(ahead - behind, TWO * (ahead + behind - TWO * middle))


@wp.func
def ways_of(turn: wp.array(dtype=float), met: faces_met, bounces: int) -> wp.float64:
    """How many of both ways over surfaces count: 1, or 0 and 2. `turn`: of each face, as `PathRays` has it.

    A tube that a flat piece of a curved surface mirrors stays as narrow as the piece, where the surface would spread
    it: its currents on the next surface have gaps, and their field is too weak. The way back, which ends on the curved
    surface, has no gaps. Both have one field by reciprocity, so it counts for both. Ways over more than one curved
    surface, and with one in the middle, are left to tubes that are spread (`multibounce_spread.py`): 0.
    """
    ways = float(1.0)
    if spread_over(turn, met, bounces) or turn[met[0] - 1] > 0.0:
        ways = 0.0
    elif turn[met[bounces - 1] - 1] > 0.0:
        ways = 2.0
    return wp.float64(ways)


@wp.struct
class TubeEnd:
    """A tube on its last surface: half its way there and back, and the mean azimuth of both ends [m]; by how much half
    of the way changes with the place there, `turn`; its sides there, and where it enters [m]. `ends`: as in
    `PathRecords`; `ahead` [rad]: of the phase, by caustics; `size` [m]: what the field would be if it had one phase."""

    along: wp.float64
    azimuth: wp.float64
    turn: wp.vec3d
    foot_u: wp.vec3d
    foot_v: wp.vec3d
    enters_u: wp.vec3d
    enters_v: wp.vec3d
    ends: wp.vec3
    ahead: wp.float64
    size: wp.float64


@wp.func
def keep_tube(tubes: TubeFields, i: int, cells: ResolutionCells, u: wp.vec3d, wavenumber: wp.float64, tube: TubeEnd):
    """Write the field of a tube."""
    turn_u = wavenumber * wp.dot(tube.turn, tube.foot_u)
    turn_v = wavenumber * wp.dot(tube.turn, tube.foot_v)
    place = wp.vec2d(tube.along / cells.size[0], tube.azimuth / cells.size[1])
    phase = turned(tube.ahead - TWO * wavenumber * tube.along)
    at = wp.vec2d(turn_u, turn_v)
    if tube.ends[0] > 0.5:
        at = wp.vec2d(turn_v, turn_u)
    begin = wp.float64(tube.ends[1])
    end = wp.float64(tube.ends[2])
    whole = slanted(at[0], at[1], begin, end)
    by_along = wp.vec2d(ZERO, tilted(at[0]) * sinc(at[1]))
    by_across = wp.vec2d(ZERO, sinc(at[0]) * tilted(at[1]))
    twice_along = wp.vec2d(curved(at[0]) * sinc(at[1]), ZERO)
    twice_across = wp.vec2d(sinc(at[0]) * curved(at[1]), ZERO)
    if begin != ZERO or end != ZERO:  # moments are slopes and curvatures of the field
        less = slanted(at[0] - STEP, at[1], begin, end)
        more = slanted(at[0] + STEP, at[1], begin, end)
        by_along = moment_of(less, more)
        twice_along = second_of(less, whole, more)
        less = slanted(at[0], at[1] - STEP, begin, end)
        more = slanted(at[0], at[1] + STEP, begin, end)
        by_across = moment_of(less, more)
        twice_across = second_of(less, whole, more)
    by_u = by_along
    by_v = by_across
    by_uu = twice_along
    by_vv = twice_across
    if tube.ends[0] > 0.5:
        by_u = by_across
        by_v = by_along
        by_uu = twice_across
        by_vv = twice_along
    phase = tube.size * phase
    moved_u = wp.vec2d(
        -wp.dot(tube.turn, tube.foot_u) / cells.size[0], HALF * wp.dot(u, tube.enters_u + tube.foot_u) / cells.size[1]
    )
    moved_v = wp.vec2d(
        -wp.dot(tube.turn, tube.foot_v) / cells.size[0], HALF * wp.dot(u, tube.enters_v + tube.foot_v) / cells.size[1]
    )
    # the factor changes over the tube, and moments of the third and fourth order are a quarter of those of the first
    # and second where phases turn fast, as they come from the ends
    even = evened(cells, place)
    even_u = evenness(cells, place, moved_u, even)
    even_v = evenness(cells, place, moved_v, even)
    quarter = wp.float64(0.25)
    tubes.place[i] = place
    tubes.side_u[i] = moved_u
    tubes.side_v[i] = moved_v
    tubes.size[i] = even * tube.size
    tubes.field[i] = product(
        even * whole + even_u[0] * by_u + even_u[1] * by_uu + even_v[0] * by_v + even_v[1] * by_vv, phase
    )
    tubes.by_u[i] = product((even + quarter * even_u[1]) * by_u + even_u[0] * by_uu, phase)
    tubes.by_v[i] = product((even + quarter * even_v[1]) * by_v + even_v[0] * by_vv, phase)
    tubes.by_uu[i] = product((even + quarter * even_u[1]) * by_uu + quarter * even_u[0] * by_u, phase)
    tubes.by_vv[i] = product((even + quarter * even_v[1]) * by_vv + quarter * even_v[0] * by_v, phase)


@wp.kernel(enable_backward=False)
def tube_kernel(
    # In:
    grid: RayGrid,
    mesh: Triangles,
    records: PathRecords,
    cells: ResolutionCells,
    wavenumber: wp.float64,
    turn: wp.array(dtype=float),
    # Out:
    tubes_out: TubeFields,
):
    """Follow each tube once more along the planes of its faces, in double precision: its phase needs it.

    The shares of a field in the samples that are kept have the squares' sum 1 (`ResolutionCells.even`). `turn`: of
    each face, as `PathRays` has it, for `ways_of`.
    """
    i = wp.tid()
    d = wp.vec3d(grid.d)
    u = wp.vec3d(grid.u)
    v = wp.vec3d(grid.v)
    slant_range = wp.float64(grid.slant_range)
    standoff = wp.float64(grid.standoff)
    elevation = wp.float64(records.ray[i][1])
    along = -standoff
    across = elevation
    direction = ONE * d
    width = wp.float64(records.ray[i][2]) * wp.float64(grid.azimuth_step)
    height = wp.float64(records.ray[i][3]) * wp.float64(grid.elevation_step)
    side_u = width * u
    side_v = height * v
    if slant_range > wp.float64(0.0):
        half = wp.sin(HALF * elevation)
        along = -TWO * half * half * slant_range - standoff * wp.cos(elevation)
        across = (slant_range - standoff) * wp.sin(elevation)
        direction = wp.cos(elevation) * d + wp.sin(elevation) * v
        side_v = height * (wp.cos(elevation) * v - wp.sin(elevation) * d)
    point = wp.float64(records.ray[i][0]) * u + along * d + across * v
    enters_u = wp.vec3d()
    enters_v = wp.vec3d()
    entry = wp.vec3d()
    foot_u = wp.vec3d()
    foot_v = wp.vec3d()
    area = wp.float64(0.0)
    way = wp.float64(0.0)
    met = records.faces[i]
    bounces = records.bounces[i]
    arrival = ONE * direction
    for k in range(bounces):
        f = met[k] - 1
        p0 = wp.vec3d(mesh.vertices[mesh.faces[f, 0]])
        p1 = wp.vec3d(mesh.vertices[mesh.faces[f, 1]])
        p2 = wp.vec3d(mesh.vertices[mesh.faces[f, 2]])
        normal = wp.normalize(wp.cross(p1 - p0, p2 - p0))
        slope = wp.dot(normal, direction)
        t = wp.dot(normal, p0 - point) / slope
        point = point + t * direction
        if k == 0:
            entry = ONE * point
            sight = sight_of(point, d, v, slant_range)
            way = sight.distance
            if slant_range > wp.float64(0.0):
                side_v = (sight.distance + slant_range) * side_v
            area = wp.length(wp.cross(side_u, side_v))
        else:
            way = way + t
        foot_u = footprint(side_u, normal, direction)
        foot_v = footprint(side_v, normal, direction)
        if k == 0:
            enters_u = ONE * foot_u
            enters_v = ONE * foot_v
        if k == bounces - 1:
            area = area / wp.abs(slope)
        arrival = ONE * direction
        direction = direction - TWO * slope * normal
        side_u = side_u - TWO * wp.dot(normal, side_u) * normal
        side_v = side_v - TWO * wp.dot(normal, side_v) * normal
    last = sight_of(point, d, v, slant_range)
    end = TubeEnd()
    end.along = HALF * (way + last.distance)
    end.azimuth = HALF * wp.dot(u, entry + point)
    end.turn = -HALF * (last.direction + arrival)  # (s - d) / 2
    end.foot_u = foot_u
    end.foot_v = foot_v
    end.enters_u = enters_u
    end.enters_v = enters_v
    end.ends = records.ends[i]
    end.size = wavenumber / FOUR_PI * area * ways_of(turn, met, bounces)
    keep_tube(tubes_out, i, cells, u, wavenumber, end)


@wp.struct
class AtEnds:
    """What the response at a tube's ends along a side changes in what it adds to a sample: its `field` and first moment
    along this side, `moved` [m]. `most`: the response of an end, without its sign."""

    field: wp.vec2d
    moved: wp.vec2d
    most: wp.float64


@wp.func
def response_at(cells: ResolutionCells, x: wp.float64, y: wp.float64) -> wp.float64:
    """The response at a distance (range, azimuth) [cells]."""
    return faded(x, y)[0] * read(cells.response, 0, x)[0] * read(cells.response, 1, y)[0]


@wp.func
def is_long(side: wp.vec2d) -> bool:
    return wp.max(wp.abs(side[0]), wp.abs(side[1])) > LONG


@wp.func
def at_ends(
    cells: ResolutionCells,
    x: wp.float64,
    y: wp.float64,
    side: wp.vec2d,
    middle: wp.float64,
    slope: wp.vec2d,
    first: wp.vec2d,
    second: wp.vec2d,
) -> AtEnds:
    """For a tube in whose middle, at a distance of x, y, the response and its slopes are known; `first` and `second`
    are the field's moments along the side.

    A tube on a wall along the line of sight is longer than a cell: there the ends tell the response, and not the
    slopes. The phase turns fast there, so that the field comes from the ends, and tubes that touch cancel where they
    do: in the end of one and the beginning of the next the response must be the same. So it is a parabola through
    middle and ends.
    """
    ahead = response_at(cells, x + HALF * side[0], y + HALF * side[1])
    behind = response_at(cells, x - HALF * side[0], y - HALF * side[1])
    change = ahead - behind
    beyond = HALF * (ahead + behind) - middle
    found = AtEnds()
    found.field = (change - wp.dot(side, slope)) * first + wp.float64(4.0) * beyond * second
    found.moved = beyond * first + change * second
    found.most = wp.max(wp.abs(ahead), wp.abs(behind))
    return found


@wp.func
def fading(x: wp.float64, y: wp.float64) -> wp.vec3d:
    """Second derivatives of `faded`, where it fades: along x, along x and y, and along y."""
    width = wp.float64(FADED) - wp.float64(WHOLE)
    part = (wp.float64(FADED) - wp.abs(x * y)) / width
    slope = wp.float64(-6.0) * part * (ONE - part) / width
    bend = wp.float64(6.0) * (ONE - TWO * part) / (width * width)
    return wp.vec3d(bend * y * y, wp.sign(x) * wp.sign(y) * slope + bend * x * y, bend * x * x)


@wp.kernel(enable_backward=False)
def couple_kernel(
    # In:
    tubes: TubeFields,
    order: wp.array(dtype=int),
    first: wp.array(dtype=int),
    bin: wp.array(dtype=int),
    cells: ResolutionCells,
    # Out:
    field_out: wp.array2d(dtype=wp.vec2d),
    by_range_out: wp.array2d(dtype=wp.vec2d),
    by_azimuth_out: wp.array2d(dtype=wp.vec2d),
    even_out: wp.array2d(dtype=wp.float64),
    loose_out: wp.array2d(dtype=wp.float64),
):
    """The field that each group of tubes adds to each of the samples about its bin, shape (groups, offsets).

    A thread has a group: it reads the responses of a tube once for all samples in a row and in a column. All arrays
    begin with zeros. `by_range_out`, `by_azimuth_out`: the field's first moments about the sample [m cells]. `even_out`
    [m]: the sum of the sizes of what tubes add, as if all had one phase. `loose_out`, (groups, offsets) or (0, 0): sums
    of the squares of what each tube adds [m2], as if these had no phase in common.
    """
    i = wp.tid()
    end = order.shape[0]
    if i + 1 < first.shape[0]:
        end = first[i + 1]
    base = cell_of(cells, bin[i])
    across = along_an_axis()
    across_slope = along_an_axis()
    across_bend = along_an_axis()
    for k in range(first[i], end):
        at = order[k]
        x = tubes.place[at][0] - wp.float64(base[0])
        y = tubes.place[at][1] - wp.float64(base[1])
        for n in range(2 * NEAR):
            azimuth = read(cells.response, 1, y - wp.float64(n + 1 - NEAR))
            across[n] = azimuth[0]
            across_slope[n] = azimuth[1]
            across_bend[n] = azimuth[2]
        side_u = tubes.side_u[at]
        side_v = tubes.side_v[at]
        field = tubes.field[at]
        by_range = side_u[0] * tubes.by_u[at] + side_v[0] * tubes.by_v[at]
        by_azimuth = side_u[1] * tubes.by_u[at] + side_v[1] * tubes.by_v[at]
        long_u = is_long(side_u)
        long_v = is_long(side_v)
        twice_range = wp.vec2d()
        twice = wp.vec2d()
        twice_azimuth = wp.vec2d()
        if not long_u:
            twice_range += HALF * side_u[0] * side_u[0] * tubes.by_uu[at]
            twice += side_u[0] * side_u[1] * tubes.by_uu[at]
            twice_azimuth += HALF * side_u[1] * side_u[1] * tubes.by_uu[at]
        if not long_v:
            twice_range += HALF * side_v[0] * side_v[0] * tubes.by_vv[at]
            twice += side_v[0] * side_v[1] * tubes.by_vv[at]
            twice_azimuth += HALF * side_v[1] * side_v[1] * tubes.by_vv[at]
        row = int(-NEAR)
        response = wp.vec3d()
        straight = wp.vec2d()
        aside = wp.vec2d()
        bent = wp.vec2d()
        power = wp.float64(0.0)
        for j in range(cells.offset.shape[0]):
            offset = cells.offset[j]
            if offset[0] != row:  # offsets of a row lie together
                row = offset[0]
                response = read(cells.response, 0, x - wp.float64(row))
                straight = response[0] * field + response[1] * by_range + response[2] * twice_range
                aside = response[0] * by_azimuth + response[1] * twice
                bent = response[0] * twice_azimuth
                power = response[0] * response[0] * wp.length_sq(field)
            n = offset[1] + NEAR - 1
            dx = x - wp.float64(row)
            dy = y - wp.float64(offset[1])
            fade = faded(dx, dy)
            plain = response[0] * across[n]
            share = fade[0] * plain
            most = wp.abs(share)
            added = fade[0] * (across[n] * straight + across_slope[n] * aside + across_bend[n] * bent) + plain * (
                fade[1] * by_range + fade[2] * by_azimuth
            )
            if fade[0] > ZERO and fade[0] < ONE:
                bend = fading(dx, dy)
                added += (
                    (bend[0] * plain + TWO * fade[1] * response[1] * across[n]) * twice_range
                    + (bend[1] * plain + fade[1] * response[0] * across_slope[n] + fade[2] * response[1] * across[n])
                    * twice
                    + (bend[2] * plain + TWO * fade[2] * response[0] * across_slope[n]) * twice_azimuth
                )
            moved_u = wp.vec2d()
            moved_v = wp.vec2d()
            if long_u or long_v:
                slope = wp.vec2d(
                    fade[0] * response[1] * across[n] + fade[1] * plain,
                    fade[0] * response[0] * across_slope[n] + fade[2] * plain,
                )
                if long_u:
                    ends = at_ends(cells, dx, dy, side_u, share, slope, tubes.by_u[at], tubes.by_uu[at])
                    added += ends.field
                    moved_u = ends.moved
                    most = wp.max(most, ends.most)
                if long_v:
                    ends = at_ends(cells, dx, dy, side_v, share, slope, tubes.by_v[at], tubes.by_vv[at])
                    added += ends.field
                    moved_v = ends.moved
                    most = wp.max(most, ends.most)
            field_out[i, j] = field_out[i, j] + added
            by_range_out[i, j] = (
                by_range_out[i, j] + dx * added + share * by_range + side_u[0] * moved_u + side_v[0] * moved_v
            )
            by_azimuth_out[i, j] = (
                by_azimuth_out[i, j] + dy * added + share * by_azimuth + side_u[1] * moved_u + side_v[1] * moved_v
            )
            even_out[i, j] = even_out[i, j] + most * tubes.size[at]
            if loose_out.shape[0] > 0:
                loose_out[i, j] = loose_out[i, j] + fade[0] * fade[0] * across[n] * across[n] * power
