"""The fit's history in evaluate's report, where `warpsar learn` left one beside the scene."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

from warpsar.errors import InputError
from warpsar.io import html as report
from warpsar.io.figures import new

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def convergence_sections(folder: Path | None) -> list[str]:
    """The fit's history, where `warpsar learn` left one beside the scene."""
    path = folder / "history.csv" if folder else None
    if path is None or not path.is_file():
        return []
    history = _history(path)
    if not history:
        return []
    figures = [
        report.drawing(_loss_figure(history), "Loss above the best one, against iterations"),
        report.drawing(_deviance_figure(history), "Deviance of the fit, in units of the speckle floor"),
    ]
    return [report.section("Convergence of the fit", report.row(*figures, across=2, least_px=300))]


def _history(path: Path) -> list[dict[str, float]]:
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            history = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(stream)]
        for row in history:
            numbers = {key: row[key] for key in ("iteration", "start", "loss", "train_deviance")}
            if not all(0 <= abs(value) < 1e100 for value in numbers.values()):
                raise ValueError(f"found {numbers}; must be finite numbers")
    except (OSError, ValueError, TypeError, KeyError, csv.Error) as error:
        raise InputError(f"{path}: not what `warpsar learn` leaves ({error}); remove it") from error
    return history


def _loss_figure(history: list[dict[str, float]]) -> Figure:
    figure, axis = new(4.6, 3.0)
    best = min(row["loss"] for row in history)
    for start in sorted({row["start"] for row in history}):
        mine = [row for row in history if row["start"] == start]
        above = [max(row["loss"] - best, 1e-4) for row in mine]
        axis.plot([row["iteration"] for row in mine], above, ".-", label=f"start {start + 1:g}")
    axis.set_yscale("log")
    axis.set_xlabel("iteration")
    axis.set_ylabel("loss above the best [log-likelihood]")
    axis.legend(frameon=False, fontsize=8)
    return figure


def _deviance_figure(history: list[dict[str, float]]) -> Figure:
    figure, axis = new(4.6, 3.0)
    for role, style in (("train", "-"), ("test", "--")):
        if f"{role}_deviance" in history[0]:
            axis.plot(
                [row["iteration"] for row in history],
                [row[f"{role}_deviance"] for row in history],
                style,
                label=f"{role} views",
            )
    axis.axhline(1.0, color="0.6", lw=0.8)
    axis.set_yscale("log")
    axis.set_xlabel("iteration")
    axis.set_ylabel("deviance / speckle floor")
    axis.legend(frameon=False, fontsize=8)
    return figure
