"""`warpsar diagnose`: which effect the measured images hold and the scene does not declare."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import Any

from warpsar.compare.aim import unaimed
from warpsar.compare.contract import ROLES
from warpsar.diagnosis.content import content_of
from warpsar.diagnosis.curve_command import run_curves
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.left.words import first_sentence
from warpsar.diagnosis.models.names import kind_of
from warpsar.diagnosis.phase.declared import ask_phase, named_in, with_phase_errors
from warpsar.diagnosis.report.page import write_report
from warpsar.diagnosis.result import OPEN_WORDS, Diagnosed, judged
from warpsar.diagnosis.search.procedure import diagnose_scene
from warpsar.diagnosis.search.record import open_record
from warpsar.diagnosis.surface_moves import moved_parameters
from warpsar.diagnosis.written_scene import annotate
from warpsar.io import checkpoint
from warpsar.runtime import console, once
from warpsar.simulation.outputs import opened, write_json
from warpsar.world.world import refuse_both_kinds

UNEXPLAINED = 4
"""Exit status of the command where something is left that nothing found explains."""


def run(
    scene_path: Path | str,
    out: Path | str,
    *,
    device: str | None = None,
    options: DiagnoseOptions | None = None,
    resume: bool = False,
) -> dict[str, Any]:
    """`warpsar diagnose`: write diagnosis.json, scene.toml with the added effects, and report.html into `out`.

    A checkpoint is kept there while it runs, and `resume` goes on from it. Returns the JSON's content. Of several
    processes, the first one judges and writes. The others return nothing. Raises InputError as `diagnose` and
    `open_record` do.
    """
    started = time.perf_counter()
    options = options or DiagnoseOptions()
    scene, out, where = opened(scene_path, out, device)
    words = command_line(scene_path, out, where.alias, options)
    refuse_both_kinds(scene)
    if scene.has_curves_alone:
        return run_curves(scene, out, where, started, words, seed=options.seed)
    console.warn(unaimed(scene))
    once.join(where)
    phases = once.find(lambda: ask_phase(scene))
    scene = with_phase_errors(scene, phases)
    record = open_record(scene, options, out, resume)
    diagnosis = diagnose_scene(scene, where, options, record)

    processes = once.processes()

    def write() -> dict[str, Any]:
        done = judged(diagnosis)
        moves, identified = moved_parameters(done.diagnosis)
        done.diagnosis.final.scene.save(out / "scene.toml")
        annotate(out / "scene.toml", done.diagnosis.objects)
        content = content_of(done, moves, identified, options) | {"processes": processes}
        content["phase"] = [one.content() for one in phases]
        content["verdict"] = [*named_in(phases), *content["verdict"]]
        content = write_json(out / "diagnosis.json", scene, where, options.seed, started, content)
        write_report(out / "report.html", done, moves, content, words, phases)
        if not diagnosis.not_asked:
            checkpoint.remove(out)
        for one in content["tolerances"].values():
            console.say(one["after"]["words"])
        if done.speckle.departs:
            console.say(f"train views: {done.speckle.words}")
        for reason in done.reasons:
            console.say(reason)
        if done.unexplained:
            console.say(first_sentence(done.left))
        for role, one in done.verdicts.items():
            if not one.wrong:
                console.say(f"{role} views: {one.words}")
        for name in done.diagnosis.of_test_views:
            console.say(f"{name}: a test view, whose own number was fitted to it alone")
        if done.open_surface:
            console.say(done.open_surface)
        for doubt in done.doubts:
            console.say(f"{doubt}: such values mean little")
        console.say_written(out, "report.html", "diagnosis.json", "scene.toml")
        print("; ".join([*(one.words for one in phases if one.named), in_short(done)]), file=sys.stdout)
        return content

    return once.agree(lambda: once.write(write)) or {}


def command_line(scene_path: Path | str, out: Path, device: str, options: DiagnoseOptions) -> list[str]:
    """The words that make this run again."""
    words = ["warpsar", "diagnose", str(scene_path), "-o", str(out), "--device", device, "--seed", str(options.seed)]
    words += ["--family-error", f"{options.family_error:g}", "--draws", str(options.draws)]
    return [*words, "--starts", str(options.starts), "--most-effects", str(options.most_effects)]


def in_short(done: Diagnosed) -> str:
    """One line: what is left unexplained first, then the names, and what they did to the views that named nothing."""
    diagnosis = done.diagnosis
    others = {one.effect: "" for one, _ in done.alternatives}
    for one, _ in done.alternatives:
        others[one.effect] += f" or {one.other}"
    others |= {name: "".join(f" or {other}" for other in done.speckle.rivals) for name in done.speckle.names}
    names = ", ".join(name + others.get(name, "") for name in done.verdict)
    parts = []
    if done.unexplained:
        findings = dict.fromkeys(_WORDS[kind] for one in done.verdicts.values() for kind in one.findings)
        why = [*findings, *(f"{label} leaves its tolerance" for label in done.leaving)]
        parts.append(f"unexplained: {', '.join(why) or '; '.join(done.reasons)}")
        parts += [f"found: {names}"] if names else []
        doubted = ", ".join(dict.fromkeys(map(kind_of, done.not_established)))
        parts += [f"in the model, but not established: {doubted}"] if doubted else []
    else:
        parts.append(names or "nothing missing")
        parts += [OPEN_WORDS] if done.foretold else []
    if diagnosis.not_asked:
        parts.append("the time was over before all was asked")
    if not done.unexplained:
        edges = [one.edges for one in done.verdicts.values()]
        parts.append(max(edges, key=lambda one: one.most_m if one.judged else math.inf).words)
        parts += [] if "test" in done.verdicts else ["no test views: train views alone were judged"]
        few = [role for role, one in done.verdicts.items() if one.finding == "cannot be told"]
        parts += [f"too few pixels of {' and '.join(few)} views to tell their level"] if few else []
    for role in reversed(ROLES):
        before, after = done.before[role], done.after[role]
        if before is not None and after is not None:
            parts.append(
                f"{role} deviance {before['deviance']:.4f} -> {after['deviance']:.4f} +- {after['deviance_error']:.4f}"
            )
            break
    return "; ".join(one for one in parts if one)


_WORDS = {
    "structure": "structure",
    "edges": "edges that do not agree",
    "looks": "looks",
    "texture": "texture",
    "distribution": "speckle of another distribution",
    "level": "a deviance that speckle does not leave",
}
