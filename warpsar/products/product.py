"""One product: its geometry, its samples, and what they are worth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.errors import InputError
from warpsar.products.grid import LineGrid
from warpsar.products.orbit import Orbit
from warpsar.products.zero_doppler import Side, abeam, azimuth_deg, incidence_deg, locate, toward_radar
from warpsar.world.earth import geodetic_to_ecef
from warpsar.world.frame import SPEED_OF_LIGHT

F64 = NDArray[np.float64]
Radiometry = Literal["beta0", "sigma0", "gamma0"]
RADIOMETRIES: tuple[Radiometry, ...] = ("beta0", "sigma0", "gamma0")


def to_beta0(radiometry: Radiometry | None, incidence_deg: ArrayLike) -> F64:
    """What turns power into beta0, of the incidences' shape: beta0 = sigma0 / sin(incidence), sigma0 = gamma0
    cos(incidence), on the ellipsoid. 1 where nothing says what the power is."""
    angle = np.deg2rad(incidence_deg)
    factor = {"sigma0": np.sin, "gamma0": np.tan}.get(str(radiometry), np.ones_like)
    return np.asarray(1.0 / factor(angle))


class Samples(Protocol):
    """Pixels (rows, columns): an array, a memory map, or a file that is read only where it is sliced."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    @property
    def dtype(self) -> np.dtype: ...

    def __getitem__(self, window: tuple[slice, slice], /) -> np.ndarray: ...


@dataclass(frozen=True)
class ImagedPoint:
    """Where a product shows a place, and how it looks at it."""

    time_s: float
    slant_range_m: float
    line: float
    pixel: float
    toward_radar: F64
    """Unit vector east, north, up, (3,)."""

    @property
    def azimuth_deg(self) -> float:
        """Of the direction to the radar, clockwise from north."""
        return azimuth_deg(self.toward_radar)

    @property
    def incidence_deg(self) -> float:
        """From the ellipsoid's normal."""
        return incidence_deg(self.toward_radar)


@dataclass(frozen=True)
class Product:
    """A zero-Doppler image of the earth. Times are seconds from `epoch`."""

    source: str
    platform: str
    epoch: np.datetime64
    polarization: str | None
    frequency_hz: float
    side: Side
    grid: LineGrid
    orbit: Orbit | None
    """None where the file has no state vectors."""
    samples: Samples | None
    """(lines, pixels): complex, amplitude or power, by `quantity`. None where there is annotation alone."""
    quantity: Literal["complex", "amplitude", "power"]
    radiometry: Radiometry | None
    """What power times `gain` is; None where the product does not say."""
    gain: Callable[[ArrayLike, ArrayLike], F64] | None = None
    """At lines and pixels: turns power into `radiometry`; None where that is 1, or nothing is known."""
    noise: Callable[[ArrayLike, ArrayLike], F64] | None = None
    """At lines and pixels: power of the noise, before `gain`."""
    demodulate: Callable[[F64, F64, NDArray[np.complex128]], NDArray[np.complex128]] | None = None
    """Of lines (n,), pixels (m,) and samples (n, m): samples whose spectrum lies about zero frequency (TOPS)."""
    bandwidth_hz: tuple[float | None, float | None] = (None, None)
    """Processed, in range and azimuth."""
    hamming: tuple[float, float] = (1.0, 1.0)
    """Coefficient alpha of the windows of range and azimuth: alpha - (1 - alpha) cos; 1 is none."""
    looks: tuple[float, float] = (1.0, 1.0)
    """In range and azimuth: parts of the spectrum, of `bandwidth_hz` each, whose powers are averaged."""
    top: float | None = None
    """The largest number that the format can say, of a complex sample in either part: brighter ones have it, too."""

    def __post_init__(self) -> None:
        above_zero: dict[str, float | None] = {
            "radar frequency [Hz]": self.frequency_hz,
            "time between lines [s]": abs(self.grid.line_s),
            "step between pixels [m]": abs(self.grid.range_step_m),
            "bandwidth in range [Hz]": self.bandwidth_hz[0],
            "bandwidth in azimuth [Hz]": self.bandwidth_hz[1],
            "looks in range": self.looks[0],
            "looks in azimuth": self.looks[1],
        }
        for name, value in above_zero.items():
            if value is not None and not 0.0 < value < np.inf:
                raise InputError(f"{self.source}: {name}: found {value:g}; must be a number above 0")
        for name, count in (("lines", self.grid.lines), ("pixels in a line", self.grid.pixels)):
            if count < 1:
                raise InputError(f"{self.source}: number of {name}: found {count}; must be 1 or more")
        for axis, alpha in zip(("range", "azimuth"), self.hamming, strict=True):
            if not 0.5 <= alpha <= 1.0:
                raise InputError(f"{self.source}: window in {axis}: found the coefficient {alpha:g}; must be 0.5 to 1")

    @property
    def wavelength_m(self) -> float:
        return SPEED_OF_LIGHT / self.frequency_hz

    def date(self, time_s: float) -> np.datetime64:
        """UTC of an azimuth time."""
        return self.epoch + np.timedelta64(round(time_s * 1e6), "us")

    def to_image(self, geodetic: ArrayLike) -> ImagedPoint:
        """Where the image shows a place (latitude, longitude [deg], height [m] above the WGS 84 ellipsoid).

        Raises InputError where the orbit is missing, or does not reach that place.
        """
        orbit = self.required_orbit
        place = np.asarray(geodetic, np.float64)
        time, distance = abeam(orbit, geodetic_to_ecef(place), self.grid.middle_s)
        step = float(np.diff(orbit.time_s).max())
        if not orbit.covers(time, step):
            raise InputError(
                f"{self.source}: latitude {place[0]:g}, longitude {place[1]:g} is abeam at {float(time):.1f} s; the "
                f"state vectors reach from {orbit.time_s[0]:.1f} to {orbit.time_s[-1]:.1f} s"
            )
        at, slant = float(time), float(distance)
        line, pixel = float(self.grid.line(at, slant)), float(self.grid.pixel(at, slant))
        return ImagedPoint(at, slant, line, pixel, toward_radar(orbit, place, at))

    def to_ground(self, line: ArrayLike, pixel: ArrayLike, height_m: ArrayLike) -> F64:
        """Latitude, longitude [deg] and height [m], (..., 3), of lines and pixels at that height."""
        slant = self.grid.slant_m(line, pixel)
        return locate(self.required_orbit, self.grid.time_s(line, pixel), slant, height_m, self.side)

    def speed_m_s(self, point: ImagedPoint) -> float:
        """How fast zero Doppler moves over the ground at a place [m/s]: what a second of azimuth is long there.

        From the two places at height 0 and the same range, half a second before and after.
        """
        orbit, half = self.required_orbit, 0.5
        ends = [locate(orbit, point.time_s + dt, point.slant_range_m, 0.0, self.side) for dt in (-half, half)]
        return float(np.linalg.norm(np.diff([geodetic_to_ecef(end) for end in ends], axis=0))) / (2.0 * half)

    def spacing_m(self, point: ImagedPoint) -> tuple[float, float]:
        """Length of a line on the ground, and of a pixel in slant range, at a place [m]."""
        return (
            self.speed_m_s(point) * abs(self.grid.line_s),
            abs(self.grid.slant_step_m(point.line, point.pixel)),
        )

    @property
    def required_orbit(self) -> Orbit:
        """The orbit. Raises InputError where the file has none."""
        if self.orbit is None:
            raise InputError(f"{self.source}: found no state vectors of the orbit; must be there to place a site")
        return self.orbit
