"""Objects of a scene: where their vertices come to lie, what is saved, and what is refused."""

from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import tomlkit

import warpsar
from warpsar.errors import InputError
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.mesh import Mesh, read_mesh
from warpsar.world.objects.groups import group_names
from warpsar.world.objects.pose import foot, placed, rotation
from warpsar.world.objects.shapes import body
from warpsar.world.objects.table import Object, Primitive
from warpsar.world.tables import Grid, Material, Radar, View
from warpsar.world.world import posed

pytestmark = pytest.mark.unit

SOIL = {"eps_r": 6.0, "rms_height_m": 0.0012, "correlation_length_m": 0.010}
FLOOR = {"name": "floor", "primitive": "plate", "size_m": [30.0, 30.0, 0.0], "material": "soil"}
OBJ = """\
o wheel
v 0 0 0
v 1 0 0
v 1 0 2
v 0 0 2
v 1 3 0
v 1 3 2
f 1 2 3
f 1 3 4
o door
f 2 5 6
f 2 6 3
"""
"""An L of two sheets that share an edge: x from 0 to 1, y from 0 to 3, z from 0 to 2."""


def written(folder: Path, objects: list[dict[str, Any]], mesh: str | None = None, **more: Any) -> Path:
    names = more.pop("materials", ["soil", "body"])
    scene = {
        "scene": {"mesh": mesh} if mesh else {},
        "radar": {"frequency_hz": 9.6e9, "polarizations": ["HH"]},
        "image": {"shape": [80, 80], "spacing_m": [0.25, 0.25]},
        "materials": dict.fromkeys(names, SOIL),
        "objects": objects,
        "views": [{"name": "a", "azimuth_deg": 20.0, "incidence_deg": 40.0}],
    }
    path = folder / "scene.toml"
    path.write_text(tomlkit.dumps(scene))
    return path


def with_floor(folder: Path, **one: Any) -> Scene:
    return Scene.load(written(folder, [FLOOR, {"material": "body", **one}]))


def own(scene: Scene, name: str) -> np.ndarray:
    assert scene.assembly is not None
    return scene.assembly.vertices_of(next(one for one in scene.objects if one.label == name))


@pytest.mark.parametrize(
    ("turned", "point", "found"),
    [
        ({"heading_deg": 90.0}, (0, 1, 0), (1, 0, 0)),  # the front, north, turns clockwise to the east
        ({"pitch_deg": 90.0}, (0, 1, 0), (0, 0, 1)),  # nose up
        ({"roll_deg": 90.0}, (1, 0, 0), (0, 0, -1)),  # right side down
        ({"roll_deg": 90.0, "pitch_deg": 90.0}, (0, 0, 1), (1, 0, 0)),  # roll first: up lies east, which pitch leaves
        ({"pitch_deg": 90.0, "heading_deg": 90.0}, (0, 0, 1), (-1, 0, 0)),  # pitch first: up lies south, then west
    ],
)
def test_rotation(turned: dict[str, float], point: tuple[int, ...], found: tuple[int, ...]) -> None:
    angles = {"heading_deg": 0.0, "pitch_deg": 0.0, "roll_deg": 0.0, **turned}
    np.testing.assert_allclose(rotation(**angles) @ point, found, atol=1e-15)


def test_a_placed_box_by_hand() -> None:
    """4 m long, 2 m wide, 1 m high, twice as long, at (10, 20, 3), facing east: 8 m east, 2 m north."""
    table = Object(primitive="box", size_m=(4, 2, 1), position_m=(10, 20, 3), heading_deg=90.0, scale=(2.0, 1.0, 1.0))
    vertices = placed(body(table).vertices, table)
    np.testing.assert_allclose(vertices.min(axis=0), (6, 19, 3), atol=1e-12)
    np.testing.assert_allclose(vertices.max(axis=0), (14, 21, 4), atol=1e-12)
    # the right side of the front, at the foot: south, as one who faces east has it
    assert np.abs(vertices - (14, 19, 3)).max(axis=1).min() < 1e-12


def test_a_file_in_other_axes_and_units(tmp_path: Path) -> None:
    """Front +X and up +Y of the file, in inches: its x is north, its y up, and so its z east."""
    (tmp_path / "part.obj").write_text("v 0 0 0\nv 100 0 0\nv 100 50 0\nv 0 0 20\nf 1 2 3\nf 1 2 4\n")
    scene = with_floor(tmp_path, name="part", mesh="part.obj", units="in", up="+Y", front="+X")
    vertices = own(scene, "part") / 0.0254
    expected = [(-10, -50, 0), (-10, 50, 0), (-10, 50, 50), (10, -50, 0)]
    for one in expected:
        assert np.abs(vertices - one).max(axis=1).min() < 1e-9


