"""`warpsar evaluate`: metrics against values by hand and scipy, speckle against its closed forms, files, refusals."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from comparisons import comparison
from learning_scenes import TRUTH, cube_scene, measured, starting, views_at
from scipy import integrate, special, stats
from worlds import box, ground, mesh_of, scene_of, view

from warpsar.cli.main import main
from warpsar.compare.comparison import Comparison
from warpsar.compare.metrics import mean_deviance, nuisance_floor, pool
from warpsar.errors import InputError
from warpsar.evaluation.command import evaluate, run
from warpsar.evaluation.meshview import RAYS, look, write_learned_ply
from warpsar.evaluation.residuals import expected_db, profiles, residual_db
from warpsar.io.images import read_channel, write_tiff
from warpsar.io.ply import write_ply
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.scene.unwrap import write_obj
from warpsar.speckle.law import Law
from warpsar.speckle.likelihood import deviance, expected_deviance, metrics
from warpsar.surface.stage import Stage
from warpsar.surface.surface import KEYS
from warpsar.world.mesh import read_mesh

LOOKS = (1.0, 4.0, 16.0)


def synthetic(
    looks: float, shape: tuple[int, int] = (200, 300), modelled: Any = 0.02, seed: int = 0, floor: float = 0.0
) -> Comparison:
    """Gamma speckle about `modelled`: what a perfect model leaves. Every pixel is compared."""
    speckle = np.random.default_rng(seed).gamma(looks, 1.0 / looks, shape)
    simulated = np.broadcast_to(np.asarray(modelled, float), shape)
    return comparison((simulated + floor) * speckle, simulated, looks, border=0)


# Metrics


def test_metrics_by_hand() -> None:
    found = metrics(np.array([1.0, 2.0, 4.0]), np.array([2.0, 2.0, 2.0]) * [1, 1, 2], Law(4.0))
    assert found["rmse"] == pytest.approx(np.sqrt(1 / 3))
    assert found["nrmse"] == pytest.approx(np.sqrt(1 / 21))
    assert found["rmse_db"] == pytest.approx(10 * np.log10(2) / np.sqrt(3))
    # d = 2 L (1/2 - 1 + ln 2), 0, 0
    assert found["deviance"] == pytest.approx(8 * (np.log(2) - 0.5) / 3 / (8 * (np.log(4) - special.digamma(4))))
    # deviations from the means 7/3 and 8/3: (-4, -1, 5)/3 and (-2, -2, 4)/3
    assert found["correlation"] == pytest.approx(30 / np.sqrt(42 * 24))


@pytest.mark.parametrize("looks", LOOKS)
def test_deviance_is_twice_the_likelihood_ratio_of_scipys_gamma(looks: float) -> None:
    random = np.random.default_rng(1)
    i, mu = random.uniform(0.1, 3.0, (2, 50))
    saturated, fitted = (stats.gamma.logpdf(i, looks, scale=m / looks) for m in (i, mu))
    # both are differences of numbers of a few tens: float64 leaves 1e-12
    np.testing.assert_allclose(deviance(i, mu, looks), 2 * (saturated - fitted), rtol=0, atol=1e-10)


@pytest.mark.parametrize("looks", LOOKS)
def test_expected_deviance_is_the_integral_over_speckle(looks: float) -> None:
    def integrand(x: float) -> float:
        return float(deviance(np.array(x), np.array(1.0), looks) * stats.gamma.pdf(x, looks, scale=1 / looks))

    parts = [integrate.quad(integrand, a, b, limit=200)[0] for a, b in ((0, 0.1), (0.1, 2), (2, 60))]
    assert expected_deviance(looks) == pytest.approx(sum(parts), rel=1e-6)


@pytest.mark.parametrize("looks", LOOKS)
def test_speckle_alone_leaves_a_deviance_of_one(looks: float) -> None:
    image = synthetic(looks)
    mean, error = mean_deviance(image.seen, image.simulated, image.interior)
    # var d = 4 L^2 (psi'(L) - 1/L), since var x = cov(x, ln x) = 1/L and var ln x = psi'(L)
    variance = 4 * looks**2 * (special.polygamma(1, looks) - 1 / looks) / expected_deviance(looks) ** 2
    # a sample variance of 60,000 heavy-tailed values, and lags that stand out by chance: a few per cent
    assert error == pytest.approx(np.sqrt(variance / image.simulated.size), rel=0.1)
    assert abs(mean - 1) < 3.5 * error


def test_error_knows_that_neighbours_share_their_speckle() -> None:
    """2 x 2 equal pixels are one sample: the true error of the mean is twice that of independent pixels."""
    small = synthetic(4.0, (100, 150))
    twice = comparison(np.kron(small.measured, np.ones((2, 2))), 0.02, border=0).seen
    _, alone = mean_deviance(small.seen, small.simulated, small.interior)
    simulated = np.full(twice.measured.shape, 0.02)
    _, error = mean_deviance(twice, simulated, twice.interior)
    # four times the pixels, none of them new: the same error; the autocovariance is itself estimated
    assert error == pytest.approx(alone, rel=0.1)


def test_floor_is_the_most_likely_one() -> None:
    random = np.random.default_rng(2)
    modelled = np.concatenate([random.uniform(0.001, 0.1, 40000), np.zeros(20000)])
    image = synthetic(4.0, (200, 300), modelled.reshape(200, 300), floor=0.005)
    floor = nuisance_floor(image.measured.ravel(), modelled)
    # Fisher information of the level: sum of L / (mu + N)^2
    sd = 1 / np.sqrt(np.sum(4.0 / (modelled + 0.005) ** 2))
    assert abs(floor - 0.005) < 3.5 * sd


def test_floor_is_none_where_there_is_none() -> None:
    measured = np.linspace(0.01, 0.02, 1000)
    assert nuisance_floor(measured, 1.5 * measured) == 0.0


def test_pooled_metrics_are_those_of_all_pixels_together() -> None:
    images = [synthetic(4.0, (40, 50), 0.02, seed=1), synthetic(16.0, (60, 50), 0.05, seed=2)]
    for image in images:
        image.metrics.update({"left_out": 1, "zeros": 2, "left_out_all": 3, "deviance_error": 0.03})
    together = pool(images)
    assert together is not None
    i, mu = (np.concatenate(a) for a in zip(*((m.measured.ravel(), m.simulated.ravel()) for m in images), strict=True))
    assert together["rmse"] == pytest.approx(np.sqrt(np.mean((i - mu) ** 2)))
    assert together["correlation"] == pytest.approx(stats.pearsonr(i, mu).statistic)
    parts = [image.metrics["deviance"] for image in images]
    assert together["deviance"] == pytest.approx(0.4 * parts[0] + 0.6 * parts[1])
    assert together["deviance_error"] == pytest.approx(0.03 * np.hypot(0.4, 0.6))
    assert (together["pixels"], together["left_out"], together["zeros"], together["images"]) == (5000, 2, 4, 2)
    assert pool([]) is None


# Profiles


@pytest.mark.parametrize("looks", LOOKS)
def test_residual_of_speckle_is_where_it_is_expected(looks: float) -> None:
    image = synthetic(looks)
    residual = residual_db(image)
    # the standard error of a mean of 60,000 residuals of at most 5.6 dB is 0.023 dB
    assert abs(residual.mean()) < 0.08
    expected = expected_db([image])
    found = dict(zip(expected, np.percentile(residual, [16, 50, 84]), strict=True))
    assert found == pytest.approx(expected, abs=0.08)


def test_profiles_follow_what_the_residual_follows() -> None:
    image = synthetic(16.0)
    image = replace(image, simulated=image.simulated * 10 ** (-0.01 * image.range_m[:, None]))
    found = profiles([image], ["soil", "never seen"])
    rows = found["range_m"].rows
    middle = np.array([(row["low"] + row["high"]) / 2 for row in rows])
    median = [row["median_db"] for row in rows]
    # 0.1 dB per metre; 2,400 pixels of 1.1 dB to a bin
    assert np.polyfit(middle, median, 1)[0] == pytest.approx(0.1, abs=0.001)
    assert sum(row["pixels"] for row in rows) == image.simulated.size
    across = [row["median_db"] for row in found["azimuth_m"].rows]
    assert np.ptp(across) < 0.5
    assert [row["name"] for row in found["material"].rows] == ["soil"]
    assert found["incidence_deg"].rows[0]["low"] == 40.0


# Scenes


def with_truth(folder: Path, views: tuple[int, ...]) -> Scene:
    """An independent case with its true materials, and some of its views."""
    scene = Scene.load(folder / "scene.toml")
    truth = json.loads((folder / "truth.json").read_text())["materials"]
    materials = {
        name: m.model_copy(update=dict(zip(KEYS, truth[name], strict=True))) for name, m in scene.materials.items()
    }
    return replace(scene, materials=materials, views=[scene.views[i] for i in views])


@pytest.mark.full
def test_true_parameters_leave_speckle_alone(independent_cases: Path) -> None:
    found = evaluate(with_truth(independent_cases / "none", (0, 1, 5)), device="cpu")
    for role in (found.train, found.test):
        assert role is not None
        # 3.5 errors: six numbers are looked at, and the other renderer's rays add to them
        assert abs(role["deviance"] - 1) < 3.5 * role["deviance_error"]
        assert role["deviance_error"] < 0.02
    assert max(i.sampling_noise for i in found.images) < 0.01


CASES = (
    "antenna_pattern",
    "missing_object",
    "moved_object",
    "multibounce",
    "point_spread",
    "registration",
    "three_at_once",
)


@pytest.mark.parametrize(
    "case",
    [
        "none",
        pytest.param("noise_floor", marks=pytest.mark.full),
        *(pytest.param(c, marks=pytest.mark.slow) for c in CASES),
    ],
)
def test_verdict_on_images_of_another_renderer(case: str, independent_cases: Path) -> None:
    """With its true materials, and what the scene file does not declare: speckle where nothing is missing, and
    nowhere else."""
    found = evaluate(with_truth(independent_cases / case, tuple(range(8))), device="cpu")
    verdicts = {role: one.finding for role, one in found.verdicts.items()}
    if case == "none":
        assert verdicts == {"train": "speckle", "test": "speckle"}
    else:
        assert set(verdicts.values()) <= {"structure", "edges", "level"}


@pytest.mark.full
def test_nuisance_floor_is_the_one_that_was_added(independent_cases: Path) -> None:
    """The case's images have 0.004 added everywhere, which its scene does not declare."""
    scene = with_truth(independent_cases / "noise_floor", (0,))
    (image,) = evaluate(scene, device="cpu").images
    # 10,000 unlit pixels of 16 looks know the level to 0.25 %
    assert image.metrics["floor"] == pytest.approx(0.004, rel=0.01)
    assert image.metrics["deviance"] > 1.3
    assert abs(image.metrics["deviance_all"] - 1) < 3.5 * image.metrics["deviance_all_error"]

    declared = replace(scene, effects={"noise_floor": {"level": 0.004}})
    (better,) = evaluate(declared, device="cpu").images
    assert abs(better.metrics["deviance"] - 1) < 3.5 * better.metrics["deviance_error"]
    # the same pixels on both sides, though the declared model now has light everywhere
    np.testing.assert_array_equal(better.interior, image.interior)


