"""How far reflectors lie off the place that orbit and survey give, and which of them moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from warpsar.calibration.measure import ReflectorObservation

CONFIDENCE = 0.9
MOVED = 4.0
"""Standard errors of a reflector's mean off the others' mean."""


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

    def content(self) -> dict[str, object]:
        """For JSON."""

        def of(axes: tuple[GeolocationOffset, GeolocationOffset]) -> dict[str, object]:
            return {name: vars(axis) for name, axis in zip(("azimuth", "slant_range"), axes, strict=True)}

        sites = {name: of(axes) for name, axes in self.sites.items()}
        return {**of((self.azimuth, self.slant_range)), "sites": sites, "moved": list(self.moved), "words": self.words}


def geolocation(observations: Sequence[ReflectorObservation]) -> Geolocation | None:
    """None where nothing was found."""
    used = [one for one in observations if one.offset_m is not None and one.stands and one.point and one.point.seen]
    used = [one for one in used if one.site.for_place]
    if not used:
        return None
    offsets = np.array([one.offset_m for one in used], np.float64)
    names = np.array([one.site.name for one in used])
    whole = _offset(offsets[:, 0]), _offset(offsets[:, 1])
    sites, moved = {}, []
    for name in dict.fromkeys(names.tolist()):
        here = names == name
        sites[name] = _offset(offsets[here, 0]), _offset(offsets[here, 1])
        if here.all() or (~here).sum() < 3 or here.sum() < 2:
            continue
        others = np.median(offsets[~here], axis=0)
        spread = np.maximum(1.4826 * np.median(np.abs(offsets[~here] - others), axis=0), 0.02)
        off = np.abs(offsets[here].mean(axis=0) - others) / (spread * np.sqrt(1.0 / here.sum() + 1.0 / (~here).sum()))
        if (off > MOVED).any():
            moved.append(name)
    words = (
        f"The image lies {whole[0].mean_m:+.2f} m in azimuth and {whole[1].mean_m:+.2f} m in slant range off orbit and "
        "survey. The path through the atmosphere (2 to 4 m in range), tides and the product's timing are tied here; a "
        "model of the atmosphere, or reflectors at two incidences, would decide."
    )
    return Geolocation(*whole, sites, tuple(moved), words)


def _offset(values: np.ndarray) -> GeolocationOffset:
    mean, count = float(values.mean()), values.size
    if count < 2:
        return GeolocationOffset(mean, float("nan"), float("nan"), float("nan"), count)
    scatter = float(values.std(ddof=1))
    reach = float(student.ppf(0.5 + 0.5 * CONFIDENCE, count - 1)) * scatter / np.sqrt(count)
    return GeolocationOffset(mean, mean - reach, mean + reach, scatter, count)
