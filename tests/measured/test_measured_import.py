"""From a measured file to an image on the view's grid, declared in the scene file."""

import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from measured_files import C, Pass, echoes, write_cphd, write_mat, write_phoenix, write_sicd

from warpsar.diagnosis.command import run as diagnose
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.errors import InputError
from warpsar.io.images import read_channel, write_exr
from warpsar.measured.gridding import sample_power
from warpsar.measured.ground import mesh_points, pixel_centres, plane_points
from warpsar.measured.importer import import_measured
from warpsar.scene.scene import Scene
from warpsar.speckle.looks import equivalent_looks

GROUND = "v -60 -60 0\nv 60 -60 0\nv 60 60 0\nv -60 60 0\nf 1 2 3\nf 1 3 4\n"
STEP = "usemtl low\n" + GROUND + "usemtl high\nv -4 -60 3\nv 4 -60 3\nv 4 60 3\nv -4 60 3\nf 5 6 7\nf 5 7 8\n"


def scene_file(
    folder: Path,
    shape: tuple[int, int],
    spacing_m: tuple[float, float],
    *,
    views: str = "",
    calibrated: bool = False,
    mesh: str = GROUND,
    polarization: str = "HH",
) -> Path:
    (folder / "ground.obj").write_text(mesh)
    names = ["low", "high"] if "usemtl" in mesh else ["default"]
    surface = "eps_r = 6.0\nrms_height_m = 0.0012\ncorrelation_length_m = 0.01"
    rough = "eps_r = 9.0\nrms_height_m = 0.0014\ncorrelation_length_m = 0.008"
    materials = "\n".join(f"[materials.{n}]\n{rough if n == 'high' else surface}" for n in names)
    path = folder / "scene.toml"
    path.write_text(
        f"""# kept
[scene]
mesh = "ground.obj"     # flat
[radar]
frequency_hz = 9.6e9
polarizations = ["{polarization}"]
[image]
shape = [{shape[0]}, {shape[1]}]
spacing_m = [{spacing_m[0]}, {spacing_m[1]}]
calibrated = {str(calibrated).lower()}
{materials}
{views}
"""
    )
    return path


def view_text(name: str, look: Pass, **extra: object) -> str:
    lines = {"name": f'"{name}"', "azimuth_deg": look.azimuth_deg, "incidence_deg": look.incidence_deg} | extra
    return "[[views]]\n" + "".join(f"{key} = {value}\n" for key, value in lines.items())


def simulated(path: Path) -> np.ndarray:
    """The scene's own model image, as complex numbers of random phase."""
    from warpsar.simulation.command import simulate

    beta0 = simulate(Scene.load(path), device="cpu")[0].beta0
    (power,) = beta0.values()
    phase = np.random.default_rng(3).uniform(0.0, 2 * np.pi, power.shape)
    return np.sqrt(power.astype(np.float64)) * np.exp(1j * phase)


# ---- there and back ----


def test_a_simulated_scene_comes_back_from_sicd(tmp_path: Path) -> None:
    from sarkit.verification import SicdConsistency

    look = Pass(slant_range_m=700e3)
    shape, spacing = (41, 51), (0.5, 0.6)
    view = view_text("v", look)
    path = scene_file(tmp_path, shape, spacing, views=view, calibrated=True, mesh=STEP, polarization="VV")
    image = simulated(path)
    scale = 0.25
    source = write_sicd(tmp_path / "made.nitf", image / np.sqrt(scale), spacing, look, scale)
    with source.open("rb") as file:
        checker = SicdConsistency.from_file(file)
        checker.check()
    assert not checker.failures()

    done = import_measured([source], path, "v")
    assert done.messages == () or all("homogeneous" in message for message in done.messages)
    expected = np.abs(image) ** 2
    # At 700 km the wavefront bends by 0.2 mm over the scene and the earth falls away as much: 1e-3 of a pixel, of an
    # image whose pixels are all independent.
    np.testing.assert_allclose(done.power, expected, atol=0.01 * expected.max())
    assert np.sqrt(np.mean((done.power - expected) ** 2)) < 2e-3 * expected.max()
    scene = Scene.load(path)
    np.testing.assert_array_equal(scene.measured(scene.views[0], "VV"), done.power)


