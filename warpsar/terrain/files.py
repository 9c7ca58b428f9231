"""Layers in files: GeoTIFF, NetCDF and Zarr with attributes by the CF conventions 1.11."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from warpsar.errors import InputError
from warpsar.io.bands import bands_of, release
from warpsar.io.geotiff import AffinePlace, write_cog
from warpsar.io.images import replacing
from warpsar.runtime.extra import Extra
from warpsar.terrain.elevation import Elevation
from warpsar.terrain.layers import Layer, of_image, of_map
from warpsar.terrain.result import SimulatedProduct
from warpsar.version import __version__

if TYPE_CHECKING:
    import xarray

FORMATS = ("geotiff", "netcdf", "zarr")
EXTRAS = {
    "netcdf": Extra("xarray", ("xarray", "h5netcdf")),
    "zarr": Extra("xarray", ("xarray", "zarr")),
}
CHUNK = 512
"""Lines and pixels of a piece of NetCDF and Zarr."""
PLACE = ("longitude", "latitude", "height")
UNITS = {"metre": "m", "US survey foot": "US_survey_foot", "foot": "international_foot"}
"""Of maps: as coordinate systems and as UDUNITS name them."""


def facts(found: SimulatedProduct) -> dict[str, Any]:
    """What every file says of the product."""
    product = found.product
    return {
        "product": Path(product.source).name,
        "platform": product.platform,
        "acquired": str(product.date(product.grid.middle_s)),
        "polarization": product.polarization or "unknown",
        "frequency_hz": product.frequency_hz,
        "look_side": product.side,
        "elevation_model": found.elevation.path.name,
        "vertical_datum": found.elevation.datum.words,
        "first_line": found.window.lines[0],
        "first_pixel": found.window.pixels[0],
        "surface": found.scenery.surfaces[0],
        "surfaces": " ".join(found.scenery.surfaces),
        "landcover": "none" if found.scenery.landcover is None else found.scenery.landcover.path.name,
        "buildings": "none" if found.scenery.buildings is None else found.scenery.buildings.path.name,
        "pixels": found.pixels,
        "software": f"warpsar {__version__}",
    }


def refuse_askew(elevation: Elevation, what: str) -> None:
    """Raise InputError for a map that has no axes along which places could be told."""
    if AffinePlace(elevation.crs, elevation.affine).askew:
        raise InputError(
            f"{elevation.path}: found rows askew to the axes of its coordinate system; must run along them for {what}; "
            "warp it (gdalwarp does), or take --format geotiff"
        )


def writers(found: SimulatedProduct, out: Path, file_format: str) -> dict[str, Callable[[], None]]:
    """What writes the layers in one format, by the names of the files in `out`; they may run side by side."""
    if file_format == "geotiff":
        image = {name: values for name, values in found.image.items() if name not in PLACE}
        place = {name: found.image[name] for name in PLACE}
        axes = "rows: lines of the product from first_line on; columns: its pixels from first_pixel on"
        attrs = {**facts(found), "axes": axes}
        tags = {**attrs, **_units(image, False)}, {**attrs, **_units(place, False)}
        on_map = {**facts(found), **_units(found.map, True)}
        return {
            "image.tif": partial(write_cog, out / "image.tif", image, tags[0]),
            "image_place.tif": partial(write_cog, out / "image_place.tif", place, tags[1], kind="float64"),
            "map.tif": partial(write_cog, out / "map.tif", found.map, on_map, found.map_place),
        }
    sets = {"image": image_dataset(found), "map": map_dataset(found)}
    if file_format == "netcdf":
        return {f"{name}.nc": partial(write_netcdf, out / f"{name}.nc", data) for name, data in sets.items()}
    return {f"{name}.zarr": partial(write_zarr, out / f"{name}.zarr", data) for name, data in sets.items()}


def write_netcdf(path: Path, data: xarray.Dataset) -> None:
    """Axes and attributes by xarray; layers by bands, which xarray cannot write without Dask."""
    with replacing(path) as temporary:
        layers = _layers(data)
        data.drop_vars(layers).to_netcdf(temporary, engine="h5netcdf")

        import h5netcdf

        with h5netcdf.File(temporary, "a") as file:
            for name, attrs in layers.items():
                one = data[name]
                chunks = tuple(min(CHUNK, n) for n in one.shape)
                variable = file.create_variable(
                    name, one.dims, one.dtype, fillvalue=one.dtype.type(np.nan), chunks=chunks, compression="gzip",
                    compression_opts=4,
                )  # fmt: skip
                variable.attrs.update(attrs)
                _fill(variable, one.data)


def _layers(data: xarray.Dataset) -> dict[str, dict[str, Any]]:
    """Attributes of all variables over two axes, by name, as xarray would write them."""
    names = [str(name) for name in data.variables if data[name].ndim == 2]
    beside = " ".join(str(name) for name in data.coords if data[name].ndim == 2)
    return {
        name: {**data[name].attrs, **({"coordinates": beside} if beside and name not in data.coords else {})}
        for name in names
    }


def _fill(into: Any, values: np.ndarray) -> None:
    for rows in bands_of(values.shape, CHUNK):
        into[rows] = values[rows]
        release(values)


def _units(bands: dict[str, np.ndarray], on_map: bool) -> dict[str, str]:
    layers = [of_map(name) if on_map else of_image(name) for name in bands]
    return {f"band_{one.name}": f"{one.words} [{one.unit}]" for one in layers}


def write_zarr(path: Path, data: xarray.Dataset) -> None:
    """A folder, which takes the place of one that was there when it is whole."""
    temporary = path.with_name(f".{uuid4().hex}{path.suffix}")
    try:
        layers = _layers(data)
        data.drop_vars(layers).to_zarr(temporary, mode="w", zarr_format=2, consolidated=False)

        import zarr

        group = zarr.open_group(temporary, mode="a", zarr_format=2)
        for name, attrs in layers.items():
            one = data[name]
            listed = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in attrs.items()}
            array = group.create_array(
                name, shape=one.shape, dtype=one.dtype, chunks=tuple(min(CHUNK, n) for n in one.shape),
                fill_value=float("nan"), attributes={**listed, "_ARRAY_DIMENSIONS": [str(each) for each in one.dims]},
            )  # fmt: skip
            _fill(array, one.data)
        zarr.consolidate_metadata(temporary, zarr_format=2)
        if path.exists():
            shutil.rmtree(path)
        os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def image_dataset(found: SimulatedProduct) -> xarray.Dataset:
    """Layers on the product's grid, along `line` and `pixel`; longitude and latitude are coordinates."""
    EXTRAS["netcdf"].require("image_dataset:")

    variables = {name: _variable(("line", "pixel"), values, of_image(name)) for name, values in found.image.items()}
    if "cover" in variables:
        surfaces = found.scenery.surfaces
        flags = {"flag_values": np.arange(len(surfaces), dtype=np.float32), "flag_meanings": " ".join(surfaces)}
        variables["cover"] = (*variables["cover"][:2], {**variables["cover"][2], **flags})
    places = {name: variables.pop(name) for name in ("longitude", "latitude")}
    axes = {
        name: ((name,), np.arange(*ends), {"long_name": f"{name} of the product, from 0", "units": "1"})
        for name, ends in (("line", found.window.lines), ("pixel", found.window.pixels))
    }
    return _dataset(variables, {**axes, **places}, "product's grid", found)


