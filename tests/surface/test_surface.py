"""Parameters at the hit: three layouts, each against NumPy, and back to SI units."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import BRICK, SOIL, ground, mesh_of, plate, scene_of, sigma0, view

import warpsar
from warpsar.io.images import write_exr
from warpsar.kernels.codes import FRACTION_LIMIT
from warpsar.render.render import ViewRender
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import trace_view
from warpsar.surface.stage import Stage
from warpsar.surface.surface import KEYS, KINDS, Surface
from warpsar.trace.hits import Hits
from warpsar.world.mesh import Mesh

pytestmark = pytest.mark.unit

SIZE = 24.0


def textured_mesh(**scalars: np.ndarray) -> Mesh:
    """Level ground with u east and v north, and a wall of another material without UV."""
    vertices, faces = ground(SIZE, cells=5)
    rng = np.random.default_rng(1)
    inner = (np.abs(vertices[:, :2]) < SIZE / 2 - 1e-6).all(axis=1)
    vertices[inner, :2] += rng.uniform(-1, 1, (inner.sum(), 2))
    wall, wall_faces = plate((-3, 2, 0), (6, 0, 0), (0, 0, 5))
    uv = np.full((len(vertices) + len(wall), 2), np.nan, np.float32)
    uv[: len(vertices)] = vertices[:, :2] / SIZE + 0.5
    mesh = mesh_of(soil=(vertices, faces), brick=(wall, wall_faces))
    return Mesh(mesh.vertices, mesh.faces, mesh.face_material, mesh.materials, uv, scalars)


def hits_of(scene: Scene, device: str, merge: bool = True) -> tuple[Hits, ViewRender]:
    stage = Stage.of(scene, devices.resolve_device(device))
    hits = trace_view(scene, stage, scene.views[0], seed=1, effects=[], merge=merge)
    render = ViewRender(stage, scene.views[0], hits, scene.grid.shape, scene.radar.polarizations, [])
    render.forward()
    return hits, render


def bilinear(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Texel centres at ((i + 0.5) / width, 1 - (j + 0.5) / height), row 0 at the top, clamped outside."""
    height, width = texture.shape
    x = np.clip(uv[:, 0] * width - 0.5, 0, width - 1)
    y = np.clip((1 - uv[:, 1]) * height - 0.5, 0, height - 1)
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    fx, fy = x - x0, y - y0
    top = texture[y0, x0] * (1 - fx) + texture[y0, x1] * fx
    return top * (1 - fy) + (texture[y1, x0] * (1 - fx) + texture[y1, x1] * fx) * fy


def texture_scene(tmp_path: Path, **values: np.ndarray) -> Scene:
    material: dict[str, Any] = {**SOIL, "layout": "texture"}
    for key, value in values.items():
        write_exr(tmp_path / f"{key}.exr", {"Y": value})
        material[key] = str(tmp_path / f"{key}.exr")
    return scene_of(textured_mesh(), view(30, 40), materials={"soil": material, "brick": BRICK})


def test_texture(tmp_path: Path, device: str) -> None:
    """Every hit's coordinates, ln(eps_r - 1) and ln h, are bilinear in the texture's; what is a number stays one."""
    rng = np.random.default_rng(2)
    eps = (2 + 8 * rng.random((4, 7))).astype(np.float32)
    height = (1e-3 * (0.5 + rng.random((3, 2)))).astype(np.float32)
    scene = texture_scene(tmp_path, eps_r=eps, rms_height_m=height)
    hits, render = hits_of(scene, device)
    zeta = render.zeta.numpy()
    soil = scene.mesh.face_material[hits.face.numpy()] == 0
    uv = hits.point.numpy()[soil, :2] / SIZE + 0.5
    # float32: coordinates of 1 with weights of 1e-7, times differences of 2 between neighbours of 1/7
    np.testing.assert_allclose(zeta[soil, 0], bilinear(np.log(eps.astype(float) - 1), uv), atol=1e-5)
    np.testing.assert_allclose(zeta[soil, 1], bilinear(np.log(height.astype(float)), uv), atol=1e-5)
    np.testing.assert_allclose(zeta[soil, 2], np.log(SOIL["correlation_length_m"]), rtol=1e-6)
    np.testing.assert_array_equal(zeta[:, 3], -FRACTION_LIMIT)
    np.testing.assert_allclose(zeta[~soil, :3], np.log([[11.0, 0.001, 0.008]]).repeat((~soil).sum(), 0), rtol=1e-6)


def test_texture_lies_the_right_way_up(tmp_path: Path) -> None:
    """Row 0 is at v = 1, here the north; column 0 at u = 0, the west: a picture of the map."""
    height = np.full((8, 8), 1e-4, np.float32)
    height[0, 6] = 1e-2  # north, and east of the middle
    scene = texture_scene(tmp_path, rms_height_m=height)
    materials = {**materials_of(scene), "brick": {**BRICK, "rms_height_m": 1e-6}}
    # from the north columns run east and rows south; a texel is 3 m
    seen = scene_of(scene.mesh, view(0, 60), materials=materials, shape=(64, 64))
    image = warpsar.simulate(seen, device="cpu")[0]
    row, col = np.unravel_index(image.beta0["HH"].argmax(), (64, 64))
    x, y = image.azimuth_m[col], -image.range_m[row] / np.sin(np.deg2rad(60))
    assert (np.floor((x / SIZE + 0.5) * 8), np.floor((0.5 - y / SIZE) * 8)) == (6, 0)


