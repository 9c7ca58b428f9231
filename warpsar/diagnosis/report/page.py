"""report.html of `warpsar diagnose`: what was found, why it is believed, and what is left, for one who doubts it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from warpsar.diagnosis.found import Turn
from warpsar.diagnosis.phase.declared import PhaseAsked
from warpsar.diagnosis.report.first import first_screen, verdict_sentence
from warpsar.diagnosis.report.law import law_section
from warpsar.diagnosis.report.left import left_section, residuals_section
from warpsar.diagnosis.report.objects import objects_section
from warpsar.diagnosis.report.phase import phase_section, phase_sentence
from warpsar.diagnosis.report.summary import summary_section
from warpsar.diagnosis.report.surface import parameters_section
from warpsar.diagnosis.report.turns import turn_section
from warpsar.diagnosis.result import Diagnosed, why_not
from warpsar.diagnosis.surface_moves import ParameterMove
from warpsar.io import html as report


def write_report(
    path: Path,
    done: Diagnosed,
    moves: Sequence[ParameterMove],
    content: dict[str, Any],
    command: Sequence[str],
    phases: Sequence[PhaseAsked] = (),
) -> None:
    """`path` lies beside the written scene. `content` is that of diagnosis.json, `command` the words that made it."""
    found = done.diagnosis
    rows, cols = found.scene.grid.shape
    lead = f"{Path(found.scene.path or 'the scene').name}: {len(done.models[0])} images of {rows} x {cols} pixels"
    sections = [
        *first_screen(done, path.parent),
        summary_section(done, content),
        *phase_section(phases),
        *objects_section(done, content),
        residuals_section(done),
        *(turn_section(turn, number, done, content) for number, turn in enumerate(found.turns)),
        *law_section(done),
        parameters_section(done, moves, content),
        _not_tested(found.turns[-1]),
        left_section(done),
        report.reproduce(
            content, command, "Beside this file: diagnosis.json (all numbers), scene.toml (the model at the end)."
        ),
    ]
    report.write(path, report.page(phase_sentence(phases) + verdict_sentence(done), lead, *sections))


def _not_tested(turn: Turn) -> str:
    items = [f"{c.effect}: {why_not(c)}" for c in turn.candidates if c.testability != "testable"]
    said = "Not found is not absent. Of these effects nothing can be said from these views, with the model as it ended:"
    if not items:
        return report.section(
            "What could not be tested", report.paragraph("Every effect of the library could be tested.")
        )
    return report.section("What could not be tested", report.paragraph(said), report.bullets(items))
