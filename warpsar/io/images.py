"""Image files in and out, through OpenImageIO: float32, linear power."""

from __future__ import annotations

import os
import struct
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from tokenize import TokenError
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.errors import InputError
from warpsar.io import tiff
from warpsar.runtime import threads

LARGEST_IMAGE = 2**28
"""Pixels of an image: 1 GiB of float32."""
_MOST_PER_BYTE = 8 * 1032  # pixels: deflate packs 1032 to 1, and a mask's pixel may be a bit
_OIIO_FORMATS = {b"v/1\x01": "openexr", **dict.fromkeys(tiff.MAGIC, "tiff")}
_PNG = b"\x89PNG"
_TOPS = {"uint8": 255.0, "uint16": 65535.0}  # the largest levels of whole numbers


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A temporary file name beside `path`, with its suffix; when the block ends well the file is renamed to `path`."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{uuid4().hex}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        if error.errno is not None:  # name the file that was wanted, not the temporary one
            error.filename, error.filename2 = str(path), None
        raise
    finally:
        temporary.unlink(missing_ok=True)


@dataclass(frozen=True)
class _Picture:
    """An image file: its header is read, its pixels are not yet."""

    names: tuple[str, ...]
    """Its channels."""
    kind: str | None
    """The type of its numbers where it is not a floating-point one."""
    pixels: Callable[[int, int], NDArray[Any]]
    """Channels from the first number up to the second, shape (rows, cols, channels)."""
    top: float | None = None
    """The largest level of whole numbers without a sign, of 8 or 16 bits; None for other numbers."""


@contextmanager
def _opened(path: Path, shape: tuple[int, int] | None) -> Iterator[_Picture]:
    """An image or a NumPy file. Its size is checked against `shape` and its bytes before any pixel is read."""
    if not os.path.isfile(path):  # Path.is_file raises for names that no file can have
        raise InputError(f"{path}: no such image file")
    if path.suffix.lower() == ".npy":
        yield _open_npy(path, shape)
        return
    try:
        with path.open("rb") as file:
            magic = file.read(4)
    except OSError as error:
        raise InputError(f"{path}: cannot be read as an image ({error.strerror})") from error
    if magic == _PNG:
        with _open_png(path, shape) as picture:
            yield picture
    elif magic in _OIIO_FORMATS:
        with _open_oiio(path, _OIIO_FORMATS[magic], shape) as picture:
            yield picture
    else:
        raise InputError(f"{path}: cannot be read as an image (its first bytes are of no TIFF, EXR or PNG)")


def _check_size(path: Path, rows: int, cols: int, shape: tuple[int, int] | None) -> None:
    if shape is not None and (rows, cols) != tuple(shape):
        raise InputError(f"{path}: found {rows} x {cols} pixels; must be {shape[0]} x {shape[1]} (image.shape)")
    most = min(LARGEST_IMAGE, _MOST_PER_BYTE * path.stat().st_size)
    if not 0 < rows * cols <= most:
        raise InputError(
            f"{path}: found {rows} x {cols} pixels; must be 1 to {most}, by its {path.stat().st_size} bytes"
        )


@contextmanager
def _open_oiio(path: Path, kind: str, shape: tuple[int, int] | None) -> Iterator[_Picture]:
    import OpenImageIO as oiio  # noqa: N813

    if kind == "tiff":
        tiff.check(path)
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise InputError(f"{path}: cannot be read as an image ({_reason(oiio.geterror)})")
    try:
        spec = source.spec()
        if source.format_name() != kind:  # it asks all its readers, the suffix' first
            raise InputError(f"{path}: cannot be read as an image (found {source.format_name()}; must be {kind})")
        if spec.deep or spec.depth > 1:
            raise InputError(f"{path}: found a deep or volume image; must be a plain one of rows and columns")
        _check_size(path, spec.height, spec.width, shape)
        try:
            names = tuple(spec.channelnames)
        except UnicodeDecodeError as error:
            raise InputError(f"{path}: broken (its channels' names are not UTF-8)") from error

        @cache
        def check_pixels() -> None:
            if kind == "tiff":
                tiff.check_pixels(path)

        def pixels(first: int, end: int) -> NDArray[Any]:
            _check_size(path, spec.height * (end - first), spec.width, None)
            check_pixels()
            found = source.read_image(0, 0, first, end, oiio.FLOAT if top is None else spec.format)
            if found is None:
                raise InputError(f"{path}: broken or truncated ({_reason(source.geterror)})")
            return np.asarray(found, np.float32).reshape(spec.height, spec.width, end - first)

        floating = spec.format.basetype in (oiio.HALF, oiio.FLOAT, oiio.DOUBLE)
        top = _TOPS.get(str(spec.format))
        yield _Picture(names, None if floating else str(spec.format), pixels, top)
    finally:
        source.close()


