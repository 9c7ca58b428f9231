"""How far reflectors lie off the place that orbit and survey give, and which of them moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from warpsar.calibration.causes import ALL, LEAST_SPAN_DEG, LEAST_SPAN_YEARS, Cause, Situation
from warpsar.calibration.differences import Differences
from warpsar.calibration.joint import JointFit, joint, together_words
from warpsar.calibration.measure import ALLOWANCE_M, FEWEST_PIXELS, ReflectorObservation

CONFIDENCE = 0.9
AXES = ("azimuth", "slant_range")
F64 = NDArray[np.float64]
LEAST_SCATTER_M = 0.02
"""From date to date; a choice. Some 0.01 m was reached, with all corrections (Eineder et al., IEEE TGRS 49, 2011)."""
FARTHEST_M = 1e4


def offsets(observations: Sequence[ReflectorObservation], axis: int, allowance_m: float) -> Differences:
    """Of reflectors that are seen, stand, and are surveyed; `axis` is 0 for azimuth, 1 for slant range.

    Places scatter by sqrt(1/3) of what was searched at most: so do peaks that lie anywhere in it.
    """
    used = [one for one in observations if one.offset_m is not None and one.stands and one.site.for_place]
    used = [one for one in used if one.point is not None and one.point.seen and one.expected is not None]
    spacings = [one.spacing_m[axis] for one in used if one.spacing_m is not None]
    searched = max(allowance_m, FEWEST_PIXELS * max(spacings, default=0.0))
    values = [(one.offset_m[axis], one.point.position_sd_m[axis]) for one in used if one.offset_m and one.point]
    return Differences.between(used, values, LEAST_SCATTER_M, searched / np.sqrt(3.0))


def place_causes(data: Differences, axis: int) -> list[Cause]:
    """All that these data could speak of."""
    found = [
        Cause(
            "timing", "the image's timing is off", ("offset [m]",), lambda x, d: np.full(len(d), x[0]), (0.0,),
            (-FARTHEST_M,), (FARTHEST_M,), lambda x, s: float(x[0]), level=ALL,
        )
    ]  # fmt: skip
    if axis == 1 and np.ptp(data.incidence_deg) > LEAST_SPAN_DEG:
        found.append(
            Cause(
                "atmosphere", "the path through the atmosphere is longer", ("at zenith [m]",),
                lambda x, d: x[0] / np.cos(np.deg2rad(d.incidence_deg)), (0.0,), (0.0,), (100.0,),
                lambda x, s: float(x[0] / np.cos(np.deg2rad(s.incidence_deg))),
            )
        )  # fmt: skip
    if np.ptp(data.years) > LEAST_SPAN_YEARS and len(data) > 4:
        middle = float(data.years.mean())
        found.append(
            Cause(
                "timing drift", "the image's timing drifts", ("offset [m]", "drift [m/year]"),
                lambda x, d: x[0] + x[1] * (d.years - middle), (0.0, 0.0), (-FARTHEST_M, -FARTHEST_M),
                (FARTHEST_M, FARTHEST_M), lambda x, s: float(x[0] + x[1] * (s.years - middle)), level=ALL,
            )
        )  # fmt: skip
    return found + [_place(i, name) for i, name in enumerate(data.names)]


def _place(i: int, name: str) -> Cause:
    return Cause(
        f"place of {name}", f"{name} is not where it was surveyed", ("offset [m]",),
        lambda x, d: np.where(d.site == i, x[0], 0.0), (0.0,), (-FARTHEST_M,), (FARTHEST_M,),
        lambda x, s: float(x[0]) if s.site == name and not s.attitude_surveyed else 0.0, level=(f"site {i}", 0),
    )  # fmt: skip


def place_situations(data: Differences) -> list[Situation]:
    """What could be measured next."""
    now, angle, look = float(data.years.max()), float(data.incidence_deg.mean()), data.look[-1]
    found = [
        Situation("another surveyed reflector in the same image", None, angle, now, look),
        Situation("another surveyed reflector, at an incidence 8 degrees higher", None, angle + 8.0, now, look),
        Situation("another surveyed reflector, in an image of a year later", None, angle, now + 1.0, look),
    ]
    return found + [
        Situation(f"{name} surveyed anew", name, angle, now, look, attitude_surveyed=True) for name in data.names
    ]


@dataclass(frozen=True)
class GeolocationOffset:
    """Mean of found less expected place along one axis [m], its interval of 90 %, and the scatter of single values.

    Interval and scatter are NaN of a single value.
    """

    mean_m: float
    low_m: float
    high_m: float
    scatter_m: float
    values: int


@dataclass(frozen=True)
class Geolocation:
    """Of all reflectors together, in azimuth and slant range, and of each by itself."""

    azimuth: GeolocationOffset
    slant_range: GeolocationOffset
    sites: dict[str, tuple[GeolocationOffset, GeolocationOffset]]
    moved: tuple[str, ...]
    """Reflectors that lie off where the others say that the image is."""
    words: str
    joint: tuple[JointFit, JointFit] = field(repr=False)
    """What moves places, of azimuth and slant range, fitted together."""

    def content(self) -> dict[str, object]:
        """For JSON."""

        def of(axes: tuple[GeolocationOffset, GeolocationOffset]) -> dict[str, object]:
            return {name: vars(axis) for name, axis in zip(AXES, axes, strict=True)}

        sites = {name: of(axes) for name, axes in self.sites.items()}
        return {
            **of((self.azimuth, self.slant_range)),
            "sites": sites,
            "moved": list(self.moved),
            "words": self.words,
            "joint": {name: one.content() for name, one in zip(AXES, self.joint, strict=True)},
        }


def geolocation(
    observations: Sequence[ReflectorObservation], allowance_m: tuple[float, float] = ALLOWANCE_M
) -> Geolocation | None:
    """None where nothing was found. `allowance_m`: how far off places were looked for, in azimuth and slant range."""
    both = offsets(observations, 0, allowance_m[0]), offsets(observations, 1, allowance_m[1])
    if not len(both[0]):
        return None
    whole = _offset(both[0].value), _offset(both[1].value)
    sites = {
        name: (_offset(both[0].value[both[0].site == i]), _offset(both[1].value[both[1].site == i]))
        for i, name in enumerate(both[0].names)
    }
    found = [joint(data, partial(place_causes, axis=axis), place_situations(data)) for axis, data in enumerate(both)]
    named = {one.cause.name for each in found for one in each.causes}
    moved = tuple(name for name in sites if f"place of {name}" in named)
    words = (
        f"The image lies {whole[0].mean_m:+.2f} m in azimuth and {whole[1].mean_m:+.2f} m in slant range off orbit and "
        "survey, before any correction for atmosphere (2 to 4 m in range), tides and timing."
    )
    for title, one in zip(("Azimuth", "Slant range"), found, strict=True):
        words += " " + " ".join(f"{title}: {each[0].lower()}{each[1:]}" for each in together_words(one, "m"))
    return Geolocation(*whole, sites, moved, words, (found[0], found[1]))


def _offset(values: np.ndarray) -> GeolocationOffset:
    mean, count = float(values.mean()), values.size
    if count < 2:
        return GeolocationOffset(mean, float("nan"), float("nan"), float("nan"), count)
    scatter = float(values.std(ddof=1))
    reach = float(stdtrit(count - 1, 0.5 + 0.5 * CONFIDENCE)) * scatter / np.sqrt(count)
    return GeolocationOffset(mean, mean - reach, mean + reach, scatter, count)
