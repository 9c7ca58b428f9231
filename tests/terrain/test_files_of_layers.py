"""Layers over lines and pixels, and over a map, through NetCDF and Zarr."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from warpsar.terrain import files

xarray = pytest.importorskip("xarray", reason="xarray comes with the extra `xarray`")
pytestmark = pytest.mark.unit


@pytest.mark.parametrize("kind", ["netcdf", "zarr"])
def test_layers_come_back(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Values to the bit, with what is missing; axes, places and attributes. A second file takes the first one's place,
    and layers are written piece by piece."""
    pytest.importorskip("h5netcdf" if kind == "netcdf" else "zarr")
    monkeypatch.setattr(files, "CHUNK", 3)
    random = np.random.default_rng(1)
    path = tmp_path / f"image.{kind}"
    write = files.write_netcdf if kind == "netcdf" else files.write_zarr
    for _ in range(2):
        beta0 = random.random((5, 7), np.float32)
        beta0[1, 2] = np.nan
        flags = random.integers(0, 9, (5, 7)).astype(np.float32)
        expected = xarray.Dataset(
            {
                "beta0": (("line", "pixel"), beta0, {"units": "1", "long_name": "beta0"}),
                "surfaces": (("line", "pixel"), flags, {"flag_values": np.arange(9.0), "flag_meanings": "a b"}),
            },
            {
                "line": ("line", np.arange(10, 15), {"units": "1"}),
                "pixel": ("pixel", np.arange(20, 27)),
                "latitude": (("line", "pixel"), random.random((5, 7)), {"units": "degrees_north"}),
            },
            {"title": "layers", "pixels": 3},
        )
        write(path, expected)
        found = xarray.load_dataset(path, engine="h5netcdf") if kind == "netcdf" else xarray.open_zarr(path).load()
        xarray.testing.assert_identical(found.drop_attrs(), expected.drop_attrs())
        assert found.attrs == expected.attrs
        for name, one in expected.variables.items():
            assert found[name].attrs.keys() == one.attrs.keys(), name
            for key, value in one.attrs.items():
                np.testing.assert_array_equal(found[name].attrs[key], value)
    assert [each.name for each in tmp_path.iterdir()] == [path.name]
