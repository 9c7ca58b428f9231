"""Figures and tables of `rcs.py`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tables
from rcs_curves import Work

from warpsar.curves.metrics import decibels
from warpsar.curves.observed import ObservedCurve
from warpsar.io import figures

TITLES = {
    "pec_plate": "metal plate",
    "dielectric_plate": "dielectric plate",
    "box_closed": "closed box",
    "box_cobra": "box with the cobra duct",
    "box_cylinder": "box with the cylindrical duct",
}
SHOWN_DB = 50.0


def body(out: Path, work: Work, final: Sequence[ObservedCurve], predict: Callable[[ObservedCurve], Any]) -> None:
    """RCS against phi: measured, declared and final.

    A panel for each frequency and polarization of the first measurement.
    """
    pairs = [(d, f) for file, d, f in zip(work.files, work.curves, final, strict=True) if file.first]
    frequencies = sorted({round(d.frequency_hz / 1e9, 2) for d, _ in pairs})
    figure, panels = figures.new(
        9.0, 1.9 * len(frequencies) + 0.8, nrows=len(frequencies), ncols=2, sharex=True, squeeze=False
    )
    for declared, one in pairs:
        row, column = frequencies.index(round(one.frequency_hz / 1e9, 2)), ("VV", "HH").index(one.polarization)
        panel, phi = panels[row, column], 90.0 - one.azimuth_deg
        order = np.argsort(phi)
        gap = np.where(np.diff(phi[order], prepend=phi[order][0]) > 1.5, np.nan, 0.0)  # saturated angles are left out
        high = decibels(one.measured_m2).max()
        lines = (
            ("measured", one.measured_m2, "black", 1.2, "-"),
            ("declared: single bounces", np.abs(declared.amplitude(["single"])) ** 2, "tab:blue", 0.8, ":"),
            ("final", predict(one), "tab:red", 0.9, "-"),
        )
        for label, power, colour, width, style in lines:
            panel.plot(phi[order], decibels(power)[order] + gap, color=colour, lw=width, ls=style, label=label)
        if len(work.normals):
            seen = phi[work.sector(one, "aperture")]
            panel.axvspan(seen.min(), seen.max(), color="0.92", zorder=0)
        panel.set_ylim(high - SHOWN_DB, high + 4.0)
        panel.set_title(f"{one.frequency_hz / 1e9:.4g} GHz, {one.polarization}, {one.role}", fontsize=9)
        panel.grid(alpha=0.3)
        panel.set_ylabel("RCS [dBsm]")
    panels[0, 0].legend(frameon=False, fontsize=7)
    for panel in panels[-1]:
        panel.set_xlabel("phi [deg]")
    figures.save(figure, out / f"rcs_{work.body.key}.png")


def tables_of(result: Mapping[str, Any]) -> dict[str, str]:
    """The three tables of docs/measured-record.md."""
    return {"rcs.verdicts": verdicts(result), "rcs.errors": errors(result), "rcs.learned": learned(result)}


def verdicts(result: Mapping[str, Any]) -> str:
    """What was asked in each sector, and the answer."""
    rows = []
    for key, entry in result["bodies"].items():
        for sector, asked in entry.get("asked", {}).items():
            rows += [_asked(TITLES[key], sector, one) for one in asked if one["outcome"] != "not testable"]
        for name, one in entry["learned"].get("offered", {}).items():
            rows.append(_asked(f"{TITLES[key]}, offered {name}", "aperture", one))
    header = ("body", "sector", "effect", "factor", "2 ln L", "price", "test curves", "VV", "HH",
              "over a constant level", "over a smooth curve", "answer")  # fmt: skip
    return tables.markdown(header, rows)


def _asked(title: str, sector: str, one: Mapping[str, Any]) -> tuple[Any, ...]:
    gains = {each["name"]: f"{each['gain']:.0f} ± {each['error']:.0f}" for each in one["left_out"]}
    over = one["over_rivals"]
    return (
        title, sector, one["effect"], f"{one['factor']:.2f}", f"{one['gain']:.0f}", f"{one['price']:.0f}",
        *(gains.get(name, "") for name in ("test", "VV", "HH")),
        f"{over['constant level']:.0f}", f"{over['smooth curve']:.0f}",
        one["outcome"] if not one["why"] else f"{one['outcome']}: {one['why']}",
    )  # fmt: skip


def errors(result: Mapping[str, Any]) -> str:
    """Mean abs(dB) of every row."""
    rows = []
    for key, entry in result["bodies"].items():
        for r in entry["rows"]:
            e, c = r["error_db"], r["correlation"]
            numbers = [e.get(name) for name in ("declared", "amplitude", "final", "null", "smooth")]
            head = (TITLES.get(key, key), f"{r['frequency_hz'] / 1e9:.4g}", r["polarization"], r["role"], r["sector"])
            rows.append((*head, r["angles"], *(_number(n) for n in numbers), _number(c.get("final"))))  # fmt: skip
    header = (
        *("body", "GHz", "pol.", "role", "sector", "angles", "declared", "amplitude", "final", "constant level"),
        *("smooth curve", "correlation of dB"),
    )
    return tables.markdown(header, rows)


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.2f}"


def learned(result: Mapping[str, Any]) -> str:
    """What was learned, with intervals, beside what is stated."""
    rows: list[tuple[str, ...]] = []
    found = {key: entry["learned"] for key, entry in result["bodies"].items()}
    if "duct" in (box := found.get("box_cylinder", {})):
        for name, one in box["duct"].items():
            stated = [f"{box['dimensions'][which][name] * 1e3:.2f}" for which in ("drawing", "model")]
            rows.append((f"cylindrical duct, {name} [mm]", *stated, *_interval(one, 1e3)))
    if "plate" in (plate := found.get("dielectric_plate", {})):
        stated_of = {"product_mm": f"{plate['stated']['product_mm']:.3f}", "eps_r": "2.61", "gain_db": "none"}
        names = {"product_mm": "(eps_r - 1) x thickness [mm]", "eps_r": "eps_r", "gain_db": "calibration [dB]"}
        for name, one in plate["plate"].items():
            rows.append((f"dielectric plate, {names[name]}", stated_of[name], "none", *_interval(one, 1.0)))
    for key, one in found.items():
        for pol, noise in one.get("noise", {}).items():
            words = f"{noise['background_dbsm']:.1f} dBsm, {noise['error_db']:.2f} dB"
            rows.append((f"{TITLES.get(key, key)}, background and error, {pol}", "none", "none", words, ""))
        for file, missing in one.get("saturation_db", {}).items():
            if missing > 1.0:
                rows.append(
                    (
                        f"{TITLES[key]}, {file}: short of the model at phi = 90 [dB]",
                        "none",
                        "none",
                        f"{missing:.1f}",
                        "",
                    )
                )
        if one.get("spurious"):
            hump = one["spurious"]
            level = f"{hump['level_dbsm'][0]:.0f} to {hump['level_dbsm'][1]:.0f} dBsm"
            what = f"{TITLES.get(key, key)}, spurious hump [deg of phi]"
            rows.append((what, "none", "none", f"{hump['phi_deg']:.1f}", level))
    return tables.markdown(("what", "drawing or text", "model", "measured", "95 % interval"), rows)


def _interval(one: Mapping[str, Any], scale: float) -> tuple[str, str]:
    low, high = (end * scale for end in one["interval_95"])
    return f"{one['value'] * scale:.2f}", f"{low:.2f} to {high:.2f}" + (" (the grid's end)" if one["open"] else "")
