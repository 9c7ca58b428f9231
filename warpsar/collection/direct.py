"""Direct images: each scatterer times the system's response, deposited on a fine grid and brought through the band."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy import fft

from warpsar.coherent.records import upload
from warpsar.coherent.sweep import POLARIZATIONS
from warpsar.collection import places
from warpsar.collection.bodies import Bodies
from warpsar.collection.history import beam_of, spread_transform
from warpsar.collection.plan import Plan
from warpsar.collection.response import band_weights
from warpsar.collection.scatterers import FAR_FIELD, Scatterers, Stream
from warpsar.collection.slc import Slc
from warpsar.errors import InputError
from warpsar.kernels import collection as kernels
from warpsar.measured.ground import pixel_centres
from warpsar.runtime import threads
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import Grid

F64 = NDArray[np.float64]
MARGIN = 24
"""Cells about a direct image from which scatterers still count."""


def refuse_direct(plan: Plan, name: str) -> None:
    """Raise InputError where the system's response is not one for the whole image."""
    why = None
    if plan.track.straight is None:
        why = "a track that is not straight, or two antennas"
    elif plan.table.squint_deg:
        why = "a squint"
    elif plan.table.velocity_m_s:
        why = "a moving object"
    if why is not None:
        raise InputError(f'{name}: collection.focus: found "direct" with {why}; must be "backprojection" there')


@dataclass(frozen=True)
class _Axis:
    """One axis of a direct image: a fine grid about it, and the system's weights at its frequencies."""

    start_m: float
    step_m: float
    count: int
    every: int
    first: int
    weights: F64
    """(count,), in the order of `fft.fftfreq`."""

    @classmethod
    def of(cls, pixels_m: F64, spacing_m: float, cell_m: float, at: F64, weight: F64) -> _Axis:
        """`at`: frequencies [1/m] of the samples with their `weight`, ascending."""
        every = int(np.ceil(spacing_m / (0.5 * cell_m)))
        step = spacing_m / every
        margin = int(np.ceil(MARGIN * cell_m / step))
        count = fft.next_fast_len((len(pixels_m) - 1) * every + 1 + 2 * margin)
        own = fft.fftfreq(count, step)
        # The mean over each step of frequency: the ends of the band seldom lie between two.
        total = np.concatenate([[0.0], np.cumsum(0.5 * (weight[1:] + weight[:-1]) * np.diff(at))])
        half = 0.5 / (count * step)
        inside = (np.interp(own + half, at, total) - np.interp(own - half, at, total)) / (2.0 * half)
        spread = fft.ifftshift(spread_transform(count, count))
        power = float((inside**2).sum() / inside.sum() ** 2) * count * step
        start = float(pixels_m[0]) - margin * step
        return cls(start, step, count, every, margin, inside / spread / inside.sum() * count / np.sqrt(power))

    def pixels(self, count: int) -> slice:
        """Where the image's own pixels lie on the fine grid."""
        return slice(self.first, self.first + (count - 1) * self.every + 1, self.every)


@dataclass(frozen=True)
class DeviceScatterers:
    """Scatterers on a device, as the middle of the track sees them."""

    point: wp.array
    """(n,), vec3d, about the reference point [m]."""
    amplitude: wp.array
    """(n, columns), vec2."""
    columns: tuple[int, ...]
    """Of each polarization."""
    scale: float
    """Of the amplitudes, so that a scatterer's power is its RCS."""
    count: int


def direct(
    plan: Plan, scatterers: Scatterers | Stream, polarizations: tuple[str, ...], grid: Grid, device: wp.Device
) -> Slc:
    """Each scatterer at its slant range and azimuth, times the response of band and aperture."""
    columns = tuple(range(len(polarizations)))

    def seen() -> Iterator[DeviceScatterers]:
        for part in scatterers.parts:
            values = np.ascontiguousarray(part.amplitude.T).view(np.float32).reshape(-1, len(columns), 2)
            place, amplitude = upload(part.point, wp.vec3d, device), upload(values, wp.vec2, device)
            yield DeviceScatterers(place, amplitude, columns, 1.0, len(part))

    return image_of_seen(plan, seen(), polarizations, grid, device)


