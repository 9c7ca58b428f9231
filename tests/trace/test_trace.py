"""Tracing: what a ray adds, where it falls, and what must not matter."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import BRICK, axes, box, ground, mesh_of, plate, scene_of, sigma0, view

import warpsar
from warpsar.errors import InputError
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import hit_grid
from warpsar.trace.hits import BinGrid, Hits
from warpsar.trace.rays import ray_count
from warpsar.trace.target import Target
from warpsar.trace.trace import trace
from warpsar.world.frame import view_geometry
from warpsar.world.mesh import Mesh
from warpsar.world.world import geometry_of

pytestmark = pytest.mark.unit

DEPOSITS = ("nearest", "linear", "footprint")


def town(**options: Any) -> Scene:
    mesh = mesh_of(soil=ground(26, cells=9), brick=box((-4, -3, 0), (5, 2, 6)), tower=box((-8, 4, 0), (-5.5, 6, 9)))
    materials = {"brick": BRICK, "tower": {**BRICK, "eps_r": 4.0}}
    return scene_of(mesh, view(25, 40), **{"materials": materials, **options})


def traced(scene: Scene, **options: Any) -> Hits:
    target = Target.upload(scene.mesh, scene.reference_point_m, devices.resolve_device(options.pop("device", "cpu")))
    density = options.pop("rays_per_m2", scene.sampling.density_per_m2(scene.grid))
    return trace(target, geometry_of(scene, scene.views[0]), options.pop("grid", hit_grid(scene)), density, **options)


def image_of(hits: Hits) -> np.ndarray:
    """Sum of the weights per pixel: the image of a surface with sigma0 = 1."""
    rows, cols = hits.grid.shape
    return np.bincount(hits.pixel.numpy(), hits.weight.numpy().astype(float), rows * cols).reshape(rows, cols)


# ---- axes ----


@given(st.floats(-360, 360), st.floats(0.5, 89.5))
def test_axes(azimuth_deg: float, incidence_deg: float) -> None:
    """docs/simulate.md: s toward the radar, clockwise from north; u, v right-handed with d; v_z = -sin(incidence)."""
    geometry = view_geometry(azimuth_deg, incidence_deg, 9.6e9)
    d, u, v = axes(azimuth_deg, incidence_deg)
    for found, expected in ((geometry.d, d), (geometry.s, -d), (geometry.u, u), (geometry.v, v)):
        np.testing.assert_allclose(found, expected, atol=1e-12)
    assert np.linalg.det([geometry.u, geometry.d, geometry.v]) == pytest.approx(1)
    assert geometry.v[2] == pytest.approx(-np.sin(np.deg2rad(incidence_deg)))
    assert geometry.v[:2] @ geometry.s[:2] >= 0  # it leans back toward the radar


def test_picture_of_a_radar_in_the_north() -> None:
    """Columns run east, rows south: a map seen from above, north up, the radar at its top."""
    geometry = view_geometry(0.0, 45.0, 9.6e9)
    np.testing.assert_allclose(geometry.u, [1, 0, 0], atol=1e-15)
    assert geometry.d[1] < 0 < geometry.s[1]
    assert geometry.wavenumber == pytest.approx(2 * np.pi * 9.6e9 / 299792458)


@pytest.mark.parametrize(
    ("place", "row", "col"),
    [((0.3, -0.3, 0.0), 10, 10), ((-0.3, 0.3, 0.0), 9, 9), ((2.3, 3.0, 0.0), 6, 12), ((0.3, 0.3, 1.0), 8, 10)],
)
def test_pixel_of_a_place(place: tuple[float, float, float], row: int, col: int) -> None:
    """Pixel (i, j) covers ((i, i+1) - rows/2) * spacing of X . d and of X . u; the reference point is a corner."""
    x, y, z = place
    # a patch of 10 cm, for a radar in the north at 45 degrees: range -(y + z) / sqrt(2)
    mesh = mesh_of(soil=plate((x - 0.05, y - 0.05, z), (0.1, 0, 0), (0, 0.1, 0)))
    scene = scene_of(mesh, view(0, 45), shape=(20, 20), spacing_m=(0.6, 1.0), rays_per_pixel=1e4)
    assert (int(np.floor(-(y + z) / np.sqrt(2) / 0.6 + 10)), int(np.floor(x + 10))) == (row, col)
    np.testing.assert_array_equal(np.argwhere(image_of(traced(scene))), [[row, col]])


# ---- what a ray adds ----


@pytest.mark.parametrize("deposit", DEPOSITS)
@pytest.mark.parametrize("slant_range_m", [None, 90.0])
def test_deposits_conserve_power(deposit: str, slant_range_m: float | None, device: str) -> None:
    """Every deposit leaves the same power in the image: that of the rays, added in float64."""
    scene = town(shape=(90, 60), slant_range_m=slant_range_m)  # room for all of it
    rays = traced(scene, deposit="nearest", merge=False, device=device)
    total = rays.weight.numpy().astype(float).sum()
    deposited = image_of(traced(scene, deposit=deposit, device=device)).sum()
    # float32 sums of a few dozen weights each
    assert deposited == pytest.approx(total, rel=1e-6)


def test_a_rays_weight_is_its_area() -> None:
    """dA_perp / cos(theta) / pixel area: 1 / rays_per_m2 across the look direction."""
    scene = scene_of(mesh_of(soil=ground(60)), view(10, 40), rays_per_pixel=50)
    hits = traced(scene, deposit="nearest", merge=False)
    np.testing.assert_allclose(hits.weight.numpy(), 1 / 50 / np.cos(np.deg2rad(40)), rtol=1e-5)
    np.testing.assert_allclose(hits.cos_incidence.numpy(), np.cos(np.deg2rad(40)), rtol=1e-6)


def test_strip_map_weight() -> None:
    """dA_perp = r dalpha du, with one ray to a unit of area at the reference point's range."""
    scene = scene_of(mesh_of(soil=ground(60)), view(10, 40), rays_per_pixel=50, slant_range_m=80.0)
    hits = traced(scene, deposit="nearest", merge=False)
    d, _, v = axes(10, 40)
    along, across = hits.point.numpy() @ d, hits.point.numpy() @ v
    r = np.hypot(80 + along, across)
    cos = 80 * np.cos(np.deg2rad(40)) / r
    np.testing.assert_allclose(hits.cos_incidence.numpy(), cos, rtol=1e-5)
    np.testing.assert_allclose(hits.weight.numpy(), r / 80 / 50 / cos, rtol=1e-5)


