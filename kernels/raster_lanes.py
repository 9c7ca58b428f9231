"""The nearest face of every ray on the CPU: faces in the order of the columns they lie in, each against eight rays.

The steps are those of kernels/raster.py, written out by kernels/lanes.py; loads, stores and loops are by hand. A launch
is serial here, so a ray keeps its nearest face without atomics.
"""

import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.geometry import Band, RayGrid, azimuth_of, elevation_of, jitter_of, plane_ray
from warpsar.kernels.raster import ProjectedVertices, distance_to, strip_of

# As in kernels/raster.py: two faces see their common edge alike only where no product is fused into a sum.
wp.set_module_options({"fuse_fp": False})

LANES = 8  # rays that are worked on at once


@wp.struct
class InColumns:
    """Faces in the order of the pixel columns in which they begin, from number `begin` of them on.

    `cells` of each face are those of `raster.extent_kernel`.
    """

    cells: wp.array(dtype=wp.vec4i)
    order: wp.array(dtype=int)
    begin: int


@wp.struct
class BandRays:
    """The rays of a band: azimuth [m], and what `geometry.PlaneRay` has; of plane waves `across` alone."""

    azimuth: wp.array(dtype=float)
    across: wp.array(dtype=float)
    along: wp.array(dtype=float)
    cosine: wp.array(dtype=float)
    sine: wp.array(dtype=float)


@wp.struct
class Nearest:
    """Of every ray of a band the face that lies nearest, or -1, and its distance [m]."""

    depth: wp.array(dtype=float)
    face: wp.array(dtype=int)


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


_START = lanes.source(LANES, dict.fromkeys((jitter_of, azimuth_of, elevation_of, plane_ray)))


@wp.func_native(
    _START
    + """
    const auto& azimuth_out = rays_out.azimuth;
    const auto& across_out = rays_out.across;
    const int first_cell = band.first_cell, seed = band.seed;
    // two loops, since a compiler finds vectors in the first alone
    const bool curved = grid.slant_range > 0.0f;
    const int begin = i * grid.elevation_cells;
    for (int k = 0; k < grid.elevation_cells; ++k) {
        const wp::vec_t<2, wp::float32> jitter = Lanes::jitter_of(grid, seed, first_cell + i, k);
        azimuth_out.data[begin + k] = Lanes::azimuth_of(grid, first_cell + i, jitter);
        across_out.data[begin + k] = Lanes::elevation_of(grid, k, jitter);
    }
    for (int at = begin; at < begin + grid.elevation_cells && curved; ++at) {
        const Lanes::PlaneRay ray = Lanes::plane_ray(grid, across_out.data[at]);
        across_out.data[at] = ray.across;
        rays_out.along.data[at] = ray.along;
        rays_out.cosine.data[at] = ray.cosine;
        rays_out.sine.data[at] = ray.sine;
    }
"""
)
def start_cell(i: int, grid: RayGrid, band: Band, rays_out: BandRays): ...


@wp.kernel(enable_backward=False)
def ray_kernel(
    # In:
    grid: RayGrid,
    band: Band,
    # Out:
    rays_out: BandRays,
):
    """The rays of one azimuth cell."""
    start_cell(wp.tid(), grid, band, rays_out)


_RASTER = """
    typedef Lanes::V V;
    typedef Lanes::I I;
    const auto& corner = mesh.corner;
    const auto& faces = mesh.faces;
    const auto& cells = sorted.cells;
    const auto& order = sorted.order;
    const int begin = sorted.begin, first_cell = band.first_cell, last_cell = band.end_cell - 1;
    const float slack = mesh.slack;
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
    const int* corners = faces.data + 3 * f;
    const wp::vec_t<4, float> a = corner.data[corners[0]], b = corner.data[corners[1]], c = corner.data[corners[2]];
    const bool slanted = first < last && box.c[2] + 16 < box.c[3];  // worth cutting into strips of one azimuth cell
    for (int cell = first; cell <= last; ++cell) {
        int bottom = box.c[2], top = box.c[3];
        if (slanted) {
            const wp::vec_t<2, wp::int32> strip = Lanes::strip_of(grid, a, b, c, cell, bottom, top, slack);
            bottom = strip.c[0];
            top = strip.c[1];
        }
        const int row = (cell - first_cell) * grid.elevation_cells;
        for (int k = bottom; k <= top; k += 8) {
            const int at = row + k;
            Lanes::PlaneRays ray = {-grid.standoff, load(rays.across, at), 1.0f, 0.0f};
            if (curved) {
                ray.along = load(rays.along, at);
                ray.cosine = load(rays.cosine, at);
                ray.sine = load(rays.sine, at);
            }
            const V distance = Lanes::distance_to(grid, a, b, c, load(rays.azimuth, at), ray);
            const I met = (lane <= top - k) & (distance < __builtin_inff());
            if (!Lanes::any(met))
                continue;
            V nearest_depth;
            I nearest_face;
            __builtin_memcpy(&nearest_depth, nearest_out.depth.data + at, sizeof(V));
            __builtin_memcpy(&nearest_face, nearest_out.face.data + at, sizeof(I));
            // of two at one distance the first: a matter of the mesh, not of the order they come in
            const I first_of_two = (distance == nearest_depth) & (f < nearest_face);
            const I nearer = met & ((distance < nearest_depth) | first_of_two);
            nearest_depth = nearer ? distance : nearest_depth;
            nearest_face = nearer ? I(f) : nearest_face;
            __builtin_memcpy(nearest_out.depth.data + at, &nearest_depth, sizeof(V));
            __builtin_memcpy(nearest_out.face.data + at, &nearest_face, sizeof(I));
        }
    }
"""


@wp.func_native(lanes.source(LANES, {distance_to: ("grid", "a", "b", "c"), strip_of: None}) + _RASTER)
def raster_face(
    i: int, grid: RayGrid, mesh: ProjectedVertices, sorted: InColumns, band: Band, rays: BandRays, nearest_out: Nearest
): ...


@wp.kernel(enable_backward=False)
def raster_kernel(
    # In:
    grid: RayGrid,
    mesh: ProjectedVertices,
    sorted: InColumns,
    band: Band,
    rays: BandRays,
    # In and out:
    nearest: Nearest,
):
    """One face against the rays whose cells it may touch, LANES at once; a launch on the CPU is serial, so nothing is
    atomic. Every array of rays has LANES more than there are. Edges and distances as in `raster.distance_to`."""
    raster_face(wp.tid(), grid, mesh, sorted, band, rays, nearest)
