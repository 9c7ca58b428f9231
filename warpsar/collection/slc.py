"""Complex images: phase history backprojected, or each scatterer times the system's response.

|s|^2 is beta0 in the mean. The phase of a scatterer is that of its amplitude, less 4 pi f (r - r0) / c with the way at
the centre of its aperture: zero at the reference point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy import fft

from warpsar.coherent.records import upload
from warpsar.collection.history import Collected, spread_transform
from warpsar.collection.plan import Plan, beam, plan_axes
from warpsar.collection.response import band_weights
from warpsar.collection.scatterers import Scatterers
from warpsar.errors import InputError
from warpsar.kernels import collection as kernels
from warpsar.measured.focus import focus
from warpsar.measured.ground import pixel_centres
from warpsar.runtime import threads
from warpsar.version import __version__
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import Grid

if TYPE_CHECKING:
    import xarray

F64 = NDArray[np.float64]
MARGIN = 24
"""Cells about a direct image from which scatterers still count."""


@dataclass(frozen=True)
class Slc:
    """A complex image of one view. The plane is that of slant range and azimuth, or the ground (`plane`)."""

    plan: Plan
    images: dict[str, NDArray[np.complex64]]
    """(rows, columns) of each polarization."""
    range_m: F64
    """Of the rows' middles about the reference point [m]; along the ground where `plane` is "ground"."""
    azimuth_m: F64
    scatterers: int

    @property
    def plane(self) -> str:
        return "ground" if self.plan.ground else "slant"

    def to_xarray(self) -> xarray.Dataset:
        """`slc` over range, azimuth and polarization (extra `xarray`)."""
        try:
            import xarray
        except ImportError as error:
            raise InputError('xarray is needed: pip install "warpsar[xarray]"') from error
        plan = self.plan
        told = {"units": "1", "long_name": "complex image, whose power is beta0"}
        return xarray.Dataset(
            {"slc": (("range", "azimuth", "polarization"), np.stack(list(self.images.values()), axis=-1), told)},
            {
                "range": ("range", self.range_m, {"units": "m", "long_name": f"{self.plane} range"}),
                "azimuth": ("azimuth", self.azimuth_m, {"units": "m", "long_name": "azimuth"}),
                "polarization": list(self.images),
            },
            {
                "title": "simulated complex image",
                "view": plan.view.name,
                "plane": self.plane,
                "azimuth_deg": plan.view.azimuth_deg,
                "incidence_deg": plan.view.incidence_deg,
                "frequency_hz": plan.centre_hz,
                "slant_range_m": plan.slant_range_m,
                "cells_m": list(plan.cells_m),
                "windows": list(plan.windows),
                "response_m2": plan.response_m2,
                "software": f"warpsar {__version__}",
            },
        )


def way_at_centre(plan: Plan, points_m: F64) -> F64:
    """Mean way to points (..., 3) [m] at the centre of their aperture, less the reference point's, (...) [m].

    In a stripmap the centre is where the beam's axis passes the point; else the middle of the track.
    """
    flat = points_m.reshape(-1, 3)
    if plan.stripmap and plan.track.straight is not None:
        slant = plan.slant_range_m
        to = flat - slant * plan.geometry.s
        across = np.linalg.norm(to - (to @ plan.track.straight)[:, None] * plan.track.straight, axis=1)
        return np.asarray(across / np.cos(np.deg2rad(plan.table.squint_deg)) - slant).reshape(points_m.shape[:-1])
    way = plan.track.centre().ranges_less_reference(flat, np.array([0]))[0]
    return way.reshape(points_m.shape[:-1])


def turned(plan: Plan, way_m: F64) -> NDArray[np.complex64]:
    """exp(-j 4 pi f r / c) at the centre of the band."""
    turns = 2.0 * plan.centre_hz / SPEED_OF_LIGHT * way_m
    return np.exp(-2j * np.pi * (turns - np.round(turns))).astype(np.complex64)