@pytest.mark.parametrize("slant_range_m", [None, 90.0, 2e4])
def test_hits_lie_where_they_say(slant_range_m: float | None) -> None:
    """Barycentrics, face and point agree, and the pixel is that of the point."""
    scene = town(slant_range_m=slant_range_m)
    hits = traced(scene, deposit="nearest", merge=False)
    b, corners = hits.barycentric.numpy().astype(float), scene.mesh.vertices[scene.mesh.faces[hits.face.numpy()]]
    assert b.min() > -1e-4
    assert b.sum(axis=1).max() < 1 + 1e-4
    points = np.einsum("nk,nkj->nj", np.column_stack([1 - b.sum(axis=1), b]), corners)
    np.testing.assert_allclose(hits.point.numpy(), points, atol=1e-5)
    d, u, v = axes(25, 40)
    along = points @ d
    if slant_range_m:
        along = np.hypot(slant_range_m + along, points @ v) - slant_range_m
    place = np.stack([along, points @ u]) / 0.5 + 20
    found = np.stack(np.divmod(hits.pixel.numpy(), 40))
    # inside of the pixel, to the rounding of a place in it
    assert np.abs(place - found - 0.5).max() < 0.5 + 1e-4


def test_strata_hold_one_ray_each() -> None:
    """Every (azimuth, elevation) cell over the mesh has one sample, anywhere in it."""
    scene = scene_of(mesh_of(soil=ground(60)), view(0, 40), shape=(20, 20), rays_per_pixel=16)
    hits = traced(scene, deposit="nearest", merge=False)
    _, u, v = axes(0, 40)
    points = hits.point.numpy().astype(float)
    azimuth, elevation = points @ u / 0.125, points @ v / 0.125
    for place in (azimuth % 1, (elevation + 0.5) % 1):  # uniform in a cell
        assert place.mean() == pytest.approx(0.5, abs=4 / np.sqrt(12 * len(place)))
        assert place.var() == pytest.approx(1 / 12, rel=0.05)
    columns = np.bincount(np.floor(azimuth + 40).astype(int), minlength=80)
    # an azimuth cell's column covers the 20 rows with 20 * 4 / tan(40) cells, give or take one at each end
    assert np.abs(columns - 80 / np.tan(np.deg2rad(40))).max() < 2.5


# ---- what must not matter ----


