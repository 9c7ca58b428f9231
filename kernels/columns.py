"""Rays to hits on the CPU, eight at once, one pixel column after the other.

The same faces, records and hits as kernels/raster.py and kernels/trace.py find: their steps in their order, in vector
registers. A launch is serial here, so that a ray keeps its nearest face without atomics, and as nothing else adds to a
column of pixels its records are found again through a table small enough for the nearest cache.
"""

import warp as wp

from warpsar.kernels.geometry import RayGrid

# As in kernels/raster.py: two faces see their common edge alike only where no product is fused into a sum.
wp.set_module_options({"fuse_fp": False})

LANES = 8  # rays that are worked on at once

# What the native code below begins with: numbers of LANES rays side by side, and points of as many.
_NUMBERS = """
    typedef float V __attribute__((ext_vector_type(8)));
    typedef int I __attribute__((ext_vector_type(8)));
"""
_POINTS = """
    struct P { V x, y, z; };
    const auto dot = [](P a, P b) -> V { return a.x * b.x + a.y * b.y + a.z * b.z; };
    const auto cross = [](P a, P b) -> P {
        return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
    };
    const auto difference = [](P a, P b) -> P { return {a.x - b.x, a.y - b.y, a.z - b.z}; };
    const auto constant = [](wp::vec_t<3, float> p) -> P { return {V(p.c[0]), V(p.c[1]), V(p.c[2])}; };
    const P d = constant(grid.d), u = constant(grid.u), v = constant(grid.v);
    const V one = 1.0f;
"""


@wp.func_native(
    """
    const int first = i * grid.elevation_cells;
    for (int k = 0; k < grid.elevation_cells; ++k) {
        wp::uint32 random = wp::rand_init(seed, (first_cell + i) * grid.elevation_cells + k);
        across_out.data[first + k] = wp::randf(random) - 0.5f;
        along_out.data[first + k] = wp::randf(random) - 0.5f;
    }
"""
)
def jitter_cell(
    i: int,
    grid: RayGrid,
    first_cell: int,
    seed: int,
    across_out: wp.array(dtype=float),
    along_out: wp.array(dtype=float),
): ...


@wp.kernel(enable_backward=False)
def jitter_kernel(
    # In:
    grid: RayGrid,
    first_cell: int,
    seed: int,
    # Out:
    across_out: wp.array(dtype=float),
    along_out: wp.array(dtype=float),
):
    """`trace.jitter_of` the rays of one azimuth cell."""
    jitter_cell(wp.tid(), grid, first_cell, seed, across_out, along_out)


_SORT = """
    // counted, then placed: faces of one column stay in their order
    const int n = cells.shape[0], columns = first_out.shape[0] - 1;
    for (int column = 0; column <= columns; ++column)
        first_out.data[column] = 0;
    int widest = 0;
    double tests = 0.0;
    const auto column_of = [&](int f) -> int {
        const wp::vec_t<4, wp::int32> box = cells.data[f];
        return box.c[1] < box.c[0] || box.c[3] < box.c[2] ? columns : wp::min(box.c[0] / cells_per_column, columns);
    };
    for (int f = 0; f < n; ++f) {
        const int column = column_of(f);
        if (column == columns)
            continue;
        ++first_out.data[column + 1];
        const wp::vec_t<4, wp::int32> box = cells.data[f];
        widest = wp::max(widest, box.c[1] - box.c[0]);
        const int wide = wp::min(box.c[1], last_cell) - wp::max(box.c[0], first_cell) + 1;
        if (wide > 0)
            tests += wp::float64(wide) * wp::float64(box.c[3] - box.c[2] + 1);
    }
    for (int column = 0; column < columns; ++column)
        first_out.data[column + 1] += first_out.data[column];
    for (int f = 0; f < n; ++f) {
        const int column = column_of(f);
        if (column < columns)
            order_out.data[first_out.data[column]++] = f;
    }
    for (int column = columns; column > 0; --column)
        first_out.data[column] = first_out.data[column - 1];
    first_out.data[0] = 0;
    counts_out.data[0] = tests;
    counts_out.data[1] = widest;
"""


