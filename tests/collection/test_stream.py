"""Products with phase: what is said before the work, and the memory that the work is held to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from collected_scenes import field, scene, square_trihedral

import warpsar
from warpsar.cli.main import main
from warpsar.collection import forecast as forecasting
from warpsar.collection.bodies import Bodies
from warpsar.collection.command import wide_tubes
from warpsar.collection.direct import direct
from warpsar.collection.forecast import FEWEST, forecast, together
from warpsar.collection.history import phase_history
from warpsar.collection.places import COARSE, GROUP, TubeTally
from warpsar.collection.plan import plan_of
from warpsar.collection.scatterers import TOGETHER, Stream
from warpsar.runtime import devices

ALL = {"terms": ("single", "multibounce", "edges", "rough"), "max_bounces": 3}


def corner() -> warpsar.Scene:
    """Three rough squares, whose coherent part the tubes follow over up to three bounces."""
    return scene(square_trihedral(1.2), radar=ALL, shape=(24, 24), collection={"focus": "direct"})


def stream(made: warpsar.Scene, most: int, *, once: bool = False) -> Stream:
    cpu = devices.resolve_device("cpu")
    (plan,) = (plan_of(made, view, cpu) for view in made.views)
    return Stream(made, plan, Bodies(made, [plan], cpu, 0).of(plan), once=once, together=most)


@pytest.mark.full
def test_parts_change_nothing() -> None:
    """Scatterers in many small parts make the image and the phase history that they make together."""
    made, cpu = corner(), devices.resolve_device("cpu")
    images, samples = [], []
    for most in (TOGETHER, 8192):
        found = stream(made, most, once=True)
        images.append(direct(found.plan, found, ("HH",), made.grid, cpu).images["HH"])
        found = stream(made, most)
        samples.append(phase_history(found.plan, found, ("HH",), cpu).samples)
    for one, other in (images, samples):
        # Sums of 1e6 scatterers in float32, most of which cancel: up to 1e-3 off a sum in float64 when they are added
        # at once, and 3e-5 in parts. A part that is lost is 5e-3 and more.
        assert np.abs(one - other).max() < 3e-3 * np.abs(one).max()
        assert np.abs(one).max() > 0.0


def test_parts_are_as_small_as_asked() -> None:
    """Of tubes a part may be larger by what one launch of them hits."""
    found = stream(corner(), 8192)
    sizes = [len(part) for part in found.parts]
    launch = GROUP * COARSE**2 * found.worker.tracer.bounces
    assert max(sizes) <= 8192 + launch
    assert len(sizes) > 3
    assert sum(sizes) == found.count


def test_the_scatterers_of_a_forecast(monkeypatch: pytest.MonkeyPatch) -> None:
    """A forecast counts the scatterers that the work then finds. Its time is in docs/benchmarks.md."""
    monkeypatch.setattr(forecasting, "LONG_S", 0.0)
    made, cpu = corner(), devices.resolve_device("cpu")
    plans = [plan_of(made, view, cpu) for view in made.views]
    for product, once in (("slc", True), ("phase-history", False)):
        bodies = Bodies(made, plans, cpu, 0)
        said = forecast(bodies, plans, product)
        assert said is not None
        found = Stream(made, plans[0], bodies.of(plans[0]), once=once)
        count = sum(len(part) for part in found.parts)
        # tubes of a share of the cells that matter, seen from one place of the track
        assert said.scatterers == pytest.approx(count, rel=0.25)
        assert f"1 view, {said.scatterers:.2g} scatterers: about " in str(said)


def test_memory_is_bounded_or_refused() -> None:
    made, cpu = corner(), devices.resolve_device("cpu")
    plans = [plan_of(made, view, cpu) for view in made.views]
    most = [together(made, plans, "slc", cpu, gib) for gib in (0.2, 0.3, 4.0)]
    assert FEWEST <= most[0] < most[1] < most[2] == TOGETHER
    with pytest.raises(warpsar.InputError, match=r"slc: found .* GiB .*--max-memory allows 0.001 GiB"):
        together(made, plans, "slc", cpu, 0.001)


@pytest.mark.parametrize("product", ["slc", "phase-history"])
def test_on_the_console(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, product: str) -> None:
    """The forecast stands before the files; what does not fit is refused before anything is written."""
    monkeypatch.setattr(forecasting, "LONG_S", 0.0)
    made = scene(field(6.0, 6.0), collection={"resolution_m": (1.0, 1.0)}, shape=(16, 16), spacing=(0.5, 0.5))
    made.save(tmp_path / "scene.toml")
    words = ["simulate", str(tmp_path / "scene.toml"), "--product", product, "--device", "cpu", "-o"]
    done = CliRunner().invoke(main, [*words, str(tmp_path / "refused"), "--max-memory", "0.0001"])
    assert done.exit_code == 2
    assert not (tmp_path / "refused").exists()
    done = CliRunner().invoke(main, [*words, str(tmp_path / "out"), "--max-memory", "0.5"])
    assert done.exit_code == 0, done.output
    assert done.stderr.index(" scatterers: about ") < done.stderr.index("one.npz")


def test_wide_tubes_in_words() -> None:
    """What counts is their power: many that send nothing back change no level."""
    assert wide_tubes(TubeTally(100, 28, 1.0, 0.005)) == []
    (said,) = wide_tubes(TubeTally(50, 14, 0.5, 0.1) + TubeTally(50, 14, 0.5, 0.1))
    assert said.startswith("28 % of the tubes")
    assert "20 % of the power of single and multibounce, which is 0.97 dB lower without them" in said
    assert "too strong toward the mirror direction" in said


def test_wide_tubes_of_a_sphere() -> None:
    """A sphere spreads every tube far from its middle; a plate none."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    smooth = {"material": {"conductor": True}, "radar": {"terms": ("single",)}, "collection": {"focus": "direct"}}
    found = stream(scene(warpsar.Mesh.of(ball.vertices, ball.faces), **smooth), TOGETHER, once=True)
    list(found.parts)
    assert found.tally.tubes > 0
    assert 0 <= found.tally.wide_power <= found.tally.power
    plate = stream(scene(field(1.0, 1.0), **smooth), TOGETHER, once=True)
    list(plate.parts)
    assert plate.tally.wide == 0
