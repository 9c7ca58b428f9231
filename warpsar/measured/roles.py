"""Which of many views are learned from, and which are held back as test views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from warpsar.errors import InputError
from warpsar.world.tables import View

Sector = tuple[float, float]


def inside(azimuth_deg: float, sector: Sector) -> bool:
    """Whether an azimuth lies in the sector that runs clockwise from its first to its second azimuth [deg]."""
    low, high = sector
    return (azimuth_deg - low) % 360.0 <= (high - low) % 360.0


def assigned(
    table: Path,
    views: Mapping[str, View],
    given: Sequence[str],
    *,
    role: str | None = None,
    train: int | None = None,
    held_back: Sequence[Sector] = (),
) -> dict[str, View]:
    """The views of a table with roles for those that are `given` and state none.

    All of them have the `role`, if there is one. Views in a sector that is held back are test views. Of the others,
    `train` views spread evenly in the order of their azimuth are train views, and the rest are test views. Raises
    InputError where there are fewer than `train`.
    """
    free = [name for name in given if "role" not in views[name].model_fields_set]
    back = {name for name in free if any(inside(views[name].azimuth_deg, one) for one in held_back)}
    roles = dict.fromkeys(free, role) if role is not None else {}
    roles |= dict.fromkeys(back, "test")
    if train is not None:
        open_to_all = sorted(set(free) - back, key=lambda name: (views[name].azimuth_deg % 360.0, name))
        if len(open_to_all) < train:
            raise InputError(
                f"{table}: --train {train}: found {len(open_to_all)} views that are not held back and state no role; "
                f"must be {train} or more"
            )
        chosen = {open_to_all[int(k)] for k in np.linspace(0, len(open_to_all), train, endpoint=False)}
        roles |= {name: "train" if name in chosen else "test" for name in open_to_all}
    found = dict(views)
    for name, one in roles.items():
        if one is not None:
            stated = views[name].model_dump(by_alias=True, exclude_unset=True)
            found[name] = View.model_validate({**stated, "role": one})
    return found