def materials_of(scene: Scene) -> dict[str, dict[str, Any]]:
    return {name: material.model_dump() for name, material in scene.materials.items()}


def test_texture_is_clamped(tmp_path: Path) -> None:
    """Outside of the outermost texel centres the value stays: half a texel along each side, and beyond 0 to 1."""
    eps = np.array([[3.0, 9.0]], np.float32)
    scene = texture_scene(tmp_path, eps_r=eps)
    mesh = scene.mesh
    assert mesh.uv is not None
    wide = Mesh(mesh.vertices, mesh.faces, mesh.face_material, mesh.materials, mesh.uv * 3 - 1)
    hits, render = hits_of(scene_of(wide, view(30, 40), materials=materials_of(scene)), "cpu")
    soil = mesh.face_material[hits.face.numpy()] == 0
    u = (hits.point.numpy()[soil, 0] / SIZE + 0.5) * 3 - 1
    assert (u.min() < -0.5, u.max() > 1.5) == (True, True)
    found = render.zeta.numpy()[soil, 0]
    np.testing.assert_allclose(found[u < 0.25], np.log(2.0), rtol=1e-6)
    np.testing.assert_allclose(found[u > 0.75], np.log(8.0), rtol=1e-6)


@pytest.mark.parametrize("layout", ["uniform", "vertex", "texture"])
def test_the_way_back_is_the_transpose(layout: str, tmp_path: Path, device: str) -> None:
    """zeta = A nodes and gradient = A^T y, from two kernels: A's columns one by one. Held nodes get nothing."""
    rng = np.random.default_rng(4)
    if layout == "texture":  # textures of two sizes, and a third parameter that is a number
        scene = texture_scene(
            tmp_path,
            eps_r=(2 + rng.random((3, 4))).astype(np.float32),
            rms_height_m=(1e-3 * (1 + rng.random((2, 2)))).astype(np.float32),
        )
    else:
        n = len(textured_mesh().vertices)
        mesh = textured_mesh(wet=3 + 9 * rng.random(n), rough=1e-3 * (0.5 + rng.random(n)))
        fields = {"layout": "vertex", "eps_r": "wet", "rms_height_m": "rough"} if layout == "vertex" else {}
        scene = scene_of(mesh, view(30, 40), materials={"soil": {**SOIL, **fields}, "brick": {**BRICK, **fields}})
    hits, render = hits_of(scene, device)
    surface, program = render.stage.surface, render.program
    y = rng.normal(size=(hits.count, 4)).astype(np.float32)
    program.backward({render.zeta: y})
    found = render.nodes.grad.numpy().astype(float)
    held = np.setdiff1d(np.arange(found.size), surface.learned)
    assert held.size
    np.testing.assert_array_equal(found[held], 0.0)
    columns = []
    for node in surface.learned:
        ends = []
        for step in (-1.0, 1.0):
            moved = surface.nodes.copy()
            moved[node] += step
            render.set_parameters(moved)
            program.forward()
            ends.append(render.zeta.numpy().astype(float))
        columns.append(float((y * (ends[1] - ends[0]) / 2).sum()))
    # float32 in zeta, of 1 to 10, and in sums of up to some thousand terms
    np.testing.assert_allclose(found[surface.learned], columns, rtol=1e-4, atol=1e-6 * hits.count)
    assert np.count_nonzero(found) > 0.5 * surface.learned.size


@pytest.mark.parametrize("merge", [True, False])
def test_vertex(merge: bool, device: str) -> None:
    """Barycentric in the learned coordinate, along the face that was hit."""
    rng = np.random.default_rng(3)
    n = len(textured_mesh().vertices)
    mesh = textured_mesh(wet=3 + 9 * rng.random(n), rough=1e-3 * (0.5 + rng.random(n)), share=rng.random(n))
    soil = {**SOIL, "layout": "vertex", "eps_r": "wet", "specular_fraction": "share"}
    brick = {**BRICK, "layout": "vertex", "rms_height_m": "rough"}
    hits, render = hits_of(scene_of(mesh, view(30, 40), materials={"soil": soil, "brick": brick}), device, merge)
    faces, b = hits.face.numpy(), hits.barycentric.numpy().astype(float)
    weights = np.column_stack([1 - b.sum(axis=1), b])
    corners = mesh.faces[faces]
    material = mesh.face_material[faces]

    def along(values: np.ndarray) -> np.ndarray:
        return (values[corners] * weights).sum(axis=1)

    zeta = render.zeta.numpy()
    on_soil, on_brick = material == 0, material == 1
    assert on_brick.any()
    wet, rough, share = (mesh.vertex_scalars[key] for key in ("wet", "rough", "share"))
    np.testing.assert_allclose(zeta[on_soil, 0], along(np.log(wet - 1))[on_soil], atol=1e-5)
    np.testing.assert_allclose(zeta[on_soil, 3], along(np.log(share / (1 - share)))[on_soil], atol=2e-5)
    np.testing.assert_allclose(zeta[on_brick, 1], along(np.log(rough))[on_brick], atol=1e-5)
    np.testing.assert_allclose(zeta[on_brick, 0], np.log(11.0), rtol=1e-6)


