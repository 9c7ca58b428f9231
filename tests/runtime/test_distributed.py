"""Several processes find what one finds, to the order of summation; one that dies costs time and nothing else."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from learning_scenes import bumpy, cube_scene, measured, starting, views_at
from test_diagnose import saved
from test_learned_table import GIVEN, bent, seeing, site
from test_resume import outcome, small_scene, written
from torchrun import ENVIRONMENT, finish, start, strike
from worlds import SOIL, scene_of

from warpsar.cli.main import main
from warpsar.effects import registry as effects
from warpsar.errors import InputError
from warpsar.io import checkpoint
from warpsar.io.images import read_image
from warpsar.runtime.distributed.processes import ALONE, deal, join
from warpsar.scene.scene import Scene
from warpsar.scene.unwrap import write_obj
from warpsar.surface.surface import KINDS
from warpsar.world.tables import Material, Sampling

# Long enough to be struck, with a checkpoint every five iterations.
ADAM = ["--rate", "0.001", "--iterations", "200", "--checkpoint-every", "5", "--tv", "rms_height_m=1"]
HERE = Path(__file__).resolve().parents[1]
needs_torch = pytest.mark.skipif(find_spec("torch") is None, reason="torch is not installed (extra `distributed`)")


def effects_scene(folder: Path) -> Path:
    """Numbers of the material and of effects: one that sums to zero over the views, one of all views, and blurs."""
    folder.mkdir()
    views = [*views_at((0.0, 40.0), (100.0, 50.0), (200.0, 45.0)), *views_at((300.0, 45.0), role="test")]
    views[3] = views[3].model_copy(update={"name": "test"})
    scene = scene_of(bumpy(), views, shape=(14, 18), spacing_m=(0.4, 0.4), polarizations=("HH", "VV"))
    seen = measured(replace(scene, mesh=replace(scene.mesh, vertex_scalars={})), folder)
    write_obj(folder / "mesh.obj", seen.mesh)
    tables = {
        "view_gain": {"gain_db": {"v0": 0.2, "v1": -0.1, "v2": 0.0}},
        # known about another value than the start's, so that the prior has a part in loss and gradient
        "range_loss": {"per_m": 0.01, "tolerance": {"per_m": {"about": 0.02, "sd": 0.01}}},
        "point_spread": {"range_fwhm_m": 0.5, "azimuth_fwhm_m": 0.5},
    }
    soil = Material(**dict(SOIL, rms_height_m=0.0010), tolerance={"eps_r": {"about": 5.0, "sd": 2.0}})
    changed = replace(seen, materials={"soil": soil}, effects=tables)
    replace(changed, mesh_path=(folder / "mesh.obj").resolve()).save(folder / "scene.toml")
    return folder / "scene.toml"


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of two scenes, and of what one process and two find in them."""
    folder = tmp_path_factory.mktemp("ranks")
    small_scene(folder / "texture", "adam")
    effects_scene(folder / "effects")
    for run in [start(size, HERE / "ranks_worker.py", folder, "texture", "effects") for size in (1, 2)]:
        finish(run)
    return folder


def found(work: Path, size: int) -> list[dict[str, Any]]:
    content: list[dict[str, Any]] = json.loads((work / f"found_{size}.json").read_text())
    return content


@pytest.mark.full
@needs_torch
def test_collectives(work: Path) -> None:
    first, second = (each["collectives"] for each in found(work, 2))
    for key in ("sum", "sum_on_device", "largest", "same", "gathered", "handed", "nothing"):
        assert first[key] == second[key], key  # to the bit
    terms = [np.random.default_rng(r).normal(size=4097) for r in (0, 1)]
    expected = (terms[0] + terms[1]) * 10.0 ** np.random.default_rng(9).integers(-8, 8, 4097)
    np.testing.assert_allclose(np.frombuffer(bytes.fromhex(first["sum"])), expected, rtol=1e-12)
    assert first["matrix"] == [[3.0, 3.0]] * 3
    assert first["largest"] == 1.0
    assert first["same"] == [0.0, 0.1]
    assert first["gathered"] == [{"rank": r, "text": "ä" * (10 * r), "number": 0.1 + r} for r in (0, 1)]
    assert first["collected"] == [
        [[0], "<f4", [[0.0, 0.0], [0.0, 0.0]]],
        [[0, 1], "<f4", [[1.0, 1.0], [1.0, 1.0]]],
    ]
    assert second["collected"] == []
    assert (first["handed"], first["nothing"]) == ([0.1, 0.0], None)
    assert sorted(first["numbers"] + second["numbers"]) == list(range(10))
    assert [each["refusal"] for each in (first, second)] == [
        "the last one does not want to True",
        "the last one does not want to False",
    ]


