"""`warpsar import --table`: many chips of one target and a table of their angles, into one scene file, in one call."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np

from warpsar.errors import InputError
from warpsar.formats import registry
from warpsar.formats.base.data import ImageChip, Quantity, RadarAt
from warpsar.io import input_file
from warpsar.io.images import write_exr
from warpsar.io.quick_look import contact_sheet
from warpsar.measured.gridding import Gridding, on_grid
from warpsar.measured.importer import (
    Scale,
    clip_level,
    declare,
    editing,
    keep_phase,
    opened,
    polarization_of,
    quick_look,
    rounding,
)
from warpsar.scene.file import refuse
from warpsar.speckle.looks import equivalent_looks
from warpsar.world.problems import first_problem
from warpsar.world.tables import View

NAMES = ("chip", "view", "name", "file", "filename", "image")
AZIMUTHS = ("azimuth_deg",)
ELEVATIONS = ("incidence_deg", "depression_deg", "grazing_deg")
_SEPARATORS = (",", ";", "\t")
_LARGEST_BYTES = 2**24
PICTURES = {".jpeg", ".jpg", ".png"}  # suffixes of formats that are known by their bytes
FEW = 3  # views, of which nothing is said

Sense = Literal["clockwise", "counterclockwise"]


def read_views(path: Path, azimuths: Sense = "clockwise") -> dict[str, View]:
    """The views of a table, by chip name: columns `chip` (or view, name, file, filename, image), azimuth_deg, one of
    incidence_deg, depression_deg and grazing_deg, and, if stated, role and looks. Other columns are not read.

    Columns are parted by commas, semicolons or tabs. A chip may be named by its file. Angles are degrees, also where
    `_deg` is left out; azimuths may go beyond a turn, and run in the sense of `azimuths`. Raises InputError, one
    message with all that is wrong, before any image is read.
    """
    text = input_file.read_text(path, "a table of views", _LARGEST_BYTES)
    first = text.partition("\n")[0]
    try:
        reader = csv.reader(
            io.StringIO(text, newline=""), delimiter=max(_SEPARATORS, key=first.count), skipinitialspace=True
        )
        lines = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as a table of views ({error})") from None
    columns = [column.lower() for column in lines[0][1]] if lines else []
    name, azimuth, elevation = (_one_of(path, columns, allowed) for allowed in (NAMES, AZIMUTHS, ELEVATIONS))
    keys = {azimuth: AZIMUTHS[0], elevation: f"{elevation.removesuffix('_deg')}_deg", "looks": "looks", "role": "role"}
    found: dict[str, View] = {}
    problems: list[str] = []
    for number, cells in lines[1:]:
        if not any(cells):
            continue
        row = dict(zip(columns, cells, strict=False))
        stated = {key: _value(key, row[column]) for column, key in keys.items() if row.get(column)}
        if isinstance(stated.get("azimuth_deg"), float):
            stated["azimuth_deg"] = _within_a_turn(stated["azimuth_deg"], azimuths)
        chip = _stem(row.get(name, ""))
        if chip in found:
            problems.append(f"line {number}: {chip} stands twice")
            continue
        try:
            found[chip] = View.model_validate({"name": chip} | stated)
        except ValueError as error:
            problems.append(f"line {number} ({chip}): {first_problem(error, View)}")
    if not problems:
        problems += _radians(found.values())
    refuse(path, problems)
    return found


def _stem(text: str) -> str:
    """The name of a chip that a table names, or whose file it names."""
    file = PurePosixPath(text.replace("\\", "/"))
    suffixes = {suffix for name in registry.names() for suffix in registry.get(name).suffixes} | PICTURES
    return file.stem if file.suffix.lower() in suffixes else file.name


def _within_a_turn(azimuth_deg: float, sense: Sense) -> float:
    """An azimuth clockwise, -360 to 360 degrees."""
    own = azimuth_deg if sense == "clockwise" else -azimuth_deg
    return own if abs(own) <= 360.0 else own % 360.0


def _radians(views: Iterable[View]) -> list[str]:
    """The problem that angles seem to be radians: some views, all within 6.3 of azimuth and within 1.6 of grazing."""
    angles = [(abs(view.azimuth_deg), min(view.incidence_deg, 90.0 - view.incidence_deg)) for view in views]
    if len(angles) < FEW or any(a > 2.0 * math.pi or e > 0.5 * math.pi for a, e in angles):
        return []
    return ["all azimuths are below 6.3 and all elevations below 1.6: the angles seem to be radians; must be degrees"]


def _chosen(path: Path, views: dict[str, View], sources: Iterable[Path]) -> list[tuple[Path, View]]:
    """Every source with the view that its file name, less the suffix, names. Raises InputError for one without."""
    pairs, problems, seen = [], [], set()
    for source in sources:
        if source.stem in seen:
            problems.append(f"{source}: a chip of this name is given twice")
        elif source.stem not in views:
            problems.append(f"{source}: no line of the table is called {source.stem}")
        else:
            pairs.append((source, views[source.stem]))
        seen.add(source.stem)
    refuse(path, problems)
    return pairs


def _one_of(path: Path, columns: list[str], allowed: tuple[str, ...]) -> str:
    """The one column of a table that is `allowed`, with `_deg` or without."""
    found = [column for column in columns if column in {*allowed, *(one.removesuffix("_deg") for one in allowed)}]
    if len(found) != 1:
        raise InputError(
            f"{path}: found the columns {', '.join(columns)}; exactly one of {', '.join(allowed)} is needed"
        )
    return found[0]


def _value(key: str, text: Any) -> Any:
    if key == "role":
        return text
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    return number if math.isfinite(number) else text


@dataclass(frozen=True)
class ImportedChips:
    """What was imported: names of the `views`, in their order, and the share of clipped pixels in each.

    `sheet` is a picture of all images, or of some of them where there are many.
    """

    views: tuple[str, ...]
    clipped: tuple[float, ...]
    messages: tuple[str, ...]
    sheet: Path


def import_chips(
    sources: Sequence[str | Path],
    scene_path: str | Path,
    table: str | Path,
    *,
    file_format: str = "auto",
    quantity: Quantity | None = None,
    polarization: str | None = None,
    radar_at: RadarAt = "top",
    spacing_m: tuple[float, float] | None = None,
    scale: Scale = "as declared",
    role: str | None = None,
    train: int | None = None,
    held_back: Sequence[Sector] = (),
    azimuths: Sense = "clockwise",
) -> ImportedChips:
    """Bring slant-plane pictures onto the grid of a scene, each as the view that the table names after its file.

    Views that the scene file has already keep what it says and get the image. `read_views` says what a table
    holds and `azimuths` means, and `assigned` what `role`, `train` and `held_back` do; the other arguments are those of
    `import_measured`. The scene file is written once, at the end. Raises
    InputError for a table or a file that cannot be read, and for a file that the table does not name.
    """
    scene_path, table = Path(scene_path), Path(table)
    paths = [Path(source) for source in sources]
    views = read_views(table, azimuths)
    named = [view.name for _, view in _chosen(table, views, paths)]
    views = assigned(table, views, named, role=role, train=train, held_back=held_back)
    pairs = _chosen(table, views, paths)
    scene, _ = opened(scene_path, pairs[0][1].name)
    known = {view.name for view in opened(scene_path, None)[0].views}
    clipped, done, pictures = [], [], []
    messages: dict[str, int] = dict.fromkeys(scene.warnings, 1)
    for source, view in pairs:
        chip = registry.read(
            [source],
            file_format=file_format,
            quantity=quantity,
            polarization=polarization,
            radar_at=radar_at,
            spacing_m=spacing_m,
        )
        if not isinstance(chip, ImageChip) or chip.locate is not None:
            raise InputError(f"{source}: is no picture in the slant plane; import it by itself, without --table")
        pol = polarization_of(chip.source, None, polarization or scene.radar.polarizations[0], scene)
        gridded = on_grid(chip, scene, view, Gridding())
        power, per_pixel, notes = gridded.power, gridded.samples, gridded.messages
        top = clip_level(chip, per_pixel)
        clipped.append(float(np.mean(power >= top)) if top is not None else 0.0)
        looks = view.looks or equivalent_looks(power)
        if looks is None:
            notes = [*notes, "too little homogeneous ground to estimate looks from; none written"]
        for one in (*notes, *rounding(chip)):
            messages[one] = messages.get(one, 0) + 1
        image = scene_path.parent / f"{view.name}_{pol}.exr"
        write_exr(image, {pol: power})
        slc = keep_phase(image, pol, gridded)
        pictures.append(quick_look(image, view, pol, power, scene))
        stated = {
            "looks": None if looks is None else round(looks, 2),
            "looks_estimated": None if looks is None or (view.looks and not view.looks_estimated) else True,
            "clipped_at": top,
        }
        done.append((view, pol, image.name, stated, slc))
    sheet = scene_path.parent / f"{scene_path.stem}_measured.png"
    contact_sheet(sheet, pictures)
    with editing(scene_path) as document:
        if scale == "unknown":
            document["image"]["calibrated"] = False
        for view, pol, name, stated, slc in done:
            declare(document, view, view.name in known, pol, name, stated, slc)
    if scale != "unknown" and scene.grid.calibrated:
        messages[f"{scene_path}: image.calibrated is true, but pictures give no beta0: use --scale unknown"] = 1
    texts = tuple(text if count == 1 else f"{text} ({count} chips)" for text, count in messages.items())
    return ImportedChips(tuple(view.name for view, *_ in done), tuple(clipped), texts, sheet)


# ---- which views are learned from, and which are held back as test views


Sector = tuple[float, float]


def inside(azimuth_deg: float, sector: Sector) -> bool:
    """Whether an azimuth lies in the sector that runs clockwise from its first to its second azimuth [deg]."""
    low, high = sector
    return (azimuth_deg - low) % 360.0 <= (high - low) % 360.0


def assigned(
    table: Path,
    views: Mapping[str, View],
    given: Sequence[str],
    *,
    role: str | None = None,
    train: int | None = None,
    held_back: Sequence[Sector] = (),
) -> dict[str, View]:
    """The views of a table with roles for those that are `given` and state none.

    All of them have the `role`, if there is one. Views in a sector that is held back are test views. Of the others,
    `train` views spread evenly in the order of their azimuth are train views, and the rest are test views. Raises
    InputError where there are fewer than `train`.
    """
    free = [name for name in given if "role" not in views[name].model_fields_set]
    back = {name for name in free if any(inside(views[name].azimuth_deg, one) for one in held_back)}
    roles = dict.fromkeys(free, role) if role is not None else {}
    roles |= dict.fromkeys(back, "test")
    if train is not None:
        open_to_all = sorted(set(free) - back, key=lambda name: (views[name].azimuth_deg % 360.0, name))
        if len(open_to_all) < train:
            raise InputError(
                f"{table}: --train {train}: found {len(open_to_all)} views that are not held back and state no role; "
                f"must be {train} or more"
            )
        chosen = {open_to_all[int(k)] for k in np.linspace(0, len(open_to_all), train, endpoint=False)}
        roles |= {name: "train" if name in chosen else "test" for name in open_to_all}
    found = dict(views)
    for name, one in roles.items():
        if one is not None:
            stated = views[name].model_dump(by_alias=True, exclude_unset=True)
            found[name] = View.model_validate({**stated, "role": one})
    return found
