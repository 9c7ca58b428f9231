"""Mesh files of every kind become the same triangles, names and scalars; what is broken is refused."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from warpsar.errors import InputError
from warpsar.world.mesh import Mesh, read_mesh

pytestmark = pytest.mark.unit

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property float eps
element face 2
property list uchar int vertex_indices
end_header
0 0 0 2
1 0 0 3
1 1 0 4
0 1 0 5
3 2 1 0
3 0 2 3
"""


def write(folder: Path, name: str, text: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def corners(mesh: Mesh, material: str) -> np.ndarray:
    """World coordinates of a material's faces, (m, 3, 3)."""
    return mesh.vertices[mesh.faces[mesh.face_material == mesh.materials.index(material)]]


def area(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_obj_names_without_a_material_library(tmp_path: Path) -> None:
    text = SQUARE + "usemtl wet soil\nf 1 2 3\nusemtl ü#1\nf 1 3 4\nusemtl wet soil\nf 2 3 4\n"
    mesh = read_mesh(write(tmp_path, "a.obj", text))
    assert mesh.materials == ("wet soil", "ü#1")
    np.testing.assert_array_equal(corners(mesh, "ü#1"), [[[0, 0, 0], [1, 1, 0], [0, 1, 0]]])
    assert corners(mesh, "wet soil").shape == (2, 3, 3)
    assert mesh.faces.dtype == np.int32
    assert mesh.face_material.dtype == np.int32
    assert mesh.vertices.dtype == np.float64


def test_obj_object_and_group_names_stand_in_until_usemtl(tmp_path: Path) -> None:
    text = "o one\n" + SQUARE + "f 1 2 3\ng two\nf 1 3 4\nusemtl m\nf 1 2 4\no three\nf 2 3 4\n"
    mesh = read_mesh(write(tmp_path, "a.obj", text))
    assert mesh.materials == ("one", "two", "m")  # usemtl goes on until the next one, as OBJ says
    assert np.bincount(mesh.face_material).tolist() == [1, 1, 2]


def test_obj_without_names_is_default(tmp_path: Path) -> None:
    assert read_mesh(write(tmp_path, "a.obj", SQUARE + "f 1 2 3\n")).materials == ("default",)


def test_obj_relative_indices_count_from_their_line(tmp_path: Path) -> None:
    text = SQUARE + "f -4 -3 -2\nv 0 0 5\nv 1 0 5\nv 1 1 5\nf -3 -2 -1\nv 9 9 9\n"
    mesh = read_mesh(write(tmp_path, "a.obj", text))
    expected = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 5], [1, 0, 5], [1, 1, 5]]]
    np.testing.assert_array_equal(corners(mesh, "default"), expected)


@pytest.mark.parametrize("faces", ["f 1 2 3 4\n", "f 1 2 3\nf 1 3 4\n", "\tf 1\t2 \\\n3 # half\r\nf 4/ 1 3\n"])
def test_obj_polygons_continuations_and_comments(tmp_path: Path, faces: str) -> None:
    text = "# usemtl no\n" + SQUARE + faces.replace("4/", "4")
    mesh = read_mesh(write(tmp_path, "a.obj", text))
    assert mesh.materials == ("default",)
    assert area(mesh) == pytest.approx(1.0)


def test_obj_mixed_polygons(tmp_path: Path) -> None:
    mesh = read_mesh(write(tmp_path, "a.obj", SQUARE + "v .5 2 0\nf 1 2 3 5 4\nf 1 2 3 4\nf 1 2 3\n"))
    assert area(mesh) == pytest.approx(1.5 + 1.0 + 0.5)


def test_obj_uv_of_a_part_is_nan_elsewhere(tmp_path: Path) -> None:
    text = SQUARE + "vt 0 0\nvt 1 0\nvt 1 .5\nusemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 1 3 4\n"
    mesh = read_mesh(write(tmp_path, "a.obj", text))
    assert mesh.uv is not None
    assert mesh.uv.dtype == np.float32
    np.testing.assert_array_equal(mesh.uv[mesh.faces[0]], [[0, 0], [1, 0], [1, 0.5]])
    assert np.isnan(mesh.uv[mesh.faces[1]]).all()


def test_ply_keeps_order_and_scalars(tmp_path: Path) -> None:
    mesh = read_mesh(write(tmp_path, "a.ply", PLY))
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(mesh.faces, [[2, 1, 0], [0, 2, 3]])
    assert list(mesh.vertex_scalars) == ["eps"]
    np.testing.assert_array_equal(mesh.vertex_scalars["eps"], [2, 3, 4, 5])