@pytest.mark.parametrize("kind", ["cphd", "mat"])
def test_a_simulated_scene_comes_back_from_phase_history(kind: str, tmp_path: Path) -> None:
    """One scatterer per pixel, band and aperture of exactly one cell per pixel: each is the others' zero."""
    look = Pass(slant_range_m=700e3)
    shape, spacing = (24, 30), (2.0, 2.4)
    path = scene_file(tmp_path, shape, spacing, views=view_text("v", look), mesh=STEP)
    image = simulated(path)
    scene = Scene.load(path)
    from warpsar.world.world import geometry_of

    geometry = geometry_of(scene, scene.views[0])
    points = plane_points(geometry, np.zeros(3), *pixel_centres(shape, spacing, (1, 1)))
    count, pulses = 64, 80
    frequency = 9.6e9 + (np.arange(count) - (count - 1) / 2) * C / (2 * spacing[0]) / count
    aperture = C / 9.6e9 / (2 * spacing[1])
    cosine = (np.arange(pulses) - (pulses - 1) / 2) / pulses * aperture
    positions = look.position(look.slant_range_m * cosine / np.sqrt(1 - cosine**2))
    samples = echoes(positions, frequency, points.reshape(-1, 3), image.ravel(), np.zeros(3))
    if kind == "cphd":
        source = write_cphd(tmp_path / "made.cphd", samples, frequency, positions, look)
    else:
        source = write_mat(tmp_path / "made_HH.mat", samples, frequency, positions)

    done = import_measured([source], path, "v", samples=(1, 1), device="cpu")
    expected = np.abs(image) ** 2
    # Band and aperture make a fan, not a rectangle, by the relative bandwidth of 0.8 %: 15 pixels from the middle a
    # scatterer is 0.06 of a pixel off the others' zero.
    assert np.sqrt(np.mean((done.power - expected) ** 2)) < 0.015 * expected.max()
    assert np.corrcoef(done.power.ravel(), expected.ravel())[0, 1] > 0.999


@pytest.mark.parametrize("surface", ["reference", "mesh"])
def test_a_target_on_a_roof_is_in_focus_on_the_roof(surface: str, tmp_path: Path) -> None:
    """12 degrees of aperture over 3 m of height: at the wrong height the echo is smeared."""
    look = Pass(azimuth_deg=0.0, incidence_deg=45.0, slant_range_m=300.0)
    path = scene_file(tmp_path, (140, 60), (0.05, 0.05), views=view_text("v", look), mesh=STEP)
    target = np.array([[0.0, 1.0, 3.0]])
    frequency = 9.3e9 + 4e6 * np.arange(150)
    # A curved track: along a straight one height and range are the same thing.
    angle = np.deg2rad(np.linspace(-6.0, 6.0, 161))
    s = np.column_stack([np.sin(angle), np.cos(angle), np.ones_like(angle)]) / np.sqrt(2)
    samples = echoes(300.0 * s, frequency, target, np.ones(1), np.zeros(3))
    source = write_mat(tmp_path / "made_HH.mat", samples, frequency, 300.0 * s)
    done = import_measured([source], path, "v", surface=surface, samples=(1, 1), device="cpu")
    scene = Scene.load(path)
    from warpsar.world.world import geometry_of

    geometry = geometry_of(scene, scene.views[0])
    at = target[0] @ geometry.d, target[0] @ geometry.u
    pixel = tuple(int(np.floor(x / 0.05 + n / 2)) for x, n in zip(at, (140, 60), strict=True))
    peak = float(done.power[pixel[0] - 1 : pixel[0] + 2, pixel[1] - 1 : pixel[1] + 2].max())
    # A pixel's centre is at most half a pixel from the target, a quarter of the azimuth cell: 0.8 of its power.
    assert (peak > 0.75) == (surface == "mesh")
    assert (peak < 0.3) == (surface == "reference")


