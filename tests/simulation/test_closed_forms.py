"""Images whose every pixel, or whose sum, is known without a ray: plates, walls, a box, a sphere, a strip-map."""

from typing import Any

import numpy as np
import pytest
from worlds import BRICK, SOIL, axes, box, cos_twist, ground, join, mesh_of, plate, scene_of, sigma0, view

import warpsar
from warpsar.scene.scene import Scene
from warpsar.simulation.command import SimulatedView
from warpsar.world.mesh import Mesh

pytestmark = pytest.mark.unit

INCIDENCES = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0)
# A range in float32 is off by up to 4e-6 m at 64 m and beyond, 1e-5 of these half-metre pixels: a few of them at each
# of a pixel's edges.
ROUNDING = 1e-4


def simulate(scene: Scene, device: str = "cpu", **options: Any) -> SimulatedView:
    return warpsar.simulate(scene, device=device, **options)[0]


def power(image: SimulatedView, scene: Scene, polarization: str = "HH") -> float:
    """Sum of sigma0 dA [m2]."""
    return float(image.beta0[polarization].sum(dtype=float)) * scene.grid.pixel_area_m2


@pytest.mark.parametrize("incidence_deg", INCIDENCES)
def test_flat_plate(incidence_deg: float, device: str) -> None:
    """A slant-plane pixel covers 1 / sin(incidence) of its area on level ground."""
    # at 10 degrees the image is 115 m of ground
    image = simulate(scene_of(mesh_of(soil=ground(150)), view(33, incidence_deg)), device).beta0["HH"]
    theta = np.deg2rad(incidence_deg)
    np.testing.assert_allclose(image, sigma0(theta) / np.sin(theta), rtol=ROUNDING)


def test_sampling_error_falls_as_theory_says() -> None:
    """Without footprints, only strata that a row's edge cuts are uncertain.

    Of n rays in a pixel, sqrt(rays per pixel) lie beside each other along each of its two edges in range; one of
    them falls in with probability p, and p (1 - p) is 1/6 on average. So the count's variance is
    sqrt(rays_per_pixel) / 3, and its relative error falls as n^-3/4: unstratified rays would give n^-1/2.
    """
    theta = np.deg2rad(35.0)
    rays = np.array([16.0, 64.0, 256.0, 1024.0])
    errors = []
    for rays_per_pixel in rays:
        scene = scene_of(
            mesh_of(soil=ground(80)),
            view(0, 35.0),
            shape=(60, 60),
            rays_per_pixel=rays_per_pixel,
            sampling={"deposit": "nearest"},
        )
        image = simulate(scene).beta0["HH"][4:-4, 4:-4] / (sigma0(theta) / np.sin(theta))
        errors.append(image.std())
        # the mean over rows keeps only the outer two edges' error
        assert abs(image.mean() - 1) < 4 * errors[-1] / np.sqrt(image.size)
    in_pixel = rays / np.tan(theta)
    # 52 rows take p at 52 places only, so their average of p (1 - p) is off by some per cent of 1/6
    np.testing.assert_allclose(errors, np.sqrt(np.sqrt(rays) / 3) / in_pixel, rtol=0.15)
    slope = np.polyfit(np.log(rays), np.log(errors), 1)[0]
    assert slope == pytest.approx(-0.75, abs=0.05)