def test_ply_keeps_order_with_texture_coordinates(tmp_path: Path) -> None:
    text = PLY.replace("property float eps\n", "property float s\nproperty float t\nproperty float eps\n")
    for x, y, e in ((0, 0, 2), (1, 0, 3), (1, 1, 4), (0, 1, 5)):
        text = text.replace(f"{x} {y} 0 {e}\n", f"{x} {y} 0 {x} {y} {e}\n")
    mesh = read_mesh(write(tmp_path, "a.ply", text))
    np.testing.assert_array_equal(mesh.uv, mesh.vertices[:, :2])
    np.testing.assert_array_equal(mesh.vertex_scalars["eps"], [2, 3, 4, 5])


def test_stl_corners_become_vertices(tmp_path: Path) -> None:
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "a.stl")
    mesh = read_mesh(tmp_path / "a.stl")
    assert mesh.vertices.shape == (8, 3)
    assert area(mesh) == pytest.approx(2 * (2 + 3 + 6))


def _glb(named: bool) -> bytes:
    box = trimesh.creation.box((1, 2, 3))
    if named:
        material = trimesh.visual.material.PBRMaterial(name="roof")
        box.visual = trimesh.visual.TextureVisuals(material=material)
    scene = trimesh.Scene()
    scene.add_geometry(box, geom_name="box", transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    return bytes(scene.export(file_type="glb"))


@pytest.mark.parametrize(("named", "name"), [(True, "roof"), (False, "box")])
def test_glb_by_trimesh_is_taken_as_it_is(tmp_path: Path, named: bool, name: str) -> None:
    mesh = read_mesh(write(tmp_path, "a.glb", _glb(named)))
    assert mesh.materials == (name,)
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [4.5, -1, -1.5])
    assert "Z up" in mesh.warnings[0]


def test_glb_by_others_is_y_up(tmp_path: Path) -> None:
    generator = b"https://github.com/mikedh/trimesh"
    data = _glb(True).replace(generator, b"Some exporter".ljust(len(generator)))
    mesh = read_mesh(write(tmp_path, "a.glb", data))
    # y up: (x, y, z) of the file stands for east x, north -z, up y.
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [4.5, -1.5, -1])
    vertex = mesh.vertices[mesh.faces]
    outward = np.cross(vertex[:, 1] - vertex[:, 0], vertex[:, 2] - vertex[:, 0])
    assert (np.einsum("ij,ij->i", outward, vertex.mean(axis=1) - [5, 0, 0]) > 0).all()  # turned, not mirrored


def test_faces_of_zero_area_are_dropped_and_counted(tmp_path: Path) -> None:
    mesh = read_mesh(write(tmp_path, "a.obj", SQUARE + "v 2 0 0\nusemtl a\nf 1 1 3\nf 1 2 5\nf 1 2 3\n"))
    assert len(mesh.faces) == len(mesh.face_material) == 1
    assert "2 of 3 faces" in mesh.warnings[0]


def test_a_sliver_far_from_the_origin_is_kept(tmp_path: Path) -> None:
    mesh = read_mesh(write(tmp_path, "a.obj", "v 500000 0 0\nv 500100 0 0\nv 500050 1e-6 0\nf 1 2 3\n"))
    assert len(mesh.faces) == 1


