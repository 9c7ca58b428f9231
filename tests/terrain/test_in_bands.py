"""A twin that memory should not hold: layers in files, work by bands of rows. Nothing of the result depends on it."""

from __future__ import annotations

import json
import shutil
from collections import namedtuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from product_files import Band, write_safe
from terrain_files import dem, landcover

from warpsar.cli.main import main
from warpsar.io import bands, geotiff
from warpsar.terrain import memory

SHAPE = (192, 256)
FORMATS = [word for name in ("geotiff", "netcdf", "zarr") for word in ("--format", name)]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A product of speckle over hills and two kinds of land, so that something is compared and differs."""
    from scipy.ndimage import gaussian_filter

    folder = tmp_path_factory.mktemp("inputs")
    random = np.random.default_rng(3)
    rough = gaussian_filter(random.standard_normal((161, 161)), 5.0)
    image = np.exp(gaussian_filter(random.standard_normal(SHAPE), 20.0) * 20.0)
    image = image * (random.standard_normal(SHAPE) + 1j * random.standard_normal(SHAPE)) * 0.1
    safe = write_safe(
        folder, image.astype(np.complex64), Band(lines=SHAPE[0], pixels=SHAPE[1], centre=(95.5, 127.5)), noise=1.0
    )
    classes = np.full((400, 400), 30, np.uint8)
    classes[:, 200:] = 40
    return safe, dem(folder, 300.0 + 40.0 * rough / rough.std()), landcover(folder, classes)


def made(inputs: tuple[Path, Path, Path], out: Path) -> str:
    safe, model, cover = inputs
    words = [safe, "--dem", model, "--geoid-offset", 0, "--landcover", cover, *FORMATS, "-o", out, "--device", "cpu"]
    done = CliRunner().invoke(main, ["twin", *map(str, words)])
    assert done.exit_code == 0, done.output
    return done.output


def layers(out: Path) -> dict[str, np.ndarray]:
    import rasterio
    import xarray

    found: dict[str, np.ndarray] = {}
    for path in sorted(out.glob("*.tif")):
        with rasterio.open(path) as file:
            found |= {f"{path.name} {name}": file.read(i) for i, name in enumerate(file.descriptions, 1)}
            found |= {f"{path.name} overview": file.read(1, out_shape=(file.height // 2, file.width // 2))}
    for name in ("image", "map"):
        for data in (
            xarray.open_dataset(out / f"{name}.nc", engine="h5netcdf"),
            xarray.open_zarr(out / f"{name}.zarr"),
        ):
            with data:
                found |= {
                    f"{name} {kind}{each}": data[each].values
                    for kind in (data.encoding["source"][-4:],)
                    for each in data.variables
                }
    return found


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_one_band_or_many(inputs: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To the bit: every layer in every format, and what is said of them."""
    pytest.importorskip("zarr")
    pytest.importorskip("h5netcdf")
    one, many = tmp_path / "one", tmp_path / "many"
    made(inputs, one)
    monkeypatch.setattr(memory, "IN_MEMORY", 0)
    monkeypatch.setattr(geotiff, "IN_MEMORY", 0)
    monkeypatch.setattr(bands, "PIXELS", 2000)  # 7 rows; where cells are counted, so many that cells are whole
    said = made(inputs, many)
    assert "of disk for layers" in said
    held, banded = layers(one), layers(many)
    assert held.keys() == banded.keys()
    assert len(held) > 60
    for name, values in held.items():
        np.testing.assert_array_equal(values, banded[name], err_msg=name)
    told: list[dict[str, Any]] = [json.loads((each / "twin.json").read_text()) for each in (one, many)]
    assert told[0]["differences"]["found"]  # something is found, so that fits were made
    for key in ("layers", "shares", "words", "comparison", "differences", "window", "map_shape"):
        assert told[0][key] == told[1][key], key
    assert [each["forecast"]["disk_gib"] > 0.0 for each in told] == [False, True]
    # what was in files without a name leaves nothing behind
    assert sorted(each.name for each in many.iterdir()) == sorted([*told[1]["files"], "twin.json"])


def test_a_small_disk_is_refused(
    inputs: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    safe, model, _ = inputs
    monkeypatch.setattr(memory, "IN_MEMORY", 0)
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10, 9, 1))
    words = [safe, "--dem", model, "--geoid-offset", 0, "-o", tmp_path / "out", "--device", "cpu"]
    done = CliRunner().invoke(main, ["twin", *map(str, words)])
    assert done.exit_code == 2, done.output
    assert "GiB free; must be" in done.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("pixels", [50, 10**6])
def test_order_statistics(kind: type, pixels: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a sort of all numbers."""
    monkeypatch.setattr(bands, "PIXELS", pixels)
    random = np.random.default_rng(1)
    values = (10.0 ** random.uniform(-30, 30, (60, 70)) * random.choice([-1, 1], (60, 70))).astype(kind)
    values[random.random(values.shape) < 0.2] = np.nan
    values[:10] = 7.0  # many alike
    values[20, :3] = np.inf, -np.inf, 0.0
    for above in (False, True):
        known = values[np.isfinite(values)]
        known = np.sort(known[known > 0.0] if above else known)
        wanted = np.array([0, 1, known.size // 3, known.size // 2, known.size - 1])
        found = bands.order_statistics(values, lambda count, wanted=wanted: wanted, above_zero=above)
        np.testing.assert_array_equal(found, known[wanted])
    assert bands.median(values) == pytest.approx(np.median(values[np.isfinite(values)].astype(float)))
    assert np.isnan(bands.median(np.full((3, 4), np.nan, kind)))


def test_an_array_in_a_file_keeps_its_numbers(tmp_path: Path) -> None:
    """Its pages go, and come back when they are read; the file has no name."""
    made = bands.in_file((300, 400), np.float32, tmp_path)
    assert not list(tmp_path.iterdir())
    numbers = np.random.default_rng(0).random((300, 400)).astype(np.float32)
    made[...] = numbers
    part = made[10:20, 30:40]
    bands.release(part)
    np.testing.assert_array_equal(made, numbers)
    bands.release(numbers)  # no file: nothing happens
    np.testing.assert_array_equal(made, numbers)


@pytest.mark.parametrize("multiple", [1, 7, 5000])
def test_bands_are_whole_and_in_order(multiple: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bands, "PIXELS", 4000)
    found = list(bands.bands_of((101, 300), multiple))
    assert [row for band in found for row in range(band.start, band.stop)] == list(range(101))
    assert all((band.stop - band.start) % multiple == 0 for band in found[:-1])
