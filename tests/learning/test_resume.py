"""Checkpoints: a run killed at any moment and resumed ends where the uninterrupted one ends, to the bit on the CPU."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from learning_scenes import bumpy, measured, views_at
from worlds import SOIL, scene_of

from warpsar.cli.main import main
from warpsar.errors import InputError
from warpsar.io import checkpoint
from warpsar.io.images import read_image, write_exr
from warpsar.learning import descent
from warpsar.learning.command import LearnOptions, learn
from warpsar.learning.optimise import FitState, levenberg_marquardt
from warpsar.learning.problem import FitProblem
from warpsar.scene.scene import Scene
from warpsar.scene.unwrap import write_obj
from warpsar.world.tables import Material

Whole = Callable[[str], tuple[Path, Path]]
# Long enough to be killed more than once; what stops it is the number of iterations.
OPTIONS = {
    "adam": ["--rate", "0.001", "--iterations", "600", "--checkpoint-every", "5", "--tv", "rms_height_m=1"],
    "lm": ["--starts", "30", "--iterations", "90", "--checkpoint-every", "1"],
}


def small_scene(folder: Path, optimiser: str) -> Path:
    """Tilted facets in 14 x 14 pixels, two train views and a test view: a texture for Adam, numbers for LM."""
    folder.mkdir()
    views = [*views_at((0.0, 40.0), (120.0, 50.0)), *views_at((240.0, 45.0), role="test")]
    views[2] = views[2].model_copy(update={"name": "test"})
    scene = scene_of(bumpy(), views, shape=(14, 14), spacing_m=(0.4, 0.4), polarizations=("HH", "VV"))
    scene = replace(scene, mesh=replace(scene.mesh, vertex_scalars={}))
    seen = measured(scene, folder)
    start = dict(SOIL, rms_height_m=0.0010)
    if optimiser == "adam":
        write_exr(folder / "h.exr", {"h": np.full((4, 4), 0.0010)})
        start |= {"rms_height_m": str(folder / "h.exr"), "layout": "texture"}
    write_obj(folder / "mesh.obj", scene.mesh)
    replace(seen, materials={"soil": Material(**start)}, mesh_path=(folder / "mesh.obj").resolve()).save(
        folder / "scene.toml"
    )
    return folder / "scene.toml"


def start(scene: Path, out: Path, optimiser: str, *more: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "warpsar", "learn", str(scene), "-o", str(out), "--device", "cpu"]
    return subprocess.Popen(
        [*command, "--optimiser", optimiser, *OPTIONS[optimiser], *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(run: subprocess.Popen[str]) -> None:
    _, stderr = run.communicate(timeout=300)
    assert run.returncode == 0, stderr


def written(path: Path) -> int:
    return path.stat().st_mtime_ns if path.exists() else 0


def interrupt(run: subprocess.Popen[str], out: Path, number: int, delay: float) -> None:
    """Send a signal `delay` seconds after the run's first checkpoint."""
    before = written(out / checkpoint.NAME)
    while written(out / checkpoint.NAME) == before:
        assert run.poll() is None, f"ended before it could be interrupted: {run.communicate()}"
        time.sleep(0.002)
    time.sleep(delay)
    assert run.poll() is None, "ended before it could be interrupted"
    os.kill(run.pid, number)


