"""Zarr, through xarray."""

from __future__ import annotations

import os
import shutil
from functools import partial
from pathlib import Path
from uuid import uuid4

from warpsar.runtime.extra import Extra
from warpsar.simulation.ground import MapGround
from warpsar.simulation.image_format import ImageFormat, Parts
from warpsar.simulation.view import SimulatedView


def parts(view: SimulatedView, name: str, ground: MapGround | None) -> Parts:
    yield "", f"{name}.zarr", partial(write, view=view)


def write(path: Path, view: SimulatedView) -> None:
    """A Zarr store: a folder, which takes the place of one that was there when it is whole."""
    temporary = path.with_name(f".{uuid4().hex}{path.suffix}")
    try:
        # version 2 of the format: version 3 has no specification for texts, such as the polarizations
        view.to_xarray().to_zarr(temporary, mode="w", zarr_format=2, consolidated=True)
        if path.exists():
            shutil.rmtree(path)
        os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


FORMAT = ImageFormat(
    "zarr",
    "Zarr",
    "`<view>.zarr`: the same as a Zarr store (version 2)",
    "xarray, dask",
    parts,
    Extra("xarray", ("xarray", "zarr")),
)