@wp.func_native(_SORT)
def sort_all(
    cells: wp.array(dtype=wp.vec4i),
    cells_per_column: int,
    first_cell: int,
    last_cell: int,
    first_out: wp.array(dtype=int),
    order_out: wp.array(dtype=int),
    counts_out: wp.array(dtype=wp.float64),
): ...


@wp.kernel(enable_backward=False)
def sort_kernel(
    # In:
    cells: wp.array(dtype=wp.vec4i),
    cells_per_column: int,
    first_cell: int,
    last_cell: int,
    # Out:
    first_out: wp.array(dtype=int),
    order_out: wp.array(dtype=int),
    counts_out: wp.array(dtype=wp.float64),
):
    """Faces that touch any cell, in the order of the pixel columns they begin in: those of column j from `first_out`
    [j] to [j + 1]. `counts_out`: the rays of the cells `first_cell` to `last_cell` that all faces together are held
    against, and the most azimuth cells that one face reaches beyond its first. One thread."""
    sort_all(cells, cells_per_column, first_cell, last_cell, first_out, order_out, counts_out)


_RAY = """
    const bool curved = grid.slant_range > 0.0f;
    for (int k = 0; k < grid.elevation_cells; ++k) {
        const int at = i * grid.elevation_cells + k;
        const float middle = grid.azimuth_start + (wp::float32(first_cell + i) + 0.5f) * grid.azimuth_step;
        azimuth.data[at] = middle + azimuth.data[at] * grid.azimuth_step;
        const float elevation = grid.elevation_start + (wp::float32(k) + 0.5f + higher.data[at]) * grid.elevation_step;
        higher.data[at] = elevation;
        if (curved) {
            const float cosine = wp::cos(elevation), sine = wp::sin(elevation), half = wp::sin(0.5f * elevation);
            higher.data[at] = (grid.slant_range - grid.standoff) * sine;
            nearer_out.data[at] = -2.0f * half * half * grid.slant_range - grid.standoff * cosine;
            cosine_out.data[at] = cosine;
            sine_out.data[at] = sine;
        }
    }
"""


@wp.func_native(_RAY)
def ray_cell(
    i: int,
    grid: RayGrid,
    first_cell: int,
    azimuth: wp.array(dtype=float),
    higher: wp.array(dtype=float),
    nearer_out: wp.array(dtype=float),
    cosine_out: wp.array(dtype=float),
    sine_out: wp.array(dtype=float),
): ...


@wp.kernel(enable_backward=False)
def ray_kernel(
    # In:
    grid: RayGrid,
    first_cell: int,
    # In and out:
    azimuth: wp.array(dtype=float),
    higher: wp.array(dtype=float),
    # Out:
    nearer_out: wp.array(dtype=float),
    cosine_out: wp.array(dtype=float),
    sine_out: wp.array(dtype=float),
):
    """Rays of one azimuth cell in the plane of d and v, as `raster.distance_to` needs them: in the place of their
    jitter azimuth [m], and where they start along v [m]; about a track also where along d [m], and cosine and sine of
    their direction's angle to d."""
    ray_cell(wp.tid(), grid, first_cell, azimuth, higher, nearer_out, cosine_out, sine_out)


