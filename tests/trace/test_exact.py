"""Images without rays: closed forms, the ray tracer, and derivatives by silhouettes and shadows."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import BRICK, SOIL, box, ground, mesh_of, plate, scene_of, sigma0, view

from warpsar.kernels.codes import Deposit
from warpsar.render.render import ViewRender
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.exact_rays import ExactRays
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.trace import exact
from warpsar.world.objects.pose import placed
from warpsar.world.objects.shapes import body
from warpsar.world.objects.table import Object
from warpsar.world.tables import Sampling

EXAMPLE = Path(__file__).resolve().parents[2] / "data" / "example" / "scene.toml"
DARK = {**SOIL, "rms_height_m": 1e-7}  # returns nothing: only its shadow is seen


def image(scene: Scene, device: str = "cpu", rays_per_pixel: float | None = None) -> np.ndarray:
    """beta0 of the first view, float64: exact, or by rays."""
    if rays_per_pixel is not None:
        scene = replace(scene, sampling=Sampling(rays_per_pixel=rays_per_pixel))
    stage = Stage.of(scene, devices.resolve_device(device))
    kind = ExactRays if rays_per_pixel is None else Rays
    hits = kind(stage).trace(scene, scene.views[0], [])
    return ViewRender(stage, scene.views[0], hits, scene.grid.shape, ("HH",), []).forward()["HH"].astype(float)


def away(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def with_object(table: dict[str, Any], material: dict[str, Any] = BRICK, **more: Any) -> Scene:
    """An object on bumpless ground beside a building, on which its shadow may fall."""
    one = Object(**table)
    made = body(one)
    parts = {"g": ground(30), "b": box((-6, 4, 0), (-2, 9, 3)), "o": (placed(made.vertices, one), made.faces)}
    materials = {"g": SOIL, "b": SOIL, "o": material}
    options: dict[str, Any] = {"shape": (60, 60), "materials": materials, **more}
    return scene_of(mesh_of(**parts), view(25, 40), **options)


def test_a_plane_in_closed_form(device: str) -> None:
    """beta0 = sigma0 / sin(incidence) in every pixel, to float32."""
    found = image(scene_of(mesh_of(g=ground(60, cells=3)), view(25, 40), shape=(20, 24)), device)
    theta = np.deg2rad(40.0)
    np.testing.assert_allclose(found, sigma0(theta) / np.sin(theta), rtol=2e-6)


def test_an_edge_inside_a_pixel_in_closed_form() -> None:
    """A strip of 2 x 0.3 m facing the radar: its area in each pixel is cut by hand, along azimuth and along range."""
    strip = plate((-1.0, -0.15, 0.0), (2.0, 0.0, 0.0), (0.0, 0.3, 0.0))
    found = image(scene_of(mesh_of(g=strip), view(0.0, 40.0), shape=(4, 6), rays_per_pixel=16))
    theta = np.deg2rad(40.0)
    # u points east for a radar in the north; azimuth pixels of 0.5 m from -1.5; range: y sin(theta) to either side of 0
    columns = np.array([0.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    rows = np.array([0.0, 0.15 * np.sin(theta) / 0.5, 0.15 * np.sin(theta) / 0.5, 0.0])
    np.testing.assert_allclose(found, np.outer(rows, columns) * sigma0(theta) / np.sin(theta), rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("slant_range_m", [None, 120.0])
@pytest.mark.parametrize(
    "table",
    [
        {"primitive": "box", "size_m": (6, 4, 5), "heading_deg": 17.0},
        {"primitive": "car", "size_m": (4.5, 1.8, 1.5), "heading_deg": 33.0, "side_curvature": 0.2},
        {"primitive": "sphere", "size_m": (6, 6, 6), "position_m": (-4, 4, -2)},  # in the ground, and in the building
        {"primitive": "plate", "size_m": (0, 4, 4), "heading_deg": 40.0, "position_m": (0, 0, 1)},  # in the air
    ],
)
def test_rays_come_to_the_exact_image(table: dict[str, Any], slant_range_m: float | None) -> None:
    """1024 rays per pixel leave 1e-3 of the image's norm, as the same number leaves between two seeds."""
    scene = with_object(table, slant_range_m=slant_range_m)
    assert away(image(scene, rays_per_pixel=1024), image(scene)) < 2e-3


