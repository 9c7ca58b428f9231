"""GAMMA images in slant range (.mli, .slc, .rslc ...) with the parameter file of the same name and `.par` behind it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from warpsar.errors import InputError
from warpsar.formats.base.data import ImageChip
from warpsar.formats.base.format import Format, Stated
from warpsar.formats.base.located import chip_of
from warpsar.io import input_file
from warpsar.products.grid import LineGrid
from warpsar.products.orbit import Orbit
from warpsar.products.product import Product
from warpsar.products.zero_doppler import Side

LARGEST_TEXT = 2**22
"""Bytes of a parameter file; they have some 4 kB."""
TITLE = "Gamma Interferometric SAR Processor"
TYPES = {"FLOAT": ">f4", "FCOMPLEX": ">c8", "SCOMPLEX": ">i2"}
_DAY_S = 86400.0


class _Big:
    """An image in a flat file of big-endian numbers, read only where it is sliced."""

    def __init__(self, path: Path, shape: tuple[int, int], kind: str) -> None:
        self.path, self.shape, self.kind = path, shape, kind
        self.dtype = np.dtype(np.float32 if kind == "FLOAT" else np.complex64)

    def __getitem__(self, window: tuple[slice, slice]) -> np.ndarray:
        pair = (2,) if self.kind == "SCOMPLEX" else ()
        try:
            found = np.memmap(self.path, TYPES[self.kind], "r", shape=(*self.shape, *pair))[window]
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read ({error.strerror})") from error
        if pair:
            return np.asarray(found[..., 0].astype(np.float32) + 1j * found[..., 1], np.complex64)
        return np.asarray(found, self.dtype)


def parameter_file(path: Path) -> Path:
    """The .par of an image; itself where it is one."""
    return path if _begins(path) else path.with_name(f"{path.name}.par")


def _begins(path: Path) -> bool:
    """Whether a file begins as a parameter file."""
    try:
        with path.open("rb") as file:
            return TITLE.encode() in file.read(256)
    except (OSError, ValueError):
        return False


def is_one(path: Path, head: bytes) -> bool:
    """An image with such a parameter file beside it, or the parameter file itself."""
    return TITLE.encode() in head[:256] or _begins(parameter_file(path))


def products(path: Path, polarization: str | None) -> tuple[Product, ...]:
    """The product of an image or of its parameter file. GAMMA does not say what power a detected image holds."""
    par = parameter_file(path)
    keys = _Keys(par)
    image = par.with_suffix("")
    kind, geometry = keys.text("image_format"), keys.text("image_geometry")
    if kind not in TYPES:
        raise InputError(f"{par}: image_format: found {kind}; must be one of {', '.join(TYPES)}")
    if geometry != "SLANT_RANGE":
        raise InputError(
            f"{par}: image_geometry: found {geometry}; must be SLANT_RANGE: the file's polynomials to slant range do "
            "not say for which lines each holds. Take the image before it was projected, or the SAFE folder"
        )
    lines, pixels = keys.whole("azimuth_lines"), keys.whole("range_samples")
    found = _polarization(keys.text("title")) or _polarization(image.name)
    if polarization is not None and found is not None and polarization != found:
        raise InputError(f"{par}: found the polarization {found}; {polarization} was asked for")
    turned = keys.numbers("azimuth_angle")[0]
    side: Side = "right" if turned > 0.0 else "left"
    grid = LineGrid(
        lines,
        pixels,
        keys.numbers("start_time")[0],
        keys.numbers("azimuth_line_time")[0],
        keys.numbers("near_range_slc")[0],
        keys.numbers("range_pixel_spacing")[0],
    )
    if grid.line_s <= 0.0 or grid.range_step_m <= 0.0:
        raise InputError(f"{par}: azimuth_line_time and range_pixel_spacing: must be positive")
    samples = _Big(image, (lines, pixels), kind) if image.is_file() else None
    if samples is not None:
        size, needed = image.stat().st_size, lines * pixels * {"FLOAT": 4, "SCOMPLEX": 4, "FCOMPLEX": 8}[kind]
        if size != needed:
            raise InputError(f"{image}: found {size} bytes; {par.name} says {lines} x {pixels} pixels, {needed} bytes")
    return (
        Product(
            source=str(image),
            platform=keys.text("sensor"),
            epoch=keys.date(),
            polarization=found or polarization,
            frequency_hz=keys.numbers("radar_frequency")[0],
            side=side,
            grid=grid,
            orbit=_orbit(keys),
            samples=samples,
            quantity="power" if kind == "FLOAT" else "complex",
            radiometry=None,
            bandwidth_hz=(keys.optional("chirp_bandwidth"), keys.optional("azimuth_proc_bandwidth")),
        ),
    )


def read(path: Path, stated: Stated) -> ImageChip:
    """The image, placed by its orbit; not calibrated."""
    return chip_of(products(path, stated.polarization)[0], path, stated)


class _Keys:
    """Lines `key: values` of a parameter file; units stand behind the values."""

    def __init__(self, path: Path) -> None:
        self.path = path
        text = input_file.read_bytes(path, "a parameter file", LARGEST_TEXT).decode("utf-8", errors="replace")
        if TITLE not in text[:256]:
            raise InputError(f"{path}: found no {TITLE!r} in its first line; must be GAMMA's")
        pairs = (line.partition(":") for line in text.splitlines() if ":" in line)
        self.lines = {key.strip(): value.strip() for key, _, value in pairs}

    def text(self, key: str) -> str:
        if not (found := self.lines.get(key)):
            raise InputError(f"{self.path}: found no {key}; must be there")
        return found

    def numbers(self, key: str, count: int = 1) -> list[float]:
        words = self.text(key).split()[:count]
        try:
            found = [float(word) for word in words]
        except ValueError:
            found = []
        if len(found) != count or not np.isfinite(found).all():
            raise InputError(f"{self.path}: {key}: found {self.text(key)[:60]!r}; must begin with {count} numbers")
        return found

    def whole(self, key: str) -> int:
        (found,) = self.numbers(key)
        if found != int(found) or not 1 <= found <= 2**24:
            raise InputError(f"{self.path}: {key}: found {found:g}; must be a whole number from 1 to {2**24}")
        return int(found)

    def optional(self, key: str) -> float | None:
        found = self.numbers(key)[0] if key in self.lines else 0.0
        return found if found > 0.0 else None

    def date(self) -> np.datetime64:
        year, month, day = (int(each) for each in self.numbers("date", 3))
        try:
            return np.datetime64(f"{year:04d}-{month:02d}-{day:02d}", "us")
        except ValueError:
            raise InputError(f"{self.path}: date: found {self.text('date')!r}; must be year, month and day") from None


def _orbit(keys: _Keys) -> Orbit | None:
    if "number_of_state_vectors" not in keys.lines or keys.numbers("number_of_state_vectors")[0] < 2:
        return None
    count = keys.whole("number_of_state_vectors")
    start, step = keys.numbers("time_of_first_state_vector")[0], keys.numbers("state_vector_interval")[0]
    line = keys.numbers("start_time")[0]
    start += _DAY_S * round((line - start - 0.5 * step * (count - 1)) / _DAY_S)  # past midnight
    place, speed = (
        [keys.numbers(f"state_vector_{what}_{i + 1}", 3) for i in range(count)] for what in ("position", "velocity")
    )
    return Orbit.of(str(keys.path), start + step * np.arange(count), place, speed)


def _polarization(text: str) -> str | None:
    found = re.search(r"(?<![A-Za-z])(HH|HV|VH|VV)(?![A-Za-z])", text.upper())
    return found[1] if found else None


FORMAT = Format(
    "gamma",
    "GAMMA .mli, .slc",
    "`.par` of GAMMA beside it",
    "image in slant range, placed by orbit and zero Doppler; its file does not say what power it holds",
    read,
    detect=is_one,
    products=products,
)
