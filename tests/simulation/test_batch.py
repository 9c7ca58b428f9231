"""Batches: every image exactly once, whatever happens on the way; views made on the fly; what fails is named."""

import csv
import errno
import hashlib
import json
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from test_distributed import needs_torch
from torchrun import ENVIRONMENT, finish, start, strike
from worlds import SOIL, ground, mesh_of, scene_of, view

from warpsar.cli.main import main
from warpsar.errors import InputError
from warpsar.io import images
from warpsar.io.images import read_channel
from warpsar.runtime.background import Background
from warpsar.scene.scene import Scene
from warpsar.scene.unwrap import write_obj
from warpsar.simulation import maker
from warpsar.simulation.batch import shares
from warpsar.simulation.command import simulate
from warpsar.simulation.index import FIELDS, INDEX, PARTS, Index
from warpsar.simulation.naming import angles, labels, views_at

HERE = Path(__file__).resolve().parents[1]


def scene_file(folder: Path, size: float = 6.0, cells: int = 3, name: str = "scene") -> Path:
    """A square with a view of its own, in 10 x 12 pixels."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = scene_of(
        mesh_of(soil=ground(size, cells)), view(10.0, 40.0, name="own"), shape=(10, 12), rays_per_pixel=16.0
    )
    write_obj(folder / f"{name}.obj", scene.mesh)
    text = f"""