def map_dataset(found: SimulatedProduct) -> xarray.Dataset:
    """Layers on the map, along `y` and `x`, with a grid mapping `spatial_ref` as CF and rioxarray know it."""
    EXTRAS["netcdf"].require("map_dataset:")
    refuse_askew(found.elevation, "map_dataset")

    place = found.map_place
    rows, columns = next(iter(found.map.values())).shape
    variables: dict[str, Any] = {}
    for name, values in found.map.items():
        dimensions, array, attrs = _variable(("y", "x"), values, of_map(name))
        variables[name] = dimensions, array, {**attrs, "grid_mapping": "spatial_ref"}
    affine = place.affine
    words = " ".join(f"{each:.17g}" for each in affine.to_gdal())
    variables["spatial_ref"] = (), np.int32(0), {**_grid_mapping(place.crs), "GeoTransform": words}
    geographic = place.crs.is_geographic
    kinds = (
        ("x", columns, affine.a, affine.c, "longitude" if geographic else "projection_x_coordinate"),
        ("y", rows, affine.e, affine.f, "latitude" if geographic else "projection_y_coordinate"),
    )
    if geographic:
        unit = {"x": "degree_east", "y": "degree_north"}
    else:
        name, metres = place.crs.linear_units_factor
        unit = dict.fromkeys("xy", UNITS.get(name, f"{metres:.17g} m"))
    axes = {
        name: ((name,), start + step * (np.arange(count) + 0.5), {"standard_name": kind, "units": unit[name]})
        for name, count, step, start, kind in kinds
    }
    return _dataset(variables, axes, "map", found)


def _dataset(
    variables: dict[str, Any], coordinates: dict[str, Any], where: str, found: SimulatedProduct
) -> xarray.Dataset:
    import xarray

    attrs = facts(found)
    now = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
    made = xarray.Dataset(
        variables,
        coordinates,
        {
            "Conventions": "CF-1.11",
            "title": f"Simulated twin of {attrs['product']}, on the {where}",
            "history": f"{now} {attrs['software']}: twin of {attrs['product']} over {attrs['elevation_model']}",
            **attrs,
        },
    )
    for name in set(coordinates) & set(made.dims):
        made[name].encoding["_FillValue"] = None  # CF allows none on axes, and xarray would write NaN
    return made


def _grid_mapping(crs: Any) -> dict[str, Any]:
    """A coordinate system by appendix F of CF; by `crs_wkt` alone where that has no such projection."""
    import pyproj

    wkt = crs.to_wkt()
    attrs = pyproj.CRS.from_wkt(wkt).to_2d().to_cf() if crs else {}
    return {**{key: value for key, value in attrs.items() if value != "unknown"}, "crs_wkt": wkt}


def _variable(dimensions: tuple[str, str], values: np.ndarray, layer: Layer) -> tuple[Any, np.ndarray, dict[str, Any]]:
    attrs = {"long_name": layer.words, "units": layer.unit}
    if layer.standard_name is not None:
        attrs["standard_name"] = layer.standard_name
    return dimensions, values, attrs
