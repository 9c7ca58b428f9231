"""The report that `warpsar learn` leaves: the learned model beside the one that it began with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from warpsar.evaluation.report import write_report
from warpsar.evaluation.residuals import expected_db, profiles
from warpsar.learning.learn import Learned
from warpsar.runtime import console
from warpsar.scene.scene import Scene


def write_learn_report(scene_path: Path, out: Path, found: Learned, content: dict[str, Any]) -> None:
    """report.html in `out`, where `learn` has left scene.toml and learn.json; `content` is that of learn.json. Of
    several processes (`distributed`) the first one writes."""
    problem = found.problem
    if not problem.ranks.first:
        return
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
        title=f"What {scene_path.name} learned from its images",
        beside="scene.toml (the learned scene), learn.json (all numbers), history.csv and figures",
    )
    console.say_written(out, "report.html")
