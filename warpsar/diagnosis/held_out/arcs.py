"""Which train views are left out together: arcs of neighbours in azimuth, so that none is left out among its like; and
how sure a gain of these views is."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from warpsar.errors import InputError
from warpsar.world.tables import View

ARCS = 3  # of each fold


def by_azimuth(views: Sequence[View]) -> list[View]:
    return sorted(views, key=lambda view: (view.azimuth_deg % 360.0, view.name))


def arcs_of(views: int, count: int) -> int:
    """How many arcs so many views make in `count` parts."""
    return count * min(ARCS, views // count)


def folds(views: Sequence[View], count: int) -> list[list[str]]:
    """The names of the views in `count` parts, each of `ARCS` arcs of neighbours in azimuth, or of fewer where there
    are few views. Raises InputError for fewer views than two for each part."""
    if len(views) < 2 * count:
        raise InputError(f"--folds {count}: found {len(views)} train views; must be {2 * count} or more")
    parts = np.array_split([view.name for view in by_azimuth(views)], arcs_of(len(views), count))
    return [[str(name) for arc in parts[k::count] for name in arc] for k in range(count)]


def mean_and_error(gain: np.ndarray, arcs: int | None = None) -> tuple[float, float]:
    """Mean of the views' gains and its standard error over the views. With so many `arcs`, of views in order of
    azimuth, it is that over views or that over arcs, the larger: views of an arc look alike, and one fit has predicted
    them all, so that they may be wrong together."""
    arcs = arcs or gain.size
    groups = np.array_split(gain - gain.mean(), arcs)
    over_arcs = math.sqrt(sum(float(one.sum()) ** 2 for one in groups) * arcs / (arcs - 1)) / gain.size
    return float(gain.mean()), max(over_arcs, float(gain.std(ddof=1)) / math.sqrt(gain.size))


def over_draws(gains: Sequence[np.ndarray], arcs: int) -> tuple[float, float]:
    """The same of gains by several draws of rays: the scatter of their means adds to the error."""
    mean, error = mean_and_error(np.mean(gains, axis=0), arcs)
    if len(gains) > 1:
        error = math.hypot(error, float(np.std([one.mean() for one in gains], ddof=1)) / math.sqrt(len(gains)))
    return mean, error
