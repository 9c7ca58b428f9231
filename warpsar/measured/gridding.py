"""A measurement onto the slant-plane grid of a view: focused or resampled, and averaged in power."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np
from scipy import fft
from scipy.ndimage import map_coordinates

from warpsar.errors import InputError
from warpsar.formats.base.data import ImageChip, PhaseHistory
from warpsar.io.images import LARGEST_IMAGE
from warpsar.measured.focus import cell_m, focus
from warpsar.measured.ground import mesh_points, pixel_centres, plane_points
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import View
from warpsar.world.world import World, geometry_of

_MOST_LOOKS = 64
_COARSE = 3.0  # times the grid's pixels: what is coarser shows nothing of what a grid is for


@dataclass(frozen=True)
class Gridding:
    """How a measurement comes onto the grid.

    `samples` per pixel (range, azimuth) are averaged in power; None: as many as the resolution asks for. Pixels lie at
    the reference point's height, or on the mesh. The windows and the sub-apertures are those of `focus`.
    """

    window_range: str = "none"
    window_azimuth: str = "none"
    subapertures: int = 1
    samples: tuple[int | None, int | None] = (None, None)
    surface: Literal["reference", "mesh"] = "reference"
    device: str | None = None


@dataclass(frozen=True)
class Gridded:
    """A measurement on the grid of a view; NaN where nothing was measured."""

    power: np.ndarray
    """Linear power, float32 (rows, cols)."""
    samples: tuple[int, int]
    """Per pixel (range, azimuth)."""
    messages: list[str]
    """What to tell the user."""
    range_m: np.ndarray
    """Of the samples, (rows * samples[0],) [m]."""
    azimuth_m: np.ndarray
    slc: np.ndarray | None
    """The samples of a complex image, complex64 (rows * samples[0], cols * samples[1]), or of a phase history that is
    focused as one aperture onto a plane."""


def on_grid(measured: PhaseHistory | ImageChip, world: World, view: View, how: Gridding) -> Gridded:
    """A measurement on the grid of a view.

    Raises InputError where no pixel of the grid lies wholly inside the image.
    """
    reference = np.asarray(world.reference_point_m, np.float64)
    looks = _samples_per_pixel(measured, world, reference, how.samples)
    messages: list[str] = []
    range_m, azimuth_m = pixel_centres(world.grid.shape, world.grid.spacing_m, looks)
    slc = None
    if isinstance(measured, ImageChip) and measured.locate is None:
        fine, slc = _sampled(measured, _in_slant_plane(measured, world, range_m, azimuth_m, looks))
        messages += _coarse(measured, world)
    else:
        geometry = geometry_of(world, view)
        if how.surface == "mesh":
            points, missed = mesh_points(geometry, reference, range_m, azimuth_m, world.mesh, how.device)
            if missed:
                messages.append(
                    f"{missed} of {points[..., 0].size} samples meet no mesh; taken at the reference height"
                )
        else:
            points = plane_points(geometry, reference, range_m, azimuth_m)
        if isinstance(measured, PhaseHistory):
            fine, slc = _focused(measured, points, reference, how)
        else:
            fine, slc = _sampled(measured, _located(measured, points, reference))
    with np.errstate(all="ignore"):  # beyond float32 is infinite, and no power
        power = averaged(fine, looks).astype(np.float32)
    power[~np.isfinite(power)] = np.nan
    unseen = int((~np.isfinite(power)).sum())
    if unseen == power.size:
        raise InputError(f"{measured.source}: no pixel of the view's grid lies wholly inside the measured area")
    if unseen:
        messages.append(f"{unseen} of {power.size} pixels lie outside the measured area; they are NaN, and masked")
    return Gridded(power, looks, messages, range_m, azimuth_m, slc)


def _coarse(chip: ImageChip, world: World) -> list[str]:
    """The message that a picture's stated pixels are much larger than the grid's, if they are."""
    steps = world.grid.spacing_m
    if chip.spacing_m is None or all(a <= _COARSE * b for a, b in zip(chip.spacing_m, steps, strict=True)):
        return []
    found, own = (" x ".join(f"{step:g}" for step in each) for each in (chip.spacing_m, steps))
    return [f"the picture's pixels are stated as {found} m, and image.spacing_m is {own}: is one of them wrong?"]


def _sampled(chip: ImageChip, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Power at (row, column) of a chip, and the samples themselves where it is complex."""
    return sample_power(chip, pixel), sample_complex(chip, pixel) if chip.quantity == "complex" else None