@pytest.fixture(scope="module")
def cube(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A cube on a plane with images of its own: one train and one test view, HH and VV, one pixel 0, one NaN."""
    views = [*views_at((200.0, 40.0)), view(80.0, 50.0, name="judge", role="test")]
    folder = tmp_path_factory.mktemp("cube")
    scene = measured(cube_scene(views), folder)
    image = scene.measured(scene.views[0], "HH")
    image[18, 4], image[18, 5] = 0.0, np.nan
    write_tiff(scene.views[0].images["HH"], image)
    return scene


def saved(scene: Scene, folder: Path) -> Path:
    """The scene as files; its mesh as a PLY of one material cannot hold names, so as OBJ."""
    mesh = scene.mesh
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
    for index, name in enumerate(mesh.materials):
        lines.append(f"usemtl {name}")
        lines += [f"f {a} {b} {c}" for a, b, c in mesh.faces[mesh.face_material == index] + 1]
    (folder / "scene.obj").write_text("mtllib scene.mtl\n" + "\n".join(lines) + "\n")
    (folder / "scene.mtl").write_text("".join(f"newmtl {name}\n" for name in mesh.materials))
    replace(scene, mesh_path=folder / "scene.obj").save(folder / "scene.toml")
    return folder / "scene.toml"


@pytest.mark.full
def test_another_model_is_compared_on_the_same_pixels(cube: Scene) -> None:
    right, wrong = evaluate(cube, device="cpu"), evaluate(starting(cube), device="cpu")
    for a, b in zip(right.images, wrong.images, strict=True):
        np.testing.assert_array_equal(a.interior, b.interior)
        np.testing.assert_array_equal(a.valid, b.valid)
    assert right.train is not None
    assert wrong.train is not None
    assert abs(right.train["deviance"] - 1) < 3.5 * right.train["deviance_error"]
    assert wrong.train["deviance"] > 1.5


def test_what_is_left_out_is_counted(cube: Scene) -> None:
    first, other = evaluate(cube, device="cpu").images[:2]
    assert first.metrics["zeros"] == 1
    assert first.metrics["pixels"] + first.metrics["left_out"] == first.measured.size
    assert other.metrics["pixels"] - first.metrics["pixels"] == 2  # VV: neither the zero nor the NaN
    assert first.metrics["pixels_all"] + first.metrics["left_out_all"] == first.measured.size
    assert np.isnan(first.ratio_db[18, 4:6]).all()


def test_surface_in_the_pixel_is_what_the_geometry_says() -> None:
    """On flat ground seen at 40 degrees every lit pixel is ground at 40 degrees, and a cube's wall that faces the
    radar at 50."""
    mesh = mesh_of(ground=ground(30.0), cube=box((-3.0, -3.0, 0.0), (3.0, 3.0, 6.0)))
    scene = scene_of(mesh, view(0.0, 40.0, images={"HH": Path("none.tif")}, looks=4.0), shape=(60, 60))

    class WithImage(Scene):
        def measured(self, view: Any, polarization: str) -> Any:
            return np.full(self.grid.shape, 0.1, np.float32)

    shown = {key: getattr(scene, key) for key in ("mesh", "radar", "grid", "materials", "views", "sampling")}
    (image,) = evaluate(WithImage(**shown), device="cpu").images
    bare = image.material == 0
    away = np.abs(image.azimuth_m) > 4.0
    assert set(np.unique(image.material[:, away])) == {-1, 0}
    # float32 angles
    np.testing.assert_allclose(image.incidence_deg[:, away][bare[:, away]], 40.0, atol=0.01)
    # wall, roof and the ground before it share pixels: between 40 and 50 degrees, and the cube is the stronger
    # nowhere but in its layover
    laid_over = image.material == 1
    if laid_over.any():
        rows = image.range_m[np.flatnonzero(laid_over.any(axis=1))]
        # the roof's near edge: range axis d = -(0, sin 40, cos 40); 0.25 m is half a pixel
        assert rows.min() >= -3 * np.sin(np.deg2rad(40)) - 6 * np.cos(np.deg2rad(40)) - 0.25
        assert ((image.incidence_deg[laid_over] > 39.99) & (image.incidence_deg[laid_over] < 50.01)).all()


# Files


@pytest.mark.full
def test_files_are_those_of_the_contract(cube: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene_path = saved(cube, tmp_path)
    written = run(scene_path, tmp_path / "out", device="cpu", seed=3)
    out, err = capsys.readouterr()
    assert out.startswith("train deviance ")
    assert out.count("\n") == 1
    assert "device: cpu" in err
    # the verdict comes before any other finding
    said = [line for line in err.splitlines() if "views: " in line or "deviance" in line]
    assert said[0].startswith("train views: ")
    assert said[1].startswith("test views: ")
    content = json.loads((tmp_path / "out" / "evaluate.json").read_text())
    assert content == written
    for key in ("version", "device", "wall_time_s", "input"):
        assert content[key]
    assert content["seed"] == 3
    assert {role: one["finding"] for role, one in content["verdict"].items()} == {"train": "speckle", "test": "speckle"}
    assert "nothing but speckle is found" in (tmp_path / "out" / "report.html").read_text()
    assert [(v["name"], v["role"], v["polarization"]) for v in content["views"]] == [
        ("v0", "train", "HH"), ("v0", "train", "VV"), ("judge", "test", "HH"), ("judge", "test", "VV"),
    ]  # fmt: skip
    asked = ("rmse", "nrmse", "rmse_db", "deviance", "correlation", "deviance_all", "pixels", "left_out")
    for one in (*content["views"], content["train"], content["test"]):
        assert all(isinstance(one[key], int | float) for key in asked)
    assert set(content["residuals_db"]) == {"incidence_deg", "range_m", "azimuth_m", "brightness_db", "material"}
    for one in content["views"]:
        exr = tmp_path / "out" / one["files"]["exr"]
        i, mu, ratio = (read_channel(exr, name).astype(float) for name in ("measured", "simulated", "ratio_db"))
        both = (i > 0) & (mu > 0)
        np.testing.assert_allclose(ratio[both], 10 * np.log10(i[both] / mu[both]), atol=1e-4)  # float32 of up to 50 dB
        assert np.isnan(ratio[~both]).all()
        assert (tmp_path / "out" / one["files"]["png"]).read_bytes()[:4] == b"\x89PNG"
    mesh = read_mesh(tmp_path / "out" / "learned.ply")
    assert set(mesh.vertex_scalars) >= {*KEYS, "material"}
    assert not [p.name for p in (tmp_path / "out").iterdir() if p.name.startswith(".")]


@pytest.mark.full
def test_gain_of_an_uncalibrated_image_is_fitted_and_said(
    cube: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scaled = []
    for index, one in enumerate(cube.views):
        images = {pol: tmp_path / f"{one.name}_{pol}.tif" for pol in one.images}
        for path, pol in zip(images.values(), one.images, strict=True):
            write_tiff(path, (2.5 + index) * cube.measured(one, pol))
        scaled.append(one.model_copy(update={"images": images}))
    grid = cube.grid.model_copy(update={"calibrated": False})
    scene_path = saved(replace(cube, views=scaled, grid=grid), tmp_path)
    content = run(scene_path, tmp_path / "out", device="cpu")
    # 700 pixels of 16 looks know a gain to 1 %
    assert [v["gain"] for v in content["views"]] == pytest.approx([2.5, 2.5, 3.5, 3.5], rel=0.035)
    assert all(v["gain_fitted"] for v in content["views"])
    assert capsys.readouterr().err.count("not calibrated, fitted as") == 4
    assert abs(content["train"]["deviance"] - 1) < 3.5 * content["train"]["deviance_error"]
    assert "one gain per image is fitted" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("change", "arguments", "exit_code", "said"),
    [
        (lambda s: replace(s, views=[v.model_copy(update={"images": {}}) for v in s.views]), [], 2, "measured images"),
        (lambda s: s, ["--device", "cuda:99"], 3, "cuda:99"),
        (lambda s: s, ["--seed", "-1"], 2, "--seed"),
        (lambda s: s, [], 0, ""),
    ],
    ids=["no images", "no device", "bad seed", "done"],
)
def test_exit_codes(
    cube: Scene,
    change: Callable[[Scene], Scene],
    arguments: list[str],
    exit_code: int,
    said: str,
    tmp_path: Path,
) -> None:
    scene_path = saved(change(cube), tmp_path)
    done = CliRunner().invoke(main, ["evaluate", str(scene_path), "-o", str(tmp_path / "out"), *arguments])
    assert done.exit_code == exit_code
    assert said in done.stderr
    assert (tmp_path / "out" / "report.html").exists() == (exit_code == 0)


# The mesh


def test_ply_keeps_uniform_values_sharp(tmp_path: Path) -> None:
    scene = cube_scene(views_at((0.0, 40.0)))
    # the ground's corner becomes the cube's too: a vertex of two materials
    shared = scene.mesh.faces.copy()
    shared[-1, 0] = shared[0, 0]
    scene = replace(scene, mesh=replace(scene.mesh, faces=shared))
    write_learned_ply(tmp_path / "learned.ply", scene)
    mesh = read_mesh(tmp_path / "learned.ply")
    for key in KEYS[:3]:
        # float32 nodes, in log coordinates
        np.testing.assert_allclose(np.unique(mesh.vertex_scalars[key]), sorted(TRUTH[m][key] for m in TRUTH), rtol=1e-6)
    for face, material in zip(mesh.faces, scene.mesh.face_material, strict=True):
        np.testing.assert_allclose(
            mesh.vertex_scalars["eps_r"][face], TRUTH[scene.mesh.materials[material]]["eps_r"], 1e-6
        )
    np.testing.assert_allclose(mesh.vertices[mesh.faces], scene.mesh.vertices[scene.mesh.faces])


def test_ply_and_pictures_show_vertex_values(tmp_path: Path) -> None:
    """eps_r grows linearly in x on a flat square: at the vertices in the PLY, and inside the faces in the picture."""
    vertices, faces = ground(10.0, cells=2)
    write_ply(tmp_path / "mesh.ply", vertices, faces, {"eps": np.exp(0.1 * vertices[:, 0]) + 1.0})
    materials = {"default": {"layout": "vertex", "eps_r": "eps", "rms_height_m": 1e-3, "correlation_length_m": 1e-2}}
    scene = replace(scene_of(read_mesh(tmp_path / "mesh.ply"), view(0.0, 40.0), materials=materials))
    write_learned_ply(tmp_path / "learned.ply", scene)
    mesh = read_mesh(tmp_path / "learned.ply")
    np.testing.assert_allclose(mesh.vertex_scalars["eps_r"], np.exp(0.1 * mesh.vertices[:, 0]) + 1.0, rtol=1e-6)

    # from the south, east is on the right of the picture
    side = look(Stage.of(scene, devices.resolve_device("cpu")), 180.0, 55.0, width=100)
    columns = side.pixel % side.shape[1]
    x = np.log(side.parameters["eps_r"] - 1.0) / 0.1
    pixel_m = 10.0 / 100
    np.testing.assert_allclose(x, (columns + 0.5) * pixel_m - 5.0, atol=pixel_m)  # within the pixel


def test_pictures_hide_what_is_hidden() -> None:
    """Areas in the picture are those of the visible faces in projection; of the ground, what the cube leaves."""
    mesh = mesh_of(ground=ground(32.0), cube=box((-2.5, -2.5, 0.0), (2.5, 2.5, 5.0)))
    scene = scene_of(mesh, view(0.0, 40.0))
    azimuth, incidence = np.deg2rad([205.0, 55.0])
    side = look(Stage.of(scene, devices.resolve_device("cpu")), 205.0, 55.0, width=200)
    toward = np.array([np.sin(azimuth) * np.sin(incidence), np.cos(azimuth) * np.sin(incidence), np.cos(incidence)])
    across = 32.0 * (abs(np.sin(azimuth)) + abs(np.cos(azimuth)))  # of the ground's square
    pixel_m = across / 200
    found = np.bincount(side.material) * (pixel_m / RAYS) ** 2
    cube = 25.0 * np.abs(toward).sum()
    whole = 32.0**2 * toward[2]
    # 1 %: outlines are as sharp as a third of a pixel, 0.07 m; the cube stands inside the ground's picture
    assert found[scene.mesh.materials.index("cube")] == pytest.approx(cube, rel=0.01)
    assert found[scene.mesh.materials.index("ground")] == pytest.approx(whole - cube, rel=0.01)
    picture = side.paint(np.ones((side.pixel.size, 3)))
    assert picture[0, 0, 3] == 0  # nothing behind: a dark page shows through
    assert picture[picture.shape[0] // 2, picture.shape[1] // 2, 3] == 255
    assert picture[picture[..., 3] > 0, :3].min() < 230


def with_file(scene: Scene, folder: Path) -> Scene:
    """The scene with its mesh in an OBJ."""
    write_obj(folder / "scene.obj", scene.mesh)
    return replace(scene, mesh_path=folder / "scene.obj")


@pytest.mark.full
def test_two_models_of_the_same_images(tmp_path: Path) -> None:
    """The numbers under `before` are those of the other scene alone, and the report shows both residuals."""
    scene = measured(cube_scene([*views_at((200.0, 40.0)), view(80.0, 50.0, name="judge", role="test")]), tmp_path)
    whole = with_file(scene, tmp_path)
    whole.save(tmp_path / "after.toml")
    rougher = {
        n: m.model_copy(update={"rms_height_m": 1.3 * float(m.rms_height_m)}) for n, m in scene.materials.items()
    }
    replace(whole, materials=rougher).save(tmp_path / "before.toml")
    alone = run(tmp_path / "before.toml", tmp_path / "alone", device="cpu")
    both = run(tmp_path / "after.toml", tmp_path / "both", before=tmp_path / "before.toml", device="cpu")
    assert both["before"] == {"train": alone["train"], "test": alone["test"]}
    assert both["before"]["test"]["deviance"] > both["test"]["deviance"]
    report = (tmp_path / "both/report.html").read_text()
    assert report.count('alt="residual before"') == report.count('alt="residual after"') == 1 + len(both["views"])


def test_models_of_other_images_are_not_compared(tmp_path: Path) -> None:
    scene = measured(cube_scene(views_at((200.0, 40.0))), tmp_path)
    whole = with_file(scene, tmp_path)
    whole.save(tmp_path / "after.toml")
    renamed = [whole.views[0].model_copy(update={"name": "other"}), *whole.views[1:]]
    replace(whole, views=renamed).save(tmp_path / "before.toml")
    with pytest.raises(InputError, match=r"before.toml: found images other .*; must be those of"):
        run(tmp_path / "after.toml", tmp_path / "out", before=tmp_path / "before.toml", device="cpu")
    assert not (tmp_path / "out").exists()
