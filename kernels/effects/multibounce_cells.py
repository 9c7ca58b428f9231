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
from warpsar.kernels.effects.multibounce import PathRecords
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

WHOLE = wp.constant(1.0)
FADED = wp.constant(4.0)
"""Products of the distances in range and azimuth [cells] between which the response fades to nothing."""

along_an_axis = wp.types.vector(length=2 * int(NEAR), dtype=wp.float64)
"""Numbers of the samples about one, from `1 - NEAR` to `NEAR`."""


@wp.struct
class ResolutionCells:
    """Cells of `size` (range, azimuth) [m] about the reference point, and the bins of the records among them.

    `offset`: the samples about a bin that get a share of a field in it. `response`: (2, 2 REACH STEPS + 1), of range
    and azimuth, each with its derivative [1/cells].
    """

    size: wp.vec2d
    bin_start: wp.vec2d  # [m]
    bin_size: wp.vec2d  # [m]
    bin_cols: int
    offset: wp.array(dtype=wp.vec2i)
    response: wp.array2d(dtype=wp.vec2d)


@wp.struct
class TubeFields:
    """Fields of tubes, shape (n,): `place` x (range, azimuth) [cells], `field` [m] there, and its first moments [m].

    `size` [m]: what the field would be if it had one phase in the whole tube.
    """

    place: wp.array(dtype=wp.vec2d)
    size: wp.array(dtype=wp.float64)
    field: wp.array(dtype=wp.vec2d)
    by_range: wp.array(dtype=wp.vec2d)
    by_azimuth: wp.array(dtype=wp.vec2d)


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
def moment_of(change: wp.vec2d) -> wp.vec2d:
    """The change of a field over `STEP` to either side, as a moment: its slope over 2j."""
    return (wp.float64(0.25) / STEP) * wp.vec2d(change[1], -change[0])


@wp.func
def slanted(along: wp.float64, across: wp.float64, begin: wp.float64, end: wp.float64) -> wp.vec2d:
    """Integral of exp(2j (along s + across t)) over t from -1/2 to 1/2, and s from -1/2 + begin t to 1/2 + end t."""
    first = sinc(across + along * begin)
    last = sinc(across + along * end)
    step = tilted(across) * (begin - end)
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
def read(table: wp.array2d(dtype=wp.vec2d), axis: int, distance: wp.float64) -> wp.vec2d:
    """The response at a distance [cells], and its derivative; 0 beyond the table."""
    at = (distance + wp.float64(REACH)) * wp.float64(STEPS)
    low = int(wp.floor(at))
    if low < 0 or low + 1 >= table.shape[1]:
        return wp.vec2d()
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