def outcome(out: Path) -> tuple[str, str, dict[str, object], list[object]]:
    content = json.loads((out / "learn.json").read_text())
    kept = {key: content[key] for key in ("loss", "materials", "train", "test", "iterations", "stopped")}
    # pixels, not bytes: an EXR carries the time it was written at
    maps = [read_image(path).tolist() for path in sorted(out.glob("*.exr"))]
    return (out / "scene.toml").read_text(), (out / "history.csv").read_text(), kept, maps


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the scenes, of what uninterrupted runs leave, and of other runs: side by side, so that the paths in
    their scene files are the same."""
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def whole(base: Path) -> Callable[[str], tuple[Path, Path]]:
    """Scene file and output folder of the uninterrupted run, made when first asked for."""

    @cache
    def run(optimiser: str) -> tuple[Path, Path]:
        scene = small_scene(base / f"{optimiser}_scene", optimiser)
        finish(start(scene, base / optimiser, optimiser))
        return scene, base / optimiser

    return run


def killed_and_resumed(optimiser: str, times: int, whole: Whole, seed: int) -> None:
    scene, expected = whole(optimiser)
    random = np.random.default_rng(seed)
    out = expected.parent / f"{optimiser}_killed_{times}"
    for _ in range(times):
        run = start(scene, out, optimiser, "--resume")
        interrupt(run, out, signal.SIGKILL, random.uniform(0.0, 0.5 / times))
        run.communicate()
        assert run.returncode == -signal.SIGKILL
        assert (out / checkpoint.NAME).exists()
        assert not (out / "learn.json").exists()
    finish(start(scene, out, optimiser, "--resume"))
    assert outcome(out) == outcome(expected)
    left = {path.name for path in out.iterdir()} - {path.name for path in expected.iterdir()}
    # a kill in the middle of a write leaves its temporary file, a hidden one, and nothing else
    assert all(name.startswith(".") for name in left)


@pytest.mark.parametrize(
    ("optimiser", "times"),
    [pytest.param("adam", 3, marks=pytest.mark.slow), pytest.param("lm", 1, marks=pytest.mark.full)],
)
def test_killed_and_resumed(optimiser: str, times: int, whole: Whole) -> None:
    killed_and_resumed(optimiser, times, whole, seed=3)


@pytest.mark.slow
@pytest.mark.parametrize("optimiser", ["adam", "lm"])
def test_killed_twenty_times(optimiser: str, whole: Whole) -> None:
    killed_and_resumed(optimiser, 20, whole, seed=20)


@pytest.mark.slow
def test_sigterm_writes_a_checkpoint_and_exits_1(whole: Whole) -> None:
    scene, expected = whole("adam")
    out = expected.parent / "terminated"
    run = start(scene, out, "adam")
    interrupt(run, out, signal.SIGTERM, 0.02)
    stdout, stderr = run.communicate(timeout=60)
    assert run.returncode == 1
    assert stdout == ""
    (message,) = [line for line in stderr.splitlines() if line.startswith("Error:")]
    iteration = int(message.split("iteration ")[1].split(";")[0])
    assert message == f"Error: stopped by a signal at iteration {iteration}; go on with --resume"
    with np.load(out / checkpoint.NAME) as stored:
        assert int(stored["iteration"]) == iteration
    finish(start(scene, out, "adam", "--resume"))
    assert outcome(out) == outcome(expected)


@pytest.mark.usefixtures("listening")
@pytest.mark.parametrize(
    "optimiser", [pytest.param("adam", marks=pytest.mark.slow), pytest.param("lm", marks=pytest.mark.full)]
)
def test_ctrl_c_says_how_to_go_on(optimiser: str, whole: Whole) -> None:
    """The words that it says are run as they stand, and end where the uninterrupted run ends."""
    scene, expected = whole(optimiser)
    out = expected.parent / f"{optimiser} interrupted"
    run = start(scene, out, optimiser)
    interrupt(run, out, signal.SIGINT, 0.02)
    stdout, stderr = run.communicate(timeout=60)
    assert run.returncode == 130
    assert stdout == ""
    assert "Traceback" not in stderr
    (message,) = [line for line in stderr.splitlines() if line.startswith("Error:")]
    said = message.removeprefix("Error: interrupted; go on with: ")
    words = shlex.split(said)
    assert words[:6] == ["warpsar", "learn", str(scene), "-o", str(out), "--resume"]
    given = ["--device", "cpu", "--optimiser", optimiser, *OPTIONS[optimiser]]
    assert sorted(words[6:]) == sorted(given)
    finish(subprocess.Popen([sys.executable, "-m", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
    assert outcome(out) == outcome(expected)


def test_ctrl_c_before_the_first_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def pressed(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("warpsar.learning.command.fitted", pressed)
    scene = small_scene(tmp_path / "scene", "lm")
    done = CliRunner().invoke(main, ["learn", str(scene), "-o", str(tmp_path / "out")])
    assert done.exit_code == 130
    assert done.stderr == "Error: interrupted before the first checkpoint\n"


@pytest.mark.usefixtures("listening")
def test_ctrl_c_in_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first ends the run after its iteration, with a checkpoint; the handler is then Python's own again."""
    scene = Scene.load(small_scene(tmp_path / "scene", "lm"))
    options = LearnOptions(starts=1, iterations=5)

    def pressed(problem: FitProblem, state: FitState) -> FitState:
        os.kill(os.getpid(), signal.SIGINT)
        return levenberg_marquardt(problem, state)

    monkeypatch.setattr(descent, "levenberg_marquardt", pressed)
    with pytest.raises(KeyboardInterrupt):
        learn(scene, device="cpu", options=options, folder=tmp_path / "out")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with np.load(tmp_path / "out" / checkpoint.NAME) as stored:
        assert int(stored["iteration"]) == 1


