"""Gradients of what a ray meets to the mesh's vertices."""

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp
from worlds import axes, cos_twist

from warpsar.kernels.geometry import (
    RayGrid,
    cos2_azimuth_of,
    cos_twist_of,
    intersect,
    look_direction,
    ray_direction,
    ray_origin,
    slant_range_of,
)

pytestmark = pytest.mark.unit

QUANTITIES = 11


@wp.kernel
def facet_kernel(
    grid: RayGrid,
    azimuth: wp.array(dtype=float),
    elevation: wp.array(dtype=float),
    vertices: wp.array(dtype=wp.vec3),
    out: wp.array2d(dtype=float),
):
    """Everything a ray learns from the three vertices of its face."""
    i = wp.tid()
    origin = ray_origin(grid, azimuth[i], elevation[i])
    direction = ray_direction(grid, elevation[i])
    p0 = vertices[3 * i]
    p1 = vertices[3 * i + 1]
    p2 = vertices[3 * i + 2]
    hit = intersect(origin, direction, p0, p1, p2)
    point = p0 + hit.b1 * (p1 - p0) + hit.b2 * (p2 - p0)
    look = look_direction(grid, point)
    out[i, 0] = hit.distance
    out[i, 1] = hit.b1
    out[i, 2] = hit.b2
    out[i, 3] = hit.normal[0]
    out[i, 4] = hit.normal[1]
    out[i, 5] = hit.normal[2]
    out[i, 6] = slant_range_of(grid, point)
    out[i, 7] = wp.abs(wp.dot(hit.normal, look))
    out[i, 8] = cos_twist_of(hit.normal, look, grid.u)
    out[i, 9] = cos2_azimuth_of(hit.normal, look)
    out[i, 10] = wp.dot(look, grid.v)


def facet_quantities(
    corners: np.ndarray, azimuth: float, elevation: float, slant_range: float, standoff: float
) -> np.ndarray:
    """The same in NumPy, float64, by the plane's equation and areas instead of Moeller and Trumbore."""
    d, u, v = axes(30, 40)
    if slant_range:
        direction = np.cos(elevation) * d + np.sin(elevation) * v
        origin = azimuth * u - slant_range * d + (slant_range - standoff) * direction
    else:
        direction, origin = d, azimuth * u + elevation * v - standoff * d
    p0, p1, p2 = corners
    n = np.cross(p1 - p0, p2 - p0)
    t = n @ (p0 - origin) / (n @ direction)
    point = origin + t * direction
    b1 = np.cross(point - p0, p2 - p0) @ n / (n @ n)
    b2 = np.cross(p1 - p0, point - p0) @ n / (n @ n)
    normal = n / np.linalg.norm(n)
    along = np.hypot(slant_range + point @ d, point @ v) - slant_range if slant_range else point @ d
    x = np.cross((0, 0, 1), normal)
    flat = direction - (direction @ normal) * normal
    cos2 = (flat @ x) ** 2 / (flat @ flat) / (x @ x)
    return np.array(
        [t, b1, b2, *normal, along, abs(normal @ direction), cos_twist(normal, direction, u), cos2, direction @ v]
    )


def jacobian(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Central differences of a float64 function, shape (outputs, *at.shape)."""
    columns = []
    for k in range(at.size):
        move = np.zeros(at.size)
        move[k] = step
        move = move.reshape(at.shape)
        columns.append((function(at + move) - function(at - move)) / (2 * step))
    return np.stack(columns, -1).reshape(-1, *at.shape)


@pytest.mark.parametrize("slant_range", [0.0, 150.0])
def test_facet(slant_range: float, device: str) -> None:
    """Values and derivatives of t, barycentrics, normal, range, incidence and twist to each vertex of 24 facets."""
    rng = np.random.default_rng(3)
    d, u, v = axes(30, 40)
    grid = RayGrid()
    grid.d, grid.u, grid.v = wp.vec3(*d), wp.vec3(*u), wp.vec3(*v)
    grid.slant_range, grid.standoff = slant_range, 25.0
    n = 24
    corners = np.array([[-1.0, -1.0, 0.0], [2.0, -0.5, 0.5], [0.0, 2.0, 0.3]]) + rng.normal(scale=0.2, size=(n, 3, 3))
    corners += rng.uniform(-5, 5, size=(n, 1, 3))
    corners = corners.astype(np.float32).astype(float)
    inside = np.einsum("nk,nkj->nj", rng.dirichlet((2, 2, 2), n), corners)
    azimuth = (inside @ u).astype(np.float32)
    across = inside @ v
    if slant_range:
        across = np.arctan2(across, slant_range + inside @ d)
    elevation = across.astype(np.float32)

    vertices = wp.array(corners.reshape(-1, 3).astype(np.float32), dtype=wp.vec3, device=device, requires_grad=True)
    out = wp.zeros((n, QUANTITIES), dtype=float, device=device, requires_grad=True)
    with wp.Tape() as tape:
        wp.launch(
            facet_kernel,
            n,
            inputs=[grid, wp.array(azimuth, device=device), wp.array(elevation, device=device), vertices],
            outputs=[out],
            device=device,
        )
    found = np.zeros((n, QUANTITIES, 3, 3))
    for quantity in range(QUANTITIES):
        seed = np.zeros((n, QUANTITIES), np.float32)
        seed[:, quantity] = 1
        tape.backward(grads={out: wp.array(seed, device=device)})
        found[:, quantity] = vertices.grad.numpy().reshape(n, 3, 3)
        tape.zero()
    for i in range(n):

        def quantities(p: np.ndarray, i: int = i) -> np.ndarray:
            return facet_quantities(p, float(azimuth[i]), float(elevation[i]), slant_range, 25.0)

        # float32: 1e-7 of 25 m of distance is 3e-6 m, the largest of the values; divided by edges of 2 m
        np.testing.assert_allclose(out.numpy()[i], quantities(corners[i]), rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(found[i], jacobian(quantities, corners[i]), rtol=1e-3, atol=2e-4)