_RASTER = """
    const auto load = [](const wp::array_t<float>& array, int at) -> V {
        V result;
        __builtin_memcpy(&result, array.data + at, sizeof(V));
        return result;
    };
    const bool curved = grid.slant_range > 0.0f;
    const I lane = {0, 1, 2, 3, 4, 5, 6, 7};
    // faces of one column lie far apart in memory: what later ones need is asked for now
    const int end = order.shape[0] - 1, next = order.data[wp::min(begin + i + 8, end)];
    const int later = order.data[wp::min(begin + i + 16, end)];
    __builtin_prefetch(cells.data + later);
    __builtin_prefetch(faces.data + 3 * later);
    for (int j = 0; j < 3; ++j)
        __builtin_prefetch(corner.data + faces.data[3 * next + j]);
    const int f = order.data[begin + i];
    const wp::vec_t<4, wp::int32> box = cells.data[f];
    const int first = wp::max(box.c[0], first_cell), last = wp::min(box.c[1], last_cell);
    if (first > last)
        return;
    wp::vec_t<4, float> corners[3];
    for (int j = 0; j < 3; ++j)
        corners[j] = corner.data[faces.data[3 * f + j]];
    const wp::vec_t<4, float> a = corners[0], b = corners[1], c = corners[2];
    const bool slanted = first < last && box.c[2] + 16 < box.c[3];  // worth cutting into strips of one azimuth cell
    for (int cell = first; cell <= last; ++cell) {
        int bottom = box.c[2], top = box.c[3];
        if (slanted) {
            // the elevations that the edges have between the cell's sides
            const float left = grid.azimuth_start + (wp::float32(cell) - slack) * grid.azimuth_step;
            const float right = grid.azimuth_start + (wp::float32(cell) + 1.0f + slack) * grid.azimuth_step;
            float lowest = 1.0e30f, highest = -1.0e30f;
            for (int j = 0; j < 3; ++j) {
                const wp::vec_t<4, float> p = corners[j], q = corners[j == 2 ? 0 : j + 1];
                const float low = wp::max(wp::min(p.c[0], q.c[0]), left);
                const float high = wp::min(wp::max(p.c[0], q.c[0]), right);
                if (low > high)
                    continue;
                const float wide = q.c[0] - p.c[0];
                for (int end = 0; end < 2; ++end) {
                    float elevation = end ? q.c[1] : p.c[1];
                    if (wide != 0.0f) {
                        const float t = wp::clamp(((end ? high : low) - p.c[0]) / wide, 0.0f, 1.0f);
                        elevation = p.c[1] + t * (q.c[1] - p.c[1]);
                        if (curved) {
                            const float across = p.c[3] + t * (q.c[3] - p.c[3]);
                            const float along = p.c[2] + t * (q.c[2] - p.c[2]);
                            elevation = wp::atan2(across, along + grid.slant_range) - grid.elevation_start;
                            elevation = elevation / grid.elevation_step;
                        }
                    }
                    lowest = wp::min(lowest, elevation);
                    highest = wp::max(highest, elevation);
                }
            }
            bottom = wp::max(bottom, wp::int32(wp::floor(lowest - slack)));
            top = wp::min(top, wp::int32(wp::floor(highest + slack)));
        }
        const int row = (cell - first_cell) * grid.elevation_cells;
        for (int k = bottom; k <= top; k += 8) {
            const int at = row + k;
            const V x = load(azimuth, at), across = load(higher, at);
            const V au = a.c[0] - x, bu = b.c[0] - x, cu = c.c[0] - x;
            V along = -grid.standoff, cosine = 1.0f, sine = 0.0f;
            V av = a.c[3] - across, bv = b.c[3] - across, cv = c.c[3] - across;
            if (curved) {
                along = load(nearer, at);
                cosine = load(cosines, at);
                sine = load(sines, at);
                av = av * cosine - (a.c[2] - along) * sine;
                bv = bv * cosine - (b.c[2] - along) * sine;
                cv = cv * cosine - (c.c[2] - along) * sine;
            }
            const V wa = bu * cv - bv * cu, wb = cu * av - cv * au, wc = au * bv - av * bu;
            const I left_of = (wa >= 0.0f) & (wb >= 0.0f) & (wc >= 0.0f);
            const I inside = left_of | ((wa <= 0.0f) & (wb <= 0.0f) & (wc <= 0.0f));
            const V total = wa + wb + wc;
            const I met = inside & (lane <= top - k) & (total != 0.0f);  // else edge-on
            if (!__builtin_reduce_or(met))
                continue;
            V distance = (wa * a.c[2] + wb * b.c[2] + wc * c.c[2]) / total - along;
            if (curved) {
                const V v = (wa * a.c[3] + wb * b.c[3] + wc * c.c[3]) / total - across;
                distance = distance * cosine + v * sine;
            }
            V nearest_depth;
            I nearest_face;
            __builtin_memcpy(&nearest_depth, depth.data + at, sizeof(V));
            __builtin_memcpy(&nearest_face, nearest.data + at, sizeof(I));
            // of two at one distance the first: a matter of the mesh, not of the order they come in
            const I first_of_two = (distance == nearest_depth) & (f < nearest_face);
            const I nearer_one = met & ((distance < nearest_depth) | first_of_two);
            nearest_depth = nearer_one ? distance : nearest_depth;
            nearest_face = nearer_one ? I(f) : nearest_face;
            __builtin_memcpy(depth.data + at, &nearest_depth, sizeof(V));
            __builtin_memcpy(nearest.data + at, &nearest_face, sizeof(I));
        }
    }
"""


