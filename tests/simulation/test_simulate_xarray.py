"""Simulated views through xarray: dimensions, coordinates, units, and back from NetCDF and Zarr."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from test_cli_simulate import MESH, SCENE
from worlds import ground, mesh_of, scene_of, view

import warpsar
from warpsar.cli.main import main
from warpsar.runtime import extra
from warpsar.simulation.formats import netcdf, zarr
from warpsar.simulation.view import SimulatedView

xarray = pytest.importorskip("xarray", reason="xarray comes with the extra `xarray`")


def views(**radar: float) -> list[SimulatedView]:
    scene = scene_of(
        mesh_of(soil=ground(30)),
        [view(0, 40, name="north"), view(90, 50, name="east")],
        polarizations=("HH", "VV"),
        shape=(30, 44),
        rays_per_pixel=4.0,
        **radar,
    )
    return warpsar.simulate(scene, device="cpu", layers=True, variance=True)


def test_a_view() -> None:
    image = views()[0]
    data = image.to_xarray()
    assert data.beta0.dims == ("range", "azimuth", "polarization")
    assert dict(data.sizes) == {"azimuth": 44, "range": 30, "polarization": 2}
    for polarization, beta0 in image.beta0.items():
        np.testing.assert_array_equal(data.beta0.sel(polarization=polarization), beta0)
        np.testing.assert_array_equal(
            data.sampling_variance.sel(polarization=polarization), image.sampling_variance[polarization]
        )
    np.testing.assert_array_equal(data.incidence_deg, image.layers["incidence_deg"])
    assert data.beta0.units == "1"
    assert data.incidence_deg.units == "degree"
    for axis, values in (("azimuth", image.azimuth_m), ("range", image.range_m)):
        np.testing.assert_array_equal(data[axis], values)
        assert data[axis].units == "m"
    assert (data.azimuth_deg, data.attrs["incidence_deg"], data.frequency_hz) == (0, 40, 9.6e9)
    np.testing.assert_allclose(data.range_axis, [0, -np.sin(np.deg2rad(40)), -np.cos(np.deg2rad(40))], atol=1e-12)
    assert data.attrs["Conventions"].startswith("CF-")
    assert "slant_range" not in data.coords


def test_a_strip_map_has_its_slant_range() -> None:
    data = views(slant_range_m=350.0)[0].to_xarray()
    np.testing.assert_allclose(data.slant_range, 350 + data.range)
    assert data.slant_range.units == "m"


@pytest.mark.parametrize("kind", ["netcdf", "zarr"])
def test_round_trip(kind: str, tmp_path: Path) -> None:
    """Values, names, coordinates and attributes come back; a second writing takes the place of the first."""
    write, path = (netcdf.write, tmp_path / "a.nc") if kind == "netcdf" else (zarr.write, tmp_path / "a.zarr")
    first, second = views()
    for image in (first, second):
        write(path, image)
        found = xarray.load_dataset(path, engine="h5netcdf") if kind == "netcdf" else xarray.open_zarr(path).load()
        expected = image.to_xarray()
        xarray.testing.assert_identical(found.drop_attrs(), expected.drop_attrs())
        assert found.beta0.attrs == expected.beta0.attrs
        assert set(found.attrs) == set(expected.attrs)
        for name, value in expected.attrs.items():
            np.testing.assert_array_equal(found.attrs[name], value)
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_all_views_are_one_data_set() -> None:
    images = views()
    data = warpsar.to_xarray(images)
    assert data.beta0.dims == ("view", "range", "azimuth", "polarization")
    assert list(data.view.values) == ["north", "east"]
    for image in images:
        one = data.sel(view=image.name)
        np.testing.assert_array_equal(one.beta0.sel(polarization="VV"), image.beta0["VV"])
        np.testing.assert_allclose(one.range_axis, image.metadata["range_axis"])
        assert one.azimuth_deg == image.metadata["azimuth_deg"]
    assert data.frequency_hz == 9.6e9
    assert data.beta0.units == "1"
    with pytest.raises(warpsar.InputError, match="found no views"):
        warpsar.to_xarray([])


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "scene.obj").write_text(MESH)
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path / "scene.toml"


def simulate(scene: Path, *arguments: str) -> tuple[int, str]:
    out = scene.parent / "out"
    done = CliRunner().invoke(main, ["simulate", str(scene), "-o", str(out), "--device", "cpu", *arguments])
    return done.exit_code, done.output


@pytest.mark.full
def test_formats_of_the_command(scene: Path) -> None:
    out = scene.parent / "out"
    assert simulate(scene, "--format", "netcdf", "--format", "zarr", "--format", "exr", "--looks", "3")[0] == 0
    said = json.loads((out / "simulate.json").read_text())["views"][0]["files"]
    assert said == {
        "quick_look": "north.png",
        "image": "north.nc",
        "image_zarr": "north.zarr",
        "image_exr": "north.exr",
        "speckled_quick_look": "north_looks3.png",
        "speckled": "north_looks3.nc",
        "speckled_zarr": "north_looks3.zarr",
        "speckled_exr": "north_looks3.exr",
    }
    for name in said.values():
        assert (out / name).exists()
    clean, noisy = (xarray.load_dataset(out / said[key], engine="h5netcdf") for key in ("image", "speckled"))
    assert (noisy.looks, noisy.speckle_seed) == (3, 3)
    assert (clean.beta0 != noisy.beta0).any()


@pytest.mark.full
def test_only_what_is_asked_for(scene: Path) -> None:
    out = scene.parent / "out"
    assert simulate(scene, "--format", "netcdf", "--layers")[0] == 0
    assert {each.name for each in out.iterdir()} == {"north.nc", "north.png", "east.nc", "east.png", "simulate.json"}
    assert "layover" in xarray.load_dataset(out / "north.nc", engine="h5netcdf")


@pytest.mark.full
def test_declared_images_are_exr(scene: Path) -> None:
    """A scene file names images that `warpsar` reads."""
    assert simulate(scene, "--format", "netcdf", "--looks", "3", "--declare")[0] == 0
    assert len(warpsar.Scene.load(scene.parent / "out" / "scene.toml").views[0].images) == 2


def test_a_missing_library_is_one_message_before_any_work(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extra, "find_spec", lambda name: None)
    status, said = simulate(scene, "--format", "zarr")
    assert status == 2
    assert 'Error: --format zarr: needs xarray: pip install "warpsar[xarray]"' in said
    assert not (scene.parent / "out").exists()
    image = views()[0]
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(warpsar.InputError, match=r"warpsar\[xarray\]"):
        image.to_xarray()
