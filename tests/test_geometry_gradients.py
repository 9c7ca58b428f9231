"""Gradients to the mesh's vertices: of what a ray meets, and of an image through the linear deposit."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import warp as wp
from worlds import SOIL, axes, cos_twist, ground, mesh_of, scene_of, sigma0, view

import warpsar
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
from warpsar.render.geometry_image import GeometryImage
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import hit_grid, view_seed
from warpsar.surface.stage import Stage
from warpsar.world.mesh import Mesh
from warpsar.world.world import geometry_of

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


# ---- an image ----

GROUND_CELLS = 6


def bumpy(layout: str = "uniform", slant_range_m: float | None = None) -> Scene:
    """A bumpy plate that reaches beyond the image: no outline, no shadow, every pixel lit."""
    vertices, faces = ground(30, cells=GROUND_CELLS)
    vertices = vertices + np.random.default_rng(5).normal(size=vertices.shape) * (0.2, 0.2, 0.3)
    mesh = mesh_of(soil=(vertices, faces))
    materials: dict[str, Any] = {"soil": SOIL}
    if layout == "vertex":
        eps = 4 + 3 * np.random.default_rng(6).random(len(vertices))
        mesh = Mesh(vertices, mesh.faces, mesh.face_material, ("soil",), vertex_scalars={"wet": eps})
        materials = {"soil": {**SOIL, "layout": "vertex", "eps_r": "wet"}}
    return scene_of(
        mesh, view(25, 40), shape=(16, 16), rays_per_pixel=36, materials=materials, slant_range_m=slant_range_m
    )


def geometry_image(scene: Scene, device: str, seed: int = 0) -> GeometryImage:
    stage = Stage.of(scene, devices.resolve_device(device))
    return GeometryImage(
        stage,
        geometry_of(scene, scene.views[0]),
        hit_grid(scene),
        scene.sampling.density_per_m2(scene.grid),
        seed=seed,
    )


@pytest.mark.parametrize("slant_range_m", [None, 120.0])
def test_geometry_image_is_the_linear_deposit(slant_range_m: float | None, device: str) -> None:
    """Unmoved, it is the image of the plain path, but for rays from just outside of the image's rows."""
    scene = bumpy(slant_range_m=slant_range_m)
    linear = scene.sampling.model_copy(update={"deposit": "linear"})
    plain = warpsar.simulate(replace(scene, sampling=linear), device=device, merge=False)[0].beta0["HH"]
    image = geometry_image(scene, device, view_seed(0, 0)).forward()
    # a ray's place is found again from its hit, to 1e-6 m of a pixel of 0.5 m
    np.testing.assert_allclose(image[1:-1], plain[1:-1], rtol=1e-4)


@pytest.mark.parametrize("slant_range_m", [None, 120.0])
@pytest.mark.parametrize("layout", ["uniform", "vertex"])
def test_image_gradient_to_vertices(layout: str, slant_range_m: float | None, device: str) -> None:
    """Against central differences of a smooth functional of the image, along random directions."""
    scene = bumpy(layout, slant_range_m)
    image = geometry_image(scene, device)
    base = image.forward()
    row, col = np.meshgrid(*(np.linspace(-1, 1, 16) for _ in range(2)), indexing="ij")
    # vanishes at the first and last row: rays that leave the image leave smoothly
    weight = np.cos(np.pi / 2 * row) ** 2 * (1 + 0.5 * np.sin(3 * row + 2 * col)) / base.mean()
    gradient = image.gradient(weight)
    at = image.vertices.numpy().copy()
    rng = np.random.default_rng(9)
    for _ in range(6):
        direction = rng.normal(size=at.shape)
        direction /= np.linalg.norm(direction)
        # all vertices together, each by some 5 mm: float32 sums of 1e-7, corners of a function linear in pieces of
        # 0.5 m, rounded by 9000 rays
        step = 5e-3 * np.sqrt(at.size)
        values = []
        for sign in (1, -1):
            image.vertices.assign((at + sign * step * direction).astype(np.float32))
            values.append((image.forward() * weight).sum(dtype=float))
        difference = (values[0] - values[1]) / (2 * step)
        # of the length that such a direction has on average
        scale = np.linalg.norm(gradient) / np.sqrt(at.size)
        assert (gradient * direction).sum() == pytest.approx(difference, rel=2e-3, abs=2e-3 * scale)
    assert np.abs(gradient).max(axis=0).min() > 0


def test_gradient_of_a_raised_plate_is_known() -> None:
    """A ray that stays meets a plate raised by dz nearer by dz / cos(incidence), at the same incidence.

    So sum(w beta0) changes by the slopes of w times the power, along the rows and, by half a row, out of the image.
    """
    scene = scene_of(mesh_of(soil=ground(40)), view(0, 40), shape=(32, 16), rays_per_pixel=64)
    image = geometry_image(scene, "cpu")
    image.forward()
    weight = np.linspace(1.0, 4.0, 32)
    gradient = image.gradient(np.tile(weight[:, None], (1, 16))).sum(axis=0)
    theta = np.deg2rad(40.0)
    slopes = (weight[-1] - weight[0] + 0.5 * weight[0] - 0.5 * weight[-1]) / 0.5 * 16
    # the power in the outer half rows is that of a few rays' jitter
    expected = -slopes * sigma0(theta) / np.sin(theta) / np.cos(theta)
    assert gradient[2] == pytest.approx(expected, rel=0.01)
    # moving it sideways in its own plane does nothing
    assert np.abs(gradient[:2]).max() < 1e-4 * abs(expected)


def test_gradient_to_the_surface_comes_with_it() -> None:
    """sigma0 of the small-perturbation term goes as h^2."""
    scene = bumpy()
    image = geometry_image(scene, "cpu")
    image.forward()
    image.gradient(np.ones(image.shape))
    ln_h = 1
    assert image.nodes.grad.numpy()[ln_h] == pytest.approx(2 * image.forward().sum(), rel=1e-3)