# ---- onto the grid ----


def test_samples_of_a_pixel_are_averaged_in_power(tmp_path: Path) -> None:
    amplitude = np.random.default_rng(0).rayleigh(size=(36, 40)).astype(np.float32)
    look = Pass()
    path = scene_file(tmp_path, (12, 20), (1.5, 1.0), views=view_text("v", look))
    write_exr(tmp_path / "fine.exr", {"HH": amplitude})
    done = import_measured([tmp_path / "fine.exr"], path, "v", quantity="amplitude", polarization="HH")
    assert done.picture_path == done.image_path.with_suffix(".png")
    assert done.picture_path.read_bytes().startswith(b"\x89PNG")
    assert done.samples_per_pixel == (3, 2)
    expected = (amplitude.astype(float) ** 2).reshape(12, 3, 20, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(done.power, expected, rtol=1e-5)  # float32
    with pytest.raises(InputError, match=r"36 x 40 pixels.*5 x 2 looks needs 60 x 40"):
        import_measured([tmp_path / "fine.exr"], path, "v", quantity="power", polarization="HH", samples=(5, 2))


def test_a_chip_keeps_its_spacing_and_is_nan_around_it(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    magnitude = generator.rayleigh(size=(20, 24))
    chip = write_phoenix(tmp_path / "chip", magnitude, generator.uniform(-3, 3, (20, 24)))
    look = Pass(azimuth_deg=30.0, incidence_deg=40.0)
    path = scene_file(tmp_path, (26, 30), (0.5, 0.5), views=view_text("v", look))
    done = import_measured([chip], path, "v")
    np.testing.assert_allclose(done.power[3:23, 3:27], magnitude**2, rtol=1e-5)
    assert np.isnan(done.power).sum() == 26 * 30 - 20 * 24
    assert any("300 of 780 pixels lie outside" in message for message in done.messages)


def test_complex_images_are_resampled_without_aliasing() -> None:
    """A band-limited field off its carrier, sampled between its pixels: its power there is known in closed form."""
    from warpsar.formats.base.data import Facts, ImageChip

    generator = np.random.default_rng(0)
    count = 64
    # Up to 0.8 of the band, about a carrier of 0.3 cycles per pixel, periodic: then the interpolation is exact but
    # for its splines.
    k = np.arange(-25, 26)
    spectrum = generator.normal(size=(51, 51)) + 1j * generator.normal(size=(51, 51))

    def field(row: np.ndarray, col: np.ndarray) -> np.ndarray:
        left = np.exp(2j * np.pi * np.outer(row, k + 19) / count)
        right = np.exp(2j * np.pi * np.outer(col, k - 7) / count)
        return left @ spectrum @ right.T

    pixels = np.arange(count)
    chip = ImageChip("made", field(pixels, pixels), "complex", lambda reference_point_m: Facts())
    at = 20.0 + np.linspace(0.0, 24.0, 101)
    expected = np.abs(field(at, at)) ** 2
    found = sample_power(chip, np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1))
    # Splines of fifth order, on a power spectrum that fills 0.53 of their band.
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.005 * expected.mean()
    on_grid = sample_power(chip, np.stack(np.meshgrid(pixels, pixels, indexing="ij"), axis=-1).astype(float))
    np.testing.assert_allclose(on_grid, np.abs(field(pixels, pixels)) ** 2, rtol=1e-12)


def test_unknown_pixels_spoil_only_their_neighbours() -> None:
    from warpsar.formats.base.data import Facts, ImageChip

    power = np.ones((20, 20))
    power[10, 10] = np.nan
    chip = ImageChip("made", power, "power", lambda reference_point_m: Facts())
    at = np.arange(19) + 0.5
    found = sample_power(chip, np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1))
    assert np.isnan(found).sum() == 4
    np.testing.assert_allclose(found[np.isfinite(found)], 1.0)
    assert np.isnan(sample_power(chip, np.array([[-0.6, 3.0], [3.0, 19.6]]))).all()


