"""Cells of a grid across the line of sight: made, judged, cut into parts; and sums over them, view by view.

The cells of a view follow one another, and those of the next view come after them. Each view has a multiple of `RAYS`
places for cells; its last ones may be empty, of no width. `first_in` holds the first place of each view, and the end.
"""

import warp as wp

RAYS = wp.constant(8)
"""Cells whose sums one thread makes. A sum has the same order for any number of threads, and on any device."""
LANES = wp.constant(32)
"""Partial sums of a view: threads that add up side by side."""


@wp.struct
class Cells:
    """Cells of views: the view of each, its middle along u and v [m], and its width [m], 0 of an empty one."""

    view: wp.array(dtype=int)
    place: wp.array(dtype=wp.vec2d)
    size: wp.array(dtype=wp.vec2d)


@wp.struct
class TubeEnds:
    """What became of the cells' tubes: how many faces they met, the way from the first to the last [m], and how wide
    they got along u and v [rad] (`tubes.trace_kernel`)."""

    count: wp.array(dtype=int)
    span: wp.array(dtype=wp.float64)
    turn: wp.array(dtype=wp.vec2d)


@wp.kernel(enable_backward=False)
def grid_kernel(
    # In:
    first_in: wp.array[int],
    low_in: wp.array[wp.vec2d],
    step_in: wp.array[wp.vec2d],
    count_in: wp.array[wp.vec2i],
    start: int,
    # Out:
    cells_out: Cells,
):
    """Cells from number `start` on of grids, one for each view, along u and then along v."""
    i = wp.tid()
    view = wp.lower_bound(first_in, start + i + 1) - 1
    number = start + i - first_in[view]
    count = count_in[view]
    place = wp.vec2d()
    size = wp.vec2d()
    if number < count[0] * count[1]:
        half = wp.float64(0.5)
        step = step_in[view]
        u = number / count[1]
        at = wp.vec2d(wp.float64(u) + half, wp.float64(number - u * count[1]) + half)
        place = low_in[view] + wp.cw_mul(at, step)
        size = step
    cells_out.view[i] = view
    cells_out.place[i] = place
    cells_out.size[i] = size


@wp.func
def parts_along(turn: wp.float64, most: wp.float64) -> int:
    return wp.where(turn > most, 2, 1)


@wp.kernel(enable_backward=False)
def judge_kernel(
    # In:
    cells: Cells,
    ends: TubeEnds,
    most: wp.float64,
    level: int,
    levels: int,
    # Out:
    kept_out: wp.array[int],
    parts_out: wp.array[int],
    sums_out: wp.array4d[wp.vec2d],
):
    """Which tubes stay, and into how many parts the others are cut: those that turn more than `most` [rad].

    Each thread takes RAYS tubes. Their sums, (chunks, 1, 1, 3) pairs: cross-sections that are cut at the first level,
    and that alias even so [m2]; of tubes that meet more than one face, and that times their way [m2, m3]; hits, and the
    most of one tube.
    """
    chunk = wp.tid()
    zero = wp.float64(0.0)
    refined = zero
    aliased = zero
    cross = zero
    way = zero
    hits = int(0)
    deepest = int(0)
    for ray in range(chunk * RAYS, (chunk + 1) * RAYS):
        size = cells.size[ray]
        area = size[0] * size[1]
        count = ends.count[ray]
        turn = ends.turn[ray]
        parts = parts_along(turn[0], most) * parts_along(turn[1], most)
        kept = wp.where(size[0] > zero or size[1] > zero, 1, 0)
        hits += count
        deepest = wp.max(deepest, count)
        if parts > 1 and level < levels:
            kept = 0
            if level == 0:
                refined += area
        elif parts > 1:
            aliased += area
            parts = 1
        if kept != 0 and count > 1:
            cross += area
            way += area * ends.span[ray]
        kept_out[ray] = kept
        parts_out[ray] = wp.where(parts > 1, parts, 0)
    sums_out[chunk, 0, 0, 0] = wp.vec2d(refined, aliased)
    sums_out[chunk, 0, 0, 1] = wp.vec2d(cross, way)
    sums_out[chunk, 0, 0, 2] = wp.vec2d(wp.float64(hits), wp.float64(deepest))


@wp.func
def before(through_in: wp.array[int], place: int) -> int:
    """Parts of all cells before a place, of sums through each."""
    if place > 0:
        return through_in[place - 1]
    return 0


