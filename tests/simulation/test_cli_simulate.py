"""`warpsar simulate` as a program: exit status, streams, and whole files or none."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from warpsar import __version__
from warpsar.io.images import read_channel

MESH = """\
usemtl soil
v -12 -12 0\nv 12 -12 0\nv 12 12 0\nv -12 12 0\nf 1 2 3 4
usemtl wall
v -3 0 0\nv 3 0 0\nv 3 0 4\nv -3 0 4\nf 5 6 7 8
"""
SCENE = """\
[scene]
mesh = "scene.obj"
[radar]
frequency_hz = 9.6e9
polarizations = ["HH", "VV"]
[image]
shape = [24, 20]
spacing_m = [0.5, 0.5]
[sampling]
rays_per_pixel = 16.0
seed = 3
[materials.soil]
eps_r = 6.0
rms_height_m = 0.0012
correlation_length_m = 0.010
[materials.wall]
eps_r = 12.0
rms_height_m = 0.001
correlation_length_m = 0.008
[[views]]
name = "north"
azimuth_deg = 0.0
incidence_deg = 60.0
[[views]]
name = "east"
azimuth_deg = 90.0
depression_deg = 40.0
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "scene.obj").write_text(MESH)
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path / "scene.toml"


def warpsar(*arguments: str | Path, threads: str = "2", **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "warpsar", *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, "WARPSAR_THREADS": threads},
        timeout=300,
        check=False,
        **options,
    )