@wp.func_native(_NUMBERS + _RASTER)
def raster_face(
    i: int,
    grid: RayGrid,
    corner: wp.array(dtype=wp.vec4),
    faces: wp.array2d(dtype=int),
    cells: wp.array(dtype=wp.vec4i),
    order: wp.array(dtype=int),
    begin: int,
    azimuth: wp.array(dtype=float),
    higher: wp.array(dtype=float),
    nearer: wp.array(dtype=float),
    cosines: wp.array(dtype=float),
    sines: wp.array(dtype=float),
    first_cell: int,
    last_cell: int,
    slack: float,
    depth: wp.array(dtype=float),
    nearest: wp.array(dtype=int),
): ...


@wp.kernel(enable_backward=False)
def raster_kernel(
    # In:
    grid: RayGrid,
    corner: wp.array(dtype=wp.vec4),
    faces: wp.array2d(dtype=int),
    cells: wp.array(dtype=wp.vec4i),
    order: wp.array(dtype=int),
    begin: int,
    azimuth: wp.array(dtype=float),
    higher: wp.array(dtype=float),
    nearer: wp.array(dtype=float),
    cosines: wp.array(dtype=float),
    sines: wp.array(dtype=float),
    first_cell: int,
    last_cell: int,
    slack: float,
    # In and out:
    depth: wp.array(dtype=float),
    nearest: wp.array(dtype=int),
):
    """One face against the rays whose cells it may touch, LANES at once; a launch on the CPU is serial, so nothing is
    atomic. Every array of rays has LANES more than there are.

    Edges and distances as in `raster.distance_to`; `cells` of each face are those of `raster.extent_kernel`, `slack`
    [cells] is what it had.
    """
    raster_face(
        wp.tid(),
        grid,
        corner,
        faces,
        cells,
        order,
        begin,
        azimuth,
        higher,
        nearer,
        cosines,
        sines,
        first_cell,
        last_cell,
        slack,
        depth,
        nearest,
    )