def test_a_file_with_y_up_is_told_once(tmp_path: Path) -> None:
    """A tent whose ridge is along y lies on its side: its table has a key for that."""
    corners = "v -5 0 -4\nv 5 0 -4\nv 5 0 4\nv -5 0 4\nv -5 3 0\nv 5 3 0\n"
    (tmp_path / "tent.obj").write_text(corners + "f 1 2 6 5\nf 3 4 5 6\nf 4 1 5\nf 2 3 6\nf 1 4 3 2\n")
    several = [
        {"name": f"tent{k}", "mesh": "tent.obj", "material": "body", "position_m": [2.0 * k, 0.0, 0.0]}
        for k in range(3)
    ]
    (told,) = Scene.load(written(tmp_path, [FLOOR, *several])).warnings
    assert told.startswith("objects[1] (tent0).mesh: ")
    assert told.endswith(
        'it seems to have Y up (it stands across Y), and the world has Z up; up = "+Y" with front = "+Z" turns it'
    )
    turned = [{**one, "up": "+Y", "front": "+Z"} for one in several]
    assert Scene.load(written(tmp_path, [FLOOR, *turned])).warnings == ()


@pytest.mark.parametrize("primitive", ["box", "cylinder", "sphere", "plate", "car", "truck", "dihedral", "trihedral"])
def test_primitives_fill_their_size_and_close(primitive: Any) -> None:
    """The extent is the stated one, the foot is in the origin; bodies are closed: every edge belongs to two faces."""
    made = body(Object(primitive=primitive, size_m=(4.0, 2.0, 1.0)))
    low, high = made.vertices.min(axis=0), made.vertices.max(axis=0)
    lift = 0.12 if primitive in ("car", "truck") else 0.0  # the clearance
    np.testing.assert_allclose(high - low, (2.0, 4.0, 1.0 - lift), rtol=1e-9)
    np.testing.assert_allclose(foot(made.vertices), (0, 0, lift), atol=1e-9)
    p = made.vertices[made.faces]
    assert np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).min() > 1e-6
    if primitive not in ("dihedral", "trihedral"):
        merged = np.unique(np.round(made.vertices, 9), axis=0, return_inverse=True)[1].ravel()[made.faces]
        edges = np.sort(np.concatenate([merged[:, (0, 1)], merged[:, (1, 2)], merged[:, (2, 0)]]), axis=1)
        assert set(np.unique(edges, axis=0, return_counts=True)[1]) == {2}
        # outward normals: the volume by the divergence theorem is positive, and no larger than that of the box
        volume = np.einsum("ij,ij->i", p[:, 0], np.cross(p[:, 1], p[:, 2])).sum() / 6.0
        assert 0 < volume <= 8.0 * (1 + 1e-9)


def test_volumes_in_closed_form() -> None:
    """A cylinder of 48 sides is an ellipse's area times 24/pi sin(pi/24) short; a sphere lies within 1 %."""

    def volume(**table: Any) -> float:
        made = body(Object(**table))
        p = made.vertices[made.faces]
        return float(np.einsum("ij,ij->i", p[:, 0], np.cross(p[:, 1], p[:, 2])).sum() / 6.0)

    cylinder = np.pi * 2 * 1 * 3 * (24 / np.pi * np.sin(np.pi / 24))
    assert volume(primitive="cylinder", size_m=(4.0, 2.0, 3.0)) == pytest.approx(cylinder, rel=1e-12)
    assert volume(primitive="sphere", size_m=(2.0, 2.0, 2.0)) == pytest.approx(4 / 3 * np.pi, rel=0.01)


def test_instances_share_one_mesh(tmp_path: Path) -> None:
    (tmp_path / "part.obj").write_text(OBJ)
    several = [
        {"name": f"part{k}", "mesh": "part.obj", "position_m": [4.0 * k, 0.0, 0.0], "material": "body"}
        for k in range(3)
    ]
    scene = Scene.load(written(tmp_path, [FLOOR, *several]))
    assert scene.assembly is not None
    assert len(scene.assembly.templates) == 1
    first, last = own(scene, "part0"), own(scene, "part2")
    np.testing.assert_allclose(last - first, np.tile((8.0, 0.0, 0.0), (len(first), 1)))


