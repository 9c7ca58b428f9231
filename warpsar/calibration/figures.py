"""Drawings of the reflectors' report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.calibration.explain import Explanation
from warpsar.calibration.forecast import Forecast
from warpsar.calibration.measure import ReflectorObservation
from warpsar.calibration.table import decibel
from warpsar.io import figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:purple", "tab:brown", "tab:cyan")
ABOVE: dict[str, Any] = {"frameon": False, "fontsize": 7, "loc": "lower left", "bbox_to_anchor": (0.0, 1.0)}
"""Of a legend: within the axes its marks look like values."""
KILOMETRE = 111.195
"""Of a degree of latitude."""


def map_figure(observations: Sequence[ReflectorObservation], explanation: Explanation) -> Figure:
    """Where the reflectors stand, and how far each lies off its prediction on average, without bad dates."""
    bad = {(one.site, one.date) for one in explanation.bad_dates}
    good = [one for one in observations if one.stands and (one.site.name, str(one.date)[:10]) not in bad]
    sites = {one.site.name: one.site for one in observations}
    lat = np.array([site.latitude_deg for site in sites.values()])
    lon = np.array([site.longitude_deg for site in sites.values()])
    east = (lon - lon.mean()) * KILOMETRE * np.cos(np.deg2rad(lat.mean()))
    north = (lat - lat.mean()) * KILOMETRE
    means = []
    for name in sites:
        own = [one.difference_db for one in good if one.site.name == name and one.difference_db is not None]
        means.append(float(np.mean(own)) if own else np.nan)
    values = np.array(means)
    figure, axes = figures.new(5.0, 4.2)
    reach = float(np.nanmax(np.abs(values), initial=0.5)) if np.isfinite(values).any() else 0.5
    unknown = ~np.isfinite(values)
    axes.scatter(east[unknown], north[unknown], s=60, facecolors="none", edgecolors="0.4", label="no prediction")
    drawn = axes.scatter(
        east[~unknown],
        north[~unknown],
        c=values[~unknown],
        s=70,
        cmap="RdBu_r",
        vmin=-reach,
        vmax=reach,
        edgecolors="k",
    )
    for name, x, y in zip(sites, east, north, strict=True):
        axes.annotate(name, (x, y), xytext=(6, 6), textcoords="offset points", fontsize=8)
    if not unknown.all():
        figure.colorbar(drawn, ax=axes, label="mean difference [dB]")
    if unknown.any():
        axes.legend(frameon=False, fontsize=8)
    if len(sites) == 1:
        axes.set(xlim=(-1, 1), ylim=(-1, 1))
    axes.margins(0.15)
    axes.set_aspect("equal", adjustable="box" if len(sites) == 1 else "datalim")
    axes.set_xlabel(f"east of {lon.mean():.4f}° [km]")
    axes.set_ylabel(f"north of {lat.mean():.4f}° [km]")
    axes.grid(alpha=0.3)
    return figure


def passes(observations: Sequence[ReflectorObservation]) -> dict[str, list[ReflectorObservation]]:
    """By platform, polarization and direction of the look, in order."""
    found: dict[str, list[ReflectorObservation]] = {}
    for one in observations:
        look = "" if one.expected is None else f", from {one.expected.azimuth_deg:.0f}°"
        words = [*one.platform.split(), one.polarization or ""]
        found.setdefault(" ".join(dict.fromkeys(words)).strip() + look, []).append(one)
    return found


def series_figure(
    observations: Sequence[ReflectorObservation], explanation: Explanation, held_back: Forecast | None = None
) -> Figure:
    """RCS of one reflector over time with its interval, beside the prediction; bad dates are crossed.

    What was foretold of dates that were held back is a wide grey bar."""
    bad = {(one.site, one.date) for one in explanation.bad_dates}
    figure, axes = figures.new(6.4, 3.2)
    names = {one.site.name for one in observations}
    foretold = [] if held_back is None else [one for one in held_back.values if one.observation.site.name in names]
    if foretold:
        date = np.array([one.observation.date for one in foretold]).astype("datetime64[s]").astype(object)
        low, high = (np.array([getattr(one, f"{end}_dbsm") for one in foretold]) for end in ("low", "high"))
        axes.vlines(date, low, high, color="0.8", lw=6, label="foretold, 90 %")
    for (name, some), colour in zip(passes(observations).items(), COLOURS * 9, strict=False):
        own = [one for one in some if one.calibrated and one.point is not None]
        for seen, marker in ((True, "o"), (False, "v")):
            shown = [one for one in own if (one.status == "measured") == seen]
            if not shown:
                continue
            date = np.array([one.date for one in shown]).astype("datetime64[s]").astype(object)
            high = np.array([_dbsm(one.point.high_m2) for one in shown if one.point is not None])
            low = np.array([_dbsm(one.point.low_m2) for one in shown if one.point is not None])
            middle = np.array([_dbsm(one.point.rcs_m2) for one in shown if one.point is not None])
            if not seen:  # an upper bound
                axes.plot(date, high, marker, color=colour, mfc="none", ms=5, label=f"{name}: not seen, upper bound")
                continue
            low = np.maximum(low, middle - 10.0)
            bars = np.array([np.maximum(middle - low, 0.0), np.maximum(high - middle, 0.0)])
            axes.errorbar(date, middle, bars, fmt=marker, color=colour, ms=4, lw=0.9, label=name)
            for x, y, one in zip(date, middle, shown, strict=True):
                if (one.site.name, str(one.date)[:10]) in bad:
                    axes.plot([x], [y], "x", color="black", ms=9)
        predicted = [(one.date, decibel(one.predicted_m2)) for one in some if one.predicted_m2]
        if predicted:
            date = np.array([each for each, _ in predicted]).astype("datetime64[s]").astype(object)
            axes.plot(
                date, [value for _, value in predicted], "_", color=colour, ms=9, mew=2.2, label=f"{name}: predicted"
            )
    shown_dates = np.array([one.date for one in observations]).astype("datetime64[s]")
    if np.ptp(shown_dates) < np.timedelta64(1, "D"):  # else an axis of years about one date
        middle, reach = shown_dates.min(), np.timedelta64(10, "D")
        axes.set_xlim((middle - reach).astype(object), (middle + reach).astype(object))
    axes.set_ylabel("RCS [dBsm]")
    axes.grid(alpha=0.3)
    axes.tick_params(axis="x", labelrotation=25)
    for each in axes.get_xticklabels():
        each.set(ha="right", rotation_mode="anchor")
    axes.legend(**ABOVE, ncols=2)
    return figure


def _dbsm(area: float) -> float:
    return float(10.0 * np.log10(max(area, 1e-6)))


def incidence_figure(observations: Sequence[ReflectorObservation], explanation: Explanation) -> Figure:
    """Measured over predicted against incidence, and what the causes together make of it; bad dates are crossed."""
    bad = {(one.site, one.date) for one in explanation.bad_dates}
    figure, axes = figures.new(5.0, 4.2)
    names = list(dict.fromkeys(one.site.name for one in observations))
    for name, colour in zip(names, COLOURS * 99, strict=False):
        own = [one for one in observations if one.site.name == name and one.difference_db is not None]
        if not own:
            continue
        angle = [one.expected.incidence_deg for one in own if one.expected is not None]
        off = np.array([one.difference_db for one in own], np.float64)
        error = np.array([one.difference_sd_db or 0.0 for one in own])
        axes.errorbar(angle, off, 1.645 * error, fmt="o", ms=3.5, lw=0.8, color=colour, label=name)
        for x, y, one in zip(angle, off, own, strict=False):
            if (name, str(one.date)[:10]) in bad:
                axes.plot([x], [y], "x", color="black", ms=9)
    data = explanation.differences
    if data is not None and explanation.joint is not None:
        axes.plot(data.incidence_deg, explanation.joint.fit.fitted, "k_", ms=9, label="causes together")
    axes.axhline(0.0, color="0.6", lw=0.8)
    axes.locator_params(axis="x", nbins=5)
    axes.ticklabel_format(axis="x", useOffset=False)
    axes.set_xlabel("incidence [deg]")
    axes.set_ylabel("measured / predicted [dB]")
    axes.grid(alpha=0.3)
    if len(names) <= 12:
        axes.legend(**ABOVE, ncols=4)
    return figure


def offset_figure(observations: Sequence[ReflectorObservation]) -> Figure:
    """Found less expected place."""
    figure, axes = figures.new(5.0, 4.2)
    names = list(dict.fromkeys(one.site.name for one in observations))
    for name, colour in zip(names, COLOURS * 99, strict=False):
        off = np.array([one.offset_m for one in observations if one.site.name == name and one.offset_m is not None])
        if off.size:
            axes.plot(off[:, 1], off[:, 0], "o", ms=4, color=colour, label=name)
    axes.axhline(0.0, color="0.6", lw=0.8)
    axes.axvline(0.0, color="0.6", lw=0.8)
    axes.set_xlabel("slant range, found − expected [m]")
    axes.set_ylabel("azimuth, found − expected [m]")
    axes.grid(alpha=0.3)
    if len(names) <= 12:
        axes.legend(**ABOVE, ncols=4)
    return figure
