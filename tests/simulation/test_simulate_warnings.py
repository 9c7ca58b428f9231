"""What `simulate` says in time: domains, grids that miss, units, empty polarizations, and signs of life."""

import io
import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from test_cli_simulate import MESH, SCENE, warpsar
from worlds import ground, mesh_of, scene_of, view

from warpsar.cli.main import main
from warpsar.effects.registry import validate
from warpsar.errors import InputError
from warpsar.runtime import busy as busy_module
from warpsar.runtime import devices
from warpsar.runtime.busy import busy
from warpsar.runtime.devices import no_driver_warning, resolve_device
from warpsar.scene.scene import Scene
from warpsar.simulation.checks import Findings, grid_warnings
from warpsar.simulation.command import Simulation, simulate
from warpsar.simulation.outputs import refuse_unlikely_size
from warpsar.surface.stage import Stage

WALL = {"eps_r": 6.0, "rms_height_m": 0.001, "correlation_length_m": 0.01}
OPTICS = {"eps_r": 6.0, "rms_height_m": 0.02, "correlation_length_m": 0.2, "specular_fraction": 1.0}


def stage_of(scene: Scene) -> Stage:
    return Stage.of(scene, resolve_device("cpu"))


def found(**material: Any) -> list[str]:
    """Warnings of level ground of one material, at 9.6 GHz and 40 degrees."""
    soil = {"eps_r": 6.0, "rms_height_m": 0.0012, "correlation_length_m": 0.010, **material}
    scene = scene_of(mesh_of(soil=ground(30)), view(0, 40), rays_per_pixel=4.0, materials={"soil": soil})
    made = Simulation(scene, stage_of(scene))
    made.view(scene.views[0], 0)
    return made.findings.warnings(scene)


@pytest.mark.parametrize(("roof", "turned", "said"), [(True, 1, None), (True, -1, "6 of 12"), (False, 1, "6 of 10")])
def test_a_body_that_is_open_or_inside_out(roof: bool, turned: int, said: str | None) -> None:
    """Two walls and the roof are seen of a block. Without the roof the inside of the other two walls is seen, and
    a part of the floor."""
    block = trimesh.creation.box((4.0, 4.0, 4.0)).apply_translation((0.0, 0.0, 2.0))
    faces = block.faces[(block.triangles_center[:, 2] < 3.9) | roof]
    made = scene_of(
        mesh_of(soil=ground(30), block=(block.vertices, faces[:, ::turned])),
        view(20, 30),
        rays_per_pixel=4.0,
        materials=dict.fromkeys(("soil", "block"), WALL),
    )
    made = replace(made, effects={"multibounce": validate("multibounce", {"strength": 1.0}, "effects")})
    simulation = Simulation(made, stage_of(made))
    simulation.view(made.views[0], 0)
    found = [one for one in simulation.findings.warnings(made) if "look away" in one]
    assert [one.split(" faces")[0] for one in found] == ([] if said is None else [f"materials.block: {said}"])
    if said is None:  # a ray that slips through a seam sees the far side from inside
        rays = simulation.findings.rays
        rays[1, -1] = 0.0005 * rays[0, -len(faces) :].sum()
        assert not any("look away" in one for one in simulation.findings.warnings(made))


def test_a_surface_outside_its_models_domain() -> None:
    """h = 5 cm at X band once gave a beta0 of 73 without a word."""
    assert found() == []
    (said,) = found(rms_height_m=0.05)
    assert said.startswith("materials.soil: 100 % of its lit area lies outside the domain of small perturbation")
    assert "kh = 10.1, kl = 2.01" in said
    assert found(**OPTICS) == []
    (said,) = found(**{**OPTICS, "correlation_length_m": 0.01})
    assert "outside the domain of geometric optics" in said
    assert found(**{**OPTICS, "specular_fraction": 0.5}) == []  # its two domains cannot both hold
    (said,) = found(rms_height_m=0.003, specular_fraction=0.5)
    assert "outside the domain of both" in said


def test_domains_hold_at_the_incidences_seen() -> None:
    """kh cos(theta) > 1.58 fails where the ground is seen at grazing."""
    rough = {**OPTICS, "rms_height_m": 0.01, "correlation_length_m": 0.1}  # kh = 2.01: to 38 degrees

    def at(incidence: float) -> list[str]:
        scene = scene_of(mesh_of(soil=ground(30)), view(0, incidence), rays_per_pixel=4.0, materials={"soil": rough})
        made = Simulation(scene, stage_of(scene))
        made.view(scene.views[0], 0)
        return made.findings.warnings(scene)

    assert at(30.0) == []
    assert len(at(50.0)) == 1


