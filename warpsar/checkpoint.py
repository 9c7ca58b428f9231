"""A run's state on disk, whole or not at all."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from warpsar.errors import InputError
from warpsar.images import replacing

NAME = "checkpoint.npz"


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
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {key: stored[key] for key in stored.files}
        if str(arrays.pop("digest", "")) != _digest(arrays):  # zip alone does not miss a member that is gone
            raise ValueError("damaged")
    except Exception as error:  # whatever broken bytes make zip and NumPy stumble over
        raise InputError(f"{path}: not a checkpoint of warpsar ({error}); remove it to start afresh") from error
    if str(arrays.pop("tag", "")) != tag:
        raise InputError(
            f"{path}: found a checkpoint of other input or options; allowed is one of the same scene file, mesh, "
            f"images and options, or a fresh output folder"
        )
    return arrays


def _digest(arrays: dict[str, np.ndarray]) -> str:
    total = hashlib.sha256()
    for key, array in sorted(arrays.items()):
        total.update(repr((key, array.dtype.str, array.shape)).encode())
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()


def remove(folder: Path) -> None:
    (folder / NAME).unlink(missing_ok=True)