@needs_torch
def test_a_refusal_of_one_rank_is_one_of_all(work: Path) -> None:
    said = [each["refusal"] for each in found(work, 2)]
    assert sorted(each.partition(" ")[0] for each in said) == ["False", "True"]  # one of them speaks
    (message,) = {each.partition(" ")[2] for each in said}
    assert "views v1: no pixel of HH is lit by the model, unmasked and positive at once" in message


@needs_torch
@pytest.mark.parametrize("name", ["texture", "effects"])
def test_views_are_shared_and_sums_are_those_of_one(work: Path, name: str) -> None:
    (alone,) = (each[name]["kept"] for each in found(work, 1))
    together = [each[name]["kept"] for each in found(work, 2)]
    assert sorted(view for each in together for view in each["views"]) == alone["views"]
    assert all(each["views"] for each in together)
    for key in ("loss", "gradient", "value"):
        assert together[0][key] == together[1][key]  # the same on every rank, to the bit
    # each view is the same to the bit; what differs is the order in which float64 sums are taken
    np.testing.assert_allclose(together[0]["loss"], alone["loss"], rtol=1e-12)
    scale = np.abs(alone["gradient"]).max()
    np.testing.assert_allclose(together[0]["gradient"], alone["gradient"], rtol=1e-9, atol=1e-12 * scale)


@needs_torch
def test_views_traced_again_in_bands_over_ranks(work: Path) -> None:
    (kept,) = (each["effects"]["kept"] for each in found(work, 1))
    banded = [each["effects"]["banded"] for each in found(work, 2)]
    assert kept["keeps_hits"]
    assert not banded[0]["keeps_hits"]
    # a pixel's hits are added in the same order; gradients of float32 are added up in bands
    np.testing.assert_allclose(banded[0]["loss"], kept["loss"], rtol=1e-6)
    scale = np.abs(kept["gradient"]).max()
    np.testing.assert_allclose(banded[1]["gradient"], kept["gradient"], rtol=1e-4, atol=1e-6 * scale)


@needs_torch
@pytest.mark.parametrize("name", ["texture", "effects"])
def test_learn_on_two_ranks_is_learn_on_one(work: Path, name: str) -> None:
    alone, together = (json.loads((work / f"{name}_{size}" / "learn.json").read_text()) for size in (1, 2))
    assert (alone["processes"], together["processes"]) == (1, 2)
    for key in ("looks", "pixels", "options"):
        assert together[key] == alone[key]
    files = [sorted(path.name for path in (work / f"{name}_{size}").iterdir()) for size in (1, 2)]
    assert files[0] == files[1]
    if name == "texture":  # thirty steps of Adam, in float32
        assert together["iterations"] == alone["iterations"]
        for key in ("loss", "train", "test", "materials", "outside_domain", "fields"):
            assert_near(together[key], alone[key], 1e-5)
        return
    # Levenberg-Marquardt stops where a step promises less than 2e-3 in log-likelihood, a sixteenth of a standard
    # deviation: last bits decide at which iteration, and so where within it.
    assert together["loss"] == pytest.approx(alone["loss"], abs=5e-3)
    labels, sd = alone["identifiability"]["parameters"], alone["identifiability"]["standard_deviation"]
    both = zip(labels, sd, strict=True)
    for label, one in [pair for pair in both if pair[1] is not None and pair[1] < 1.0]:
        apart = coordinate(together, label) - coordinate(alone, label)
        assert abs(apart) < 0.1 * one, label
    assert_near(together["identifiability"]["standard_deviation"], sd, 0.02)