def _reason(error: Callable[[], str]) -> str:
    """What OpenImageIO says, on one line."""
    try:
        return " ".join(error().split())[:500] or "no reason given"
    except UnicodeDecodeError:  # it quotes the file's own bytes
        return "no readable reason given"


@contextmanager
def _open_png(path: Path, shape: tuple[int, int] | None) -> Iterator[_Picture]:
    """Open with Pillow: OpenImageIO's reader of PNG writes to stderr about broken files."""
    from PIL.PngImagePlugin import PngImageFile

    def broken(error: Exception) -> InputError:
        return InputError(f"{path}: cannot be read as an image ({error})")

    try:
        picture = PngImageFile(BytesIO(path.read_bytes()))  # of a file it asks for as much as a chunk claims
    except _PNG_ERRORS as error:
        raise broken(error) from error
    with picture:
        _check_size(path, picture.height, picture.width, shape)

        def pixels(first: int, end: int) -> NDArray[Any]:
            try:
                plain = picture.convert("RGBA") if picture.mode in ("P", "PA") else picture
                found = np.asarray(plain)
            except _PNG_ERRORS as error:
                raise broken(error) from error
            return np.atleast_3d(found)[:, :, first:end]

        names = ("R", "G", "B", "A") if picture.mode in ("P", "PA") else picture.getbands()
        top = {"1": 1.0, "I": _TOPS["uint16"], "I;16": _TOPS["uint16"]}.get(picture.mode, _TOPS["uint8"])
        yield _Picture(tuple(names), "uint", pixels, top)


# What Pillow raises on broken files, by its documentation (OSError, SyntaxError) and by its decoders of chunks.
_PNG_ERRORS = (OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error)


def read_npy(path: Path) -> NDArray[Any]:
    """The array in a NumPy file, memory-mapped: no larger than the file, and never a pickle. Raises InputError."""
    try:
        # NumPy multiplies a shape's numbers, and finds headers of Python 2.
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return np.lib.format.open_memmap(path, mode="r")
    except (OSError, ValueError, EOFError, SyntaxError, TypeError, OverflowError, RecursionError, TokenError) as error:
        reason = " ".join(str(error).split())[:500]
        raise InputError(f"{path}: cannot be read as a NumPy array ({reason})") from error


def _open_npy(path: Path, shape: tuple[int, int] | None) -> _Picture:
    array = read_npy(path)
    if array.ndim not in (2, 3):
        raise InputError(f"{path}: found an array of shape {np.shape(array)}; must be (rows, cols[, channels])")
    if array.dtype.kind not in "fiub":
        raise InputError(f"{path}: found values of type {array.dtype}; must be floating point")
    _check_size(path, array.shape[0], array.shape[1], shape)
    array = np.atleast_3d(array)

    def pixels(first: int, end: int) -> NDArray[Any]:
        with np.errstate(all="ignore"):  # beyond float32 is infinite, and masked or refused as such
            return array[:, :, first:end].astype(np.float32)

    names = tuple(str(i) for i in range(array.shape[2]))
    kind = str(array.dtype)
    return _Picture(names, None if array.dtype.kind == "f" else kind, pixels, _TOPS.get(kind))


def _refuse_whole_numbers(path: Path, picture: _Picture) -> None:
    if picture.kind is not None:
        raise InputError(f"{path}: found pixels of type {picture.kind}; must be floating point (float32 TIFF or EXR)")


def read_image(path: str | Path) -> NDArray[np.float32]:
    """All channels of a floating-point image (TIFF, EXR, NPY), shape (rows, cols, channels).

    Raises `InputError` for a file that is missing, broken, truncated or of whole numbers (of unknown scale).
    """
    path = Path(path)
    with _opened(path, None) as picture:
        _refuse_whole_numbers(path, picture)
        return picture.pixels(0, len(picture.names))


