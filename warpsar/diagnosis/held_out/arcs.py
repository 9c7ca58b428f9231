"""Which train views are left out together: arcs of neighbours in azimuth, so that none is left out among its like."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpsar.errors import InputError
from warpsar.world.tables import View

ARCS = 3  # of each fold


def by_azimuth(views: Sequence[View]) -> list[View]:
    return sorted(views, key=lambda view: (view.azimuth_deg % 360.0, view.name))


def folds(views: Sequence[View], count: int) -> list[list[str]]:
    """The names of the views in `count` parts, each of `ARCS` arcs of neighbours in azimuth, or of fewer where there
    are few views. Raises InputError for fewer views than two for each part."""
    if len(views) < 2 * count:
        raise InputError(f"--folds {count}: found {len(views)} train views; must be {2 * count} or more")
    arcs = min(ARCS, len(views) // count)
    parts = np.array_split([view.name for view in by_azimuth(views)], count * arcs)
    return [[str(name) for arc in parts[k::count] for name in arc] for k in range(count)]