[scene]
mesh = "{name}.obj"
[radar]
frequency_hz = 9.6e9
polarizations = ["HH"]
[image]
shape = [10, 12]
spacing_m = [0.5, 0.5]
[sampling]
rays_per_pixel = 16.0
[materials.soil]
eps_r = {SOIL["eps_r"]}
rms_height_m = {SOIL["rms_height_m"]}
correlation_length_m = {SOIL["correlation_length_m"]}
[[views]]
name = "own"
azimuth_deg = 10.0
incidence_deg = 40.0
"""
    (folder / f"{name}.toml").write_text(text)
    return folder / f"{name}.toml"


def run(*arguments: object, expected: int = 0) -> str:
    """stderr of `warpsar simulate` in this process."""
    done = CliRunner().invoke(main, ["simulate", *map(str, arguments), "--device", "cpu"])
    assert done.exit_code == expected, done.output
    assert "Traceback" not in done.output
    return done.stderr


def rows(out: Path) -> list[dict[str, str]]:
    with (out / INDEX).open(newline="") as stream:
        return list(csv.DictReader(stream))


def assert_whole(out: Path, names: set[str]) -> None:
    """Every image once, in the index and on disk, and nothing besides."""
    found = rows(out)
    assert Counter(row["name"] for row in found) == Counter(names)
    for row in found:
        data = (out / row["file"]).read_bytes()
        assert hashlib.sha256(data).hexdigest() == row["sha256"]
    left = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert left == {row["file"] for row in found} | {INDEX, "simulate.json"}


def pixels(out: Path) -> dict[str, Any]:
    return {row["name"]: read_channel(out / row["file"], "HH").tobytes() for row in rows(out)}


def names_of(labels: list[str], azimuths: range, incidences: list[int]) -> set[str]:
    width = len(str(max(azimuths)))
    return {f"{label}/az{a:0{width}}_inc{i}" for label in labels for a in azimuths for i in incidences}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0:360:90", ["0", "90", "180", "270"]),
        ("30:60:12.5", ["30", "42.5", "55.0"]),
        ("0:1:0.1", [f"0.{i}" if i else "0" for i in range(10)]),  # in decimal: 0.3 is 0.3
        ("-10:11:10", ["-10", "0", "10"]),
        ("5", ["5"]),
        ("1,2.5,0.5", ["1", "2.5", "0.5"]),
    ],
)
def test_angles(text: str, expected: list[str]) -> None:
    assert angles(text, "--azimuths", -360.0, 360.1) == [Decimal(each) for each in expected]


@pytest.mark.parametrize(
    "text", ["", "a", "1:2", "1:2:0", "2:1:1", "0:1:-1", "0:450:90", "1,1", "nan", "0:inf:1", "0:9:1e-30"]
)
def test_angles_refused(text: str) -> None:
    found = "360" if text == "0:450:90" else repr(text)
    with pytest.raises(InputError, match=re.escape(f"--azimuths: found {found}")):
        angles(text, "--azimuths", -360.0, 360.0)


def test_views_at_carry_as_many_decimals_as_they_need() -> None:
    made = views_at(angles("0:360:90", "a", -360, 361), angles("30:31:0.25", "i", 0, 90))
    names = ["az000_inc30.00", "az000_inc30.25", "az000_inc30.50", "az000_inc30.75", "az090_inc30.00"]
    assert [one.name for one in made][:5] == names
    assert (made[1].azimuth_deg, made[1].incidence_deg) == (0.0, 30.25)


def test_labels() -> None:
    assert labels([Path("x/a.toml"), Path("y/b.toml")]) == ["a", "b"]
    assert labels([Path("/x/scene.toml"), Path("/y/scene.toml")]) == ["x", "y"]
    assert labels([Path("/x/a.toml"), Path("/x/b.toml"), Path("/y/a.toml")]) == ["x_a", "x_b", "y_a"]
    with pytest.raises(InputError, match="two that have the same name"):
        labels([Path("/p/x/a.toml"), Path("/q/x/a.toml")])


def test_blocks_hold_every_view_once() -> None:
    for views, processes in (([5], 1), ([5], 2), ([1000], 4), ([3, 1, 7], 2), ([1] * 100, 3), ([40] * 64, 4)):
        found = shares(views, processes)
        held = [(b.scene, v) for b in found for v in range(b.part, views[b.scene], b.of)]
        assert Counter(held) == Counter((s, v) for s, n in enumerate(views) for v in range(n))
    assert len(shares([40] * 64, 4)) == 64  # scenes stay whole where there are enough


def test_own_views_are_those_of_a_plain_run(tmp_path: Path) -> None:
    first, second = scene_file(tmp_path / "a"), scene_file(tmp_path / "b", 4.0)
    assert "2 images: 2 made, 0 were there" in run(first, second, "-o", tmp_path / "out")
    assert_whole(tmp_path / "out", {"a/own", "b/own"})
    for path, label in ((first, "a"), (second, "b")):
        (alone,) = simulate(Scene.load(path), device="cpu")
        np.testing.assert_array_equal(
            read_channel(tmp_path / "out" / label / "000" / "own.exr", "HH"), alone.beta0["HH"]
        )


def test_angles_are_the_views_they_say(tmp_path: Path) -> None:
    """Against a plain run of a scene file with that very view: another jitter, so to the sampling error of a plane."""
    path = scene_file(tmp_path / "a")
    run(path, "-o", tmp_path / "out", "--azimuths", "10", "--incidences", "40,50")
    (plain,) = simulate(Scene.load(path), device="cpu")
    image = read_channel(tmp_path / "out" / "scene" / "000" / "az10_inc40.exr", "HH")
    assert image[3:7, 3:9].mean() == pytest.approx(plain.beta0["HH"][3:7, 3:9].mean(), rel=1e-4)
    assert [row["incidence_deg"] for row in rows(tmp_path / "out")] == ["40.0", "50.0"]
    other = read_channel(tmp_path / "out" / "scene" / "000" / "az10_inc50.exr", "HH")
    assert other[3:7, 3:9].mean() != pytest.approx(image[3:7, 3:9].mean(), rel=0.1)


def test_a_rerun_makes_only_what_is_missing(tmp_path: Path) -> None:
    path, out = scene_file(tmp_path / "a"), tmp_path / "out"
    asked = (path, "-o", out, "--azimuths", "0:360:60", "--incidences", "40")
    names = names_of(["scene"], range(0, 360, 60), [40])
    assert "6 images: 6 made, 0 were there" in run(*asked)
    before = pixels(out)
    (out / "scene" / "000" / "az060_inc40.exr").unlink()
    broken = out / "scene" / "000" / "az120_inc40.exr"
    broken.write_bytes(broken.read_bytes()[:-7])
    stamp = (out / "scene" / "000" / "az180_inc40.exr").stat().st_mtime_ns
    assert "6 images: 0 made, 4 were there, 2 made again (0 of other inputs, 2 damaged)" in run(*asked)
    assert (out / "scene" / "000" / "az180_inc40.exr").stat().st_mtime_ns == stamp
    assert_whole(out, names)
    assert pixels(out) == before
    # more angles: what is there stays, its jitter too
    assert "12 images: 6 made, 6 were there" in run(*asked[:-1], "40,50")
    assert {name: image for name, image in pixels(out).items() if name in before} == before
    # another seed, another material: other images under the same names
    assert "6 made again (6 of other inputs, 0 damaged)" in run(*asked, "--seed", "5")
    path.write_text(path.read_text().replace("eps_r = 6.0", "eps_r = 7.0"))
    assert "6 made again (6 of other inputs, 0 damaged)" in run(*asked, "--seed", "5")


def test_a_thousand_files_a_folder_and_further_channels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(maker, "PER_FOLDER", 3)
    path, out = scene_file(tmp_path / "a"), tmp_path / "out"
    run(path, "-o", out, "--azimuths", "0:80:10", "--incidences", "40", "--layers", "--variance")
    assert {folder.name: len(list(folder.iterdir())) for folder in (out / "scene").iterdir()} == {
        "000": 3,
        "001": 3,
        "002": 2,
    }
    for name in ("HH", "incidence_deg", "shadow", "sampling_variance_HH"):
        assert np.isfinite(read_channel(out / "scene" / "000" / "az00_inc40.exr", name)[5, 6])


def test_an_unreadable_mesh_among_many(tmp_path: Path) -> None:
    scenes = [scene_file(tmp_path / f"s{i}") for i in range(5)]
    (tmp_path / "s2" / "scene.obj").write_text("v 0 0 nonsense\n")
    said = run(*scenes, "-o", tmp_path / "out", "--azimuths", "0,90", "--incidences", "45", expected=2)
    assert "1 failed; everything else is made" in said
    assert f"{scenes[2]}: scene.mesh: {tmp_path}/s2/scene.obj" in said
    names = names_of([f"s{i}" for i in (0, 1, 3, 4)], range(0, 91, 90), [45])
    assert_whole(tmp_path / "out", names)
    assert list(json.loads((tmp_path / "out" / "simulate.json").read_text())["failed"]) == [str(scenes[2])]
    scene_file(tmp_path / "s2")  # mended
    assert "10 images: 2 made, 8 were there" in run(
        *scenes, "-o", tmp_path / "out", "--azimuths", "0,90", "--incidences", "45"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--azimuths", "0:360:60"], "found one of them"),
        (["--azimuths", "0", "--incidences", "95"], "found 95"),
    ],
)
def test_angles_refused_at_the_door(arguments: list[str], message: str, tmp_path: Path) -> None:
    assert message in run(scene_file(tmp_path / "a"), "-o", tmp_path / "out", *arguments, expected=2)
    assert not (tmp_path / "out").exists()


def test_values_of_single_views_have_no_place(tmp_path: Path) -> None:
    path = scene_file(tmp_path / "a")
    path.write_text(path.read_text() + "[effects.view_gain]\ngain_db = { own = 1.0 }\n")
    said = run(path, "-o", tmp_path / "out", "--azimuths", "0", "--incidences", "40", expected=2)
    assert "effects.view_gain.gain_db: found values of single views" in said


# What may go wrong


def test_a_disk_that_fills_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The fourth image finds no room: what is there stays, the refusal is one line, the next run makes the rest."""
    path, out = scene_file(tmp_path / "a"), tmp_path / "out"
    asked = (path, "-o", out, "--azimuths", "0:360:60", "--incidences", "40")
    replace, count = os.replace, iter(range(100))

    def full(source: Any, target: Any) -> None:
        if str(target).endswith(".exr") and next(count) == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full)
        said = run(*asked, expected=2)
    assert said.splitlines()[-1] == f"Error: {out}/scene/000/az180_inc40.exr: No space left on device"
    assert len(list(out.rglob("*.exr"))) == 3  # and no half a file
    assert "6 images: 3 made, 3 were there" in run(*asked)
    assert_whole(out, names_of(["scene"], range(0, 360, 60), [40]))