def test_effects_and_layers_take_exact_hits() -> None:
    """Hits hold what the tracer's hold: one for each face in a pixel, in order, with a point on the face."""
    scene = with_object({"primitive": "box", "size_m": (6, 4, 5), "heading_deg": 17.0})
    stage = Stage.of(scene, devices.resolve_device("cpu"))
    hits = ExactRays(stage).trace(scene, scene.views[0], [])
    key = hits.pixel.numpy().astype(np.int64) * len(scene.mesh.faces) + hits.face.numpy()
    assert (np.diff(key) > 0).all()
    corners = scene.mesh.vertices[scene.mesh.faces[hits.face.numpy()]]
    b = hits.barycentric.numpy()
    weights = np.column_stack([1.0 - b.sum(axis=1), b])
    assert weights.min() > -1e-4
    np.testing.assert_allclose(np.einsum("nk,nkj->nj", weights, corners), hits.point.numpy(), atol=1e-4)
    rows = np.floor(hits.point.numpy() @ hits.geometry.d / 0.5 + 30).astype(int)
    assert (np.abs(rows - hits.pixel.numpy() // 60) <= 1).all()


def test_bands_are_the_whole() -> None:
    """The hits of some columns are those of the whole image there."""
    scene = with_object({"primitive": "car", "size_m": (4.5, 1.8, 1.5)})
    rays = ExactRays(Stage.of(scene, devices.resolve_device("cpu")))
    whole = rays.trace(scene, scene.views[0], [])
    band = rays.trace(scene, scene.views[0], [], only_columns=(20, 33))
    inside = (whole.pixel.numpy() % 60 >= 20) & (whole.pixel.numpy() % 60 < 33)
    np.testing.assert_array_equal(band.pixel.numpy(), whole.pixel.numpy()[inside])
    np.testing.assert_allclose(band.weight.numpy(), whole.weight.numpy()[inside], rtol=1e-5)


@pytest.mark.parametrize("slant_range_m", [None, 120.0])
def test_bands_of_elevation_are_the_whole(monkeypatch: pytest.MonkeyPatch, slant_range_m: float | None) -> None:
    """A column that is cut into bands has the pixels, faces and areas that it has as one. About a track an area takes
    the middle of its pieces, which are others, and about 100 m away."""
    scene = with_object(
        {"primitive": "car", "size_m": (4.5, 1.8, 1.5), "heading_deg": 33.0}, slant_range_m=slant_range_m
    )
    stage = Stage.of(scene, devices.resolve_device("cpu"))
    found = []
    for candidates in (10**9, 2):
        monkeypatch.setattr(exact, "CANDIDATES", candidates)
        found.append(ExactRays(stage).trace(scene, scene.views[0], []))
    whole, cut = found
    for name in ("pixel", "face"):
        np.testing.assert_array_equal(getattr(cut, name).numpy(), getattr(whole, name).numpy())
    rtol = 1e-5 if slant_range_m is None else 0.5 / 100.0
    np.testing.assert_allclose(cut.weight.numpy(), whole.weight.numpy(), rtol=rtol, atol=1e-9)


# ---- derivatives ----

BOX = {"primitive": "box", "size_m": (6.0, 4.0, 5.0), "heading_deg": 17.0, "position_m": (1.0, 2.0, 0.0)}
CAR = {"primitive": "car", "size_m": (4.5, 1.8, 1.5), "heading_deg": 17.0, "position_m": (1.0, 2.0, 0.0)}
SHEET = {"primitive": "plate", "size_m": (0.0, 4.0, 4.0), "heading_deg": 40.0, "position_m": (1.0, 2.0, 3.0)}


def moved(table: dict[str, Any], key: str, by: float) -> dict[str, Any]:
    """The table with a number changed: by metres, degrees, or a factor on the size."""
    if key in ("east", "north", "up"):
        shift = np.eye(3)[("east", "north", "up").index(key)] * by
        return {**table, "position_m": tuple(np.asarray(table["position_m"]) + shift)}
    if key == "scale":
        return {**table, "scale": 1.0 + by}
    return {**table, key: table.get(key, 0.0) + by}


def difference(table: dict[str, Any], key: str, step: float, rays: float | None = None, **more: Any) -> np.ndarray:
    up, down = (image(with_object(moved(table, key, s * step), **more), rays_per_pixel=rays) for s in (1, -1))
    return (up - down) / (2.0 * step)


@pytest.mark.parametrize("key", ["east", "north", "up", "heading_deg", "pitch_deg", "roll_deg", "scale"])
@pytest.mark.parametrize(
    ("table", "more"),
    [(BOX, {}), (CAR, {"spacing_m": (0.25, 0.25)}), (SHEET, {"material": DARK})],
    ids=["box", "car", "shadow alone"],
)
def test_differences_have_a_limit(table: dict[str, Any], more: dict[str, Any], key: str) -> None:
    """Differences over 2 mm are those over a tenth of it, to 1 % of the gradient's norm.

    An image by rays has no such limit. The rest is float32: 6e-8 of an image over a step of 0.2 mm.
    """
    step = {"heading_deg": 0.03, "pitch_deg": 0.03, "roll_deg": 0.03, "scale": 5e-4}.get(key, 2e-3)
    assert away(difference(table, key, step, **more), difference(table, key, step / 10.0, **more)) < 0.01


@pytest.mark.full
@pytest.mark.parametrize("key", ["east", "heading_deg", "scale"])
@pytest.mark.parametrize(
    ("table", "more"),
    [(CAR, {"spacing_m": (0.25, 0.25)}), (SHEET, {"material": DARK})],
    ids=["car", "shadow alone"],
)
def test_differences_are_those_of_converged_images(table: dict[str, Any], more: dict[str, Any], key: str) -> None:
    """Against images of many rays over steps of half a pixel, where their noise is small; both have the same steps.

    What the rays leave falls with their number: from 64 to 1024 per pixel by five times and more.
    """
    step = {"heading_deg": 5.0, "scale": 0.05}.get(key, 0.125)
    exact = difference(table, key, step, **more)
    few, many = (away(difference(table, key, step, rays, **more), exact) for rays in (64, 2048))
    assert many < 0.01
    assert few > 2.0 * many


@pytest.mark.full
def test_the_example_scene() -> None:
    """Its concrete building moved, against 1024 rays per pixel, and against smaller steps."""
    scene = Scene.load(EXAMPLE)
    concrete = scene.mesh.materials.index("concrete")
    mine = np.unique(scene.mesh.faces[scene.mesh.face_material == concrete])

    def at(shift: float, rays: float | None = None) -> np.ndarray:
        vertices = scene.mesh.vertices.copy()
        vertices[mine] += (shift, 0.5 * shift, 0.0)
        return image(replace(scene, mesh=replace(scene.mesh, vertices=vertices)), rays_per_pixel=rays)

    def slope(step: float, rays: float | None = None) -> np.ndarray:
        return (at(step, rays) - at(-step, rays)) / (2.0 * step)

    assert away(slope(2e-3), slope(2e-4)) < 0.01
    assert away(slope(0.25, 1024.0), slope(0.25)) < 0.01


def test_a_raised_plate_in_closed_form() -> None:
    """A plate raised by dz comes nearer by dz cos(incidence), and moves nowhere else: sum(row * beta0) follows."""

    theta = np.deg2rad(40.0)
    length = 5.0 / np.sin(theta)  # ten whole rows: so many lie between its ends, wherever the rows begin

    def total(z: float) -> float:
        sheet = plate((-4.0, -length / 2, z), (8.0, 0.0, 0.0), (0.0, length, 0.0))
        found = image(scene_of(mesh_of(g=sheet), view(0.0, 40.0), shape=(40, 40)))
        return float((found * (np.arange(40) + 0.5)[:, None]).sum())

    power = sigma0(theta) / np.sin(theta) * 10.0 * 16.0
    assert (total(0.1) - total(-0.1)) / 0.2 == pytest.approx(-power * np.cos(theta) / 0.5, rel=1e-5)


def test_deposits_are_still_three() -> None:
    """Exact areas are no fourth deposit: scene files do not name them."""
    assert {code.name for code in Deposit} == {"FOOTPRINT", "NEAREST", "LINEAR"}
