"""How well views are predicted that no fit has seen, beside rivals that need no physics: in evaluate's report."""

from __future__ import annotations

from collections.abc import Sequence

from warpsar.compare.aim import SMOOTHED_PX
from warpsar.compare.laid import TILE, BesideMean
from warpsar.compare.prediction import PredictedImage, Summary, advantage, summaries
from warpsar.io import html as report

NAMES = {
    "model": "this model",
    "before": "the model before",
    "box": "a box of its size, same effects",
    "then": "the model that met the box",
    "nearest": "nearest measured view, turned",
    "smoothed": f"the same, smoothed by {SMOOTHED_PX:g} pixels",
    "mirrored": "nearest mirrored view, turned",
    "mean": "mean of the measured views",
    "mean_3x3": "the same, over 3 x 3 pixels",
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
    sentences = [] if ahead is None else [f"{ahead.words[0].upper()}{ahead.words[1:]}."]
    sentences.append(
        "Each test view is compared at the best shift within the reach of aim_point. The correlation is that of fourth "
        "roots of power that was smoothed by 1.5 pixels. A model has the shift of its own least loss, a measured rival "
        "that of the best correlation. The deviance is that of one look; speckle leaves 1."
    )
    return report.section(
        "Prediction of views not seen", *map(report.paragraph, sentences), prediction_table(summaries(images))
    )


def means_section(images: Sequence[BesideMean]) -> str:
    """Test views beside train views of nearly the same azimuth."""
    names = list(images[0].deviances)
    rows = [
        [
            one.view,
            one.polarization,
            one.pixels,
            *(f"{one.deviances[name]:.3f}" for name in names),
            f"{one.ahead:+.3f} ± {one.error:.3f}",
        ]
        for one in images
    ]
    text = (
        "Mean deviance over that of speckle, on the pixels that all predictions have, in shadow too; each has the gain "
        "that fits best. The measured views are the train views within 5 degrees of azimuth, as they lie on the plane "
        f"through the reference point. The lead is that over the better mean, its error comes from tiles of {TILE} "
        "pixels."
    )
    head = ("view", "polarization", "pixels", *(NAMES[name] for name in names), "lead")
    return report.section("Test views beside measured ones", report.paragraph(text), report.table(head, rows))
