"""Where reflectors stand, and what they are: a CSV of sites, in the columns that calibration teams have."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.calibration.attitude import SHAPES, Facing, Shape
from warpsar.errors import InputError, did_you_mean, shown
from warpsar.io import input_file
from warpsar.io.images import replacing
from warpsar.world.earth import LocalEarth, ecef_to_geodetic, geodetic_to_ecef

F64 = NDArray[np.float64]
LARGEST_FILE = 2**24
FARTHEST_SEARCH_M = 5000.0
VALID_POWER, VALID_PLACE, ALL_VALID = 2 | 16, 4, 7
LARGEST_VALIDITY = 31
"""NISAR's flags: 1 response, 2 power, 4 place; 8 response and 16 power in its S band."""
ISCE3_COLUMNS = (
    "Corner reflector ID",
    "Latitude (deg)",
    "Longitude (deg)",
    "Height above ellipsoid (m)",
    "Azimuth (deg)",
    "Tilt / Elevation angle (deg)",
    "Side length (m)",
    "Survey Date",
    "Validity",
    "Velocity East (m/s)",
    "Velocity North (m/s)",
    "Velocity Up (m/s)",
    "Shape",
)
"""Of NISAR's table (B. Hawkins, Corner Reflector Software Interface Specification, JPL D-107698, 2025), which ISCE3 and
nisarqa read. UAVSAR's has the first seven. The shape came last, in 2025: ISCE3 of before takes twelve alone."""
UAVSAR_COLUMNS, SHAPELESS_COLUMNS = 7, 12
NO_DATE = np.datetime64("1970-01-01", "us")
ISCE3_AZIMUTH_DEG = 90.0
"""It counts azimuth from east, clockwise."""
COLUMNS = (
    "id",
    "latitude_deg",
    "longitude_deg",
    "height_m",
    "azimuth_deg",
    "tilt_deg",
    "shape",
    "leg_m",
    "from",
    "until",
)
"""Of our own layout; the last six may be missing."""
MORE_COLUMNS = ("flipped", "search_m")
"""Which may stand beside them."""
NEARLY = 0.85
"""Of the letters of a column's name: a wrong letter or two. incidence_deg is no longitude_deg."""


@dataclass(frozen=True)
class ReflectorSite:
    """A reflector. Latitude, longitude [deg], height [m] above the WGS 84 ellipsoid, at `surveyed` where it moves."""

    name: str
    latitude_deg: float
    longitude_deg: float
    height_m: float
    facings: tuple[Facing, ...]
    """The attitudes of one device, of which the one nearest to the radar counts; none where it is not known."""
    shape: Shape
    leg_m: float | None
    """Inner length of a leg [m]; None where it is not known: nothing is predicted then."""
    start: np.datetime64 | None = None
    """From when it stands; None: always."""
    end: np.datetime64 | None = None
    surveyed: np.datetime64 | None = None
    velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """East, north, up, of the ground that it stands on."""
    validity: int = ALL_VALID
    """NISAR's code, a sum of what it may be used for; 0 is out of service."""

    search_m: float | None = None
    """How far off its place may be, in azimuth and slant range [m], where it is not known; None where it is."""

    @property
    def for_power(self) -> bool:
        """Whether its radar cross-section may calibrate."""
        return bool(self.validity & VALID_POWER)

    @property
    def for_place(self) -> bool:
        """Whether its survey may locate the image."""
        return bool(self.validity & VALID_PLACE)

    def geodetic(self, date: np.datetime64) -> F64:
        """Latitude, longitude [deg] and height [m], (3,), at a date."""
        place = np.array([self.latitude_deg, self.longitude_deg, self.height_m])
        if self.surveyed is None or not any(self.velocity_m_s):
            return place
        seconds = float((date - self.surveyed) / np.timedelta64(1, "s"))
        moved = seconds * np.array(self.velocity_m_s) @ LocalEarth(*place).axes
        return np.asarray(ecef_to_geodetic(geodetic_to_ecef(place) + moved))

    def facing(self, toward_radar: F64) -> Facing | None:
        """The attitude whose boresight is nearest to the direction (3,) of the radar."""
        return min(self.facings, key=lambda one: one.off_boresight_deg(toward_radar), default=None)

    def stands(self, date: np.datetime64) -> bool:
        """Whether it is there at a date, by the file."""
        after = self.start is None or bool(date >= self.start)
        before = self.end is None or bool(date <= self.end)
        return after and before and self.validity > 0