_RECORD = """
    const bool curved = grid.slant_range > 0.0f;
    const int column = first_cell / grid.cells_per_column + i;
    const wp::int64 capacity = rows.shape[0];
    const wp::uint32 mask = head.shape[0] - 1;
    for (wp::uint32 slot = 0; slot <= mask; ++slot)
        head.data[slot] = -1;

    const auto leave = [&](int row, int f, float weight, float moment1, float moment2) {
        const wp::int64 counted = wp::int64(weight * quanta);
        if (counted <= 0)
            return;
        const wp::int64 key = (wp::int64(row * grid.cols + column) << face_bits) + f;
        wp::uint32 slot = wp::uint32(row) * 0x9E3779B1u + wp::uint32(f) * 0x85EBCA77u;
        slot = (slot ^ (slot >> 15)) & mask;
        int at = head.data[slot];
        while (at >= 0 && rows.data[4 * wp::int64(at)] != key)
            at = link.data[at];
        if (at < 0) {
            at = taken.data[0]++;
            if (at >= capacity)  // the host begins again with room for as many
                return;
            rows.data[4 * wp::int64(at)] = key;
            for (int j = 1; j < 4; ++j)
                rows.data[4 * wp::int64(at) + j] = 0;
            link.data[at] = head.data[slot];
            head.data[slot] = at;
        }
        rows.data[4 * wp::int64(at) + 1] += counted;
        rows.data[4 * wp::int64(at) + 2] += wp::int64(moment1 * quanta);
        rows.data[4 * wp::int64(at) + 3] += wp::int64(moment2 * quanta);
    };

    // eight rays at once
    const auto sum = [](V a, P p, V b, P q, V c, P r) -> P {
        return {a * p.x + b * q.x + c * r.x, a * p.y + b * q.y + c * r.y, a * p.z + b * q.z + c * r.z};
    };
    const auto least = [](V a, V b) -> V { return a < b ? a : b; };
    const auto most = [](V a, V b) -> V { return a > b ? a : b; };
    const V none = 0.0f;
    const auto slant_range_of = [&](P point) -> V {
        const V along = dot(point, d);
        if (!curved)
            return along;
        const V across = dot(point, v), far = grid.slant_range + along;
        const V r = __builtin_elementwise_sqrt(far * far + across * across);
        return (2.0f * grid.slant_range * along + along * along + across * across) / (r + grid.slant_range);
    };
    // `trace.share_before`
    const auto share_before = [&](V offset, V wide, V narrow) -> V {
        const V distance = __builtin_elementwise_abs(offset), rest = 0.5f * (wide + narrow) - distance;
        const V linear = 0.5f - distance / most(wide, V(1.0e-30f));
        const V square = 0.5f * rest * rest / most(wide * narrow, V(1.0e-30f));
        const V outer = distance < 0.5f * (wide + narrow) ? square : none;
        const V beyond = distance <= 0.5f * (wide - narrow) ? linear : outer;
        return offset < 0.0f ? beyond : one - beyond;
    };
    const int first = first_cell + i * grid.cells_per_column;
    for (int cell = first; cell < first + grid.cells_per_column; ++cell) {
        const int before = (cell - first_cell) * grid.elevation_cells;
        const float middle_azimuth = grid.azimuth_start + (wp::float32(cell) + 0.5f) * grid.azimuth_step;
        int run_row = -1, run_face = -1;
        float run_weight = 0.0f, run_moment1 = 0.0f, run_moment2 = 0.0f;
        const auto add = [&](int row, int f, float part, float b1, float b2) {
            if (row != run_row || f != run_face) {
                if (run_row >= 0)
                    leave(run_row, run_face, run_weight, run_moment1, run_moment2);
                run_row = row;
                run_face = f;
                run_weight = run_moment1 = run_moment2 = 0.0f;
            }
            run_weight += part;
            run_moment1 += part * b1;
            run_moment2 += part * b2;
        };
        // the next rays that meet something, side by side
        int count = 0, met[8];
        struct { V across, along, number; P corner[3]; } ray;
        float* lanes = reinterpret_cast<float*>(&ray);
        for (int k = 0; k < grid.elevation_cells; ++k) {
            const int f = face.data[before + k];
            const int next = face.data[before + wp::min(k + 8, grid.elevation_cells - 1)];
            const int later = face.data[before + wp::min(k + 16, grid.elevation_cells - 1)];
            if (later >= 0)
                __builtin_prefetch(faces.data + 3 * later);
            if (next >= 0)
                for (int j = 0; j < 3; ++j)
                    __builtin_prefetch(vertices.data + faces.data[3 * next + j]);
            if (f >= 0) {
                met[count] = f;
                lanes[count] = jitter_across.data[before + k];
                lanes[8 + count] = jitter_along.data[before + k];
                lanes[16 + count] = wp::float32(k) + 0.5f;
                for (int j = 0; j < 3; ++j)
                    for (int axis = 0; axis < 3; ++axis)
                        lanes[24 + 24 * j + 8 * axis + count] = vertices.data[faces.data[3 * f + j]].c[axis];
                ++count;
            }
            if (!count || (count < 8 && k + 1 < grid.elevation_cells))
                continue;
            const P p0 = ray.corner[0], e1 = difference(ray.corner[1], p0), e2 = difference(ray.corner[2], p0);
            const P area = cross(e1, e2);
            const V length = __builtin_elementwise_sqrt(dot(area, area));
            const I some = length > 0.0f;
            const V x = some ? area.x / length : none, y = some ? area.y / length : none;
            const P normal = {x, y, some ? area.z / length : none};
            const V azimuth = middle_azimuth + ray.across * grid.azimuth_step;
            const V elevation = grid.elevation_start + (ray.number + ray.along) * grid.elevation_step;
            P origin, direction = d;
            if (curved) {
                V c, s, half;
                for (int lane = 0; lane < 8; ++lane) {
                    c[lane] = wp::cos(elevation[lane]);
                    s[lane] = wp::sin(elevation[lane]);
                    half[lane] = wp::sin(0.5f * elevation[lane]);
                }
                const V nearer = -2.0f * half * half * grid.slant_range - grid.standoff * c;
                const V higher = (grid.slant_range - grid.standoff) * s;
                origin = sum(azimuth, u, nearer, d, higher, v);
                direction = {c * d.x + s * v.x, c * d.y + s * v.y, c * d.z + s * v.z};
            } else
                origin = sum(azimuth, u, elevation, v, V(-grid.standoff), d);
            const P q = cross(direction, e2), o = difference(origin, p0);
            const V inverse = one / dot(e1, q), b1 = dot(o, q) * inverse, b2 = dot(direction, cross(o, e1)) * inverse;
            const V slope = dot(normal, direction), cosine = __builtin_elementwise_abs(slope);
            const V centre = slant_range_of(sum(one, p0, b1, e1, b2, e2));
            const V step = curved ? (centre + grid.slant_range) * grid.elevation_step : V(grid.elevation_step);
            const V weight = grid.azimuth_step * step / (cosine * grid.pixel_area);
            // where the ray's power falls in range: two boxes convolved, cut to [low, high]
            V middle = centre, wide = none, narrow = none, low = -1.0e30f, high = 1.0e30f;
            if (deposit == 1)
                wide = grid.range_spacing;
            if (deposit == 2) {
                const V per_u = -dot(normal, u) / slope * grid.azimuth_step;
                const V per_v = -dot(normal, cross(u, direction)) / slope * step;
                const V r0 = slant_range_of(p0), r1 = slant_range_of(ray.corner[1]), r2 = slant_range_of(ray.corner[2]);
                middle = centre - per_u * ray.across - per_v * ray.along;
                wide = most(__builtin_elementwise_abs(per_u), __builtin_elementwise_abs(per_v));
                narrow = least(__builtin_elementwise_abs(per_u), __builtin_elementwise_abs(per_v));
                low = least(least(r0, centre), least(r1, r2));
                high = most(most(r0, centre), most(r1, r2));
            }
            const V half = 0.5f * (wide + narrow);
            low = most(low, middle - half);
            high = least(high, middle + half);
            const V below = share_before(low - middle, wide, narrow), above = share_before(high - middle, wide, narrow);
            const V total = above - below;
            const I point = (wide < 1.0e-5f * grid.range_spacing) | (total < 1.0e-4f);
            low = point ? centre : low;
            high = point ? centre : high;
            // the rows that are met, and what falls into the first two
            const V lowest = __builtin_elementwise_floor((low - grid.range_start) / grid.range_spacing);
            const V highest = __builtin_elementwise_floor((high - grid.range_start) / grid.range_spacing);
            const auto share_of = [&](V row) -> V {
                const V edge = grid.range_start + row * grid.range_spacing;
                const V upper = share_before(least(high, edge + grid.range_spacing) - middle, wide, narrow);
                return (upper - share_before(most(low, edge) - middle, wide, narrow)) / total;
            };
            const I spread = high > low;
            const V shares[2] = {spread ? share_of(lowest) : one, spread ? share_of(lowest + 1.0f) : one};
            for (int lane = 0; lane < count; ++lane) {
                if (!(cosine[lane] > 1.0e-6f))
                    continue;
                const int first_row = wp::int32(lowest[lane]);
                const int last_row = wp::min(wp::int32(highest[lane]), grid.rows - 1);
                for (int row = wp::max(first_row, 0); row <= last_row; ++row) {
                    const int turn = row - first_row;
                    const float share = turn < 2 ? shares[turn][lane]
                        : spread[lane]           ? share_of(V(wp::float32(row)))[lane]
                                                 : 1.0f;
                    if (share > 0.0f)
                        add(row, met[lane], share * weight[lane], b1[lane], b2[lane]);
                }
            }
            count = 0;
        }
        if (run_row >= 0)
            leave(run_row, run_face, run_weight, run_moment1, run_moment2);
    }
"""


