"""`warpsar new`: a scene for a mesh, which simulates as it is and holds the whole mesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner, Result

from warpsar.cli import new as command
from warpsar.cli import options
from warpsar.cli.main import main
from warpsar.io.images import read_channel
from warpsar.io.ply import write_ply
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.world.library.names import MEANT, surface_named
from warpsar.world.library.surfaces import SURFACES
from warpsar.world.mesh import read_mesh
from warpsar.world.objects.table import UNITS
from warpsar.world.sensors import SENSORS
from warpsar.world.world import geometry_of


def house(scale: float = 1.0) -> trimesh.Trimesh:
    """A box of 8 x 6 x 7 m on a plate of 40 x 30 m, times `scale`; away from the origin."""
    ground, box = trimesh.creation.box((40, 30, 0.2)), trimesh.creation.box((8, 6, 7))
    box.apply_translation((3, -2, 3.5))
    both = trimesh.util.concatenate([ground, box])
    both.apply_translation((100, 50, 20))
    both.apply_scale(scale)
    return both


def dem(path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    y, x = np.mgrid[:40, :60]
    heights = 200 * np.exp(-((x - 30) ** 2 + (y - 20) ** 2) / 80)
    how = {"driver": "GTiff", "height": 40, "width": 60, "count": 1, "dtype": "float32", "crs": "EPSG:32633"}
    with rasterio.open(path, "w", transform=rasterio.Affine(30, 0, 500000, 0, -30, 5e6), **how) as file:
        file.write(heights.astype("float32"), 1)


def warpsar(*arguments: object, status: int = 0) -> Result:
    done = CliRunner().invoke(main, [str(each) for each in arguments])
    assert done.exit_code == status, done.output
    return done


def sizes_m(path: Path) -> np.ndarray:
    return np.ptp(Scene.load(path).mesh.vertices, axis=0)


@pytest.mark.full
@pytest.mark.parametrize("name", ["mm.obj", "m.glb", "m.stl", "mm.stl", "m.ply", "dem.tif"])
def test_new_scene_simulates_as_it_is(name: str, tmp_path: Path) -> None:
    mesh = tmp_path / name
    dem(mesh) if name == "dem.tif" else house(1000.0 if name.startswith("mm") else 1.0).export(mesh)
    out = tmp_path / "out"
    warpsar("new", out, mesh)
    warpsar("simulate", out / "scene.toml", "-o", out / "images", "--device", "cpu")
    scene = Scene.load(out / "scene.toml")
    assert [view.role for view in scene.views] == ["train", "train", "train", "test"]
    assert max(scene.grid.shape) <= 512
    if name != "dem.tif":
        assert sizes_m(out / "scene.toml") == pytest.approx([40, 30, 7.1])
    for view in scene.views:
        image = read_channel(out / "images" / f"{view.name}.exr", "HH")
        assert np.isfinite(image).all()
        assert (image > 0).all()  # the noise of the receiver lies in every pixel
    # bounces lie farther than what they come from, and may leave the image; the surface itself may not
    for image in simulate(replace(scene, effects={}), device="cpu"):
        lit = image.beta0["HH"] > 0
        assert lit.mean() > 0.2
        assert not np.concatenate([lit[[0, -1]].ravel(), lit[:, [0, -1]].ravel()]).any()  # nothing is cut off


def test_grid_holds_layover_and_shadow(tmp_path: Path) -> None:
    """A mast without ground: its top comes nearest, and its shadow would fall far behind its foot."""
    mast = trimesh.creation.box((1, 1, 100))
    mast.apply_translation((0, 0, 50))
    mast.export(tmp_path / "mast.stl")
    warpsar("new", tmp_path, tmp_path / "mast.stl")
    scene = Scene.load(tmp_path / "scene.toml")
    rows, columns = (n * step / 2 for n, step in zip(scene.grid.shape, scene.grid.spacing_m, strict=True))
    top = np.array([0.0, 0.0, 100.0]) - scene.reference_point_m
    for view in scene.views:
        look = geometry_of(scene, view)
        assert -rows < top @ look.d
        assert top @ look.d + 100 / np.cos(np.deg2rad(40)) < rows  # where its ray meets the ground
        assert np.abs((scene.mesh.vertices - scene.reference_point_m) @ look.u).max() < columns


def test_the_ground_in_comments_takes_the_shadow(tmp_path: Path) -> None:
    """A box alone lights what the radar sees of it. With the ground there is more light, and the box's shadow in it."""
    box = trimesh.creation.box((8, 6, 7))
    box.apply_translation((100, 50, 23.5))
    box.export(tmp_path / "box.stl")
    warpsar("new", tmp_path, tmp_path / "box.stl")
    path = tmp_path / "scene.toml"
    alone, text = Scene.load(path), path.read_text()
    head, ground = text.split("# If the mesh has no ground")
    ground, views = ground.split("\n\n", 1)
    path.write_text(head + ground.replace("# ", "").split("\n", 1)[1] + "\n\n" + views)
    with_ground = Scene.load(path)
    assert list(with_ground.materials) == ["default", "ground"]
    view = with_ground.views[0]
    images = [
        simulate(replace(scene, effects={}, views=[view]), device="cpu", layers=True)[0]
        for scene in (alone, with_ground)
    ]
    lit = [(image.beta0["HH"] > 0).mean() for image in images]
    assert lit[1] > 2 * lit[0]
    # in the middle column, behind the box: 7 m / cos(40 degrees) of shadow in slant range, less the box's own depth
    lit_rows = np.flatnonzero(images[1].beta0["HH"][:, with_ground.grid.shape[1] // 2])
    dark = (np.diff(lit_rows).max() - 1) * with_ground.grid.spacing_m[0]
    assert 2.0 < dark < 7 / np.cos(np.deg2rad(40))


def test_materials_are_those_of_the_mesh(tmp_path: Path) -> None:
    text = 'v 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 1\nusemtl red "tile"\nf 1 2 3\nusemtl grüner Rasen\nf 1 3 4\n'
    (tmp_path / "roof.obj").write_text(text, encoding="utf-8")
    warpsar("new", tmp_path / "a", tmp_path / "roof.obj")
    scene = Scene.load(tmp_path / "a" / "scene.toml")
    assert list(scene.materials) == ['red "tile"', "grüner Rasen"]
    assert scene.mesh_path == (tmp_path / "roof.obj").resolve()  # referred to where it lies
    warpsar("new", tmp_path / "b", tmp_path / "roof.obj", "--units", "ft")
    scene = Scene.load(tmp_path / "b" / "scene.toml")
    assert list(scene.materials) == ['red "tile"', "grüner Rasen"]
    assert sizes_m(tmp_path / "b" / "scene.toml") == pytest.approx([9 * 0.3048, 9 * 0.3048, 0.3048])


def test_unit_is_guessed_and_said(tmp_path: Path) -> None:
    house(1000.0).export(tmp_path / "mm.obj")
    said = warpsar("new", tmp_path / "a", tmp_path / "mm.obj").output
    assert "taken as mm, a guess. If it is wrong: --units with m, cm, in, ft" in said
    assert "mm_in_metres.obj" in said
    said = warpsar("new", tmp_path / "b", tmp_path / "mm.obj", "--units", "cm").output
    assert "a guess" not in said
    assert sizes_m(tmp_path / "b" / "scene.toml") == pytest.approx([400, 300, 71])
    house().export(tmp_path / "m.stl")
    assert "taken as m, a guess" in warpsar("new", tmp_path / "c", tmp_path / "m.stl").output
    house(1000.0).export(tmp_path / "large.glb")
    said = warpsar("new", tmp_path / "d", tmp_path / "large.glb", "--yes").output
    assert "a guess" not in said  # metres, by its standard


def test_scalars_of_a_ply_are_kept_in_metres(tmp_path: Path) -> None:
    mesh = house(1000.0)
    wet = np.linspace(0, 1, len(mesh.vertices))
    write_ply(tmp_path / "mm.ply", mesh.vertices, mesh.faces, {"wet": wet})
    warpsar("new", tmp_path / "a", tmp_path / "mm.ply")
    written = read_mesh(tmp_path / "a" / "mm_in_metres.ply")
    assert np.array_equal(written.vertex_scalars["wet"], wet)
    assert np.ptp(written.vertices, axis=0) == pytest.approx([40, 30, 7.1])


def test_scene_file_that_is_there_is_kept(tmp_path: Path) -> None:
    house().export(tmp_path / "m.stl")
    (tmp_path / "scene.toml").write_text("mine")
    assert "--force" in warpsar("new", tmp_path, tmp_path / "m.stl", status=2).output
    assert (tmp_path / "scene.toml").read_text() == "mine"
    warpsar("new", tmp_path, tmp_path / "m.stl", "--force")
    assert Scene.load(tmp_path / "scene.toml").mesh.materials == ("default",)


def test_elevation_model_states_its_own_unit(tmp_path: Path) -> None:
    dem(tmp_path / "dem.tif")
    assert "--units" in warpsar("new", tmp_path / "a", tmp_path / "dem.tif", "--units", "ft", status=2).output
    assert not (tmp_path / "a").exists()


def test_a_mesh_of_unlikely_size_needs_a_yes(tmp_path: Path) -> None:
    """Kilometres of a building: nothing is written, and the message says what would scale it."""
    house(1000.0).export(tmp_path / "large.glb")
    said = warpsar("new", tmp_path / "a", tmp_path / "large.glb", status=2).output
    for words in ("large.glb: taken as m", "40000 m across", "likely the millimetre", "--units", "--yes"):
        assert words in said
    assert not (tmp_path / "a").exists()
    warpsar("new", tmp_path / "b", tmp_path / "large.glb", "--units", "mm")
    assert sizes_m(tmp_path / "b" / "scene.toml") == pytest.approx([40, 30, 7.1])
    warpsar("new", tmp_path / "c", tmp_path / "large.glb", "--yes")
    assert sizes_m(tmp_path / "c" / "scene.toml") == pytest.approx([40000, 30000, 7100])
    dem(tmp_path / "dem.tif")
    warpsar("new", tmp_path / "d", tmp_path / "dem.tif")  # 1.8 km; and elevation models may be of any size


def lying(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh as a program with Y up writes it: (x, y, z) of ours is its (x, z, -y)."""
    turned = mesh.copy()
    turned.vertices = np.stack([mesh.vertices[:, 0], mesh.vertices[:, 2], -mesh.vertices[:, 1]], axis=1)
    return turned


@pytest.mark.parametrize("name", ["a.obj", "a.ply", "a.stl"])
def test_y_up_is_seen_and_turned(name: str, tmp_path: Path) -> None:
    lying(house()).export(tmp_path / name)
    said = warpsar("new", tmp_path / "as_it_is", tmp_path / name).output
    assert "it seems to have Y up (it stands across Y), and the world has Z up; `warpsar new --up y` turns it" in said
    loaded = Scene.load(tmp_path / "as_it_is" / "scene.toml")  # and every command that loads it warns
    assert any("seems to have Y up" in warning for warning in loaded.warnings)

    said = warpsar("new", tmp_path / "turned", tmp_path / name, "--up", "y").output
    assert "a_z_up.obj: the mesh with Z up" in said
    assert "seems" not in said
    turned = Scene.load(tmp_path / "turned" / "scene.toml")
    assert not turned.warnings
    np.testing.assert_allclose(turned.mesh.vertices.min(axis=0), house().vertices.min(axis=0), atol=1e-4)
    np.testing.assert_allclose(turned.mesh.vertices.max(axis=0), house().vertices.max(axis=0), atol=1e-4)
    assert volume(turned) == pytest.approx(house().volume, rel=1e-4)  # not mirrored: that of a mirror image is negative

    said = warpsar("new", tmp_path / "stated", tmp_path / name, "--up", "z").output
    assert "seems" not in said  # the user has said it


def volume(scene: Scene) -> float:
    a, b, c = (scene.mesh.vertices[scene.mesh.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def test_y_up_and_millimetres_are_one_copy(tmp_path: Path) -> None:
    lying(house(1000.0)).export(tmp_path / "a.obj")
    said = warpsar("new", tmp_path / "a", tmp_path / "a.obj", "--up", "y").output
    assert "a_in_metres.obj: the mesh in metres with Z up" in said
    assert sizes_m(tmp_path / "a" / "scene.toml") == pytest.approx([40, 30, 7.1])
    assert "# Made from a.obj in mm, y up." in (tmp_path / "a" / "scene.toml").read_text()


def test_what_is_up_in_gltf(tmp_path: Path) -> None:
    """Y by its standard; Z where trimesh wrote it; and what the user says before both."""
    house().export(tmp_path / "by_trimesh.glb")
    data = (tmp_path / "by_trimesh.glb").read_bytes().replace(b"mikedh/trimesh", b"mikedh/another")
    (tmp_path / "a.glb").write_bytes(data)
    assert "glTF has Y up by its standard; turned to Z up" in warpsar("new", tmp_path / "1", tmp_path / "a.glb").output
    assert sizes_m(tmp_path / "1" / "scene.toml") == pytest.approx([40, 7.1, 30])
    warpsar("new", tmp_path / "2", tmp_path / "a.glb", "--up", "z")
    assert sizes_m(tmp_path / "2" / "scene.toml") == pytest.approx([40, 30, 7.1])
    assert "by trimesh" in warpsar("new", tmp_path / "3", tmp_path / "by_trimesh.glb").output
    assert sizes_m(tmp_path / "3" / "scene.toml") == pytest.approx([40, 30, 7.1])
    warpsar("new", tmp_path / "4", tmp_path / "by_trimesh.glb", "--up", "y")
    assert sizes_m(tmp_path / "4" / "scene.toml") == pytest.approx([40, 7.1, 30])


def test_an_elevation_model_has_heights(tmp_path: Path) -> None:
    dem(tmp_path / "dem.tif")
    assert "--up" in warpsar("new", tmp_path / "a", tmp_path / "dem.tif", "--up", "y", status=2).output
    assert not (tmp_path / "a").exists()


def test_a_file_of_another_type_hears_of_meshes_and_buildings(tmp_path: Path) -> None:
    (tmp_path / "town.kml").write_text("<kml/>")
    said = warpsar("new", tmp_path / "a", tmp_path / "town.kml", status=2).output
    assert "found a file of type '.kml'; must be a mesh or buildings: .obj," in said
    assert ".geojson" in said


def test_buildings_without_their_extra_name_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "town.geojson").write_text("{}")
    monkeypatch.setattr("warpsar.runtime.extra.find_spec", lambda library: None)
    said = warpsar("new", tmp_path / "a", tmp_path / "town.geojson", status=2).output
    assert said.endswith('town.geojson: a file of buildings needs shapely: pip install "warpsar[geo]"\n')


def test_options_name_every_unit() -> None:
    assert tuple(UNITS) == options.UNITS
    assert tuple(SENSORS) == command.SENSORS


@pytest.mark.parametrize(
    ("name", "surface"),
    [
        ("grass", "grass"),
        ("Asphalt.001", "asphalt"),
        ("METAL", "metal"),
        ("red brick", "brick"),
        ("brick wall", "brick"),
        ("Soil_Wet", "soil_wet"),
        ("soil wet 2", "soil_wet"),
        ("Main Road", "asphalt"),
        ("grüner Rasen", None),
        ("glasshouse", None),
        ("Material.003", None),
        ("", None),
    ],
)
def test_a_name_says_its_surface(name: str, surface: str | None) -> None:
    assert surface_named(name) == surface


def test_every_word_means_a_surface_of_the_library() -> None:
    assert set(MEANT.values()) <= set(SURFACES)
    assert not set(MEANT) & set(SURFACES)


def test_a_first_scene_has_surfaces_bounces_and_the_noise_of_a_receiver(tmp_path: Path) -> None:
    """beta0 of the noise is NESZ over sin(40 degrees): 10^-2.2 / 0.64279 = 9.816e-3."""
    text = "v 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 1\nusemtl Grass.001\nf 1 2 3\nusemtl thing\nf 1 3 4\n"
    (tmp_path / "a.obj").write_text(text)
    warpsar("new", tmp_path, tmp_path / "a.obj")
    scene = Scene.load(tmp_path / "scene.toml")
    assert scene.materials["Grass.001"].library == "grass"
    assert (scene.materials["thing"].library, scene.materials["thing"].eps_r) == (None, 5.0)
    assert scene.effects["multibounce"]["strength"] == 1.0
    assert scene.effects["noise_floor"]["level"] == pytest.approx(9.816e-3, rel=1e-3)
    assert "NESZ -22 dB" in (tmp_path / "scene.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(("size_m", "spacing_m", "said"), [(0.3, 0.04, True), (4.5, 0.04, False), (200.0, 0.5, False)])
def test_pixels_are_as_fine_as_a_radar_can_resolve(size_m: float, spacing_m: float, said: bool, tmp_path: Path) -> None:
    """At 9.6 GHz a wavelength is 0.0312 m: the next round number is 0.04 m, however small the mesh. A pixel of a large
    mesh is what 512 of them leave. The resolution is two pixels, so that levels of corners have a cell."""
    trimesh.creation.box((size_m, size_m / 2, size_m / 5)).export(tmp_path / "box.stl")
    output = warpsar("new", tmp_path, tmp_path / "box.stl", "--units", "m").output
    assert ("an image shows little of it" in output) == said
    scene = Scene.load(tmp_path / "scene.toml")
    assert scene.grid.spacing_m == (spacing_m, spacing_m)
    spread = scene.effects["point_spread"]
    assert (spread["range_fwhm_m"], spread["azimuth_fwhm_m"]) == pytest.approx((2 * spacing_m, 2 * spacing_m))


@pytest.mark.full
def test_a_first_image_has_no_warning(tmp_path: Path) -> None:
    house().export(tmp_path / "house.stl")
    warpsar("new", tmp_path, tmp_path / "house.stl")
    done = warpsar("simulate", tmp_path / "scene.toml", "-o", tmp_path / "out", "--device", "cpu")
    assert "warning" not in done.output


@pytest.mark.parametrize("name", SENSORS)
def test_a_sensor_states_what_it_is_made_of(name: str, tmp_path: Path) -> None:
    """Two pixels to a width, an incidence that the sensor has, its noise, and the sources in comments. A number that
    could not be read is said, and that of Sentinel-1, or 40 degrees, stands in its place."""
    house().export(tmp_path / "house.ply")
    warpsar("new", tmp_path, tmp_path / "house.ply", "--sensor", name)
    scene, sensor = Scene.load(tmp_path / "scene.toml"), SENSORS[name]
    assert scene.radar.frequency_hz == sensor.frequency_hz
    spread = scene.effects["point_spread"]
    assert (spread["range_fwhm_m"], spread["azimuth_fwhm_m"]) == sensor.resolution_m
    assert scene.grid.spacing_m[0] >= min(sensor.resolution_m) / 2.0
    low, high = sensor.incidence_deg or (40.0, 40.0)
    assert all(low <= view.incidence_deg <= high for view in scene.views)
    level = scene.effects["noise_floor"]["level"] * np.sin(np.deg2rad(scene.views[0].incidence_deg))
    assert 10.0 * np.log10(level) == pytest.approx(-22.0 if sensor.nesz_db is None else sensor.nesz_db, abs=0.02)
    written = (tmp_path / "scene.toml").read_text(encoding="utf-8")
    assert all(f"# {line}" in written for line in sensor.source)
    assert ("which we could not read" in written) == (sensor.nesz_db is None)
    assert ("incidences: we could not read them" in written) == (sensor.incidence_deg is None)


@pytest.mark.full
@pytest.mark.parametrize("name", ["sentinel-1", "capella"])
def test_the_scene_of_a_sensor_simulates(name: str, tmp_path: Path) -> None:
    house().export(tmp_path / "house.ply")
    warpsar("new", tmp_path, tmp_path / "house.ply", "--sensor", name)
    warpsar("simulate", tmp_path / "scene.toml", "-o", tmp_path / "out", "--looks", "2", "--device", "cpu")


def test_the_docs_list_every_sensor_with_its_numbers() -> None:
    """docs/own-mesh.md has a row for each."""
    page = (Path(__file__).parents[2] / "docs" / "own-mesh.md").read_text(encoding="utf-8")
    for name, one in SENSORS.items():
        noise = "not read" if one.nesz_db is None else f"{one.nesz_db:g}"
        degrees = "not read" if one.incidence_deg is None else "{:g} to {:g}".format(*one.incidence_deg)
        widths = "{:g} x {:g}".format(*one.resolution_m)
        assert f"| `{name}` | {one.title} | {one.frequency_hz / 1e9:g} | {widths} | {noise} | {degrees} |" in page


def test_the_example_is_copied_and_loads(tmp_path: Path) -> None:
    folder = tmp_path / "corner"
    done = CliRunner().invoke(main, ["new", str(folder), "--example"])
    assert done.exit_code == 0, done.output
    scene = folder / "scene.toml"
    assert done.output.splitlines() == [str(scene), f"next: warpsar simulate {scene} -o {folder / 'out'}"]
    assert sorted(path.name for path in folder.iterdir()) == ["scene.mtl", "scene.obj", "scene.toml"]
    assert [view.name for view in Scene.load(folder / "scene.toml").views] == ["north", "south", "west"]
    (folder / "scene.toml").unlink()
    again = CliRunner().invoke(main, ["new", str(folder), "--example"])
    assert again.exit_code == 2
    assert f"{folder / 'scene.mtl'}: found a file there already; --force replaces it" in again.output
    assert not (folder / "scene.toml").exists()
    assert CliRunner().invoke(main, ["new", str(folder), "--example", "--force"]).exit_code == 0
    assert (folder / "scene.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "MESH: found none; give a mesh or a file of buildings, or --example"),
        (["--example", "--up", "y"], "--up: found y; --example"),
    ],
)
def test_new_asks_for_a_mesh_or_the_example(arguments: list[str], message: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(main, ["new", str(tmp_path / "a"), *arguments])
    assert done.exit_code == 2
    assert message in " ".join(done.output.split())
    assert not (tmp_path / "a").exists()