def test_millimetres_are_suspected(tmp_path: Path) -> None:
    mesh = read_mesh(write(tmp_path, "a.obj", "v 0 0 0\nv 12000 0 0\nv 0 8000 0\nf 1 2 3\n"))
    assert "12000 m across" in mesh.warnings[0]
    assert "likely the millimetre" in mesh.warnings[0]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.obj", "", "empty"),
        ("a.obj", "# nothing\n", "empty"),
        ("a.obj", SQUARE, "no faces"),
        ("a.obj", SQUARE + "f 1 2 9\n", "not there"),
        ("a.obj", SQUARE + "f 0 1 2\n", "index 0"),
        ("a.obj", SQUARE + "f 1 2 -5\n", "index -5"),
        ("a.obj", SQUARE + "f 1 1 2\n", "zero area"),
        ("a.obj", "v nan 0 0\n" + SQUARE + "f 1 2 3\n", "NaN"),
        ("a.obj", "v 1e300 0 0\n" + SQUARE + "f 1 2 3\n", "1e+300"),
        ("a.obj", "v x 0 0\n" + SQUARE + "f 1 2 3\n", "cannot be read as OBJ"),
        ("a.obj", b"\xff\xfe\x00\x01 binary", "empty"),
        ("a.ply", "", "empty"),
        ("a.ply", "ply\n", "cannot be read as PLY"),
        ("a.ply", PLY[:-12], "truncated"),
        ("a.ply", PLY[:-8], "found 1 of 2 face entries"),
        ("a.ply", PLY.replace("3 0 2 3", "3 0 2 7"), "vertex 7"),
        ("a.ply", PLY.replace("3 0 2 3", "3 0 2 -1"), "vertex -1"),
        ("a.ply", PLY.replace("face 2", "face 0").replace("3 2 1 0\n3 0 2 3\n", ""), "no faces"),
        ("a.stl", b"\x80" * 300, "cannot be read as STL"),
        ("a.glb", b"glTF\x02\x00\x00\x00", "cannot be read as GLB"),
        ("a.gltf", '{"asset": {"version": "2.0"}}', "empty"),
        ("a.gltf", "{", "cannot be read as GLTF"),
        ("a.tif", b"II*\x00 not really", "cannot be read as TIF"),
        ("a.dae", "", "type '.dae'"),
    ],
)
def test_broken_files_are_refused(tmp_path: Path, name: str, text: str | bytes, message: str) -> None:
    path = write(tmp_path, name, text)
    with pytest.raises(InputError) as error:
        read_mesh(path)
    assert message in str(error.value)
    assert str(path) in str(error.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such mesh"):
        read_mesh(tmp_path / "a.obj")


def test_truncated_meshes_are_refused(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    for kind in ("stl", "glb", "ply"):
        data = box.export(file_type=kind)
        with pytest.raises(InputError):
            read_mesh(write(tmp_path, f"a.{kind}", data[: len(data) * 2 // 3]))


TEXTURED = SQUARE + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\nusemtl a\nf 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n"
STL = "".join(
    f"facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\n"
    for corners in ("vertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\n", "vertex 0 0 0\nvertex 1 1 0\nvertex 0 1 0\n")
)
WHERE = r"line \d+[,:]|of 4 vertex entries: truncated|of 2 face entries: truncated|no line 'end_header'"
ENDS = r"the mesh is empty|has vertices and no faces|have zero area"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.obj", SQUARE + "f 1 2 3\nf 1 3 4\n"),
        ("a.obj", SQUARE + "f -4 -3 -2\nf -4 -2 -1\n"),
        ("a.obj", TEXTURED),
        ("a.ply", PLY),
        ("a.stl", f"solid a\n{STL}endsolid a\n"),
    ],
)
def test_a_text_cut_anywhere_is_read_or_says_where(tmp_path: Path, name: str, text: str) -> None:
    """A file that ends with a whole face is sound, for all that its text says; else the message names line or entry."""
    assert area(read_mesh(write(tmp_path, name, text))) == pytest.approx(1.0)
    for kept in range(1, len(text)):
        path = write(tmp_path, name, text[:kept])
        try:
            assert len(read_mesh(path).faces) in (1, 2)
        except InputError as error:
            said = str(error).removeprefix(f"{path}: ")
            assert re.search(f"{WHERE}|^{ENDS}" if kept > 8 else "", said), f"{kept} bytes: {said}"
            assert "Error" not in said, f"{kept} bytes: {said}"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.obj", SQUARE + "v 0 1", "line 5, the last: found 2 numbers; must be 3 or more (x, y and z)"),
        ("a.obj", SQUARE + "v 0 1\nf 1 2 3\n", "line 5: found 2 numbers"),
        ("a.obj", SQUARE + "\n# two\nv 0 1 2-\nf 1 2 3\n", "line 7: found '2-'; must be a number"),
        ("a.obj", SQUARE + "f 1 2 \\\n3\nf 1 3\nf 1 3 4\n", "line 7: found a face of 2 corners"),
        ("a.obj", SQUARE + "f 1 2 3\nf 1 2 9\n", "line 6, the last: a face refers to entry 9 of v, which is not there"),
        ("a.obj", SQUARE + "f -1 -2 -3x\n", "line 5, the last: a face has the index '-3x'"),
        ("a.ply", PLY.replace("1 1 0 4", "1 1 4"), "line 13: found 3 numbers; must be 4 (vertex 2 of 4)"),
        ("a.ply", PLY[: PLY.index("end_header")], "no line 'end_header'"),
        ("a.stl", f"solid a\n{STL[:51]}", "line 5, the last, is 'vertex 1'"),
        ("a.stl", b"\x80" * 80 + b"\x02\0\0\0" + b"\x80" * 60, "2 triangles take 184 bytes, found 144"),
    ],
)
def test_a_broken_line_is_named(tmp_path: Path, name: str, text: str | bytes, message: str) -> None:
    path = write(tmp_path, name, text)
    with pytest.raises(InputError) as error:
        read_mesh(path)
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)


