"""Objects before and after, in diagnose's report: in plan and in space, where objects exist or were found."""

from __future__ import annotations

from typing import Any

from warpsar.diagnosis.result import Diagnosed
from warpsar.io import html as report
from warpsar.learning.object_figures import figure_of_objects


def objects_section(done: Diagnosed, content: dict[str, Any]) -> list[str]:
    """`content` is that of diagnosis.json; nothing where no object was learned, moved, found or left out."""
    found = done.diagnosis
    told: dict[str, dict[str, Any]] = content.get("objects", {})
    figure = figure_of_objects(found.scene, found.final.scene, told)
    if figure is None:
        return []
    caption = "Objects as the scene file has them (dashed) and as they were found (red)"
    return [report.section("Objects before and after", report.drawing(figure, caption))]