def test_several_materials_of_one_object(tmp_path: Path) -> None:
    """The file's two names become two of the scene's, or one and the same."""
    (tmp_path / "part.obj").write_text(OBJ)
    part = {"name": "p", "mesh": "part.obj", "position_m": [3.0, 0.0, 0.0]}
    for door, expected in (("soil", ("body", "soil")), ("body", ("body",))):
        named = {**part, "materials": {"wheel": "body", "door": door}}
        scene = Scene.load(written(tmp_path, [FLOOR, named]))
        assert scene.assembly is not None
        placed_mesh = scene.assembly.placed(scene.objects[1])
        assert placed_mesh.materials == expected
        names = [placed_mesh.materials[k] for k in placed_mesh.face_material]
        assert names == ["body", "body", door, door]
        again = tmp_path / "again"
        again.mkdir(exist_ok=True)
        scene.save(again / "scene.toml")
        assert Scene.load(again / "scene.toml").objects[1].materials == named["materials"]


@pytest.mark.parametrize("group", ["wheel", "door"])
def test_a_group_moves_alone(tmp_path: Path, group: str) -> None:
    """One sheet turns a quarter about its middle and rises; the other, with which it shared an edge, stays."""
    (tmp_path / "scene.obj").write_text(OBJ)
    plain = read_mesh(tmp_path / "scene.obj")
    turned = {"group": group, "heading_deg": 90.0, "position_m": [0.0, 0.0, 1.0]}
    scene = Scene.load(written(tmp_path, [turned], "scene.obj", materials=["wheel", "door"]))
    index = plain.materials.index(group)

    def corners(mesh: Mesh, mine: bool) -> np.ndarray:
        return mesh.vertices[mesh.faces[(mesh.face_material == index) == mine]]

    np.testing.assert_array_equal(corners(scene.mesh, False), corners(plain, False))
    before = corners(plain, True)
    middle = (0.5, 0.0) if group == "wheel" else (1.0, 1.5)
    x, y = before[..., 0] - middle[0], before[..., 1] - middle[1]
    # clockwise by 90 degrees: (x, y) becomes (y, -x)
    expected = np.stack([middle[0] + y, middle[1] - x, before[..., 2] + 1.0], axis=-1)
    np.testing.assert_allclose(corners(scene.mesh, True), expected, atol=1e-12)


def test_groups_by_usemtl_o_and_g(tmp_path: Path) -> None:
    """All three names mean their faces; a `usemtl` goes before an `o` of the same name."""
    text = OBJ.replace("o wheel", "o car\ng left\nusemtl steel").replace("o door", "g right\nusemtl car")
    (tmp_path / "scene.obj").write_text(text)
    mesh = read_mesh(tmp_path / "scene.obj", groups=True)
    counts = {name: len(faces) for name, faces in mesh.groups.items()}
    assert counts == {"steel": 2, "car": 2, "left": 2, "right": 2}
    np.testing.assert_array_equal(mesh.groups["car"], mesh.groups["right"])
    names = group_names(read_mesh(tmp_path / "scene.obj"), tmp_path / "scene.obj")
    assert sorted(names) == ["car", "left", "right", "steel"]


def test_groups_of_a_gltf_are_its_nodes(tmp_path: Path) -> None:
    """A node means what hangs below it, too."""
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.Scene()
    scene.graph.update("car", "world", matrix=np.eye(4))
    scene.add_geometry(trimesh.creation.box(), node_name="body", geom_name="body", parent_node_name="car")
    scene.add_geometry(trimesh.creation.icosahedron(), node_name="ball", geom_name="ball")
    (tmp_path / "scene.glb").write_bytes(scene.export(file_type="glb"))
    groups = read_mesh(tmp_path / "scene.glb", groups=True).groups
    assert {name: len(groups[name]) for name in ("car", "body", "ball")} == {"car": 12, "body": 12, "ball": 20}


def test_a_scene_with_objects_is_saved(tmp_path: Path) -> None:
    (tmp_path / "part.obj").write_text(OBJ)
    car = {"name": "c", "primitive": "car", "size_m": [4.5, 1.8, 1.5], "material": "body", "learn": ["position"]}
    part = {"name": "p", "mesh": "part.obj", "material": "body", "position_m": [5.0, 5.0, 0.0]} | {
        "scale": [1.0, 2.0, 1.0]
    }
    scene = Scene.load(written(tmp_path, [FLOOR, car, part]))
    floor, one, other = scene.objects
    moved = [floor, one.model_copy(update={"position_m": (1.0, 2.0, 0.0)}), other]
    moved[2] = other.model_copy(update={"scale": (1.0, 2.0, 1.5)})
    (tmp_path / "out").mkdir()
    posed(scene, moved).save(tmp_path / "out" / "scene.toml")
    again = Scene.load(tmp_path / "out" / "scene.toml")
    assert again.objects[1:] == tuple(moved)[1:]
    np.testing.assert_array_equal(again.mesh.vertices, posed(scene, moved).mesh.vertices)
    assert 'mesh = "../part.obj"' in (tmp_path / "out" / "scene.toml").read_text()
    assert "mesh" not in tomlkit.parse((tmp_path / "out" / "scene.toml").read_text())["scene"]


