"""Bars of long work: seen on a terminal, and nowhere else."""

import os
import pty
import re
import select
import subprocess
import sys
import termios
import time
from dataclasses import replace
from pathlib import Path

import pytest
from worlds import BRICK, SOIL, box, ground, mesh_of, scene_of, view

from warpsar.world.collection import Collection

# Bars wait for a second, so that short work shows none. Here all work is short.
START = (
    "import sys; from warpsar.runtime import busy, console; console.DELAY_S = 0.0; busy.TICK_S = 0.02; "
    "from warpsar.cli.main import main; main(sys.argv[1:])"
)
BARS = {
    "rays:": ["simulate", "scene.toml", "-o", "images"],
    "images:": ["simulate", "scene.toml", "-o", "many", "--azimuths", "0:30:10", "--incidences", "40"],
    "scatterers:": ["simulate", "scene.toml", "-o", "slc", "--product", "slc"],
    "focusing:": ["simulate", "scene.toml", "-o", "focused", "--product", "slc"],
    "view: scatterers:": ["simulate", "scene.toml", "-o", "history", "--product", "phase-history"],
    "directions:": ["rcs", "scene.toml", "-o", "rcs", "--azimuths", "0:4:1"],
    "learn:": ["learn", "seen/scene.toml", "-o", "learned"],
    "evaluate:": ["evaluate", "seen/scene.toml", "-o", "evaluated"],
    "diagnose:": ["diagnose", "seen/scene.toml", "-o", "diagnosed"],
}
"""What the bar of a command is called."""
WAIT_S = 240.0  # for a kernel to be compiled on a busy machine


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene for every product, and the same with images that were measured."""
    found = tmp_path_factory.mktemp("bars")
    mesh = mesh_of(soil=ground(8.0), brick=box((-1.0, -1.0, 0.0), (1.0, 1.0, 1.0)))
    scene = scene_of(
        mesh,
        view(10.0, 42.0),
        shape=(24, 24),
        materials={"soil": SOIL, "brick": BRICK},
        terms=("rough",),
        slant_range_m=10e3,
    )
    scene = replace(scene, collection=Collection(mode="spotlight", resolution_m=(1.0, 1.0)))
    scene.save(found / "scene.toml")
    words = ["simulate", "scene.toml", "-o", "seen", "--looks", "4", "--declare", "--device", "cpu"]
    subprocess.run([sys.executable, "-c", START, *words], cwd=found, check=True, capture_output=True)
    return found


def started(words: list[str], folder: Path, stderr: int) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", START, *words, "--device", "cpu"]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=stderr)


def seen_on_terminal(words: list[str], folder: Path, wanted: re.Pattern[bytes]) -> bytes:
    """What a command shows on a terminal, until it shows what is wanted, or ends."""
    terminal, its_end = pty.openpty()
    termios.tcsetwinsize(its_end, (40, 120))  # a terminal of no width shows no bar
    process = started(words, folder, its_end)
    os.close(its_end)
    shown, until = b"", time.monotonic() + WAIT_S
    try:
        while not wanted.search(shown) and time.monotonic() < until:
            if select.select([terminal], [], [], 1.0)[0]:
                try:
                    shown += os.read(terminal, 65536)
                except OSError:  # the other end is closed
                    break
    finally:
        process.kill()
        process.wait()
        os.close(terminal)
    return shown


@pytest.mark.full
@pytest.mark.parametrize("bar", BARS)
def test_a_bar_on_a_terminal(folder: Path, bar: str) -> None:
    wanted = drawn(bar)
    assert wanted.search(seen_on_terminal(BARS[bar], folder, wanted))


@pytest.mark.full
@pytest.mark.parametrize("bar", ["rays:", "images:", "scatterers:", "directions:", "evaluate:"])
def test_no_bar_elsewhere(folder: Path, bar: str) -> None:
    words = list(BARS[bar])
    words[3] += "_piped"
    process = started(words, folder, subprocess.PIPE)
    said = process.communicate(timeout=WAIT_S)[1]
    assert process.returncode == 0, said.decode()
    assert b"\r" not in said
    assert not drawn(bar).search(said)


def drawn(bar: str) -> re.Pattern[bytes]:
    """A bar of this name: its name, and how many per cent are done."""
    return re.compile(re.escape(bar.encode()) + rb"\s+\d+%")
