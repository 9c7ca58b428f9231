"""`warpsar learn`: a fit, and the files that it leaves."""

from __future__ import annotations

import csv
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.coherent.left_out import left_out_warning
from warpsar.compare.aim import unaimed
from warpsar.compare.curve import content_of, errors_in_short
from warpsar.compare.evaluation import curves_content
from warpsar.effects.registry import held_by
from warpsar.io import checkpoint
from warpsar.io.figures import convergence, save
from warpsar.io.images import replacing
from warpsar.learning.curves import LearnedCurves, learn_from_curves
from warpsar.learning.descent import History
from warpsar.learning.fields import field_uncertainty
from warpsar.learning.learn import Learned, learn
from warpsar.learning.object_figures import figure_of_objects
from warpsar.learning.options import LearnOptions
from warpsar.learning.pull import leaving
from warpsar.learning.table import figure_of_table
from warpsar.runtime import console, once
from warpsar.scene.scene import Scene
from warpsar.simulation.outputs import opened, write_json


def run(
    scene_path: Path | str,
    out: Path | str,
    *,
    device: str | None = None,
    options: LearnOptions | None = None,
    resume: bool = False,
) -> dict[str, Any]:
    """`warpsar learn`: scene.toml with what was learned, history.csv, learn.json and figures in `out`. Returns the
    JSON's content."""
    found, content = fitted(scene_path, out, device=device, options=options, resume=resume)
    once.write(lambda: print_in_short(found))
    return content


def print_in_short(found: Learned | LearnedCurves) -> None:
    """The last line of the command: how well the result fits."""
    if isinstance(found, LearnedCurves):
        words = errors_in_short(found.after)
    else:
        words = f"train deviance {found.train['deviance']:.4f}"
        words += "" if found.test is None else f", test deviance {found.test['deviance']:.4f}"
    print(words, file=sys.stdout, flush=True)


def fitted(
    scene_path: Path | str,
    out: Path | str,
    *,
    device: str | None = None,
    options: LearnOptions | None = None,
    resume: bool = False,
) -> tuple[Learned | LearnedCurves, dict[str, Any]]:
    """What `run` does: the fit, to images or to curves, and the content of learn.json."""
    started = time.perf_counter()
    options = options or LearnOptions()
    scene, out, where = opened(scene_path, out, device)
    if scene.has_curves_alone:
        console.warn(left_out_warning(scene, "a curve"))
        of_curves = learn_from_curves(scene, out / "cache", where.alias)
        of_curves.scene.save(out / "scene.toml")
        for sentence in of_curves.words:
            console.say(sentence)
        written = write_json(out / "learn.json", scene, where, options.seed, started, of_curves.content())
        console.say_written(out, "scene.toml", "learn.json")
        return of_curves, written
    console.warn([*unaimed(scene), *(left_out_warning(scene, "a curve") if scene.curves else [])])
    found = learn(scene, device=where.alias, options=options, folder=out, resume=resume)
    once.write(lambda: _write(out, scene, found))
    content = _summary(found, options)
    _say_doubts(found, scene_path)
    for one in found.pulls:
        if not one.alarm:  # the others are doubts
            console.say(one.words)
    for name, table in found.tables.items():
        console.say(f"{name}: {table.words}")
    for name, other in held_by(scene.effects).items():
        console.say(f"{name}: held, because {other} can do all that it does")
    for sentence in () if found.objects is None else found.objects.words:
        console.say(sentence)
    if found.identified is not None:
        content["identifiability"] = found.identified.summary()
        for sentence in found.identified.words:
            console.say(sentence)
    elif not found.problem.uniform:
        fields = field_uncertainty(found.problem, found.x)
        content["fields"] = once.write(lambda: {name: one.write(out) for name, one in fields.items()}) or {}
    once.wait()  # a process that dies from here on takes no result with it

    def write() -> dict[str, Any]:
        written = write_json(out / "learn.json", scene, where, options.seed, started, content)
        checkpoint.remove(out)
        console.say_written(out, "scene.toml", "learn.json", "history.csv", "figures")
        return written

    return found, once.write(write) or content


def _write(out: Path, scene: Scene, found: Learned) -> None:
    """The files that say what was found, but learn.json."""
    found.scene.save(out / "scene.toml")
    _write_history(out / "history.csv", found.history)
    convergence(out / "convergence.png", found.history)
    _draw_objects(out / "objects.png", scene, found)
    for name, table in found.tables.items():
        save(figure_of_table(name, table.content()), table.file.with_suffix(".png"))