@pytest.mark.full
def test_files_streams_and_status(scene: Path) -> None:
    out = scene.parent / "deep" / "out"
    done = warpsar("simulate", scene, "-o", out, "--device", "cpu")
    assert (done.returncode, done.stdout) == (0, "")
    # the device in one line, what was written, and no progress bar where stderr is no terminal; on a machine that is
    # busy enough this takes two seconds, and the time is announced
    assert [line for line in done.stderr.splitlines() if " rays: about " not in line] == [
        "device: cpu (2 threads)",
        f"{out}:",
        "  quick look, dB: north.png, east.png",
        "  beta0: north.exr, east.exr",
        "  facts: simulate.json",
    ]
    assert sorted(path.name for path in out.iterdir()) == [
        "east.exr",
        "east.png",
        "north.exr",
        "north.png",
        "simulate.json",
    ]
    for name in ("north", "east"):
        for polarization in ("HH", "VV"):
            image = read_channel(out / f"{name}.exr", polarization)
            assert image.shape == (24, 20)
            assert image.max() > 0
        assert (out / f"{name}.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.full
def test_json(scene: Path) -> None:
    out = scene.parent / "out"
    assert warpsar("simulate", scene, "-o", out, "--device", "cpu").returncode == 0
    content = json.loads((out / "simulate.json").read_text())
    assert content["version"] == __version__
    assert content["device"].startswith("cpu")
    assert content["seed"] == 3
    assert content["wall_time_s"] > 0
    assert content["input"]["scene"] == "scene.toml"
    assert len(content["input"]["sha256"]) == 64
    assert content["rays_per_m2"] == 64
    assert content["materials"] == ["soil", "wall"]
    assert [view["name"] for view in content["views"]] == ["north", "east"]
    for view in content["views"]:
        image = read_channel(out / view["files"]["image"], "VV")
        assert view["mean_beta0"]["VV"] == pytest.approx(image.mean(dtype=float), rel=1e-6)
        assert view["lit_fraction"] == pytest.approx((image > 0).mean())
        assert view["rays"] > view["hits"] > 0


@pytest.mark.full
def test_seed_threads_and_memory(scene: Path) -> None:
    """The same seed makes the same files to the bit, with any number of threads and any memory; another does not."""
    images = {}
    for name, arguments, threads in (
        ("plain", [], "2"),
        ("one thread", ["--max-memory", "0.00001"], "1"),
        ("other", ["--seed", "4"], "2"),
    ):
        out = scene.parent / name
        assert warpsar("simulate", scene, "-o", out, "--device", "cpu", *arguments, threads=threads).returncode == 0
        images[name] = read_channel(out / "north.exr", "HH")
        assert json.loads((out / "simulate.json").read_text())["seed"] == (4 if name == "other" else 3)
    np.testing.assert_array_equal(images["one thread"], images["plain"])
    assert (images["other"] != images["plain"]).any()


@pytest.mark.full
def test_layers_variance_and_per_ray(scene: Path) -> None:
    out = scene.parent / "out"
    done = warpsar("simulate", scene, "-o", out, "--device", "cpu", "--layers", "--variance", "--per-ray")
    assert done.returncode == 0
    layers = {
        name: read_channel(out / "north_layers.exr", name)
        for name in ("incidence_deg", "layover", "shadow", "material", "sampling_variance_HH", "sampling_variance_VV")
    }
    image = read_channel(out / "north.exr", "HH")
    assert set(np.unique(layers["material"])) == {-1, 0, 1}
    assert set(np.unique(layers["shadow"])) == {0, 1}
    np.testing.assert_array_equal(np.isnan(layers["incidence_deg"]), image == 0)
    assert layers["layover"].max() >= 2
    assert (layers["sampling_variance_HH"] >= 0).all()
    views = json.loads((out / "simulate.json").read_text())["views"]
    assert views[0]["files"]["layers"] == "north_layers.exr"


@pytest.mark.full
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("eps_r = 6.0", "eps_r = 0.5"), "materials.soil.eps_r: found 0.5; must be"),
        (("scene.obj", "other.obj"), "other.obj: no such mesh file"),
        (("[materials.wall]", "[materials.brick]"), "materials: found soil, brick; must be those of the mesh"),
        (("azimuth_deg = 0.0", "azimuth_degree = 0.0"), "unknown key"),
        (("[scene]", "[scene"), "not valid TOML"),
        (("polarizations = ", "slant_range_m = 3.0\npolarizations = "), "slant_range_m: found 3"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_bad_input_is_exit_2(change: tuple[str, str], message: str, scene: Path) -> None:
    """One message, nothing on stdout, no file."""
    scene.write_text(SCENE.replace(*change))
    out = scene.parent / "out"
    done = warpsar("simulate", scene, "-o", out, "--device", "cpu")
    assert (done.returncode, done.stdout) == (2, "")
    assert message in done.stderr
    assert done.stderr.count("Error: ") == 1
    assert "Traceback" not in done.stderr
    assert not out.exists() or not list(out.iterdir())


@pytest.mark.full
def test_missing_device_is_exit_3(scene: Path) -> None:
    done = warpsar("simulate", scene, "-o", scene.parent / "out", "--device", "cuda:99")
    assert (done.returncode, done.stdout) == (3, "")
    message = done.stderr
    assert message.startswith("Error: --device cuda:99: there is no such device here; there is cpu")
    assert message.count("\n") == 1
    assert not (scene.parent / "out").exists()


@pytest.mark.full
def test_an_output_folder_that_cannot_be_made_is_exit_2(scene: Path) -> None:
    (scene.parent / "file").write_text("")
    done = warpsar("simulate", scene, "-o", scene.parent / "file" / "out", "--device", "cpu")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("Error: ")
    assert "Traceback" not in done.stderr


@pytest.mark.full
@pytest.mark.usefixtures("listening")
def test_an_older_result_stays_whole_when_the_next_run_is_stopped(scene: Path) -> None:
    """Interrupted while it works: exit 130, one message, and what lies in the folder is the old result or nothing."""
    out = scene.parent / "out"
    assert warpsar("simulate", scene, "-o", out, "--device", "cpu").returncode == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    scene.write_text(SCENE.replace("rays_per_pixel = 16.0", "rays_per_pixel = 1e7"))
    process = subprocess.Popen(
        [sys.executable, "-m", "warpsar", "simulate", str(scene), "-o", str(out), "--device", "cpu"],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    try:
        while not (line := process.stderr.readline()).startswith("device: cpu"):
            assert not line
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        _, message = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 130
    assert message.count("Error: interrupted") == 1
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


@pytest.mark.full
def test_a_view_in_which_nothing_lies(scene: Path) -> None:
    """A black image is a result, not a failure."""
    moved = "reference_point_m = [900.0, 0.0, 0.0]"
    scene.write_text(SCENE.replace('mesh = "scene.obj"', f'mesh = "scene.obj"\n{moved}'))
    out = scene.parent / "out"
    done = warpsar("simulate", scene, "-o", out, "--device", "cpu", "--layers")
    assert done.returncode == 0, done.stderr
    assert not read_channel(out / "north.exr", "HH").any()
    assert json.loads((out / "simulate.json").read_text())["views"][0]["lit_fraction"] == 0