@pytest.mark.full
@needs_torch
def test_a_table_and_a_term_on_two_ranks_are_those_on_one(tmp_path: Path) -> None:
    """Each process sees one or two of the three views: the incidences seen, the term's units and all values are of all
    three. The values stop where a step promises less than 2e-3 in log-likelihood, a sixteenth of a standard
    deviation."""
    GIVEN.write(tmp_path / "given.csv")
    bent().write(tmp_path / "bent.csv")
    block = {**SOIL, "model": "i2em"}
    truth = site({"lawn": {"sigma0": tmp_path / "bent.csv"}, "block": block}, ("HH", "VV"))
    asked = {
        "lawn": Material(model="facet", sigma0=tmp_path / "given.csv", learn=("sigma0",)),
        "block": Material(**block, learn=("learned_term",)),
    }
    saved(seeing(replace(truth, materials=asked), truth, 0, tmp_path), tmp_path)
    outs = [tmp_path / str(size) for size in (1, 2)]
    words = ["-m", "warpsar", "learn", tmp_path / "scene.toml", "--starts", "1", "-o"]
    for run in [start(size, *words, out) for size, out in enumerate(outs, start=1)]:
        finish(run)
    assert [path.name for path in sorted(outs[0].iterdir())] == [path.name for path in sorted(outs[1].iterdir())]
    alone, together = (json.loads((out / "learn.json").read_text()) for out in outs)
    assert (alone["processes"], together["processes"]) == (1, 2)
    assert together["loss"] == pytest.approx(alone["loss"], abs=5e-3)
    lawns = [content["learned_tables"]["lawn"] for content in (alone, together)]
    assert lawns[1]["incidence_seen_deg"] == lawns[0]["incidence_seen_deg"]
    for channel in ("HH", "VV"):
        (one, own), sd = (np.array(lawn["learned_db"][channel]) for lawn in lawns), np.array(lawns[0]["sd_db"][channel])
        assert (np.abs(own - one) < 0.1 * sd).all()
        np.testing.assert_allclose(lawns[1]["sd_db"][channel], sd, rtol=0.02)
        assert np.abs(one - GIVEN.sigma0_db[channel]).max() > 1.0  # there is something to learn
    terms = [json.loads((out / "block_term.json").read_text()) for out in outs]
    assert terms[1]["places"] == terms[0]["places"]
    for channel, weights in terms[0]["weights"].items():
        np.testing.assert_allclose(terms[1]["weights"][channel], weights, atol=0.05)


@needs_torch
@pytest.mark.parametrize("command", ["evaluate", "simulate"])
def test_evaluate_and_simulate_on_two_ranks_are_those_on_one(work: Path, command: str) -> None:
    """To the bit: each view is one process's work."""
    alone, together = (work / f"{command}_{size}" for size in (1, 2))
    assert sorted(path.name for path in together.iterdir()) == sorted(path.name for path in alone.iterdir())
    one, other = (json.loads((folder / f"{command}.json").read_text()) for folder in (alone, together))
    assert (one.pop("processes"), other.pop("processes")) == (1, 2)
    assert one.pop("wall_time_s") > 0
    assert other.pop("wall_time_s") > 0
    assert other == one
    images = [path.name for path in alone.glob("*.exr")]
    assert images
    for name in images:
        np.testing.assert_array_equal(read_image(together / name), read_image(alone / name))


def shifted_scene(folder: Path) -> Path:
    """A cube on a plane whose images lie beside the model's by less than a pixel: several effects look alike."""
    folder.mkdir()
    views = [*views_at((15.0, 35.0), (135.0, 48.0), (250.0, 42.0)), *views_at((330.0, 40.0), role="test")]
    views[3] = views[3].model_copy(update={"name": "test"})
    shift = {"registration": {"range_m": 0.33, "azimuth_m": -0.41}}
    truth = replace(cube_scene(views, polarizations=("HH",), shape=32), effects=shift)
    scene = starting(replace(measured(replace(truth, sampling=Sampling(rays_per_pixel=256.0)), folder), effects={}))
    saved(replace(scene, sampling=Sampling(rays_per_pixel=64.0)), folder)
    return folder / "scene.toml"