@wp.kernel(enable_backward=False)
def tube_kernel(
    # In:
    grid: RayGrid,
    mesh: Triangles,
    records: PathRecords,
    cells: ResolutionCells,
    wavenumber: wp.float64,
    # Out:
    tubes_out: TubeFields,
):
    """Follow each tube once more along the planes of its faces, in double precision: its phase needs it.

    The shares of a field in the samples that are kept have the squares' sum 1.
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
    along = HALF * (way + last.distance)
    azimuth = HALF * wp.dot(u, entry + point)
    turn = -HALF * (last.direction + arrival)  # (s - d) / 2
    turn_u = wavenumber * wp.dot(turn, foot_u)
    turn_v = wavenumber * wp.dot(turn, foot_v)
    place = wp.vec2d(along / cells.size[0], azimuth / cells.size[1])
    base = cell_of(cells, records.bin[i])
    near_range = along_an_axis()
    near_azimuth = along_an_axis()
    for n in range(2 * NEAR):
        ahead = wp.float64(n + 1 - NEAR)
        near_range[n] = read(cells.response, 0, place[0] - wp.float64(base[0]) - ahead)[0]
        near_azimuth[n] = read(cells.response, 1, place[1] - wp.float64(base[1]) - ahead)[0]
    total = wp.float64(0.0)
    for j in range(cells.offset.shape[0]):
        offset = cells.offset[j]
        fade = faded(
            place[0] - wp.float64(base[0]) - wp.float64(offset[0]),
            place[1] - wp.float64(base[1]) - wp.float64(offset[1]),
        )
        share = fade[0] * near_range[offset[0] + NEAR - 1] * near_azimuth[offset[1] + NEAR - 1]
        total += share * share
    size = wavenumber / FOUR_PI * area / wp.sqrt(wp.max(total, wp.float64(1.0e-3)))
    phase = turned(-TWO * wavenumber * along)
    at = wp.vec2d(turn_u, turn_v)
    if records.ends[i][0] > 0.5:
        at = wp.vec2d(turn_v, turn_u)
    begin = wp.float64(records.ends[i][1])
    end = wp.float64(records.ends[i][2])
    whole = slanted(at[0], at[1], begin, end)
    by_along = wp.vec2d(ZERO, tilted(at[0]) * sinc(at[1]))
    by_across = wp.vec2d(ZERO, sinc(at[0]) * tilted(at[1]))
    if begin != ZERO or end != ZERO:  # moments are slopes of the field, over 2j
        by_along = moment_of(slanted(at[0] + STEP, at[1], begin, end) - slanted(at[0] - STEP, at[1], begin, end))
        by_across = moment_of(slanted(at[0], at[1] + STEP, begin, end) - slanted(at[0], at[1] - STEP, begin, end))
    by_u = by_along
    by_v = by_across
    if records.ends[i][0] > 0.5:
        by_u = by_across
        by_v = by_along
    tubes_out.place[i] = place
    tubes_out.size[i] = size
    tubes_out.field[i] = size * product(whole, phase)
    tubes_out.by_range[i] = (-size / cells.size[0]) * product(
        wp.dot(turn, foot_u) * by_u + wp.dot(turn, foot_v) * by_v, phase
    )
    shift_u = HALF * wp.dot(u, enters_u + foot_u)
    shift_v = HALF * wp.dot(u, enters_v + foot_v)
    tubes_out.by_azimuth[i] = (size / cells.size[1]) * product(shift_u * by_u + shift_v * by_v, phase)


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
    for k in range(first[i], end):
        at = order[k]
        x = tubes.place[at][0] - wp.float64(base[0])
        y = tubes.place[at][1] - wp.float64(base[1])
        for n in range(2 * NEAR):
            azimuth = read(cells.response, 1, y - wp.float64(n + 1 - NEAR))
            across[n] = azimuth[0]
            across_slope[n] = azimuth[1]
        row = int(-NEAR)
        straight = wp.vec2d()
        aside = wp.vec2d()
        along = wp.float64(0.0)
        power = wp.float64(0.0)
        for j in range(cells.offset.shape[0]):
            offset = cells.offset[j]
            if offset[0] != row:  # offsets of a row lie together
                row = offset[0]
                response = read(cells.response, 0, x - wp.float64(row))
                along = response[0]
                straight = along * tubes.field[at] + response[1] * tubes.by_range[at]
                aside = along * tubes.by_azimuth[at]
                power = along * along * wp.length_sq(tubes.field[at])
            n = offset[1] + NEAR - 1
            fade = faded(x - wp.float64(row), y - wp.float64(offset[1]))
            share = fade[0] * along * across[n]
            added = fade[0] * (across[n] * straight + across_slope[n] * aside) + along * across[n] * (
                fade[1] * tubes.by_range[at] + fade[2] * tubes.by_azimuth[at]
            )
            field_out[i, j] = field_out[i, j] + added
            by_range_out[i, j] = by_range_out[i, j] + (x - wp.float64(row)) * added + share * tubes.by_range[at]
            by_azimuth_out[i, j] = (
                by_azimuth_out[i, j] + (y - wp.float64(offset[1])) * added + share * tubes.by_azimuth[at]
            )
            even_out[i, j] = even_out[i, j] + wp.abs(share) * tubes.size[at]
            if loose_out.shape[0] > 0:
                loose_out[i, j] = loose_out[i, j] + fade[0] * fade[0] * across[n] * across[n] * power