def sites_at(sites: Sequence[ReflectorSite], date: np.datetime64) -> list[ReflectorSite]:
    """Each reflector once: by its latest survey that is not after the date, or the first one where all are after it."""
    chosen: dict[str, ReflectorSite] = {}
    for one in sorted(sites, key=lambda site: _or_early(site.surveyed)):
        if one.name not in chosen or _or_early(one.surveyed) <= date:
            chosen[one.name] = one
    return list(chosen.values())


def _or_early(date: np.datetime64 | None) -> np.datetime64:
    return np.datetime64("0001-01-01", "us") if date is None else date


def read(path: Path) -> list[ReflectorSite]:
    """The sites of a file: our own columns, those of GECORIS, or those of UAVSAR, ISCE3 and NISAR.

    Raises InputError, one message that names file, line and column, for a file that has none of them.
    """
    text = input_file.read_text(path, "a table of sites", LARGEST_FILE)
    reader = csv.reader(io.StringIO(text, newline=None), skipinitialspace=True)
    try:
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row))]
        rows = [(line, cells) for line, cells in rows if not cells[0].startswith("#")]
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: no CSV ({error})") from error
    if rows and _is_bare(rows[0][1]):
        rows.insert(0, (0, list(ISCE3_COLUMNS[: len(rows[0][1])])))
    if len(rows) < 2:
        raise InputError(f"{path}: found {len(rows)} lines; must be names of columns, and at least one site")
    header = [_key(cell) for cell in rows[0][1]]
    layout = next((one for names, one in _LAYOUTS if set(names) <= set(header)), None)
    if layout is None:
        missing = [name for name in COLUMNS[:4] if name not in header]
        unknown = [name for name in header if name not in COLUMNS]
        near = next((f"{hint}" for name in unknown if (hint := did_you_mean(name, missing))), "")
        if len(rows[0][1]) == 1 and (mark := next((mark for mark in ";\t|" if mark in rows[0][1][0]), None)):
            raise InputError(f"{path}: line {rows[0][0]}: found cells with {mark!r} between them; must be commas")
        raise InputError(
            f"{path}: line {rows[0][0]}: found the columns {', '.join(rows[0][1])[:200]}, without "
            f"{', '.join(missing)}; must have {', '.join(COLUMNS[:4])}, or be a table of GECORIS, UAVSAR, ISCE3 or "
            f"NISAR{near}"
        )
    if layout is _own:
        _refuse_misspelt(path, rows[0][0], header)
    sites = [layout(_Row(path, line, dict(zip(header, row, strict=False)))) for line, row in rows[1:]]
    seen: dict[tuple[str, np.datetime64 | None], int] = {}
    for (line, _), one in zip(rows[1:], sites, strict=True):
        if first := seen.get((one.name, one.surveyed)):
            allowed = "there once" if one.surveyed is None else "there once for each survey date"
            raise InputError(f"{path}: line {line}: id: found {shown(one.name)}, as in line {first}; must be {allowed}")
        seen[one.name, one.surveyed] = line
    return sites


def _refuse_misspelt(path: Path, line: int, header: Sequence[str]) -> None:
    """A column that is nearly one of ours would be left out in silence; other columns are the user's own."""
    known = {name.removesuffix("_deg").removesuffix("_m"): name for name in (*COLUMNS, *MORE_COLUMNS)}
    for name in (one for one in header if one not in known.values()):
        stem = name.removesuffix("_deg").removesuffix("_m")
        if stem == "elevation":
            raise InputError(
                f"{path}: line {line}: found the column {shown(name)}; must be tilt_deg: of an upright trihedral the "
                "boresight's elevation less 35.26 degrees"
            )
        if near := did_you_mean(known.get(stem, name), known.values(), NEARLY):
            raise InputError(f"{path}: line {line}: found the column {shown(name)}{near}")


def _is_bare(cells: Sequence[str]) -> bool:
    """Whether this is a line of UAVSAR's or NISAR's table, without names of columns: ISCE3 needs none."""
    if len(cells) not in (UAVSAR_COLUMNS, SHAPELESS_COLUMNS, len(ISCE3_COLUMNS)):
        return False
    try:
        return all(np.isfinite(float(cell)) for cell in cells[1:UAVSAR_COLUMNS])
    except ValueError:
        return False


