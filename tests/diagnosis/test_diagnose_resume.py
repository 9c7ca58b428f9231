"""`warpsar diagnose --resume`: a run killed after any stage ends where the uninterrupted one ends, to the bit."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from test_diagnose import SLOPE, scene_with

from warpsar.cli.main import main
from warpsar.diagnosis.command import UNEXPLAINED
from warpsar.diagnosis.found import DiagnoseOptions, Turn
from warpsar.diagnosis.search import loop, record
from warpsar.errors import InputError
from warpsar.io import checkpoint
from warpsar.runtime.deadline import TimeUp
from warpsar.scene.scene import Scene

SHIFT = {"range_m": 0.33, "azimuth_m": -0.41}  # of pixels of 0.5 m: light moves, and fewer pixels are compared
WORDS = ["--device", "cpu", "--draws", "400", "--starts", "1", "--most-effects", "2", "--seed", "3"]
OPTIONS = DiagnoseOptions(draws=400, starts=1, most_effects=2, seed=3)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, int]:
    """Scene file and output folder of an uninterrupted run, and how many checkpoints it writes."""
    folder = tmp_path_factory.mktemp("runs")
    scene_with({"eps_gradient": SLOPE, "registration": SHIFT}, folder)
    written = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checkpoint, "write", counted(written.append))
        done = CliRunner().invoke(main, command(folder / "scene.toml", folder / "whole"))
    assert done.exit_code == 0, done.output
    content = json.loads((folder / "whole" / "diagnosis.json").read_text())
    assert sorted(content["verdict"]) == ["eps_gradient", "registration"]
    assert len(written) == 1 + len(content["turns"]) + 1  # the declared model, the turns, and what holds of them
    return folder / "scene.toml", folder / "whole", len(written)


def counted(seen: Callable[[Path], Any], write: Callable[..., None] = checkpoint.write) -> Callable[..., None]:
    """`checkpoint.write`, of which `seen` is told the folder."""

    def writing(folder: Path, *about: Any) -> None:
        write(folder, *about)
        seen(folder)

    return writing


def command(scene: Path, out: Path, *more: str) -> list[str]:
    return ["diagnose", str(scene), "-o", str(out), *WORDS, *more]


def outcome(out: Path) -> tuple[dict[str, Any], str, str]:
    """Everything that a run leaves, but for its time and its folder."""
    content = json.loads((out / "diagnosis.json").read_text())
    report = (out / "report.html").read_text().replace(str(out), "OUT")
    content.pop("wall_time_s")  # not looked for in the report: 0.5 s may be a number there, too
    report = re.sub(r"[\d.]+ s\b", "TIME", report)
    return content, (out / "scene.toml").read_text(), report


@pytest.mark.full
def test_killed_after_every_stage(whole: tuple[Path, Path, int]) -> None:
    """SIGKILL after the declared fit and after every turn, the last one too: one run, killed again and again."""
    scene, expected, stages = whole
    out = expected.parent / "killed"
    path, resume = out / checkpoint.NAME, []
    for _ in range(stages):
        before = path.stat().st_mtime_ns if resume else 0
        run = subprocess.Popen(
            [sys.executable, "-m", "warpsar", *command(scene, out, *resume)], stderr=subprocess.PIPE, text=True
        )
        while not path.exists() or path.stat().st_mtime_ns == before:
            assert run.poll() is None, run.communicate()
            time.sleep(0.002)
        os.kill(run.pid, signal.SIGKILL)
        run.communicate()
        assert run.returncode == -signal.SIGKILL
        assert not (out / "diagnosis.json").exists()
        resume = ["--resume"]
    done = CliRunner().invoke(main, command(scene, out, "--resume"))
    assert done.exit_code == 0, done.output
    assert outcome(out) == outcome(expected)
    assert not path.exists()


@pytest.mark.slow
@pytest.mark.parametrize("stage", [1, 2])
def test_ctrl_c_says_how_to_go_on(stage: int, whole: tuple[Path, Path, int], monkeypatch: pytest.MonkeyPatch) -> None:
    """The words that it says end where the uninterrupted run ends; what the checkpoint holds is not done again."""
    scene, expected, stages = whole
    out = expected.parent / f"interrupted{stage}"
    seen: list[Path] = []

    def pressed(folder: Path) -> None:
        seen.append(folder)
        if len(seen) == stage:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "write", counted(pressed))
        done = CliRunner().invoke(main, command(scene, out))
        assert done.exit_code == 130
        said = done.stderr.splitlines()[-1].removeprefix("Error: interrupted; go on with: ")
        words = shlex.split(said)
        assert words[:6] == ["warpsar", "diagnose", str(scene), "-o", str(out), "--resume"]
        assert sorted(words[6:]) == sorted(WORDS)
        done = CliRunner().invoke(main, words[1:])
    assert done.exit_code == 0, done.output
    assert len(seen) == stages
    assert outcome(out) == outcome(expected)


@pytest.mark.full
def test_a_limit_of_time_ends_with_what_there_is_and_goes_on(whole: tuple[Path, Path, int]) -> None:
    """Over before the first turn: the declared model is judged, and what was not asked is said. The run goes on
    to where it would have ended."""
    scene, expected, _ = whole
    out = expected.parent / "limited"
    done = CliRunner().invoke(main, command(scene, out, "--time-limit", "1e-6"))
    content = json.loads((out / "diagnosis.json").read_text())
    assert done.exit_code == UNEXPLAINED, done.output
    assert (content["verdict"], content["unexplained"]) == ([], True)
    first, second = content["not_asked"]
    assert first == "turn 1: which effect explains the residual"
    assert "eps_gradient" in second
    assert "the time was over before all was asked" in done.stdout
    assert first in (out / "report.html").read_text()
    assert (out / checkpoint.NAME).exists()
    done = CliRunner().invoke(main, command(scene, out, "--resume"))
    assert done.exit_code == 0, done.output
    assert outcome(out) == outcome(expected)
    assert not (out / checkpoint.NAME).exists()


@pytest.mark.full
def test_what_was_added_on_trial_stays_in_the_model_and_is_no_name_when_the_time_is_over(
    whole: tuple[Path, Path, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, expected, _ = whole
    out = expected.parent / "after_a_turn"
    turns = []
    forward = loop.Search._turn

    def over(search: loop.Search) -> Turn:
        if turns:
            raise TimeUp
        turns.append(forward(search))
        return turns[0]

    monkeypatch.setattr(loop.Search, "_turn", over)
    CliRunner().invoke(main, command(scene, out, "--time-limit", "1000"))
    content = json.loads((out / "diagnosis.json").read_text())
    name = turns[0].added
    assert name is not None
    assert name in content["effects"]
    assert (content["verdict"], content["unexplained"]) == ([], True), "it was never asked beside the others"
    assert "time was over" in content["not_established"][name]
    assert content["not_asked"] == [
        "turn 2: which effect explains the residual",
        f"whether each of these holds beside all the others: {turns[0].added}",
    ]


@pytest.mark.full
def test_nothing_to_resume_is_refused(whole: tuple[Path, Path, int], tmp_path: Path) -> None:
    done = CliRunner().invoke(main, command(whole[0], tmp_path / "out", "--resume"))
    assert done.exit_code == 2
    assert f"Error: --resume: found no checkpoint in {tmp_path / 'out'}" in done.stderr
    assert "fit of the declared model" not in done.stderr


@pytest.mark.full
def test_under_torchrun_a_job_before_its_first_checkpoint_begins_anew(
    whole: tuple[Path, Path, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TORCHELASTIC_RESTART_COUNT", "1")
    begun = record.open_record(Scene.load(whole[0]), OPTIONS, tmp_path, True)
    assert begun._stored == []
    assert "--resume: there is no checkpoint; the run starts afresh" in capsys.readouterr().err


@pytest.mark.full
def test_a_checkpoint_of_something_else_is_refused(
    whole: tuple[Path, Path, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene.load(whole[0])
    stored: dict[str, Any] = {"told": np.array("[]")}
    monkeypatch.setattr(record, "__version__", "0.0.1")
    first = record.open_record(scene, OPTIONS, tmp_path, False)
    checkpoint.write(tmp_path, stored, first._log._tag)
    record.open_record(scene, OPTIONS, tmp_path, True)  # the same run
    for other in ({"draws": 500}, {"starts": 2}, {"seed": 4}, {"family_error": 0.02}, {"most_effects": 1}):
        with pytest.raises(InputError, match="found a checkpoint of other input or options"):
            record.open_record(scene, replace(OPTIONS, **other), tmp_path, True)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="found a checkpoint of other input or options"):
        record.open_record(replace(scene, source=scene.source + "\n"), OPTIONS, tmp_path, True)
    monkeypatch.setattr(record, "__version__", "0.0.2")
    with pytest.raises(InputError, match="found a checkpoint of other input or options"):
        record.open_record(scene, OPTIONS, tmp_path, True)
    (tmp_path / checkpoint.NAME).write_bytes(b"not a checkpoint")
    with pytest.raises(InputError, match=r"not a checkpoint of warpsar .*; remove it to start afresh"):
        record.open_record(scene, OPTIONS, tmp_path, True)
