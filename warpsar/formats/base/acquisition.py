"""What the standards' files say of a simulated product: how it was taken, and its samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.world.site import Site
from warpsar.world.track import Track

START = "2026-01-01T00:00:00"
"""A simulated collection has no date of its own."""
F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Acquisition:
    """How a view was taken: along which track, about which place on the earth, and in which band."""

    view: str
    stripmap: bool
    """Else a spotlight."""
    site: Site
    track: Track
    """Places about the reference point, in the frame of `site`."""
    start_hz: float
    step_hz: float
    frequencies: int

    @property
    def time_s(self) -> F64:
        """Of each pulse, from the first one, (p,)."""
        return self.track.time_s - self.track.time_s[0]

    @property
    def middle(self) -> int:
        """The pulse in the middle."""
        return len(self.track) // 2

    @property
    def band_hz(self) -> tuple[float, float]:
        """The first and the last frequency."""
        return self.start_hz, self.start_hz + (self.frequencies - 1) * self.step_hz

    @property
    def kind(self) -> str:
        """CollectType, as the standards call it."""
        return "BISTATIC" if self.track.bistatic else "MONOSTATIC"

    @property
    def mode(self) -> str:
        """ModeType, as the standards call it."""
        return "STRIPMAP" if self.stripmap else "SPOTLIGHT"


@dataclass(frozen=True)
class RecordedSignal:
    """Phase history, as a CPHD takes it."""

    taken: Acquisition
    samples: Mapping[str, NDArray[np.complex64]]
    """(frequencies, pulses) of each polarization."""
    toa_s: float
    """Half of the swath in time of arrival."""
    corners_m: F64
    """Corners of the box about the scene, (n, 3), about the reference point."""
    cells_m: tuple[float, float]
    """Resolution cells in range and azimuth."""


@dataclass(frozen=True)
class FormedImage:
    """A complex image on a plane through the reference point, as a SICD takes it."""

    taken: Acquisition
    polarization: str
    pixels: NDArray[np.complex64]
    """(rows, columns), whose power is beta0."""
    range_m: F64
    """Places of the rows along `axes[0]`, about the reference point."""
    azimuth_m: F64
    """The same of the columns along `axes[1]`."""
    axes: tuple[F64, F64]
    """Unit vectors along the rows' and the columns' direction, (3,) each, in the frame of the site."""
    look: F64
    """Unit vector from the reference point to the radar, (3,)."""
    ground: bool
    """Whether the plane is level; else it is that of slant range and azimuth."""
    windows: tuple[str, str]
    """Of range and azimuth: a name of `taper.TAPERS`, or "unknown" where the weights are no window's."""
    weights: tuple[F64, F64]
    """Of the frequencies, and of the pulses."""
    response_m2: float
    """Integral of a point's power over its peak, in the plane."""
