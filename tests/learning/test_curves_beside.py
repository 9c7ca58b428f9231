"""Curves of RCS and images in one fit: what only both determine, and derivatives."""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from worlds import FREQUENCY_HZ, SOIL, ground, mesh_of, scene_of, view

import warpsar
from warpsar import Scene, simulate
from warpsar.cli.main import main
from warpsar.diagnosis.result import diagnose
from warpsar.errors import InputError
from warpsar.io.images import write_exr
from warpsar.learning.curves import curves_beside
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.world.curve import Curve

PLATE = "usemtl g\nv 0 -.15 -.1\nv 0 .15 -.1\nv 0 .15 .1\nv 0 -.15 .1\nf 1 2 3\nf 1 3 4\n"
START = {"eps_r": 9.0, "rms_height_m": 0.0010, "learn": ("eps_r", "rms_height_m")}
LOOKS = 16.0
PHI = np.arange(0.0, 60.0)


def both(folder: Path) -> Scene:
    """Ground of a soil, in images of one polarization, and a plate of it, in a curve; eps_r and h start wrong."""
    (folder / "plate.obj").write_text(PLATE)
    truth = scene_of(
        mesh_of(g=ground(14.4)),
        [view(100 * k, incidence, name=f"v{k}") for k, incidence in enumerate((40, 40))],
        shape=(24, 24),
        spacing_m=(0.6, 0.6),
        polarizations=("HH",),
        rays_per_pixel=32.0,
        materials={"g": SOIL},
    )
    truth = replace(truth, radar=truth.radar.model_copy(update={"terms": ("single",)}))
    plate = replace(truth, mesh=warpsar.Scene.load(_plate_file(folder)).mesh)
    random = np.random.default_rng(3)
    field = np.sqrt(4 * np.pi) * warpsar.rcs(plate, 90.0 - PHI, 90.0, [FREQUENCY_HZ]).amplitude_m[:, 0, 0, 0]
    noise = 3e-3 * np.abs(field).max() / np.sqrt(2) * (random.normal(size=60) + 1j * random.normal(size=60))
    rows = zip(PHI, 10 * np.log10(np.abs(field + noise) ** 2), strict=True)
    lines = [f"{FREQUENCY_HZ},90,{a},{v}" for a, v in rows]
    (folder / "plate.csv").write_text("\n".join(["frequency_hz,theta_deg,phi_deg,rcs_dbsm", *lines]))
    curve = Curve(file=folder / "plate.csv", polarization="HH", role="train", mesh=folder / "plate.obj")
    views = []
    for one, clean in zip(truth.views, simulate(truth, device="cpu"), strict=True):
        image = clean.beta0["HH"] * random.gamma(LOOKS, 1 / LOOKS, clean.beta0["HH"].shape)
        write_exr(folder / f"{one.name}.exr", {"HH": image.astype(np.float32)})
        views.append(one.model_copy(update={"images": {"HH": folder / f"{one.name}.exr"}, "looks": LOOKS}))
    soil = truth.materials["g"].model_copy(update=START)
    return replace(truth, views=views, materials={"g": soil}, curves=(curve,))


def _plate_file(folder: Path) -> Path:
    (folder / "plate.toml").write_text(
        '[scene]\nmesh = "plate.obj"\n[radar]\nfrequency_hz = 9.6e9\npolarizations = ["HH"]\n'
        "[image]\nshape = [4, 4]\nspacing_m = [1.0, 1.0]\n"
        "[materials.g]\neps_r = 6.0\nrms_height_m = 0.0012\ncorrelation_length_m = 0.01\n"
        '[[views]]\nname = "one"\nazimuth_deg = 0.0\nincidence_deg = 45.0\n'
    )
    return folder / "plate.toml"


def saved(folder: Path, scene: Scene) -> Path:
    scene.save(folder / "scene.toml")
    return folder / "scene.toml"


def run(command: str, path: Path, out: Path, *further: str) -> Any:
    return CliRunner().invoke(main, [command, str(path), "-o", str(out), "--device", "cpu", *further])