@pytest.fixture(scope="module")
def shifted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return shifted_scene(tmp_path_factory.mktemp("diagnosed") / "shifted")


@pytest.mark.full
@needs_torch
def test_diagnose_on_two_ranks_is_diagnose_on_one(shifted: Path, tmp_path: Path) -> None:
    """To the bit: a fit, a fold, a batch of draws is one process's work, and what is shared is in the tasks' order."""
    options = ["--device", "cpu", "--draws", "400", "--starts", "1"]
    runs = [start(n, "-m", "warpsar", "diagnose", shifted, "-o", tmp_path / str(n), *options) for n in (1, 2)]
    alone, together = [finish(run) for run in runs]
    assert together[0] == alone[0]
    assert alone[0].startswith("registration; edges agree to ")
    said = [
        [line for line in stderr.splitlines() if re.search("2 ln L|left out|added", line)]
        for _, stderr in (alone, together)
    ]
    assert said[1] == said[0]  # by one of them
    one, other = (json.loads((tmp_path / str(n) / "diagnosis.json").read_text()) for n in (1, 2))
    assert (one.pop("processes"), other.pop("processes")) == (1, 2)
    assert one.pop("wall_time_s") > 0
    assert other.pop("wall_time_s") > 0
    assert other == one
    # what was shared: several candidates' fits, the views left out, and a second turn
    assert len(one["turns"]) == 2
    assert len(one["steps"][0]["refitted"]) > 1
    assert one["steps"][0]["left_out"]["passed"]
    for name in ("scene.toml", "report.html"):
        assert (tmp_path / "2" / name).exists()
    assert (tmp_path / "2" / "scene.toml").read_text() == (tmp_path / "1" / "scene.toml").read_text()


