"""The command `reflectors`, and `warpsar.reflectors`: two tables (CSV), reflectors.json and report.html."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.calibration import sites as site_tables
from warpsar.calibration.engine import engine_rcs_m2
from warpsar.calibration.explain import Explanation, explain
from warpsar.calibration.forecast import Forecast, forecast
from warpsar.calibration.geolocation import Geolocation, geolocation
from warpsar.calibration.measure import ALLOWANCE_M, ReflectorObservation, observe, without_neighbours
from warpsar.calibration.point import PointSettings
from warpsar.calibration.presence import FoundPlace, Presence, find_place, presences, settled, standing
from warpsar.calibration.report import write_report
from warpsar.calibration.sites import ReflectorSite, sites_at, write_isce3
from warpsar.calibration.table import row, write_csv
from warpsar.errors import InputError
from warpsar.formats import registry
from warpsar.products.product import RADIOMETRIES, Product, Radiometry
from warpsar.runtime import console, devices
from warpsar.simulation.outputs import make_folder, write_json
from warpsar.world.tables import Polarization

LOOK_STEP_DEG = 0.1
"""The engine is asked once for looks so near to each other: a trihedral changes by under 0.02 dB."""
CO_POLARIZED = ("HH", "VV")
POLARIZATIONS: tuple[Polarization, ...] = ("HH", "HV", "VH", "VV")


@dataclass(frozen=True)
class ReflectorResult:
    """What was measured and predicted of each reflector and date, and what the differences mean."""

    observations: tuple[ReflectorObservation, ...]
    explanation: Explanation
    geolocation: Geolocation | None
    refused: tuple[str, ...]
    """Products that could not be opened, and reflectors that were not found, a line each."""
    found: tuple[FoundPlace, ...] = ()
    """Reflectors whose place was not known."""
    presence: tuple[Presence, ...] = ()
    """When reflectors came, went, or moved."""
    held_back: Forecast | None = None
    """Later values that the earlier dates foretell, where later dates were held back."""

    def rows(self) -> list[dict[str, Any]]:
        """The table, by the names of the columns of reflectors.csv."""
        return [dict(row(one)) for one in self.observations]


def reflectors(
    products: Sequence[Product | PathLike[str] | str] | Product | PathLike[str] | str,
    sites: Sequence[ReflectorSite] | PathLike[str] | str,
    *,
    polarization: str | None = None,
    radiometry: Radiometry | None = None,
    allowance_m: tuple[float, float] = ALLOWANCE_M,
    window_cells: float = PointSettings.window_cells,
    engine: bool = True,
    hold_back: str | np.datetime64 | None = None,
    file_format: str = "auto",
    device: str | None = None,
) -> ReflectorResult:
    """Measure corner reflectors in radar products, predict them, and explain the differences.

    `products`: files, SAFE folders, or products that are open. `sites`: a CSV of sites, or sites. Without
    `polarization` the co-polarized images are taken. `radiometry` says what power is where a product does not:
    "beta0", "sigma0" or "gamma0". `allowance_m`: how far off a reflector may be, in azimuth and slant range.
    `window_cells`: half of the window that is integrated, in resolution cells. `engine`: predict by rays, else in
    closed form alone. `hold_back`: dates from this one on are measured, and decide nothing: places, set-up dates and
    causes are found from earlier dates, which then foretell the later RCS. Raises InputError for a table of sites that
    cannot be read, and where no product can be opened.
    """
    _refuse(polarization, radiometry, allowance_m, window_cells)
    given = [products] if isinstance(products, Product | PathLike | str) else list(products)
    table = site_tables.read(Path(sites)) if isinstance(sites, PathLike | str) else list(sites)
    opened, refused = _opened(given, polarization, file_format)
    settings = PointSettings(window_cells=window_cells)
    found: list[ReflectorObservation] = []
    since = _first_held_back(hold_back, opened)
    earlier = [one for one in opened if since is None or one.date(one.grid.middle_s) < since]
    table, places, lost = _placed(earlier, table, allowance_m, settings, radiometry)
    bar = console.progress(len(opened), "reflectors", "product")
    for product in opened:
        date = product.date(product.grid.middle_s)
        seen = [observe(product, site, allowance_m, settings, radiometry) for site in sites_at(table, date)]
        found += without_neighbours(seen, settings)
        bar.update()
    bar.close()
    found = _without_other_swaths(found)
    presence = presences(_before(found, since))
    found = standing(found, presence)
    if engine:
        found = _predicted(found, {one.source: one.frequency_hz for one in opened}, device)
    found.sort(key=lambda one: (one.site.name, one.date, one.polarization or ""))
    early = _before(found, since)
    explanation = explain(early)
    return ReflectorResult(
        tuple(found),
        explanation,
        geolocation(early, allowance_m),
        (*refused, *lost, *_never_seen(found)),
        tuple(places),
        tuple(presence),
        None if since is None else forecast(found, since, explanation),
    )


def _first_held_back(given: str | np.datetime64 | None, opened: Sequence[Product]) -> np.datetime64 | None:
    """The day. Raises InputError for what is none, and where it leaves no dates before it, or holds none back."""
    if given is None:
        return None
    dates = sorted(one.date(one.grid.middle_s) for one in opened)
    try:
        since = np.datetime64(str(given)).astype("datetime64[D]").astype("datetime64[us]")
    except ValueError:
        raise InputError(f"hold_back: found {str(given)[:40]!r}; must be a date like 2024-06-01") from None
    if not dates[0] < since <= dates[-1]:
        raise InputError(
            f"hold_back: found {str(since)[:10]}; must be after {str(dates[0])[:10]}, the first date of the products, "
            f"and not after {str(dates[-1])[:10]}, the last one"
        )
    return since


def _before(found: Sequence[ReflectorObservation], since: np.datetime64 | None) -> list[ReflectorObservation]:
    return [one for one in found if since is None or one.date < since]


def _placed(
    products: Sequence[Product],
    table: Sequence[ReflectorSite],
    allowance_m: tuple[float, float],
    settings: PointSettings,
    radiometry: Radiometry | None,
) -> tuple[list[ReflectorSite], list[FoundPlace], list[str]]:
    """The table, with places that were looked for in the images; what was found; and a line for what was not."""
    made: list[ReflectorSite] = []
    places: list[FoundPlace] = []
    lost: list[str] = []
    for site in table:
        if site.search_m is None:
            made.append(site)
            continue
        found, words = find_place(products, site, radiometry)
        if found is None:
            lost.append(words)
            continue
        seen = [observe(product, found.site, allowance_m, settings, radiometry) for product in products]
        places.append(settled(found, seen, {one.source: one for one in products}))
        made.append(places[-1].site)
    return made, places, lost


def _refuse(
    polarization: str | None, radiometry: str | None, allowance_m: tuple[float, float], window_cells: float
) -> None:
    if polarization is not None and polarization not in POLARIZATIONS:
        raise InputError(f"polarization: found {polarization!r}; must be one of {', '.join(POLARIZATIONS)}")
    if radiometry is not None and radiometry not in RADIOMETRIES:
        raise InputError(f"radiometry: found {radiometry!r}; must be one of {', '.join(RADIOMETRIES)}")
    if not all(0.0 <= each <= 1e4 for each in allowance_m):
        raise InputError(f"allowance_m: found {allowance_m}; must be two lengths from 0 to 10000 m")
    if not 0.5 <= window_cells <= 6.0:
        raise InputError(f"window_cells: found {window_cells:g}; must be from 0.5 to 6")


def _opened(
    given: Sequence[Product | PathLike[str] | str], polarization: str | None, file_format: str
) -> tuple[list[Product], list[str]]:
    """Products that can be read, and a line for each that cannot."""
    opened: list[Product] = []
    refused: list[str] = []
    for one in given:
        if isinstance(one, Product):
            opened.append(one)
            continue
        try:
            several = registry.products(Path(one), file_format=file_format, polarization=polarization)
        except InputError as error:
            refused.append(str(error))
            continue
        chosen = [p for p in several if polarization or p.polarization is None or p.polarization in CO_POLARIZED]
        if not chosen:
            refused.append(f"{one}: found no co-polarized image; must be HH or VV, or name it with --polarization")
        for each in chosen:
            if (each.source, each.polarization) in {(p.source, p.polarization) for p in opened}:
                refused.append(f"{each.source}: named twice; it is taken once")
            else:
                opened.append(each)
    if not opened:
        raise InputError("\n  ".join(["no product can be measured:", *refused]) if refused else "no product given")
    return opened, refused


def _never_seen(found: Sequence[ReflectorObservation]) -> list[str]:
    """A line for each reflector that no product shows, though it should stand."""
    seen = {one.site.name for one in found if one.point is not None and one.point.seen}
    unseen = dict.fromkeys(one.site.name for one in found if one.status == "not seen" and one.stands)
    return [
        f"{name}: seen in no product; it is absent, or its place is off (a height above the sea instead of the "
        "ellipsoid moves it by tens of metres); --allowance or search_m looks farther"
        for name in unseen
        if name not in seen
    ]


def _without_other_swaths(found: Sequence[ReflectorObservation]) -> list[ReflectorObservation]:
    """A reflector that lies outside one swath of an acquisition and inside another is no problem."""

    def acquisition(one: ReflectorObservation) -> tuple[str, str, str | None, str]:
        return one.site.name, one.platform.split()[0], one.polarization, str(one.date)[:10]

    inside = {acquisition(one) for one in found if one.status not in ("outside", "no orbit")}
    return [one for one in found if one.status != "outside" or acquisition(one) not in inside]


def _predicted(
    found: Sequence[ReflectorObservation], frequency_hz: dict[str, float], device: str | None
) -> list[ReflectorObservation]:
    """With the engine's prediction, where shape, size and attitude are known and the radar sees the inside."""
    known: dict[tuple[Any, ...], float] = {}
    made = []
    bar = console.progress(len(found), "predictions", "reflector")
    for one in found:
        bar.update()
        known_body = one.closed_form_m2 and one.calibrated
        if not known_body or one.expected is None or one.facing is None or one.site.leg_m is None:
            made.append(one)
            continue
        look = tuple(
            round(angle / LOOK_STEP_DEG) * LOOK_STEP_DEG
            for angle in (one.expected.azimuth_deg, one.expected.incidence_deg)
        )
        pol: Polarization = next((each for each in POLARIZATIONS if each == one.polarization), "VV")
        key = (one.site.shape, one.site.leg_m, one.facing, look, frequency_hz[one.source], pol)
        if key not in known:
            area = engine_rcs_m2(
                one.site.shape, one.site.leg_m, one.facing, [(look[0], look[1])], frequency_hz[one.source], pol, device
            )
            known[key] = float(area[0])
        made.append(replace(one, engine_m2=known[key]))
    bar.close()
    return made


