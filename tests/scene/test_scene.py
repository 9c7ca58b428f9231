"""A scene file is read whole or refused in one message that names key, found and allowed; and written back."""

import dataclasses
import math
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from warpsar.errors import InputError
from warpsar.io.images import write_exr, write_tiff
from warpsar.scene.scene import Scene
from warpsar.world.tables import Grid, Material, Sampling

pytestmark = pytest.mark.unit

OBJ = """vt 0 0
vt 1 0
vt 1 1
v 0 0 0
v 9 0 0
v 9 9 0
v 0 9 0
usemtl ground
f 1/1 2/2 3/3
usemtl roof
f 1 3 4
"""

TOML = """# The user's own words.
[scene]
mesh = "scene.obj"

[radar]
frequency_hz = 9.6e9  # X band
polarizations = ["HH", "VV"]

[image]
shape = [4, 6]
spacing_m = [0.5, 0.25]

[materials.roof]
eps_r = [6.0, -0.5]
rms_height_m = 0.002
correlation_length_m = 0.02

[materials.ground]
eps_r = 4.0          # dry
rms_height_m = 0.001
correlation_length_m = 0.01

[[views]]
name = "az000"
azimuth_deg = 0.0
depression_deg = 50.0
images = { HH = "hh.tif", VV = "both.exr" }
mask = "mask.npy"
looks = 16.0

[[views]]
name = "az090"
azimuth_deg = 90
incidence_deg = 45
frequency_hz = 1e10
slant_range_m = 350.0
role = "test"
"""

