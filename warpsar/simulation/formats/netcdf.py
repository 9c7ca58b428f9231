"""NetCDF-4, through xarray and h5netcdf."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from warpsar.io.images import replacing
from warpsar.runtime.extra import Extra
from warpsar.simulation.ground import MapGround
from warpsar.simulation.image_format import ImageFormat, Parts
from warpsar.simulation.view import SimulatedView


def parts(view: SimulatedView, name: str, ground: MapGround | None) -> Parts:
    yield "", f"{name}.nc", partial(write, view=view)


def write(path: Path, view: SimulatedView) -> None:
    """NetCDF-4, deflated, through h5netcdf; whole or not at all."""
    data = view.to_xarray()
    packed = {name: {"zlib": True, "complevel": 4} for name in data.data_vars}
    with replacing(path) as temporary:
        data.to_netcdf(temporary, engine="h5netcdf", encoding=packed)


FORMAT = ImageFormat(
    "netcdf",
    "NetCDF",
    "`<view>.nc`: NetCDF-4, layers and sampling variance inside",
    "xarray, Panoply, MATLAB",
    parts,
    Extra("xarray", ("xarray", "h5netcdf")),
)