# ---- GeoTIFF ----

rasterio = pytest.importorskip("rasterio", reason="needs the extra geo")


def dem(path: Path, heights: np.ndarray, origin: tuple[float, float], step: float, crs: str | None) -> Path:
    transform = rasterio.transform.from_origin(*origin, step, step)
    rows, cols = heights.shape
    with rasterio.open(path, "w", "GTiff", cols, rows, 1, crs, transform, heights.dtype, nodata=-9999.0) as target:
        target.write(heights, 1)
    return path


def test_projected_dem(tmp_path: Path) -> None:
    heights = np.arange(12, dtype=np.float32).reshape(3, 4)
    heights[0, 0] = -9999.0
    mesh = read_mesh(dem(tmp_path / "a.tif", heights, (600000.0, 5500000.0), 10.0, "EPSG:32614"))
    assert mesh.materials == ("default",)
    assert mesh.faces.shape == (2 * (2 * 3 - 1), 3)  # the cell at the missing corner is left out
    assert mesh.vertices.shape == (11, 3)
    # First valid pixel: row 0, column 1; centres are at +-5, +-15 m east and 10, 0, -10 m north.
    np.testing.assert_allclose(mesh.vertices[0], [-5, 10, 1])
    np.testing.assert_allclose(mesh.vertices[-1], [15, -10, 11])
    vertex = mesh.vertices[mesh.faces]
    up = np.cross(vertex[:, 1] - vertex[:, 0], vertex[:, 2] - vertex[:, 0])
    np.testing.assert_allclose(up[:, 2], 100.0)  # twice each triangle's area in plan, facing up


def test_geographic_dem_is_in_metres(tmp_path: Path) -> None:
    heights = np.zeros((11, 11), np.float32)
    latitude, step = 50.0, 0.001
    origin = (-97.0 - 5.5 * step, latitude + 5.5 * step)
    mesh = read_mesh(dem(tmp_path / "a.tif", heights, origin, step, "EPSG:4326"))
    # WGS84 radii of curvature at 50 degrees (a = 6378137 m, e^2 = 0.00669438).
    sine = np.sin(np.radians(latitude))
    normal = 6378137.0 / np.sqrt(1 - 0.00669438 * sine**2)
    meridional = normal * (1 - 0.00669438) / (1 - 0.00669438 * sine**2)
    width, height = np.ptp(mesh.vertices[:, 0]), np.ptp(mesh.vertices[:, 1])
    # The raster is 700 m wide: curvature over it is of the order of (350 m / 6378 km) * tan(50 deg) = 7e-5.
    assert width == pytest.approx(np.radians(10 * step) * normal * np.cos(np.radians(latitude)), rel=2e-4)
    assert height == pytest.approx(np.radians(10 * step) * meridional, rel=2e-4)
    np.testing.assert_allclose(mesh.vertices[60, :2], 0.0, atol=1e-6)


def test_dem_in_feet_and_without_a_crs(tmp_path: Path) -> None:
    heights = np.zeros((3, 3), np.float32)
    feet = read_mesh(dem(tmp_path / "a.tif", heights, (2e6, 1e6), 10.0, "EPSG:2263"))
    assert np.ptp(feet.vertices[:, 0]) == pytest.approx(20 * 1200 / 3937)  # US survey feet
    plain = read_mesh(dem(tmp_path / "b.tif", heights, (0.0, 0.0), 10.0, None))
    assert np.ptp(plain.vertices[:, 0]) == 20.0
    assert "no coordinate system" in plain.warnings[0]


def test_dem_without_a_whole_cell_is_refused(tmp_path: Path) -> None:
    heights = np.full((3, 3), -9999.0, np.float32)
    with pytest.raises(InputError, match="triangles"):
        read_mesh(dem(tmp_path / "a.tif", heights, (0.0, 0.0), 10.0, None))