@pytest.mark.parametrize("slant_range_m", [None, 500.0])
def test_points_have_the_range_and_azimuth_they_are_asked_for(slant_range_m: float | None) -> None:
    from warpsar.world.frame import view_geometry

    geometry = view_geometry(200.0, 35.0, 9.6e9, slant_range_m)
    reference = np.array([10.0, -20.0, 5.0])
    r, a = np.linspace(-20, 20, 7), np.linspace(-15, 15, 5)
    points = plane_points(geometry, reference, r, a, 2.5) - reference
    np.testing.assert_allclose(points[..., 2], 2.5)
    np.testing.assert_allclose(points @ geometry.u, np.broadcast_to(a, (7, 5)), atol=1e-9)
    if slant_range_m is None:
        found = points @ geometry.d
    else:
        across = points - (points @ geometry.u)[..., None] * geometry.u
        found = np.linalg.norm(across + slant_range_m * geometry.d, axis=-1) - slant_range_m
    np.testing.assert_allclose(found, np.broadcast_to(r[:, None], (7, 5)), atol=1e-9)


@pytest.mark.parametrize("slant_range_m", [None, 300.0])
def test_on_the_mesh_the_roof_comes_before_the_ground(slant_range_m: float | None, tmp_path: Path, device: str) -> None:
    from warpsar.world.frame import view_geometry

    scene = Scene.load(scene_file(tmp_path, (8, 8), (1.0, 1.0), views=view_text("v", Pass()), mesh=STEP))
    geometry = view_geometry(90.0, 45.0, 9.6e9, slant_range_m)
    east = np.array([-30.0, -6.0, 0.0, 6.0])
    # The range of roof points at these places of the reference height; the roof covers |x| < 4 at z = 3.
    on_roof = np.array([[x, 0.0, 3.0] for x in (-3.0, 0.0, 3.0)])
    if slant_range_m is None:
        ranges = np.sort(on_roof @ geometry.d)
    else:
        ranges = np.sort(np.linalg.norm(on_roof + slant_range_m * geometry.d, axis=1) - slant_range_m)
    found, missed = mesh_points(geometry, np.zeros(3), ranges, np.array([0.5]), scene.mesh, device)
    assert missed == 0
    np.testing.assert_allclose(found[:, 0, 0], [3.0, 0.0, -3.0], atol=2e-3)  # float32 ray casting, at 300 m
    np.testing.assert_allclose(found[:, 0, 2], 3.0, atol=2e-3)
    flat = np.column_stack([east[:2], 0 * east[:2], 0 * east[:2]]) @ geometry.d
    if slant_range_m is None:
        found, _ = mesh_points(geometry, np.zeros(3), flat[:1], np.array([0.5]), scene.mesh, device)
        np.testing.assert_allclose(found[0, 0], [-30.0, -0.5, 0.0], atol=2e-3)


# ---- looks ----


@pytest.mark.full
@pytest.mark.parametrize("looks", [1, 4, 16])
@pytest.mark.parametrize("sigma", [0.0, 0.8])
def test_looks_are_found_under_texture_and_correlation(looks: int, sigma: float) -> None:
    from scipy.ndimage import gaussian_filter

    generator = np.random.default_rng(looks)
    power = np.zeros((240, 240))
    for _ in range(looks):
        part = generator.normal(size=(2, 240, 240))
        if sigma:
            part = np.stack([gaussian_filter(p, sigma) for p in part])
        power += (part**2).sum(axis=0)
    power[:, 120:] *= 4.0  # another field
    power[60:100] *= np.exp(generator.normal(size=(40, 240)) * 0.7)  # a wood
    power[150:154, 30:200] *= 100.0  # a wall
    found = equivalent_looks(power)
    # 12 %: what the mode over some 2500 overlapping windows scatters by (2 %), and the pull of mixed windows.
    assert found == pytest.approx(looks, rel=0.12)