def direct_of_rough(bodies: Bodies, plan: Plan) -> Slc:
    """The direct image of a world with the term "rough" alone. Its scatterers never leave the device."""
    world, device, body = bodies.world, bodies.device, bodies.of(plan)
    polarizations = tuple(world.radar.polarizations)
    k = 2.0 * np.pi * plan.centre_hz / SPEED_OF_LIGHT
    worker = places.worker_of(body, k, ("rough",), 1, 1.0)
    sensor = plan.track.towards()[plan.middle] * plan.track.reference_m()[plan.middle]
    amplitude, count = places.rough_amplitudes(worker, places.sight(body, sensor)[1])
    columns = tuple(POLARIZATIONS.index(name[::-1]) for name in polarizations)
    seen = DeviceScatterers(bodies.rough_places(plan), amplitude, columns, FAR_FIELD, count)
    return image_of_seen(plan, [seen], polarizations, world.grid, device)


def image_of_seen(
    plan: Plan, seen: Iterable[DeviceScatterers], polarizations: tuple[str, ...], grid: Grid, device: wp.Device
) -> Slc:
    """The image of scatterers that are on the device."""
    range_m, azimuth_m = pixel_centres(grid.shape, grid.spacing_m, (1, 1))
    rows, columns = _axes(plan, range_m, azimuth_m, grid)
    out = wp.zeros((len(polarizations), rows.count, columns.count), dtype=wp.vec2, device=device)
    frame = _frame(plan, rows, columns, device)
    count = 0
    for one in seen:
        count += one.count
        chosen = upload(np.array(one.columns, np.int32), int, device)
        inputs = [frame, one.point, one.amplitude, chosen, one.scale]
        wp.launch(kernels.image_deposit_kernel, one.point.shape[0], inputs=inputs, outputs=[out], device=device)
    deposited = np.ascontiguousarray(out.numpy()).view(np.complex64)[..., 0]
    weights = (rows.weights[:, None] * columns.weights).astype(np.float32)
    workers = threads.thread_count()
    spectrum = fft.fft2(deposited, workers=workers)
    spectrum *= weights
    whole = fft.ifft2(spectrum, workers=workers)[:, rows.pixels(len(range_m)), columns.pixels(len(azimuth_m))]
    images = {name: np.ascontiguousarray(image) for name, image in zip(polarizations, whole, strict=True)}
    return Slc(plan, images, range_m, azimuth_m, count)


def _frame(plan: Plan, rows: _Axis, columns: _Axis, device: wp.Device) -> Any:
    """Where the kernel finds a scatterer's row and column, and its phase."""
    centre = plan.track.centre().receiver_m[0]
    frame: Any = kernels.ImageFrame()
    frame.place = wp.vec3d(*(plan.slant_range_m * plan.geometry.s))
    frame.slant = plan.slant_range_m
    frame.centre = wp.vec3d(*centre)
    frame.centre_slant = float(np.linalg.norm(centre))
    frame.u = wp.vec3d(*plan.geometry.u)
    frame.start = wp.vec2d(rows.start_m, columns.start_m)
    frame.step = wp.vec2d(rows.step_m, columns.step_m)
    frame.turns_per_metre = 2.0 * plan.centre_hz / SPEED_OF_LIGHT
    frame.stripmap = int(plan.stripmap)
    frame.beam = beam_of(plan, device)
    frame.receiver = wp.vec3d(*plan.track.receiver_m[plan.middle])
    frame.pulse = plan.middle
    return frame


def _axes(plan: Plan, range_m: F64, azimuth_m: F64, grid: Grid) -> tuple[_Axis, _Axis]:
    """Both axes: the band's frequencies about its centre, and those of the aperture."""
    number: F64 = np.arange(plan.frequencies, dtype=np.float64) - 0.5 * (plan.frequencies - 1)
    band = 2.0 * number * plan.step_hz / SPEED_OF_LIGHT
    weights = band_weights(plan.windows[0], plan.frequencies)
    rows = _Axis.of(range_m, grid.spacing_m[0], plan.cells_m[0], *_edged(band, weights))
    along = 2.0 * plan.centre_hz / SPEED_OF_LIGHT * (plan.track.towards() @ plan.geometry.u)
    order = np.argsort(along)
    columns = _Axis.of(
        azimuth_m, grid.spacing_m[1], plan.cells_m[1], *_edged(along[order], plan.azimuth_weights[order])
    )
    return rows, columns


def _edged(at: F64, weight: F64) -> tuple[F64, F64]:
    """With both ends half a step further out, where the band ends."""
    step = np.diff(at)[[0, -1]]
    tiny = 1e-6 * step
    low, high = at[0] - 0.5 * step[0], at[-1] + 0.5 * step[1]
    return (
        np.concatenate([[low - tiny[0], low], at, [high, high + tiny[1]]]),
        np.concatenate([[0.0, weight[0]], weight, [weight[-1], 0.0]]),
    )
