"""`warpsar twin` from files to files."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from product_files import Band, write_safe
from terrain_files import dem, flat, product

from warpsar.cli.main import main


def run(*words: object) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["twin", *map(str, words)])
    return done.exit_code, done.output


@pytest.mark.full
def test_files_of_a_product_without_pixels(tmp_path: Path) -> None:
    import rasterio

    xarray = pytest.importorskip("xarray")
    h5py = pytest.importorskip("h5py")
    out = tmp_path / "out"
    safe, model = product(tmp_path), dem(tmp_path, flat(31))
    formats = [word for name in ("geotiff", "netcdf", "zarr") for word in ("--format", name)]
    code, said = run(safe, "--dem", model, "--geoid-offset", 0, "-o", out, *formats, "--device", "cpu")
    assert code == 0, said
    assert "all pixels of the product are zero there: layers only, no comparison" in said
    content = json.loads((out / "twin.json").read_text())
    assert sorted(content["files"]) == sorted(one.name for one in out.iterdir() if one.name != "twin.json")
    assert content["shares"]["shadow"] == 0.0
    assert content["layers"]["incidence"]["unit"] == "degree"
    assert "measured" not in content["layers"]
    lines, pixels = content["window"]["lines"], content["window"]["pixels"]
    with rasterio.open(out / "image.tif") as file:
        assert file.shape == (lines[1] - lines[0], pixels[1] - pixels[0])
        assert {"beta0", "sigma0", "gamma0", "noise", "layover", "shadow", "surfaces"} <= set(file.descriptions)
        beta0 = file.read(file.descriptions.index("beta0") + 1)
    with rasterio.open(out / "map.tif") as file:
        assert file.crs.to_epsg() == 4326
        at = ~file.transform * (12.0, 46.0)
        line = file.read(file.descriptions.index("line") + 1)[int(at[1]), int(at[0])]
        assert line == pytest.approx(31.5, abs=1.5)  # a cell is as large as a line and a half
    with xarray.open_dataset(out / "image.nc", engine="h5netcdf") as data:
        np.testing.assert_array_equal(data["beta0"].values, beta0)
        assert data["line"].values[0] == lines[0]
        assert data.attrs["Conventions"] == "CF-1.11"
        assert data["incidence"].attrs["units"] == "degree"
        assert set(data.coords) == {"line", "pixel", "latitude", "longitude"}
        power = data["noise"].values
        # noise 4 DN^2 x azimuth factor 1.5 over betaNought 200 squared
        np.testing.assert_allclose(power[np.isfinite(power)], 4.0 * 1.5 / 200.0**2, rtol=1e-5)
    with h5py.File(out / "map.nc") as file:  # CF: axes have no value for what is missing
        assert "_FillValue" not in file["x"].attrs
        assert "_FillValue" not in file["y"].attrs
    with xarray.open_zarr(out / "map.zarr") as data:
        assert data["spatial_ref"].attrs["grid_mapping_name"] == "latitude_longitude"
        assert data.attrs["title"].endswith("on the map")
        assert "warpsar" in data.attrs["history"]
        assert data["gamma0"].attrs["grid_mapping"] == "spatial_ref"
        assert "WGS" in data["spatial_ref"].attrs["crs_wkt"]
        assert data["x"].values[0] < data["x"].values[-1]
        assert data["y"].values[0] > data["y"].values[-1]
    report = (out / "report.html").read_text()
    assert "Places are those of orbit and annotation" in report
    assert "image.tif" in report
    assert "5.405 GHz" in report  # of Sentinel-1


@pytest.mark.full
def test_pixels_lie_on_the_same_grid(tmp_path: Path) -> None:
    """beta0 of a sample is |DN / betaNought|^2; flattened gamma0 leaves the noise out and divides by the lit area."""
    import rasterio

    image = np.full((64, 256), 0.5 + 0.5j, np.complex64)
    image[20, 100] = 3.0
    safe = write_safe(tmp_path, image, Band(lines=64, pixels=256, centre=(31.5, 127.5)))
    out = tmp_path / "out"
    code, said = run(safe, "--dem", dem(tmp_path, flat(61)), "--geoid-offset", 0, "-o", out, "--device", "cpu")
    assert code == 0, said
    window = json.loads((out / "twin.json").read_text())["window"]
    with rasterio.open(out / "image.tif") as file:
        found = dict(zip(file.descriptions, file.read(), strict=True))
    row, column = 20 - window["lines"][0], 100 - window["pixels"][0]
    assert found["measured"][row, column] == pytest.approx(9.0, rel=1e-3)
    assert found["measured"][row, column + 1] == pytest.approx(0.5, rel=1e-2)
    with rasterio.open(out / "map.tif") as file:
        mapped = dict(zip(file.descriptions, file.read(), strict=True))
    level = np.nanmedian(mapped["measured_gamma0"])
    ratio = np.nanmedian(found["area_beta"] / found["area_gamma"])
    assert level == pytest.approx((0.5 - 4.0 * 1.5 / 200.0**2) * ratio, rel=0.01)


@pytest.mark.parametrize(("units", "said"), [("m", "m"), ("us-ft", "US_survey_foot"), ("km", "1000 m")])
def test_axes_of_the_map_have_the_unit_of_its_coordinate_system(tmp_path: Path, units: str, said: str) -> None:
    """A transverse Mercator map of 61 x 61 posts of 20 m, with level ground."""
    import rasterio

    import warpsar
    from warpsar.terrain import map_dataset

    pytest.importorskip("xarray")
    step = 20.0 / {"m": 1.0, "us-ft": 1200.0 / 3937.0, "km": 1000.0}[units]
    path = tmp_path / "map.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=61, height=61, count=1, dtype="float32",
        crs=f"+proj=tmerc +lat_0=46 +lon_0=12 +datum=WGS84 +units={units}",
        transform=rasterio.transform.from_origin(-30.5 * step, 30.5 * step, step, step),
    ) as file:  # fmt: skip
        file.write(flat(61).astype(np.float32), 1)
    found = warpsar.twin(product(tmp_path), path, geoid_offset_m=0.0, device="cpu")
    data = map_dataset(found)
    assert data["x"].attrs["units"] == data["y"].attrs["units"] == said
    assert abs(float(data["x"].mean())) < step  # the site is in the middle
    assert abs(float(data["y"].mean())) < step


def test_a_zip_archive_must_be_unpacked(tmp_path: Path) -> None:
    archive = tmp_path / "scene.zip"
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("scene.SAFE/manifest.safe", "<xfdu:XFDU/>")
    code, output = run(archive, "--dem", dem(tmp_path, flat(9)), "--geoid-offset", 0, "-o", tmp_path / "out")
    assert code == 2
    assert "found a zip archive; unpack it" in output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--geoid-offset", "0", "--surface", "gras"), "--surface: found 'gras'"),
        ((), "does not say what its heights are above"),
        (("--geoid-offset", "0", "--crop", "40", "10", "41", "11"), "--crop: found 40 10 41 11"),
        (("--geoid-offset", "0", "--product-format", "mstar"), "must be one of"),
    ],
)
def test_a_refusal_leaves_nothing_behind(tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    out = tmp_path / "out"
    code, output = run(product(tmp_path), "--dem", dem(tmp_path, flat(9)), "-o", out, *words, "--device", "cpu")
    assert code == 2, output
    assert said in output
    assert not out.exists()
