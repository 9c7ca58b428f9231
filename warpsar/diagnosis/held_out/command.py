"""`warpsar diagnose --folds N`: what the model lacks by views left out in arcs of azimuth, or by curves of frequencies
that are held back."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.compare.aim import without_aims
from warpsar.compare.prediction import Advantage, summaries
from warpsar.diagnosis.curve_command import run_curves
from warpsar.diagnosis.held_out.glints import on_bodies
from warpsar.diagnosis.held_out.report import front_words, judgement, sentence, write_report
from warpsar.diagnosis.held_out.search import HeldOut, held_out
from warpsar.diagnosis.run_log import open_run_log
from warpsar.io import checkpoint
from warpsar.learning.learn import tag_of
from warpsar.learning.pull import leaving
from warpsar.runtime import console, once
from warpsar.simulation.outputs import opened, write_json
from warpsar.version import __version__
from warpsar.world.world import refuse_both_kinds


def run(
    scene_path: Path | str,
    out: Path | str,
    *,
    folds: int,
    device: str | None = None,
    time_limit_s: float | None = None,
    resume: bool = False,
) -> dict[str, Any]:
    """Write diagnosis.json, scene.toml with what was found, and report.html into `out`. Returns the JSON's content.

    A checkpoint is kept there while it runs, and `resume` goes on from it. Raises InputError for a scene whose train
    views are too few to be left out in so many parts, and as `open_run_log` does.
    """
    started = time.perf_counter()
    scene, out, where = opened(scene_path, out, device)
    words = ["warpsar", "diagnose", str(scene_path), "-o", str(out), "--device", where.alias, "--folds", str(folds)]
    refuse_both_kinds(scene)
    if scene.has_curves_alone:
        return run_curves(scene, out, where, started, words, parts=folds)
    once.join(where)
    tag = tag_of(scene, {"command": "diagnose", "version": __version__, "folds": folds})
    log = open_run_log(out, tag, resume)
    result = once.agree(lambda: held_out(scene, where, folds, log, time_limit_s))

    def write() -> dict[str, Any]:
        result.final.save(out / "scene.toml")
        content = content_of(result)
        content = write_json(out / "diagnosis.json", scene, where, scene.sampling.seed, started, content)
        write_report(out / "report.html", result, content, words, where)
        if not result.not_asked:
            checkpoint.remove(out)
        for verdict_words in judgement(result):
            console.say(verdict_words)
        console.say_written(out, "report.html", "diagnosis.json", "scene.toml")
        print(sentence(result), file=sys.stdout)
        return content

    return once.agree(lambda: once.write(write)) or {}


def content_of(result: HeldOut) -> dict[str, Any]:
    """What diagnosis.json holds."""
    return {
        "verdict": result.held,
        "unexplained": not result.ahead,
        "lead": _advantage_content(result.of_pictures),
        "lead_of_box": _advantage_content(result.of_box),
        "box_found": result.box_held,
        "fronts": {label: {**asdict(step), "words": front_words(label, step)} for label, step in result.fronts.items()},
        "not_told": result.untold,
        "not_asked": result.not_asked,
        "ended": result.ended,
        "azimuths": None if result.counting is None else {**asdict(result.counting), "words": result.counting.words},
        "folds": result.folds,
        "steps": [asdict(step) for step in result.steps],
        "profiles": {name: asdict(profile) for name, profile in result.profiles.items()},
        "tolerances": {one.label: one.content() for one in result.pulls},
        "leaves_tolerance": leaving(result.pulls),
        "left_out": {
            "deviance_before": float(np.mean(list(result.before.values()))),
            "deviance_after": float(np.mean(list(result.after.values()))),
            "views_before": result.before,
            "views_after": result.after,
            "predictions": [asdict(row) for row in summaries(result.images)],
        },
        "placed_glints": [asdict(one) for one in on_bodies(result.final)],
        "effects": dict(without_aims(result.final).effects),
        "materials": {
            name: one.model_dump(exclude_unset=True, mode="json", warnings=False)
            for name, one in result.final.materials.items()
        },
    }


def _advantage_content(one: Advantage | None) -> dict[str, Any] | None:
    return None if one is None else {**asdict(one), "ahead": one.ahead, "words": one.words}