def _samples_per_pixel(
    measured: PhaseHistory | ImageChip,
    world: World,
    reference: np.ndarray,
    asked: tuple[int | None, int | None],
) -> tuple[int, int]:
    """Samples per pixel (range, azimuth): as asked, else one for each resolution cell, or each pixel of an image."""
    if isinstance(measured, PhaseHistory):
        step: Sequence[float] | None = cell_m(measured, reference)
    else:
        step = measured.spacing_m
    counts = []
    for axis, (name, given) in enumerate(zip(("range", "azimuth"), asked, strict=True)):
        if given is not None and not 1 <= given <= _MOST_LOOKS:
            raise InputError(f"--looks-{name} {given}: must be 1 to {_MOST_LOOKS}")
        if given is None and step is not None:
            ratio = world.grid.spacing_m[axis] / step[axis]
            count = math.ceil(ratio - 1e-6) if isinstance(measured, PhaseHistory) else round(ratio)
            given = min(max(1, count), _MOST_LOOKS)
        elif given is None:
            given = max(1, round(measured.samples.shape[axis] / world.grid.shape[axis]))
        counts.append(given)
    return counts[0], counts[1]


def _in_slant_plane(
    chip: ImageChip, world: World, range_m: np.ndarray, azimuth_m: np.ndarray, looks: tuple[int, int]
) -> np.ndarray:
    """(row, column) of samples in an image whose axes are those of the view, its middle the reference point."""
    spacing = chip.spacing_m
    if spacing is None:
        wanted = tuple(size * n for size, n in zip(world.grid.shape, looks, strict=True))
        if tuple(chip.samples.shape) != wanted:
            raise InputError(
                f"{chip.source}: {' x '.join(map(str, chip.samples.shape))} pixels, and no spacing; image.shape "
                f"{list(world.grid.shape)} with {looks[0]} x {looks[1]} looks needs {wanted[0]} x {wanted[1]}; state "
                "--spacing for a picture of another size"
            )
        spacing = cast(tuple[float, float], tuple(s / n for s, n in zip(world.grid.spacing_m, looks, strict=True)))
    rows, cols = chip.samples.shape
    row = range_m / spacing[0] + (rows - 1) / 2.0
    col = azimuth_m / spacing[1] + (cols - 1) / 2.0
    return np.stack(np.meshgrid(row, col, indexing="ij"), axis=-1)


def _focused(
    history: PhaseHistory, points: np.ndarray, reference: np.ndarray, how: Gridding
) -> tuple[np.ndarray, np.ndarray | None]:
    """Power, mean over the sub-apertures, with the file's autofocus where it has one; and the complex image of a single
    aperture on a plane, whose phase is that of a complex image: -4 pi f (r - r0) / c at the middle of the track."""
    images = focus(
        history.with_autofocus(),
        points,
        reference_point_m=reference,
        window_range=how.window_range,
        window_azimuth=how.window_azimuth,
        subapertures=how.subapertures,
        device=how.device,
    )
    power = np.zeros(points.shape[:-1])
    for image in images:
        power += image.real.astype(np.float64) ** 2 + image.imag.astype(np.float64) ** 2
    if how.subapertures > 1 or how.surface == "mesh":
        return power / how.subapertures, None
    return power, image * _carrier(history, points, reference)


