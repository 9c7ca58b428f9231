"""Tables of sigma0 that `warpsar learn` has adapted, in its report: drawn over incidence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from warpsar.io import html as report
from warpsar.learning.table import figure_of_table


def tables_section(content: Mapping[str, Any]) -> list[str]:
    """A section, or none where `content`, that of learn.json, has no learned table."""
    tables = content.get("learned_tables", {})
    if not tables:
        return []
    said = (
        "What the images changed of the tables. Bands are 95 % intervals, if the model is right. Away from the "
        "incidences seen, a table stays as given."
    )
    figures = [
        report.drawing(figure_of_table(name, told), f"sigma0 of {name} over local incidence, before and after")
        for name, told in tables.items()
    ]
    return [
        report.section("Learned tables of sigma0", report.paragraph(said), report.row(*figures, across=2, least_px=300))
    ]