def focused(made: Collected, grid: Grid, device: wp.Device) -> Slc:
    """Backprojection onto the plane of slant range and azimuth, or onto the ground."""
    plan = made.plan
    range_m, azimuth_m = pixel_centres(grid.shape, grid.spacing_m, (1, 1))
    row, column = plan_axes(plan)
    points = range_m[:, None, None] * row + azimuth_m[None, :, None] * column
    scale = plan.azimuth_taper.sum() / plan.azimuth_weights.sum() / np.sqrt(plan.response_m2)
    carrier = turned(plan, way_at_centre(plan, points)) * np.float32(scale)
    images = {}
    for name in made.polarizations:
        (image,) = focus(
            made.history(name),
            points,
            reference_point_m=np.zeros(3),
            window_range=plan.windows[0],
            window_azimuth=plan.windows[1],
            device=device.alias,
        )
        images[name] = image * carrier
    return Slc(plan, images, range_m, azimuth_m, made.scatterers)


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


def direct(plan: Plan, scatterers: Scatterers, polarizations: tuple[str, ...], grid: Grid, device: wp.Device) -> Slc:
    """Each scatterer at its slant range and azimuth, times the response of band and aperture."""
    range_m, azimuth_m = pixel_centres(grid.shape, grid.spacing_m, (1, 1))
    rows, columns = _axes(plan, range_m, azimuth_m, grid)
    assert plan.track.straight is not None
    images = {name: np.zeros((rows.count, columns.count), np.complex64) for name in polarizations}
    for part in scatterers.parts:
        place = np.stack(_coordinates(plan, part.point), axis=1)
        fine = (place - [rows.start_m, columns.start_m]) / [rows.step_m, columns.step_m]
        some = ((fine > 3.0) & (fine < np.array([rows.count, columns.count]) - 4.0)).all(axis=1)
        inside = part.point[some]
        # A stripmap's beam passes over every point; what is left of it lies across the track.
        seen = inside - place[some, 1:] * plan.geometry.u if plan.stripmap else inside
        gain = beam(plan, seen, np.array([plan.middle]))[0].astype(np.float32)
        phase = gain * turned(plan, way_at_centre(plan, inside))
        at = upload(fine[some], wp.vec2d, device)
        for index, name in enumerate(polarizations):
            values = (part.amplitude[index, some] * phase).view(np.float32).reshape(-1, 2)
            out = wp.zeros((rows.count, columns.count), dtype=wp.vec2, device=device)
            inputs = [at, upload(values, wp.vec2, device)]
            wp.launch(kernels.image_deposit_kernel, len(at), inputs=inputs, outputs=[out], device=device)
            images[name] += np.ascontiguousarray(out.numpy()).view(np.complex64)[..., 0]
    made = {}
    workers = threads.thread_count()
    for name, deposited in images.items():
        spectrum = fft.fft2(deposited, workers=workers)
        spectrum *= (rows.weights[:, None] * columns.weights).astype(np.float32)
        whole = fft.ifft2(spectrum, workers=workers)
        some_rows = slice(rows.first, rows.first + (len(range_m) - 1) * rows.every + 1, rows.every)
        some_columns = slice(columns.first, columns.first + (len(azimuth_m) - 1) * columns.every + 1, columns.every)
        made[name] = np.ascontiguousarray(whole[some_rows, some_columns])
    return Slc(plan, made, range_m, azimuth_m, scatterers.count)


def _coordinates(plan: Plan, points_m: F64) -> tuple[F64, F64]:
    """Slant range (from the track, less the reference point's) and azimuth of points (n, 3) [m]."""
    place = plan.slant_range_m * plan.geometry.s
    along = points_m @ plan.geometry.u
    to = points_m - along[:, None] * plan.geometry.u
    # |place - to| - |place| from differences
    way = ((to**2).sum(axis=1) - 2.0 * to @ place) / (np.linalg.norm(place - to, axis=1) + np.linalg.norm(place))
    return way, along


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