def test_looks_of_too_little_are_not_made_up() -> None:
    assert equivalent_looks(np.ones((8, 30))) is None
    assert equivalent_looks(np.full((40, 40), np.nan)) is None
    assert equivalent_looks(np.zeros((40, 40))) is None


# ---- in the scene file ----


def history(folder: Path, look: Pass, name: str = "made_HH.mat") -> Path:
    frequency = 9.45e9 + 4e6 * np.arange(75)
    positions = look.position(np.linspace(-100.0, 100.0, 101))
    generator = np.random.default_rng(0)
    points = np.column_stack([generator.uniform(-15, 15, (40, 2)), np.zeros(40)])
    samples = echoes(positions, frequency, points, generator.normal(size=40), np.zeros(3))
    return write_mat(folder / name, samples, frequency, positions)


LOOK = Pass(azimuth_deg=60.0, incidence_deg=40.0, slant_range_m=10e3)


def test_a_new_view_is_what_the_file_says(tmp_path: Path) -> None:
    path = scene_file(tmp_path, (60, 60), (0.5, 0.5))
    before = path.read_text()
    done = import_measured([history(tmp_path, LOOK)], path, "first", device="cpu")
    text = path.read_text()
    assert text.startswith(before.rstrip("\n"))
    (view,) = tomllib.loads(text)["views"]
    assert view["images"] == {"HH": "first_HH.exr"}
    assert view["azimuth_deg"] == pytest.approx(60.0, abs=0.01)
    assert view["incidence_deg"] == pytest.approx(40.0, abs=0.01)
    assert "slant_range_m" not in view
    assert done.looks is None or view["looks"] == pytest.approx(done.looks, abs=0.01)
    scene = Scene.load(path)
    np.testing.assert_array_equal(scene.measured(scene.views[0], "HH"), read_channel(done.image_path, "HH"))
    import_measured([history(tmp_path, Pass(azimuth_deg=70.0, slant_range_m=10e3))], path, "second", device="cpu")
    assert [view.name for view in Scene.load(path).views] == ["first", "second"]


def test_a_declared_view_keeps_what_it_says(tmp_path: Path) -> None:
    views = view_text("v", LOOK, depression_deg=50.0, role='"test"  # held back').replace("incidence_deg = 40.0\n", "")
    path = scene_file(tmp_path, (60, 60), (0.5, 0.5), views=views)
    import_measured([history(tmp_path, LOOK)], path, "v", device="cpu")
    text = path.read_text()
    assert "depression_deg = 50.0" in text
    assert '"test"  # held back' in text
    assert "# kept" in text
    assert Scene.load(path).views[0].images["HH"].name == "v_HH.exr"


def test_images_that_are_not_there_yet_do_not_hinder(tmp_path: Path) -> None:
    views = view_text("v", LOOK, images='{ HH = "later.exr" }') + view_text("w", LOOK, images='{ HH = "w_HH.exr" }')
    path = scene_file(tmp_path, (60, 60), (0.5, 0.5), views=views)
    import_measured([history(tmp_path, LOOK)], path, "v", device="cpu")
    import_measured([history(tmp_path, LOOK)], path, "w", device="cpu")
    assert {view.images["HH"].name for view in Scene.load(path).views} == {"v_HH.exr", "w_HH.exr"}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"azimuth_deg": 61.0}, r"azimuth_deg = 61, but the file says 60\.00"),
        ({"azimuth_deg": -300.4}, None),
        ({"incidence_deg": 41.0}, r"incidence_deg = 41, but the file says 40\.00"),
        ({"frequency_hz": 9.8e9}, r"frequency_hz = 9800000000, but the file says 9\.598e\+09"),
        ({"slant_range_m": 9000.0}, r"slant_range_m = 9000, but the file says 1000"),
        ({"slant_range_m": 10010.0, "frequency_hz": 9.61e9, "incidence_deg": 40.3}, None),
    ],
)
def test_contradictions_beyond_tolerance_are_refused(
    changed: dict[str, float], message: str | None, tmp_path: Path
) -> None:
    path = scene_file(tmp_path, (40, 40), (0.5, 0.5), views=view_text("v", LOOK, **changed))
    before = path.read_text()
    source = history(tmp_path, LOOK)
    if message is None:
        import_measured([source], path, "v", device="cpu")
    else:
        with pytest.raises(InputError, match=rf"made_HH\.mat: contradicts.*'v'.*{message}"):
            import_measured([source], path, "v", device="cpu")
        assert path.read_text() == before
        assert not (tmp_path / "v_HH.exr").exists()


