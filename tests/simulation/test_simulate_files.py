"""What the files of `simulate` say of themselves."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from test_cli_simulate import MESH, SCENE

from warpsar import __version__
from warpsar.cli.main import main
from warpsar.io.images import read_channel


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "scene.obj").write_text(MESH)
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path / "scene.toml"


def simulate(scene: Path, *arguments: str | Path) -> Result:
    out = scene.parent / "out"
    return CliRunner().invoke(main, ["simulate", *map(str, (scene, "-o", out, "--device", "cpu", *arguments))])


def header(path: Path) -> dict[str, Any]:
    import OpenImageIO as oiio  # noqa: N813

    return {each.name: each.value for each in oiio.ImageInput.open(str(path)).spec().extra_attribs}


FACTS = {
    "azimuth_deg": 90.0,
    "incidence_deg": 50.0,
    "frequency_hz": 9.6e9,
    "spacing_m": [0.5, 0.5],
    "reference_point_m": [0.0, 0.0, 0.0],
    "range_axis": [-np.sin(np.deg2rad(50.0)), 0.0, -np.cos(np.deg2rad(50.0))],
    "azimuth_axis": [0.0, -1.0, 0.0],
    "elevation_axis": [np.cos(np.deg2rad(50.0)), 0.0, -np.sin(np.deg2rad(50.0))],
    "quantity": "beta0",
    "units": "1",
    "scale": "linear power",
    "polarization_basis": "radar",
    "software": f"warpsar {__version__}",
}


def check(found: dict[str, Any], rel: float) -> None:
    for name, value in FACTS.items():
        assert found[name] == (value if isinstance(value, str) else pytest.approx(value, rel=rel, abs=1e-7)), name
    assert "near range first" in found["axes"]
    assert "sigma0" in found["calibration"]
    assert "slant_range_m" not in found


def test_headers_and_json_carry_geometry_and_calibration(scene: Path) -> None:
    """East looks west at 40 degrees of depression; layers and speckled images say so as well."""
    assert simulate(scene, "--layers", "--looks", "2").exit_code == 0
    out = scene.parent / "out"
    for name in ("east.exr", "east_layers.exr", "east_looks2.exr"):
        found = header(out / name)
        check(found, 1e-6)
        assert found["polarizations"] == "HH, VV"
    assert header(out / "east_looks2.exr")["looks"] == 2
    assert "looks" not in header(out / "east.exr")
    view = json.loads((out / "simulate.json").read_text())["views"][1]
    check(view, 1e-12)
    assert view["polarizations"] == ["HH", "VV"]


def test_images_of_a_batch_have_headers_too(scene: Path) -> None:
    assert simulate(scene, "--azimuths", "90", "--incidences", "50").exit_code == 0
    check(header(scene.parent / "out" / "scene" / "000" / "az90_inc50.exr"), 1e-6)


def test_a_strip_map_says_its_range(scene: Path) -> None:
    scene.write_text(SCENE.replace("frequency_hz", "slant_range_m = 350.0\nfrequency_hz"))
    assert simulate(scene).exit_code == 0
    assert header(scene.parent / "out" / "east.exr")["slant_range_m"] == 350


@pytest.mark.full
@pytest.mark.parametrize("memory", [[], ["--max-memory", "0.00001"]])
def test_a_noise_floor_lights_nothing(memory: list[str], scene: Path) -> None:
    out = scene.parent / "out"
    scene.write_text(SCENE + "\n[effects.noise_floor]\nlevel = 0.001\n")
    assert simulate(scene, *memory).exit_code == 0
    said = [view["lit_fraction"] for view in json.loads((out / "simulate.json").read_text())["views"]]
    assert read_channel(out / "north.exr", "HH").min() > 0
    scene.write_text(SCENE)
    assert simulate(scene).exit_code == 0
    assert said == [(read_channel(out / f"{name}.exr", "HH") > 0).mean() for name in ("north", "east")]
    assert 0.3 < min(said) < 0.9


@pytest.mark.parametrize("out", ["file/out", "/proc/none/out"])
@pytest.mark.parametrize("command", ["simulate", "batch", "learn", "evaluate"])
def test_a_folder_that_cannot_be_written_is_named_as_such(command: str, out: str, scene: Path) -> None:
    (scene.parent / "file").write_text("")
    arguments = ["--azimuths", "0", "--incidences", "30"] if command == "batch" else []
    name = "simulate" if command == "batch" else command
    done = CliRunner().invoke(main, [name, str(scene), "-o", str(scene.parent / out), *arguments, "--device", "cpu"])
    assert done.exit_code == 2
    assert f"--out: found {scene.parent / out}; nothing can be written there" in done.output
