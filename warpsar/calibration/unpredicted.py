"""Reflectors without a prediction: whether their RCS stays the same, and what changes it with time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from warpsar.calibration.attitude import turn_that_loses_deg
from warpsar.calibration.causes import changes
from warpsar.calibration.differences import BadDate, Differences, bad_dates, over_1_m2
from warpsar.calibration.joint import JointFit, joint, together_words
from warpsar.calibration.measure import ReflectorObservation

F64 = NDArray[np.float64]
USUAL_SCATTER_DB = 1.0 / 3.0
"""From date to date, of a reflector that stays the same; a choice: Sentinel-1 is specified to 1 dB in three standard
deviations. Few dates do not show it."""
FALSE_RATE = 0.01
"""Chance that any of all series is said to change, of those that do not."""


@dataclass(frozen=True)
class UnevenSeries:
    """A reflector whose RCS, from one pass and in one polarization, is not the same at all dates."""

    site: str
    polarization: str | None
    brightest: tuple[str, float]
    weakest: tuple[str, float]
    """Date, and RCS [dBsm]."""
    chance: float
    """That clutter and the usual scatter alone make values so different."""
    turn_deg: float
    """In azimuth from the boresight that would take as much; NaN where none would."""

    @property
    def words(self) -> str:
        """What it may be: its own power does not tell that apart."""
        (bright_date, bright), (weak_date, weak) = self.brightest, self.weakest
        turn = f"A turn (by {self.turn_deg:.0f} deg in azimuth, from the boresight), water or dirt, and a bent plate"
        tied = turn if self.turn_deg > 0.0 else "Water or dirt, and a bent plate"
        name = f"{self.site}, {self.polarization}" if self.polarization else self.site
        return (
            f"{name}: no prediction; its RCS is not the same at all dates: {bright:.1f} dBsm on {bright_date}, "
            f"{bright - weak:.1f} dB less on {weak_date} (clutter and {USUAL_SCATTER_DB:.2f} dB of scatter would have "
            f"it with a chance of {self.chance:.0e}). {tied} could each stand for it; a survey of its attitude, or a "
            "look at its plates, would decide."
        )

    def content(self) -> dict[str, object]:
        """For JSON."""
        return {
            "id": self.site, "polarization": self.polarization,
            "brightest": {"date": self.brightest[0], "rcs_dbsm": self.brightest[1]},
            "weakest": {"date": self.weakest[0], "rcs_dbsm": self.weakest[1]},
            "chance": self.chance, "turn_deg": self.turn_deg, "words": self.words,
        }  # fmt: skip


@dataclass(frozen=True)
class Unpredicted:
    """What the dates of all reflectors without a prediction say."""

    uneven: tuple[UnevenSeries, ...]
    bad_dates: tuple[BadDate, ...]
    joint: JointFit | None
    """Fading and steps, fitted together to each series less its mean."""
    words: tuple[str, ...]

    def content(self) -> dict[str, object]:
        """For JSON."""
        return {
            "uneven": [one.content() for one in self.uneven],
            "joint": None if self.joint is None else self.joint.content(),
            "words": list(self.words),
        }


def unpredicted(observations: Sequence[ReflectorObservation]) -> Unpredicted | None:
    """Of reflectors that are measured and have no prediction; None where there is none with two dates.

    A series is a reflector in one pass and polarization. Values are tested against their weighted mean by chi-square,
    with clutter's errors and `USUAL_SCATTER_DB`. Where they are enough for a cause, `joint` finds it as it does among
    differences."""
    data = Differences.of([over_1_m2(one) for one in observations if not one.predicted_m2])
    series = _series(data)
    groups = [np.flatnonzero(series == k) for k in np.unique(series)]
    groups = [group for group in groups if group.size > 1]
    if not groups:
        return None
    bad, good = bad_dates(data)
    uneven = [one for group in groups if (one := _uneven(data, group[good[group]], len(groups))) is not None]
    found, words = None, [one.words for one in uneven]
    means = np.bincount(series, data.value) / np.bincount(series)
    known = replace(data, value=data.value - means[series]).part(good)
    if any(cause.physical for cause in changes(known)):
        found = joint(known, changes)
        if found.causes:
            words += [f"Without a prediction, each about its own mean. {each}" for each in together_words(found)]
    if not words:
        names = ", ".join(dict.fromkeys(data.names[data.site[group[0]]] for group in groups))
        words.append(f"No prediction, and no change of RCS beyond clutter and {USUAL_SCATTER_DB:.2f} dB: {names}.")
    return Unpredicted(tuple(uneven), tuple(bad), found, tuple(words))


def _series(data: Differences) -> NDArray[np.int64]:
    """A number of each reflector, pass and polarization, (n,)."""
    numbers: dict[tuple[int, str | None], int] = {}
    pairs = zip(data.passes.tolist(), (one.polarization for one in data.observations), strict=True)
    return np.array([numbers.setdefault(pair, len(numbers)) for pair in pairs], np.int64)


def _uneven(data: Differences, group: NDArray[np.int64], tried: int) -> UnevenSeries | None:
    value, weight = data.value[group], 1.0 / (data.sd[group] ** 2 + USUAL_SCATTER_DB**2)
    if value.size < 2:
        return None
    misfit = float((weight * (value - np.average(value, weights=weight)) ** 2).sum())
    chance = float(chdtrc(value.size - 1, misfit))
    if chance * tried >= FALSE_RATE:
        return None
    dates = [str(data.observations[k].date)[:10] for k in group.tolist()]
    high, low = int(value.argmax()), int(value.argmin())
    one = data.observations[int(group[0])]
    return UnevenSeries(
        one.site.name, one.polarization, (dates[high], float(value[high])), (dates[low], float(value[low])), chance,
        turn_that_loses_deg(one.site.shape, float(value[high] - value[low])),
    )  # fmt: skip