def test_cross_polarization_of_level_ground() -> None:
    scene = scene_of(mesh_of(soil=ground(30)), view(0, 40), polarizations=("HH", "HV"), rays_per_pixel=4.0)
    made = Simulation(scene, stage_of(scene))
    made.view(scene.views[0], 0)
    (said,) = made.findings.warnings(scene)
    assert said.startswith("view view: HV is exactly 0 in 100 % of the lit pixels: level ground")
    wall = scene_of(mesh_of(soil=ground(30)), view(0, 40), polarizations=("HH",), rays_per_pixel=4.0)
    made = Simulation(wall, stage_of(wall))
    made.view(wall.views[0], 0)
    assert made.findings.warnings(wall) == []


@pytest.mark.parametrize(
    ("size", "reference", "expected"),
    [
        (30.0, (0.0, 0.0, 0.0), None),
        (8.0, (0.0, 0.0, 0.0), None),  # all of it, in the middle
        (400.0, (0.0, 0.0, 0.0), None),  # a part of it fills the image
        (30.0, (900.0, 0.0, 0.0), "misses the mesh, which lies at range 0"),
        (30.0, (24.0, 0.0, 0.0), "misses most of the mesh"),
        (30e3, (0.0, 0.0, 0.0), "is the mesh in metres"),
        (30e-3, (0.0, 0.0, 0.0), "is the mesh in metres"),
    ],
)
@pytest.mark.parametrize("slant_range_m", [None, 5e5])
def test_a_grid_that_does_not_fit_the_mesh(
    size: float, reference: tuple[float, float, float], expected: str | None, slant_range_m: float | None
) -> None:
    flat = scene_of(mesh_of(soil=ground(size)), view(0, 40), slant_range_m=slant_range_m)
    scene = replace(flat, reference_point_m=reference)
    said = grid_warnings(scene, stage_of(scene), scene.views)
    if expected is None:
        assert said == []
    else:
        (one,) = said
        assert one.startswith("view view: the image covers 20 x 20 m")
        assert expected.partition(" 0")[0] in one


def test_views_of_one_warning_are_named_together() -> None:
    views = [view(10.0 * i, 40, name=f"v{i}") for i in range(5)]
    scene = scene_of(mesh_of(soil=ground(30e3)), views)
    (said,) = grid_warnings(scene, stage_of(scene), scene.views)
    assert said.startswith("views v0, v1, v2 and 2 more: ")


def test_findings_of_several_processes_are_one() -> None:
    parts = [
        Findings(np.array([[2.0, 0.0, 2.0, 0.0]]), {"HV": {"a": 1.0}}),
        Findings(np.array([[2.0, 0.0, 0.0, 0.0]]), {"HV": {"b": 0.8}}),
        Findings(),
    ]
    scene = scene_of(mesh_of(soil=ground(30)), view(0, 40))
    domain, dark = Findings.together(parts).warnings(scene)
    assert "50 % of its lit area" in domain
    assert dark.startswith("views a, b: HV")


@pytest.mark.full
def test_warnings_stand_on_stderr_and_in_the_json(tmp_path: Path) -> None:
    (tmp_path / "scene.obj").write_text(MESH)
    (tmp_path / "scene.toml").write_text(SCENE.replace("0.0012", "0.05"))
    done = warpsar("simulate", tmp_path / "scene.toml", "-o", tmp_path / "out", "--device", "cpu")
    assert done.returncode == 0
    (said,) = json.loads((tmp_path / "out" / "simulate.json").read_text())["warnings"]
    assert said.startswith("materials.soil")
    assert f"warning: {said}\n" in done.stderr


MILLIMETRES = re.sub(r"^v (\S+) (\S+) (\S+)", r"v \g<1>e3 \g<2>e3 \g<3>e3", MESH, flags=re.MULTILINE)
"""The same mesh in millimetres: 24 km across, if they are read as metres."""
COLLECTION = '[collection]\nfocus = "direct"\nresolution_m = [1.0, 1.0]\n[materials.soil]'


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ([], "`warpsar new FOLDER scene.obj --units mm` writes a copy in metres, --yes takes it as it is"),
        (["--azimuths", "0:30:10", "--incidences", "40"], "1 failed; everything else is made"),
        (["--product", "slc"], "--yes takes it as it is"),
        (["--product", "phase-history"], "--yes takes it as it is"),
    ],
)
def test_a_mesh_of_unlikely_size_needs_a_yes(tmp_path: Path, more: list[str], words: str) -> None:
    """No work begins, and no folder is made for one scene."""
    (tmp_path / "scene.obj").write_text(MILLIMETRES)
    path, out = tmp_path / "scene.toml", tmp_path / "out"
    path.write_text(SCENE.replace("[materials.soil]", COLLECTION) if "--product" in more else SCENE)
    done = CliRunner().invoke(main, ["simulate", str(path), "-o", str(out), "--device", "cpu", *more])
    assert done.exit_code == 2, done.output
    assert "scene.obj: the mesh is 24000 m across, more than 5000 m: its unit is likely the millimetre" in done.stderr
    assert words in done.stderr
    assert not list(out.glob("**/*.exr")) if "--azimuths" in more else not out.exists()


