"""The report that `warpsar learn` leaves: the learned model beside the one that it began with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from warpsar.compare.curve import curve_verdicts
from warpsar.evaluation.report import write_report
from warpsar.evaluation.report_curves import write_curves_report
from warpsar.evaluation.residuals import expected_db, profiles
from warpsar.learning.curves import LearnedCurves
from warpsar.learning.learn import Learned
from warpsar.runtime import console
from warpsar.scene.scene import Scene


def write_learn_report(scene_path: Path, out: Path, found: Learned | LearnedCurves, content: dict[str, Any]) -> None:
    """report.html in `out`, where `learn` has left scene.toml and learn.json; `content` is that of learn.json."""
    if isinstance(found, LearnedCurves):
        _write_of_curves(scene_path, out, found, content)
        return
    problem = found.problem
    after = Scene.load(out / "scene.toml")
    write_report(
        out / "report.html",
        after,
        found.after,
        profiles(found.after.images, after.mesh.materials),
        expected_db(found.after.images),
        content,
        ["warpsar", "learn", str(scene_path), "-o", str(out), "--device", problem.device.alias],
        problem.device,
        before=found.before,
        identified=found.identified,
        title=f"What {scene_path.name} learned from its images{' and curves' if found.after.curves else ''}",
        beside="scene.toml (the learned scene), learn.json (all numbers), history.csv and figures",
    )
    console.say_written(out, "report.html")


def _write_of_curves(scene_path: Path, out: Path, found: LearnedCurves, content: dict[str, Any]) -> None:
    words = ["warpsar", "learn", str(scene_path), "-o", str(out), "--device", content["device"]]
    title, beside = f"What {scene_path.name} learned from its curves", "scene.toml (as learned), learn.json"
    write_curves_report(
        out / "report.html",
        title,
        found.after,
        curve_verdicts(found.after),
        content,
        words,
        before=found.before,
        words=found.words,
        beside=beside,
    )
    console.say_written(out, "report.html")