@pytest.mark.parametrize("slant_range_m", [None, 90.0])
@pytest.mark.parametrize("deposit", DEPOSITS)
def test_threads_and_memory_do_not_matter(
    deposit: str, slant_range_m: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the bit: rays are numbered by their cell, and bands never share a pixel."""
    scene = town(slant_range_m=slant_range_m, sampling={"deposit": deposit}, polarizations=("HH", "HV"))
    images = []
    for threads, gib in (("1", 2.0), ("2", 2.0), ("5", 2.0), ("2", 1e-5), ("1", 1e-9)):
        monkeypatch.setenv("WARPSAR_THREADS", threads)
        images.append(warpsar.simulate(scene, device="cpu", max_memory_gib=gib)[0].beta0)
    for image in images[1:]:
        for polarization in image:
            np.testing.assert_array_equal(image[polarization], images[0][polarization])


@pytest.mark.cuda
@pytest.mark.parametrize("deposit", DEPOSITS)
def test_memory_does_not_matter_on_cuda(deposit: str) -> None:
    """To the bit, from run to run as well: weights are summed as integers, and a pixel's hits in their order."""
    scene = town(sampling={"deposit": deposit})
    images = [warpsar.simulate(scene, device="cuda", max_memory_gib=gib)[0].beta0["HH"] for gib in (2.0, 2.0, 1e-4)]
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


@pytest.mark.parametrize("slant_range_m", [None, 90.0])
def test_cpu_and_cuda_agree(slant_range_m: float | None, device: str) -> None:
    """The same rays and strata; a ray on an edge may fall on either side of it."""
    scene = town(slant_range_m=slant_range_m, polarizations=("HH", "VV"))
    cpu, other = (warpsar.simulate(scene, device=name)[0].beta0 for name in ("cpu", device))
    for polarization in ("HH", "VV"):
        scale = np.sqrt((cpu[polarization] ** 2).mean())
        assert np.sqrt(((cpu[polarization] - other[polarization]) ** 2).mean()) < 1e-3 * scale
        assert other[polarization].sum() == pytest.approx(cpu[polarization].sum(), rel=1e-5)


def test_number_of_rays_does_not_change_the_mean() -> None:
    many = image_of(traced(town(rays_per_pixel=2048.0))).sum()
    for rays_per_pixel in (1.0, 16.0, 64.0):
        few = image_of(traced(town(rays_per_pixel=rays_per_pixel))).sum()
        # outlines of 200 m cut strata: of 600 m2, 200 m * 0.5 m / n^1/2 in strata that each err by half their share
        assert few == pytest.approx(many, rel=0.02 / np.sqrt(rays_per_pixel))


@pytest.mark.parametrize("slant_range_m", [None, 90.0])
def test_finer_and_wider_bins_hold_the_same_power(slant_range_m: float | None) -> None:
    """Effects ask for bins finer than pixels; their weights are over the image's pixel area."""
    scene = town(slant_range_m=slant_range_m)
    image = image_of(traced(scene))
    fine = image_of(traced(scene, grid=BinGrid((168, 168), (0.125, 0.125)), pixel_area_m2=0.25))[4:-4, 4:-4]
    coarse = fine.reshape(40, 4, 40, 4).sum(axis=(1, 3))
    # other strata: what 64 rays leave in a pixel on an outline
    assert np.sqrt(((coarse - image) ** 2).mean()) < 0.05 * np.sqrt((image**2).mean())
    assert coarse.sum() == pytest.approx(image.sum(), rel=2e-3)


def test_seed() -> None:
    """The same seed is the same image; another one is another, as far as its variance says."""
    scene = town(sampling={"deposit": "nearest"})
    first, again, other = (warpsar.simulate(scene, device="cpu", seed=seed)[0].beta0["HH"] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert 0.005 < np.sqrt(((first - other) ** 2).mean() / (first**2).mean()) < 0.1


# ---- merging ----


@pytest.mark.parametrize("slant_range_m", [None, 90.0])
@pytest.mark.parametrize("deposit", DEPOSITS)
def test_merged_is_per_ray_for_uniform_materials(deposit: str, slant_range_m: float | None, device: str) -> None:
    """To 1e-5 of the image's rms: in a plane wave a facet has one incidence."""
    scene = town(slant_range_m=slant_range_m, sampling={"deposit": deposit}, polarizations=("HH", "HV"))
    merged, per_ray = (warpsar.simulate(scene, device=device, merge=merge)[0] for merge in (True, False))
    assert merged.hits < per_ray.hits / 5
    for polarization in ("HH", "HV"):
        scale = np.sqrt((per_ray.beta0[polarization] ** 2).mean())
        error = np.abs(merged.beta0[polarization] - per_ray.beta0[polarization]).max()
        # Strip-map: incidence varies over the part of a facet in a pixel, as any other field does.
        assert error < (1e-5 if slant_range_m is None else 1e-3) * scale


def slats() -> Scene:
    """Level ground in strips 5 cm wide along the rows: more (face, pixel) than a first table has room for."""
    edges = np.linspace(-10, 10, 401)
    vertices = np.array([(x, y, 0.0) for y in edges for x in (-10.0, 10.0)])
    quad = np.array([[0, 1, 3], [0, 3, 2]], np.int32)
    faces = (2 * np.arange(400, dtype=np.int32)[:, None, None] + quad).reshape(-1, 3)
    return scene_of(mesh_of(soil=(vertices, faces)), view(0, 40), rays_per_pixel=100.0)


@pytest.mark.parametrize("world", [town, slats])
@pytest.mark.parametrize("deposit", DEPOSITS)
def test_merged_hits_are_the_rays_added_up(world: Callable[[], Scene], deposit: str, device: str) -> None:
    """Per (pixel, face): weights summed, barycentrics averaged with them, in float64."""
    hits, rays = (traced(world(), deposit=deposit, merge=merge, device=device) for merge in (True, False))
    keys, which = np.unique(np.stack([rays.pixel.numpy(), rays.face.numpy()]), axis=1, return_inverse=True)
    pixel, face = hits.pixel.numpy(), hits.face.numpy()
    order = np.lexsort([face, pixel])  # hits come band by band
    np.testing.assert_array_equal(np.stack([pixel, face])[:, order], keys)
    weight = rays.weight.numpy().astype(float)
    total = np.bincount(which, weight)
    # float32 sums of a thread's run, and quanta of 2^-29 of a ray's own weight, cut off a few hundred times at most
    unit = np.median(weight)
    np.testing.assert_allclose(hits.weight.numpy()[order], total, rtol=2e-6, atol=1e-6 * unit)
    b = np.stack([np.bincount(which, weight * column) for column in rays.barycentric.numpy().T.astype(float)], axis=1)
    np.testing.assert_allclose(hits.barycentric.numpy()[order] * total[:, None], b, rtol=5e-6, atol=1e-6 * unit)


@settings(max_examples=15)
@given(st.integers(0, 2**31 - 1), st.floats(2, 88), st.floats(-180, 180), st.sampled_from(DEPOSITS))
def test_any_triangles(seed: int, incidence_deg: float, azimuth_deg: float, deposit: str) -> None:
    """Random triangles, thin ones and edge-on ones too: finite, not negative, and no power is made."""
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(30, 3)) * rng.choice([0.01, 1.0, 8.0], size=(30, 1))
    faces = rng.permutation(30).reshape(-1, 3).astype(np.int32)
    mesh = Mesh(vertices, faces, np.zeros(10, np.int32), ("soil",))
    hits = traced(scene_of(mesh, view(azimuth_deg, incidence_deg), rays_per_pixel=16), deposit=deposit)
    weight = hits.weight.numpy()
    assert np.isfinite(weight).all()
    assert (weight >= 0).all()
    image = warpsar.simulate(
        scene_of(mesh, view(azimuth_deg, incidence_deg), rays_per_pixel=16, sampling={"deposit": deposit}),
        device="cpu",
    )[0].beta0["HH"]
    assert np.isfinite(image).all()
    # the mesh's whole area, every face lit, at sigma0's largest; strata add their 1/8 m at outlines
    edges = vertices[faces]
    area = np.linalg.norm(np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0]), axis=1).sum() / 2
    outline = np.linalg.norm(edges - np.roll(edges, 1, axis=1), axis=2).sum()
    assert hits.weight.numpy().sum() * 0.25 * np.cos(np.deg2rad(89)) <= area + 0.25 * outline
    assert image.max() >= 0


