"""What a reader gives: a `PhaseHistory`, which is focused, or an `ImageChip`, which is resampled."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from warpsar.errors import InputError
from warpsar.formats.base.declared import Declared
from warpsar.products.product import Samples
from warpsar.world.earth import EarthFrame, axes_at
from warpsar.world.frame import SPEED_OF_LIGHT

Quantity = Literal["complex", "amplitude", "power"]
RadarAt = Literal["top", "bottom"]
FARTHEST_M = 1e9
"""Bound of any length in a file: that of `slant_range_m` in a scene file."""
_BAND_HZ = (1e6, 1e13)  # bounds of `frequency_hz` there


@dataclass(frozen=True)
class Facts:
    """What a file says of how it was taken; None where it says nothing. Angles are those of a scene's view."""

    azimuth_deg: float | None = None
    incidence_deg: float | None = None
    frequency_hz: float | None = None
    polarization: str | None = None
    slant_range_m: float | None = None
    strip_map: bool = False
    target_roll_deg: float | None = None
    target_pitch_deg: float | None = None

    def checked(self, source: str) -> Facts:
        """Itself; raises InputError, naming `source`, for numbers that no radar can have."""
        limits = {
            "azimuth_deg": (-360.0, 360.0),
            "incidence_deg": (-180.0, 180.0),
            "frequency_hz": _BAND_HZ,
            "slant_range_m": (1e-3, FARTHEST_M),
            "target_roll_deg": (-180.0, 180.0),
            "target_pitch_deg": (-180.0, 180.0),
        }
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:  # NaN is within nothing
                raise InputError(f"{source}: found {name} = {value:g}; must be {low:g} to {high:g}")
        return self


