"""What became of the values that the scene knows to a tolerance, when effects were added."""

from __future__ import annotations

from typing import Any

from warpsar.diagnosis.found import Diagnosis
from warpsar.learning.identify import Identified, identify
from warpsar.learning.pull import leaving, pulls


def leaves_tolerance(diagnosis: Diagnosis) -> list[str]:
    """The values that the images pull out of what the scene knows of them, in the final model."""
    problem, x = diagnosis.final.problem, diagnosis.final.x
    return leaving(pulls(problem, x, identify(problem, x) if problem.uniform else None)) if problem.prior.known else []


def known_content(diagnosis: Diagnosis, identified: Identified) -> dict[str, Any]:
    """For diagnosis.json: each known value in the declared model and in the final one; `identified` is the final's."""
    first, last = diagnosis.declared, diagnosis.final
    uniform = first.problem.uniform  # beside fields no standard deviations are given
    after = pulls(last.problem, last.x, identified if uniform else None)
    before = after
    if after and first is not last:
        before = pulls(first.problem, first.x, identify(first.problem, first.x) if uniform else None)
    standing = {one.label: one for one in before}  # what an absent object was made of is gone
    pairs = [(standing[one.label], one) for one in after if one.label in standing]
    return {
        "tolerances": {b.label: {"before": a.content(), "after": b.content()} for a, b in pairs},
        "leaves_tolerance": leaving(after),
    }


def known_rows(content: dict[str, Any]) -> list[list[str]]:
    """A row of the report's table for each known value."""
    rows = []
    for label, one in content["tolerances"].items():
        before, after = one["before"], one["after"]
        unit = "" if after["unit"] == "1" else f" [{after['unit']}]"
        alone = "–" if after["data"] is None else _with_error(after["data"], after["data_sd"])
        values = [_with_error(each["posterior"], each["posterior_sd"]) for each in (before, after)]
        pull = [f"{each['pull']:+.1f}" for each in (before, after)]
        known = _with_error(after["prior"], after["prior_sd"])
        rows.append([f"{label}{unit}", known, values[0], pull[0], values[1], pull[1], alone, tension_words(after)])
    return rows


KNOWN_HEAD = ["known to a tolerance", "as", "before", "pull", "after", "pull", "the images alone", "from what is known"]

KNOWN_CAPTION = (
    "Pull: found less known, in standard deviations of the tolerance. The images alone: where they would lead without "
    "this tolerance, to first order. The last column is in standard deviations of both together; beyond 3 the value "
    "leaves its tolerance."
)


def tension_words(one: dict[str, Any]) -> str:
    """For a cell of a table, of `Pull.content`."""
    tension = "–" if one["tension"] is None else f"{one['tension']:+.1f} sd"
    return f"{tension}: leaves it" if one["alarm"] else tension


def _with_error(value: float, error: float | None) -> str:
    return f"{value:.4g}" if error is None else f"{value:.4g} ± {error:.2g}"
