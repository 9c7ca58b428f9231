"""`warpsar diagnose` on small scenes of our own: what is found, what is written, and that test views decide nothing."""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from comparisons import comparison
from learning_scenes import cube_scene, measured, starting
from test_report import assert_alone
from worlds import axes, view

import warpsar
from warpsar.cli.main import main
from warpsar.compare.metrics import difference, pool
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.result import Diagnosed, diagnose
from warpsar.diagnosis.role_metrics import role_metrics
from warpsar.effects.registry import get, names
from warpsar.io.images import read_channel, write_tiff
from warpsar.scene.scene import Scene
from warpsar.speckle.law import Law
from warpsar.speckle.likelihood import metrics
from warpsar.world.tables import Sampling

SLOPE = {"per_m_east": 0.08, "per_m_north": -0.05}  # of ln(eps_r - 1), over a scene of 16 m
SIZE = 44
EFFECTS_SPAN = 0.05  # 1/m, of a unit of the coordinate in which a fit moves the gradient
QUICK = DiagnoseOptions(draws=400, starts=0, most_effects=2)
ANGLES = ((15.0, 35.0, "train"), (135.0, 48.0, "train"), (250.0, 42.0, "train"), (330.0, 40.0, "test"))


def scene_with(effects: dict[str, Any], folder: Path, *, seed: int = 1) -> Scene:
    """A cube on a plane, from four sides; the images hold `effects`, the scene declares none and starts beside the
    truth."""
    views = [view(a, i, name=f"v{k}", role=role) for k, (a, i, role) in enumerate(ANGLES)]
    truth = replace(
        cube_scene(views, polarizations=("HH",), shape=SIZE), effects=effects, sampling=Sampling(rays_per_pixel=256.0)
    )
    found = starting(replace(measured(truth, folder, seed=seed), effects={}))
    return saved(replace(found, sampling=Sampling(rays_per_pixel=64.0)), folder)


def saved(scene: Scene, folder: Path) -> Scene:
    mesh = scene.mesh
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
    for index, name in enumerate(mesh.materials):
        lines += [f"usemtl {name}", *(f"f {a} {b} {c}" for a, b, c in mesh.faces[mesh.face_material == index] + 1)]
    (folder / "scene.obj").write_text("\n".join(lines) + "\n")
    replace(scene, mesh_path=folder / "scene.obj").save(folder / "scene.toml")
    return Scene.load(folder / "scene.toml")


@dataclass
class Ran:
    scene: Scene
    out: Path
    content: dict[str, Any]
    stdout: str
    stderr: str