def _draw_objects(path: Path, scene: Scene, found: Learned) -> None:
    """The objects in plan and in space, where any was learned."""
    figure = None if found.objects is None else figure_of_objects(scene, found.scene, found.objects.content())
    if figure is not None:
        save(figure, path)


def _say_doubts(found: Learned, scene_path: Path | str) -> None:
    """What a reader must know before any number."""
    for role, one in found.verdicts.items():
        if not one.wrong:
            console.say(f"{role} views: {one.words}")
    for sentence in found.worse:
        console.say(sentence)
    if not found.doubts:
        return
    console.say("the intervals do not hold:")
    for reason in found.doubts:
        console.say(f"  {reason}")
    # a bound or a model's domain alone is nothing that a search of effects could name
    wrong = any(one.wrong for one in found.verdicts.values()) or any(one.alarm for one in found.pulls)
    if wrong and found.problem.uniform:
        console.say(f"next: warpsar diagnose {scene_path} -o diagnosed/ names what the model lacks")
    console.say("if the model were right:")


def _write_history(path: Path, history: History) -> None:
    with replacing(path) as temporary, temporary.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(history[0]))
        writer.writeheader()
        writer.writerows(history)


def _summary(found: Learned, options: LearnOptions) -> dict[str, Any]:
    """What learn.json says of every fit; all processes call this."""
    problem = found.problem
    content: dict[str, Any] = {
        "intervals_hold": not found.doubts,
        "reasons": found.doubts,
        "verdict": {role: one.content() for role, one in found.verdicts.items()},
        "worse": found.worse,
        "options": asdict(options),
        "rays_per_pixel": found.density.rays_per_pixel,
        "rays_chosen": found.density.chosen,
        "ray_noise": found.density.noise,
        "gradient_check": {"worst": found.gradient_check.worst, "directions": found.gradient_check.directions},
        "loss": found.loss,
        "iterations": found.history[-1]["iteration"],
        "stopped": found.stopped,
        "train": found.train,
        "test": found.test,
        "before": {"train": found.before.train, "test": found.before.test},
        "materials": _material_summary(found),
        "effects": found.scene.effects,
        "tolerances": {one.label: one.content() for one in found.pulls},
        "leaves_tolerance": leaving(found.pulls),
        "outside_domain": found.domains,
        "looks": problem.of_each(lambda s: {"looks": s.looks, "estimated": s.looks_estimated}),
        "pixels": problem.of_each(lambda s: {"used": s.count, "left_out": s.left_out, "zeros": s.zeros}),
        "processes": once.processes(),
    }
    if found.terms:
        content["learned_terms"] = {name: one.content() for name, one in found.terms.items()}
    if found.tables:
        content["learned_tables"] = {name: one.content() for name, one in found.tables.items()}
    if found.objects is not None:
        content["objects"] = found.objects.content()
        if found.objects.found.numbers:
            content["geometry"] = found.objects.found.numbers
    if found.after.curves:
        content["curves"] = {"before": content_of(found.before.curves), **curves_content(found.scene, found.after)}
    if not problem.scene.grid.calibrated:
        gains = problem.gains(problem.modelled(found.x))
        pairs = zip(problem.observations, gains, strict=True)
        known = {(s.view.name, s.polarization): float(gain) for s, gain in pairs}
        content["gains"] = problem.of_each(lambda s: known[s.view.name, s.polarization])
    return content


def _material_summary(found: Learned) -> dict[str, dict[str, Any]]:
    """Learned value of every parameter, and its 95 % interval where it is a single number."""
    problem = found.problem
    nodes = problem.nodes(found.x)
    at = 0
    summary: dict[str, dict[str, Any]] = {}
    for block in problem.surface.blocks:
        values = problem.surface.values(block.material, block.kind.key, nodes)
        entry: dict[str, Any] = {"learned": block.learn, "layout": block.layout}
        if block.size == 1:
            entry["value"] = float(values.ravel()[0])
        else:
            entry |= {"median": float(np.median(values)), "low": float(values.min()), "high": float(values.max())}
        if block.learn:
            if found.identified is not None:
                sd = float(found.identified.sd[at])
                ends = found.identified.interval_95(at, float(nodes[block.start]))
                entry["interval_95"] = list(block.kind.interval(ends))
                entry["interval_from"] = found.identified.interval_from(at)
                entry["interval_holds"] = not found.doubts
                entry["sd_log"] = sd
            at += block.size
        summary.setdefault(block.material, {})[block.kind.key] = entry
    return summary
