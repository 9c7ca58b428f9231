"""The differences between measured and predicted RCS, as what is explained; and which dates are bad."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from warpsar.calibration.measure import ReflectorObservation

F64 = NDArray[np.float64]
YEAR_S = 365.25 * 86400.0
FALSE_SHARE = 0.05
"""Of the dates that are called bad, how many are good ones, on average (Benjamini and Hochberg, 1995)."""
NULL_DRAWS = 120_000
"""Made-up values by which the chance of a deviation is known: down to some 1e-5."""
NEIGHBOURS = 3
"""Values before, and after, that make the level at a date."""
LEAST_SCATTER_DB = 0.1
"""From date to date; a choice: a third of what Sentinel-1 is specified to, 1 dB in three standard deviations."""
MOST_SCATTER_DB = float(10.0 / np.log(10.0) * np.pi / np.sqrt(6.0))
"""5.6 dB: of power that is speckle alone, the logarithm of an exponential variable. What scatters more has no level."""
SAME_PASS = float(np.cos(np.deg2rad(3.0)))
"""Looks that differ by less are of one pass."""
FEWEST = 5
"""Values of a reflector from one pass, of which one can be called bad."""


@dataclass(frozen=True)
class Differences:
    """What is explained: values of several reflectors and dates, (n,) each, ascending in time."""

    observations: tuple[ReflectorObservation, ...]
    value: F64
    """[dB]; of places, [m]."""
    sd: F64
    """Of clutter and noise."""
    site: NDArray[np.int64]
    names: tuple[str, ...]
    years: F64
    """From the first one."""
    incidence_deg: F64
    look: F64
    """Unit vectors to the radar, (n, 3)."""
    image: NDArray[np.int64]
    """Which values come from one image."""
    least_scatter: float = LEAST_SCATTER_DB
    """From date to date, however well few values agree."""
    most_scatter: float = MOST_SCATTER_DB
    """What nothing that is measured scatters by more than."""

    @classmethod
    def of(cls, observations: Sequence[ReflectorObservation]) -> Differences:
        """Of all that are measured, stand by the table of sites, and have a prediction."""
        used = [
            one
            for one in observations
            if one.stands and one.site.for_power and one.difference_db is not None and one.difference_sd_db is not None
        ]
        return cls.between(used, [(one.difference_db, one.difference_sd_db) for one in used])

    @classmethod
    def between(
        cls,
        observations: Sequence[ReflectorObservation],
        values: Sequence[tuple[float | None, float | None]],
        least_scatter: float = LEAST_SCATTER_DB,
        most_scatter: float = MOST_SCATTER_DB,
    ) -> Differences:
        """Of observations of any order, each with a value and its standard deviation."""
        order = sorted(range(len(observations)), key=lambda i: (observations[i].date, observations[i].site.name))
        used = [observations[i] for i in order]
        value, sd = np.array([values[i] for i in order], np.float64).reshape(-1, 2).T
        names = tuple(dict.fromkeys(one.site.name for one in used))
        first = used[0].date if used else np.datetime64("2000-01-01")
        return cls(
            tuple(used),
            value.copy(),
            sd.copy(),
            np.array([names.index(one.site.name) for one in used], np.int64),
            names,
            np.array([(one.date - first) / np.timedelta64(1, "s") / YEAR_S for one in used], np.float64),
            np.array([one.expected.incidence_deg for one in used if one.expected is not None], np.float64),
            np.array([one.expected.toward_radar for one in used if one.expected is not None]).reshape(-1, 3),
            images_of(used),
            least_scatter,
            most_scatter,
        )

    def part(self, chosen: NDArray[np.bool_]) -> Differences:
        return Differences(
            tuple(one for one, take in zip(self.observations, chosen, strict=True) if take),
            self.value[chosen],
            self.sd[chosen],
            self.site[chosen],
            self.names,
            self.years[chosen],
            self.incidence_deg[chosen],
            self.look[chosen],
            self.image[chosen],
            self.least_scatter,
            self.most_scatter,
        )

    @property
    def days(self) -> NDArray[np.datetime64]:
        """Of each value, (n,)."""
        return np.array([one.date for one in self.observations], "datetime64[us]").astype("datetime64[D]")

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

    @cached_property
    def members(self) -> F64:
        """1 where a value is of an image, (images, n)."""
        return (np.arange(int(self.image.max(initial=-1)) + 1)[:, None] == self.image).astype(np.float64)

    def __len__(self) -> int:
        return self.value.size


def over_1_m2(one: ReflectorObservation) -> ReflectorObservation:
    """Without a prediction the RCS itself is the value."""
    return one if one.predicted_m2 else replace(one, closed_form_m2=1.0, engine_m2=None)


def images_of(observations: Sequence[ReflectorObservation]) -> NDArray[np.int64]:
    """Which image each has, (n,)."""
    images: dict[tuple[str, str, str | None], int] = {}
    keys = [(one.source, str(one.date)[:10], one.polarization) for one in observations]
    return np.array([images.setdefault(key, len(images)) for key in keys], np.int64)


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
    chance: float = float("nan")
    """That a good date lies as far off; NaN of what is not seen."""

    def content(self) -> dict[str, object]:
        """For JSON."""
        chance = None if np.isnan(self.chance) else self.chance
        return {"id": self.site, "date": self.date, "off_db": self.off_db, "chance": chance, "words": self.words}


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

    A step, or a level that drifts, is no bad date: it has neighbours on one side at least. How far a value lies off is
    counted in deviations (`deviations`). The chance that a good date lies as far off is that among made-up series of as
    many values, so it holds the error of the scale. Over all reflectors and dates, the dates are called bad among which
    a share of `FALSE_SHARE` is good, on average.
    """
    good = np.ones(len(data), bool)
    where: list[int] = []
    off: list[float] = []
    far: list[float] = []
    chance: list[float] = []
    for group in np.unique(data.passes):
        here = np.flatnonzero(data.passes == group)
        if here.size < FEWEST:
            continue
        level, score = deviations(data.value[here][None], data.sd[here], data.least_scatter)
        null = _null(here.size)
        where += here.tolist()
        off += level[0].tolist()
        far += score[0].tolist()
        above = null.size - np.searchsorted(null, np.abs(score[0]))
        chance += ((above + 1.0) / (null.size + 1.0)).tolist()
    if not where:
        return [], good
    found = []
    for k in _called(np.array(chance)).tolist():
        i = where[k]
        good[i] = False
        one = data.observations[i]
        words = f"{off[k]:+.1f} dB off its level: {_weather(off[k])}"
        found.append(BadDate(one.site.name, str(one.date)[:10], off[k], far[k], words, chance[k]))
    return found, good


