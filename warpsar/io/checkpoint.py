"""A run's state on disk, whole or not at all."""

from __future__ import annotations

import hashlib
import math
import os
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path
from tokenize import TokenError

import numpy as np
from numpy.lib import format

from warpsar.errors import InputError
from warpsar.io.images import replacing
from warpsar.runtime import console, once

NAME = "checkpoint.npz"
# What broken bytes make zipfile and NumPy, whose headers are Python text, raise.
_BROKEN: tuple[type[Exception], ...] = (OSError, ValueError, EOFError, LookupError, TypeError, OverflowError)
_BROKEN += (RecursionError, RuntimeError, SyntaxError, TokenError, struct.error, zipfile.BadZipFile, zlib.error)


class Checkpoint:
    """The checkpoint of one run in its folder, for all its processes: the first one reads, writes and removes it.

    A run that is begun, and not started again by torchrun, removes that of an earlier one. `resumes`: whether it goes
    on from what is stored. Without a `folder` nothing is stored, and nothing found.
    """

    def __init__(self, folder: Path | None, resume: bool = False) -> None:
        self._folder, self._restarts = folder, once.restarts()
        self.resumes = folder is not None and (resume or bool(self._restarts))
        if folder is not None and self._restarts == 0 and not resume:
            once.write(partial(remove, folder))  # of an earlier run: torchrun's restarts shall find this one's

    def stored(self, tag: str, *, needed: bool = False) -> dict[str, np.ndarray] | None:
        """The arrays that a run to be resumed goes on from, as `read` has them; None where there are none.

        `needed`: InputError is raised where there are none; but not under torchrun, which may start a job again before
        its first checkpoint.
        """
        folder = self._folder
        if folder is None or not self.resumes:
            return None

        def found() -> dict[str, np.ndarray] | None:
            arrays = read(folder, tag)
            if arrays is None and needed and self._restarts is None:
                raise InputError(f"--resume: found no checkpoint in {folder}; allowed is a folder with one of this run")
            return arrays

        arrays = once.find(found)
        if arrays is None:
            console.say("--resume: there is no checkpoint; the run starts afresh")
        return arrays

    def write(self, arrays: Callable[[], dict[str, np.ndarray]], tag: str) -> None:
        """Replace what is stored, as `write` does."""
        folder = self._folder
        if folder is not None:
            once.write(lambda: write(folder, arrays(), tag))


def write(folder: Path, arrays: dict[str, np.ndarray], tag: str) -> None:
    """Replace the folder's checkpoint; `tag` names the run it belongs to (input hash and options)."""
    whole = {**arrays, "tag": np.array(tag)}
    with replacing(folder / NAME) as temporary, temporary.open("wb") as stream:
        np.savez(stream, digest=np.array(_digest(whole)), **whole)  # type: ignore[arg-type]


def read(folder: Path, tag: str) -> dict[str, np.ndarray] | None:
    """The checkpoint's arrays; None where there is none.

    Raises InputError for one of another run, or one that cannot be read.
    """
    path = folder / NAME
    if not os.path.lexists(path):
        return None
    try:
        if not path.is_file():
            raise ValueError("not a file")
        with zipfile.ZipFile(path) as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of headers of Python 2
            arrays = {info.filename.removesuffix(".npy"): _array(archive, info) for info in archive.infolist()}
        if str(arrays.pop("digest", "")) != _digest(arrays):  # zip alone does not miss a member that is gone
            raise ValueError("damaged")
    except _BROKEN as error:
        raise InputError(f"{path}: not a checkpoint of warpsar ({error}); remove it to start afresh") from error
    if str(arrays.pop("tag", "")) != tag:
        raise InputError(
            f"{path}: found a checkpoint of other input or options; allowed is one of the same scene file, mesh, "
            f"images and options, or a fresh output folder"
        )
    return arrays


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    """A member as `np.savez` writes it: neither packed, nor larger than said, nor a pickle."""
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > info.compress_size:
        raise ValueError(f"{info.filename} is packed")
    stream = BytesIO(archive.read(info))
    read_header = {(1, 0): format.read_array_header_1_0, (2, 0): format.read_array_header_2_0}
    shape, _, kind = read_header[format.read_magic(stream)](stream)
    if kind.hasobject or math.prod(shape) * kind.itemsize != info.file_size - stream.tell():
        raise ValueError(f"{info.filename} is not the array it says")
    stream.seek(0)
    return np.asarray(format.read_array(stream, allow_pickle=False))


def _digest(arrays: dict[str, np.ndarray]) -> str:
    total = hashlib.sha256()
    for key, array in sorted(arrays.items()):
        total.update(repr((key, array.dtype.str, array.shape)).encode())
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()


def remove(folder: Path) -> None:
    (folder / NAME).unlink(missing_ok=True)
