"""The report that `warpsar learn` leaves: the learned model beside the one that it began with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from warpsar.evaluation.command import evaluate
from warpsar.evaluation.report import write_report
from warpsar.evaluation.residuals import expected_db, profiles
from warpsar.runtime import console, devices, distributed
from warpsar.scene.scene import Scene


def write_learn_report(scene_path: Path, out: Path, content: dict[str, Any], device: str | None) -> None:
    """report.html in `out`, where `learn` has left scene.toml and learn.json; `content` is that of learn.json. Nothing
    where no image was learned from. All processes (`distributed`) call this, and the first one writes."""
    before, after = Scene.load(scene_path), Scene.load(out / "scene.toml")
    if not any(view.images for view in after.views):
        return
    where = devices.resolve_device(device)
    models = [evaluate(scene, device=where.alias) for scene in (before, after)]
    if not distributed.ranks(where).first:
        return
    write_report(
        out / "report.html",
        after,
        models[1],
        profiles(models[1].images, after.mesh.materials),
        expected_db(models[1].images),
        content,
        ["warpsar", "learn", str(scene_path), "-o", str(out), "--device", where.alias],
        where,
        before=models[0],
        title=f"What {scene_path.name} learned from its images",
        beside="scene.toml (the learned scene), learn.json (all numbers), history.csv and figures",
    )
    console.say_written(out, "report.html")
