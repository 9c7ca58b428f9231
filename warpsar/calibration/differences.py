"""The differences between measured and predicted RCS, as what is explained; and which dates are bad."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.calibration.measure import ReflectorObservation

F64 = NDArray[np.float64]
YEAR_S = 365.25 * 86400.0
OUTLYING = 3.5
"""Robust standard deviations off the values before and after: such a date is bad (Iglewicz and Hoaglin, 1993)."""
NEIGHBOURS = 3
"""Values before, and after, that make the level at a date."""
LEAST_SCATTER_DB = 0.1
"""What is known of no radar better, from date to date."""
SAME_PASS = float(np.cos(np.deg2rad(3.0)))
"""Looks that differ by less are of one pass."""
FEWEST = 5
"""Values of a reflector from one pass, of which one can be called bad."""


@dataclass(frozen=True)
class Differences:
    """What is explained: values of several reflectors and dates, (n,) each, ascending in time."""

    observations: tuple[ReflectorObservation, ...]
    difference_db: F64
    sd_db: F64
    """Of clutter and noise."""
    site: NDArray[np.int64]
    names: tuple[str, ...]
    years: F64
    """From the first one."""
    incidence_deg: F64
    look: F64
    """Unit vectors to the radar, (n, 3)."""

    @classmethod
    def of(cls, observations: Sequence[ReflectorObservation]) -> Differences:
        """Of all that are measured, stand by the table of sites, and have a prediction."""
        used = [
            one
            for one in observations
            if one.stands and one.site.for_power and one.difference_db is not None and one.difference_sd_db is not None
        ]
        used.sort(key=lambda one: (one.date, one.site.name))
        names = tuple(dict.fromkeys(one.site.name for one in used))
        first = used[0].date if used else np.datetime64("2000-01-01")
        return cls(
            tuple(used),
            np.array([one.difference_db for one in used], np.float64),
            np.array([one.difference_sd_db for one in used], np.float64),
            np.array([names.index(one.site.name) for one in used], np.int64),
            names,
            np.array([(one.date - first) / np.timedelta64(1, "s") / YEAR_S for one in used], np.float64),
            np.array([one.expected.incidence_deg for one in used if one.expected is not None], np.float64),
            np.array([one.expected.toward_radar for one in used if one.expected is not None]).reshape(-1, 3),
        )

    def part(self, chosen: NDArray[np.bool_]) -> Differences:
        return Differences(
            tuple(one for one, take in zip(self.observations, chosen, strict=True) if take),
            self.difference_db[chosen],
            self.sd_db[chosen],
            self.site[chosen],
            self.names,
            self.years[chosen],
            self.incidence_deg[chosen],
            self.look[chosen],
        )

    @property
    def looks(self) -> list[tuple[int, F64]]:
        """Reflector and direction to the radar of each pass, in the order of time."""
        found: list[tuple[int, F64]] = []
        for site, look in zip(self.site.tolist(), self.look, strict=True):
            if not any(site == other and look @ known > SAME_PASS for other, known in found):
                found.append((site, look))
        return found

    @property
    def passes(self) -> NDArray[np.int64]:
        """Which of `looks` each value has, (n,)."""
        return pass_numbers(self.looks, self)

    def __len__(self) -> int:
        return self.difference_db.size


def pass_numbers(looks: Sequence[tuple[int, F64]], data: Differences) -> NDArray[np.int64]:
    """Which of these passes each value has, (n,); -1 for none."""
    found = np.full(len(data), -1, np.int64)
    for k, (site, look) in reversed(list(enumerate(looks))):
        found[(data.site == site) & (data.look @ look > SAME_PASS)] = k
    return found


@dataclass(frozen=True)
class BadDate:
    """A date whose value lies off the level of its reflector, or at which it is not seen."""

    site: str
    date: str
    off_db: float
    """From the level; of what is not seen: from the prediction at most."""
    deviations: float
    """Standard ones, by a robust scale; NaN of what is not seen."""
    words: str

    def content(self) -> dict[str, object]:
        """For JSON."""
        return {"id": self.site, "date": self.date, "off_db": self.off_db, "words": self.words}


def absent(observations: Sequence[ReflectorObservation]) -> list[BadDate]:
    """Dates at which a reflector should stand, but its upper bound lies below the prediction."""
    found = []
    for one in observations:
        if one.status != "not seen" or not one.stands or one.point is None or not one.predicted_m2:
            continue
        off = float(10.0 * np.log10(max(one.point.high_m2, 1e-9) / one.predicted_m2))
        if off < 0.0:
            words = f"not seen, at least {-off:.1f} dB below the prediction: absent, moved, or covered"
            found.append(BadDate(one.site.name, str(one.date)[:10], off, float("nan"), words))
    return found


def bad_dates(data: Differences) -> tuple[list[BadDate], NDArray[np.bool_]]:
    """Values that lie off those before them and off those after them; and which values do not, (n,).

    A step, or a level that drifts, is no bad date: it has neighbours on one side at least.
    """
    good = np.ones(len(data), bool)
    found = []
    for group in np.unique(data.passes):
        here = np.flatnonzero(data.passes == group)
        if here.size < FEWEST:
            continue
        values = data.difference_db[here]
        # From one value to the next: twice the variance of one, and blind to steps.
        spread = 1.4826 / np.sqrt(2.0) * float(np.median(np.abs(np.diff(values))))
        scale = np.maximum(max(spread, LEAST_SCATTER_DB), data.sd_db[here])
        for k, i in enumerate(here.tolist()):
            sides = [
                side for side in (values[max(k - NEIGHBOURS, 0) : k], values[k + 1 : k + 1 + NEIGHBOURS]) if side.size
            ]
            off = [float(values[k] - np.median(side)) for side in sides]
            level = min(off, key=abs)
            if min(off) * max(off) > 0.0 and abs(level) > OUTLYING * scale[k]:
                good[i] = False
                one = data.observations[i]
                words = f"{level:+.1f} dB off its level: {_weather(level)}"
                found.append(BadDate(one.site.name, str(one.date)[:10], level, level / float(scale[k]), words))
    return found, good


def _weather(level_db: float) -> str:
    """What a single date may have, by its sign."""
    return "snow, water or a covered plate" if level_db < 0.0 else "a brighter target beside it"
