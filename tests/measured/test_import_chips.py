"""Many 8-bit chips and a table of their angles in one call; roll and pitch of a raw chip."""

from pathlib import Path

import numpy as np
import pytest
from measured_files import write_phoenix
from PIL import Image

from warpsar.errors import InputError
from warpsar.formats import jpeg, registry
from warpsar.measured.chips import assigned, import_chips, read_views
from warpsar.measured.importer import import_measured
from warpsar.scene.scene import Scene
from warpsar.world.tables import View

SCENE = """# kept
[scene]
reference_point_m = [0.0, 0.0, 0.0]
[radar]
frequency_hz = 9.6e9
polarizations = ["HH"]
[image]
shape = [32, 32]
spacing_m = [0.2, 0.2]
[materials.ground]
eps_r = 6.0
rms_height_m = 0.0012
correlation_length_m = 0.01
[[objects]]
name = "ground"
primitive = "plate"
size_m = [30.0, 30.0, 0.0]
material = "ground"
"""
HUT = '[[objects]]\nname = "hut"\nmesh = "hut.obj"\nmaterial = "ground"\n'
TABLE = "chip,azimuth_deg,depression_deg\n"
SPACING = (0.2, 0.2)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two chips of 48 x 48: even ground, and a bright square in the upper left part."""
    (tmp_path / "scene.toml").write_text(SCENE)
    random = np.random.default_rng(0)
    for name in ("HB1", "HB2"):
        grey = np.clip(60.0 * np.sqrt(random.gamma(1.0, 1.0, (48, 48))), 1, 250)
        grey[8:16, 8:16] = 255.0
        Image.fromarray(grey.astype(np.uint8), "L").save(tmp_path / f"{name}.jpeg", quality=95)
    (tmp_path / "views.csv").write_text(TABLE + "HB1,10.5,15.0\nHB2,200.0,17.0\nHB3,90.0,17.0\n")
    return tmp_path


def test_chips_become_views_of_one_scene(folder: Path) -> None:
    sources = [folder / "HB1.jpeg", folder / "HB2.jpeg"]
    done = import_chips(
        sources,
        folder / "scene.toml",
        folder / "views.csv",
        quantity="amplitude",
        radar_at="bottom",
        spacing_m=SPACING,
        scale="unknown",
    )
    assert done.sheet == folder / "scene_measured.png"
    assert done.sheet.read_bytes().startswith(b"\x89PNG")
    scene = Scene.load(folder / "scene.toml")
    assert (folder / "scene.toml").read_text().startswith("# kept")
    assert not scene.grid.calibrated
    assert [(v.name, v.azimuth_deg, v.incidence_deg) for v in scene.views] == [
        ("HB1", 10.5, 75.0),
        ("HB2", 200.0, 73.0),
    ]
    assert {v.clipped_at for v in scene.views} == {255.0**2}
    grey = np.asarray(Image.open(sources[0])).astype(float)
    # upside down, and its middle 32 x 32: pixel centres coincide, so nothing is interpolated
    np.testing.assert_allclose(scene.measured(scene.views[0], "HH"), grey[::-1][8:40, 8:40] ** 2, rtol=1e-6)
    assert done.clipped[0] == pytest.approx(np.mean(grey[8:40, 8:40] == 255.0))
    assert all(view.looks is not None for view in scene.views)


def test_a_view_that_stands_already_keeps_its_place(folder: Path) -> None:
    path = folder / "scene.toml"
    for _ in range(2):
        import_chips([folder / "HB1.jpeg"], path, folder / "views.csv", quantity="amplitude", spacing_m=SPACING)
    assert len(Scene.load(path).views) == 1


BAD_TABLES = [
    ("HB1,10.5,15.0\nHB1,11.0,15.0\n", "line 3: HB1 stands twice"),
    ("HB1,10.5,95.0\n", "line 2 (HB1): depression_deg: found 95.0"),
    ("HB1,north,15.0\n", "line 2 (HB1): azimuth_deg: found 'north'"),
    ("HB1,nan,15.0\n", "azimuth_deg: found 'nan'"),
    ("HB7,10.0,15.0\n", "no line of the table is called HB1"),
    ("HB1,0.2,0.26\nHB2,3.5,0.3\nHB3,6.1,0.3\n", "the angles seem to be radians"),
]


@pytest.mark.parametrize(("lines", "message"), BAD_TABLES)
def test_bad_tables_are_refused_before_anything_is_written(folder: Path, lines: str, message: str) -> None:
    (folder / "views.csv").write_text(TABLE + lines)
    before = (folder / "scene.toml").read_text()
    with pytest.raises(InputError) as refused:
        import_chips([folder / "HB1.jpeg"], folder / "scene.toml", folder / "views.csv", quantity="amplitude")
    assert message in str(refused.value)
    assert (folder / "scene.toml").read_text() == before
    assert not list(folder.glob("*.exr"))


def test_a_table_without_angles_is_refused(folder: Path) -> None:
    (folder / "views.csv").write_text("chip,azimuth_deg\nHB1,3.0\n")
    with pytest.raises(InputError, match="exactly one of incidence_deg, depression_deg, grazing_deg is needed"):
        import_chips([folder / "HB1.jpeg"], folder / "scene.toml", folder / "views.csv", quantity="amplitude")


TABLES = [
    ("chip,azimuth_deg,depression_deg\n{0},{1},15\n", "HB1", 10.5),
    ("Chip; Azimuth ;Depression\n{0};{1};15\n\n", "HB1.jpeg", 10.5),
    ("filename\tazimuth\tincidence\n{0}\t{1}\t75\n", "chips/HB1.JPG", 370.5),
    ("depression,image,azimuth\n15, {0}, {1}\n", "C:\\chips\\HB1.png", -709.5),
]


@pytest.mark.parametrize(("text", "chip", "azimuth_deg"), TABLES)
def test_tables_of_other_hands(folder: Path, text: str, chip: str, azimuth_deg: float) -> None:
    (folder / "views.csv").write_text(text.format(chip, azimuth_deg))
    (view,) = read_views(folder / "views.csv").values()
    assert (view.name, view.azimuth_deg % 360.0, view.incidence_deg) == ("HB1", 10.5, 75.0)
    (view,) = read_views(folder / "views.csv", "counterclockwise").values()
    assert view.azimuth_deg % 360.0 == 349.5


PICTURES = {
    "HB1.png": lambda grey: Image.fromarray(grey),
    "grey in colour.png": lambda grey: Image.fromarray(grey).convert("RGBA"),
    "HB1.tif": lambda grey: Image.fromarray(grey),
    "16 bits.tif": lambda grey: Image.fromarray(grey.astype(np.uint16) * 257),
    "16 bits.png": lambda grey: Image.fromarray(grey.astype(np.uint16) * 257),
}


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_of_levels_are_clipped_at_their_top(tmp_path: Path, name: str) -> None:
    grey = np.random.default_rng(0).integers(0, 256, (12, 10), np.uint8)
    PICTURES[name](grey).save(tmp_path / name)
    top = 65535.0 if name.startswith("16") else 255.0
    chip = registry.read([tmp_path / name], quantity="amplitude")
    assert chip.top == top
    np.testing.assert_array_equal(np.asarray(chip.samples), grey * (top / 255.0))


def test_an_array_of_levels_is_clipped_at_its_top(tmp_path: Path) -> None:
    grey = np.random.default_rng(0).integers(0, 256, (12, 10), np.uint8)
    np.save(tmp_path / "grey.npy", grey)
    chip = registry.read([tmp_path / "grey.npy"], quantity="amplitude")
    assert chip.top == 255.0
    np.testing.assert_array_equal(np.asarray(chip.samples), grey)


def test_a_grey_jpeg_may_be_stored_with_colours(tmp_path: Path) -> None:
    """Its plane of brightness is coded as the only plane of a grey one: by the same table the levels are the same, but
    for the rounding to red, green and blue and back."""
    grey = np.random.default_rng(0).integers(0, 256, (16, 24), np.uint8)
    for name, picture in (("a.jpg", Image.fromarray(grey)), ("b.jpg", Image.fromarray(grey).convert("RGB"))):
        picture.save(tmp_path / name, quality=90)
    one, other = (jpeg.levels(tmp_path / name)[0] for name in ("a.jpg", "b.jpg"))
    np.testing.assert_allclose(one, other, atol=1.0)


def test_pixels_that_are_stated_too_large_are_said(folder: Path) -> None:
    path, table = folder / "scene.toml", folder / "views.csv"
    done = import_chips([folder / "HB1.jpeg"], path, table, quantity="amplitude", spacing_m=(20.0, 20.0))
    assert any("stated as 20 x 20 m, and image.spacing_m is 0.2 x 0.2" in one for one in done.messages)


@pytest.mark.parametrize("units", ["m", "mm"])
def test_a_body_in_another_unit_is_said(folder: Path, units: str) -> None:
    """The hut is 2 m across in metres."""
    (folder / "hut.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    freed = f'units = "{units}"\nscale = 1.0\nlearn = ["scale"]\ntolerance = {{ scale = "10 %" }}\n'
    path = folder / "scene.toml"
    path.write_text(SCENE + HUT + freed)
    done = import_chips([folder / "HB1.jpeg"], path, folder / "views.csv", quantity="amplitude", spacing_m=SPACING)
    said = [one for one in done.messages if "check units" in one]
    assert len(said) == (units == "mm")
    assert all("0.002 m across in units of 'mm', and an image shows 6.4 m" in one for one in said)


@pytest.mark.parametrize(("content", "message"), [(b"\xff\xd8\xff", "cannot be read as a JPEG"), (None, "in colour")])
def test_bad_pictures_are_refused(folder: Path, content: bytes | None, message: str) -> None:
    path = folder / "HB1.jpeg"
    if content is None:
        Image.new("RGB", (48, 48), (200, 40, 40)).save(path)
    else:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        import_chips([path], folder / "scene.toml", folder / "views.csv", quantity="amplitude", spacing_m=SPACING)


def test_the_files_rounding_is_said(tmp_path: Path) -> None:
    """White noise of 30 levels: its cosine coefficients spread over many steps, so the error is what the steps say.

    1 % is the scatter of 65536 errors and the rounding to whole levels (1 / 12 of a variance beside some 8)."""
    grey = np.clip(np.random.default_rng(0).normal(128.0, 30.0, (256, 256)), 0, 255).astype(np.uint8)
    Image.fromarray(grey, "L").save(tmp_path / "noise.jpeg", quality=90)
    levels, error = jpeg.levels(tmp_path / "noise.jpeg")
    assert np.sqrt(np.mean((levels - grey.astype(float)) ** 2)) == pytest.approx(error, rel=0.01)


def test_a_message_names_the_rounding(folder: Path) -> None:
    sources = [folder / "HB1.jpeg", folder / "HB2.jpeg"]
    table, path = folder / "views.csv", folder / "scene.toml"
    done = import_chips(sources, path, table, quantity="amplitude", spacing_m=SPACING, scale="unknown")
    (said,) = (one for one in done.messages if "rounds" in one)
    assert f"by up to {jpeg.levels(sources[0])[1]:.1f} rms" in said
    assert said.endswith("(2 chips)")


def test_amplitude_is_never_guessed(folder: Path) -> None:
    with pytest.raises(InputError, match="use --quantity"):
        import_chips([folder / "HB1.jpeg"], folder / "scene.toml", folder / "views.csv", spacing_m=SPACING)


def test_a_raw_chip_brings_roll_and_pitch(folder: Path) -> None:
    """358.58 degrees are -1.42; and a radar at the bottom turns rows over, not columns."""
    (folder / "hut.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 3 1 4\n")
    path = folder / "scene.toml"
    path.write_text(SCENE.replace("spacing_m = [0.2, 0.2]", "spacing_m = [0.5, 0.5]") + HUT)
    magnitude = np.random.default_rng(1).rayleigh(size=(32, 32))
    chip = write_phoenix(
        folder / "raw.004",
        magnitude,
        np.zeros((32, 32)),
        TargetRoll="-1.179039",
        TargetPitch="358.580475",
        RadarPosition="bottom",
    )
    done = import_measured([chip], path, "raw", scale="unknown")
    (_, hut) = Scene.load(path).objects
    assert (hut.roll_deg, hut.pitch_deg) == pytest.approx((-1.179, -1.4195), abs=1e-3)
    np.testing.assert_allclose(done.power, magnitude[::-1].astype(np.float32) ** 2, rtol=1e-5)


def test_the_command_takes_a_table(folder: Path) -> None:
    from click.testing import CliRunner

    from warpsar.cli.main import main

    words = ["import", str(folder / "HB1.jpeg"), str(folder / "HB2.jpeg"), "--scene", str(folder / "scene.toml")]
    words += ["--table", str(folder / "views.csv"), "--amplitude", "--scale", "unknown", "--spacing", "0.2", "0.2"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    assert "2 views; " in done.output
    assert len(Scene.load(folder / "scene.toml").views) == 2
    refused = CliRunner().invoke(main, [*words, "--view", "HB1"])
    assert refused.exit_code == 2
    assert "one of --view and --table is needed" in refused.output


def test_roles_are_spread_and_sectors_held_back(folder: Path) -> None:
    views = {f"v{k}": View(name=f"v{k}", azimuth_deg=10.0 * k, incidence_deg=73.0) for k in range(36)}
    views["v0"] = View(name="v0", azimuth_deg=0.0, incidence_deg=73.0, role="test")
    found = assigned(folder / "views.csv", views, list(views), train=8, held_back=[(85.0, 115.0), (345.0, 15.0)])
    train = [name for name, view in found.items() if view.role == "train"]
    assert len(train) == 8
    assert not {"v9", "v10", "v11", "v35", "v0", "v1"} & set(train)
    gaps = np.diff([found[name].azimuth_deg for name in train])
    assert gaps.max() <= 70.0
    assert {view.role for view in assigned(folder, views, ["v3"], role="test").values()} == {"train", "test"}
    with pytest.raises(InputError, match="--train 40: found 35 views"):
        assigned(folder / "views.csv", views, list(views), train=40)


def test_the_command_holds_back(folder: Path) -> None:
    from click.testing import CliRunner

    from warpsar.cli.main import main

    sources = [str(folder / f"HB{k}.jpeg") for k in (1, 2)]
    words = ["import", *sources, "--scene", str(folder / "scene.toml"), "--table", str(folder / "views.csv")]
    words += ["--amplitude", "--spacing", "0.2", "0.2"]
    run = CliRunner().invoke(main, [*words, "--train", "1", "--hold-back", "190", "210"])
    assert run.exit_code == 0, run.output
    assert [view.role for view in Scene.load(folder / "scene.toml").views] == ["train", "test"]
    run = CliRunner().invoke(main, [*words, "--train", "1", "--role", "test"])
    assert run.exit_code == 2
    assert "contradict" in run.output