def _carrier(history: PhaseHistory, points: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """exp(-j 4 pi f (r - r0) / c) at points (..., 3), with the ways at the middle of the track and of the band."""
    ends = [history.position_m] if history.transmitter_m is None else [history.position_m, history.transmitter_m]
    middle = slice((len(history.position_m) - 1) // 2, len(history.position_m) // 2 + 1)  # one pulse, or two
    middles = [end[middle].mean(axis=0) for end in ends]
    places, origin = history.in_frame(points), history.in_frame(reference)
    way = np.mean([np.linalg.norm(one - places, axis=-1) - np.linalg.norm(one - origin) for one in middles], axis=0)
    turns = 2.0 * history.centre_frequency_hz / SPEED_OF_LIGHT * way
    return np.exp(-2j * np.pi * (turns - np.round(turns))).astype(np.complex64)


def _located(chip: ImageChip, points: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Pixels of the chip at the points. Where none is inside, InputError says where in the world the image lies."""
    assert chip.locate is not None
    pixel = chip.locate(points)
    rows, cols = chip.samples.shape
    inside = (pixel >= 0).all(-1) & (pixel[..., 0] <= rows - 1) & (pixel[..., 1] <= cols - 1)
    if inside.any():
        return pixel
    middle = np.array([(rows - 1) / 2.0, (cols - 1) / 2.0])
    point = reference.copy()
    for _ in range(20):  # Newton's method in east and north
        steps = chip.locate(point + 10.0 * np.eye(3)[:2]) - chip.locate(point)
        try:
            point[:2] += 10.0 * np.linalg.solve(steps.T, middle - chip.locate(point))
        except np.linalg.LinAlgError:
            break
    raise InputError(
        f"{chip.source}: the view's grid lies wholly outside the image, whose middle is near the world's "
        f"({point[0]:.0f}, {point[1]:.0f}) m at the reference point's height"
    )


# ---- power and complex samples between the pixels of an image, without aliasing


_MARGIN = 32  # [pixels] around the wanted ones, in which the samples fade for the Fourier transform
_UNFADED = 8  # [pixels] of it, next to the wanted ones, that stay as they are
_FINER = 3  # times as fine a grid for the power of complex samples
_COINCIDENT = 1e-6  # [pixels]: grids that differ by less are the same grid


def sample_power(chip: ImageChip, pixel: np.ndarray) -> np.ndarray:
    """Power of `chip` at fractional (row, column) pixel centres (..., 2), float64; NaN outside the image.

    The power of a complex image has twice its bandwidth. So it is taken on a grid three times as fine, made by zero
    padding the spectrum, and is then interpolated by splines. Detected images become power first and are interpolated
    linearly, which keeps them positive. A point on a pixel centre gets that pixel's value. A point in the outer half of
    a border pixel gets the border's value. Raises InputError for an image without a usable pixel under the grid.
    """
    power = np.full(pixel.shape[:-1], np.nan)
    found = _under(chip, pixel)
    if found is None:
        return power
    inside, at, samples, bad = found
    if chip.quantity == "power" and (samples[~bad] < 0).any():
        raise InputError(f"{chip.source}: negative values, down to {samples[~bad].min():g}; linear power has none")
    with np.errstate(all="ignore"):  # what overflows is infinite, and no power
        power[inside] = _interpolated(np.where(bad, 0, samples), bad, at, chip.quantity)
        if chip.gain is not None:
            power *= chip.gain(pixel)
    power[~np.isfinite(power)] = np.nan
    return power


def sample_complex(chip: ImageChip, pixel: np.ndarray) -> np.ndarray:
    """Samples of a complex `chip` at fractional (row, column), complex64: |s|^2 is beta0 where it is calibrated.

    NaN outside the image, and where a sample that is not finite has a part. The spectrum of each axis, wherever it
    lies, is centred and made three times as fine, interpolated by splines, and put back. On the image's own pixels the
    samples come back as they are.
    """
    values = np.full(pixel.shape[:-1], np.nan, np.complex64)
    found = _under(chip, pixel)
    if found is None:
        return values
    inside, at, samples, bad = found
    samples = np.where(bad, 0, samples)
    nearest = np.rint(at).astype(int)
    with np.errstate(all="ignore"):  # what overflows is infinite, and no sample
        if np.abs(at - nearest).max() < _COINCIDENT:
            own, spoilt = samples[nearest[:, 0], nearest[:, 1]], bad[nearest[:, 0], nearest[:, 1]]
        else:
            fine, turns = _finer(samples * _faded_both(samples.shape, at))
            places = _FINER * at.T
            parts = [map_coordinates(part, places, order=5, mode="mirror") for part in (fine.real, fine.imag)]
            own = (parts[0] + 1j * parts[1]) * np.exp(1j * (at @ np.array(turns)))
            spoilt = map_coordinates(bad.astype(np.float64), at.T, order=1, mode="nearest") > _COINCIDENT
        own = np.where(spoilt, np.nan, own)
        if chip.gain is not None:
            own = own * np.sqrt(chip.gain(pixel[inside]))
        values[inside] = own
    values[~np.isfinite(values)] = np.nan
    return values


def _under(chip: ImageChip, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Which points are inside; where they lie in a window of the image, (n, 2); the window, and which of it is bad."""
    last = np.array(chip.samples.shape) - 1
    inside = np.asarray((np.abs(pixel - last / 2.0) <= last / 2.0 + 0.5).all(-1))  # false for NaN
    if not inside.any():
        return None
    wanted = np.clip(pixel[inside], 0, last)
    low = np.maximum(np.floor(wanted.min(axis=0)).astype(int) - _MARGIN, 0)
    high = np.minimum(np.ceil(wanted.max(axis=0)).astype(int) + _MARGIN, last) + 1
    if np.prod(high - low) > LARGEST_IMAGE:
        raise InputError(
            f"{chip.source}: the view's grid lies on {high[0] - low[0]} x {high[1] - low[1]} of its pixels; at most "
            f"{LARGEST_IMAGE} can be resampled at once"
        )
    samples = np.asarray(chip.samples[slice(low[0], high[0]), slice(low[1], high[1])])
    bad = ~np.isfinite(samples)
    if bad.all():
        raise InputError(f"{chip.source}: every pixel under the view's grid is NaN or infinite")
    return inside, wanted - low, samples, bad


def _interpolated(samples: np.ndarray, bad: np.ndarray, at: np.ndarray, quantity: str) -> np.ndarray:
    nearest = np.rint(at).astype(int)
    if np.abs(at - nearest).max() < _COINCIDENT:
        values = _power(samples[nearest[:, 0], nearest[:, 1]], quantity)
        return np.where(bad[nearest[:, 0], nearest[:, 1]], np.nan, values)
    if quantity == "complex":
        fine = _power(_finer(samples * _faded_both(samples.shape, at))[0], quantity)
        values = np.maximum(map_coordinates(fine, _FINER * at.T, order=5, mode="mirror"), 0.0)
    else:
        values = map_coordinates(_power(samples, quantity), at.T, order=1, mode="nearest")
    if bad.any():  # a pixel that is not finite spoils all values that it has a part in
        values[map_coordinates(bad.astype(np.float64), at.T, order=1, mode="nearest") > _COINCIDENT] = np.nan
    return values


def _power(samples: np.ndarray, quantity: str) -> np.ndarray:
    return samples.astype(np.float64) if quantity == "power" else np.abs(samples).astype(np.float64) ** 2


def _faded_both(shape: tuple[int, ...], at: np.ndarray) -> np.ndarray:
    """`_faded` of rows times that of columns."""
    return np.outer(*(_faded(n, at[:, axis]) for axis, n in enumerate(shape)))


def _faded(count: int, at: np.ndarray) -> np.ndarray:
    """Weights: 1 where samples are wanted, falling to 0 outside; a cut edge is a step to a Fourier transform."""
    index = np.arange(count)
    before, after = max(int(np.floor(at.min())), 0), count - 1 - min(int(np.ceil(at.max())), count - 1)
    weight = np.ones(count)
    for margin, distance in ((before, index), (after, index[::-1])):
        ramp = np.clip((distance + 1) / max(margin - _UNFADED, 1), 0.0, 1.0)
        weight *= np.sin(np.pi / 2 * ramp) ** 2
    return weight


def _finer(samples: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """The image on a grid `_FINER` times as fine, its spectrum centred; and the phase from pixel to pixel of each axis
    that was taken away for it [rad]."""
    turns = []
    for axis in (0, 1):
        moved = np.moveaxis(samples, axis, 0)
        count = moved.shape[0]
        centroid = np.angle(np.vdot(moved[:-1], moved[1:])) if count > 1 else 0.0
        turns.append(float(centroid))
        index = np.arange(count)[:, None]
        spectrum = fft.fftshift(fft.fft(moved * np.exp(-1j * centroid * index), axis=0), axes=0)
        padded = np.zeros((_FINER * count, spectrum.shape[1]), np.complex64)
        first = _FINER * count // 2 - count // 2  # zero frequency stays zero frequency
        padded[first : first + count] = spectrum
        samples = np.moveaxis(_FINER * fft.ifft(fft.ifftshift(padded, axes=0), axis=0), 0, axis)
    return samples, turns


def averaged(fine: np.ndarray, looks: tuple[int, int]) -> np.ndarray:
    """Means over blocks of `looks` samples, in linear power; NaN samples spoil their pixel."""
    rows, cols = fine.shape[0] // looks[0], fine.shape[1] // looks[1]
    return fine.reshape(rows, looks[0], cols, looks[1]).mean(axis=(1, 3))
