"""UV on request: charts that do not overlap, a mesh that our reader takes back, and fields learned on it."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from learning_scenes import TRUTH, bumpy, cube_scene, measured, starting, views_at
from worlds import SOIL, scene_of, view

from warpsar.cli.main import main
from warpsar.errors import InputError
from warpsar.io.images import write_exr
from warpsar.learning.command import LearnOptions, learn
from warpsar.scene.scene import Scene
from warpsar.scene.unwrap import unwrap, write_obj
from warpsar.simulation.command import simulate
from warpsar.world.mesh import Mesh, read_mesh
from warpsar.world.tables import Material


@pytest.fixture
def cube(tmp_path: Path) -> Scene:
    """A cube on a plane in files, without UV."""
    scene = starting(measured(cube_scene(views_at((20.0, 35.0), (140.0, 50.0))), tmp_path), TRUTH)
    write_obj(tmp_path / "mesh.obj", scene.mesh)
    replace(scene, mesh_path=(tmp_path / "mesh.obj").resolve()).save(tmp_path / "scene.toml")
    return Scene.load(tmp_path / "scene.toml")


def corners(mesh: Mesh, material: int) -> np.ndarray:
    return mesh.vertices[mesh.faces[mesh.face_material == material]]


def overlap(mesh: Mesh, material: int, cells: int = 400) -> int:
    """Points of a grid in [0, 1] x [0, 1] that lie inside two faces of a material, off their edges."""
    at = (np.arange(cells) + 0.5) / cells
    x, y = np.meshgrid(at, at)
    inside = np.zeros((cells, cells), int)
    assert mesh.uv is not None
    for a, b, c in mesh.uv[mesh.faces[mesh.face_material == material]].astype(float):
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        v = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
        w = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
        inside += (v > 1e-6) & (w > 1e-6) & (v + w < 1 - 1e-6)
    assert inside.max() >= 1
    return int((inside > 1).sum())


def test_charts_fill_the_square_and_do_not_overlap(cube: Scene) -> None:
    mesh = unwrap(cube.mesh)
    assert mesh.uv is not None
    assert mesh.uv.shape == (len(mesh.vertices), 2)
    assert mesh.uv.min() >= 0.0
    assert mesh.uv.max() <= 1.0
    assert mesh.materials == cube.mesh.materials
    np.testing.assert_array_equal(mesh.face_material, cube.mesh.face_material)
    for material in range(2):
        # the same triangles in the same order, each turned in its order of corners at most
        before, after = corners(cube.mesh, material), corners(mesh, material)
        np.testing.assert_array_equal(np.sort(before, axis=1), np.sort(after, axis=1))
        normal = [np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in (before, after)]
        np.testing.assert_allclose(normal[0], normal[1], rtol=1e-12, atol=1e-12)
        assert overlap(mesh, material) == 0


def test_vertex_scalars_are_split_with_their_vertices() -> None:
    mesh = replace(bumpy(), uv=None)
    mesh = replace(mesh, vertex_scalars={"z": mesh.vertices[:, 2].copy()})
    split = unwrap(mesh)
    np.testing.assert_array_equal(split.vertex_scalars["z"], split.vertices[:, 2])


def test_uv_that_is_there_stays() -> None:
    mesh = bumpy()
    half = replace(
        mesh,
        materials=("soil", "wall"),
        face_material=(np.arange(len(mesh.faces)) % 2).astype(np.int32),
        vertex_scalars={},
    )
    lacking = np.unique(half.faces[half.face_material == 1])
    kept = np.setdiff1d(np.arange(len(half.vertices)), lacking)
    assert half.uv is not None
    uv = half.uv.copy()
    only_soil = replace(
        half, vertices=np.concatenate([half.vertices] * 2), uv=np.concatenate([uv, np.full_like(uv, np.nan)])
    )
    faces = only_soil.faces.copy()
    faces[half.face_material == 1] += len(half.vertices)
    found = unwrap(replace(only_soil, faces=faces))
    assert found.uv is not None
    assert np.isfinite(found.uv).all()
    mine = found.face_material == 0
    np.testing.assert_array_equal(found.uv[found.faces[mine]], uv[half.faces[mine]])
    assert kept.size < len(half.vertices)


def test_the_reader_takes_the_obj_back(cube: Scene, tmp_path: Path) -> None:
    mesh = unwrap(cube.mesh)
    write_obj(tmp_path / "back.obj", mesh)
    back = read_mesh(tmp_path / "back.obj")
    assert back.uv is not None
    assert mesh.uv is not None
    assert back.materials == mesh.materials
    for material in range(2):
        np.testing.assert_array_equal(corners(back, material), corners(mesh, material))
        ours, theirs = (m.uv[m.faces[m.face_material == material]] for m in (mesh, back))  # type: ignore[index]
        np.testing.assert_array_equal(theirs, ours)


@pytest.mark.full
def test_the_command_leaves_a_scene_with_the_same_images(cube: Scene, tmp_path: Path) -> None:
    out = tmp_path / "with_uv"
    result = CliRunner().invoke(main, ["uv", str(tmp_path / "scene.toml"), "-o", str(out)])
    assert result.exit_code == 0, result.output
    scene = Scene.load(out / "scene.toml")
    assert scene.mesh.uv is not None
    assert np.isfinite(scene.mesh.uv).all()
    assert [v.images for v in scene.views] == [v.images for v in cube.views]
    for before, after in zip(simulate(cube, device="cpu"), simulate(scene, device="cpu"), strict=True):
        for polarization, image in before.beta0.items():
            # the same triangles; another order of a face's corners rounds differently
            np.testing.assert_allclose(after.beta0[polarization], image, rtol=1e-4, atol=1e-5 * image.max())
    # now textures fit on it, and learn writes them
    for name, key in (("ground", "rms_height_m"), ("cube", "rms_height_m")):
        write_exr(out / f"{name}.exr", {key: np.full((8, 8), 0.001)})
    text = (out / "scene.toml").read_text()
    for name in ("ground", "cube"):
        head = f"[materials.{name}]\n"
        assert head in text
        text = text.replace(head, f'{head}layout = "texture"\nlearn = ["rms_height_m"]\n')
        text = text.replace(f"rms_height_m = {TRUTH[name]['rms_height_m']}", f'rms_height_m = "{name}.exr"')
    (out / "scene.toml").write_text(text)
    found = learn(
        Scene.load(out / "scene.toml"),
        device="cpu",
        options=LearnOptions(iterations=150, total_variation={"rms_height_m": 2.0}),
        folder=tmp_path / "learned",
    )
    seen = found.problem.surface.values("ground", "rms_height_m", found.problem.nodes(found.x))
    assert np.median(seen) == pytest.approx(TRUTH["ground"]["rms_height_m"], rel=0.1)


def refused(scene: Path, out: Path) -> str:
    result = CliRunner().invoke(main, ["uv", str(scene), "-o", str(out)])
    assert result.exit_code == 2
    assert result.output.count("Error: ") == 1
    assert not (out / "mesh.obj").exists() or out == scene.parent
    return result.output


def test_refusals(cube: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "scene.toml"
    assert "would be replaced" in refused(path, tmp_path)
    with monkeypatch.context() as context:
        context.setitem(sys.modules, "xatlas", None)
        assert 'pip install "warpsar[uv]"' in refused(path, tmp_path / "out")
    assert CliRunner().invoke(main, ["uv", str(path), "-o", str(tmp_path / "once")]).exit_code == 0
    assert "nothing to unwrap" in refused(tmp_path / "once" / "scene.toml", tmp_path / "twice")


def test_vertex_layouts_are_refused(tmp_path: Path) -> None:
    from warpsar.io.ply import write_ply
    from warpsar.scene.unwrap import run

    mesh = bumpy()
    write_ply(tmp_path / "mesh.ply", mesh.vertices, mesh.faces, mesh.vertex_scalars)
    scene = scene_of(replace(mesh, materials=("default",)), view(0.0, 40.0), shape=(12, 12))
    material = Material(**{**SOIL, "layout": "vertex", "rms_height_m": "h"})
    replace(scene, materials={"default": material}, mesh_path=tmp_path / "mesh.ply").save(tmp_path / "scene.toml")
    with pytest.raises(InputError, match='layout: found "vertex"'):
        run(tmp_path / "scene.toml", tmp_path / "out")