def test_a_file_that_cannot_be_written_among_many(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A refusal of one file, beside the making of the next images: it is named at the end, and all others are made."""
    path, out = scene_file(tmp_path / "a"), tmp_path / "out"
    asked = (path, "-o", out, "--azimuths", "0:360:60", "--incidences", "40")
    write = images.write_exr

    def refused(target: Path, channels: Any, header: Any) -> None:
        if target.name == "az120_inc40.exr":
            raise InputError(f"{target}: cannot be written (so it is said)")
        write(target, channels, header)

    with monkeypatch.context() as patch:
        patch.setattr(maker, "write_exr", refused)
        said = run(*asked, expected=2)
    assert "6 images" not in said
    assert "5 images: 5 made" in said
    assert "1 failed; everything else is made" in said
    assert said.count("cannot be written (so it is said)") == 1
    names = names_of(["scene"], range(0, 360, 60), [40])
    assert_whole(out, names - {"scene/az120_inc40"})
    assert list(json.loads((out / "simulate.json").read_text())["failed"]) == [f"{path}, view az120_inc40"]
    assert "6 images: 1 made, 5 were there" in run(*asked)


def test_the_last_file_finds_no_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """When no image is left to be made, whose end would have told of it."""
    path, out = scene_file(tmp_path / "a"), tmp_path / "out"
    asked = (path, "-o", out, "--azimuths", "0:360:60", "--incidences", "40")
    write = images.write_exr

    def full(target: Path, channels: Any, header: Any) -> None:
        if target.name == "az300_inc40.exr":
            time.sleep(0.2)  # the other thread has ended by then
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))
        write(target, channels, header)

    with monkeypatch.context() as patch:
        patch.setattr(maker, "write_exr", full)
        said = run(*asked, expected=2)
    assert said.splitlines()[-1] == f"Error: {out}/scene/000/az300_inc40.exr: No space left on device"
    assert "Traceback" not in said
    assert not (out / "simulate.json").exists()
    assert "6 images: 1 made, 5 were there" in run(*asked)
    assert_whole(out, names_of(["scene"], range(0, 360, 60), [40]))


def test_tasks_beside_are_in_order_few_and_end_with_the_first_failure() -> None:
    done: list[int] = []
    held = threading.Semaphore(0)

    def task(number: int) -> None:
        held.acquire()
        if number == 3:
            raise OSError("the third")
        done.append(number)

    with Background(2) as beside:
        for number in (0, 1, 2):
            beside.put(partial(task, number))
        waiting = threading.Thread(target=beside.put, args=[partial(task, 7)], daemon=True)
        waiting.start()
        waiting.join(0.1)
        assert waiting.is_alive()  # one in work, two that wait: the fourth has to wait with its image
        held.release()
        waiting.join(10.0)
        assert not waiting.is_alive()
        for _ in range(3):
            held.release()
    assert done == [0, 1, 2, 7]
    for _ in range(9):
        held.release()

    def failing(own: Exception | None = None) -> None:
        with Background(4) as beside:
            for number in (3, 4, 5):
                beside.put(partial(task, number))
            if own is not None:
                raise own

    with pytest.raises(OSError, match="the third"):
        failing()
    assert done == [0, 1, 2, 7]
    with pytest.raises(ValueError, match="of the block"):  # which goes before
        failing(ValueError("of the block"))


def test_the_kernel_refuses_the_bytes_of_an_image(tmp_path: Path) -> None:
    """A bound on a file's size, which the system enforces in the middle of OpenImageIO's writing."""
    path, out = scene_file(tmp_path / "a"), tmp_path / "out"
    path.write_text(path.read_text().replace("[10, 12]", "[160, 192]").replace("[0.5, 0.5]", "[0.03, 0.03]"))
    run(path, "-o", tmp_path / "first", "--azimuths", "0", "--incidences", "50")  # compiles what has to be
    command = [sys.executable, "-m", "warpsar", "simulate", path, "-o", out, "--azimuths", "0", "--incidences", "40"]
    done = subprocess.run(
        [*map(str, command), "--device", "cpu"],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
    )
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    (message,) = [line for line in done.stderr.splitlines() if line.startswith("Error:")]
    assert "az0_inc40.exr: cannot be written" in message
    assert list(out.rglob("*.exr")) == []


def test_rows_that_find_no_room(tmp_path: Path) -> None:
    """The index on a full device, which /dev/full is: an image without its row is made again."""
    path, out = scene_file(tmp_path / "a"), tmp_path / "out"
    (out / PARTS).mkdir(parents=True)
    part = out / PARTS / "0.csv"
    index = Index(out)
    (out / PARTS).mkdir()
    part.symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left"):
        index.add(dict.fromkeys(FIELDS, "x"))
    part.unlink()
    assert "1 images: 1 made" in run(path, "-o", out, "--azimuths", "0", "--incidences", "40")
    assert_whole(out, {"scene/az0_inc40"})


def test_half_a_row_and_half_a_file_are_as_if_never_written(tmp_path: Path) -> None:
    path, out = scene_file(tmp_path / "a"), tmp_path / "out"
    asked = (path, "-o", out, "--azimuths", "0:360:60", "--incidences", "40")
    run(*asked)
    lines = (out / INDEX).read_text().splitlines(keepends=True)
    (out / INDEX).write_text("".join(lines[:4]))
    (out / PARTS).mkdir()
    (out / PARTS / "0.csv").write_text(lines[4] + lines[5][:-9])
    (out / "scene" / "000" / f".{'0a' * 16}.exr").write_bytes(b"half")
    assert "6 images: 2 made, 4 were there" in run(*asked)
    assert_whole(out, names_of(["scene"], range(0, 360, 60), [40]))


def out_of_memory(limit: int, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Have `trace` fail as Warp does on a device whose memory ends at `limit` hits of a call; counts that passed."""
    from warpsar.simulation import rays as simulation

    real, passed = simulation.trace, []

    def trace(*arguments: Any, **more: Any) -> Any:
        hits = real(*arguments, **more)
        if hits.count > limit:
            raise RuntimeError(f"Failed to allocate {hits.count * 64} bytes on device 'cuda:0'")
        passed.append(hits.count)
        return hits

    monkeypatch.setattr(simulation, "trace", trace)
    return passed


def test_out_of_memory_goes_on_in_smaller_bands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = scene_file(tmp_path / "a")
    (whole,) = simulate(Scene.load(path), device="cpu")
    with monkeypatch.context() as patch:
        passed = out_of_memory(whole.hits // 5, patch)
        (banded,) = simulate(Scene.load(path), device="cpu")
        assert max(passed) <= whole.hits // 5
    assert banded.hits == whole.hits
    # the same hits of every pixel, added up in another order, in float32
    np.testing.assert_allclose(banded.beta0["HH"], whole.beta0["HH"], rtol=1e-6)


def test_out_of_memory_for_good_is_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [scene_file(tmp_path / "a", cells=24), scene_file(tmp_path / "b", 1.0, cells=1)]
    out_of_memory(20, monkeypatch)  # all of b's, and not a column of a's
    said = run(*scenes, "-o", tmp_path / "out", expected=2)
    assert "view own: out of memory even in 256 parts (Failed to allocate" in said
    assert_whole(tmp_path / "out", {"b/own"})


@pytest.mark.full
def test_sigterm_loses_nothing(tmp_path: Path) -> None:
    """The process ends at once, as the system has it (a shell calls that 143); the next run makes the rest."""
    path, out = scene_file(tmp_path / "a"), tmp_path / "out"
    asked = (path, "-o", out, "--azimuths", "0:360:0.5", "--incidences", "35,50")
    command = [sys.executable, "-m", "warpsar", "simulate", *map(str, asked), "--device", "cpu"]
    started = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    while len(list(out.glob("scene/000/az*.exr"))) < 20:
        assert started.poll() is None, started.communicate()
        time.sleep(0.005)
    started.terminate()
    started.communicate(timeout=60)
    assert started.returncode == -signal.SIGTERM
    made, kept = map(int, re.findall(r"1440 images: (\d+) made, (\d+) were there", run(*asked))[0])
    assert made + kept == 1440
    assert kept >= 19  # the last one's row may be missing
    names = {f"scene/az{i / 2:05.1f}_inc{k}" for i in range(720) for k in (35, 50)}
    assert_whole(out, names)


# Several processes


def killed(folder: Path, times: int, azimuths: range, seed: int) -> None:
    """Kill one rank of two `times` times: the batch ends with every image exactly once, and says how many it kept."""
    scenes = [scene_file(folder / "a"), scene_file(folder / "b", 4.0)]
    angles = ["--azimuths", f"0:{azimuths.stop}:{azimuths.step}", "--incidences", "35,50"]
    command = ["-m", "warpsar", "simulate", *scenes, "--device", "cpu", *angles]
    out, random = folder / "out", np.random.default_rng(seed)
    run = start(2, *command, "-o", out, restarts=times)

    def written() -> int:
        return len(list(out.glob("*/000/az*.exr")))

    for number in range(times):
        before = written()
        strike(run, lambda before=before: written() > before, random.uniform(0.0, 0.4 / times), number)
    _, stderr = finish(run)
    names = names_of(["a", "b"], azimuths, [35, 50])
    assert_whole(out, names)
    made, kept = map(int, re.findall(r"images: (\d+) made, (\d+) were there", stderr)[-1])
    assert made + kept == len(names)
    assert kept > 0
    alone = subprocess.run(
        [sys.executable, *map(str, command), "-o", str(folder / "alone")], env={**os.environ, **ENVIRONMENT}
    )
    assert alone.returncode == 0
    assert pixels(out) == pixels(folder / "alone")


@pytest.mark.full
@needs_torch
def test_a_rank_killed(tmp_path: Path) -> None:
    killed(tmp_path, 1, range(0, 300, 2), seed=1)


@needs_torch
@pytest.mark.slow
def test_a_rank_killed_twenty_times(tmp_path: Path) -> None:
    killed(tmp_path, 20, range(0, 360), seed=2)
