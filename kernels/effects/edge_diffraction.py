"""Power that sharp edges return."""

import warp as wp

from warpsar.kernels.geometry import RayGrid, look_direction, slant_range_of


@wp.struct
class EdgePieces:
    """Short pieces of edges."""

    place: wp.array(dtype=wp.vec3)  # [m]
    along: wp.array(dtype=wp.vec3)  # direction of the edge
    outward: wp.array(dtype=wp.vec3)  # away from the wedge's matter
    length: wp.array(dtype=float)  # [m]


@wp.kernel(enable_backward=False)
def edge_kernel(
    # In:
    grid: RayGrid,  # its bins are those of the hits
    azimuth_spacing: float,
    mesh: wp.uint64,
    size: float,  # of the mesh [m]
    wavelength: float,
    pieces: EdgePieces,
    # Out:
    bin_out: wp.array(dtype=int),  # -1 where it is hidden or beside the image
    weight_out: wp.array(dtype=float),
):
    """For a short piece of edge: its bin if the radar sees it, and its length times lambda / (2 pi) sin^2(b)."""
    i = wp.tid()
    place = pieces.place[i]
    direction = look_direction(grid, place)
    across = wp.cross(pieces.along[i], direction)
    row = int(wp.floor((slant_range_of(grid, place) - grid.range_start) / grid.range_spacing))
    col = int(wp.floor((wp.dot(place, grid.u) - grid.azimuth_start) / azimuth_spacing))
    bin_out[i] = -1
    weight_out[i] = wavelength / (2.0 * wp.pi) * wp.dot(across, across) * pieces.length[i] / grid.pixel_area
    if row >= 0 and row < grid.rows and col >= 0 and col < grid.cols:
        start = place + 1.0e-4 * size * pieces.outward[i]
        query = wp.mesh_query_ray(mesh, start, -direction, size)
        if not query.result:
            bin_out[i] = row * grid.cols + col


@wp.kernel
def strength_kernel(
    # In:
    p: wp.array(dtype=float),  # strength
    # Out:
    sigma_out: wp.array(dtype=float),
):
    i = wp.tid()
    sigma_out[i] = p[0]