def _key(name: str) -> str:
    """A column's name without its unit and punctuation: "Tilt / Elevation angle (deg)" is "tilt elevation angle"."""
    return " ".join(re.findall(r"[a-z0-9_]+", re.sub(r"\(.*?\)", "", name.lower())))


class _Row:
    """A line of the table. Messages name file, line and column."""

    def __init__(self, path: Path, line: int, cells: Mapping[str, str]) -> None:
        self.path, self.line, self.cells = path, line, cells

    def refuse(self, key: str, allowed: str) -> InputError:
        found = shown(self.cells.get(key, ""))
        return InputError(f"{self.path}: line {self.line}: {key}: found {found}; must be {allowed}")

    def text(self, key: str) -> str:
        if not (found := self.cells.get(key, "")):
            raise self.refuse(key, "there")
        return found

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        text = self.cells.get(key, "")
        if not text and default is not None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            raise self.refuse(key, f"a number from {low:g} to {high:g}")
        return value

    def place(self, latitude: str, longitude: str, height: str) -> tuple[float, float, float]:
        return (
            self.number(latitude, -90.0, 90.0),
            self.number(longitude, -360.0, 360.0),
            self.number(height, -1e3, 1e4),
        )

    def date(self, key: str) -> np.datetime64 | None:
        """A date, "2020-02-19", "20200219" or "20200219T1150Z"; None for an empty cell, and for 9999..."""
        text = self.cells.get(key, "").rstrip("Z")
        if not text or text.startswith("9999"):
            return None
        if re.fullmatch(r"\d{8}(T\d{4})?", text):
            text = f"{text[:4]}-{text[4:6]}-{text[6:8]}" + (f"T{text[9:11]}:{text[11:13]}" if "T" in text else "")
        try:
            return np.datetime64(text, "us")
        except ValueError:
            raise self.refuse(key, "a date such as 2020-02-19") from None

    def leg(self, key: str) -> float | None:
        return self.number(key, 0.01, 100.0) if self.cells.get(key) else None

    def shape(self, key: str) -> Shape:
        found = self.cells.get(key, "").lower() or "triangular"
        for shape in SHAPES:
            if found == shape:
                return shape
        raise self.refuse(key, f"one of {', '.join(SHAPES)}")


def _own(row: _Row) -> ReflectorSite:
    flipped = row.cells.get("flipped", "").lower()
    if flipped not in ("", "yes", "no", "true", "false", "1", "0"):
        raise row.refuse("flipped", "yes or no")
    facings: tuple[Facing, ...] = ()
    if row.cells.get("azimuth_deg"):
        tilt = row.number("tilt_deg", -90.0, 90.0, 0.0)
        facings = (Facing(row.number("azimuth_deg", -360.0, 360.0), tilt, flipped in ("yes", "true", "1")),)
    place = row.place("latitude_deg", "longitude_deg", "height_m")
    start, end = row.date("from"), row.date("until")
    if end is not None and re.fullmatch(r"\d{4}-?\d{2}-?\d{2}", row.cells["until"]):
        end = end + np.timedelta64(1, "D") - np.timedelta64(1, "us")  # it stands on that day, too
    if start is not None and end is not None and end < start:
        raise row.refuse("until", f"a date that is not before {row.cells['from']}, its `from`")
    search = row.number("search_m", 10.0, FARTHEST_SEARCH_M) if row.cells.get("search_m") else None
    return ReflectorSite(
        row.text("id"), *place, facings, row.shape("shape"), row.leg("leg_m"), start, end,
        search_m=search,
    )  # fmt: skip


def _gecoris(row: _Row) -> ReflectorSite:
    """The dips of GECORIS: from due east for passes that look from there, from due west for the others."""
    kinds: dict[str, tuple[Shape, bool]] = {
        "TRIANGULAR": ("triangular", False),
        "TRIANGULARFLIPPED": ("triangular", True),
        "IGRS": ("triangular", True),
        "SQUARE": ("square", False),
        "SQUAREFLIPPED": ("square", True),
    }
    kind = row.text("crshape").upper()
    if kind not in kinds:
        raise row.refuse("crshape", f"one of {', '.join(kinds)}")
    shape, flipped = kinds[kind]
    dip, tilt = row.number("azidip", -180.0, 180.0, 0.0), -row.number("zendip", -90.0, 90.0, 0.0)
    facings: tuple[Facing, ...] = (Facing(90.0 + dip, tilt, flipped), Facing(270.0 - dip, tilt, flipped))
    orientation = row.cells.get("orientation", "*").upper()[:1]
    facings = facings[:1] if orientation == "D" else facings[1:] if orientation == "A" else facings
    place = row.place("latitude", "longitude", "el height")
    start = row.date("startdate") or row.date("installdate")
    return ReflectorSite(row.text("id"), *place, facings, shape, row.leg("leglength"), start, row.date("enddate"))


