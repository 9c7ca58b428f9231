"""report.html of `warpsar diagnose`: what was found, why it is believed, and what is left, for one who doubts it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.diagnosis.found import Turn
from warpsar.diagnosis.phase.declared import PhaseAsked
from warpsar.diagnosis.report.first import first_screen, verdict_sentence
from warpsar.diagnosis.report.law import law_section
from warpsar.diagnosis.report.left import left_section, residuals_section
from warpsar.diagnosis.report.summary import summary_section
from warpsar.diagnosis.report.surface import parameters_section
from warpsar.diagnosis.report.turns import turn_section
from warpsar.diagnosis.result import Diagnosed, why_not
from warpsar.diagnosis.surface_moves import ParameterMove
from warpsar.io import html as report
from warpsar.io.figures import new
from warpsar.learning.object_figures import figure_of_objects

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PLACES = 201  # along the aperture, at which a phase is drawn


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
        *_phase_section(phases),
        *_objects_section(done, content),
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
    report.write(path, report.page(_phase_sentence(phases) + verdict_sentence(done), lead, *sections))


def _not_tested(turn: Turn) -> str:
    items = [f"{c.effect}: {why_not(c)}" for c in turn.candidates if c.testability != "testable"]
    said = "Not found is not absent. Of these effects nothing can be said from these views, with the model as it ended:"
    if not items:
        return report.section(
            "What could not be tested", report.paragraph("Every effect of the library could be tested.")
        )
    return report.section("What could not be tested", report.paragraph(said), report.bullets(items))


def _phase_section(found: Sequence[PhaseAsked]) -> list[str]:
    """A sentence for each view with samples of phase, and the phases that were named, over the aperture."""
    if not found:
        return []
    said = [report.bullets([one.words for one in found])]
    if named := [one for one in found if one.named]:
        said.append(report.drawing(_phase_figure(named), "Phase error over slow time, as it was named"))
    return [report.section("The phase of complex images", *said)]


def _phase_sentence(found: Sequence[PhaseAsked]) -> str:
    """For the head of the page; empty where nothing was named."""
    named = [f"{one.view} ({one.cause})" for one in found if one.named]
    return f"The phase over slow time is wrong in {', '.join(named)}. " if named else ""


def _phase_figure(named: Sequence[PhaseAsked]) -> Figure:
    figure, axes = new(6.0, 3.2)
    place = np.linspace(-1.0, 1.0, _PLACES)
    for one in named:
        axes.plot(place, one.phase(place), label=one.view)
    axes.set(xlabel="place along the aperture", ylabel="phase error [rad]")
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def _objects_section(done: Diagnosed, content: dict[str, Any]) -> list[str]:
    """Objects in plan and in space; nothing where none was learned, moved, found or left out."""
    found = done.diagnosis
    told: dict[str, dict[str, Any]] = content.get("objects", {})
    figure = figure_of_objects(found.scene, found.final.scene, told)
    if figure is None:
        return []
    caption = "Objects as the scene file has them (dashed) and as they were found (red)"
    return [report.section("Objects before and after", report.drawing(figure, caption))]
