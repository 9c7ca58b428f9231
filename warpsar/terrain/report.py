"""report.html of `warpsar twin`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpsar.io import html as report
from warpsar.terrain.comparison import TerrainComparison
from warpsar.terrain.differences import TerrainDifferences
from warpsar.terrain.summary import TwinSummary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAID = {
    "image.png": "On the product's grid: lines downward, pixels to the right. Blue: no ground, or nothing is seen",
    "map.png": "On the map",
    "comparison.png": "Cells of the measured and the simulated image, and what is left, less its median",
    "differences.png": "Cells of the measured image less the model [dB], without and with what was found",
}
LIMITS = (
    "One bounce, surfaces of the library at their median levels. No trees, and no speckle.",
    "Places are those of orbit and annotation. Atmosphere, tides and the product's own timing are not corrected.",
    "At the near edge of the elevation model nothing throws a shadow from outside of it.",
    "A ray to the radar starts at the middle of each piece of a facet: borders of shadow are right to about half a "
    "pixel.",
)


def write_report(
    path: Path,
    said: TwinSummary,
    against: TerrainComparison | str | None,
    differs: TerrainDifferences | str | None,
    drawn: Mapping[str, Figure],
    content: dict[str, Any],
    command: Sequence[str],
) -> None:
    """`content` is that of twin.json, `command` the words that made it."""
    lead = f"warpsar twin {content['version']}; {content['product']}, {content['acquired'][:19]} UTC"
    pictures = {name: report.picture(_png(figure), SAID[name]) for name, figure in drawn.items()}
    compared = [report.paragraph(_sentence(each)) for each in words_of(against)]
    if against is not None:
        compared += [pictures.pop("comparison.png")] if "comparison.png" in pictures else []
    differences = [report.paragraph(_sentence(each)) for each in words_of(differs)]
    if isinstance(differs, TerrainDifferences):
        columns = ["hypothesis", "value", "95 %, low", "95 %, high", "unit", "2 ln L on the other half", "named"]
        rows = [
            [one.name, f"{one.value:+.2f}", f"{one.low:+.2f}", f"{one.high:+.2f}", one.unit, f"{one.gain:.0f}",
             "yes" if one.named else "no: expected"]
            for one in differs.found
        ]  # fmt: skip
        differences += [pictures.pop("differences.png")]
        if rows:
            differences.append(report.table(columns, rows, "Chosen in half of the squares, confirmed in the other"))
        differences += [report.paragraph(f"Asked: {', '.join(differs.asked)}.")]
    rows = [[one.name, one.unit, *(f"{value:.4g}" for value in one.percentiles), one.words] for one in said.layers]
    columns = ["layer", "unit", "5 %", "median", "95 %", "what it is"]
    facts = [
        (name.replace("_", " "), str(content[name]))
        for name in (
            *("platform", "polarization", "frequency_hz", "look_side", "elevation_model", "vertical_datum", "surfaces"),
            *("landcover", "buildings", "pixels", "first_line", "first_pixel"),
        )
    ]
    sections = [
        report.section("In short", *(report.paragraph(_sentence(each)) for each in said.words)),
        *([report.section("Measured beside simulated", *compared)] if compared else []),
        *([report.section("What differs", *differences)] if differences else []),
        report.section("Pictures", *pictures.values()),
        report.section("Layers", report.table(columns, rows, "Percentiles over the pixels with ground", (5,))),
        report.section("What is left out", report.bullets(LIMITS)),
        report.section("Product", report.facts(facts)),
        report.reproduce(content, list(command) or ["warpsar", "twin"], f"Beside this file: {_beside(content)}."),
    ]
    report.write(path, report.page("What the product should show", lead, *sections))


def words_of(answer: TerrainComparison | TerrainDifferences | str | None) -> list[str]:
    """What an answer says, a line each; nothing where there is none."""
    if answer is None:
        return []
    return [answer] if isinstance(answer, str) else list(answer.words)


def _sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}."


def _beside(content: dict[str, Any]) -> str:
    return ", ".join(["twin.json", *(name for name in content["files"] if name != "report.html")])


def _png(figure: Figure) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return stream.getvalue()