# ---- what is refused ----


def test_a_track_inside_the_mesh_is_refused() -> None:
    with pytest.raises(InputError, match="slant_range_m: found 5, and the mesh reaches"):
        traced(scene_of(mesh_of(soil=ground(60)), view(0, 40), slant_range_m=5.0))


def test_a_mesh_far_outside_of_the_image_has_no_rays() -> None:
    scene = scene_of(mesh_of(soil=ground(4)), view(0, 40))
    away = replace(scene, mesh=replace(scene.mesh, vertices=scene.mesh.vertices + np.array([500.0, 0.0, 0.0])))
    assert traced(away).count == 0
    target = Target.upload(away.mesh, (0, 0, 0), devices.resolve_device("cpu"))
    assert ray_count(target, geometry_of(away, away.views[0]), hit_grid(away), 100.0) == 0


def test_rays_are_counted() -> None:
    scene = town()
    target = Target.upload(scene.mesh, (0, 0, 0), devices.resolve_device("cpu"))
    hits = traced(scene)
    assert hits.rays == ray_count(target, geometry_of(scene, scene.views[0]), hit_grid(scene), hits.rays_per_m2)


def test_one_ray_per_pixel_is_enough_to_be_right_on_average() -> None:
    theta = np.deg2rad(40)
    scene = scene_of(mesh_of(soil=ground(60)), view(0, 40), rays_per_pixel=1.0)
    image = warpsar.simulate(scene, device="cpu")[0].beta0["HH"]
    assert image.mean() == pytest.approx(sigma0(theta) / np.sin(theta), rel=1e-4)