@pytest.mark.slow
@needs_torch
def test_a_diagnosis_goes_on_with_other_processes(
    shifted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interrupted after its first turn in one process, it goes on in two: the first reads the checkpoint for both."""
    options = ["--device", "cpu", "--draws", "400", "--starts", "0", "--most-effects", "1"]
    words = ["diagnose", str(shifted), "-o"]
    assert CliRunner().invoke(main, [*words, str(tmp_path / "whole"), *options]).exit_code == 0
    written: list[Path] = []

    def interrupted(folder: Path, *about: Any) -> None:
        write(folder, *about)
        written.append(folder)
        if len(written) == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        write = checkpoint.write
        patch.setattr(checkpoint, "write", interrupted)
        assert CliRunner().invoke(main, [*words, str(tmp_path / "parts"), *options]).exit_code == 130
    finish(start(2, "-m", "warpsar", *words, tmp_path / "parts", *options, "--resume"))
    whole, parts = (json.loads((tmp_path / name / "diagnosis.json").read_text()) for name in ("whole", "parts"))
    assert (whole.pop("processes"), parts.pop("processes")) == (1, 2)
    assert whole.pop("wall_time_s") > 0
    assert parts.pop("wall_time_s") > 0
    assert parts == whole
    assert not (tmp_path / "parts" / checkpoint.NAME).exists()


NOISY = """
import json, sys
from dataclasses import asdict
from pathlib import Path
import numpy as np
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.search.procedure import diagnose_scene
from warpsar.learning.view import FitView
from warpsar.runtime import devices
from warpsar.runtime.distributed.processes import join
from warpsar.scene.scene import Scene

device = devices.resolve_device("cpu")
ranks = join(device)
random, exact = np.random.default_rng(ranks.rank), FitView.modelled
FitView.modelled = lambda view: [mu * (1.0 + 1e-6 * random.normal(size=mu.shape)) for mu in exact(view)]
found = diagnose_scene(Scene.load(sys.argv[1]), device, DiagnoseOptions(draws=400, starts=1))
last = found.final
mine = {
    "pixel": float(last.problem.modelled(last.x)[0][0]),
    "verdict": found.verdict,
    "fits": [[fit.x.tolist(), fit.log_likelihood, fit.whole] for fit in (found.declared, last)],
    "effects": last.scene.effects,
    "turns": [
        [asdict(step.spot), step.threshold, step.p_scan, step.added, [repr(c) for c in step.candidates]]
        for step in found.turns
    ],
    "pixels": [seen.pixels.tolist() for seen in found.observations],
}
everything = ranks.gather(mine)
if ranks.first:
    Path(sys.argv[2]).write_text(json.dumps(everything))
"""


@pytest.mark.slow
@needs_torch
def test_ranks_that_see_other_last_bits_decide_alike(shifted: Path, tmp_path: Path) -> None:
    """Sums of a GPU's atomics differ from rank to rank; so do these images, by noise of each rank's own."""
    worker = tmp_path / "worker.py"
    worker.write_text(NOISY)
    finish(start(2, worker, shifted, tmp_path / "found.json"))
    first, second = json.loads((tmp_path / "found.json").read_text())
    assert second.pop("pixel") != first.pop("pixel")
    assert second == first
    assert first["verdict"] == ["registration"]


@pytest.mark.full
@needs_torch
def test_a_refusal_of_diagnose_is_said_once(work: Path, tmp_path: Path) -> None:
    scene = Scene.load(work / "texture" / "scene.toml")
    untrained = work / "texture" / "untrained.toml"
    replace(scene, views=[one.model_copy(update={"role": "test"}) for one in scene.views]).save(untrained)
    run = start(2, "-m", "warpsar", "diagnose", untrained, "-o", tmp_path, "--device", "cpu")
    _, stderr = finish(run, expected=1)  # torchrun's own
    assert len(re.findall("^Error: ", stderr, re.MULTILINE)) == 1
    assert stderr.count("views: none with role train has measured images") == 1
    assert re.search(r"Root Cause.*exitcode +: 2 ", stderr, re.DOTALL)
    assert not list(tmp_path.iterdir())


def coordinate(content: dict[str, Any], label: str) -> float:
    """An element of x, by its label, as learn.json has it."""
    name, _, key = label.partition(".")
    key, _, view = key.rstrip("]").partition("[")
    if name in content["materials"]:
        (kind,) = (kind for kind in KINDS if kind.key == key)
        return float(kind.to_coordinate(np.array(content["materials"][name][key]["value"])))
    value = content["effects"][name][key]
    return float(effects.get(name).parameter(key).to_coordinate(value[view] if view else value))


def assert_near(a: Any, b: Any, tolerance: float) -> None:
    if isinstance(b, dict):
        assert a.keys() == b.keys()
        for key in b:
            if key != "eigenvectors":  # of an arbitrary sign
                assert_near(a[key], b[key], tolerance)
    elif isinstance(b, list):
        assert len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            assert_near(one, other, tolerance)
    elif isinstance(b, float):
        assert a == pytest.approx(b, rel=tolerance, abs=1e-9)
    else:
        assert a == b


def struck(folder: Path, times: int, seed: int) -> None:
    """Kill one rank of a run of two `times` times; torchrun starts it again, and it ends where the undisturbed ends."""
    scene = small_scene(folder / "scene", "adam")
    options = ["--optimiser", "adam", *ADAM]
    command = ["-m", "warpsar", "learn", scene, "--device", "cpu", *options]
    finish(start(2, *command, "-o", folder / "whole"))
    out, random = folder / "struck", np.random.default_rng(seed)
    run = start(2, *command, "-o", out, restarts=times)
    for number in range(times):
        before = written(out / checkpoint.NAME)
        delay = random.uniform(0.0, 0.5 / times)
        strike(run, lambda before=before: written(out / checkpoint.NAME) != before, delay, number)
    finish(run)
    assert outcome(out) == outcome(folder / "whole")
    assert not (out / checkpoint.NAME).exists()


@pytest.mark.slow
@needs_torch
def test_learn_with_a_rank_killed(tmp_path: Path) -> None:
    struck(tmp_path, 1, seed=4)


@needs_torch
@pytest.mark.slow
def test_learn_with_a_rank_killed_twenty_times(tmp_path: Path) -> None:
    struck(tmp_path, 20, seed=5)


@pytest.mark.full
@needs_torch
def test_sigterm_writes_one_checkpoint(tmp_path: Path) -> None:
    """To torchrun, as a scheduler sends it; the run then goes on with one process."""
    scene = small_scene(tmp_path / "scene", "adam")
    out = tmp_path / "out"
    options = ["--device", "cpu", "--optimiser", "adam", *ADAM]
    run = start(2, "-m", "warpsar", "learn", scene, "-o", out, *options)
    while not (out / checkpoint.NAME).exists():
        assert run.poll() is None, run.communicate()
        time.sleep(0.005)
    run.send_signal(signal.SIGTERM)
    _, stderr = run.communicate(timeout=120)
    assert run.returncode != 0
    assert len(re.findall(r"Error: stopped by a signal at iteration \d+; go on with --resume", stderr)) == 1
    command = [sys.executable, "-m", "warpsar", "learn", scene, "-o", out, *options, "--resume"]
    alone = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert alone.returncode == 0, alone.stderr
    assert json.loads((out / "learn.json").read_text())["iterations"] == 200


@pytest.mark.full
@needs_torch
def test_slurm_script(tmp_path: Path) -> None:
    """Its own lines, with srun and scontrol that stand for two hosts, both this one, of a process each."""
    tools = tmp_path / "tools"
    tools.mkdir()
    (tools / "scontrol").write_text("#!/bin/sh\necho localhost\necho localhost\n")
    (tools / "srun").write_text('#!/bin/sh\n"$@" & first=$!\n"$@" & second=$!\nwait $first && wait $second\n')
    (tools / "torchrun").write_text(f'#!/bin/sh\nexec {sys.executable} -m torch.distributed.run "$@"\n')
    for tool in tools.iterdir():
        tool.chmod(0o755)
    scene = small_scene(tmp_path / "scene", "lm")
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    slurm = {"JOB_NODELIST": "a[1-2]", "NNODES": "2", "GPUS_ON_NODE": "1", "JOB_ID": "7", "RESTART_COUNT": "1"}
    environment = {**os.environ, **ENVIRONMENT, "PATH": f"{tools}:{os.environ['PATH']}", "WARPSAR_PORT": str(port)}
    environment |= {f"SLURM_{name}": value for name, value in slurm.items()}
    out = tmp_path / "out"
    done = subprocess.run(
        ["bash", HERE.parent / "examples" / "slurm.sh", "learn", scene, "-o", out, "--device", "cpu", "--starts", "1"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert "--resume: there is no checkpoint" in done.stderr  # as one put back into the queue
    assert json.loads((out / "learn.json").read_text())["processes"] == 2


def test_deal_is_longest_first() -> None:
    costs = [3.0, 9.0, 2.0, 8.0, 4.0, 7.0]
    hands = deal(costs, 2)
    assert hands == [[0, 1, 4], [2, 3, 5]]  # 9 + 4 + 3 = 16 and 8 + 7 + 2 = 17
    assert sorted(i for hand in deal(np.ones(10).tolist(), 4) for i in hand) == list(range(10))
    assert deal([], 2) == [[], []]
    assert deal([1.0], 3) == [[0], [], []]


@pytest.mark.full
def test_one_process_imports_no_torch() -> None:
    code = """
import sys

class NoTorch:
    def find_spec(self, name, path=None, target=None):
        assert name.partition(".")[0] != "torch", "torch is asked for"

sys.meta_path.insert(0, NoTorch())
import warpsar.diagnosis.command, warpsar.evaluation.command, warpsar.learning.command, warpsar.simulation.batch
from warpsar.runtime.distributed.processes import ALONE, join
assert join(None) is ALONE
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert ALONE.size == 1


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ({"WORLD_SIZE": "2"}, "RANK, LOCAL_RANK, MASTER_ADDR, MASTER_PORT is not set"),
        ({"WORLD_SIZE": "two"}, "found 'two'"),
        ({"WORLD_SIZE": "0"}, "found '0'"),
    ],
)
def test_half_an_environment_is_refused(
    environment: dict[str, str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("RANK", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("warpsar.runtime.distributed.processes._here", None)
    with pytest.raises(InputError, match=re.escape(message)):
        join(None)