def test_polarization_that_the_scene_does_not_have_is_refused(tmp_path: Path) -> None:
    path = scene_file(tmp_path, (40, 40), (0.5, 0.5))
    with pytest.raises(InputError, match=r"polarization is VV; the scene file's radar\.polarizations are HH"):
        import_measured([history(tmp_path, LOOK, "made_VV.mat")], path, "v")
    with pytest.raises(InputError, match="--polarization VV was asked for"):
        import_measured([history(tmp_path, LOOK)], path, "v", polarization="VV")
    with pytest.raises(InputError, match="says no polarization"):
        import_measured([history(tmp_path, LOOK, "made.mat")], path, "v")


def test_uncalibrated_data_in_a_calibrated_scene_is_said(tmp_path: Path) -> None:
    path = scene_file(tmp_path, (40, 40), (0.5, 0.5), calibrated=True)
    done = import_measured([history(tmp_path, LOOK)], path, "v", device="cpu")
    assert any("image.calibrated is true" in message for message in done.messages)
    assert "calibrated = true" in path.read_text()


def test_a_picture_needs_a_declared_view(tmp_path: Path) -> None:
    path = scene_file(tmp_path, (20, 20), (0.5, 0.5))
    write_exr(tmp_path / "a.exr", {"HH": np.ones((20, 20))})
    with pytest.raises(InputError, match=r"a\.exr: says nothing of azimuth and incidence"):
        import_measured([tmp_path / "a.exr"], path, "v", quantity="power", polarization="HH")


def test_where_the_image_lies_is_said_when_the_grid_misses_it(tmp_path: Path) -> None:
    image = np.random.default_rng(0).normal(size=(41, 51, 2)) @ [1, 1j]
    source = write_sicd(tmp_path / "made.nitf", image, (0.5, 0.6), Pass(), 1.0)
    path = scene_file(tmp_path, (20, 20), (0.5, 0.6), polarization="VV")
    path.write_text(path.read_text().replace("[radar]", "reference_point_m = [200.0, 100.0, 0.0]\n[radar]"))
    with pytest.raises(InputError, match=r"outside the image, whose middle is near the world's \((-0|0), (-0|0)\) m"):
        import_measured([source], path, "v")


def test_a_scene_file_that_is_wrong_is_refused_under_its_own_name(tmp_path: Path) -> None:
    path = scene_file(tmp_path, (40, 40), (0.5, 0.5))
    path.write_text(path.read_text().replace("spacing_m", "spacing"))
    with pytest.raises(InputError, match=r"scene\.toml") as caught:
        import_measured([history(tmp_path, LOOK)], path, "v")
    assert "/tmp" not in str(caught.value).replace(str(path), "")
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".mat", ".obj", ".toml"]


def test_command_line(tmp_path: Path) -> None:
    from click.testing import CliRunner

    from warpsar.cli.main import main

    path = scene_file(tmp_path, (40, 40), (0.5, 0.5), calibrated=True)
    arguments = [
        "import",
        str(history(tmp_path, LOOK)),
        "--scene",
        str(path),
        "--view",
        "v",
        "--window-range",
        "hann",
        "--device",
        "cpu",
    ]
    result = CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    assert "v_HH.exr: HH" in result.stdout
    assert "image.calibrated is true" in result.stderr