def test_what_curves_say_of_x_has_the_derivatives_of_their_likelihood(tmp_path: Path) -> None:
    scene, cpu = both(tmp_path), devices.resolve_device("cpu")
    alone, together = FitProblem(scene, cpu), FitProblem(scene, cpu, beside=curves_beside(scene, None, "cpu"))
    x = together.x0 + np.array([0.1, -0.05])
    (loss, slope), (whole, gradient) = alone.gradient(x), together.gradient(x)
    assert whole != loss
    for k in range(2):
        ends = [together.prior.value(x + step * np.eye(2)[k]) for step in (0.03, -0.03)]
        assert (gradient - slope)[k] == pytest.approx((ends[0] - ends[1]) / 0.06, rel=0.02, abs=0.02)
    # the curve tells one number: eps_r, less the little that h dims a mirror by
    information = together.prior.information(x)
    least, most = np.linalg.eigvalsh(information)
    assert 0.0 <= least < 0.02 * most
    assert information[0, 0] > 5.0 * information[1, 1] > 0.0


@pytest.mark.full
def test_a_material_that_only_images_and_curves_together_determine(tmp_path: Path) -> None:
    """Images of one polarization and incidence tell a product of eps_r and h; a plate's level tells eps_r."""
    scene = both(tmp_path)
    found = {}
    for name, one in {"both": scene, "images": replace(scene, curves=())}.items():
        folder = tmp_path / name
        folder.mkdir()
        done = run("learn", saved(folder, one), folder / "out")
        assert done.exit_code == 0, done.output
        found[name] = json.loads((folder / "out" / "learn.json").read_text())
    assert found["images"]["identifiability"]["identifiable"] == [False, False]
    assert found["both"]["identifiability"]["identifiable"] == [True, True]
    told = found["both"]["materials"]["g"]
    for key in ("eps_r", "rms_height_m"):
        low, high = told[key]["interval_95"]
        assert low < SOIL[key] < high
        assert told[key]["value"] == pytest.approx(SOIL[key], rel=0.1)
    # each observation has its own comparison
    (curve,), noise = (found["both"]["curves"][key] for key in ("curves", "noise"))
    assert noise["HH"]["error_db"] < 0.3 * found["both"]["curves"]["before"]["noise"]["HH"]["error_db"]
    assert found["both"]["curves"]["curves_verdict"]["train"]["findings"] == []
    assert found["both"]["train"]["deviance"] == pytest.approx(1.0, abs=0.1)
    done = run("evaluate", tmp_path / "both" / "out" / "scene.toml", tmp_path / "evaluated")
    assert done.exit_code == 0, done.output
    told = json.loads((tmp_path / "evaluated" / "evaluate.json").read_text())
    assert told["curves"][0]["error_db"]["model"] == pytest.approx(curve["error_db"]["model"], rel=1e-3)
    assert told["train"]["deviance"] == pytest.approx(found["both"]["train"]["deviance"], rel=1e-3)
    # the pages say what the numbers say: the curve, before and after, and what both observations determine
    page = (tmp_path / "both" / "out" / "report.html").read_text()
    for words in ("its images and curves", "1 curve and 2 images", "Measured and modelled curves"):
        assert words in page
    drawn = re.search(r'base64,([^"]*)" alt="plate 9.6 GHz HH, train"', page)
    assert drawn is not None
    for line in (b"measured", b"before", b"model"):
        assert b"<!-- " + line + b" -->" in base64.b64decode(drawn.group(1))
    assert "Every value that is learned is determined by itself." in page
    low, high = found["both"]["materials"]["g"]["eps_r"]["interval_95"]
    assert f"({low:.3g} to {high:.3g})" in page
    assert (
        "Every value that is learned is determined by itself." in (tmp_path / "evaluated" / "report.html").read_text()
    )
    assert "alone not identifiable" in (tmp_path / "images" / "out" / "report.html").read_text()


@pytest.mark.parametrize("further", [[], ["--folds", "2"]])
def test_diagnose_refuses_both(further: list[str], tmp_path: Path) -> None:
    done = run("diagnose", saved(tmp_path, both(tmp_path)), tmp_path / "out", *further)
    assert done.exit_code == 2
    assert "found curves and images; diagnose must have one of them" in done.output
    with pytest.raises(InputError, match="found curves and images"):
        diagnose(both(tmp_path), device="cpu")


def test_a_geometry_beside_curves_is_refused(tmp_path: Path) -> None:
    scene = both(tmp_path)
    first = scene.views[0].model_copy(update={"learn": ("azimuth_deg",)})
    done = run("learn", saved(tmp_path, replace(scene, views=[first, scene.views[1]])), tmp_path / "out")
    assert done.exit_code == 2
    assert "beside curves only surfaces and effects can be learned" in done.output
