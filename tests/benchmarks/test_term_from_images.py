"""The learned term of a material trained through the renderer, from images, by `warpsar learn`."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from worlds import WAVENUMBER, ground, mesh_of, scene_of, view

from warpsar import InputError, Material, Scene, learn, renderer, simulate
from warpsar.cli.main import main
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.world import scattering_term
from warpsar.world.scattering_term import ScatteringTerm

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
from references import DATA, changed, clean_images, measured

pytestmark = pytest.mark.unit

SOIL = {"eps_r": 9.0, "rms_height_m": 0.003, "correlation_length_m": 0.03, "spectrum": "exponential"}


def lawn(polarizations: tuple[str, ...] = ("HH", "VV"), **more: Any) -> Scene:
    return scene_of(
        mesh_of(lawn=ground(12.0)),
        [view(120 * k, incidence, name=f"v{k}") for k, incidence in enumerate((30, 40, 50))],
        shape=(20, 22),
        spacing_m=(0.7, 0.6),
        polarizations=polarizations,
        materials={"lawn": {**SOIL, **more}},
    )


def with_images(scene: Scene, truth: Scene) -> Scene:
    images = {one.name: one.beta0 for one in simulate(truth, device="cpu")}
    seen = [one.model_copy(update={"images": images[one.name], "looks": 100.0}) for one in scene.views]
    return replace(scene, views=seen)


def test_the_loss_has_the_derivatives_of_differences_to_the_weights(tmp_path: Path) -> None:
    """Warp's adjoint through the images, for HV that two channels share too."""
    random = np.random.default_rng(0)
    here = [np.log(WAVENUMBER * 0.003), np.log(WAVENUMBER * 0.03), np.log(8.0)]
    places = np.column_stack([[0.55, 0.65, 0.75, 0.85], np.tile(here, (4, 1))])
    weights = {name: random.normal(0, 0.1, 4) for name in ("HH", "VV", "HV")}
    ScatteringTerm("i2em", places, np.array([0.1, 1, 1, 1]), weights, 3.0, 0.25).save(tmp_path / "term.json")
    scene = lawn(("HH", "VV", "HV"), model="i2em", learned_term=tmp_path / "term.json", learn=())
    problem = FitProblem(with_images(scene, lawn(("HH", "VV", "HV"), model="i2em")), devices.resolve_device("cpu"))
    terms = problem.stage.terms
    assert terms is not None
    terms.weights.requires_grad = True
    base, slope = terms.weights.numpy().copy(), 0.0
    problem.loss_at(problem.x0)
    for one in problem.views:
        one.forward(gradient=True)
        one.backward()
        slope = slope + terms.weights.grad.numpy()
    direction = random.normal(size=base.shape).astype(np.float32)

    def at(step: float) -> float:
        terms.weights.assign(base + step * direction)
        return problem.loss_at(problem.x0)

    expected = (8 * (at(0.02) - at(-0.02)) - (at(0.04) - at(-0.04))) / 0.24
    assert float((slope * direction).sum()) == pytest.approx(expected, rel=1e-3)  # float32 images


@pytest.mark.full
def test_images_teach_what_the_model_lacks(tmp_path: Path) -> None:
    """Images of a table over incidence without speckle: the term is the table over the model, where it was seen."""
    (tmp_path / "lawn.csv").write_text("incidence_deg,HH,VV\n10,-6,-5\n30,-9,-11\n50,-16,-13\n70,-17,-16\n")
    truth = lawn(model="facet", sigma0=tmp_path / "lawn.csv")
    truth = replace(truth, materials={"lawn": Material(model="facet", sigma0=tmp_path / "lawn.csv")})
    begun = with_images(lawn(learn=("learned_term",)), truth)
    found = learn(begun, device="cpu", folder=tmp_path / "out")
    assert found.stopped == "plateau"
    assert found.terms["lawn"].before["deviance"] > 10 * found.train["deviance"]
    assert found.train["rmse_db"] < 0.3
    material = found.scene.materials["lawn"]
    assert material.learned_term == (tmp_path / "out" / "lawn_term.json").resolve()
    assert material.learn == ("learned_term",)
    assert material.rms_height_m == 0.003  # held
    with pytest.raises(InputError, match="needs a folder"):
        learn(begun, device="cpu")


@pytest.mark.parametrize("learn_keys", [["learned_term", "eps_r"], ["learned_term", "rms_height_m"]])
def test_a_term_is_learned_alone(learn_keys: list[str]) -> None:
    with pytest.raises((InputError, ValueError), match="learned_term is learned alone"):
        lawn(learn=learn_keys)
    with pytest.raises((InputError, ValueError), match="learned_term is learned alone"):
        Material(model="facet", sigma0=Path("lawn.csv"), learn=("learned_term",))


@pytest.mark.slow
def test_the_command_leaves_no_more_than_speckle_of_another_models_images(tmp_path: Path) -> None:
    """`warpsar learn` of i2em images, kh 0.6, where the scene has ka_spm with h, l and eps as they are and a term.

    The images are down to their speckle. The term is what lies between the two models on level ground, to 0.35 dB:
    this ground is rolling, so facets are turned about the line of sight, and their HH holds some VV.
    """
    given = Scene.load(DATA / "in_domain" / "spm.toml")
    truth, declared = (
        replace(given, materials={"soil": Material(**SOIL, model=model)}) for model in ("i2em", "ka_spm")
    )
    scene = measured(declared, clean_images(truth), tmp_path, 16.0, 0)
    changed(scene, "soil", learn=("learned_term",)).save(tmp_path / "scene.toml")
    done = CliRunner().invoke(
        main, ["learn", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out"), "--device", "cpu"]
    )
    assert done.exit_code == 0, done.output
    content = json.loads((tmp_path / "out" / "learn.json").read_text())
    assert content["learned_terms"]["soil"]["before"]["deviance"] > 3
    assert content["verdict"]["train"]["finding"] == "speckle"
    assert 'learned_term = "soil_term.json"' in (tmp_path / "out" / "scene.toml").read_text()
    term = scattering_term.read(tmp_path / "out" / "soil_term.json")
    cosines = np.cos(np.radians([30.0, 40.0, 50.0]))
    at = np.column_stack([cosines, np.tile(term.places[0, 1:], (3, 1))])
    for channel in ("HH", "VV"):
        expected = [between(channel, angle) for angle in (30.0, 40.0, 50.0)]
        np.testing.assert_allclose(term.db(channel, at), expected, atol=0.35)
    assert (out := tmp_path / "out" / "report.html").is_file()
    assert out.stat().st_size > 10000


def between(channel: str, incidence_deg: float) -> float:
    """i2em over ka_spm at one incidence [dB], from level ground rendered with each."""
    images = []
    for model in ("i2em", "ka_spm"):
        level = replace(lawn((channel,), model=model), views=[view(30, incidence_deg)])
        images.append(renderer(level, device="cpu")()["view"][channel][8:12, 8:14])
    return float(10 * np.log10(images[0] / images[1]).mean())
