"""Vertices -> image for rays whose faces are known: the forward model as a smooth function of the geometry."""

import warp as wp

from warpsar.kernels.geometry import (
    RayGrid,
    cos2_azimuth_of,
    cos_twist_of,
    direction_of,
    elevation_step_at,
    intersect,
    origin_of,
    plane_ray,
    point_on,
    slant_range_of,
)
from warpsar.kernels.shade import coordinates_at, sigma0_of


# Long because of its arguments: sigma0 depends on all of them.
@wp.kernel
def geometry_image_kernel(
    # In:
    grid: RayGrid,
    azimuth: wp.array(dtype=float),
    elevation: wp.array(dtype=float),
    face: wp.array(dtype=int),
    column: wp.array(dtype=int),
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    face_material: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    places: wp.array2d(dtype=wp.vec4i),
    nodes: wp.array(dtype=float),
    polarization: int,
    variant: int,
    wavenumber: float,
    local_basis: int,
    spectrum: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    aspect: wp.array(dtype=float),
    # Out:
    image_out: wp.array(dtype=float),
):
    """beta0 of one ray, split linearly between the two nearest rows: its slope in range is that of the power."""
    i = wp.tid()
    f = face[i]
    ray = plane_ray(grid, elevation[i])
    origin = origin_of(grid, azimuth[i], ray)
    direction = direction_of(grid, ray)
    p0 = vertices[faces[f, 0]]
    p1 = vertices[faces[f, 1]]
    p2 = vertices[faces[f, 2]]
    hit = intersect(origin, direction, p0, p1, p2)
    b = wp.vec3(1.0 - hit.b1 - hit.b2, hit.b1, hit.b2)
    point = point_on(p0, p1, p2, hit.b1, hit.b2)
    cos_incidence = wp.abs(wp.dot(hit.normal, direction))

    material = face_material[f]
    zeta = coordinates_at(f, b, faces, face_material, uv, places, nodes)
    twist = float(1.0)
    if local_basis == 0:
        twist = cos_twist_of(hit.normal, direction, grid.u)
    sigma = sigma0_of(
        polarization,
        spectrum[material],
        variant,
        wavenumber,
        cos_incidence,
        twist,
        cos2_azimuth_of(hit.normal, direction),
        eps_im[material],
        aspect[material],
        zeta,
    )

    slant_range = slant_range_of(grid, point)
    step = elevation_step_at(grid, slant_range)
    power = sigma * grid.azimuth_step * step / (cos_incidence * grid.pixel_area)
    place = (slant_range - grid.range_start) / grid.range_spacing - 0.5
    row = int(wp.floor(place))
    after = place - wp.floor(place)
    if row >= 0 and row < grid.rows:
        wp.atomic_add(image_out, row * grid.cols + column[i], power * (1.0 - after))
    if row + 1 >= 0 and row + 1 < grid.rows:
        wp.atomic_add(image_out, (row + 1) * grid.cols + column[i], power * after)