def run(
    products: Sequence[Path],
    sites: Path,
    out: Path,
    *,
    polarization: str | None = None,
    radiometry: Radiometry | None = None,
    allowance_m: tuple[float, float] = ALLOWANCE_M,
    window_cells: float = PointSettings.window_cells,
    engine: bool = True,
    hold_back: str | None = None,
    file_format: str = "auto",
    device: str | None = None,
    command: Sequence[str] = (),
) -> dict[str, Any]:
    """`warpsar reflectors`: the files in `out`. Returns the JSON's content. Raises InputError and DeviceError."""
    started = time.perf_counter()
    where = devices.resolve_device(device)
    table = site_tables.read(sites)
    result = reflectors(
        list(products),
        table,
        polarization=polarization,
        radiometry=radiometry,
        allowance_m=allowance_m,
        window_cells=window_cells,
        engine=engine,
        hold_back=hold_back,
        file_format=file_format,
        device=device,
    )
    make_folder(out)  # nothing is written for what is refused
    console.warn(result.refused)
    console.warn(
        f"{one.site.name}, {str(one.date)[:10]}, {Path(one.source).name}: {one.status}: {one.reason}"
        for one in result.observations
        if one.status != "measured"
    )
    write_csv(out / "reflectors.csv", result.observations)
    console.warn(write_isce3(out / "sites_isce3.csv", _written(table, result)))
    content = {
        "input": {"scene": sites.name, "sha256": hashlib.sha256(sites.read_bytes()).hexdigest()},
        "observations": result.rows(),
        "refused": list(result.refused),
        "found": [one.content() for one in result.found],
        "presence": [one.content() for one in result.presence],
        "explanation": result.explanation.content(),
        "geolocation": None if result.geolocation is None else result.geolocation.content(),
        "held_back": None if result.held_back is None else result.held_back.content(),
        "settings": {
            "window_cells": window_cells,
            "guard_cells": PointSettings.guard_cells,
            "clutter_cells": PointSettings.clutter_cells,
            "confidence": PointSettings.confidence,
            "allowance_m": list(allowance_m),
            "radiometry": radiometry,
            "prediction": "engine" if engine else "closed form",
        },
    }
    content = write_json(out / "reflectors.json", None, where, None, started, content)
    write_report(
        out / "report.html", result.observations, result.explanation, result.geolocation, content, command,
        held_back=result.held_back,
    )  # fmt: skip
    console.say_written(out, "report.html", "reflectors.csv", "reflectors.json", "sites_isce3.csv")
    counted = [one.status == "measured" for one in result.observations]
    names, images = {one.site.name for one in result.observations}, {one.source for one in result.observations}
    measured = f"{int(np.sum(counted))} of {len(counted)} measured: reflectors {len(names)}, images {len(images)}"
    sentences = [one.words for one in result.found] + [one.words for one in result.presence]
    foretold = () if result.held_back is None else result.held_back.words
    print("\n".join([measured, *sentences, *result.explanation.words, *foretold]))
    return content


def _written(table: Sequence[ReflectorSite], result: ReflectorResult) -> list[ReflectorSite]:
    """The table with places and dates that were found, for those that had none."""
    placed = {one.site.name: one.site for one in result.found}
    made = [placed.get(one.name, one) for one in table if one.search_m is None or one.name in placed]
    for one in result.presence:
        since = None if one.since is None else np.datetime64(one.since[1], "us")
        until = None if one.until is None else np.datetime64(one.until[1], "us")
        made = [
            replace(site, start=site.start or since, end=site.end or until) if site.name == one.site else site
            for site in made
        ]
    return made
