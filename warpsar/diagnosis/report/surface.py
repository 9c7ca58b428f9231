"""Parameters in diagnose's report: how those of the surface moved, and what the added effects have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from warpsar.diagnosis.field_content import FIELDS_HEAD, fields_rows
from warpsar.diagnosis.known import KNOWN_CAPTION, KNOWN_HEAD, known_rows
from warpsar.diagnosis.result import Diagnosed
from warpsar.diagnosis.search.outcome import effect_table
from warpsar.diagnosis.surface_moves import SAME_SD, ParameterMove
from warpsar.evaluation.report_parts import shown_as, shown_interval
from warpsar.io import html as report


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
        said = (
            f"{len(far) or 'None'} of {len(moves)} surface parameters moved by more than {SAME_SD:g} standard "
            f"deviations when what was missing was added"
            + (": so far had they been pulled by leaving it out." if far else ".")
        )
        blocks.append(report.paragraph(said))
    blocks.append(report.bullets(content["identifiability"]["words"]))
    return report.section("How the surface parameters moved", *blocks)


def _percent(sd: float) -> str:
    return f"(± {100 * sd:.2g} %)" if np.isfinite(sd) and sd < 1.0 else "(–)"


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "–"