def _isce3(row: _Row) -> ReflectorSite:
    """Azimuth is that of the boresight (its tests: 0 is east); tilt is that of `Facing`."""
    place = row.place("latitude", "longitude", "height above ellipsoid")
    tilt = next(key for key in row.cells if key.startswith("tilt"))
    facing = Facing(row.number("azimuth", -360.0, 720.0) + ISCE3_AZIMUTH_DEG, row.number(tilt, -90.0, 90.0))
    speed = [row.number(f"velocity {way}", -1.0, 1.0, 0.0) for way in ("east", "north", "up")]
    validity = row.number("validity", 0, LARGEST_VALIDITY, ALL_VALID)
    if validity != int(validity):
        raise row.refuse("validity", f"a whole number from 0 to {LARGEST_VALIDITY}")
    return ReflectorSite(
        row.text("corner reflector id"),
        *place,
        (facing,),
        row.shape("shape"),
        row.leg("side length"),
        start=row.date("survey date"),
        surveyed=row.date("survey date"),
        velocity_m_s=(speed[0], speed[1], speed[2]),
        validity=int(validity),
    )


def isce3_rows(sites: Sequence[ReflectorSite]) -> tuple[list[list[str]], list[str]]:
    """Rows under `ISCE3_COLUMNS`, and a line for each reflector that the layout cannot say.

    It has trihedrals that stand upright, one attitude each: of two attitudes each has a row, ID-1 and ID-2.
    A survey holds until the next one. So the survey's date is that from which the reflector stands where no survey is
    known, and a row of validity 0 ends it.
    """
    rows, left_out = [], []
    for one in sites:
        why = None
        if any(facing.flipped for facing in one.facings):
            why = "the layout has upright trihedrals alone"
        elif not one.facings or one.leg_m is None:
            why = "its leg or attitude is not known"
        elif "," in one.name or one.name.startswith("#"):
            why = "its id has a comma, or begins with #"
        if why is not None or one.leg_m is None:
            left_out.append(f"{one.name}: not in ISCE3's table: {why}")
            continue
        for k, facing in enumerate(one.facings, 1):
            name = one.name if len(one.facings) == 1 else f"{one.name}-{k}"
            numbers = [one.latitude_deg, one.longitude_deg, one.height_m, facing.azimuth_deg - ISCE3_AZIMUTH_DEG]
            known = [name, *(str(round(each, 12)) for each in (*numbers, facing.tilt_deg, one.leg_m))]
            velocity = [str(each) for each in one.velocity_m_s]
            dates = [(one.surveyed or one.start or NO_DATE, one.validity)]
            dates += [(one.end, 0)] if one.end is not None else []
            rows += [[*known, _stamp(date), str(validity), *velocity, one.shape] for date, validity in dates]
    return rows, left_out


def _stamp(date: np.datetime64) -> str:
    return str(date.astype("datetime64[us]"))


def write_isce3(path: Path, sites: Sequence[ReflectorSite]) -> list[str]:
    """Write the table that ISCE3 and nisarqa read. Returns a line for each reflector that it cannot say.

    Without a square one the column of shapes is left out, so that older ISCE3 reads the table, too."""
    rows, left_out = isce3_rows(sites)
    columns = len(ISCE3_COLUMNS) if any(row[-1] == "square" for row in rows) else SHAPELESS_COLUMNS
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream, lineterminator="\n").writerows(row[:columns] for row in (ISCE3_COLUMNS, *rows))
    return left_out


_LAYOUTS: tuple[tuple[tuple[str, ...], Callable[[_Row], ReflectorSite]], ...] = (
    (COLUMNS[:4], _own),
    (("id", "latitude", "longitude", "el height", "crshape"), _gecoris),
    (("corner reflector id", "latitude", "longitude", "height above ellipsoid", "azimuth", "side length"), _isce3),
)
