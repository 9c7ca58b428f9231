"""Simulated views as one data set of xarray (extra `xarray`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from warpsar.errors import InputError
from warpsar.simulation.view import SimulatedView

if TYPE_CHECKING:
    import xarray


def to_xarray(views: Sequence[SimulatedView]) -> xarray.Dataset:
    """Views of one scene as one `xarray.Dataset`: as `SimulatedView.to_xarray`, along a first dimension `view`.

    Attributes that differ from view to view (`azimuth_deg`, `incidence_deg`, `range_axis`, ...) become coordinates of
    `view`; those of three numbers have the dimension `component` (east, north, up) besides. Raises InputError where
    xarray is missing, and for no views.
    """
    if not views:
        raise InputError("to_xarray: found no views; allowed is one or more")
    parts = [view.to_xarray() for view in views]
    import xarray

    whole = xarray.concat([part.drop_attrs(deep=False) for part in parts], dim="view", join="exact")
    attributes = {key: value for key, value in parts[0].attrs.items() if key != "view"}
    varying = {key for key in attributes if any(part.attrs.get(key) != attributes[key] for part in parts)}
    coordinates: dict[str, Any] = {"view": [view.name for view in views]}
    for key in sorted(varying):
        values = [part.attrs.get(key) for part in parts]
        coordinates[key] = (("view", "component"), values) if isinstance(attributes[key], list) else ("view", values)
    if any(isinstance(attributes[key], list) for key in varying):
        coordinates["component"] = ["east", "north", "up"]
    whole.attrs = {key: value for key, value in attributes.items() if key not in varying}
    return whole.assign_coords(coordinates)
