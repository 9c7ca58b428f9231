"""All attitudes of a reflector that fit: its cross-section is even about the boresight, so that several do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label
from scipy.special import chdtri

from warpsar.calibration.causes import MOST_TURN_DEG, Cause, causes
from warpsar.calibration.differences import Differences
from warpsar.calibration.joint import JointFit

F64 = NDArray[np.float64]
STEP_DEG = 1.0
LARGEST = float(chdtri(2.0, 0.1))
"""Squared misfit of a turn and a tilt within their 90 % region."""
MOST_SITES = 3


@dataclass(frozen=True)
class AttitudeSolution:
    """A region of turns in azimuth and tilts that fit as well as any, within 90 %; other causes as they were fitted."""

    site: str
    turn_deg: float
    tilt_deg: float
    """Of its best place."""
    turn_range_deg: tuple[float, float]
    tilt_range_deg: tuple[float, float]
    least_deg: tuple[float, float]
    """Turn and tilt of the region that are nearest to the survey."""
    passes: int
    """One pass leaves a ring about the boresight."""

    def content(self) -> dict[str, object]:
        """For JSON."""
        return {
            "id": self.site,
            "turn_deg": self.turn_deg,
            "tilt_deg": self.tilt_deg,
            "turn_range_deg": list(self.turn_range_deg),
            "tilt_range_deg": list(self.tilt_range_deg),
            "nearest_to_survey_deg": list(self.least_deg),
            "passes": self.passes,
        }


def attitude_solutions(found: JointFit, data: Differences) -> list[AttitudeSolution]:
    """Of reflectors whose attitude is a cause, or could stand for one."""
    named = [one.cause for one in found.causes if one.cause.grid]
    stands = {one.other: one.cause for one in found.stands}
    made: list[AttitudeSolution] = []
    for site, name in enumerate(data.names):
        cause = next((one for one in named if one.name == f"attitude of {name}"), None)
        stand = stands.get(f"attitude of {name}")
        if (cause is None and stand is None) or len({one.site for one in made}) >= MOST_SITES:
            continue
        left = data.value.copy()
        for one, x in zip(found.fit.model.causes, found.fit.values, strict=True):
            if one is not cause and one.name != stand:
                left -= one.curve(x, data)
        attitude = cause or _attitude_of(name, data)
        if attitude is not None:
            made += _regions(attitude, site, left, found, data)
    return made


def over_attitudes(found: JointFit, solutions: Sequence[AttitudeSolution]) -> JointFit:
    """With intervals of attitudes that reach over all regions: a fit lies in one of them, the truth in any."""
    made = []
    for one in found.causes:
        own = [each for each in solutions if one.cause.name == f"attitude of {each.site}"]
        if own:
            first = np.array([(each.turn_range_deg[0], each.tilt_range_deg[0]) for each in own]).min(axis=0)
            last = np.array([(each.turn_range_deg[1], each.tilt_range_deg[1]) for each in own]).max(axis=0)
            first, last = np.maximum(first, one.cause.low), np.minimum(last, one.cause.high)
            one = replace(
                one, low=np.minimum(one.low, first), high=np.maximum(one.high, last),
                given_low=np.minimum(one.given_low, first), given_high=np.maximum(one.given_high, last),
            )  # fmt: skip
        made.append(one)
    return replace(found, causes=tuple(made))


def _attitude_of(name: str, data: Differences) -> Cause | None:
    return next((one for one in causes(data) if one.name == f"attitude of {name}"), None)


def _regions(cause: Cause, site: int, left: F64, found: JointFit, data: Differences) -> list[AttitudeSolution]:
    """Connected regions of a grid. A cell counts where the region passes through it anywhere."""
    turns = np.arange(-MOST_TURN_DEG, MOST_TURN_DEG + 0.5 * STEP_DEG, STEP_DEG)
    here = data.site == site
    passes = np.unique(data.passes[here])
    variance = data.sd**2 + found.scatter.value**2
    first = [int(np.flatnonzero(here & (data.passes == p))[0]) for p in passes]
    curves = np.array([[cause.curve(np.array([a, b]), data)[first] for b in turns] for a in turns])
    misfit = np.zeros(curves.shape[:2])
    for k, p in enumerate(passes.tolist()):
        own = here & (data.passes == p)
        weight = 1.0 / variance[own]
        mean = float((weight * left[own]).sum() / weight.sum())
        error = 1.0 / weight.sum() + found.scatter.image**2 / own.sum()
        slopes = np.gradient(curves[..., k], STEP_DEG)
        within = (0.5 * STEP_DEG * (np.abs(slopes[0]) + np.abs(slopes[1]))) ** 2
        misfit += (curves[..., k] - mean) ** 2 / (error + within)
    inside = misfit <= LARGEST + max(float(misfit.min()), 0.0)
    parts, count = label(inside, np.ones((3, 3)))
    made = []
    for part in range(1, count + 1):
        rows, columns = np.nonzero(parts == part)
        best = int(misfit[rows, columns].argmin())
        near = int((turns[rows] ** 2 + turns[columns] ** 2).argmin())
        half = 0.5 * STEP_DEG
        made.append(
            AttitudeSolution(
                data.names[site], float(turns[rows[best]]), float(turns[columns[best]]),
                (float(turns[rows].min()) - half, float(turns[rows].max()) + half),
                (float(turns[columns].min()) - half, float(turns[columns].max()) + half),
                (float(turns[rows[near]]), float(turns[columns[near]])), len(passes),
            )
        )  # fmt: skip
    return sorted(made, key=lambda one: float(np.hypot(*one.least_deg)))


def attitude_words(solutions: Sequence[AttitudeSolution]) -> list[str]:
    """A sentence for each reflector."""
    words = []
    for name in dict.fromkeys(one.site for one in solutions):
        own = [one for one in solutions if one.site == name]
        listed = "; ".join(
            f"turn {one.turn_range_deg[0]:.1f} to {one.turn_range_deg[1]:.1f}, tilt {one.tilt_range_deg[0]:.1f} to "
            f"{one.tilt_range_deg[1]:.1f} deg (nearest to the survey: {one.least_deg[0]:.0f}, {one.least_deg[1]:.0f})"
            for one in own
        )
        seen = "1 pass" if own[0].passes == 1 else f"{own[0].passes} passes"
        fit = "1 region of attitudes fits" if len(own) == 1 else f"{len(own)} regions of attitudes fit"
        words.append(f"{name}, seen from {seen}: {fit}: {listed}.")
    return words