def test_an_object_is_the_same_scene_as_its_triangles(tmp_path: Path) -> None:
    """A box as an object, and the same triangles in the scene's mesh: one image, to the bit."""
    place = {"heading_deg": 25.0, "position_m": [1.0, 2.0, 0.0]}
    scene = with_floor(tmp_path, name="b", primitive="box", size_m=[4.0, 2.0, 3.0], **place)
    flat = Scene(scene.mesh, scene.radar, scene.grid, scene.materials, scene.views, sampling=scene.sampling)
    image, expected = (warpsar.simulate(one, device="cpu")[0].beta0["HH"] for one in (scene, flat))
    np.testing.assert_array_equal(image, expected)
    assert image.max() > 0


CAR = {"name": "c", "primitive": "car", "size_m": [4.5, 1.8, 1.5], "material": "body"}


@pytest.mark.parametrize(
    ("one", "says"),
    [
        ({**CAR, "position_m": [300.0, 0.0, 0.0]}, "outside the image in every view"),
        ({**CAR, "position_m": [0.0, 0.0, -1.0]}, "more than half of it in the ground"),
        ({**CAR, "name": "floor"}, "found 'floor' again"),
        ({**FLOOR, "name": "again"}, "at the same place again"),
        ({**CAR, "scale": 0.0}, "must be a number above 0"),
        ({**CAR, "scale": [1.0, 0.0, 1.0]}, "must be a number above 0"),
        ({**CAR, "size_m": [4.5, 1.8, 0.0]}, "all three must be above 0"),
        ({"name": "s", "primitive": "sphere", "size_m": [2.0, 2.0, 2.0], "heading_deg": 5.0}, "which has no front"),
        ({"name": "m", "mesh": "part.obj", "up": "+Y", "front": "-Y"}, "must lie on two axes"),
        ({**CAR, "mesh": "part.obj"}, "found mesh and primitive; must be exactly one of"),
        ({"name": "n"}, "found no body; must be exactly one of"),
        ({**CAR, "units": "mm"}, "found units with a car"),
        ({"name": "b", "primitive": "box", "size_m": [1.0, 1.0, 1.0], "cabin": 0.5}, "found cabin with a box"),
        ({"group": "tower", "size_m": [1.0, 1.0, 1.0]}, "found size_m with a group"),
        ({"group": "tower"}, "must be a group of the scene's mesh"),
        ({"name": "m", "mesh": "none.obj"}, "no such mesh file"),
        ({**CAR, "learn": ["place"]}, "learn"),
        (
            {"name": "m", "mesh": "part.obj", "materials": {"wheel": "body"}},
            "must be the names of its mesh: wheel, door",
        ),
        ({"name": "m", "mesh": "part.obj", "material": "body", "materials": {}}, "found material and materials"),
        ({"primitive": "box", "size_m": [1.0, 1.0, 1.0], "materials": {"a": "b"}}, "found materials with a box"),
        ({"name": "s", "primitive": "cylinder", "size_m": [2.0, 2.0, 2.0], "learn": ["heading"]}, "which has no front"),
        ({**CAR, "tolerance": {"position": 0.3}}, "position has no tolerance"),
        ({**CAR, "tolerance": {"position_m": 0.0}}, "must be a number above 0"),
        ({**CAR, "colour": "red"}, "unknown key"),
    ],
)
def test_bad_objects_are_refused_in_one_message(tmp_path: Path, one: dict[str, Any], says: str) -> None:
    (tmp_path / "part.obj").write_text(OBJ)
    (tmp_path / "ground.obj").write_text("usemtl soil\nv -15 -15 0\nv 15 -15 0\nv 15 15 0\nv -15 15 0\nf 1 2 3 4\n")
    scenes: list[tuple[list[dict[str, Any]], str | None]] = [([FLOOR, one], None)]
    if says.startswith("more than half"):  # the ground is the scene's own mesh, or the widest plate
        scenes.append(([one], "ground.obj"))
    for objects, base in scenes:
        with pytest.raises(InputError) as refused:
            Scene.load(written(tmp_path, objects, base))
        assert says in str(refused.value)
        assert "\n" not in str(refused.value)
        assert "objects" in str(refused.value)