@wp.func_native(_NUMBERS + _POINTS + _RECORD)
def record_column(
    i: int,
    grid: RayGrid,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    face: wp.array(dtype=int),
    jitter_across: wp.array(dtype=float),
    jitter_along: wp.array(dtype=float),
    first_cell: int,
    deposit: int,
    face_bits: int,
    quanta: float,
    head: wp.array(dtype=int),
    link: wp.array(dtype=int),
    taken: wp.array(dtype=int),
    rows: wp.array2d(dtype=wp.int64),
): ...


@wp.kernel(enable_backward=False)
def record_kernel(
    # In:
    grid: RayGrid,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    face: wp.array(dtype=int),
    jitter_across: wp.array(dtype=float),
    jitter_along: wp.array(dtype=float),
    first_cell: int,
    deposit: int,
    face_bits: int,
    quanta: float,
    # Room, the next column's after this one's:
    head: wp.array(dtype=int),  # of a power of two
    link: wp.array(dtype=int),
    # Out:
    taken: wp.array(dtype=int),
    rows: wp.array2d(dtype=wp.int64),
):
    """One column of pixels. `rows` as `trace.Records` has them, but for the key, which is one less; `taken` of them, or
    so many as are sure to have room."""
    record_column(
        wp.tid(),
        grid,
        vertices,
        faces,
        face,
        jitter_across,
        jitter_along,
        first_cell,
        deposit,
        face_bits,
        quanta,
        head,
        link,
        taken,
        rows,
    )