@pytest.mark.full
@pytest.mark.parametrize("more", [["--yes"], ["--yes", "--azimuths", "0", "--incidences", "40"]])
def test_a_mesh_of_unlikely_size_with_a_yes(tmp_path: Path, more: list[str]) -> None:
    (tmp_path / "scene.obj").write_text(MILLIMETRES)
    (tmp_path / "scene.toml").write_text(SCENE)
    words = ["simulate", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out"), "--device", "cpu", *more]
    assert CliRunner().invoke(main, words).exit_code == 0
    assert list((tmp_path / "out").glob("**/*.exr"))


def test_a_place_of_the_earth_may_be_large(tmp_path: Path) -> None:
    """A scene that says where it lies, as those of `warpsar new` from buildings do, is taken as it is."""
    (tmp_path / "scene.obj").write_text(MILLIMETRES)
    place = "origin = { latitude_deg = 48.1, longitude_deg = 11.6, height_m = 500.0 }"
    (tmp_path / "scene.toml").write_text(SCENE.replace("[radar]", f"{place}\n[radar]"))
    scene = Scene.load(tmp_path / "scene.toml")
    assert any("24000 m across" in warning for warning in scene.warnings)
    refuse_unlikely_size(scene, yes=False)


def test_an_object_of_unlikely_size_needs_a_yes(tmp_path: Path) -> None:
    """Its table has the unit; the mesh of the scene is of a likely size."""
    (tmp_path / "scene.obj").write_text(MESH)
    (tmp_path / "body.obj").write_text(MILLIMETRES.replace("usemtl soil", "usemtl wall"))
    body = '[[objects]]\nname = "shed"\nmesh = "body.obj"\n'
    (tmp_path / "scene.toml").write_text(f"{SCENE}\n{body}")
    with pytest.raises(InputError, match=r'objects\[0\] \(shed\): .*24000 m across.* units = "m" may be wrong'):
        refuse_unlikely_size(Scene.load(tmp_path / "scene.toml"), yes=False)
    (tmp_path / "scene.toml").write_text(f'{SCENE}\n{body}units = "mm"\n')
    refuse_unlikely_size(Scene.load(tmp_path / "scene.toml"), yes=False)


@pytest.mark.full
def test_a_batch_says_them_once(tmp_path: Path) -> None:
    (tmp_path / "scene.obj").write_text(MESH)
    (tmp_path / "scene.toml").write_text(SCENE.replace("0.0012", "0.05"))
    angles = ("--azimuths", "0:30:10", "--incidences", "40")
    done = warpsar("simulate", tmp_path / "scene.toml", "-o", tmp_path / "out", "--device", "cpu", *angles)
    assert done.returncode == 0
    assert done.stderr.count("warning: ") == 1
    assert "materials.soil" in done.stderr


def test_from_python_they_stand_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    rough = {"eps_r": 6.0, "rms_height_m": 0.05, "correlation_length_m": 0.010}
    simulate(scene_of(mesh_of(soil=ground(30)), view(0, 40), materials={"soil": rough}), device="cpu")
    assert "warning: materials.soil: 100 %" in capsys.readouterr().err


def test_a_sign_of_life(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a terminal, and after a while; nothing elsewhere."""

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr(busy_module, "TICK_S", 0.05)
    for stream, expected in ((Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, "stderr", stream)
        with busy("writing north.exr"):
            time.sleep(0.3)
        assert ("writing north.exr [00:00]" in stream.getvalue()) == expected
    monkeypatch.setattr(sys, "stderr", stream := Terminal())
    with busy("short"):
        pass
    assert "short" not in stream.getvalue()


def test_a_terminal_sees_kernels_being_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which takes tens of seconds in the first run."""
    said: list[str] = []

    @contextmanager
    def noted(what: str) -> Iterator[Callable[[str], None]]:
        said.append(what)
        yield said.append

    monkeypatch.setattr(devices, "busy", noted)
    devices.load_kernels(devices.resolve_device("cpu"), "merge", "shade")
    what = "compiling kernels for cpu (first run only)"
    assert said == [what, f"{what}: 1 of 2", f"{what}: 2 of 2"]


def test_the_driver_warning_is_not_shown_and_all_else_is(capfd: pytest.CaptureFixture[str]) -> None:
    with no_driver_warning():
        os.write(2, b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver. GPU execution will not be.\n")
        os.write(2, b"Warp CUDA error: something else\n")
    assert capfd.readouterr().err == "Warp CUDA error: something else\n"
