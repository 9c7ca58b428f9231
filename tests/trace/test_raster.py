"""The nearest face of each ray, found face by face: against float64 arithmetic, the BVH, and what must not matter."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from worlds import axes, box, ground, join, mesh_of, plate

from warpsar.runtime import devices
from warpsar.trace.hits import BinGrid
from warpsar.trace.rays import ray_grid
from warpsar.trace.target import Target
from warpsar.trace.trace import ParallelRaster, Raster, nearest_faces
from warpsar.world.frame import ViewGeometry, view_geometry
from warpsar.world.mesh import Mesh

PLANE, TRACK = None, 900.0  # R0 [m] of a wave that is plane, and of a track whose rays turn by degrees over the scene

# Each kind of raster with a device that it runs on: the parallel one's steps are the same where they come in turn.
SERIAL, PARALLEL = (Raster, "cpu"), (ParallelRaster, "cpu")
KINDS = [
    pytest.param(SERIAL, id="serial"),
    pytest.param(PARALLEL, id="parallel"),
    pytest.param((ParallelRaster, "cuda"), id="cuda", marks=pytest.mark.cuda),
]


def prepared(
    mesh: Mesh,
    slant_range_m: float | None,
    *,
    shape: tuple[int, int] = (40, 30),
    rays_per_m2: float = 9.0,
    device: str = "cpu",
) -> tuple[Target, ViewGeometry, Any]:
    target = Target.upload(mesh, np.zeros(3), devices.resolve_device(device))
    geometry = replace(view_geometry(25.0, 40.0, 9.6e9), slant_range_m=slant_range_m)
    grid = BinGrid(shape, (1.0, 1.0))
    return target, geometry, ray_grid(target, geometry, grid, rays_per_m2, 1.0)


def all_faces(kind: Any, target: Target, rays: Any, seed: int = 0) -> np.ndarray:
    return np.asarray(kind[0](target, rays).nearest(rays.first_cell, rays.end_cell, seed).numpy())


def samples(target: Target, rays: Any, seed: int = 0) -> np.ndarray:
    """Azimuth and elevation of every ray, as the query by the BVH draws them; shape (rays, 2)."""
    import warp as wp

    from warpsar.kernels.raster import sample_kernel

    cells = rays.end_cell - rays.first_cell
    found: Any = wp.empty(cells * rays.elevation_cells, dtype=wp.vec2, device=target.device)
    wp.launch(sample_kernel, cells, inputs=[rays, rays.first_cell, seed], outputs=[found], device=target.device)
    return found.numpy().astype(np.float64)


def soup(count: int) -> Mesh:
    """Triangles of all sizes and slopes, large ones through small ones."""
    rng = np.random.default_rng(3)
    size = rng.choice([0.3, 2, 8], (count, 1, 1))
    corners = rng.uniform(-11, 11, (count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    return mesh_of(soup=(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)))


@pytest.mark.full
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("slant_range_m", [PLANE, TRACK])
def test_nearest_of_a_soup(slant_range_m: float | None, kind: Any) -> None:
    """Every ray against every triangle in float64, by determinants of (edge, edge, ray)."""
    mesh = soup(150)
    target, _, rays = prepared(mesh, slant_range_m, device=kind[1])
    found = all_faces(kind, target, rays)
    azimuth, elevation = samples(target, rays).T
    d, u, v = axes(25.0, 40.0)
    if slant_range_m is None:
        direction = np.broadcast_to(d, (len(azimuth), 3))
        origin = azimuth[:, None] * u + elevation[:, None] * v - 100.0 * d
    else:
        direction = np.cos(elevation)[:, None] * d + np.sin(elevation)[:, None] * v
        origin = azimuth[:, None] * u - slant_range_m * d
    a, b, c = (np.asarray(mesh.vertices, np.float64)[mesh.faces[:, k]] for k in range(3))
    columns = np.stack([np.broadcast_to((b - a)[None], (len(origin), *a.shape)),
                        np.broadcast_to((c - a)[None], (len(origin), *a.shape)),
                        np.broadcast_to(-direction[:, None], (len(origin), *a.shape))], -1)  # fmt: skip
    weights = np.linalg.solve(columns, (origin[:, None] - a[None])[..., None])[..., 0]
    inside = np.minimum(weights[..., :2].min(-1), 1 - weights[..., :2].sum(-1))
    distance = np.where(inside >= 0, weights[..., 2], np.inf)
    expected = np.where(np.isfinite(distance.min(1)), distance.argmin(1), -1)
    # A ray within 1e-5 of a triangle's own size of an edge may fall on either side in float32, and so may the order of
    # two faces nearer than 0.1 mm where they cut one another.
    two = np.sort(distance, axis=1)[:, :2]
    clear = (np.abs(inside).min(1) > 1e-5) & ~(two[:, 1] < two[:, 0] + 1e-4)
    assert clear.mean() > 0.98
    np.testing.assert_array_equal(found[clear], expected[clear])
    assert len(np.unique(found)) > 50
    assert 0.02 < np.mean(found < 0) < 0.9


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("slant_range_m", [PLANE, TRACK])
def test_as_the_bvh(slant_range_m: float | None, kind: Any) -> None:
    """Closed buildings on fine ground: rays that differ lie on edges, where two faces are right."""
    mesh = mesh_of(soil=ground(26, cells=60), brick=box((-4, -3, 0), (5, 2, 6)), tower=box((-8, 4, 0), (-5.5, 6, 9)))
    target, _, rays = prepared(mesh, slant_range_m, rays_per_m2=200.0, device=kind[1])
    found = all_faces(kind, target, rays, seed=5)
    expected = nearest_faces(target, rays, rays.first_cell, rays.end_cell, 5).numpy()
    assert found.shape == expected.shape
    # an edge is some 1e-6 of a cell wide in float32; there are about ten cells' edges to a ray's own cell
    assert np.mean(found != expected) < 1e-4
    assert np.mean(expected >= 0) > 0.3


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("slant_range_m", [PLANE, TRACK])
def test_no_ray_passes_between_faces(slant_range_m: float | None, kind: Any) -> None:
    """Thin triangles about one vertex, crossed by a million rays, of which none may fall through."""
    angle = np.linspace(0, 2 * np.pi, 721)[:-1]
    rim = np.stack([30 * np.cos(angle), 30 * np.sin(angle), np.sin(9 * angle)], 1)
    at = np.arange(720)
    fan = (np.vstack([rim, [[0.1, 0.2, 0.3]]]), np.stack([at, (at + 1) % 720, np.full(720, 720)], 1))
    target, _, rays = prepared(mesh_of(fan=fan), slant_range_m, shape=(16, 16), rays_per_m2=1500.0, device=kind[1])
    found = all_faces(kind, target, rays)
    azimuth, elevation = samples(target, rays).T
    if slant_range_m is not None:
        elevation = slant_range_m * np.tan(elevation)
    # rays that certainly meet the fan: within 8 m of its middle
    through = np.hypot(azimuth, elevation) < 8
    assert through.sum() > 200_000
    assert (found[through] >= 0).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("slant_range_m", [PLANE, TRACK])
def test_bands_do_not_matter(slant_range_m: float | None, kind: Any) -> None:
    target, _, rays = prepared(soup(80), slant_range_m, device=kind[1])
    raster = kind[0](target, rays)
    first, last = rays.first_cell, rays.end_cell
    cuts = [first, first + 1, first + 7, (first + last) // 2, last]
    parts = [raster.nearest(a, b, 2).numpy() for a, b in pairwise(cuts)]
    np.testing.assert_array_equal(np.concatenate(parts), raster.nearest(first, last, 2).numpy())


@pytest.mark.parametrize("kind", KINDS)
def test_the_first_of_two_equal_faces(kind: Any) -> None:
    sheet = plate((-5, -5, 0), (10, 0, 0), (0, 10, 0))
    target, _, rays = prepared(mesh_of(one=join([sheet, sheet])), PLANE, device=kind[1])
    assert set(np.unique(all_faces(kind, target, rays))) == {-1, 0, 1}


SCENES = {
    "soup": (soup(200), 9.0),
    "two large faces": (mesh_of(soil=plate((-9, -9, 0), (18, 0, 0), (0, 18, 0))), 900.0),
    # one edge of the plate is along the look direction
    "edge-on": (mesh_of(soil=ground(12, cells=9), wall=plate((-6, -3, 4), axes(25.0, 40.0)[0] * 5, (0, 4, 0))), 90.0),
    "small among large": (mesh_of(soil=ground(26, cells=60), brick=box((-4, -3, 0), (5, 2, 6))), 300.0),
}


@pytest.mark.parametrize("kind", KINDS[1:])
@pytest.mark.parametrize("slant_range_m", [PLANE, TRACK])
@pytest.mark.parametrize(("name", "groups"), [(name, 7) for name in SCENES] + [("soup", 2**17)])
def test_parallel_as_serial(
    name: str, groups: int, slant_range_m: float | None, kind: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Faces of all sizes, each in whatever order: what the raster that takes one after the other finds, every time;
    many strips to one group of threads, and one."""
    monkeypatch.setattr("warpsar.trace.trace._GROUPS", groups)
    mesh, rays_per_m2 = SCENES[name]
    target, _, rays = prepared(mesh, slant_range_m, rays_per_m2=rays_per_m2)
    expected = all_faces(SERIAL, target, rays, seed=7)
    assert len(np.unique(expected)) > 2
    target, _, rays = prepared(mesh, slant_range_m, rays_per_m2=rays_per_m2, device=kind[1])
    found = all_faces(kind, target, rays, seed=7)
    np.testing.assert_array_equal(found, all_faces(kind, target, rays, seed=7))
    if slant_range_m is None or kind == PARALLEL:
        np.testing.assert_array_equal(found, expected)
    else:  # sines and cosines of CUDA's own, the last bit apart: rays on edges
        assert np.mean(found != expected) < 1e-4


@pytest.mark.parametrize("kind", [Raster, ParallelRaster])
def test_it_pays_with_rays_and_not_with_faces(kind: Any) -> None:
    """Few rays through many faces, or many sheets one behind the other, are better sent through the BVH."""
    mesh = mesh_of(soil=ground(26, cells=150))
    target, _, many = prepared(mesh, PLANE, rays_per_m2=900.0)
    assert kind.where_it_pays(target, many, many.first_cell, many.end_cell)
    target, _, few = prepared(mesh, PLANE, rays_per_m2=1.0)
    assert kind.where_it_pays(target, few, few.first_cell, few.end_cell) is None
    sheets = join([plate((-9, -9, z), (18, 0, 0), (0, 18, 0)) for z in np.linspace(0, 1, 60)])
    target, _, deep = prepared(mesh_of(sheets=sheets), PLANE, rays_per_m2=50.0)
    assert kind.where_it_pays(target, deep, deep.first_cell, deep.end_cell) is None
