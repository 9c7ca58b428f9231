"""Gradients to the mesh's vertices: of what a ray meets, and of an image through the linear deposit."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import warp as wp
from worlds import BRICK, SOIL, axes, cos_twist, ground, mesh_of, scene_of, sigma0, view

from warpsar import runtime
from warpsar.frame import geometry_of
from warpsar.geometry_image import GeometryImage
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
from warpsar.mesh import Mesh
from warpsar.render import Stage
from warpsar.scene import Scene
from warpsar.simulation import hit_grid

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


def geometry_image(scene: Scene, device: str) -> GeometryImage:
    stage = Stage.of(scene, runtime.resolve_device(device))
    return GeometryImage(
        stage, geometry_of(scene, scene.views[0]), hit_grid(scene), scene.sampling.density_per_m2(scene.grid)
    )


@pytest.mark.parametrize("slant_range_m", [None, 120.0])
def test_geometry_image_is_the_linear_deposit(slant_range_m: float | None, device: str) -> None:
    """Unmoved, it is the image of the plain path, but for rays from just outside of the image's rows."""
    import warpsar

    scene = bumpy(slant_range_m=slant_range_m)
    linear = scene.sampling.model_copy(update={"deposit": "linear"})
    from dataclasses import replace

    plain = warpsar.simulate(replace(scene, sampling=linear), device=device, merge=False)[0].beta0["HH"]
    image = geometry_image(scene, device)
    # another seed: the jitter of 36 rays leaves some 2 % in a pixel
    np.testing.assert_allclose(image.forward()[1:-1], plain[1:-1], rtol=0.15)
    assert image.forward()[1:-1].mean() == pytest.approx(plain[1:-1].mean(), rel=3e-3)


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
    at = image.vertices.numpy()
    rng = np.random.default_rng(9)
    for _ in range(6):
        direction = rng.normal(size=at.shape)
        direction /= np.linalg.norm(direction)
        # The image is piecewise linear in a ray's range, with 9000 rays to smooth its corners; a step of 4 mm against
        # pixels of 0.5 m, and sums of float32 of 1e-6: about 0.3 % between them.
        step = 4e-3 * np.sqrt(len(at))
        values = []
        for sign in (1, -1):
            image.vertices.assign((at + sign * step * direction).astype(np.float32))
            values.append((image.forward() * weight).sum(dtype=float))
        image.vertices.assign(at)
        difference = (values[0] - values[1]) / (2 * step)
        assert (gradient * direction).sum() == pytest.approx(
            difference, rel=0.01, abs=3e-3 * np.linalg.norm(gradient) / np.sqrt(at.size) * 3
        )


def test_gradient_of_a_raised_plate_is_known() -> None:
    """Raising all of a plate moves its image toward near range at cos(incidence), and changes nothing else.

    So for power P(range) the functional sum(w P) changes by -cos(incidence) * dw/drange * P.
    """
    scene = scene_of(mesh_of(soil=ground(40)), view(0, 40), shape=(32, 16), rays_per_pixel=64)
    image = geometry_image(scene, "cpu")
    image.forward()
    ramp = np.zeros((32, 16))
    ramp[8:24] = np.arange(16)[:, None] / 16  # and back to 0 over the last step
    gradient = image.gradient(ramp).sum(axis=0)
    theta = np.deg2rad(40.0)
    value = sigma0(theta) / np.sin(theta)
    # the ramp's sum over its slopes: rises by 15/16 over 15 rows and falls by 15/16 in one; a wave of constant power
    # passes through unchanged, so the whole is zero for a uniform plate ...
    assert abs(gradient[2]) < 2e-3 * value * 16 * 16 / 0.5
    # ... while raising it under a ramp that ends outside of the lit rows is not: use the last rows' slope alone
    rising = np.tile(np.arange(32.0)[:, None], (1, 16))
    rising[[0, -1]] = rising[[1, -2]]
    gradient = image.gradient(rising).sum(axis=0)
    slopes = 29 * value * 16 / 0.5  # 29 rows' steps of 1 per 0.5 m, 16 columns
    assert gradient[2] == pytest.approx(-np.cos(theta) * slopes, rel=0.02)
    # moving it sideways in its own plane does nothing
    assert abs(gradient[0]) < 1e-3 * slopes


def test_brick_is_not_soil() -> None:
    """The functional's gradient to the surface comes with it: nodes have gradients too."""
    scene = bumpy()
    image = geometry_image(scene, "cpu")
    image.forward()
    image.gradient(np.ones(image.shape))
    ln_h = 1
    # sigma0 of the small-perturbation term goes as h^2
    assert image.nodes.grad.numpy()[ln_h] == pytest.approx(2 * image.forward().sum(), rel=1e-3)
    assert BRICK != SOIL
