"""Observations as a table: reflectors.csv."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from warpsar.calibration.measure import ReflectorObservation
from warpsar.io.images import replacing

Value = str | float | None


def decibel(value: float | None) -> float | None:
    """10 log10; None for what is None, or not positive."""
    return None if value is None or not value > 0.0 else float(10.0 * np.log10(value))


def _of_point(name: str) -> Callable[[ReflectorObservation], Value]:
    return lambda one: None if one.point is None else getattr(one.point, name)


def _area(name: str) -> Callable[[ReflectorObservation], Value]:
    return lambda one: decibel(getattr(one.point, name)) if one.calibrated and one.point is not None else None


def _expected(name: str) -> Callable[[ReflectorObservation], Value]:
    return lambda one: None if one.expected is None else getattr(one.expected, name)


def _offset(axis: int) -> Callable[[ReflectorObservation], Value]:
    return lambda one: None if one.offset_m is None else one.offset_m[axis]


def _deviation(axis: int) -> Callable[[ReflectorObservation], Value]:
    return lambda one: None if one.offset_m is None or one.point is None else one.point.position_sd_m[axis]


def _quality(axis: int, name: str) -> Callable[[ReflectorObservation], Value]:
    return lambda one: (
        None if one.point is None or one.point.quality is None else getattr(one.point.quality[axis], name)
    )


def _off_boresight(one: ReflectorObservation) -> Value:
    known = one.facing is not None and one.expected is not None
    return one.facing.off_boresight_deg(one.expected.toward_radar) if known else None  # type: ignore[union-attr]


COLUMNS: dict[str, tuple[str, Callable[[ReflectorObservation], Value]]] = {
    "id": ("", lambda one: one.site.name),
    "date": ("", lambda one: str(one.date)[:19]),
    "platform": ("", lambda one: one.platform),
    "polarization": ("", lambda one: one.polarization),
    "status": ("", lambda one: one.status),
    "stands": ("", lambda one: "yes" if one.stands else "no"),
    "line_expected": (".3f", _expected("line")),
    "pixel_expected": (".3f", _expected("pixel")),
    "line": (".3f", _of_point("line")),
    "pixel": (".3f", _of_point("pixel")),
    "azimuth_offset_m": (".3f", _offset(0)),
    "azimuth_sd_m": (".3f", _deviation(0)),
    "range_offset_m": (".3f", _offset(1)),
    "range_sd_m": (".3f", _deviation(1)),
    "slant_range_m": (".3f", _expected("slant_range_m")),
    "incidence_deg": (".4f", _expected("incidence_deg")),
    "look_azimuth_deg": (".4f", _expected("azimuth_deg")),
    "off_boresight_deg": (".3f", _off_boresight),
    "rcs_dbsm": (".3f", _area("rcs_m2")),
    "rcs_low_dbsm": (".3f", _area("low_m2")),
    "rcs_high_dbsm": (".3f", _area("high_m2")),
    "rcs_peak_dbsm": (".3f", _area("peak_rcs_m2")),
    "predicted_dbsm": (".3f", lambda one: decibel(one.predicted_m2)),
    "closed_form_dbsm": (".3f", lambda one: decibel(one.closed_form_m2)),
    "difference_db": (".3f", lambda one: one.difference_db),
    "scr_db": (".2f", lambda one: None if one.point is None else decibel(one.point.scr)),
    "clutter_db": (".2f", lambda one: decibel(one.point.clutter) if one.calibrated and one.point is not None else None),
    "noise_db": (".2f", lambda one: one.noise_db),
    "window_share": (".4f", _of_point("window_share")),
    "phase_deg": (".2f", _of_point("phase_deg")),
    "irw_azimuth_m": (".3f", _quality(0, "width_m")),
    "irw_range_m": (".3f", _quality(1, "width_m")),
    "pslr_azimuth_db": (".2f", _quality(0, "pslr_db")),
    "pslr_range_db": (".2f", _quality(1, "pslr_db")),
    "islr_azimuth_db": (".2f", _quality(0, "islr_db")),
    "islr_range_db": (".2f", _quality(1, "islr_db")),
    "source": ("", lambda one: one.source),
    "reason": ("", lambda one: one.reason),
}


def row(one: ReflectorObservation) -> dict[str, Value]:
    """Numbers and words of an observation, under the names of the columns."""
    return {name: value(one) for name, (_, value) in COLUMNS.items()}


def write_csv(path: Path, observations: Sequence[ReflectorObservation]) -> None:
    """What is not known is an empty cell."""
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for one in observations:
            cells = []
            for name, value in row(one).items():
                form = COLUMNS[name][0]
                empty = value is None or (isinstance(value, float) and not np.isfinite(value))
                cells.append("" if empty else format(value, form))
            writer.writerow(cells)
