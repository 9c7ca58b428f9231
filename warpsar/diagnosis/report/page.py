"""report.html of `warpsar diagnose`: what was found, why it is believed, and what is left, for one who doubts it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.diagnosis.found import Turn
from warpsar.diagnosis.phase.declared import PhaseAsked
from warpsar.diagnosis.report.first import first_screen, verdict_sentence
from warpsar.diagnosis.report.left import left_section, residuals_section
from warpsar.diagnosis.report.summary import summary_section
from warpsar.diagnosis.report.turns import turn_section
from warpsar.diagnosis.result import Diagnosed, why_not
from warpsar.diagnosis.surface_moves import ParameterMove
from warpsar.io import html as report
from warpsar.io.figures import new
from warpsar.learning.object_figures import figure_of_objects

if TYPE_CHECKING:
    from matplotlib.figure import Figure
from warpsar.diagnosis.field_content import FIELDS_HEAD, fields_rows
from warpsar.diagnosis.known import KNOWN_CAPTION, KNOWN_HEAD, known_rows
from warpsar.diagnosis.search.outcome import effect_table
from warpsar.diagnosis.surface_moves import SAME_SD
from warpsar.effects.registry import get
from warpsar.evaluation.report_parts import shown_as, shown_interval

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
    diagnosis = done.diagnosis
    rows, cols = diagnosis.scene.grid.shape
    intro = f"{Path(diagnosis.scene.path or 'the scene').name}: {len(done.models[0])} images of {rows} x {cols} pixels"
    sections = [
        *first_screen(done, path.parent),
        summary_section(done, content),
        *_phase_section(phases),
        *_objects_section(done, content),
        residuals_section(done),
        *(turn_section(turn, number, content) for number, turn in enumerate(diagnosis.turns)),
        *law_section(done),
        parameters_section(done, moves, content),
        _not_tested(diagnosis.turns[-1]),
        left_section(done),
        report.reproduce(
            content, command, "Beside this file: diagnosis.json (all numbers), scene.toml (the model at the end)."
        ),
    ]
    report.write(path, report.page(_phase_sentence(phases) + verdict_sentence(done), intro, *sections))


def _not_tested(turn: Turn) -> str:
    items = [f"{c.effect}: {why_not(c)}" for c in turn.candidates if c.testability != "testable"]
    sentence = (
        "Not found is not absent. Of these effects nothing can be said from these views, with the model as it ended:"
    )
    if not items:
        return report.section(
            "What could not be tested", report.paragraph("Every effect of the library could be tested.")
        )
    return report.section("What could not be tested", report.paragraph(sentence), report.bullets(items))


def _phase_section(phases: Sequence[PhaseAsked]) -> list[str]:
    """A sentence for each view with samples of phase, and the phases that were named, over the aperture."""
    if not phases:
        return []
    blocks = [report.bullets([one.words for one in phases])]
    if named := [one for one in phases if one.named]:
        blocks.append(report.drawing(_phase_figure(named), "Phase error over slow time, as it was named"))
    return [report.section("The phase of complex images", *blocks)]


def _phase_sentence(phases: Sequence[PhaseAsked]) -> str:
    """For the head of the page; empty where nothing was named."""
    named = [f"{one.view} ({one.cause})" for one in phases if one.named]
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
    diagnosis = done.diagnosis
    objects: dict[str, dict[str, Any]] = content.get("objects", {})
    figure = figure_of_objects(diagnosis.scene, diagnosis.final.scene, objects)
    if figure is None:
        return []
    caption = "Objects as the scene file has them (dashed) and as they were found (red)"
    return [report.section("Objects before and after", report.drawing(figure, caption))]


# ---- the learned law of backscatter, drawn over incidence, so that a person can name it


def law_section(done: Diagnosed) -> list[str]:
    """A section, or none where no law was learned."""
    incidence = np.linspace(0.0, 90.0, 181)
    effects = done.diagnosis.final.scene.effects
    laws = [law for name, table in effects.items() if (law := get(name).law_db(table, incidence))]
    if not laws:
        return []
    figure, axes = new(6.0, 3.4)
    for channel, factor in laws[0].items():
        axes.plot(incidence, factor, label=channel)
    axes.set(xlabel="local incidence [deg]", ylabel="learned factor on sigma0 [dB]", xlim=(0.0, 90.0))
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    axes.legend()
    sentences = (
        "No named effect explains what was left, so a factor on sigma0 was learned from the images. Its shape may tell "
        "what it is: a slope over all angles is another roughness, a bend of one polarization another model, a step a "
        "layer. It is no explanation by itself."
    )
    words = "The learned factor on sigma0 over local incidence, of each polarization"
    return [report.section("The learned backscatter", report.paragraph(sentences), report.drawing(figure, words))]


# ---- parameters: how those of the surface moved, and what the added effects have


def parameters_section(done: Diagnosed, moves: Sequence[ParameterMove], content: dict[str, Any]) -> str:
    rows = []
    for move in moves:
        label, factor = shown_as(move.key)
        row = [f"{move.material}: {label}"]
        row.append(f"{_number(move.before * factor)} {_percent(move.before_sd)}")
        row.append(f"{_number(move.after * factor)} {shown_interval(move.after_95, factor)}")
        row.append("–" if not done.diagnosis.verdict else f"{move.move:+.2f}")
        row.append("–" if not done.diagnosis.verdict or not np.isfinite(move.sds) else f"{move.sds:+.1f}")
        rows.append(row)
    head = ["parameter", "before", "after", "move (ln)", "in standard deviations"]
    caption = (
        "In brackets: before, one standard deviation; after, the 95 % interval by the profile of the likelihood over "
        "all surfaces, from the speckle that was found. Open: every value that a fit may take fits. –: not determined "
        "alone."
    )
    blocks = []
    if done.diagnosis.final.scene.effects:
        tables = [[name, effect_table(table)] for name, table in done.diagnosis.final.scene.effects.items()]
        blocks.append(report.table(["effect", "parameters at the end"], tables))
    if content["objects"]:
        objects = [[name, effect_table(table)] for name, table in content["objects"].items()]
        blocks.append(report.table(["object", "found at the end"], objects))
    if content["tolerances"]:
        blocks.append(report.table(KNOWN_HEAD, known_rows(content), KNOWN_CAPTION))
    if fields := fields_rows(content):
        blocks.append(report.table(FIELDS_HEAD, fields))
    if rows:
        blocks.append(report.table(head, rows, caption))
    far = [m for m in moves if np.isfinite(m.sds) and abs(m.sds) > SAME_SD]
    if done.diagnosis.verdict and moves:
        sentence = (
            f"{len(far) or 'None'} of {len(moves)} surface parameters moved by more than {SAME_SD:g} standard "
            f"deviations when what was missing was added"
            + (": so far had they been pulled by leaving it out." if far else ".")
        )
        blocks.append(report.paragraph(sentence))
    blocks.append(report.bullets(content["identifiability"]["words"]))
    return report.section("How the surface parameters moved", *blocks)


def _percent(sd: float) -> str:
    return f"(± {100 * sd:.2g} %)" if np.isfinite(sd) and sd < 1.0 else "(–)"


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "–"