def test_a_narrow_plate_is_no_ground(tmp_path: Path) -> None:
    """A car under a roof alone: nothing says where the ground is."""
    roof = {"name": "roof", "primitive": "plate", "size_m": [3.0, 2.0, 0.0], "position_m": [0.0, 0.0, 3.0]}
    scene = Scene.load(written(tmp_path, [{**roof, "material": "soil"}, CAR], None))
    assert [one.label for one in scene.objects] == ["roof", "c"]


def test_tolerances_are_standard_deviations() -> None:
    table = Object(
        primitive="box", size_m=(4.0, 2.0, 1.0), tolerance={"position_m": 0.3, "size_m": "5 %"}, position_m=(1, 2, 3)
    )
    assert table.known_of("position_m", table.position_m) == ((1.0, 0.3), (2.0, 0.3), (3.0, 0.3))
    sizes = table.known_of("size_m", (4.0, 2.0, 1.0))
    assert [sd for _, sd in sizes] == pytest.approx((0.2, 0.1, 0.05))
    assert table.known_of("heading_deg", (0.0,)) == ((0.0, float("inf")),)


def test_a_tolerance_stays_about_what_was_known(tmp_path: Path) -> None:
    """What a fit writes keeps the known value beside its own, and is read again."""
    car = {**CAR, "position_m": [1.0, 2.0, 0.0], "tolerance": {"position_m": 0.3, "size_m": "5 %"}}
    scene = with_floor(tmp_path, **car)
    moved = scene.objects[1].pinned().model_copy(update={"position_m": (1.5, 2.0, 0.0)})
    (tmp_path / "out").mkdir()
    posed(scene, [scene.objects[0], moved]).save(tmp_path / "out" / "scene.toml")
    (_, again) = Scene.load(tmp_path / "out" / "scene.toml").objects
    assert again.position_m == (1.5, 2.0, 0.0)
    assert again.known_of("position_m", again.position_m) == ((1.0, 0.3), (2.0, 0.3), (0.0, 0.3))
    assert [sd for _, sd in again.known_of("size_m", (9.0, 9.0, 9.0))] == pytest.approx((0.225, 0.09, 0.075))
    assert again.pinned().tolerance == again.tolerance


def test_uv_refuses_a_scene_with_objects(tmp_path: Path) -> None:
    from warpsar.scene.unwrap import run

    path = written(tmp_path, [FLOOR], materials=["soil"])
    with pytest.raises(InputError, match="give UV to each mesh alone"):
        run(path, tmp_path / "out")


def test_the_page_s_scenes(tmp_path: Path) -> None:
    """The scene of each primitive in docs/objects.md simulates, and every body is seen."""
    page = (Path(__file__).resolve().parents[2] / "docs" / "objects.md").read_text(encoding="utf-8")
    first, whole, _ = (part.split("```")[0] for part in page.split("```toml\n")[1:])
    assert Object(**tomlkit.parse(first).unwrap()["objects"][0]).label == "btr70"
    (tmp_path / "scene.toml").write_text(whole, encoding="utf-8")
    scene = Scene.load(tmp_path / "scene.toml")
    assert {one.primitive for one in scene.objects} == set(get_args(Primitive))
    image = warpsar.simulate(scene, device="cpu")[0]
    assert image.lit_fraction > 0.5
    for one in scene.objects[1:]:
        without = with_objects(scene, [other for other in scene.objects if other is not one])
        assert not np.array_equal(warpsar.simulate(without, device="cpu")[0].beta0["HH"], image.beta0["HH"])


def test_objects_in_memory() -> None:
    """A car in a scene that was made from arrays; bad ones are refused as those of a file are."""
    plain = Scene(
        Mesh.of([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [(0, 1, 2), (0, 2, 3)]),
        Radar(frequency_hz=9.6e9, polarizations=("HH",)),
        Grid(shape=(40, 40), spacing_m=(0.5, 0.5)),
        {"default": Material(**SOIL)},
        [View(name="a", azimuth_deg=20.0, incidence_deg=40.0)],
    )
    car = Object(primitive="car", size_m=(4.5, 1.8, 1.5), material="body")
    scene = with_objects(plain, [car], {"body": Material(**SOIL)})
    assert scene.mesh.materials == ("default", "body")
    assert with_objects(scene, []).mesh.materials == ("default",)
    with pytest.raises(InputError, match="found 'car' again"):
        with_objects(plain, [car, car], {"body": Material(**SOIL)})
    with pytest.raises(InputError, match="must be those of the mesh"):
        with_objects(plain, [car])
