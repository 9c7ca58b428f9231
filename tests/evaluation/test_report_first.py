"""The first screen of diagnose's report: its sentence, its picture and what it sends the reader to do."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from comparisons import comparison

from warpsar.diagnosis.report.first import telling, verdict_sentence
from warpsar.diagnosis.report.next_step import next_steps
from warpsar.diagnosis.result import Diagnosed
from warpsar.evaluation.report_parts import averaged_ratio_db
from warpsar.io import html, html_image

pytestmark = pytest.mark.unit

OUT = Path("a folder")


def diagnosed(verdict: list[str] | None = None, **unlike: Any) -> Diagnosed:
    """As a diagnosis of two images that found `verdict` ends; `findings` are those of the test views."""
    names = verdict or []
    speckle = SimpleNamespace(names=[name for name in names if name in ("looks", "texture")], rivals=[])
    quiet = np.full((20, 20), 1.0)
    images = [comparison(quiet, 1.0, name="v0"), comparison(quiet, 1.0, name="v1", role="test")]
    findings = unlike.get("findings", [])
    edges = SimpleNamespace(off=lambda _: [SimpleNamespace(image="v1 HH")])
    judged = {
        "train": SimpleNamespace(findings=[], edges=edges),
        "test": SimpleNamespace(findings=findings, edges=edges),
    }
    part = SimpleNamespace(material="roof", centre_m=[12.0, -3.0, 7.5])
    told = {
        "verdict": names,
        "unexplained": bool(findings),
        "findings": set(findings),
        "changed": bool(names),
        "diagnosis": SimpleNamespace(not_asked=[], turns=[SimpleNamespace(alarms=False)], held=names),
        "speckle": speckle,
        "alternatives": [],
        "verdicts": judged,
        "models": [images, images],
        "place": SimpleNamespace(parts=[part]),
        "left": SimpleNamespace(
            image="v0 HH", shape=SimpleNamespace(row=4, col=5), moves=SimpleNamespace(way=unlike.get("way", "surface"))
        ),
    }
    told |= {key: value for key, value in unlike.items() if key in told and key != "findings"}
    return cast(Diagnosed, SimpleNamespace(**told))


RIVAL = [(SimpleNamespace(effect="aim_point", other="registration"), SimpleNamespace(sentence="measure at 60 deg"))]


@pytest.mark.parametrize(
    ("done", "said"),
    [
        (diagnosed(), "Nothing is missing: what the model leaves looks like speckle."),
        (diagnosed(["looks"]), "The model lacks looks; with it nothing but speckle is left."),
        (
            diagnosed(["noise_floor", "aim_point"], alternatives=RIVAL),
            "The model lacks noise_floor and aim_point or registration; with it nothing but speckle is left.",
        ),
        (diagnosed(findings=["structure"]), "The model lacks something that nothing found explains."),
        (
            diagnosed(["noise_floor"], findings=["edges"]),
            "The model lacks noise_floor, and something that nothing found explains.",
        ),
        (diagnosed(["aim_point"], unexplained=True), "What the train views tell does not hold on the test views."),
        (
            diagnosed(diagnosis=SimpleNamespace(not_asked=["vegetation"], turns=[], held=[])),
            "Nothing is missing: what the model leaves looks like speckle, but the time was over before all was asked.",
        ),
    ],
)
def test_the_verdict_is_one_sentence(done: Diagnosed, said: str) -> None:
    assert verdict_sentence(done) == said


@pytest.mark.parametrize(
    ("done", "words"),
    [
        (
            diagnosed(findings=["structure"]),
            "The mesh lacks something about east 12.0 m, north -3.0 m, up 7.5 m (roof)",
        ),
        (
            diagnosed(findings=["structure"], way="image"),
            "Look at the radar and its processing about row 4, column 5 of",
        ),
        (diagnosed(findings=["structure"], way="neither"), "Look at row 4, column 5 of v0 HH first"),
        (diagnosed(findings=["structure"], place=SimpleNamespace(parts=[])), "no place on the mesh accounts for it"),
        (diagnosed(findings=["edges"]), "Look at the outlines in v1 HH"),
        (diagnosed(findings=["distribution"]), "how the images were averaged, filtered or compressed"),
        (diagnosed(findings=["level"]), "calibration"),
        (diagnosed(unexplained=True), "the model holds on the train views and not on them"),
        (diagnosed(["aim_point"], alternatives=RIVAL), "Measure at 60 deg."),
        (diagnosed(["texture"]), "Declare texture as the written scene does"),
        (diagnosed(["noise_floor"]), "Check these names by other means"),
        (diagnosed(verdicts={"train": SimpleNamespace(findings=[])}), 'role = "test"'),
        (diagnosed(diagnosis=SimpleNamespace(not_asked=["x"], turns=[], held=[])), "with --resume and more time"),
    ],
)
def test_what_to_do_next_follows_from_the_verdict(done: Diagnosed, words: str) -> None:
    steps = next_steps(done, OUT)
    assert 1 <= len(steps) <= 2
    assert sum(words in step.words for step in steps) == 1


def test_a_scene_that_explains_its_images_is_to_be_looked_at() -> None:
    """The command can be pasted into a shell; where something is left, no such thing is said."""
    commands = [step.command for step in next_steps(diagnosed(), OUT)]
    assert commands == ["warpsar evaluate 'a folder/scene.toml' -o 'a folder/evaluate'"]
    assert not any(step.command for step in next_steps(diagnosed(findings=["structure"]), OUT))


def test_the_picture_is_of_the_image_that_tells_most() -> None:
    """Of three images, where the model got better most; where it stays, a test image; what is left where it is."""
    random = np.random.default_rng(4)
    measured = random.gamma(4.0, 0.25, (40, 40))
    roles = ("train", "train", "test")
    before = [
        comparison(measured, level, name=f"v{k}", role=role)
        for k, (level, role) in enumerate(zip((1.2, 2.0, 1.5), roles, strict=True))
    ]
    after = [comparison(measured, 1.0, name=f"v{k}", role=role) for k, role in enumerate(roles)]
    assert telling(diagnosed(["noise_floor"], models=[before, after])) == 1
    assert telling(diagnosed(models=[after, after])) == 2
    assert telling(diagnosed(findings=["level"], models=[before, after])) == 0


def test_powers_are_averaged_before_their_ratio() -> None:
    """One pixel of 10 among ones: (10 + 8) / 9 about it, nothing where nothing is compared, and no rounding."""
    measured = np.ones((20, 20))
    measured[8, 9] = 10.0
    dark = np.zeros((20, 20), bool)
    dark[:, 14:] = True
    found = averaged_ratio_db(comparison(measured, 1.0, dark=dark, border=2))
    assert found[7:10, 8:11] == pytest.approx(np.full((3, 3), 10.0 * np.log10(2.0)), abs=1e-12)
    assert found[4, 4] == 0.0
    assert np.isnan(found[:, 14:]).all()
    assert np.isnan(found[:2]).all()


def test_power_where_the_model_has_none_is_at_the_end_of_the_scale() -> None:
    simulated = np.ones((20, 20))
    simulated[:, 10:] = 0.0
    found = averaged_ratio_db(comparison(np.ones((20, 20)), simulated, border=2))
    assert (found[3:17, 12:17] == np.inf).all()
    assert np.isnan(averaged_ratio_db(comparison(0.0 * simulated, 0.0 * simulated + 1e-300, border=2))[0, 0])


def test_a_frame_lies_about_its_rectangle() -> None:
    """One pixel away from it, and one wide, up to 200 pixels; the rectangle keeps its colours."""
    picture = html_image.framed(np.ones((40, 50, 3)), (10, 12, 0, 20))
    black = (picture == 0.0).all(axis=2)
    assert black[8, :22].all()
    assert black[14, :22].all()
    assert black[8:15, 22].all()
    assert black.sum() == 2 * 23 + 5
    wide = html_image.framed(np.ones((400, 400, 3)), (100, 110, 100, 110))
    assert (wide[100:111, 100:111] == 1.0).all()
    assert (wide[96:98, 100] == 0.0).all()


def test_bars_are_as_long_as_they_say() -> None:
    text = html.bars([html.Bar("a < b", 0.5, "7.1", True), html.Bar("c", 0.0, "0.0")], 0.25, "key")
    assert "a &lt; b" in text
    assert '<i class=marked style="width: 50%"></i>7.1' in text
    assert '<i style="width: 0%"></i>0.0' in text
    assert "--line: 0.25" in text