_HITS = """
    typedef double D __attribute__((ext_vector_type(8)));
    const auto scaled = [](V a, P p) -> P { return {a * p.x, a * p.y, a * p.z}; };
    const auto length = [&](P p) -> V { return __builtin_elementwise_sqrt(dot(p, p)); };
    const auto normalized = [&](P p) -> P {
        const V l = length(p), none = 0.0f;
        const I some = l > 0.0f;
        return {some ? p.x / l : none, some ? p.y / l : none, some ? p.z / l : none};
    };

    const int n = pixel_out.shape[0], begin = 8 * block, count = wp::min(n - begin, 8);
    const wp::int64 mask = (wp::int64(1) << face_bits) - 1;
    int met[8];
    D sums[3];
    P corner[3];
    float* lanes = reinterpret_cast<float*>(corner);
    for (int lane = 0; lane < 8; ++lane) {
        const int i = begin + wp::min(lane, count - 1), next = wp::min(i + 16, n - 1), later = wp::min(i + 32, n - 1);
        __builtin_prefetch(rows.data + 4 * wp::int64(row.data[later]));
        __builtin_prefetch(faces.data + 3 * (key.data[later] & mask));
        for (int j = 0; j < 3; ++j)
            __builtin_prefetch(vertices.data + faces.data[3 * (key.data[next] & mask) + j]);
        met[lane] = wp::int32(key.data[i] & mask);
        for (int j = 0; j < 3; ++j) {
            sums[j][lane] = wp::float64(rows.data[4 * wp::int64(row.data[i]) + 1 + j]);
            for (int axis = 0; axis < 3; ++axis)
                lanes[24 * j + 8 * axis + lane] = vertices.data[faces.data[3 * met[lane] + j]].c[axis];
        }
    }
    const V b1 = __builtin_convertvector(sums[1] / sums[0], V), b2 = __builtin_convertvector(sums[2] / sums[0], V);
    const V weight = __builtin_convertvector(sums[0] / wp::float64(quanta), V);
    const P p0 = corner[0], e1 = difference(corner[1], p0), e2 = difference(corner[2], p0);
    const P point = {p0.x + b1 * e1.x + b2 * e2.x, p0.y + b1 * e1.y + b2 * e2.y, p0.z + b1 * e1.z + b2 * e2.z};
    const P normal = normalized(cross(e1, e2));
    P direction = d;
    if (grid.slant_range > 0.0f) {
        const P along = scaled(grid.slant_range + dot(point, d), d), across = scaled(dot(point, v), v);
        direction = normalized({along.x + across.x, along.y + across.y, along.z + across.z});
    }
    const auto bounded = [&](V a) -> V { return a < one ? a : one; };
    const V incidence = bounded(__builtin_elementwise_abs(dot(normal, direction)));
    // `geometry.cos_twist_of` and `geometry.cos2_azimuth_of`
    const P horizontal = cross(normal, direction);
    const V wide = length(horizontal);
    const V twist = wide < 1.0e-6f ? one : bounded(__builtin_elementwise_abs(dot(u, horizontal)) / wide);
    const P east = {-normal.y, normal.x, V(0.0f)};
    const I level = length(east) < 1.0e-6f;
    const P x = {level ? one : east.x, level ? V(0.0f) : east.y, V(0.0f)};
    const P down = difference(direction, scaled(dot(direction, normal), normal));
    const V azimuth = dot(normalized(down), normalized(x));
    const V azimuth2 = length(down) < 1.0e-6f ? one : azimuth * azimuth;
    for (int lane = 0; lane < count; ++lane) {
        const int i = begin + lane;
        pixel_out.data[i] = wp::int32(key.data[i] >> face_bits);
        face_out.data[i] = met[lane];
        barycentric_out.data[i] = {b1[lane], b2[lane]};
        weight_out.data[i] = weight[lane];
        point_out.data[i] = {point.x[lane], point.y[lane], point.z[lane]};
        cos_incidence_out.data[i] = incidence[lane];
        cos_twist_out.data[i] = twist[lane];
        cos2_azimuth_out.data[i] = azimuth2[lane];
    }
"""


