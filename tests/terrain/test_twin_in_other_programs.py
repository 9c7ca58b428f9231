"""What docs/twin.md says under "In other programs": each piece of code there as it stands, on files of the command."""

from __future__ import annotations

import ast
import inspect
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from product_files import Band, write_safe
from terrain_files import dem, flat

from warpsar.cli.main import main

PAGE = Path(__file__).parents[2] / "docs" / "twin.md"


def code_with(word: str) -> str:
    """The one piece of Python of the page that holds a word."""
    (found,) = (each for each in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S) if word in each)
    return str(found)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that holds `twin/`, of a product whose samples have beta0 of 0.5."""
    pytest.importorskip("h5netcdf")
    path = tmp_path_factory.mktemp("page")
    image = np.full((64, 256), 0.5 + 0.5j, np.complex64)
    safe = write_safe(path, image, Band(lines=64, pixels=256, centre=(31.5, 127.5)))
    words = [safe, "--dem", dem(path, flat(61)), "--geoid-offset", 0, "-o", path / "twin", "--device", "cpu"]
    words += ["--format", "geotiff", "--format", "netcdf"]
    done = CliRunner().invoke(main, ["twin", *map(str, words)])
    assert done.exit_code == 0, done.output
    return path


@pytest.mark.full
def test_xarray(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The flattened level is that of the map, which takes the noise off as well."""
    xarray = pytest.importorskip("xarray")
    monkeypatch.chdir(folder)
    names: dict[str, object] = {}
    exec(code_with("open_dataset"), names)
    found = names["flat"]
    assert isinstance(found, xarray.DataArray)
    assert found.dims == ("line", "pixel")
    with xarray.open_dataset("twin/map.nc", engine="h5netcdf") as mapped:
        noise = 4.0 * 1.5 / 200.0**2  # of `write_safe`, as beta0
        level = float(mapped["measured_gamma0"].median()) * 0.5 / (0.5 - noise)
        assert float(found.median()) == pytest.approx(level, rel=0.01)
        assert mapped["spatial_ref"].attrs["crs_wkt"]


@pytest.mark.full
def test_qgis(folder: Path) -> None:
    """QGIS opens rasters by GDAL, as rasterio does: the map has a place, overviews or one tile, and bands by name."""
    import rasterio

    with rasterio.open(folder / "twin" / "map.tif") as file:
        assert file.driver == "GTiff"
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.crs.to_epsg() == 4326
        assert {"incidence", "shadow"} <= set(file.descriptions)
        tile = max(file.block_shapes[0])
        assert file.overviews(1) or max(file.shape) <= tile
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), rasterio.open(folder / "twin" / "image.tif") as file:
        assert file.crs is None


def test_sarsen_has_what_the_page_calls() -> None:
    """Each call of the page fits what sarsen's function takes."""
    sarsen = pytest.importorskip("sarsen", reason="sarsen is not installed: pip install sarsen")
    calls = [node for node in ast.walk(ast.parse(code_with("import sarsen"))) if isinstance(node, ast.Call)]
    assert len(calls) == 2
    for call in calls:
        assert isinstance(call.func, ast.Attribute)
        named = {str(each.arg): None for each in call.keywords}
        inspect.signature(getattr(sarsen, call.func.attr)).bind(*call.args, **named)


def _sum_of_areas(flat: np.ndarray, posts: int) -> np.ndarray:
    """Of a flattened image of constant beta0 the inverse is the area; means over so many cells along a side."""
    rows, columns = (posts * (n // posts) for n in flat.shape)
    parts = (1.0 / flat[:rows, :columns]).reshape(rows // posts, posts, columns // posts, posts)
    return np.asarray(np.nanmean(parts, axis=(1, 3)))


@pytest.mark.measured
@pytest.mark.full
def test_sarsen(measured_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's code on Sentinel-1's annotation over Rome, with pixels of one level: both flatten it alike."""
    pytest.importorskip("sarsen", reason="sarsen is not installed: pip install sarsen")
    import rasterio

    import warpsar

    folder = measured_data / "sentinel1_rome"
    code = code_with("import sarsen")
    (name,) = re.findall(r'"(\S+\.SAFE)"', code)
    shutil.copytree(next(folder.glob("S1B*.SAFE")), tmp_path / name)
    (annotation,) = (tmp_path / name / "annotation").glob("*.xml")
    (tmp_path / name / "measurement").mkdir()
    with rasterio.open(
        tmp_path / name / "measurement" / f"{annotation.stem}.tiff", "w", driver="GTiff", width=26102, height=16705,
        count=1, dtype="uint16", sparse_ok=True, tiled=True, compress="deflate",
    ) as file:  # fmt: skip
        file.write(np.full((2400, 2600), 300, np.uint16), 1, window=((7400, 9800), (20600, 23200)))
    part = (100, 260), (100, 260)  # sarsen needs 128 posts along a side
    with rasterio.open(folder / "Rome-30m-DEM.tif") as file:
        heights, place = file.read(1, window=part).astype(np.float32), file.window_transform(part)
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=160, height=160, count=1, dtype="float32", crs="EPSG:4326",
        transform=place,
    ) as file:  # fmt: skip
        file.write(heights + np.float32(48.6), 1)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    with rasterio.open("flat.tif") as file:
        assert file.crs.to_epsg() == 4326
        theirs = file.read(1)[::-1] if file.transform.e > 0.0 else file.read(1)
    found = warpsar.twin(tmp_path / name, tmp_path / "dem.tif", geoid_offset_m=0.0, device="cpu")
    ours = found.map["measured_gamma0"]
    fine = 3  # cells of the map along a post's
    assert found.map_place.affine.a == pytest.approx(place.a / fine)
    inner = slice(6, 146)
    first, second = _sum_of_areas(theirs[inner, inner], 10), _sum_of_areas(ours[18:438, 18:438], 10 * fine)
    # 4.8 % in sum: a line is 10.11 m long and sarsen takes the nominal 10 m; it leaves the noise in, 0.4 %; and sums
    # areas over 3 x 3 pixels
    assert first.mean() == pytest.approx(second.mean(), rel=0.06)
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.9
