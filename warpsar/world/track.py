"""Where a sensor is at each pulse, about the scene's reference point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.world.frame import ViewGeometry

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """Times (p,) [s], and places of receiver and transmitter (p, 3) [m] about the reference point, east, north, up.

    `straight`: the unit vector along a straight track that was asked for, else None.
    """

    time_s: F64
    receiver_m: F64
    transmitter_m: F64
    straight: F64 | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def bistatic(self) -> bool:
        return not np.array_equal(self.receiver_m, self.transmitter_m)

    def reference_m(self) -> F64:
        """Mean of both ways to the reference point, (p,) [m]."""
        return 0.5 * (np.linalg.norm(self.receiver_m, axis=1) + np.linalg.norm(self.transmitter_m, axis=1))

    def ends(self) -> tuple[F64, F64]:
        """Unit vectors from the reference point to transmitter and receiver, (p, 3) each."""
        sent, received = (
            place / np.linalg.norm(place, axis=1, keepdims=True) for place in (self.transmitter_m, self.receiver_m)
        )
        return sent, received

    def bistatic_deg(self) -> float:
        """Largest angle between transmitter and receiver, as the reference point sees them [deg]."""
        sent, received = self.ends()
        half = 0.5 * np.linalg.norm(sent - received, axis=1)
        return float(2.0 * np.rad2deg(np.arcsin(half.clip(0.0, 1.0))).max())

    def mean_towards(self) -> F64:
        """Mean of the unit vectors to both antennas, (p, 3): cos(half their angle) long. Over a way of x [m] the phase
        turns by 2 k times its part along x: two antennas apart resolve less than one."""
        sent, received = self.ends()
        return 0.5 * (received + sent)

    def towards(self) -> F64:
        """Unit vectors from the reference point to the sensor, (p, 3); halfway between two antennas."""
        both = self.mean_towards()
        unit: F64 = both / np.linalg.norm(both, axis=1, keepdims=True)
        return unit

    def ranges_less_reference(self, points_m: F64, pulses: NDArray[np.int64]) -> F64:
        """Mean way to points (n, 3) about the reference point, less its own, (pulses, n) [m]; exact far away, too."""
        receiver, transmitter = self.receiver_m[pulses], self.transmitter_m[pulses]
        found = _less_reference(receiver, points_m)
        if np.array_equal(receiver, transmitter):
            return found
        return 0.5 * (found + _less_reference(transmitter, points_m))

    def centre(self) -> Track:
        """The middle in time, as a track of one pulse: between two pulses where their number is even."""
        middle = 0.5 * (self.time_s[0] + self.time_s[-1])
        receiver, transmitter = (
            np.array([[np.interp(middle, self.time_s, axis) for axis in place.T]])
            for place in (self.receiver_m, self.transmitter_m)
        )
        return Track(np.array([middle]), receiver, transmitter, self.straight)

    def velocity_m_s(self) -> tuple[F64, F64]:
        """Of receiver and transmitter, (p, 3) each."""
        return np.gradient(self.receiver_m, self.time_s, axis=0), np.gradient(self.transmitter_m, self.time_s, axis=0)


def _less_reference(place_m: F64, points_m: F64) -> F64:
    """Ways from places (p, 3) to points (n, 3) less those to zero, (p, n) [m]: no difference of ranges."""
    change = (points_m**2).sum(axis=1) - 2.0 * place_m @ points_m.T
    square = (place_m**2).sum(axis=1)[:, None]
    found: F64 = change / (np.sqrt(np.maximum(square + change, 0.0)) + np.sqrt(square))
    return found


def along(geometry: ViewGeometry, side: str, squint_deg: float) -> F64 | None:
    """Unit vector of level flight that sees the scene on `side`, `squint_deg` ahead; None where none can."""
    level = np.array([*geometry.d[:2], 0.0])
    sine = float(np.hypot(*geometry.d[:2]))
    ahead = np.sin(np.deg2rad(squint_deg)) / sine
    if abs(ahead) >= 1.0:
        return None
    sign = 1.0 if side == "right" else -1.0
    return ahead * level / sine + sign * np.sqrt(1.0 - ahead**2) * geometry.u


def centred(count: int) -> F64:
    """Places of `count` pulses in -1/2 to 1/2, each in the middle of its share."""
    return (np.arange(count) + 0.5) / count - 0.5


def straight(geometry: ViewGeometry, slant_m: float, way: F64, length_m: float, speed_m_s: float, count: int) -> Track:
    """Level flight along `way`, whose middle is the view's direction."""
    place = centred(count) * length_m
    position = slant_m * geometry.s + place[:, None] * way
    return Track(place / speed_m_s, position, position, way)


def circle(
    azimuth_deg: float,
    geometry: ViewGeometry,
    slant_m: float,
    side: str,
    aperture_deg: float,
    time_s: float,
    count: int,
) -> Track:
    """Around the reference point at one height; or a turntable, whose frame this is."""
    part = centred(count)
    azimuth = np.deg2rad(azimuth_deg + (1.0 if side == "right" else -1.0) * aperture_deg * part)
    sine, cosine = float(np.hypot(*geometry.s[:2])), float(geometry.s[2])
    toward = np.stack([np.sin(azimuth) * sine, np.cos(azimuth) * sine, np.full(count, cosine)], axis=1)
    return Track(part * time_s, slant_m * toward, slant_m * toward)