def read_channel(
    path: str | Path, name: str | None = None, shape: tuple[int, int] | None = None
) -> NDArray[np.float32]:
    """One channel, shape (rows, cols): the only one, or the one called `name`.

    Raises `InputError` as `read_image` does. Also where none of several channels has the name, and where the image does
    not have the `shape` (rows, cols).
    """
    path = Path(path)
    with _opened(path, shape) as picture:
        _refuse_whole_numbers(path, picture)
        names = picture.names
        if len(names) > 1 and name not in names:
            wanted = f", or one named {name}" if name else ""
            raise InputError(f"{path}: found the channels {', '.join(names)}; must have one channel{wanted}")
        index = names.index(name) if len(names) > 1 and name is not None else 0
        return np.ascontiguousarray(picture.pixels(index, index + 1)[:, :, 0])


def read_levels(path: str | Path, name: str | None = None) -> tuple[NDArray[np.float32], float | None]:
    """One channel, shape (rows, cols), as `read_channel`, or levels in whole numbers of 8 or 16 bits, with their
    largest; None for numbers that have none.

    Grey levels may be stored as a picture in colour, with or without an opaque alpha. Raises `InputError` as
    `read_channel` does, and for a picture that has colours.
    """
    path = Path(path)
    with _opened(path, None) as picture:
        if picture.top is None:
            _refuse_whole_numbers(path, picture)
            return read_channel(path, name), None
        pixels = picture.pixels(0, len(picture.names))
        grey = pixels[:, :, [channel != "A" for channel in picture.names]]
        if (grey != grey[:, :, :1]).any():
            raise InputError(f"{path}: found a picture in colour; must be grey, one level per pixel")
        return np.ascontiguousarray(grey[:, :, 0], np.float32), picture.top


def read_mask(path: str | Path, shape: tuple[int, int] | None = None) -> NDArray[np.bool_]:
    """The pixels to use, shape (rows, cols): not zero in some channel other than alpha. PNG, or as `read_channel`."""
    with _opened(Path(path), shape) as picture:
        pixels = picture.pixels(0, len(picture.names))
    if len(picture.names) > 1:
        pixels = pixels[:, :, [name != "A" for name in picture.names]]
    return (np.nan_to_num(pixels, nan=0.0) != 0).any(axis=2)


def write_exr(path: str | Path, channels: Mapping[str, ArrayLike], header: Mapping[str, Any] | None = None) -> None:
    """Write float32 channels, each of shape (rows, cols), under their names, atomically.

    `header`: attributes by name, each a text, a number, or a list of either; numbers are float32 there.
    """
    arrays = [np.asarray(array, np.float32) for array in channels.values()]
    whole = np.stack(arrays, axis=2) if len(arrays) > 1 else arrays[0][:, :, None]
    _write(Path(path), whole, names=tuple(channels), compression="zip", header=header)


def write_tiff(path: str | Path, image: ArrayLike) -> None:
    """Write a float32 TIFF of one channel, shape (rows, cols), atomically."""
    _write(Path(path), np.asarray(image, np.float32)[:, :, None], compression="zip")


@cache
def _share_cores() -> None:
    """Let OpenEXR pack on this process's cores: by default every process takes all cores of the host."""
    import OpenImageIO as oiio  # noqa: N813

    oiio.attribute("exr_threads", threads.thread_count())


def _write(
    path: Path,
    pixels: NDArray[Any],
    names: tuple[str, ...] = (),
    compression: str | None = None,
    header: Mapping[str, Any] | None = None,
) -> None:
    """Write pixels of shape (rows, cols, channels) in their own type, in the format of the suffix."""
    import OpenImageIO as oiio  # noqa: N813

    _share_cores()
    rows, cols, count = pixels.shape
    spec = oiio.ImageSpec(cols, rows, count, oiio.UINT8 if pixels.dtype == np.uint8 else oiio.FLOAT)
    if names:
        spec.channelnames = names
    if compression:
        spec.attribute("compression", compression)
    for name, value in (header or {}).items():
        if not isinstance(value, list):
            spec.attribute(name, value)
        elif isinstance(value[0], str):
            spec.attribute(name, ", ".join(value))
        else:
            spec.attribute(name, oiio.TypeDesc(f"float[{len(value)}]"), tuple(value))
    with replacing(path) as temporary:
        target = oiio.ImageOutput.create(str(temporary))
        if target is None:
            raise InputError(f"{path}: cannot be written ({_reason(oiio.geterror)})")
        done = target.open(str(temporary), spec) and target.write_image(np.ascontiguousarray(pixels))
        done = target.close() and done
        if not done:
            raise OSError(f"{path}: cannot be written ({_reason(target.geterror)})")
