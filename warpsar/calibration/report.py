"""report.html of `warpsar reflectors`: map, table, time series, causes, and cut-outs beside their prediction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.calibration.explain import Explanation
from warpsar.calibration.figures import incidence_figure, map_figure, offset_figure, series_figure
from warpsar.calibration.forecast import Forecast
from warpsar.calibration.geolocation import Geolocation
from warpsar.calibration.joint import values_words
from warpsar.calibration.measure import Cutout, ReflectorObservation
from warpsar.calibration.table import row
from warpsar.io import html as report
from warpsar.io.grey_scale import GreyScale, in_decibel
from warpsar.io.html_image import ImageAxis, image

F64 = NDArray[np.float64]
MOST_SITES, MOST_CUTOUTS, MOST_ROWS = 24, 12, 400
SHOWN_CELLS = 6.0
"""Resolution cells to each side that a cut-out shows."""
TABLE = {
    "id": "id",
    "date": "date",
    "polarization": "pol.",
    "status": "status",
    "line": "line",
    "pixel": "pixel",
    "azimuth_offset_m": "azimuth offset [m]",
    "range_offset_m": "range offset [m]",
    "incidence_deg": "incidence [deg]",
    "off_boresight_deg": "off boresight [deg]",
    "rcs_dbsm": "RCS [dBsm]",
    "rcs_low_dbsm": "from",
    "rcs_high_dbsm": "to",
    "predicted_dbsm": "predicted [dBsm]",
    "difference_db": "difference [dB]",
    "scr_db": "SCR [dB]",
    "irw_azimuth_m": "IRW azimuth [m]",
    "irw_range_m": "IRW range [m]",
    "pslr_azimuth_db": "PSLR azimuth [dB]",
    "pslr_range_db": "PSLR range [dB]",
    "islr_azimuth_db": "ISLR azimuth [dB]",
    "islr_range_db": "ISLR range [dB]",
    "phase_deg": "phase [deg]",
}


def write_report(
    path: Path,
    observations: Sequence[ReflectorObservation],
    explanation: Explanation,
    placed: Geolocation | None,
    content: dict[str, Any],
    command: Sequence[str],
    *,
    held_back: Forecast | None = None,
    title: str = "Reflectors: measured and predicted",
    beside: str = "reflectors.csv (all columns), reflectors.json, sites_isce3.csv (the table of sites for ISCE3)",
) -> None:
    """`content` is that of reflectors.json, `command` the words that made it."""
    sites = dict.fromkeys(one.site.name for one in observations)
    dates = {str(one.date)[:10] for one in observations}
    summary = f"warpsar reflectors {content['version']}; reflectors {len(sites)}, dates {len(dates)}"
    sections = [
        _summary(observations, explanation, placed, content, held_back),
        _series(observations, explanation, held_back),
        _held_back(held_back),
        _together(explanation),
        _causes(explanation),
        _cutouts(observations),
        _table(observations),
        report.reproduce(content, list(command) or ["warpsar", "reflectors"], f"Beside this file: {beside}."),
    ]
    report.write(path, report.page(title, summary, *(each for each in sections if each)))


def _summary(
    observations: Sequence[ReflectorObservation],
    explanation: Explanation,
    placed: Geolocation | None,
    content: dict[str, Any],
    held_back: Forecast | None,
) -> str:
    sentences = [str(one["words"]) for one in (*content.get("found", ()), *content.get("presence", ()))]
    foretold = () if held_back is None else held_back.words
    words = [report.paragraph(each) for each in (*sentences, *explanation.words, *foretold)]
    if placed is not None:
        words.append(report.paragraph(placed.words))
        if placed.moved:
            words.append(report.paragraph(f"Off where the others say that the image is: {', '.join(placed.moved)}."))
    problems = [
        f"{one.site.name}, {str(one.date)[:10]}: {one.status}: {one.reason}"
        for one in observations
        if one.status != "measured"
    ]
    problems += list(content.get("refused", []))
    drawings = []
    if observations:
        drawings.append(report.drawing(map_figure(observations, explanation), "Where the reflectors stand"))
    if explanation.differences is not None:
        drawings.append(report.drawing(incidence_figure(observations, explanation), "Difference against incidence"))
    if any(one.offset_m is not None for one in observations):
        drawings.append(report.drawing(offset_figure(observations), "Found less expected place"))
    shown = problems[:MOST_SITES] + ([f"and {len(problems) - MOST_SITES} more"] if len(problems) > MOST_SITES else [])
    return report.section(
        "In short",
        *words,
        *([report.bullets(shown)] if shown else []),
        report.row(*drawings, across=3, least_px=300),
    )


def _series(observations: Sequence[ReflectorObservation], explanation: Explanation, held_back: Forecast | None) -> str:
    by_site: dict[str, list[ReflectorObservation]] = {}
    for one in observations:
        if one.calibrated:
            by_site.setdefault(one.site.name, []).append(one)
    if not by_site:
        return ""
    drawn = [
        report.drawing(series_figure(some, explanation, held_back), f"{name}: RCS over time")
        for name, some in list(by_site.items())[:MOST_SITES]
    ]
    text = (
        "Bars are 90 % intervals of clutter and noise. A short line is the prediction for the look of that date. A "
        "cross marks a bad date, a triangle the upper bound where nothing stands out of the clutter."
    )
    if held_back is not None:
        text += f" From {held_back.since} on, wide grey bars are what the earlier dates foretell with 90 %."
    return report.section(
        "RCS over time", report.paragraph(text, quiet=True), report.row(*drawn, across=2, least_px=340)
    )


def _held_back(found: Forecast | None) -> str:
    if found is None or not found.values:
        return ""
    text = (
        "Places, set-up dates, bad dates and causes are found from the earlier dates alone. Causes together, each "
        "cause alone, and both rivals foretell the later values; they are averaged by their odds. The last two "
        "columns are the rival's: the mean level of this reflector and pass."
    )
    rows = []
    for one in found.values[:MOST_ROWS]:
        point, seen = one.observation.point, one.observation.status == "measured"
        assert point is not None
        value = f"{10 * np.log10(point.rcs_m2):.2f}" if seen else f"at most {10 * np.log10(point.high_m2):.2f}"
        rows.append(
            [
                one.observation.site.name, str(one.observation.date)[:10], value, f"{one.foretold_dbsm:.2f}",
                f"{one.low_dbsm:.2f} to {one.high_dbsm:.2f}", "yes" if one.inside else "no",
                f"{one.level_low_dbsm:.2f} to {one.level_high_dbsm:.2f}", "yes" if one.level_inside else "no",
            ]
        )  # fmt: skip
    columns = [
        "id", "date", "RCS [dBsm]", "foretold [dBsm]", "90 % interval", "inside", "by a level alone", "inside",
    ]  # fmt: skip
    return report.section(
        f"Held back: dates from {found.since} on", report.paragraph(text, quiet=True), report.table(columns, rows)
    )


def _together(explanation: Explanation) -> str:
    found = explanation.joint
    if found is None:
        return ""
    rows = []
    for one in found.causes:
        none = "not confirmed" if found.held_dates else "not tried"
        held = none if one.held_gain is None else f"{one.held_gain:+.1f}"
        held += f" ± {one.held_error:.1f}" if one.held_error is not None and np.isfinite(one.held_error) else ""
        words = values_words(one.cause, one.values, one.low, one.high)
        rows.append([one.cause.title, words, f"{one.gain:+.1f}", held])
    text = (
        "Causes are added one after the other while the earlier dates need them and the later ones, which do not "
        "choose, become more likely; each is then asked again beside the others. Intervals of 90 % let the other "
        "causes move, and hold all that could stand for them. Of the scatter that is left, "
        f"{found.scatter.value:.2f} dB are of each value and {found.scatter.image:.2f} dB of each image."
    )
    blocks = [report.paragraph(text, quiet=True)]
    if rows:
        later = f"ln L of the {found.held_dates} later dates" if found.held_dates else "ln L of later dates"
        blocks.append(
            report.table(["cause", "at its best, with the others", "ln L that it adds", later], rows, "", (0, 1))
        )
    else:
        blocks.append(report.paragraph("No cause is needed."))
    if found.stands:
        stands = [
            [one.cause, one.other, f"{one.bic:+.1f}", one.decided_by or "nothing that is known", f"{one.apart:.2g}"]
            for one in found.stands[:MOST_SITES]
        ]
        blocks += [
            report.heading("What could stand for what"),
            report.table(["in place of", "could stand", "BIC", "decided by", "then apart [dB]"], stands, "", (1, 3)),
        ]
    if found.together:
        pairs = [f"{a} and {b}: correlation {c:+.2f}" for a, b, c in found.together]
        blocks += [report.heading("Known together only"), report.bullets(pairs)]
    if explanation.attitudes:
        turns = [
            [
                one.site, str(one.passes), f"{one.turn_deg:.0f}, {one.tilt_deg:.0f}",
                f"{one.turn_range_deg[0]:.1f} to {one.turn_range_deg[1]:.1f}",
                f"{one.tilt_range_deg[0]:.1f} to {one.tilt_range_deg[1]:.1f}",
                f"{one.least_deg[0]:.0f}, {one.least_deg[1]:.0f}",
            ]
            for one in explanation.attitudes
        ]  # fmt: skip
        columns = ["id", "passes", "best turn, tilt [deg]", "turn [deg]", "tilt [deg]", "nearest to the survey [deg]"]
        blocks += [report.heading("All attitudes that fit"), report.table(columns, turns)]
    return report.section("What the difference means: causes together", *blocks)


def _causes(explanation: Explanation) -> str:
    if not explanation.fitted:
        return ""
    lowest = explanation.fitted[0].bic
    rows = []
    for one in explanation.fitted:
        values = values_words(one.cause, one.values, one.low, one.high)
        held = "" if one.held_log_likelihood is None else f"{one.held_log_likelihood:.2f}"
        rows.append([one.cause.title, values, f"{one.scatter_db:.2f}", f"{one.bic - lowest:.1f}", held])
    tied = [
        f"{one.first} and {one.second}: "
        + (f"decided by {one.decided_by} ({one.apart_db:.2g} dB apart)" if one.decided_by else "nothing known decides")
        for one in explanation.tied
    ]
    bad = [f"{one.site}, {one.date}: {one.words}" for one in explanation.bad_dates]
    text = (
        "Each cause alone, at its best, with 90 % intervals; the values of bad dates are left out. BIC counts misfit "
        "and parameters: 4.6 more is odds of 1 to 10. The last column is how likely the later third of the dates is "
        "under a fit to the earlier ones; higher is better."
    )
    columns = ["cause", "at its best", "left per date [dB]", "BIC over the best", "later dates [log-likelihood each]"]
    blocks = [report.paragraph(text, quiet=True), report.table(columns, rows, "", (0, 1))]
    if tied:
        blocks += [report.heading("What cannot be told apart here, and what would decide"), report.bullets(tied)]
    if bad:
        blocks += [report.heading("Bad dates"), report.bullets(bad)]
    return report.section("What the difference means: each cause alone", *blocks)


def _cutouts(observations: Sequence[ReflectorObservation]) -> str:
    used = [one for one in observations if one.cutout is not None and one.calibrated]
    if not used:
        return ""
    chosen = [used[i] for i in np.unique(np.linspace(0, len(used) - 1, min(MOST_CUTOUTS, len(used))).astype(int))]
    chosen = [_near(one) for one in chosen]
    pairs = [(one, one.cutout.power, predicted_power(one)) for one in chosen if one.cutout is not None]
    scale = GreyScale.of([power for _, measured, model in pairs for power in (measured, model)])
    cells = []
    for one, measured, model in pairs:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = 10.0 * np.log10(measured / model)
        name = ", ".join(filter(None, (one.site.name, str(one.date)[:10], one.polarization)))
        name += "" if one.status == "measured" else f", {one.status}"
        axes = _axes(one)
        for power, what in ((measured, "measured"), (model, "predicted")):
            grey = report.colour(scale.grey(in_decibel(power)), "gray", 0.0, 1.0)
            cells.append(image(report.png(grey), f"{name}: {what}", *axes))
        cells.append(image(report.png(report.colour(ratio, "RdBu_r", -15.0, 15.0)), f"{name}: residual", *axes))
    keys = report.beta0_scale(scale) + report.scale("RdBu_r", ["−15", "0", "+15 dB"], "measured / predicted")
    text = (
        "The prediction is the response of the stated bandwidth with the predicted RCS at the place that was found, in "
        "clutter of the mean level; of a date at which no reflector stands, clutter alone. Without a prediction it has "
        "the measured RCS. Speckle scatters the residual, further to weak than to strong, so that clutter looks blue."
    )
    return report.section(
        "Cut-outs", report.paragraph(text, quiet=True), keys, report.row(*cells, across=6, least_px=120)
    )


def _near(one: ReflectorObservation) -> ReflectorObservation:
    """With the part of its cut-out that lies within some cells of the place."""
    assert one.cutout is not None
    assert one.point is not None
    assert one.response is not None
    assert one.spacing_m is not None
    kept = []
    for at, first, count, axis, step in zip(
        (one.point.line, one.point.pixel), (one.cutout.line, one.cutout.pixel), one.cutout.power.shape, one.response,
        one.spacing_m, strict=True,
    ):  # fmt: skip
        reach = SHOWN_CELLS * max(1.0 / axis.bandwidth, axis.pixel_m) / step
        kept.append((max(int(at - reach) - first, 0), min(int(np.ceil(at + reach)) - first + 1, count)))
    (top, bottom), (left, right) = kept
    part = one.cutout.power[top:bottom, left:right]
    return replace(one, cutout=Cutout(part, one.cutout.line + top, one.cutout.pixel + left))


def predicted_power(one: ReflectorObservation) -> F64:
    """beta0 of a cut-out: the response with the predicted RCS, in clutter of the mean level."""
    assert one.cutout is not None
    assert one.point is not None
    assert one.spacing_m is not None
    assert one.response is not None
    lines, pixels = (
        np.arange(n) + first
        for n, first in zip(one.cutout.power.shape, (one.cutout.line, one.cutout.pixel), strict=True)
    )
    cuts = [
        axis.power_1_m((at - place) * step)
        for axis, at, place, step in zip(
            one.response, (lines, pixels), (one.point.line, one.point.pixel), one.spacing_m, strict=True
        )
    ]
    area = (one.predicted_m2 or max(one.point.rcs_m2, 0.0)) if one.stands else 0.0
    return np.asarray(area * cuts[0][:, None] * cuts[1] + one.point.clutter)


def _axes(one: ReflectorObservation) -> tuple[ImageAxis, ImageAxis]:
    """Azimuth (down) and slant range (along) about the expected place [m]."""
    assert one.cutout is not None
    assert one.expected is not None
    assert one.spacing_m is not None
    made = []
    for label, first, count, at, step in zip(
        ("azimuth [m]", "slant range [m]"),
        (one.cutout.line, one.cutout.pixel),
        one.cutout.power.shape,
        (one.expected.line, one.expected.pixel),
        one.spacing_m,
        strict=True,
    ):
        made.append(ImageAxis(label, (first - 0.5 - at) * step, (first + count - 0.5 - at) * step))
    return made[0], made[1]


def _table(observations: Sequence[ReflectorObservation]) -> str:
    rows = []
    for one in observations[:MOST_ROWS]:
        values = row(one)
        cells = []
        for name in TABLE:
            value = values[name]
            unknown = value is None or (isinstance(value, float) and not np.isfinite(value))
            cells.append("" if unknown else f"{value:z.2f}" if isinstance(value, float) else str(value))
        rows.append(cells)
    caption = "" if len(observations) <= MOST_ROWS else f"The first {MOST_ROWS}; reflectors.csv has all."
    return report.section("All values", report.table(list(TABLE.values()), rows, caption))
