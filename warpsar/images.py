"""Image files in and out, through OpenImageIO: float32, linear power; quick looks in dB."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from warpsar.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A temporary name beside `path`, of its suffix, that becomes `path` when the block ends well."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{uuid4().hex}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _read(path: Path, *, floating: bool) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """Pixels, shape (rows, cols, channels), and the channels' names, of an image or a NumPy file."""
    if not path.is_file():
        raise InputError(f"{path}: no such image file")
    if path.suffix.lower() == ".npy":
        return _read_npy(path, floating=floating)
    import OpenImageIO as oiio  # noqa: N813

    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise InputError(f"{path}: cannot be read as an image ({_reason(oiio.geterror())})")
    try:
        spec = source.spec()
        if spec.deep or spec.depth > 1:
            raise InputError(f"{path}: found a deep or volume image; must be a plain one of rows and columns")
        if floating and spec.format.basetype not in (oiio.HALF, oiio.FLOAT, oiio.DOUBLE):
            raise InputError(
                f"{path}: found pixels of type {spec.format}; must be floating point (float32 TIFF or EXR)"
            )
        pixels = source.read_image(0, 0, 0, spec.nchannels, oiio.FLOAT)
        if pixels is None:
            raise InputError(f"{path}: broken or truncated ({_reason(source.geterror())})")
        names = tuple(spec.channelnames)
    finally:
        source.close()
    return np.asarray(pixels, np.float32).reshape(spec.height, spec.width, spec.nchannels), names


def _reason(text: str) -> str:
    """What OpenImageIO says, on one line."""
    return " ".join(text.split()) or "no reason given"


def _read_npy(path: Path, *, floating: bool) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    try:
        array = np.load(path, allow_pickle=False)
    except Exception as error:  # the header is parsed as Python text: whatever a broken one makes it raise
        raise InputError(f"{path}: cannot be read as a NumPy array ({error})") from error
    if not isinstance(array, np.ndarray) or array.ndim not in (2, 3):
        raise InputError(f"{path}: found an array of shape {np.shape(array)}; must be (rows, cols[, channels])")
    if array.dtype.kind not in ("f" if floating else "fiub"):
        raise InputError(f"{path}: found values of type {array.dtype}; must be floating point")
    with np.errstate(over="ignore"):  # beyond float32 is infinite, and masked or refused as such
        array = np.atleast_3d(array).astype(np.float32)
    return array, tuple(str(i) for i in range(array.shape[2]))


def read_image(path: str | Path) -> NDArray[np.float32]:
    """All channels of a floating-point image (TIFF, EXR, NPY ...), shape (rows, cols, channels).

    Raises `InputError` for a file that is missing, broken, truncated or of whole numbers (of unknown scale).
    """
    return _read(Path(path), floating=True)[0]


def read_channel(path: str | Path, name: str | None = None) -> NDArray[np.float32]:
    """One channel, shape (rows, cols): the only one, or the one called `name`.

    Raises `InputError` as `read_image` does, and where there are several channels and none has the name.
    """
    path = Path(path)
    pixels, names = _read(path, floating=True)
    if len(names) == 1:
        return pixels[:, :, 0]
    if name not in names:
        wanted = f", or one named {name}" if name else ""
        raise InputError(f"{path}: found the channels {', '.join(names)}; must have one channel{wanted}")
    return np.ascontiguousarray(pixels[:, :, names.index(name)])


def read_mask(path: str | Path) -> NDArray[np.bool_]:
    """The pixels to use, shape (rows, cols): not zero in some channel other than alpha."""
    pixels, names = _read(Path(path), floating=False)
    if len(names) > 1:
        pixels = pixels[:, :, [name != "A" for name in names]]
    return (np.nan_to_num(pixels, nan=0.0) != 0).any(axis=2)


def write_exr(path: str | Path, channels: Mapping[str, ArrayLike]) -> None:
    """Write float32 channels, each of shape (rows, cols), under their names, atomically."""
    arrays = [np.asarray(array, np.float32) for array in channels.values()]
    _write(Path(path), np.stack(arrays, axis=2), names=tuple(channels), compression="zip")


def write_tiff(path: str | Path, image: ArrayLike) -> None:
    """Write a float32 TIFF of one channel, shape (rows, cols), atomically."""
    _write(Path(path), np.asarray(image, np.float32)[:, :, None], compression="zip")


def quick_look(
    path: str | Path, beta0: ArrayLike, floor_db: float | None = None, ceiling_db: float | None = None
) -> tuple[float, float]:
    """Write a grey PNG of an image in dB, near range on top; the limits are returned and in its metadata.

    beta0: linear power, shape (rows, cols). Black is `floor_db` and below (and what is not positive or
    finite), white `ceiling_db` and above: by default the 2nd and 99.5th percentile of the positive pixels.
    """
    beta0 = np.asarray(beta0, np.float64)
    positive = np.isfinite(beta0) & (beta0 > 0)
    decibel = np.full(beta0.shape, -np.inf)
    decibel[positive] = 10 * np.log10(beta0[positive])
    low, high = np.percentile(decibel[positive], [2.0, 99.5]) if positive.any() else (-1.0, 0.0)
    low = float(low if floor_db is None else floor_db)
    high = float(high if ceiling_db is None else ceiling_db)
    if not high > low:  # a constant image, or a floor above everything: show a range of one dB
        high = low + 1.0
    grey = np.round(np.clip((decibel - low) / (high - low), 0.0, 1.0) * 255.0).astype(np.uint8)
    _write(Path(path), grey[:, :, None], description=f"beta0 in dB: black {low:.2f} dB, white {high:.2f} dB")
    return low, high


def _write(
    path: Path,
    pixels: NDArray[Any],
    names: tuple[str, ...] = (),
    compression: str | None = None,
    description: str | None = None,
) -> None:
    """Write pixels of shape (rows, cols, channels) in their own type, in the format of the suffix."""
    import OpenImageIO as oiio  # noqa: N813

    rows, cols, count = pixels.shape
    spec = oiio.ImageSpec(cols, rows, count, oiio.UINT8 if pixels.dtype == np.uint8 else oiio.FLOAT)
    if names:
        spec.channelnames = names
    if compression:
        spec.attribute("compression", compression)
    if description:
        spec.attribute("ImageDescription", description)
    with replacing(path) as temporary:
        target = oiio.ImageOutput.create(str(temporary))
        if target is None:
            raise InputError(f"{path}: cannot be written ({_reason(oiio.geterror())})")
        done = target.open(str(temporary), spec) and target.write_image(np.ascontiguousarray(pixels))
        done = target.close() and done
        if not done:
            raise OSError(f"{path}: cannot be written ({_reason(target.geterror())})")