@pytest.mark.parametrize("layout", ["vertex", "texture"])
def test_merged_is_per_ray_for_smooth_fields(layout: str, tmp_path: Path, device: str) -> None:
    """To 1e-3 of the image's rms where fields vary over metres: merging averages their place, not their sigma0.

    In rms over the image: sigma0 bends by some 1e-3 over a pixel, and by more where a texture has its kinks.
    """
    mesh = textured_mesh()
    x, y = (mesh.vertices[:, i] / SIZE for i in (0, 1))
    if layout == "vertex":
        eps = 6 + 3 * np.sin(3 * x + 4 * y)
        mesh = Mesh(
            mesh.vertices, mesh.faces, mesh.face_material, mesh.materials, None, {"wet": eps, "rough": 1e-4 * eps}
        )
        soil = {**SOIL, "layout": "vertex", "eps_r": "wet", "rms_height_m": "rough"}
        scene = scene_of(mesh, view(30, 40), materials={"soil": soil, "brick": BRICK})
    else:
        row, col = np.meshgrid(np.linspace(0, 1, 12), np.linspace(0, 1, 9), indexing="ij")
        scene = texture_scene(tmp_path, eps_r=(6 + 3 * np.sin(3 * row + 4 * col)).astype(np.float32))
    merged, per_ray = (warpsar.simulate(scene, device=device, merge=merge)[0].beta0["HH"] for merge in (True, False))
    assert np.sqrt(((merged - per_ray) ** 2).mean()) < 1e-3 * np.sqrt((per_ray**2).mean())
    assert np.abs(merged - per_ray).max() < 1e-2 * np.sqrt((per_ray**2).mean())


def test_image_of_a_vertex_field() -> None:
    """From nodes to pixels: level ground whose permittivity grows northward, row by row in closed form."""
    vertices, faces = ground(60, cells=30)
    ln_contrast = np.log(3.0) + vertices[:, 1] / 60  # linear in the learned coordinate: exact between vertices
    mesh = mesh_of(soil=(vertices, faces))
    mesh = Mesh(vertices, mesh.faces, mesh.face_material, ("soil",), vertex_scalars={"wet": 1 + np.exp(ln_contrast)})
    scene = scene_of(mesh, view(0, 40), materials={"soil": {**SOIL, "layout": "vertex", "eps_r": "wet"}})
    image = warpsar.simulate(scene, device="cpu")[0]
    theta = np.deg2rad(40.0)
    northing = -image.range_m / np.sin(theta)
    expected = sigma0(theta, eps_r=1 + np.exp(np.log(3.0) + northing / 60)) / np.sin(theta)
    # facets of 2 m: strata on their borders, a fiftieth of a pixel in or out
    np.testing.assert_allclose(image.beta0["HH"].mean(axis=1)[2:-2], expected[2:-2], rtol=3e-3)


# ---- the table of nodes ----


def test_surface_of_a_scene(tmp_path: Path) -> None:
    eps = np.array([[3.0, 9.0, 5.0]], np.float32)
    scene = texture_scene(tmp_path, eps_r=eps)
    surface = Surface.of(scene)
    assert surface.materials == ("soil", "brick")
    np.testing.assert_allclose(surface.values("soil", "eps_r"), eps, rtol=1e-7)
    for key in KEYS[1:]:
        np.testing.assert_allclose(surface.values("soil", key), getattr(scene.materials["soil"], key))
        np.testing.assert_allclose(surface.values("brick", key), getattr(scene.materials["brick"], key))
    assert surface.nodes.size == 3 + 3 + 4
    # what may change by default: eps_r, h and l of both, not tau
    np.testing.assert_array_equal(surface.learned, [0, 1, 2, 3, 4, 6, 7, 8])


def test_only_a_materials_own_vertices_have_nodes() -> None:
    mesh = textured_mesh(wet=np.full(len(textured_mesh().vertices), 5.0))
    brick = {**BRICK, "layout": "vertex", "eps_r": "wet"}
    surface = Surface.of(scene_of(mesh, view(0, 40), materials={"brick": brick}))
    assert surface.block("brick", "eps_r").size == 4


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.key)
def test_coordinates_and_back(kind: Any) -> None:
    values = {
        "eps_r": [1.001, 2.0, 80.0],
        "rms_height_m": [1e-5, 1e-3, 0.3],
        "correlation_length_m": [1e-3, 0.01, 5.0],
        "specular_fraction": [0.0, 1e-6, 0.3, 1 - 1e-6, 1.0],
    }[kind.key]
    coordinates = kind.to_coordinate(np.array(values))
    assert np.isfinite(coordinates).all()
    np.testing.assert_allclose(kind.from_coordinate(coordinates), values, rtol=1e-9)