# ---- measured data ----


@pytest.mark.measured
def test_gotcha_degrees_look_alike(measured_data: Path, tmp_path: Path) -> None:
    from scipy.ndimage import uniform_filter

    path = scene_file(tmp_path, (168, 240), (0.5, 0.5))
    images = []
    for i in (1, 2):
        source = measured_data / "gotcha" / f"data_3dsar_pass1_az00{i}_HH.mat"
        done = import_measured([source], path, f"az00{i}", window_range="hann", device="cpu")
        assert np.isfinite(done.power).all()
        images.append(10 * np.log10(uniform_filter(done.power, 5)).ravel())
    # Neighbouring degrees of this collection correlate at 0.80 to 0.86.
    assert 0.78 < np.corrcoef(images)[0, 1] < 0.9
    assert [view.azimuth_deg for view in Scene.load(path).views] == pytest.approx([89.5, 88.5], abs=0.02)


@pytest.mark.measured
def test_slicy_chip_is_itself_on_its_own_grid(measured_data: Path, tmp_path: Path) -> None:
    source = measured_data / "slicy" / "HB14931.015"
    path = scene_file(tmp_path, (54, 54), (0.202148, 0.203125))
    done = import_measured([source], path, "slicy")
    magnitude = np.frombuffer(source.read_bytes(), ">f4", 54 * 54, 1977).reshape(54, 54)
    np.testing.assert_allclose(done.power, magnitude[::-1].astype(float) ** 2, rtol=1e-5)  # radar at the bottom
    view = Scene.load(path).views[0]
    assert (view.azimuth_deg, view.incidence_deg) == pytest.approx((162.952, 74.957), abs=1e-3)


@pytest.mark.measured
@pytest.mark.full
def test_one_view_of_slicy_does_not_establish_its_detail(measured_data: Path, tmp_path: Path) -> None:
    """On bodies of guessed shape detail explains most, and a point spread, which the header states, nearly as much: the
    name is not established, and something is left (examples/measured/slicy). Which comes first depends on the search.
    """
    path = tmp_path / "scene.toml"
    shutil.copyfile(ROOT / "examples" / "measured" / "slicy" / "scene.toml", path)
    import_measured([measured_data / "slicy" / "HB14931.015"], path, "hb14931")
    short = DiagnoseOptions(starts=0, draws=400, refits=1, most_effects=1)
    found = diagnose(path, tmp_path / "d", device="cpu", options=short)
    assert found["unexplained"]
    assert not found["verdict"]
    assert set(found["not_established"]) in ({"unresolved_detail"}, {"point_spread"})
    assert found["after"]["train"]["deviance"] < 0.85 * found["before"]["train"]["deviance"]


@pytest.mark.measured
def test_uavsar_fields_and_noise_fill(measured_data: Path, tmp_path: Path) -> None:
    folder = measured_data / "uavsar_winnipeg"
    path = scene_file(tmp_path, (120, 120), (12.5, 12.0))
    text = path.read_text().replace('"ground.obj"', f'"{folder / "winnipeg_dem.tif"}"').replace("9.6e9", "1.243e9")
    path.write_text(text.replace("[radar]", "reference_point_m = [2500.0, -50.0, 235.0]\n[radar]"))
    done = import_measured([folder / "winnipeg.h5"], path, "line", surface="mesh", device="cpu")
    view = Scene.load(path).views[0]
    assert view.slant_range_m == pytest.approx(13930, abs=5)
    assert view.incidence_deg == pytest.approx(28.4, abs=0.1)
    # Two by two samples of this oversampled image are a little less than four looks.
    assert done.looks == pytest.approx(3.6, abs=0.4)
    left, right = np.nanmean(done.power[:, :60]), np.nanmean(done.power[:, -40:])
    assert 10 * np.log10(left / right) > 10  # the fill is far below the fields