Change = Callable[[str, str], Path]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scene with two materials, one view with two images and a mask, and one view without."""
    power = np.random.default_rng(0).exponential(1.0, (4, 6)).astype(np.float32)
    write_tiff(tmp_path / "hh.tif", power)
    write_exr(tmp_path / "both.exr", {"VV": 3 * power, "HH": power})
    np.save(tmp_path / "mask.npy", power > 0.2)
    (tmp_path / "scene.obj").write_text(OBJ)
    (tmp_path / "scene.toml").write_text(TOML)
    return tmp_path


@pytest.fixture
def changed(folder: Path) -> Change:
    """The scene file with a piece of its text replaced."""

    def change(old: str, new: str) -> Path:
        assert old in TOML
        (folder / "scene.toml").write_text(TOML.replace(old, new, 1))
        return folder / "scene.toml"

    return change


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as error:
        Scene.load(path)
    assert str(error.value).startswith(str(path))
    return str(error.value)


def test_what_is_read(folder: Path) -> None:
    scene = Scene.load(folder / "scene.toml")
    assert scene.path == (folder / "scene.toml").resolve()
    assert list(scene.materials) == list(scene.mesh.materials) == ["ground", "roof"]  # the mesh's order
    assert scene.materials["roof"].eps_r == (6.0, -0.5)
    assert scene.materials["ground"].specular_fraction == 0.0
    assert scene.materials["ground"].learn == ("eps_r", "rms_height_m", "correlation_length_m")
    assert scene.grid == Grid(shape=(4, 6), spacing_m=(0.5, 0.25), calibrated=True)
    assert scene.reference_point_m == (0.0, 0.0, 0.0)
    first, second = scene.views
    assert (first.incidence_deg, second.incidence_deg) == (40.0, 45.0)
    assert (first.role, second.role) == ("train", "test")
    assert scene.slant_range_m(first) is None
    assert scene.slant_range_m(second) == 350.0
    # k of X band (f = 9.6 GHz).
    assert scene.wavenumber(first) == pytest.approx(201.2011, abs=5e-5)
    assert scene.wavenumber(second) == pytest.approx(2 * math.pi * 1e10 / 299792458.0)
    hh, vv = scene.measured(first, "HH"), scene.measured(first, "VV")
    assert hh.shape == (4, 6)
    assert hh.dtype == np.float32
    np.testing.assert_array_equal(vv, 3 * hh)
    np.testing.assert_array_equal(scene.mask(first), hh > 0.2)
    assert scene.mask(second) is None
    assert scene.warnings == ()


def test_density_of_rays() -> None:
    grid = Grid(shape=(2, 2), spacing_m=(0.5, 0.25))
    assert Sampling().density_per_m2(grid) == 64 / 0.125
    assert Sampling(rays_per_pixel=16.0).density_per_m2(grid) == 128.0
    assert Sampling(rays_per_m2=7.0).density_per_m2(grid) == 7.0


@pytest.mark.parametrize(
    ("old", "new", "messages"),
    [
        ("frequency_hz = 9.6e9", "frequency = 9.6e9", ["radar.frequency: unknown key", "radar.frequency_hz: missing"]),
        ("frequency_hz = 9.6e9", "frequency_hz = 9.6", ["radar.frequency_hz: found 9.6", "1000000"]),
        ("frequency_hz = 9.6e9", 'frequency_hz = "9.6e9"', ["radar.frequency_hz: found '9.6e9'", "number"]),
        ("frequency_hz = 9.6e9", "frequency_hz = nan", ["radar.frequency_hz: found nan", "finite"]),
        ("frequency_hz = 9.6e9", "frequency_hz = true", ["radar.frequency_hz: found True"]),
        ('["HH", "VV"]', '["HH", "XX"]', ["radar.polarizations[1]: found 'XX'", "'HH', 'HV', 'VH' or 'VV'"]),
        ('["HH", "VV"]', '["HH", "HH"]', ["radar.polarizations", "twice"]),
        ('["HH", "VV"]', "[]", ["radar.polarizations: found []"]),
        ('["HH", "VV"]', '["HH"]', ["views[0] (az000).images: found VV", "radar.polarizations, HH"]),
        ("shape = [4, 6]", "shape = [6, 4]", ["views[0] (az000).images.HH", "found 4 x 6", "must be 6 x 4"]),
        ("shape = [4, 6]", "shape = [4.0, 6]", ["image.shape[0]: found 4.0"]),
        ("shape = [4, 6]", "shape = [100000, 100000]", ["image.shape", "2^28"]),
        ("shape = [4, 6]", "shape = [4, 6, 1]", ["image.shape"]),
        ("spacing_m = [0.5, 0.25]", "spacing_m = [0.5, 0]", ["image.spacing_m[1]: found 0"]),
        ("spacing_m = [0.5, 0.25]", "", ["image.spacing_m: missing"]),
        ("eps_r = 4.0 ", "eps_r = 1.0 ", ["materials.ground.eps_r: found 1.0", "above 1"]),
        ("eps_r = 4.0 ", "eps_r = inf ", ["materials.ground.eps_r: found inf"]),
        ("eps_r = 4.0 ", "eps_r = [4.0, 0.5] ", ["materials.ground.eps_r: found [4.0, 0.5]", "not above 0"]),
        ("eps_r = 4.0 ", 'eps_r = "eps.exr" ', ["materials.ground.eps_r: found 'eps.exr'", "layout"]),
        ("rms_height_m = 0.001", "rms_height_m = -1", ["materials.ground.rms_height_m: found -1", "above 0"]),
        ("correlation_length_m = 0.01\n", "correlation_length_m = [1, 2]\n", ["correlation_length_m", "separable"]),
        ("[materials.ground]", "[materials.soil]", ["found roof, soil", "ground, roof"]),
        (
            "[materials.ground]",
            "[materials.ground]\ntau = 0.1",
            ["materials.ground.tau: unknown key", "specular_fraction"],
        ),
        ("[materials.ground]", '[materials.ground]\nlearn = ["h"]', ["materials.ground.learn[0]: found 'h'"]),
        ("[materials.roof]", '[materials.roof]\nlayout = "texture"', ["materials.roof.layout", "UV"]),
        ("depression_deg = 50.0", "incidence_deg = 100.0", ["views[0] (az000).incidence_deg: found 100.0", "90"]),
        ("depression_deg = 50.0", "depression_deg = 50\ngrazing_deg = 50", ["found depression_deg and grazing_deg"]),
        ("depression_deg = 50.0", "", ["views[0] (az000)", "no angle", "exactly one"]),
        ('name = "az000"', 'name = "a/b"', ["views[0] (a/b).name: found 'a/b'", "letters"]),
        ('name = "az000"', 'name = "AZ090"', ["views[1].name: found 'az090' again", "views[0]"]),
        ("looks = 16.0", "looks = 0", ["views[0] (az000).looks: found 0"]),
        ('role = "test"', 'role = "tests"', ["views[1] (az090).role: found 'tests'", "'train' or 'test'"]),
        ('"hh.tif"', '"none.tif"', ["views[0] (az000).images.HH", "none.tif", "no such"]),
        ('HH = "hh.tif"', 'XX = "hh.tif"', ["views[0] (az000).images.XX", "'HH'"]),
        ('"mask.npy"', '"hh\\u0000.tif"', ["views[0] (az000).mask", "control"]),
        ('"scene.obj"', '"none.obj"', ["scene.mesh", "none.obj", "no such"]),
        ('mesh = "scene.obj"', 'mesh = "scene.obj"\nreference_point_m = [0, 0]', ["scene.reference_point_m"]),
        (
            'mesh = "scene.obj"',
            'mesh = "scene.obj"\nreference_point_m = [0, 0, inf]',
            ["reference_point_m[2]: found inf"],
        ),
        ("[image]", "[effects.fog]\nlevel = 1\n[image]", ["effects.fog"]),
        ("[image]", "[effects]\nfog = 1\n[image]", ["effects.fog: found 1"]),
        ("[image]", "[sampling]\nrays_per_pixel = 4\nrays_per_m2 = 5\n[image]", ["sampling: found both"]),
        ("[image]", "[sampling]\nseed = -1\n[image]", ["sampling.seed: found -1"]),
        ("[image]", "[image]]", ["not valid TOML", "line 9"]),
        ("[image]", "x = 1" + "0" * 5000 + "\n[image]", ["not valid TOML"]),
        ("[image]", "x = 0x1" + "0" * 5000 + "\n[image]", ["radar.x: unknown key"]),
        ("looks = 16.0", "looks = 0x1" + "0" * 5000, ["looks: found a number of thousands of digits"]),
        ("looks = 16.0", "looks = " + "[" * 5000, ["not valid TOML"]),
        ("[[views]]", "[[view]]", ["view: unknown key; must be one of scene, radar"]),
    ],
)
def test_refusals(changed: Change, old: str, new: str, messages: list[str]) -> None:
    message = refusal(changed(old, new))
    for each in messages:
        assert each in message


def test_everything_wrong_is_said_at_once(changed: Change, folder: Path) -> None:
    path = changed("looks = 16.0", 'looks = -1\ncolour = "red"')
    path.write_text(path.read_text().replace("eps_r = 4.0", "eps_r = 0.5"))
    message = refusal(path)
    assert message.count("\n") == 3
    assert "3 things are wrong" in message


def test_everything_wrong_with_the_files_is_said_at_once(folder: Path) -> None:
    (folder / "hh.tif").unlink()
    (folder / "mask.npy").write_bytes(b"")
    (folder / "scene.obj").write_text(OBJ.replace("roof", "wall"))
    message = refusal(folder / "scene.toml")
    assert "images.HH" in message
    assert "mask" in message
    assert "found roof, ground; must be those of the mesh" in message
    assert "ground, wall; no roof" in message
    assert "ground, wall" in message


@pytest.mark.parametrize(("data", "found"), [(b"\xff\xfe", "not UTF-8"), (b"", "missing"), (b"\x00", "TOML")])
def test_no_scene_file(tmp_path: Path, data: bytes, found: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(data)
    assert found in refusal(path)


def test_a_new_key_stands_above_the_comment_of_the_next_table(changed: Change, folder: Path) -> None:
    """A saved scene states what the file left to the library: keys of the roof stay above the comment on the ground."""
    surface = "eps_r = [6.0, -0.5]\nrms_height_m = 0.002\ncorrelation_length_m = 0.02\n"
    path = changed(surface, 'library = "brick"\n\n# The lawn.\n')
    Scene.load(path).save(folder / "again.toml")
    lines = (folder / "again.toml").read_text().splitlines()
    roof, comment, ground = (lines.index(line) for line in ("[materials.roof]", "# The lawn.", "[materials.ground]"))
    stated = [line.split(" = ")[0] for line in lines[roof:comment]]
    assert {"library", "eps_r", "rms_height_m", "correlation_length_m"} <= set(stated)
    assert [line for line in lines[comment + 1 : ground] if line] == []


@pytest.mark.parametrize("name", ["house.obj", "house.STL"])
def test_a_mesh_in_place_of_a_scene_file(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"v 0 0 0\n")
    assert f"found a mesh; must be a scene file: warpsar new FOLDER {name} writes one for it" in refusal(
        tmp_path / name
    )


def test_no_file_at_all(tmp_path: Path) -> None:
    assert "No such file" in refusal(tmp_path / "scene.toml")
    assert "directory" in refusal(tmp_path)


def test_a_byte_order_mark_and_windows_line_ends_are_fine(folder: Path) -> None:
    (folder / "scene.toml").write_bytes(b"\xef\xbb\xbf" + TOML.replace("\n", "\r\n").encode())
    Scene.load(folder / "scene.toml").save(folder / "again.toml")
    assert Scene.load(folder / "again.toml").views == Scene.load(folder / "scene.toml").views


def test_isolated_nan_is_masked_and_counted(folder: Path) -> None:
    power = np.ones((4, 6), np.float32)
    power[1, 2], power[3, 3] = np.nan, np.inf
    write_tiff(folder / "hh.tif", power)
    scene = Scene.load(folder / "scene.toml")
    assert scene.warnings == ("views[0] (az000).images.HH: 2 of 24 pixels are NaN or infinite and masked",)
    np.testing.assert_array_equal(np.argwhere(np.isnan(scene.measured(scene.views[0], "HH"))), [[1, 2], [3, 3]])


def test_nan_everywhere_negative_power_and_a_closed_mask_are_refused(folder: Path) -> None:
    path = folder / "scene.toml"
    write_tiff(folder / "hh.tif", np.full((4, 6), np.nan))
    assert "images.HH" in refusal(path)
    power = np.ones((4, 6))
    power[0, 0] = -2
    write_tiff(folder / "hh.tif", power)
    assert "1 pixels are negative (down to -2)" in refusal(path)
    write_tiff(folder / "hh.tif", np.abs(power))
    np.save(folder / "mask.npy", np.zeros((4, 6), bool))
    assert "every pixel is 0" in refusal(path)


TEXTURED = """[materials.ground]
layout = "texture"
specular_fraction = "tau.tif"
"""


def test_textures(changed: Change, folder: Path) -> None:
    path = changed("[materials.ground]\n", TEXTURED)
    assert "materials.ground.specular_fraction" in refusal(path)
    write_tiff(folder / "tau.tif", np.array([[0.0, 0.5, 1.0]]))
    scene = Scene.load(path)
    np.testing.assert_array_equal(scene.field("ground", "specular_fraction"), [[0.0, 0.5, 1.0]])
    assert scene.materials["ground"].specular_fraction == str(folder.resolve() / "tau.tif")
    write_tiff(folder / "tau.tif", np.array([[0.0, np.nan, 1.5]]))
    assert "2 of 3 values are out of range" in refusal(path)


def test_vertex_scalars(folder: Path) -> None:
    (folder / "scene.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "property float eps\nproperty float h\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0 2 1e-3\n9 0 0 3 1e-3\n9 9 0 4 1e-3\n0 9 0 0 -1\n3 0 1 2\n"
    )
    materials = (
        '[materials.default]\nlayout = "vertex"\neps_r = "eps"\nrms_height_m = "h"\ncorrelation_length_m = 0.01\n'
    )
    text = TOML[: TOML.index("[materials.roof]")] + materials + TOML[TOML.index("[[views]]") :]
    path = folder / "scene.toml"
    path.write_text(text.replace("scene.obj", "scene.ply"))
    scene = Scene.load(path)  # the fourth vertex, out of range, is on no face
    np.testing.assert_array_equal(scene.field("default", "eps_r"), [2, 3, 4, 0])
    path.write_text(path.read_text().replace('"eps"', '"epsilon"'))
    assert "found 'epsilon'; must be a vertex scalar of the mesh (eps, h)" in refusal(path)


def test_save_keeps_words_and_finds_files_from_elsewhere(folder: Path) -> None:
    scene = Scene.load(folder / "scene.toml")
    ground = scene.materials["ground"].model_copy(update={"eps_r": 5.5, "specular_fraction": 0.25})
    learned = dataclasses.replace(
        scene, materials={**scene.materials, "ground": ground}, effects={"noise_floor": {"level": 0.002}}
    )
    place = folder / "out" / "deep" / "scene.toml"
    learned.save(place)
    text = place.read_text()
    for comment in ("# The user's own words.", "# X band", "# dry"):
        assert comment in text
    table = tomllib.loads(text)
    assert table["scene"]["mesh"] == "../../scene.obj"
    assert table["materials"]["ground"]["eps_r"] == 5.5
    assert table["effects"] == {"noise_floor": {"level": 0.002}}
    assert table["views"][0]["depression_deg"] == 50.0
    again = dataclasses.replace(Scene.load(folder / "scene.toml"), effects={})
    assert again.views == scene.views
    reread = tomllib.loads(text.replace("../../", ""))
    del reread["effects"]
    assert reread["views"] == tomllib.loads(TOML)["views"]


def test_save_to_its_own_place_changes_nothing(folder: Path) -> None:
    path = folder / "scene.toml"
    Scene.load(path).save(path)
    assert path.read_text() == TOML
    assert sorted(p.name for p in folder.iterdir()) == ["both.exr", "hh.tif", "mask.npy", "scene.obj", "scene.toml"]


def test_save_adds_and_drops_views_and_images(folder: Path) -> None:
    path = folder / "scene.toml"
    scene = Scene.load(path)
    second = scene.views[1].model_copy(update={"images": {"HH": folder.resolve() / "hh.tif"}, "looks": 4.0})
    third = second.model_copy(update={"name": "new"})
    dataclasses.replace(scene, views=[second, third]).save(path)
    again = Scene.load(path)
    assert [view.name for view in again.views] == ["az090", "new"]
    assert again.views == [second, third]


def test_a_saved_file_has_an_empty_line_above_each_view(folder: Path) -> None:
    """Images that a view gains are a table of their own, and the next view's head stands apart from it."""
    path = folder / "scene.toml"
    scene = Scene.load(path)
    first = scene.views[1].model_copy(update={"images": {"HH": folder.resolve() / "hh.tif"}, "looks": 4.0})
    path.write_text(TOML + '\n[[views]]\nname = "west"\nazimuth_deg = 270\nincidence_deg = 45\n')
    dataclasses.replace(Scene.load(path), views=[scene.views[0], first, Scene.load(path).views[2]]).save(path)
    lines = path.read_text().splitlines()
    heads = [at for at, line in enumerate(lines) if line == "[[views]]"]
    assert len(heads) == 3
    assert "[views.images]" in lines[heads[1] : heads[2]]
    assert all(lines[at - 1] == "" for at in heads)
    assert Scene.load(path).views[1] == first


