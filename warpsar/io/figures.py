"""Figures of a run, with units: small PNGs through matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpsar.io.images import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save(figure: Figure, path: Path) -> None:
    """Write the figure, atomically."""
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=110)


def new(width: float = 7.0, height: float = 4.5, **subplots: Any) -> tuple[Figure, Any]:
    """A figure that needs no display, and its axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(**subplots)


def convergence(path: Path, history: Sequence[dict[str, Any]]) -> None:
    """Loss over the best one seen, and deviance of train and test views, against iterations."""
    figure, (upper, lower) = new(7.0, 6.0, nrows=2, sharex=True)
    iteration = [row["iteration"] for row in history]
    best = min(row["loss"] for row in history)
    starts = sorted({row["start"] for row in history})
    for start in starts:
        rows = [row for row in history if row["start"] == start]
        upper.plot(
            [r["iteration"] for r in rows],
            [max(r["loss"] - best, 1e-4) for r in rows],
            ".-",
            label=f"start {start + 1}",
        )
    upper.set_yscale("log")
    upper.set_ylabel("loss above the best [log-likelihood]")
    if len(starts) > 1:
        upper.legend(frameon=False)
    for role, style in (("train", "-"), ("test", "--")):
        key = f"{role}_deviance"
        if key in history[0]:
            lower.plot(iteration, [row[key] for row in history], style, label=f"{role} views")
    lower.axhline(1.0, color="0.6", lw=0.8)
    lower.set_yscale("log")
    lower.set_ylabel("deviance / speckle floor")
    lower.set_xlabel("iteration")
    lower.legend(frameon=False)
    for axis in (upper, lower):
        axis.grid(alpha=0.3, which="both", lw=0.4)
    save(figure, path)
