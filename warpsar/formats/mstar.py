"""MSTAR chips: a Phoenix header in text, then magnitude, then phase, in big-endian float32."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from warpsar.errors import InputError
from warpsar.formats.base.data import Facts, ImageChip, reading
from warpsar.formats.base.format import Format, Stated

MAGIC = b"[PhoenixHeaderVer"
_END = b"[EndofPhoenixHeader]"


def read(path: Path, stated: Stated) -> ImageChip:
    """The complex chip, upside down where the radar is at the bottom. The target's front is the world's north."""
    with reading(path, "MSTAR chip"):
        content = path.read_bytes()
    start = content[:4096].find(MAGIC)
    end = content.find(_END)
    if start < 0 or end < 0:
        raise InputError(f"{path}: not a readable MSTAR chip (no Phoenix header)")
    header = dict(re.findall(r"^(\w+)= *(.*?) *$", content[start:end].decode("latin-1"), re.MULTILINE))

    def number(name: str, unit: str = "") -> float:
        value = header.get(name, "").lower().removesuffix(unit).strip()
        try:
            return float(value)
        except ValueError:
            raise InputError(f"{path}: header field {name} = {header.get(name)!r}; a number is needed") from None

    def whole(name: str, least: int) -> int:
        value = number(name)
        if not (value.is_integer() and least <= value <= len(content)):  # neither NaN nor infinity is
            raise InputError(f"{path}: header field {name} = {value:g}; must be {least} to the file's {len(content)}")
        return int(value)

    rows, cols = whole("NumberOfRows", 1), whole("NumberOfColumns", 1)
    offset = whole("PhoenixHeaderLength", 0) + whole("native_header_length", 0)
    size = rows * cols
    if len(content) - offset < 8 * size:
        raise InputError(
            f"{path}: {len(content)} bytes; {rows} x {cols} pixels of magnitude and phase need {offset + 8 * size}"
        )
    values = np.frombuffer(content, ">f4", 2 * size, offset).reshape(2, rows, cols).astype(np.float32)
    with np.errstate(all="ignore"):  # pixels that are not finite stay so, and are left out
        samples = (values[0] * np.exp(1j * values[1])).astype(np.complex64)
    position = header.get("RadarPosition", "").lower()
    if position not in ("top", "bottom"):
        raise InputError(f"{path}: header field RadarPosition = {position!r}; top or bottom is known")
    if position == "bottom":
        samples = samples[::-1]
    facts = Facts(
        azimuth_deg=number("TargetAz") % 360.0,
        incidence_deg=90.0 - number("MeasuredDepression"),
        frequency_hz=1e9 * number("CenterFrequency", "ghz"),
        polarization=header.get("Polarization", "").upper() or None,
        target_roll_deg=_turn(number("TargetRoll")) if "TargetRoll" in header else None,
        target_pitch_deg=_turn(number("TargetPitch")) if "TargetPitch" in header else None,
    )
    return ImageChip(
        source=str(path),
        samples=samples,
        quantity="complex",
        facts=lambda reference_point_m: facts,
        spacing_m=(number("RangePixelSpacing"), number("CrossRangePixelSpacing")),
    )


def _turn(angle_deg: float) -> float:
    """An angle as -180 to 180 degrees: headers have 358.58 for -1.42."""
    return (angle_deg + 180.0) % 360.0 - 180.0


FORMAT = Format(
    "mstar",
    "MSTAR Phoenix chip",
    "`[PhoenixHeaderVer`",
    "complex chip, upside down so that the radar is on top; the target's front is north; its roll and pitch, for the "
    "only object with a mesh",
    read,
    detect=lambda path, head: MAGIC in head,
)