@pytest.mark.full
@pytest.mark.parametrize("optimiser", ["adam", "lm"])
def test_stopped_after_any_iteration(optimiser: str, tmp_path: Path) -> None:
    """In one process, where every place to stop can be tried; a run that had ended takes no further step."""
    scene = Scene.load(small_scene(tmp_path / "scene", optimiser))
    options = LearnOptions(optimiser=optimiser, starts=3, iterations=14)
    whole = learn(scene, device="cpu", options=options, folder=tmp_path / "whole")
    for stop in (1, 2, 5, 9, 13, 14):
        out = tmp_path / f"stopped{stop}"
        learn(scene, device="cpu", options=replace(options, iterations=stop), folder=out)
        found = learn(scene, device="cpu", options=options, folder=out, resume=True)
        np.testing.assert_array_equal(found.x, whole.x)
        assert found.loss == whole.loss
        assert found.stopped == whole.stopped
        assert found.history == whole.history


# ---- what is no checkpoint of this run ----


@pytest.fixture
def stopped(tmp_path: Path) -> tuple[Scene, Path, LearnOptions]:
    scene = Scene.load(small_scene(tmp_path / "scene", "lm"))
    options = LearnOptions(starts=1, iterations=2)
    learn(scene, device="cpu", options=options, folder=tmp_path / "out")
    return scene, tmp_path / "out", options


@pytest.mark.full
@pytest.mark.parametrize("content", [b"", b"not a checkpoint", b"PK\x03\x04" + bytes(40), b"\x93NUMPY\x01\x00"])
def test_a_broken_checkpoint_is_refused(content: bytes, stopped: tuple[Scene, Path, LearnOptions]) -> None:
    scene, out, options = stopped
    (out / checkpoint.NAME).write_bytes(content)
    with pytest.raises(InputError, match=r"checkpoint\.npz: not a checkpoint of warpsar .*; remove it to start afresh"):
        learn(scene, device="cpu", options=options, folder=out, resume=True)
    learn(scene, device="cpu", options=options, folder=out)  # without --resume it is replaced


def test_no_broken_byte_goes_unseen(tmp_path: Path) -> None:
    """Truncated anywhere, or any byte changed: refused, or read as it was (a byte that means nothing, a time stamp)."""
    arrays = {"x": np.arange(5.0), "history": np.array('[{"loss": 1.0}]'), "iteration": np.array(3)}
    checkpoint.write(tmp_path, arrays, "tag")
    whole = (tmp_path / checkpoint.NAME).read_bytes()
    random = np.random.default_rng(0)
    refused = 0
    for _ in range(400):
        broken = bytearray(whole)
        if random.random() < 0.2:
            broken = broken[: random.integers(len(whole))]
        else:
            broken[random.integers(len(whole))] ^= 1 << random.integers(8)
        (tmp_path / checkpoint.NAME).write_bytes(broken)
        try:
            found = checkpoint.read(tmp_path, "tag")
        except InputError:
            refused += 1
            continue
        assert found is not None
        assert found.keys() == arrays.keys()
        for key, array in arrays.items():
            np.testing.assert_array_equal(found[key], array)
    assert refused > 200


@pytest.mark.full
def test_a_checkpoint_of_something_else_is_refused(stopped: tuple[Scene, Path, LearnOptions], tmp_path: Path) -> None:
    scene, out, options = stopped
    message = "found a checkpoint of other input or options"
    for changed in (replace(options, loss="log"), replace(options, seed=1), replace(options, validity=1.0)):
        with pytest.raises(InputError, match=message):
            learn(scene, device="cpu", options=changed, folder=out, resume=True)
    text = scene.path.read_text() if scene.path else ""
    (tmp_path / "scene" / "other.toml").write_text(text.replace("incidence_deg = 40.0", "incidence_deg = 41.0"))
    with pytest.raises(InputError, match=message):
        learn(Scene.load(tmp_path / "scene" / "other.toml"), device="cpu", options=options, folder=out, resume=True)
    # one more pixel's worth of measured power
    image = scene.views[0].images["HH"]
    image.write_bytes(scene.views[1].images["HH"].read_bytes())
    with pytest.raises(InputError, match=message):
        learn(Scene.load(scene.path or ""), device="cpu", options=options, folder=out, resume=True)


@pytest.mark.full
def test_how_long_to_run_may_change(stopped: tuple[Scene, Path, LearnOptions]) -> None:
    scene, out, options = stopped
    longer = replace(options, iterations=50, max_time_s=60.0, checkpoint_every=3)
    found = learn(scene, device="cpu", options=longer, folder=out, resume=True)
    assert len(found.history) > 2
    assert found.stopped == "plateau"


@pytest.mark.full
def test_a_refusal_of_the_command_is_one_message(stopped: tuple[Scene, Path, LearnOptions], tmp_path: Path) -> None:
    _, out, _ = stopped
    run = start(tmp_path / "scene" / "scene.toml", out, "lm", "--resume")
    stdout, stderr = run.communicate(timeout=60)
    assert run.returncode == 2
    assert stdout == ""
    assert stderr.count("Error: ") == 1
    assert "Traceback" not in stderr
