"""An orbit's state vectors, and places between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import KroghInterpolator
from scipy.special import factorial

from warpsar.errors import InputError

NODES = 4
"""State vectors that a piece of the orbit runs through."""
F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Orbit:
    """Earth-fixed state vectors: times (n,) [s] that ascend, positions (n, 3) [m], velocities (n, 3) [m/s].

    Between two of them the place is the Hermite polynomial through positions and velocities of the four nearest ones
    (degree 7), as in ISCE3. Its error for vectors 60 s apart is below 1 mm; that of a cubic one is 0.3 m
    (tests/products/test_orbit.py).
    """

    time_s: F64
    position_m: F64
    velocity_m_s: F64
    _pieces: dict[int, tuple[float, F64]] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, source: str, time_s: ArrayLike, position_m: ArrayLike, velocity_m_s: ArrayLike) -> Orbit:
        """Raises InputError, naming `source`, for vectors that are no orbit."""
        time, position, velocity = (np.asarray(each, np.float64) for each in (time_s, position_m, velocity_m_s))
        count = time.size
        if time.ndim != 1 or count < 2 or position.shape != (count, 3) or velocity.shape != (count, 3):
            raise InputError(
                f"{source}: found an orbit of {time.shape} times, {position.shape} positions and {velocity.shape} "
                "velocities; must be at least 2 of each, with 3 coordinates"
            )
        if not all(np.isfinite(each).all() for each in (time, position, velocity)):
            raise InputError(f"{source}: the orbit holds NaN or infinite values")
        if not (np.diff(time) > 0.0).all() or not (velocity**2).sum(-1).min() > 0.0:
            raise InputError(f"{source}: the orbit's times must ascend, and its velocities differ from zero")
        return cls(time, position, velocity)

    def at(self, time_s: ArrayLike) -> tuple[F64, F64]:
        """Position [m] and velocity [m/s], (..., 3) each, at times (...) [s]; beyond both ends by the outer pieces."""
        time = np.asarray(time_s, np.float64)
        flat = time.ravel()
        place, speed = np.empty((3, flat.size)), np.empty((3, flat.size))  # a coordinate a row: long loops are fast
        for start, inside in self._pieces_of(flat):
            middle, powers = self._piece(start, min(NODES, self.time_s.size))
            after = flat[inside] - middle
            for axis in range(3):
                at, slope = np.zeros(after.shape), np.zeros(after.shape)
                for k in range(len(powers) - 1, 0, -1):  # Horner's scheme, of the polynomial and of its derivative
                    at *= after
                    at += powers[k, axis]
                    slope *= after
                    slope += k * powers[k, axis]
                at *= after
                at += powers[0, axis]
                place[axis, inside], speed[axis, inside] = at, slope
        return place.T.reshape(*time.shape, 3), speed.T.reshape(*time.shape, 3)

    def _pieces_of(self, time: F64) -> Iterator[tuple[int, Any]]:
        """The first node of each piece that times (n,) lie in, and which of the times these are."""
        count = self.time_s.size
        nodes = min(NODES, count)

        def first(at: ArrayLike) -> NDArray[np.int64]:
            interval = np.clip(np.searchsorted(self.time_s, at) - 1, 0, count - 2)
            return np.clip(interval - nodes // 2 + 1, 0, count - nodes)

        if not time.size:
            return
        ends = first([np.fmin.reduce(time), np.fmax.reduce(time)])  # NaN stays NaN in any piece
        if ends[0] == ends[1]:  # an image of seconds has one or two pieces
            yield int(ends[0]), slice(None)
            return
        of = first(time)
        for start in np.unique(of).tolist():
            yield start, of == start

    def _piece(self, start: int, nodes: int) -> tuple[float, F64]:
        """The time of a piece's middle [s], and the coefficients (2 nodes, 3) of rising powers of the time from there.

        Powers are many times faster than the interpolator itself, and as exact about the middle of four nodes.
        """
        if start not in self._pieces:
            chosen = slice(start, start + nodes)
            middle = 0.5 * float(self.time_s[start] + self.time_s[start + nodes - 1])
            # A node that stands twice has a value and a derivative.
            times = np.repeat(self.time_s[chosen] - middle, 2)
            values = np.stack([self.position_m[chosen], self.velocity_m_s[chosen]], axis=1).reshape(-1, 3)
            slopes = KroghInterpolator(times, values).derivatives(0.0, der=2 * nodes)
            self._pieces[start] = middle, slopes / factorial(np.arange(2 * nodes))[:, None]
        return self._pieces[start]

    def covered(self, time_s: ArrayLike, margin_s: float = 0.0) -> NDArray[np.bool_]:
        """Which times lie between the first and the last state vector, or `margin_s` beside them."""
        time = np.asarray(time_s, np.float64)
        return (time >= self.time_s[0] - margin_s) & (time <= self.time_s[-1] + margin_s)

    def covers(self, time_s: ArrayLike, margin_s: float = 0.0) -> bool:
        """Whether all times do."""
        return bool(self.covered(time_s, margin_s).all())
