"""AFRL's MATLAB phase history (Gotcha, CV Domes, Backhoe ...): `data` with fp, freq, x, y, z, r0 and, if given, af."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from warpsar.errors import InputError
from warpsar.formats.base import mat5
from warpsar.formats.base.data import PhaseHistory, reading
from warpsar.formats.base.format import Format, Stated

_FREQUENCY_MISFIT = 0.1  # of a step: float32 frequencies of 10 GHz are rounded to 1 kHz, 0.001 of Gotcha's step


def join(parts: Sequence[PhaseHistory]) -> PhaseHistory:
    """Files of one collection, their pulses one after the other."""
    first = parts[0]
    for part in parts[1:]:
        if part.samples.shape[0] != first.samples.shape[0]:
            raise InputError(
                f"{part.source}: {part.samples.shape[0]} frequencies, but {first.source} has {first.samples.shape[0]}; "
                "files that are focused together must agree"
            )
        if part.polarization != first.polarization:
            raise InputError(
                f"{part.source}: polarization {part.polarization}, but {first.source} is {first.polarization}"
            )

    def joined(name: str, axis: int = 0) -> Any:
        values = [getattr(part, name) for part in parts]
        return None if any(v is None for v in values) else np.concatenate(values, axis=axis)

    return PhaseHistory(
        source=", ".join(part.source for part in parts),
        samples=joined("samples", 1),
        frequency_start_hz=joined("frequency_start_hz"),
        frequency_step_hz=joined("frequency_step_hz"),
        position_m=joined("position_m"),
        reference_range_m=joined("reference_range_m"),
        polarization=first.polarization,
        autofocus_range_m=joined("autofocus_range_m"),
        autofocus_phase=joined("autofocus_phase"),
    )


def read(path: Path, stated: Stated) -> PhaseHistory:
    """One file: what it holds is in the world's metres."""
    mat5.check(path)
    with reading(path, "MATLAB file", MatReadError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of variables that are there twice, or hold functions
        content = loadmat(path, squeeze_me=False)
    data = content.get("data")
    if not isinstance(data, np.ndarray) or data.dtype.names is None or data.size != 1:
        raise InputError(f"{path}: no structure `data` in it; found {', '.join(k for k in content if k[:2] != '__')}")
    record = data.ravel()[0]
    missing = [name for name in ("fp", "freq", "x", "y", "z", "r0") if name not in record.dtype.names]
    if missing:
        raise InputError(f"{path}: `data` has no field {', '.join(missing)}; found {', '.join(record.dtype.names)}")

    def row(name: str) -> np.ndarray:
        return np.asarray(record[name], np.float64).ravel()

    with reading(path, "phase history"):
        samples = np.asarray(record["fp"], np.complex64)
        frequency = row("freq")
        position = np.stack([row("x"), row("y"), row("z")], axis=1)
        af = record["af"].ravel()[0] if "af" in record.dtype.names and record["af"].size else None
        correction = [
            None if af is None else np.asarray(af[n], np.float64).ravel() for n in ("r_correct", "ph_correct")
        ]
    if samples.ndim != 2 or samples.shape[0] != frequency.size or min(samples.shape) < 2:
        raise InputError(
            f"{path}: fp has shape {samples.shape}, for {frequency.size} frequencies; at least 2 x 2 wanted"
        )
    if not np.isfinite(frequency).all() or np.abs(frequency).max() > 1e13:
        raise InputError(f"{path}: freq holds NaN, infinite or endless values; must be up to 1e13 Hz")
    index = np.arange(frequency.size)
    step, start = np.polyfit(index, frequency, 1)
    misfit = np.abs(start + step * index - frequency).max()
    if not misfit < _FREQUENCY_MISFIT * abs(step):
        raise InputError(f"{path}: freq is not evenly spaced (off by {misfit:.3g} Hz in steps of {step:.3g} Hz)")
    if step < 0:
        samples, start, step = samples[::-1], start + step * index[-1], -step
    pulses = samples.shape[1]
    named = re.search(r"_([HV]{2})$", path.stem, re.IGNORECASE)
    return PhaseHistory(
        source=str(path),
        samples=samples,
        frequency_start_hz=np.full(pulses, start),
        frequency_step_hz=np.full(pulses, step),
        position_m=position,
        reference_range_m=row("r0"),
        polarization=named[1].upper() if named else None,
        autofocus_range_m=correction[0],
        autofocus_phase=correction[1],
    )


FORMAT = Format(
    "gotcha",
    "AFRL .mat",
    "MATLAB 5 header",
    "phase history (Gotcha and kin), several files as one aperture; polarization from the file name (`..._HH.mat`)",
    read,
    detect=lambda path, head: head.startswith(b"MATLAB 5.0 MAT-file"),
    join=join,
)
