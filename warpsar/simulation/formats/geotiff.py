"""Cloud-optimized GeoTIFF, in slant range and, where the scene says where it lies, on the ground."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from warpsar.io.geotiff import write_cog
from warpsar.runtime.extra import Extra
from warpsar.simulation.ground import MapGround
from warpsar.simulation.image_format import ImageFormat, Parts
from warpsar.simulation.view import SimulatedView


def parts(view: SimulatedView, name: str, ground: MapGround | None) -> Parts:
    yield "", f"{name}.tif", partial(write_cog, bands=view.beta0, tags=view.metadata)
    if extra := view.channels():
        yield "layers_geotiff", f"{name}_layers.tif", partial(write_cog, bands=extra, tags=view.metadata)
    if ground is not None:
        yield "ground", f"{name}_ground.tif", partial(_write_ground, view=view, ground=ground)


def _write_ground(path: Path, view: SimulatedView, ground: MapGround) -> None:
    named = next(each for each in ground.scene.views if each.name == view.name)
    bands, place = ground.project(named, view.beta0)
    axes = "north up; slant range along range_axis and azimuth along azimuth_axis are projected onto the mesh"
    write_cog(path, bands, {**view.metadata, "axes": axes}, place)


FORMAT = ImageFormat(
    "geotiff",
    "GeoTIFF",
    "`<view>.tif` in slant range, `<view>_layers.tif`, and [on the ground](#on-the-ground) `<view>_ground.tif`",
    "QGIS, ArcGIS, GDAL, rasterio",
    parts,
    Extra("geo", ("rasterio",)),
    on_ground=True,
)
