"""How well views are predicted that no fit has seen, beside rivals that need no physics: in evaluate's report."""

from __future__ import annotations

from collections.abc import Sequence

from warpsar.compare.prediction import PredictedImage, Summary, advantage, summaries
from warpsar.io import html as report

NAMES = {
    "model": "this model",
    "before": "the model before",
    "box": "a box of its size, same effects",
    "nearest": "nearest measured view, turned",
    "mirrored": "nearest mirrored view, turned",
    "mean": "mean of the measured views",
}


def prediction_table(rows: Sequence[Summary]) -> str:
    """One row for each set, incidence and prediction."""
    cells = [
        [
            "unseen sector" if row.in_sector else "between train views",
            f"{90.0 - row.incidence_deg:.1f}°",
            row.views,
            NAMES[row.prediction],
            f"{row.correlation:.3f}",
            f"{row.best:.3f}",
            f"{row.deviance:.3f}",
        ]
        for row in rows
    ]
    head = ("views", "depression", "images", "prediction", "correlation", "at its best shift", "deviance")
    return report.table(head, cells)


def prediction_section(images: Sequence[PredictedImage]) -> str:
    """The test views of a scene whose aim points are found."""
    ahead = advantage(images)
    said = [] if ahead is None else [f"{ahead.words[0].upper()}{ahead.words[1:]}.".replace("+-", "±")]
    said.append(
        "Each test view is compared at the best shift within the reach of aim_point. The correlation is that of fourth "
        "roots of power that was smoothed by 1.5 pixels. A model has the shift of its own least loss, a measured rival "
        "that of the best correlation. The deviance is that of one look; speckle leaves 1."
    )
    return report.section(
        "Prediction of views not seen", *map(report.paragraph, said), prediction_table(summaries(images))
    )