def test_a_scene_made_in_memory_is_written_whole(folder: Path) -> None:
    scene = dataclasses.replace(Scene.load(folder / "scene.toml"), source="")
    scene.save(folder / "new.toml")
    again = Scene.load(folder / "new.toml")
    assert (again.views, again.materials, again.radar) == (scene.views, scene.materials, scene.radar)


def test_hash_sees_every_file_and_not_where_they_lie(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    def current(place: Path) -> str:
        return Scene.load(place / "scene.toml").input_hash

    first = current(folder)
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    for file in folder.iterdir():
        (elsewhere / file.name).write_bytes(file.read_bytes())
    assert current(elsewhere) == first
    seen = {first}
    for name, data in (("scene.obj", OBJ.replace("9", "8")), ("scene.toml", TOML + "\n")):
        (folder / name).write_text(data)
        seen.add(current(folder))
    np.save(folder / "mask.npy", np.ones((4, 6), bool))
    seen.add(current(folder))
    write_tiff(folder / "hh.tif", np.ones((4, 6)))
    seen.add(current(folder))
    assert len(seen) == 5


def test_a_table_cannot_be_changed_in_place() -> None:
    material = Material(eps_r=4.0, rms_height_m=0.001, correlation_length_m=0.01)
    with pytest.raises(ValueError, match="frozen"):
        material.eps_r = 5.0  # type: ignore[misc]