@pytest.mark.parametrize("incidence_deg", [35.0, 45.0, 55.0])
@pytest.mark.parametrize("relative_azimuth_deg", [0.0, 30.0, 60.0, -20.0])
def test_wall_in_the_radars_basis(relative_azimuth_deg: float, incidence_deg: float) -> None:
    """A plane with normal n covers 1 / |n . v| of a pixel; its Bragg amplitudes turn by psi."""
    wall = mesh_of(soil=plate((-20, 0, -20), (40, 0, 0), (0, 0, 40)))
    scene = scene_of(wall, view(relative_azimuth_deg, incidence_deg), polarizations=("HH", "VV", "HV"))
    image = simulate(scene)
    d, u, v = axes(relative_azimuth_deg, incidence_deg)
    n = np.array([0.0, 1.0, 0.0])
    theta = np.arccos(abs(n @ d))
    for polarization in ("HH", "VV", "HV"):
        expected = sigma0(theta, polarization=polarization, cos_psi=cos_twist(n, d, u)) / abs(n @ v)
        np.testing.assert_allclose(
            image.beta0[polarization][15:25, 15:25], expected, rtol=ROUNDING, atol=1e-12, err_msg=polarization
        )
    local = simulate(scene_of(wall, scene.views, polarization_basis="local")).beta0["HH"][15:25, 15:25]
    np.testing.assert_allclose(local, sigma0(theta) / abs(n @ v), rtol=ROUNDING)


@pytest.mark.parametrize(("relative_azimuth_deg", "expected_db"), [(30.0, 3.0), (60.0, 10.0)])
def test_what_turning_the_basis_does_to_a_wall(relative_azimuth_deg: float, expected_db: float) -> None:
    """The interface's round numbers for HH; at 55 degrees of incidence they are 3.0 and 9.7 dB."""
    wall = mesh_of(soil=plate((-20, 0, -20), (40, 0, 0), (0, 0, 40)))
    at = view(relative_azimuth_deg, 55.0)
    radar, local = (
        simulate(scene_of(wall, at, polarization_basis=basis)).beta0["HH"][20, 20] for basis in ("radar", "local")
    )
    assert 10 * np.log10(radar / local) == pytest.approx(expected_db, abs=0.5)


# ---- a box on a plane, seen square on: every row is a sum of known surfaces ----

HALF_WIDTH, HALF_DEPTH, HEIGHT, BOX_INCIDENCE = 5.0, 4.0, 3.0, 40.0


def box_scene(**options: Any) -> Scene:
    mesh = mesh_of(soil=ground(60), brick=box((-HALF_WIDTH, -HALF_DEPTH, 0), (HALF_WIDTH, HALF_DEPTH, HEIGHT)))
    return scene_of(
        mesh,
        view(0, BOX_INCIDENCE),
        shape=(80, 40),
        spacing_m=(0.25, 0.5),
        materials={"brick": BRICK},
        rays_per_pixel=256,
        **options,
    )


