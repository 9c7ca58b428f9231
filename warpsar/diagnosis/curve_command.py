"""`warpsar diagnose` on curves of radar cross-section, plain or with frequencies held back (`--folds`)."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import warp as wp

from warpsar.coherent.left_out import left_out_warning
from warpsar.diagnosis.curve_folds import held_back_in_turn, lost
from warpsar.diagnosis.curves import diagnose_curves
from warpsar.evaluation.report_curves import write_curves_report
from warpsar.runtime import console
from warpsar.scene.scene import Scene
from warpsar.simulation.outputs import write_json


def run_curves(
    scene: Scene,
    out: Path,
    where: wp.Device,
    started: float,
    command: Sequence[str],
    *,
    seed: int = 0,
    parts: int | None = None,
) -> dict[str, Any]:
    """Write diagnosis.json, scene.toml with the added terms, and report.html into `out`. Returns the JSON's content.

    With `parts` the frequencies of the train curves are held back in so many parts, too, one after the other. `started`
    is `time.perf_counter()` of the run's begin, `command` the words that made it. Raises InputError as
    `diagnose_curves` and `held_back_in_turn` do.
    """
    console.warn(left_out_warning(scene, "a curve"))
    cache = out / "cache"
    held_back = [] if parts is None else held_back_in_turn(scene, parts, cache, where.alias)
    asked = diagnose_curves(scene, cache, where.alias)
    asked.scene.save(out / "scene.toml")
    content, summary = asked.content(), asked.in_short
    if held_back:
        gone = lost(asked.verdict, held_back)
        content |= {"held_back": [one.content() for one in held_back], "not_in_every_part": gone}
        for one in held_back:
            console.say(one.words)
        summary += f"; not found with every frequency held back: {', '.join(gone)}" if gone else ""
    content = write_json(out / "diagnosis.json", scene, where, seed, started, content)
    write_curves_report(
        out / "report.html",
        f"What {Path(scene.path or 'the scene').name} lacks, by its curves",
        asked.after,
        asked.verdicts,
        content,
        command,
        before=asked.before,
        words=[*asked.words, *(f"{one.words[0].upper()}{one.words[1:]}." for one in held_back)],
        beside="scene.toml, diagnosis.json (all numbers)",
    )
    console.say_written(out, "report.html", "diagnosis.json", "scene.toml")
    print(summary, file=sys.stdout)
    return content