@wp.func_native(_NUMBERS + _POINTS + _HITS)
def hit_block(
    block: int,
    grid: RayGrid,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    rows: wp.array2d(dtype=wp.int64),
    quanta: float,
    key: wp.array(dtype=wp.int64),
    row: wp.array(dtype=int),
    face_bits: int,
    pixel_out: wp.array(dtype=int),
    face_out: wp.array(dtype=int),
    barycentric_out: wp.array(dtype=wp.vec2),
    weight_out: wp.array(dtype=float),
    point_out: wp.array(dtype=wp.vec3),
    cos_incidence_out: wp.array(dtype=float),
    cos_twist_out: wp.array(dtype=float),
    cos2_azimuth_out: wp.array(dtype=float),
): ...


@wp.kernel(enable_backward=False)
def hit_kernel(
    # In:
    grid: RayGrid,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    rows: wp.array2d(dtype=wp.int64),
    quanta: float,
    key: wp.array(dtype=wp.int64),
    row: wp.array(dtype=int),
    face_bits: int,
    # Out:
    pixel_out: wp.array(dtype=int),
    face_out: wp.array(dtype=int),
    barycentric_out: wp.array(dtype=wp.vec2),
    weight_out: wp.array(dtype=float),
    point_out: wp.array(dtype=wp.vec3),
    cos_incidence_out: wp.array(dtype=float),
    cos_twist_out: wp.array(dtype=float),
    cos2_azimuth_out: wp.array(dtype=float),
):
    """`trace.hit_kernel`, LANES rows at once."""
    hit_block(
        wp.tid(),
        grid,
        vertices,
        faces,
        rows,
        quanta,
        key,
        row,
        face_bits,
        pixel_out,
        face_out,
        barycentric_out,
        weight_out,
        point_out,
        cos_incidence_out,
        cos_twist_out,
        cos2_azimuth_out,
    )