def box_profile(range_m: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """beta0 of the rows through the box, 0.25 m each, and the ranges at which surfaces begin and end."""
    theta = np.deg2rad(BOX_INCIDENCE)
    sin, cos, tan = np.sin(theta), np.cos(theta), np.tan(theta)
    wall_top, wall_foot = -HALF_DEPTH * sin - HEIGHT * cos, -HALF_DEPTH * sin
    roof_end, shadow_end = HALF_DEPTH * sin - HEIGHT * cos, (HALF_DEPTH + HEIGHT * tan) * sin
    flat = sigma0(theta) / sin
    surfaces = [
        (-np.inf, wall_foot, flat),
        (wall_top, wall_foot, sigma0(np.pi / 2 - theta, **BRICK) / cos),
        (wall_top, roof_end, sigma0(theta, **BRICK) / sin),
        (shadow_end, np.inf, flat),
    ]
    profile = sum(
        value * np.clip(np.minimum(range_m + 0.125, end) - np.maximum(range_m - 0.125, begin), 0, None) / 0.25
        for begin, end, value in surfaces
    )
    return profile, [wall_top, wall_foot, roof_end, shadow_end]


def test_box_layover_and_shadow(device: str) -> None:
    """Layover of H cos(theta), shadow of H / cos(theta) from the roof's end, each to a fraction of a pixel."""
    image = simulate(box_scene(), device)
    expected, edges = box_profile(image.range_m)
    column = image.beta0["HH"][:, 20]
    whole = np.abs(image.range_m[:, None] - edges).min(axis=1) > 0.125
    np.testing.assert_allclose(column[whole], expected[whole], rtol=ROUNDING, atol=0)
    # An edge cuts one stratum, 7.5 % of a row; each of the 23 beside each other in a column is in or out, which leaves
    # 0.5 / sqrt(23) of it: 0.8 % of the surface's full value, here with three sigma.
    np.testing.assert_allclose(column[~whole], expected[~whole], rtol=0, atol=0.024 * expected.max())
    wall_top, wall_foot, roof_end, shadow_end = edges
    # dark are the rows wholly inside the shadow, and no others
    dark = (image.range_m - 0.125 > roof_end) & (image.range_m + 0.125 < shadow_end)
    np.testing.assert_array_equal(column == 0, dark)
    cos = np.cos(np.deg2rad(BOX_INCIDENCE))
    assert (wall_foot - wall_top, shadow_end - roof_end) == pytest.approx((HEIGHT * cos, HEIGHT / cos))


def test_box_layers(device: str) -> None:
    image = simulate(box_scene(), device, layers=True)
    _, (wall_top, wall_foot, roof_end, shadow_end) = box_profile(image.range_m)
    low, high = image.range_m - 0.125, image.range_m + 0.125
    folded = (low > wall_top) & (high < wall_foot)
    dark = (low > roof_end) & (high < shadow_end)
    single = (high < wall_top) | (low > shadow_end) | ((low > wall_foot) & (high < roof_end))
    layers = {name: layer[:, 20] for name, layer in image.layers.items()}
    # lit all over: the plate's own edges are outside of the image
    np.testing.assert_allclose(layers["layover"][folded], 3, rtol=1e-5)  # ground, wall and roof
    np.testing.assert_allclose(layers["layover"][single], 1, rtol=1e-5)
    np.testing.assert_array_equal(layers["layover"][dark], 0)
    np.testing.assert_array_equal(layers["shadow"], dark.astype(float))
    np.testing.assert_array_equal(np.isnan(layers["incidence_deg"]), dark)
    np.testing.assert_array_equal(layers["material"][dark], -1)
    np.testing.assert_array_equal(layers["material"][folded], 1)
    np.testing.assert_array_equal(layers["material"][high < wall_top], 0)
    np.testing.assert_allclose(layers["incidence_deg"][single], BOX_INCIDENCE, atol=1e-3)
    # ground and roof lie at 40 degrees with 1 / sin(40) m2 to a m2 of the pixel, the wall at 50 with 1 / cos(40)
    sin, cos = np.sin(np.deg2rad(BOX_INCIDENCE)), np.cos(np.deg2rad(BOX_INCIDENCE))
    mean = (2 * BOX_INCIDENCE / sin + (90 - BOX_INCIDENCE) / cos) / (2 / sin + 1 / cos)
    np.testing.assert_allclose(layers["incidence_deg"][folded], mean, rtol=1e-4)


def test_box_lit_area() -> None:
    """Image sum = sum of sigma0 dA, with the ground that the box hides and stands on left out."""
    theta = np.deg2rad(BOX_INCIDENCE)
    mesh = mesh_of(soil=ground(18), brick=box((-HALF_WIDTH, -HALF_DEPTH, 0), (HALF_WIDTH, HALF_DEPTH, HEIGHT)))
    scene = scene_of(mesh, view(0, BOX_INCIDENCE), shape=(80, 40), materials={"brick": BRICK}, rays_per_pixel=256)
    width, depth = 2 * HALF_WIDTH, 2 * HALF_DEPTH
    soil = 18 * 18 - width * (depth + HEIGHT * np.tan(theta))
    lit = (
        sigma0(theta) * soil
        + sigma0(theta, **BRICK) * width * depth
        + sigma0(np.pi / 2 - theta, **BRICK) * width * HEIGHT
    )
    # edges cut strata: 250 of them in a perimeter of 2000, each with an error of half its 0.03 m2 of 400 m2
    assert power(simulate(scene), scene) == pytest.approx(lit, rel=1e-3)


# ---- curved and arbitrary bodies: the sum over the image ----


def sphere(radius: float, subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    body = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.asarray(body.vertices), np.asarray(body.faces)


@pytest.mark.parametrize("polarization", ["HH", "VV", "HV"])
def test_sphere(polarization: str) -> None:
    """Its cross-section is the integral of sigma0 over the lit half; psi runs through all angles on it."""
    radius = 8.0
    scene = scene_of(mesh_of(soil=sphere(radius, 5)), view(25, 40), polarizations=(polarization,), rays_per_pixel=64)
    theta = (np.arange(4000) + 0.5) / 4000 * np.pi / 2
    psi = (np.arange(360) + 0.5) / 360 * 2 * np.pi
    ring = sigma0(theta[:, None], polarization=polarization, cos_psi=np.abs(np.cos(psi))).mean(axis=1)
    expected = 2 * np.pi * radius**2 * (ring * np.sin(theta)).sum() * (np.pi / 2 / 4000)
    # 20480 facets bend by 2 degrees from one to the next: a relative error of (0.02 rad)^2 or so
    assert power(simulate(scene), scene, polarization) == pytest.approx(expected, rel=1e-3)


def test_specular_sphere_returns_its_cross_section() -> None:
    """In geometric optics a sphere's radar cross-section is pi R^2 |R0|^2, however rough.

    With a slope variance m^2 per axis the mean is 1 + m^2 + O(m^4) times that: averaging the incoherent
    coefficient over the curved surface adds the m^2.
    """
    radius, rms_height, length = 8.0, 0.01, 0.1
    slope_variance = 2 * rms_height**2 / length**2
    material = {"eps_r": 9.0, "rms_height_m": rms_height, "correlation_length_m": length, "specular_fraction": 1.0}
    scene = scene_of(mesh_of(metal=sphere(radius, 6)), view(25, 40), materials={"metal": material})
    expected = np.pi * radius**2 * 0.25 * (1 + slope_variance)  # |R0| = (3 - 1) / (3 + 1)
    # m^4 = 4e-4, and the facets' angle of 1 degree against the lobe's 8
    assert power(simulate(scene), scene) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("slant_range_m", [None, 60.0])
def test_image_sum_over_a_convex_body(slant_range_m: float | None) -> None:
    """Every face turned to the radar is lit, whole: the sum is over the mesh, in float64, without a ray."""
    import trimesh

    rng = np.random.default_rng(7)
    hull = trimesh.Trimesh(rng.normal(size=(40, 3)) * (3, 4, 2)).convex_hull.subdivide_to_size(0.4)
    scene = scene_of(
        mesh_of(soil=(hull.vertices, hull.faces)),
        view(160, 35),
        shape=(60, 60),
        rays_per_pixel=256,
        polarizations=("VV",),
        slant_range_m=slant_range_m,
    )
    d, u, v = axes(160, 35)
    look = np.broadcast_to(d, hull.face_normals.shape)
    if slant_range_m:  # each face's own direction, across the track
        centre = hull.triangles_center
        look = (slant_range_m + centre @ d)[:, None] * d + (centre @ v)[:, None] * v
        look /= np.linalg.norm(look, axis=1, keepdims=True)
    cos = -(hull.face_normals * look).sum(axis=1)
    lit = cos > 0
    across = np.cross(hull.face_normals, look)
    twist = np.abs(across @ u) / np.linalg.norm(across, axis=1)
    values = sigma0(np.arccos(np.clip(cos[lit], 0, 1)), polarization="VV", cos_psi=np.clip(twist[lit], 0, 1))
    expected = (values * hull.area_faces[lit]).sum()
    # strata on the outline: 500 of 30000, each off by its own power at most
    assert power(simulate(scene), scene, "VV") == pytest.approx(expected, rel=1e-3)


# ---- strip-map ----


@pytest.mark.parametrize("slant_range_m", [100.0, 350.0, 1e4, 1e6])
@pytest.mark.parametrize("incidence_deg", [30.0, 55.0])
def test_strip_map_plate(slant_range_m: float, incidence_deg: float, device: str) -> None:
    """From a track of height H, ground at slant range R is seen at cos(theta) = H / R, for R from 100 m to orbit."""
    scene = scene_of(mesh_of(soil=ground(60)), view(33, incidence_deg), slant_range_m=slant_range_m)
    image = simulate(scene, device)
    height = slant_range_m * np.cos(np.deg2rad(incidence_deg))
    inside = np.linspace(-0.25, 0.25, 101)  # mean over a pixel
    theta = np.arccos(height / (slant_range_m + image.range_m[8:-8, None] + inside))
    expected = (sigma0(theta) / np.sin(theta)).mean(axis=1)
    rows = image.beta0["HH"][8:-8, 8:-8]
    # A cell's footprint is that of a plane wave in its middle: wrong by its 0.06 m over R, and by its square.
    np.testing.assert_allclose(
        rows, np.broadcast_to(expected[:, None], rows.shape), rtol=0.1 / slant_range_m + ROUNDING
    )


def test_a_far_track_is_a_plane_wave() -> None:
    """The difference falls as 1 / R0, first order in scene size over range."""
    mesh = mesh_of(soil=ground(16, cells=4), brick=box((-3, -2, 0), (2, 2, 4)))
    plane = simulate(scene_of(mesh, view(70, 40), materials={"brick": BRICK})).beta0["HH"]
    scale = np.sqrt((plane**2).mean())
    errors = []
    for slant_range_m in (1e3, 1e4, 1e5):
        scene = scene_of(mesh, view(70, 40), materials={"brick": BRICK}, slant_range_m=slant_range_m)
        errors.append(np.abs(simulate(scene).beta0["HH"].mean(axis=1) - plane.mean(axis=1)).max() / scale)
    assert errors[0] > 3 * errors[1] > 9 * errors[2]
    assert errors[2] < 1e-3


def test_frequency_and_slant_range_in_a_view() -> None:
    """What a view says stands before what the radar says."""
    mesh = mesh_of(soil=ground(60))
    views = [
        view(0, 40, name="radar"),
        view(0, 40, name="low", frequency_hz=4.8e9),
        view(0, 40, name="near", slant_range_m=80.0),
    ]
    radar, low, near = warpsar.simulate(scene_of(mesh, views, slant_range_m=1e7), device="cpu")
    theta = np.deg2rad(40)
    for image, wavenumber in ((radar, 1.0), (low, 0.5)):
        expected = sigma0(theta, wavenumber=wavenumber * 2 * np.pi * 9.6e9 / 299792458.0) / np.sin(theta)
        np.testing.assert_allclose(image.beta0["HH"][8:-8, 8:-8], expected, rtol=1e-4)
    angle = np.arccos(80 * np.cos(theta) / (80 + near.range_m[[8, -9]]))
    np.testing.assert_allclose(
        near.beta0["HH"][[8, -9], 20], sigma0(angle) / np.sin(angle), rtol=2e-3
    )  # the row's centre for its mean


# ---- invariances ----


def tilted_block() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    vertices, faces = box((-4, -3, 0), (5, 2, 6))
    return {"soil": ground(22, cells=6), "brick": (vertices + np.array([1.0, -1.5, 0.0]), faces)}


@pytest.mark.parametrize("slant_range_m", [None, 120.0])
@pytest.mark.parametrize("turn_deg", [17.3, 90.0, 211.9])
def test_world_and_view_turned_together(turn_deg: float, slant_range_m: float | None) -> None:
    turn = np.deg2rad(turn_deg)
    # azimuth grows clockwise
    rotation = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    turned = {name: (vertices @ rotation.T, faces) for name, (vertices, faces) in tilted_block().items()}
    images = [
        simulate(
            scene_of(mesh_of(**parts), view(azimuth, 40), materials={"brick": BRICK}, slant_range_m=slant_range_m)
        ).beta0["HH"]
        for parts, azimuth in ((tilted_block(), 25.0), (turned, 25.0 + turn_deg))
    ]
    # Rays and strata turn with the view; what differs is the rounding of a ray that meets an edge.
    assert np.sqrt(((images[1] - images[0]) ** 2).mean()) < 1e-2 * np.sqrt((images[0] ** 2).mean())
    assert images[1].sum() == pytest.approx(images[0].sum(), rel=1e-4)


def test_moved_world_and_reference_point() -> None:
    """Range and azimuth are about the reference point: far from the origin nothing changes."""
    from dataclasses import replace

    here = scene_of(mesh_of(**tilted_block()), view(25, 40))
    shift = np.array([431_000.0, 5_411_000.0, 250.0])  # UTM-like coordinates
    mesh = replace(here.mesh, vertices=here.mesh.vertices + shift)
    there = replace(here, mesh=mesh, reference_point_m=tuple(shift))
    images = [simulate(scene).beta0["HH"] for scene in (here, there)]
    assert np.sqrt(((images[1] - images[0]) ** 2).mean()) < 1e-3 * np.sqrt((images[0] ** 2).mean())


def test_facets_scatter_from_both_sides() -> None:
    vertices, faces = ground(60)
    flipped = mesh_of(soil=(vertices, faces[:, ::-1].copy()))
    up, down = (
        simulate(scene_of(mesh, view(0, 30))).beta0["HH"] for mesh in (mesh_of(soil=(vertices, faces)), flipped)
    )
    np.testing.assert_allclose(down, up, rtol=ROUNDING)


def test_tessellation_does_not_matter() -> None:
    coarse, fine = (
        simulate(scene_of(mesh_of(soil=ground(60, cells=n)), view(20, 50))).beta0["HH"][8:-8, 8:-8] for n in (1, 57)
    )
    # A stratum on the border of two facets, one in twelve here, falls on the side of its sample: of the 50 in a pixel
    # half of one may be in a row's wrong neighbour.
    np.testing.assert_allclose(fine, coarse, rtol=0.02)
    assert fine.std() < 2e-3 * coarse.mean()
    assert fine.mean() == pytest.approx(coarse.mean(), rel=1e-4)


def test_radar_at_the_top_and_shadows_below() -> None:
    """A tower east of the middle, seen from the north, is right of it, with its shadow in higher rows."""
    mesh = mesh_of(soil=ground(60), brick=box((4, -1, 0), (6, 1, 6)))
    image = simulate(scene_of(mesh, view(0, 40), materials={"brick": BRICK}), layers=True)
    rows, cols = np.nonzero(image.layers["shadow"])
    np.testing.assert_array_equal(np.unique(cols), 20 + np.arange(8, 12))
    towers = np.nonzero((image.layers["material"] == 1)[:, 30])[0]
    assert towers.max() < rows.min()
    assert towers.min() < 20 < rows.max()


def test_nothing_in_view() -> None:
    scene = scene_of(mesh_of(soil=join([ground(4)])), view(0, 30))
    far = Mesh(scene.mesh.vertices + np.array([500.0, 0, 0]), scene.mesh.faces, scene.mesh.face_material, ("soil",))
    image = simulate(scene_of(far, view(0, 30)), layers=True)
    assert not image.beta0["HH"].any()
    assert (image.hits, image.layers["shadow"].any()) == (0, False)


def test_materials_mix() -> None:
    """tau mixes the two terms linearly."""
    theta = np.deg2rad(12.0)
    rough = {"eps_r": 6.0, "rms_height_m": 0.02, "correlation_length_m": 0.1, "specular_fraction": 0.4}
    scene = scene_of(mesh_of(soil=ground(60)), view(0, 12.0), materials={"soil": rough})
    expected = sigma0(theta, **rough) / np.sin(theta)
    assert expected > 10 * sigma0(theta, **SOIL)  # the specular term counts here
    np.testing.assert_allclose(simulate(scene).beta0["HH"][8:-8, 8:-8], expected, rtol=1e-4)
