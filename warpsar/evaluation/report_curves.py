"""report.html where a scene has curves: each drawn beside its model, with its residual, and the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.compare.curve import CurveComparison, CurveJudgement
from warpsar.curves.metrics import decibels
from warpsar.io import figures
from warpsar.io import html as report

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN_DB = 50.0  # under a curve's peak
MOST_DRAWN = 24  # curves; the table has all
COLUMNS = (
    "curve",
    "role",
    "model [mean |dB|]",
    "constant level",
    "smooth curve",
    "correlation",
    "level [dB]",
    "deviance",
    "independent directions",
)


def figure_of(one: CurveComparison, before: CurveComparison | None = None) -> Figure:
    """RCS [dBsm] over azimuth, measured, modelled and smooth, and the residual in standard deviations below it."""
    order = np.argsort(one.seen.azimuth_deg, kind="stable")
    azimuth = one.seen.azimuth_deg[order]
    figure, (upper, lower) = figures.new(6.4, 4.2, nrows=2, sharex=True, height_ratios=(3, 1))
    upper.plot(azimuth, decibels(one.measured)[order], color="black", lw=1.1, label="measured")
    upper.plot(azimuth, decibels(one.without_physics["smooth"])[order], color="0.6", lw=0.9, label="smooth curve")
    if before is not None:
        upper.plot(azimuth, decibels(before.simulated)[order], color="tab:blue", lw=0.9, ls=":", label="before")
    upper.plot(azimuth, decibels(one.simulated)[order], color="tab:red", lw=0.9, label="model")
    high = float(decibels(one.measured).max())
    upper.set_ylim(high - SHOWN_DB, high + 4.0)
    upper.set_ylabel("RCS [dBsm]")
    upper.legend(frameon=False, fontsize=8, ncols=4)
    lower.axhspan(-2.0, 2.0, color="0.92", zorder=0)
    lower.plot(azimuth, one.residual[order], color="tab:red", lw=0.8)
    lower.set_ylim(-7.5, 7.5)
    lower.set_ylabel("residual [sd]")
    lower.set_xlabel("azimuth [deg]")
    for panel in (upper, lower):
        panel.grid(alpha=0.3)
    return figure


def curves_section(
    curves: Sequence[CurveComparison],
    verdicts: Mapping[str, CurveJudgement],
    before: Sequence[CurveComparison] = (),
) -> str:
    """Verdicts, pictures and numbers of all curves. `before` is another model of the same curves."""
    named = {"train": "On the train curves", "test": "On the test curves, to which no noise was fitted"}
    paragraphs = [report.paragraph(f"{named[role]}: {one.words}.") for role, one in verdicts.items()]
    explained = (
        "The residual is in standard deviations of the noise: 95 % lie in the grey band where the model is right. "
        "The noise was fitted to the train curves, unless the scene states it. Rows count for their share of an "
        "independent direction. A constant level and a smooth curve know no physics, and were fitted to the very curve "
        "that they stand beside."
    )
    first = {one.name: one for one in before}
    drawn = [
        report.drawing(figure_of(one, first.get(one.name)), f"{one.name}, {one.role}") for one in curves[:MOST_DRAWN]
    ]
    if len(curves) > MOST_DRAWN:
        explained += f" The first {MOST_DRAWN} of {len(curves)} curves are drawn."
    rows = []
    for one in curves:
        entry = one.content()
        errors = entry["error_db"]
        cells = [*(errors[key] for key in ("model", "null", "smooth")), entry["correlation"], entry["level_db"]]
        counted = f"{entry['deviance']:.2f}", f"{entry['independent_directions']:.0f}"
        rows.append([one.name, one.role, *(f"{cell:.2f}" for cell in cells), *counted])
    return report.section(
        "Measured and modelled curves",
        *paragraphs,
        report.paragraph(explained, quiet=True),
        report.row(*drawn, across=2, least_px=300),
        report.table(COLUMNS, rows),
    )


def write_curves_report(
    path: Path,
    title: str,
    curves: Sequence[CurveComparison],
    verdicts: Mapping[str, CurveJudgement],
    content: Mapping[str, Any],
    command: Sequence[str],
    *,
    before: Sequence[CurveComparison] = (),
    words: Sequence[str] = (),
    beside: str,
) -> None:
    """The page of a scene that has curves and no images. `content` is that of the command's JSON, `words` what it
    found."""
    summary = f"{' '.join(command[:2])} {content['version']}; {len(curves)} curves, on {content['device']}"
    found = [report.section("In short", *map(report.paragraph, words))] if words else []
    sections = [
        *found,
        curves_section(curves, verdicts, before),
        report.reproduce(dict(content), command, f"Beside this file: {beside}."),
    ]
    report.write(path, report.page(title, summary, *sections))
