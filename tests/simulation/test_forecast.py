"""What is said before long work comes from a timed part of the work itself."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from effect_worlds import street, working
from worlds import BRICK, SOIL, box, ground, mesh_of, scene_of, view

from warpsar.effects.registry import validate
from warpsar.runtime.devices import resolve_device
from warpsar.runtime.forecast import duration
from warpsar.scene.scene import Scene
from warpsar.simulation import command
from warpsar.simulation import estimate as estimating
from warpsar.simulation.command import Simulation
from warpsar.simulation.files import Output
from warpsar.surface.stage import Stage

pytestmark = pytest.mark.unit


@dataclass
class Clock:
    """Time that passes only where work is done."""

    now: float = 0.0

    def work(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    found = Clock()
    monkeypatch.setattr(time, "perf_counter", lambda: found.now)
    return found


@pytest.mark.parametrize(("columns", "rays"), [(5, 100), (400, 2**16), (1650, 2**27)])
def test_all_that_is_done_counts(clock: Clock, columns: int, rays: int) -> None:
    """Each view takes 0.5 s whatever its size, 0.02 s a column, and 0.6 s for its picture; the first strip compiles."""
    calls: list[tuple[int, int]] = []

    def strip(first: int, width: int) -> int:
        assert 0 <= first <= first + width <= columns
        clock.work((0.0 if calls else 100.0) + 0.5 + 0.02 * width)
        calls.append((first, width))
        return 10 * width

    said = estimating.estimate([rays, rays], (200, columns), 1, strip, 2, lambda: clock.work(0.6))
    assert said is not None
    whole = 2 * (0.5 + 0.02 * columns + 0.6)
    assert said.seconds == pytest.approx(whole, rel=1e-9)
    assert (said.views, said.pixels, said.rays) == (2, 200 * columns, 2 * rays)
    sampled = sum(width for _, width in calls[1:])
    assert sampled <= max(0.15 * columns, 30)  # a short sample


def test_short_work_is_not_announced(clock: Clock) -> None:
    def strip(first: int, width: int) -> int:
        clock.work(0.001 + 0.0001 * width)
        return 1

    assert estimating.estimate([1000], (100, 100), 1, strip, 1, lambda: clock.work(0.3)) is None


def corner() -> Scene:
    """A block on a plane, at one side of the image."""
    mesh = mesh_of(soil=ground(60.0), brick=box((4.0, -2.5, 0.0), (9.0, 3.0, 3.0)))
    materials = {"soil": SOIL, "brick": BRICK}
    return scene_of(mesh, view(0.0, 42.0), shape=(48, 48), spacing_m=(0.75, 0.75), materials=materials)


def test_a_strip_is_a_part_of_the_image() -> None:
    """Columns of the view itself, with as many rays and the same surface; only their jitter differs."""
    scene = corner()
    whole = Simulation(scene, Stage.of(scene, resolve_device("cpu")))
    image = whole.view(scene.views[0], 0)
    (beta0,) = image.beta0.values()
    for first, columns in ((0, 8), (9, 5), (40, 8)):
        part = whole.strip(scene.views[0], first, columns)
        made = part.view(scene.views[0], 0)
        (strip,) = made.beta0.values()
        wanted = beta0[:, first : first + columns]
        assert strip.shape == wanted.shape
        # 64 rays a pixel leave a few per cent at the block's edges
        assert np.abs(strip - wanted).mean() < 0.1 * np.abs(wanted).mean()
        assert made.azimuth_m == pytest.approx(image.azimuth_m[first : first + columns])
        assert part.rays(scene.views[0]) * 48 == whole.rays(scene.views[0]) * columns


@pytest.mark.parametrize(("name", "table", "radar"), working(), ids=lambda each: str(each)[:20])
def test_a_strip_has_every_effect(name: str, table: dict[str, object], radar: dict[str, object]) -> None:
    """The sample does the real work, whatever the scene declares."""
    scene = street(**radar)
    scene.effects[name] = validate(name, table, f"effects.{name}")
    made = Simulation(scene, Stage.of(scene, resolve_device("cpu")))
    (image, *_) = made.strip(scene.views[0], 5, 2).view(scene.views[0], 0).beta0.values()
    assert image.shape == (16, 2)


def test_files_are_part_of_the_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files and pictures of the sample are made, elsewhere, and none is left."""
    scene = corner()
    made = Simulation(scene, Stage.of(scene, resolve_device("cpu")), layers=True)
    written: list[Path] = []
    real = Output.write

    def write(self: Output, *given: object) -> object:
        found = real(self, *given)  # type: ignore[arg-type]
        written.extend(self.out.iterdir())
        return found

    monkeypatch.setattr(Output, "write", write)
    monkeypatch.setattr(estimating, "LONG_S", 0.0)
    output = Output(tmp_path, 0, looks=4.0)
    said = command.expected(made, output, [0])
    assert said is not None
    assert said.pixels == 48 * 48
    assert {path.name.partition(".")[2] for path in written} >= {"exr"}
    assert not any(path.exists() for path in written)
    assert not list(tmp_path.iterdir())
    assert not output.looks_at


def test_durations_in_words() -> None:
    said = [duration(seconds) for seconds in (2.4, 119.0, 130.0, 7300.0)]
    assert said == ["2 s", "119 s", "2 min", "2 h"]
