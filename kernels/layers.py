"""What lies in a pixel beside its power: how often the surface folds into it, and what stays hidden."""

import warp as wp

from warpsar.kernels.geometry import (
    RayGrid,
    Triangles,
    direction_of,
    intersect,
    origin_of,
    plane_ray,
    point_on,
    slant_range_of,
)

wp.set_module_options({"max_unroll": 1})  # sixteen copies of a BVH query would take seconds to compile

HIDDEN_SURFACES = wp.constant(16)  # surfaces behind the first that a ray looks for


@wp.kernel(enable_backward=False)
def layers_kernel(
    # In:
    grid: RayGrid,
    mesh: Triangles,
    tree: wp.uint64,
    first_cell: int,
    # Out:
    visits_out: wp.array(dtype=float),
    hidden_out: wp.array(dtype=int),
):
    """One thread walks a whole azimuth cell, from the far edge of the fan of rays to the near one.

    `visits_out` grows by 1 / cells_per_column each time the lit surface enters a pixel; `hidden_out` is 1 where a
    surface lies behind another one.
    """
    i = wp.tid()
    cell = first_cell + i
    column = cell // grid.cells_per_column
    azimuth = grid.azimuth_start + (float(cell) + 0.5) * grid.azimuth_step
    last_row = int(-1)
    for k in range(grid.elevation_cells):
        elevation = grid.elevation_start + (float(k) + 0.5) * grid.elevation_step
        ray = plane_ray(grid, elevation)
        origin = origin_of(grid, azimuth, ray)
        direction = direction_of(grid, ray)
        from_distance = float(0.0)
        row = int(-1)
        for surface in range(HIDDEN_SURFACES):
            if from_distance >= 0.0:
                query = wp.mesh_query_ray(tree, origin + from_distance * direction, direction, grid.reach)
                if query.result:
                    p0 = mesh.vertices[mesh.faces[query.face, 0]]
                    p1 = mesh.vertices[mesh.faces[query.face, 1]]
                    p2 = mesh.vertices[mesh.faces[query.face, 2]]
                    hit = intersect(origin, direction, p0, p1, p2)
                    point = point_on(p0, p1, p2, hit.b1, hit.b2)
                    at = int(wp.floor((slant_range_of(grid, point) - grid.range_start) / grid.range_spacing))
                    inside = at >= 0 and at < grid.rows
                    if surface == 0:
                        row = at
                        if inside and at != last_row:
                            share = 1.0 / float(grid.cells_per_column)
                            wp.atomic_add(visits_out, at * grid.cols + column, share)
                    elif inside:
                        hidden_out[at * grid.cols + column] = 1
                    # past this surface by more than the rounding of a distance
                    from_distance = hit.distance + 1.0e-5 * grid.reach
                else:
                    from_distance = -1.0
        last_row = row
