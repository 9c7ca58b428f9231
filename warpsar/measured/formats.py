"""The reader that a file needs: its first bytes tell, or its suffix where it is a picture."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from warpsar.errors import InputError
from warpsar.measured import cphd, gotcha, mstar, nisar, pictures, sicd
from warpsar.measured.data import ImageChip, PhaseHistory, Quantity, RadarAt
from warpsar.measured.earth import EarthFrame

PICTURES = ("geotiff", "tiff", "exr", "npy", "jpeg")
FORMATS = ("gotcha", "cphd", "sicd", "mstar", "nisar", "geotiff", "tiff", "exr", "npy", "jpeg", "rcs")
_MAGIC = {
    b"MATLAB 5.0 MAT-file": "gotcha",
    cphd.MAGIC: "cphd",
    b"NITF": "sicd",
    nisar.MAGIC: "nisar",
    b"\xff\xd8\xff": "jpeg",
}


def _regular(path: Path) -> None:
    """Raise InputError for what is no plain file: a pipe waits for ever, and a device never ends."""
    if not os.path.exists(path):  # Path.exists raises for names that no file can have
        raise InputError(f"{path}: no such file")
    if not os.path.isfile(path):
        raise InputError(f"{path}: cannot be read (a directory, pipe or device); must be a file")


def detect(path: Path) -> str:
    """The format's name, one of `FORMATS`; raises InputError for a file that is none of them."""
    _regular(path)
    try:
        with path.open("rb") as file:
            head = file.read(4096)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    for magic, name in _MAGIC.items():
        if head.startswith(magic):
            return name
    if mstar.MAGIC in head:
        return "mstar"
    suffix = path.suffix.lower()
    if suffix in (".csv", ".txt"):
        return "rcs"
    if suffix in pictures.SUFFIXES:
        if suffix in (".tif", ".tiff"):
            return "geotiff" if pictures.is_map(path) else "tiff"
        return suffix[1:]
    raise InputError(
        f"{path}: neither its first bytes nor its suffix name a known format; "
        f"choose one with --format: {', '.join(FORMATS)}"
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
    """Read one measurement; only AFRL .mat files may be several.

    `quantity` ("amplitude" or "power") is for pictures of real numbers only: the other formats say it themselves.
    `frame` says where the world lies on the earth, for formats in earth coordinates. `radar_at` and `spacing_m` (range,
    azimuth) [m] are for pictures already in the slant plane, which do not say them. Raises InputError, one message
    that names the file, for whatever cannot be read.
    """
    paths = [Path(source) for source in sources]
    if not paths:
        raise InputError("no source file given")
    name = detect(paths[0]) if file_format == "auto" else file_format
    if name not in FORMATS:
        raise InputError(f"format {name!r}: not known; use one of auto, {', '.join(FORMATS)}")
    if name == "rcs":
        raise InputError(f"{paths[0]}: found curves of radar cross-section; an image is needed here")
    if len(paths) > 1 and name != "gotcha":
        raise InputError(f"{len(paths)} sources: only AFRL .mat files can be combined, and {paths[0]} is {name}")
    if quantity is not None and name not in PICTURES:
        raise InputError(f"{paths[0]}: {name} says itself what its numbers are; leave --quantity out")
    if (radar_at != "top" or spacing_m is not None) and (name not in PICTURES or name == "geotiff"):
        raise InputError(f"{paths[0]}: {name} says itself where the radar is; leave --radar-at and --spacing out")
    for path in paths:
        _regular(path)
    path = paths[0]
    measured: PhaseHistory | ImageChip
    if name == "gotcha":
        measured = gotcha.read(paths)
    elif name == "cphd":
        measured = cphd.read(path, polarization, frame)
    elif name == "sicd":
        measured = sicd.read(path, frame)
    elif name == "mstar":
        measured = mstar.read(path)
    elif name == "nisar":
        measured = nisar.read(path, polarization, frame)
    else:
        measured = pictures.read(path, quantity, polarization, frame, kind=name, radar_at=radar_at, spacing_m=spacing_m)
    return measured