@dataclass(frozen=True)
class PhaseHistory:
    """Samples exp(-j 4 pi f (|position - q| - reference_range) / c), shape (frequency, pulse), complex64.

    Every pulse has its frequencies: `frequency_start_hz` + k `frequency_step_hz`, shape (pulse,) each.
    `position_m` (pulse, 3) [m] is in the world; it is earth-centred where `frame` says how the world lies on the earth.
    `reference_range_m` is (pulse,). `autofocus_range_m` [m] and `autofocus_phase` [rad], (pulse,), correct the
    reference range and the phase (see `with_autofocus`).
    """

    source: str
    samples: np.ndarray
    frequency_start_hz: np.ndarray
    frequency_step_hz: np.ndarray
    position_m: np.ndarray
    reference_range_m: np.ndarray
    polarization: str | None
    autofocus_range_m: np.ndarray | None = None
    autofocus_phase: np.ndarray | None = None
    frame: EarthFrame | None = None
    transmitter_m: np.ndarray | None = None
    """(pulse, 3) of a transmitter apart from `position_m`: the distance is then the mean of both."""

    def __post_init__(self) -> None:
        pulses = self.samples.shape[1] if self.samples.ndim == 2 else 0
        if self.samples.ndim != 2 or pulses < 2 or self.samples.shape[0] < 2:
            raise InputError(
                f"{self.source}: samples (frequency, pulse) have shape {self.samples.shape}; "
                "at least 2 frequencies and 2 pulses are needed"
            )
        for name in (
            "frequency_start_hz",
            "frequency_step_hz",
            "position_m",
            "reference_range_m",
            "autofocus_range_m",
            "autofocus_phase",
            "transmitter_m",
        ):
            value = getattr(self, name)
            if value is None:
                continue
            if value.shape != ((pulses, 3) if name in ("position_m", "transmitter_m") else (pulses,)):
                raise InputError(f"{self.source}: {name} has shape {value.shape}, but there are {pulses} pulses")
            if not np.isfinite(value).all():
                raise InputError(f"{self.source}: {name} holds NaN or infinite values")
        lengths = [self.position_m, self.reference_range_m]
        if self.autofocus_range_m is not None:
            lengths.append(self.autofocus_range_m)
        if max(float(np.abs(each).max()) for each in lengths) > FARTHEST_M:
            raise InputError(f"{self.source}: positions and ranges must be within {FARTHEST_M:g} m")
        if not (self.frequency_start_hz > 0).all() or not (self.frequency_step_hz > 0).all():
            raise InputError(f"{self.source}: frequencies must be positive and rising")
        highest = self.frequency_start_hz + self.samples.shape[0] * self.frequency_step_hz
        if self.frequency_start_hz.min() < _BAND_HZ[0] or highest.max() > _BAND_HZ[1]:
            raise InputError(
                f"{self.source}: found frequencies of {self.frequency_start_hz.min():g} to {highest.max():g} Hz; must "
                f"be {_BAND_HZ[0]:g} to {_BAND_HZ[1]:g}"
            )
        bad = int((~np.isfinite(self.samples)).sum())
        if bad:
            raise InputError(
                f"{self.source}: {bad} of {self.samples.size} samples are NaN or infinite; one spreads over the "
                "whole image, so none is allowed"
            )
        if not self.samples.any():
            raise InputError(f"{self.source}: all {self.samples.size} samples are zero")

    @property
    def bandwidth_hz(self) -> float:
        return float(self.samples.shape[0] * self.frequency_step_hz.mean())

    @property
    def centre_frequency_hz(self) -> float:
        return float((self.frequency_start_hz + (self.samples.shape[0] - 1) / 2 * self.frequency_step_hz).mean())

    def in_frame(self, world_m: np.ndarray) -> np.ndarray:
        """World points (..., 3) [m] in the coordinates of `position_m`."""
        return world_m if self.frame is None else self.frame.to_ecef(world_m)

    def with_autofocus(self) -> PhaseHistory:
        """With the file's autofocus applied, except for what only shifts the image.

        The correction multiplies the samples by exp(j phase) and lengthens the reference range. Of the four sign
        conventions this one leaves Gotcha's phases smooth from pulse to pulse. A constant range and a phase linear over
        the pulses only shift the image. They are left out, so that it stays where the antenna positions put it.
        """
        if self.autofocus_range_m is None or self.autofocus_phase is None:
            return self
        extra = self.autofocus_range_m - self.autofocus_range_m.mean()
        wavenumber = 4.0 * np.pi * self.centre_frequency_hz / SPEED_OF_LIGHT
        phase = np.unwrap(self.autofocus_phase - wavenumber * extra)
        index = np.arange(phase.size)
        trend = np.polyval(np.polyfit(index, phase, 1), index)
        turn = np.exp(1j * (self.autofocus_phase - trend)).astype(np.complex64)
        return replace(
            self,
            samples=self.samples * turn,
            reference_range_m=self.reference_range_m + extra,
            autofocus_range_m=None,
            autofocus_phase=None,
        )

    def facts(self, reference_point_m: np.ndarray) -> Facts:
        """Facts as seen from `reference_point_m` (3,) [m, world]; the direction is to the middle of the aperture."""
        towards, distance = self.towards(reference_point_m)
        azimuth, incidence = direction_deg(towards.mean(axis=0), self.frame, reference_point_m)
        return Facts(azimuth, incidence, self.centre_frequency_hz, self.polarization, float(distance.mean()))

    def towards(self, reference_point_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit vectors from a world point to the antenna, (pulse, 3), or between two; and the distance, (pulse,)."""
        toward = self.position_m - self.in_frame(reference_point_m)
        distance = np.linalg.norm(toward, axis=1)
        unit = toward / distance[:, None]
        if self.transmitter_m is None:
            return unit, distance
        other = self.transmitter_m - self.in_frame(reference_point_m)
        away = np.linalg.norm(other, axis=1)
        both = unit + other / away[:, None]
        return both / np.linalg.norm(both, axis=1, keepdims=True), (distance + away) / 2.0


@dataclass(frozen=True)
class ImageChip:
    """An image and where its pixels lie.

    `locate` gives the fractional (row, column), (..., 2), of world points (..., 3) [m]; whole numbers are pixel
    centres. Where it is None the image already is a slant-plane one: row 0 is nearest to the radar, and the reference
    point is in the middle.
    `spacing_m` is (range, azimuth) [m]; that of the view where the file does not say.
    `gain` at (row, column) turns |samples|^2 into beta0; only `calibrated` images have it.
    `top`: the largest sample that the format can say. Brighter pixels have it too.
    `error`: the most that the format's rounding changes a sample, rms.
    `response`: what the header says of the response to a point.
    """

    source: str
    samples: Samples
    quantity: Quantity
    facts: Callable[[np.ndarray], Facts]
    spacing_m: tuple[float, float] | None = None
    locate: Callable[[np.ndarray], np.ndarray] | None = None
    calibrated: bool = False
    gain: Callable[[np.ndarray], np.ndarray] | None = None
    top: float | None = None
    error: float | None = None
    response: Declared | None = None

    def __post_init__(self) -> None:
        if len(self.samples.shape) != 2 or min(self.samples.shape) < 1:
            raise InputError(
                f"{self.source}: the image has shape {tuple(self.samples.shape)}; rows and columns are needed"
            )
        if self.spacing_m is not None and not all(1e-5 <= step <= 1e5 for step in self.spacing_m):
            steps = " x ".join(f"{step:g}" for step in self.spacing_m)
            raise InputError(f"{self.source}: found pixels of {steps} m; must be 1e-5 to 1e5 each")


# SciPy, sarkit (jbpy, lxml), h5py and rasterio document few of their errors: broken files made them raise these.
BROKEN: tuple[type[Exception], ...] = (ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, OSError)
BROKEN += (NameError, NotImplementedError, RecursionError, RuntimeError, SyntaxError, TypeError, ValueError)
BROKEN += (struct.error, zlib.error)


@contextmanager
def reading(path: Path, what: str, *also: type[Exception]) -> Iterator[None]:
    """A `with` block around a library: what it raises on a broken file becomes one InputError that names the file.

    `also` are the library's errors that derive from no built-in one. NumPy stays silent about NaN.
    """
    try:
        with np.errstate(all="ignore"):
            yield
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (*BROKEN, *also) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not a readable {what} ({reason[:200]})") from error


def direction_deg(toward: np.ndarray, frame: EarthFrame | None, reference_point_m: np.ndarray) -> tuple[float, float]:
    """Azimuth, clockwise from +Y, and incidence, from +Z [degrees], of a vector (3,) from a world point to the radar.

    The vector is earth-centred where `frame` is given, else in the world.
    """
    if frame is not None:
        toward = axes_at(frame, reference_point_m) @ toward
    azimuth = np.degrees(np.arctan2(toward[0], toward[1])) % 360.0
    return float(azimuth), float(np.degrees(np.arccos(toward[2] / np.linalg.norm(toward))))
