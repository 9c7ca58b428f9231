"""report.html of `warpsar rcs`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.coherent.rcs import Rcs
from warpsar.io import html as report

CAPTIONS = {
    "rcs.png": "RCS over the angle. Darker: the spacing of the tubes; lighter: the 95 % interval, where there is one",
    "rcs_polar.png": "The same around the body [dBsm]",
    "range_profile.png": "Power over range, one line for each direction",
    "isar.png": "Image of the body, of even steps of frequency and azimuth",
}


def write_report(out: Path, found: Rcs, content: dict[str, Any], command: Sequence[str]) -> None:
    """`content` is that of rcs.json, `command` the words that made it; the pictures that it names lie in `out`."""
    decibels = found.rcs_dbsm
    columns = ["frequency [GHz]", "polarization", "median [dBsm]", "highest [dBsm]", "at azimuth", "at incidence"]
    rows = []
    for f, frequency in enumerate(found.frequency_hz):
        for p, polarization in enumerate(found.polarizations):
            values = decibels[:, :, f, p]
            a, i = np.unravel_index(values.argmax(), values.shape)
            azimuth, incidence = found.azimuth_deg[a], found.incidence_deg[i]
            levels = [f"{np.median(values):.1f}", f"{values[a, i]:.1f}"]
            rows.append([f"{frequency / 1e9:g}", polarization, *levels, f"{azimuth:g}°", f"{incidence:g}°"])
    _, _, f, p = (int(one) for one in np.unravel_index(decibels.argmax(), decibels.shape))
    best = rows[f * len(found.polarizations) + p]
    summary = (
        f"warpsar rcs {content['version']}; directions: {content['directions']}, frequencies: {len(found.frequency_hz)}"
    )
    highest = f"Highest: {best[3]} dBsm in {best[1]} at {best[0]} GHz, from azimuth {best[4]} and incidence {best[5]}."
    widths = content["interval"]["width_db"]
    interval = "No interval for the whole value: it is known for bodies of bare metal in HH and VV alone."
    if widths is not None:
        interval = f"The 95 % interval of a value is {widths['median']:.1f} dB wide in the median."
    pictures = {
        name: report.picture((out / name).read_bytes(), words)
        for name, words in CAPTIONS.items()
        if name in content["files"]
    }
    first, *others = pictures.values()
    beside = ", ".join(name for name in content["files"] if name != "report.html")
    sections = [
        report.section("In short", report.paragraph(highest), report.paragraph(interval), first),
        *([report.section("Warnings", report.bullets(content["warnings"]))] if content["warnings"] else []),
        report.section("More pictures", *others),
        report.section("Levels over all directions", report.table(columns, rows)),
        report.reproduce(content, command, f"Beside this file: {beside}."),
    ]
    report.write(out / "report.html", report.page("Radar cross-section", summary, *sections))
