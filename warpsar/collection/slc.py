"""Complex images, and phase history backprojected onto them.

|s|^2 is beta0 in the mean. The phase of a scatterer is that of its amplitude, less 4 pi f (r - r0) / c with the way at
the centre of its aperture: zero at the reference point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.collection.history import Collected
from warpsar.collection.plan import Plan, plan_axes
from warpsar.collection.response import band_weights
from warpsar.errors import InputError
from warpsar.formats.base.acquisition import FormedImage
from warpsar.measured.ground import pixel_centres
from warpsar.measured.plane import Plane, focus_plane
from warpsar.version import __version__
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import Grid

if TYPE_CHECKING:
    import xarray

F64 = NDArray[np.float64]
_ROWS_TOGETHER = 128


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

    def __repr__(self) -> str:
        size = f"{len(self.range_m)} x {len(self.azimuth_m)} pixels"
        return f"<Slc {self.plan.view.name}: {', '.join(self.images)}, {size}, {self.plane} plane>"

    @property
    def plane(self) -> str:
        return "ground" if self.plan.ground else "slant"

    def formed(self, polarization: str) -> FormedImage:
        """One polarization, as `warpsar.formats.sicd` writes it."""
        plan = self.plan
        beamed = np.ptp(plan.beam_gain) > 1e-3  # the beam tapers the aperture, too: no window has that name
        return FormedImage(
            taken=plan.acquisition,
            polarization=polarization,
            pixels=self.images[polarization],
            range_m=self.range_m,
            azimuth_m=self.azimuth_m,
            axes=plan_axes(plan),
            look=plan.geometry.s,
            ground=plan.ground,
            windows=(plan.windows[0], "unknown" if beamed else plan.windows[1]),
            weights=(band_weights(plan.windows[0], plan.frequencies), plan.azimuth_weights),
            response_m2=plan.response_m2,
        )

    def to_xarray(self) -> xarray.Dataset:
        """`slc` over range, azimuth and polarization (extra `xarray`)."""
        try:
            import xarray
        except ImportError as error:
            raise InputError('xarray is needed: pip install "warpsar[xarray]"') from error
        plan = self.plan
        attributes = {"units": "1", "long_name": "complex image, whose power is beta0"}
        return xarray.Dataset(
            {"slc": (("range", "azimuth", "polarization"), np.stack(list(self.images.values()), axis=-1), attributes)},
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
    way = plan.recorded.centre().ranges_less_reference(flat, np.array([0]))[0]
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
    row_m, column_m = (step * axis for step, axis in zip(grid.spacing_m, (row, column), strict=True))
    first_m = range_m[0] * row + azimuth_m[0] * column
    plane = Plane(first_m, row_m, column_m, (len(range_m), len(azimuth_m)))
    scale = plan.azimuth_taper.sum() / plan.azimuth_weights.sum() / np.sqrt(plan.response_m2)
    carrier = np.empty((len(range_m), len(azimuth_m)), np.complex64)
    for i in range(0, len(range_m), _ROWS_TOGETHER):
        points = range_m[i : i + _ROWS_TOGETHER, None, None] * row + azimuth_m[None, :, None] * column
        carrier[i : i + _ROWS_TOGETHER] = turned(plan, way_at_centre(plan, points)) * np.float32(scale)
    images = {}
    for name in made.polarizations:
        if not made.samples.any():  # nothing sends back, and there is no noise
            images[name] = np.zeros((len(range_m), len(azimuth_m)), np.complex64)
            continue
        image = focus_plane(
            made.history(name),
            plane,
            reference_point_m=np.zeros(3),
            window_range=plan.windows[0],
            window_azimuth=plan.windows[1],
            device=device.alias,
        )
        images[name] = image * carrier
    return Slc(plan, images, range_m, azimuth_m, made.scatterers)