def _called(chances: F64) -> NDArray[np.int64]:
    """Which chances are small enough for `FALSE_SHARE`: up to the last one below its rank's share of it (Benjamini and
    Hochberg, 1995)."""
    order = np.argsort(chances)
    below = np.flatnonzero(chances[order] <= FALSE_SHARE * np.arange(1, chances.size + 1) / chances.size)
    return np.sort(order[: below.max(initial=-1) + 1])


def deviations(values: F64, sd: F64, least: float) -> tuple[F64, F64]:
    """Of series (m, n): how far a value lies off the nearer of the levels before and after it, and that over its scale.

    A level is the median of up to three values; of the first and the last value, which have no side before or after,
    the neighbour stands for it, so that a step near an end is no bad date. 0 where both levels do not lie on one side
    of the value. The scale is
    the median step from value to value (which a step of the level, or one bad date, moves little), and not less than
    `least`, nor than the deviation that clutter gives a value on the level. `sd` (n,) [dB] is that of the value itself:
    the target beats with clutter, so that it goes with the inverse root of power.
    """
    count = values.shape[1]
    spread = 1.4826 / np.sqrt(2.0) * np.median(np.abs(np.diff(values, axis=1)), axis=1)
    level = np.zeros_like(values)
    for k in range(count):
        before, after = values[:, max(k - NEIGHBOURS, 0) : k], values[:, k + 1 : k + 1 + NEIGHBOURS]
        sides = before if k else after[:, :1], after if k + 1 < count else before[:, -1:]
        off = np.stack([values[:, k] - np.median(side, axis=1) for side in sides])
        one_side = (off.min(axis=0) * off.max(axis=0)) > 0.0
        nearer = np.take_along_axis(off, np.abs(off).argmin(axis=0)[None], axis=0)[0]
        level[:, k] = np.where(one_side, nearer, 0.0)
    scale = np.maximum(np.maximum(spread, least)[:, None], sd * 10.0 ** (level / 20.0))
    return level, level / scale


@lru_cache(maxsize=64)
def _null(count: int) -> F64:
    """Deviations of good values in series of so many, in rising order: Gaussian ones, made up."""
    rng = np.random.default_rng(count)
    made = rng.normal(size=(max(NULL_DRAWS // count, 1), count))
    return np.sort(np.abs(deviations(made, np.zeros(count), 0.0)[1]).ravel())


def _weather(level_db: float) -> str:
    """What a single date may have, by its sign."""
    return "snow, water or a covered plate" if level_db < 0.0 else "a brighter target beside it"