@wp.kernel(enable_backward=False)
def share_kernel(
    # In:
    first_in: wp.array[int],
    through_in: wp.array[int],
    # Out:
    parts_out: wp.array[int],
):
    """How many parts the cells of each view have; `through_in`: of all cells up to each."""
    view = wp.tid()
    parts_out[view] = before(through_in, first_in[view + 1]) - before(through_in, first_in[view])


@wp.kernel(enable_backward=False)
def parts_kernel(
    # In:
    first_in: wp.array[int],
    through_in: wp.array[int],
    cells: Cells,
    turn_in: wp.array[wp.vec2d],
    most: wp.float64,
    part_first_in: wp.array[int],
    # Out:
    parts_out: Cells,
):
    """Halves or quarters of cells that are cut, in the order of the cells; a view's ones from `part_first_in` on."""
    i = wp.tid()
    parts = through_in[i] - before(through_in, i)
    if parts == 0:
        return
    view = cells.view[i]
    start = part_first_in[view] + before(through_in, i) - before(through_in, first_in[view])
    half = wp.float64(0.5)
    turn = turn_in[i]
    along_u = parts_along(turn[0], most)
    along_v = parts_along(turn[1], most)
    place = cells.place[i]
    size = cells.size[i]
    if along_u > 1:
        size[0] = half * size[0]
        place[0] = place[0] - half * size[0]
    if along_v > 1:
        size[1] = half * size[1]
        place[1] = place[1] - half * size[1]
    for j in range(parts):
        u = j / along_v
        v = j - u * along_v
        at = place
        if u > 0:
            at[0] = at[0] + size[0]
        if v > 0:
            at[1] = at[1] + size[1]
        parts_out.view[start + j] = view
        parts_out.place[start + j] = at
        parts_out.size[start + j] = size


@wp.kernel(enable_backward=False)
def lanes_kernel(
    # In:
    first_in: wp.array[int],
    part_in: wp.array4d[wp.vec2d],
    source: int,
    target: int,
    layers: int,
    # Out:
    total_out: wp.array4d[wp.vec2d],
):
    """Add sums over RAYS cells, (chunks, frequencies, bounces, n), to those of the views in LANES partial sums each.

    Threads: (views, LANES, frequencies, bounces times n). The bounces from `source` on go to those from `target` on, of
    `layers`.
    """
    view, lane, f, j = wp.tid()
    n = part_in.shape[3]
    b = j / n
    p = j - b * n
    total = wp.vec2d()
    for chunk in range(first_in[view] / RAYS + lane, first_in[view + 1] / RAYS, LANES):
        total += part_in[chunk, f, source + b, p]
    total_out[view, lane, f * layers + target + b, p] += total


@wp.kernel(enable_backward=False)
def views_kernel(
    # In:
    part_in: wp.array4d[wp.vec2d],
    # Out:
    total_out: wp.array3d[wp.vec2d],
):
    """The sum of partial sums, (views, lanes, m, n), over lanes."""
    view, m, p = wp.tid()
    total = wp.vec2d()
    for lane in range(part_in.shape[1]):
        total += part_in[view, lane, m, p]
    total_out[view, m, p] = total


@wp.kernel(enable_backward=False)
def chunks_kernel(
    # In:
    part_in: wp.array4d[wp.vec2d],
    term: int,
    # Out:
    total_out: wp.array4d[wp.vec2d],
):
    """Add sums over chunks, (views, frequencies, chunks, 4), to a term of (views, frequencies, terms, 4)."""
    view, f, p = wp.tid()
    total = wp.vec2d()
    for chunk in range(part_in.shape[2]):
        total += part_in[view, f, chunk, p]
    total_out[view, f, term, p] += total


@wp.kernel(enable_backward=False)
def whole_kernel(
    # In:
    start_in: wp.array[int],
    seen_in: wp.array2d[wp.uint8],
    # Out:
    whole_out: wp.array2d[wp.uint8],
):
    """Whether each view sees all points of a region; `start_in`: the first point of each region, and the end."""
    view, region = wp.tid()
    whole = wp.uint8(1)
    for i in range(start_in[region], start_in[region + 1]):
        if seen_in[view, i] == wp.uint8(0):
            whole = wp.uint8(0)
    whole_out[view, region] = whole