@pytest.fixture(scope="module")
def graded(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """The command on images of a ground whose permittivity changes across it."""
    folder = tmp_path_factory.mktemp("graded & <b>bold<b>")
    scene = scene_with({"eps_gradient": SLOPE}, folder)
    words = ["diagnose", str(folder / "scene.toml"), "-o", str(folder / "out"), "--device", "cpu", "--draws", "400"]
    done = CliRunner().invoke(main, [*words, "--starts", "0", "--most-effects", "2"])
    assert done.exit_code == 0, done.output
    content = json.loads((folder / "out" / "diagnosis.json").read_text())
    return Ran(scene, folder / "out", content, done.stdout, done.stderr)


def test_as_many_effects_may_be_added_as_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the command, whose help states no number that could grow old, and from Python."""
    asked: list[DiagnoseOptions] = []
    monkeypatch.setattr("warpsar.diagnosis.command.run", lambda *_, options, **__: asked.append(options) or {})
    words = ["diagnose", __file__, "-o", "out"]  # the scene is not read
    for more in ([], ["--most-effects", "3"]):
        done = CliRunner().invoke(main, [*words, *more])
        assert done.exit_code == 0, done.output
    assert [one.most_effects for one in asked] == [len(names()), 3]
    assert DiagnoseOptions().most_effects == len(names())
    help_text = " ".join(CliRunner().invoke(main, ["diagnose", "--help"]).output.split())
    assert "Effects that may be added, at most. [default: (all there are); x>=0]" in help_text


@pytest.mark.full
def test_a_gradient_is_found(graded: Ran) -> None:
    assert graded.content["verdict"] == ["eps_gradient"]
    assert graded.content["unexplained"] is False
    table = graded.content["steps"][0]["parameters"]
    labels = graded.content["identifiability"]["parameters"]
    assert {f"eps_gradient.{name}" for name in SLOPE} <= set(labels)
    for name, value in SLOPE.items():
        sd = graded.content["identifiability"]["standard_deviation"][labels.index(f"eps_gradient.{name}")]
        assert table[name] == pytest.approx(value, abs=3.5 * sd * EFFECTS_SPAN)
        assert sd * EFFECTS_SPAN < 0.3 * abs(value)


@pytest.mark.full
def test_json_is_what_the_contract_says(graded: Ran) -> None:
    content = graded.content
    for role in ("train", "test"):
        for when in ("before", "after"):
            assert {"rmse", "nrmse", "rmse_db", "deviance", "correlation"} <= set(content[when][role])
        assert content["before"][role]["pixels"] == content["after"][role]["pixels"]
    (step,) = content["steps"]
    assert {"effect", "statistic", "p_value", "parameters", "test_deviance"} <= set(step)
    assert step["test_deviance"] == content["after"]["test"]["deviance"]
    assert step["p_value"] <= 0.01
    of_power = {name for name in names() if not get(name).of_phase}
    assert {c["effect"] for c in content["candidates"]} == of_power
    for candidate in content["candidates"]:
        assert {"effect", "testability", "statistic", "p_value"} <= set(candidate)
        assert candidate["testability"] in ("testable", "not_testable", "absent")
        assert (candidate["p_value"] is None) == (candidate["testability"] != "testable")
    assert set(content["not_testable"]) == set(content["not_testable_because"])
    assert {"version", "device", "seed", "wall_time_s", "input"} <= set(content)
    assert len(content["turns"]) == 2
    assert content["turns"][-1]["added"] is None
    for material, values in content["materials"].items():
        assert material in graded.scene.materials
        assert set(values) == {"eps_r", "rms_height_m", "correlation_length_m"}


@pytest.mark.full
def test_the_error_falls_to_the_floor_where_nothing_was_fitted(graded: Ran) -> None:
    before, after = (graded.content[when]["test"] for when in ("before", "after"))
    assert before["deviance"] > 1.5
    assert abs(after["deviance"] - 1.0) < 3.5 * after["deviance_error"]
    gain = graded.content["gain"]["test"]
    assert gain["deviance"] == pytest.approx(before["deviance"] - after["deviance"], rel=1e-6)
    assert gain["deviance"] > 2 * gain["error"]


@pytest.mark.full
def test_stdout_is_one_line_of_results(graded: Ran) -> None:
    (line,) = graded.stdout.splitlines()
    assert line.startswith("eps_gradient; edges agree to ")
    assert "; test deviance " in line
    assert "added on trial: eps_gradient" in graded.stderr
    assert "holds: eps_gradient: 2 ln L +" in graded.stderr


@pytest.mark.full
def test_console_json_and_report_say_the_same_of_every_turn(graded: Ran) -> None:
    """What was added comes first, with its gain; then what was not, and why. The numbers are those of the JSON."""
    lines = graded.stderr.splitlines()
    text = assert_alone((graded.out / "report.html").read_text(encoding="utf-8")).text
    heads = ["turn 1: added on trial: eps_gradient", "turn 2: nothing was added"]
    starts = [*(lines.index(head) for head in heads), len(lines)]
    for number, turn in enumerate(graded.content["turns"]):
        block = lines[starts[number] : starts[number + 1]]
        under, listed = [], " ".join(block)
        for candidate in turn["candidates"]:
            name, said = candidate["effect"], candidate["outcome"]
            if candidate["testability"] != "testable":
                assert name in next(line for line in block if line.startswith("  not testable: "))
                continue
            score = f"{max(0.0, candidate['minus_log_p']):.1f}"
            assert score in text
            if candidate["refit_gain"] is None and candidate["minus_log_p"] <= turn["threshold"]:
                under.append(f"{name} {score}")
                assert said == f"-ln p {score} is not over the threshold of {turn['threshold']:.1f}"
                continue
            added = name == turn["added"]
            assert f"  holds: {name}: {said}" in lines if added else f"  not added: {name}: {said}" in block
            outcome = said.replace("+- ", "±\u00a0")  # as reports write it
            assert f"{name} {'was' if added else 'was not'} added: {outcome}." in text
            if candidate["refit_gain"] is not None:
                assert said.startswith(
                    f"2 ln L {candidate['refit_gain']:+,.1f} for {candidate['refit_size']} parameter"
                )
                assert f"{candidate['refit_gain']:+,.1f} ({candidate['refit_size']})" in text
            if candidate["left_out"] is not None:
                gain, error = re.search(r"views left out gain (\S+) \+- (\S+) in ln L", said).groups()  # type: ignore[union-attr]
                assert float(gain) == pytest.approx(candidate["left_out"]["gain"], abs=0.5)
                assert float(error) == pytest.approx(candidate["left_out"]["error"], rel=0.1)
                assert f"{gain} ±\u00a0{error}" in text
        assert block[1].startswith(f"  {turn['added']}: " if turn["added"] else "  not ")
        for entry in under:
            assert entry in listed
    # no other gains are said, such as those of fits that had not ended
    gains = {
        f"{c['refit_gain']:+,.1f}" for turn in graded.content["turns"] for c in turn["candidates"] if c["refit_gain"]
    }
    assert set(re.findall(r"2 ln L (\S+)", graded.stderr)) == gains


@pytest.mark.full
def test_scene_that_comes_out_simulates_evaluates_and_is_sound(graded: Ran, tmp_path: Path) -> None:
    scene = Scene.load(graded.out / "scene.toml")
    assert scene.effects["eps_gradient"] == graded.content["effects"]["eps_gradient"]
    again = diagnose(scene, device="cpu", options=QUICK)
    assert again.diagnosis.verdict == []
    assert not again.diagnosis.unexplained
    # fitted already: the declared model has nowhere to go
    assert again.before["test"] is not None
    assert again.before["test"]["deviance"] == pytest.approx(graded.content["after"]["test"]["deviance"], abs=0.02)
    evaluated = warpsar.evaluate(scene, device="cpu")
    assert evaluated.test is not None
    # on its own pixels and rays: within what those leave
    assert evaluated.test["deviance"] == pytest.approx(graded.content["after"]["test"]["deviance"], abs=0.1)
    images = warpsar.simulate(scene, device="cpu")
    assert len(images) == len(ANGLES)


@pytest.mark.full
def test_report_stands_alone_and_says_it_all(graded: Ran) -> None:
    reader = assert_alone((graded.out / "report.html").read_text(encoding="utf-8"))
    for title in (
        "In short",
        "The residual before and after",
        "Turn 1: the score of each effect",
        "Turn 2: the score of each effect",
        "How the surface parameters moved",
        "What could not be tested",
        "What is left at the end, and where",
        "To make this again",
    ):
        assert title in reader.text
    assert "warpsar diagnose " in reader.text
    described = [attributes["alt"] or "" for tag, attributes in reader.tags if tag == "img"]
    for name in ("v0 HH, train", "v3 HH, test"):
        assert sum(text.startswith(f"{name}, before") for text in described) == 1
        assert sum(text.startswith(f"{name}, after") for text in described) == 1
    assert sum("the residual, from azimuth" in text for text in described) == 2
    for effect in names():
        assert (effect in reader.text) == (not get(effect).of_phase)
    assert "nan" not in reader.text.replace("finance", "")


@pytest.mark.full
def test_test_views_decide_nothing(tmp_path: Path) -> None:
    """With other test images everything is the same to the last digit, but for what is said of the test views."""
    found: list[Diagnosed] = []
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        scene = scene_with({}, tmp_path / name)
        if name == "other":
            path = scene.views[3].images["HH"]
            write_tiff(path, 5.0 * read_channel(path, "HH")[::-1])
        found.append(diagnose(scene, device="cpu", options=QUICK))
    one, other = found
    assert one.diagnosis.verdict == other.diagnosis.verdict == []
    assert not one.diagnosis.unexplained
    np.testing.assert_array_equal(one.diagnosis.final.x, other.diagnosis.final.x)
    for a, b in zip(one.diagnosis.turns[0].candidates, other.diagnosis.turns[0].candidates, strict=True):
        assert (a.effect, a.testability, a.p_value) == (b.effect, b.testability, b.p_value)
        np.testing.assert_equal(a.statistic, b.statistic)
    assert one.before["train"] == other.before["train"]
    assert one.before["test"] is not None
    assert other.before["test"] is not None
    assert one.before["test"]["deviance"] == pytest.approx(1.0, abs=0.2)
    assert other.before["test"]["deviance"] > 10


@pytest.mark.full
def test_a_bright_spot_is_unexplained_and_put_on_the_ground(tmp_path: Path) -> None:
    """Nine pixels of one view about a known place on the ground: no effect does that."""
    scene = scene_with({}, tmp_path)
    world = np.array([5.0, 5.5, 0.0])
    d, u, _ = axes(*ANGLES[1][:2])
    row, col = (int(np.floor(world @ axis / 0.5 + SIZE / 2)) for axis in (d, u))
    path = scene.views[1].images["HH"]
    image = read_channel(path, "HH")
    assert image[row - 1 : row + 2, col - 1 : col + 2].min() > 0
    image[row - 1 : row + 2, col - 1 : col + 2] *= 4.0
    write_tiff(path, image)
    done = diagnose(scene, device="cpu", options=QUICK)
    assert done.diagnosis.verdict == []
    assert done.diagnosis.unexplained
    where = done.place
    assert (where.view, where.window) == ("v1", (3, 3))
    assert abs(where.row - row) <= 1
    assert abs(where.col - col) <= 1
    assert where.ratio_db > 3.0
    largest = where.parts[0]
    assert largest.material == "ground"
    # within the window, whose three pixels of 0.5 m in slant range are 2 m on the ground
    np.testing.assert_allclose(largest.centre_m, world, atol=1.5)
    in_view = {v.image: v for v in where.views}
    assert abs(in_view["v1 HH"].row - where.row) <= 1
    d, u, _ = axes(*ANGLES[2][:2])
    assert in_view["v2 HH"].row == int(np.floor(np.array(largest.centre_m) @ d / 0.5 + SIZE / 2))
    assert in_view["v2 HH"].col == int(np.floor(np.array(largest.centre_m) @ u / 0.5 + SIZE / 2))
    assert abs(in_view["v2 HH"].ratio_db) < 2.0


# Numbers of the report


def test_pooled_metrics_are_over_all_pixels() -> None:
    random = np.random.default_rng(0)
    small = comparison(random.gamma(4.0, 0.25, (30, 40)), 1.0)
    large = comparison(2.0 * random.gamma(4.0, 0.25, (90, 80)), 1.5)
    found = role_metrics([small, large])
    assert found is not None
    pixels = np.concatenate([small.seen.values, large.seen.values])
    model = np.concatenate([np.full(26 * 36, 1.0), np.full(86 * 76, 1.5)])
    expected = metrics(pixels, model, Law(4.0))
    for key in ("rmse", "nrmse", "rmse_db", "deviance", "correlation"):
        assert found[key] == pytest.approx(expected[key])
    assert found["pixels"] == pixels.size
    assert role_metrics([]) is None


def test_difference_of_models_is_known_better_than_either() -> None:
    random = np.random.default_rng(1)
    power = random.gamma(4.0, 0.25, (100, 100))
    wrong, right = comparison(power, 1.1), comparison(power, 1.0)
    pair = difference([wrong], [right])
    assert pair is not None
    gain, error = pair
    before, after = pool([wrong]), pool([right])
    assert before is not None
    assert after is not None
    assert gain == pytest.approx(before["deviance"] - after["deviance"])
    # d differs by 2 L (I (1/1.1 - 1) + ln 1.1) / E[d]: its spread is that of I, 1 / sqrt(L), times 2 L (1 - 1/1.1)
    spread = 8.0 * (1 - 1 / 1.1) / 2.0 / (8.0 * (np.log(4.0) - 1.2561176684318))  # psi(4) = 1.25611...
    assert error == pytest.approx(spread / np.sqrt(96 * 96), rel=0.1)
    assert error < 0.5 * before["deviance_error"]
    assert difference([], []) is None


# Refusals


@pytest.mark.parametrize(
    ("arguments", "change", "said"),
    [
        (["--draws", "100"], None, "--draws: found 100"),
        (["--family-error", "0"], None, "--family-error"),
        ([], lambda text: text.replace('role = "train"', 'role = "test"'), "views: none with role train"),
        (["--device", "cuda:77"], None, "--device cuda:77"),
    ],
)
def test_refusals(arguments: list[str], change: Callable[[str], str] | None, said: str, tmp_path: Path) -> None:
    scene_with({}, tmp_path)
    path = tmp_path / "scene.toml"
    if change is not None:
        path.write_text(change(path.read_text()))
    done = CliRunner().invoke(main, ["diagnose", str(path), "-o", str(tmp_path / "out"), *arguments])
    assert done.exit_code == (3 if "--device" in arguments else 2)
    assert said in done.stderr
    assert not (tmp_path / "out" / "diagnosis.json").exists()


def test_the_scene_itself_is_never_replaced(tmp_path: Path) -> None:
    scene_with({}, tmp_path)
    text = (tmp_path / "scene.toml").read_text()
    done = CliRunner().invoke(main, ["diagnose", str(tmp_path / "scene.toml"), "-o", str(tmp_path)])
    assert done.exit_code == 2
    assert "where the scene file itself lies" in done.stderr
    assert (tmp_path / "scene.toml").read_text() == text
