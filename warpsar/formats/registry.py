"""The formats by name, and the format that a file has. A file in this folder is a format."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from warpsar.errors import InputError
from warpsar.runtime.plugins import names_in

if TYPE_CHECKING:  # the command line asks for names, and loads no NumPy for them
    from warpsar.formats.base.data import ImageChip, PhaseHistory, Quantity, RadarAt
    from warpsar.formats.base.format import Format
    from warpsar.products.product import Product
    from warpsar.world.earth import EarthFrame


def names() -> tuple[str, ...]:
    """All formats; none of them is imported."""
    return names_in(__package__)


def get(name: str) -> Format:
    """The format called `name`; each module `warpsar.formats.<name>` holds it as `FORMAT`."""
    found: Format = import_module(f"warpsar.formats.{name}").FORMAT
    return found


def _regular(path: Path) -> None:
    """Raise InputError for what is no plain file: a pipe waits for ever, and a device never ends."""
    if not os.path.exists(path):  # Path.exists raises for names that no file can have
        raise InputError(f"{path}: no such file")
    if not os.path.isfile(path):
        raise InputError(f"{path}: cannot be read (a directory, pipe or device); must be a file")


def detect(path: Path, allowed: Sequence[str] | None = None, option: str = "--format") -> str:
    """The name of a file's format; raises InputError for a file that has none.

    It lists those `allowed`, and the `option` that states one.
    """
    _regular(path)
    try:
        with path.open("rb") as file:
            head = file.read(4096)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    for one in sorted(map(get, names()), key=lambda one: (bool(one.suffixes), one.detect is None)):
        if one.fits(path, head):
            return one.name
    raise InputError(
        f"{path}: neither its first bytes nor its suffix name a known format; "
        f"choose one with {option}: {', '.join(allowed or names())}"
    )


def read(
    sources: Sequence[str | Path],
    *,
    file_format: str = "auto",
    quantity: Quantity | None = None,
    polarization: str | None = None,
    frame: EarthFrame | None = None,
    radar_at: RadarAt = "top",
    spacing_m: tuple[float, float] | None = None,
) -> PhaseHistory | ImageChip:
    """Read one measurement; several files only where their format joins them.

    `quantity` ("amplitude" or "power") is for pictures of real numbers only: the other formats say it themselves.
    `frame` says where the world lies on the earth, for formats in earth coordinates. `radar_at` and `spacing_m` (range,
    azimuth) [m] are for pictures already in the slant plane, which do not say them. Raises InputError, one message
    that names the file, for whatever cannot be read.
    """
    from warpsar.formats.base.format import Stated

    paths = [Path(source) for source in sources]
    if not paths:
        raise InputError("no source file given")
    name = detect(paths[0]) if file_format == "auto" else file_format
    if name not in names():
        raise InputError(f"format {name!r}: not known; use one of auto, {', '.join(names())}")
    one = get(name)
    if one.read is None:
        raise InputError(f"{paths[0]}: found {one.title}; an image is needed here")
    if len(paths) > 1 and one.join is None:
        joined = ", ".join(each.title for each in map(get, names()) if each.join is not None)
        raise InputError(f"{len(paths)} sources: only {joined} files can be combined, and {paths[0]} is {name}")
    if quantity is not None and "quantity" not in one.asks:
        raise InputError(f"{paths[0]}: {name} says itself what its numbers are; leave --quantity out")
    if (radar_at != "top" and "radar_at" not in one.asks) or (spacing_m is not None and "spacing_m" not in one.asks):
        raise InputError(f"{paths[0]}: {name} says itself where the radar is; leave --radar-at and --spacing out")
    for path in paths:
        _regular(path)
    stated = Stated(quantity, polarization, frame, radar_at, spacing_m)
    found = [one.read(path, stated) for path in paths]
    return found[0] if one.join is None else one.join(found)


def _with_products() -> list[str]:
    return [name for name in names() if get(name).products is not None]


def _folders() -> dict[str, tuple[str, str]]:
    """Formats that are handed on as folders: the folder inside, and what users call it."""
    return {name: folder for name in names() if (folder := get(name).folder) is not None}


def _within(path: Path) -> str:
    """Which folder to name in place of a file that lies in one, as a clause; empty where it lies in none."""
    for folder in path.absolute().parents[:2]:
        for inside, called in _folders().values():
            if (folder / inside).is_dir():
                return f"; it lies in {called}, which says it: name {folder}"
    return ""


def _of_folder(path: Path) -> str:
    """The name of a folder's format; raises InputError for one that has none."""
    folders = _folders()
    for name, (inside, _) in folders.items():
        if (path / inside).is_dir():
            return name
    raise InputError(
        f"{path}: found a folder without {' or '.join(f'{inside}/' for inside, _ in folders.values())}; must be "
        f"{', '.join(called for _, called in folders.values())}, or a file of one of {', '.join(_with_products())}"
    )


def products(
    source: str | Path, *, file_format: str = "auto", polarization: str | None = None, option: str = "--format"
) -> tuple[Product, ...]:
    """The images of the earth with an orbit that a file holds, or a folder such as a SAFE one.

    `polarization` chooses; without it all are given. Raises InputError, one message that names the file, and the
    command line's `option` for `file_format` where that must be said.
    """
    path = Path(source)
    name = file_format
    if file_format == "auto" and path.is_dir():
        name = _of_folder(path)
    elif file_format == "auto" and zipfile.is_zipfile(path):
        raise InputError(f"{path}: found a zip archive; unpack it, and name the folder or file inside")
    elif file_format == "auto":
        name = detect(path, _with_products(), option)
    if name not in names():
        raise InputError(f"format {name!r}: not known; use one of auto, {', '.join(names())}")
    one = get(name)
    if one.products is None:
        allowed = _within(path) or f"; must be one of {', '.join(_with_products())}"
        raise InputError(f"{path}: found {one.title}, {one.no_products}{allowed}")
    if one.extra is not None:
        one.extra.require(f"{path}: {one.title}")
    return one.products(path, polarization)
