"""A scene made wholly in memory does all that one from a file does, and is checked at the same door."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import warpsar
from warpsar import Grid, InputError, Material, Mesh, Radar, Sampling, Scene, View
from warpsar.scene.checks import fields

GROUND = ([(-6, -6, 0), (6, -6, 0), (6, 6, 0), (-6, 6, 0)], [(0, 1, 2), (0, 2, 3)])
SOIL = {"eps_r": 6.0, "rms_height_m": 0.0012, "correlation_length_m": 0.010}
LOOKS = 64.0


def lawn_and_shed() -> Mesh:
    shed = trimesh.creation.box((4, 3, 2.5), trimesh.transformations.translation_matrix((0, 0, 1.25)))
    return Mesh.of({"lawn": GROUND, "shed": shed})


def scene_of(mesh: Mesh, views: list[View] | None = None, **changed: Any) -> Scene:
    return Scene(
        **{
            "mesh": mesh,
            "radar": Radar(frequency_hz=9.6e9, polarizations=("HH",)),
            "grid": Grid(shape=(24, 24), spacing_m=(0.6, 0.6)),
            "materials": {name: Material(**SOIL) for name in mesh.materials},
            "views": views or [View(name="south", azimuth_deg=180, incidence_deg=40)],
            "sampling": Sampling(rays_per_pixel=64.0),
            **changed,
        }
    )


def measured() -> Scene:
    """Three train views and a test view with speckled images of 64 looks, and a start that is off."""
    mesh = lawn_and_shed()
    truth = scene_of(
        mesh,
        [
            View(name=f"az{az}", azimuth_deg=az, incidence_deg=inc, role=role)
            for az, inc, role in [(180, 30, "train"), (270, 40, "train"), (20, 50, "train"), (100, 45, "test")]
        ],
    )
    random = np.random.default_rng(0)
    images = {one.name: one.beta0["HH"] for one in warpsar.simulate(truth, device="cpu", seed=9)}
    views = [
        View(
            name=view.name,
            azimuth_deg=view.azimuth_deg,
            incidence_deg=view.incidence_deg,
            role=view.role,
            looks=LOOKS,
            images={"HH": images[view.name] * random.gamma(LOOKS, 1 / LOOKS, truth.grid.shape)},
            mask=np.ones(truth.grid.shape, bool),
        )
        for view in truth.views
    ]
    soil = Material(**{**SOIL, "eps_r": 4.0}, learn=("eps_r",))
    held = Material(**SOIL, learn=())
    return replace(truth, views=views, materials={"lawn": soil, "shed": held})


@pytest.fixture(scope="module")
def scene() -> Scene:
    return measured()


def test_simulates_as_from_a_file(tmp_path: Path) -> None:
    made = scene_of(lawn_and_shed())
    made.save(tmp_path / "site.toml")
    assert {path.name for path in tmp_path.iterdir()} == {"site.toml", "site_mesh.obj"}
    loaded = Scene.load(tmp_path / "site.toml")
    assert loaded.mesh.materials == ("lawn", "shed")
    one, other = (warpsar.simulate(each, device="cpu")[0].beta0["HH"] for each in (made, loaded))
    assert (one > 0).sum() > 100
    np.testing.assert_allclose(one, other, rtol=1e-5)


def test_views_that_were_turned_together_are_saved_within_a_turn(tmp_path: Path) -> None:
    made = scene_of(lawn_and_shed())
    views = [view.model_copy(update={"azimuth_deg": 358.0 + 3.25}) for view in made.views]
    replace(made, views=views).save(tmp_path / "site.toml")
    assert [view.azimuth_deg for view in Scene.load(tmp_path / "site.toml").views] == [1.25] * len(views)


def test_learns_evaluates_and_saves(scene: Scene, tmp_path: Path) -> None:
    learned = warpsar.learn(scene, device="cpu", options=warpsar.LearnOptions(starts=1), folder=tmp_path)
    found = learned.scene.materials["lawn"].eps_r
    assert isinstance(found, float)
    assert abs(found - 6.0) < 0.3
    evaluation = warpsar.evaluate(learned.scene, device="cpu")
    assert evaluation.test is not None
    assert 0.8 < evaluation.test["deviance"] < 1.25
    learned.scene.save(tmp_path / "scene.toml")
    loaded = Scene.load(tmp_path / "scene.toml")
    for view, again in zip(scene.views, loaded.views, strict=True):
        np.testing.assert_array_equal(scene.measured(view, "HH"), loaded.measured(again, "HH"))
        np.testing.assert_array_equal(scene.mask(view), loaded.mask(again))
    assert loaded.materials["lawn"].eps_r == found


def test_diagnoses(scene: Scene) -> None:
    options = warpsar.DiagnoseOptions(family_error=0.1, draws=40, starts=0, refits=1)
    truth = replace(scene, materials={**scene.materials, "lawn": Material(**SOIL, learn=("eps_r",))})
    assert warpsar.diagnose(truth, device="cpu", options=options).diagnosis.verdict == []


def test_hash_covers_arrays_and_tables(scene: Scene) -> None:
    changed = np.array(scene.measured(scene.views[0], "HH"))
    changed[5, 7] += 0.001
    view = scene.views[0]
    hashes = {
        one.input_hash
        for one in (
            scene,
            replace(scene, views=[view.model_copy(update={"images": {"HH": changed}}), *scene.views[1:]]),
            replace(scene, views=[view.model_copy(update={"mask": None}), *scene.views[1:]]),
            replace(scene, views=[view.model_copy(update={"azimuth_deg": 181.0}), *scene.views[1:]]),
            replace(scene, materials={**scene.materials, "lawn": Material(**SOIL)}),
            replace(scene, mesh=replace(scene.mesh, vertices=scene.mesh.vertices + 0.001)),
        )
    }  # fmt: skip
    assert len(hashes) == 6
    assert measured().input_hash == scene.input_hash


def test_texture_in_memory(tmp_path: Path) -> None:
    mesh = Mesh.of(*GROUND, uv=[(0, 0), (1, 0), (1, 1), (0, 1)])
    half = np.full((4, 4), 0.0012, np.float32)
    half[:, 2:] = 0.0024  # twice as rough in the east: four times as bright
    rough = Material(**{**SOIL, "rms_height_m": half}, layout="texture")
    scene = scene_of(mesh, materials={"default": rough})
    image = warpsar.simulate(scene, device="cpu")[0].beta0["HH"]
    # with the radar on top, in the south, east is on the left
    assert image[12, 4] / image[12, 20] == pytest.approx(4.0, rel=0.02)
    scene.save(tmp_path / "scene.toml")
    again = Scene.load(tmp_path / "scene.toml")
    np.testing.assert_array_equal(again.field("default", "rms_height_m"), half)
    np.testing.assert_allclose(warpsar.simulate(again, device="cpu")[0].beta0["HH"], image, rtol=1e-5)


def test_vertex_scalars_in_memory(tmp_path: Path) -> None:
    mesh = Mesh.of(*GROUND, vertex_scalars={"wet": [4.0, 8.0, 8.0, 4.0]})
    scene = scene_of(mesh, materials={"default": Material(**{**SOIL, "eps_r": "wet"}, layout="vertex")})
    scene.save(tmp_path / "scene.toml")
    again = Scene.load(tmp_path / "scene.toml")
    images = [warpsar.simulate(one, device="cpu")[0].beta0["HH"] for one in (scene, again)]
    assert images[0][12, 4] > 1.2 * images[0][12, 20] > 0
    np.testing.assert_array_equal(*images)
    two = replace(mesh, materials=("a", "b"), face_material=[0, 1])
    vertex = Material(**{**SOIL, "eps_r": "wet"}, layout="vertex")
    with pytest.raises(InputError, match='which holds one material, "default"'):
        scene_of(two, materials={"a": vertex, "b": vertex}).save(tmp_path / "two.toml")


def test_mesh_of_trimesh() -> None:
    box = trimesh.creation.box((1, 1, 1))
    assert Mesh.of(box).materials == ("default",)
    world = trimesh.Scene()
    world.add_geometry(box, geom_name="low")
    world.add_geometry(box, geom_name="high", transform=trimesh.transformations.translation_matrix((0, 0, 5)))
    mesh = Mesh.of(world)
    assert mesh.materials == ("low", "high")
    assert mesh.vertices[mesh.faces[mesh.face_material == 1]][..., 2].min() == 4.5
    np.testing.assert_array_equal(Mesh.of(box.vertices, box.faces).faces, box.faces)


def test_mesh_of_drops_faces_of_zero_area() -> None:
    mesh = Mesh.of(GROUND[0], [*GROUND[1], (0, 1, 1)])
    assert len(mesh.faces) == 2
    assert mesh.warnings == ("1 of 3 faces have zero area and were dropped",)
    with pytest.raises(InputError, match="all 1 faces have zero area"):
        Mesh.of(GROUND[0], [(0, 1, 1)])


NAN = [(0, 0, 0), (1, 0, float("nan")), (0, 1, 0)]
BROKEN: dict[str, tuple[dict[str, Any], str]] = {
    "index": ({"faces": [(0, 1, 4)]}, r"mesh.faces: found index 4; must be from 0 to 3: there are 4 vertices"),
    "negative": ({"faces": [(0, 1, -1)]}, r"mesh.faces: found index -1; must be from 0 to 3"),
    "wraps": ({"faces": np.array([(0, 1, 2**32)])}, r"found index 4294967296; must be from 0 to 3"),
    "nan": ({"vertices": NAN, "faces": [(0, 1, 2)]}, r"1 of 3 are NaN or infinite \(the first is vertex 1"),
    "infinite": ({"vertices": np.full((4, 3), np.inf)}, r"mesh.vertices: 4 of 4 are NaN or infinite"),
    "far": ({"vertices": np.array(GROUND[0]) * 1e9}, r"found a coordinate of 6e\+09 m; must be up to 1e\+08"),
    "no faces": ({"faces": []}, r"mesh.faces: found no face; must hold triangles"),
    "no vertices": ({"vertices": []}, r"mesh.faces: found index 3; must be from 0 to -1"),
    "material": ({"face_material": [0, 1]}, r"mesh.face_material: found index 1; must be from 0 to 0: there are 1 mat"),
    "count": ({"face_material": [0]}, r"mesh.face_material: found shape \(1,\); must be \(2\)"),
    "float faces": ({"faces": np.array(GROUND[1], float)}, r"mesh.faces: found values of type float64; must be whole"),
    "text": ({"vertices": [("a", "b", "c")] * 4}, r"mesh.vertices: found values of type <U1; must be real numbers"),
    "flat": ({"vertices": np.zeros((4, 2))}, r"mesh.vertices: found shape \(4, 2\); must be \(any, 3\)"),
    "quads": ({"faces": [(0, 1, 2, 3)]}, r"mesh.faces: found shape \(1, 4\); must be \(any, 3\)"),
    "ragged": ({"faces": [(0, 1, 2), (0, 1)]}, r"mesh.faces: found rows of different lengths"),
    "names": ({"materials": ("a", "a")}, r"mesh.materials: found \('a', 'a'\); must be one or more names"),
    "one name": ({"materials": "soil"}, r"mesh.materials: found 'soil'; must be names"),
    "uv": ({"uv": np.zeros((3, 2))}, r"mesh.uv: found shape \(3, 2\); must be \(4, 2\)"),
    "scalar": ({"vertex_scalars": {"wet": [1.0]}}, r"vertex_scalars\['wet'\]: found shape \(1,\); must be \(4\)"),
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_broken_mesh_is_refused(how: str) -> None:
    changed, message = BROKEN[how]
    good = {"vertices": GROUND[0], "faces": GROUND[1], "face_material": np.zeros(2, int)}
    Mesh(**good)
    with pytest.raises(InputError, match=message):
        Mesh(**{**good, **changed})


def test_a_broken_part_is_named() -> None:
    with pytest.raises(InputError, match=r"part 'shed': mesh.faces: found index 9"):
        Mesh.of({"lawn": GROUND, "shed": (GROUND[0], [(0, 1, 9)])})
    with pytest.raises(InputError, match=r"found 'int' as 'shed'; must be a trimesh.Trimesh"):
        Mesh.of({"shed": 3})


def _with_view(**more: Any) -> Scene:
    return scene_of(Mesh.of(*GROUND), [View(name="a", azimuth_deg=0, incidence_deg=40, **more)])


WRONG: dict[str, tuple[Any, str]] = {
    "no material": (lambda: scene_of(lawn_and_shed(), materials={"lawn": Material(**SOIL)}),
        "scene in memory: materials: found lawn; must be those of the mesh: lawn, shed"),
    "size": (lambda: _with_view(images={"HH": np.ones((3, 4))}),
        r"views\[0\] \(a\).images.HH: found 3 x 4 pixels; must be 24 x 24"),
    "mask": (lambda: _with_view(mask=np.ones((3, 4))), r"\(a\).mask: found 3 x 4 pixels; must be 24 x 24"),
    "polarization": (lambda: _with_view(images={"VV": np.ones((24, 24))}), "found VV; must be one of radar.pol"),
    "negative": (lambda: _with_view(images={"HH": -np.ones((24, 24))}), r"576 pixels are negative \(down to -1\)"),
    "nan": (lambda: _with_view(images={"HH": np.full((24, 24), np.nan)}), "every pixel is NaN or infinite"),
    "complex": (lambda: _with_view(images={"HH": np.ones((24, 24), complex)}), "type complex128; must be real"),
    "cube": (lambda: _with_view(images={"HH": np.ones((24, 24, 1))}), r"found shape \(24, 24, 1\); must be \(rows"),
    "blind": (lambda: _with_view(mask=np.zeros((24, 24))), "every pixel is 0"),
    "twice": (lambda: scene_of(Mesh.of(*GROUND), [View(name=n, azimuth_deg=0, incidence_deg=4) for n in "aA"]),
        r"views\[1\].name: found 'A' again"),
    "uv": (lambda: scene_of(Mesh.of(*GROUND), materials={"default": Material(
        **{**SOIL, "eps_r": np.full((2, 2), 4.0)}, layout="texture")}), "its faces must have UV"),
    "scalar": (lambda: scene_of(Mesh.of(*GROUND), materials={"default": Material(
        **{**SOIL, "eps_r": "wet"}, layout="vertex")}), r"found 'wet'; must be a vertex scalar of the mesh"),
    "layout": (lambda: Material(**{**SOIL, "eps_r": np.full((2, 2), 4.0)}), 'an array needs layout = "texture"'),
    "values": (lambda: Material(**{**SOIL, "eps_r": np.full((2, 2), 0.5)}, layout="texture"),
        r"eps_r: 4 of 4 values are out of range \(one is 0.5\)"),
}  # fmt: skip


@pytest.mark.parametrize("how", WRONG)
def test_a_scene_that_does_not_fit_together_is_refused(how: str) -> None:
    make, message = WRONG[how]
    with pytest.raises(InputError, match=message):
        make()


def test_nan_pixels_are_masked_and_arrays_are_copied() -> None:
    image = np.ones((24, 24))
    image[2, 3] = np.inf
    scene = _with_view(images={"HH": image})
    image[:] = 5
    found = scene.measured(scene.views[0], "HH")
    assert np.isnan(found[2, 3])
    assert np.nanmax(found) == 1
    assert found.dtype == np.float32


def test_a_vertex_material_without_faces_is_refused() -> None:
    mesh = replace(Mesh.of(*GROUND, vertex_scalars={"wet": [4.0] * 4}), materials=("a", "b"))
    (problem,) = fields("b", Material(**{**SOIL, "eps_r": "wet"}, layout="vertex"), mesh)
    assert "no face of that material" in problem


@pytest.mark.parametrize("layout", ["texture", "vertex"])
def test_learned_fields_stay_in_memory(layout: str, tmp_path: Path) -> None:
    mesh = Mesh.of(*GROUND, uv=[(0, 0), (1, 0), (1, 1), (0, 1)], vertex_scalars={"rough": [0.0011] * 4})
    rough = np.full((2, 2), 0.0011) if layout == "texture" else "rough"
    material = Material(**{**SOIL, "rms_height_m": rough}, layout=layout, learn=("rms_height_m",))
    scene = scene_of(mesh, materials={"default": Material(**SOIL)})
    images = {one.name: one.beta0 for one in warpsar.simulate(scene, device="cpu")}
    views = [view.model_copy(update={"images": images[view.name], "looks": 1e3}) for view in scene.views]
    seen = replace(scene, views=views, materials={"default": material})
    learned = warpsar.learn(seen, device="cpu", options=warpsar.LearnOptions(iterations=40)).scene
    np.testing.assert_allclose(learned.field("default", "rms_height_m"), 0.0012, rtol=0.02)
    if layout == "texture":
        learned.save(tmp_path / "scene.toml")
        again = Scene.load(tmp_path / "scene.toml").field("default", "rms_height_m")
        np.testing.assert_array_equal(again, learned.field("default", "rms_height_m"))
