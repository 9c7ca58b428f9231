"""How far reflectors lie off the place that orbit and survey give, and which of them moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy.special import stdtrit

from warpsar.calibration.joint import JointFit, joint, together_words
from warpsar.calibration.measure import ALLOWANCE_M, ReflectorObservation
from warpsar.calibration.places import offsets, place_causes, place_situations

CONFIDENCE = 0.9
AXES = ("azimuth", "slant_range")


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
