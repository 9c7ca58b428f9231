"""What `warpsar twin` refuses, in one line that names the file, what was found and what is allowed."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from click.testing import CliRunner
from terrain_files import dem, flat, product

from warpsar.cli.main import main


def refused(folder: Path, safe: Path, model: Path, *words: object, out: Path | None = None) -> str:
    """The one line on stderr; nothing is written."""
    out = folder / "out" if out is None else out
    before = sorted(folder.rglob("*"))
    done = CliRunner().invoke(
        main, ["twin", *map(str, (safe, "--dem", model, "-o", out, *words)), "--device", "cpu"]
    )  # fmt: skip
    assert done.exit_code == 2, done.output
    assert sorted(folder.rglob("*")) == before
    (line,) = [one for one in done.stderr.splitlines() if not one.startswith("device:")]
    return line


def changed(safe: Path, pattern: str, new: str) -> Path:
    (annotation,) = (safe / "annotation").glob("*.xml")
    text, count = re.subn(pattern, new, annotation.read_text(), count=1, flags=re.DOTALL)
    assert count == 1
    annotation.write_text(text)
    return safe


@pytest.mark.parametrize("unit", ["ft", "cm", "US survey foot"])
def test_heights_in_another_unit(tmp_path: Path, unit: str) -> None:
    import rasterio

    model = dem(tmp_path, flat(9))
    with rasterio.open(model, "r+") as file:
        file.units = [unit]
    line = refused(tmp_path, product(tmp_path), model, "--geoid-offset", 0)
    assert line == f"Error: {model}: found heights in {unit!r}, by its band; must be metres ('m')"


def test_heights_without_a_place(tmp_path: Path) -> None:
    """GDAL gives a file without a geotransform squares of one degree at 0, 0: ground all over the image."""
    import rasterio

    model = tmp_path / "dem.tif"
    with rasterio.open(
        model, "w", driver="GTiff", width=60, height=60, count=1, dtype="float32", crs="EPSG:4326"
    ) as file:
        file.write(flat(60).astype("float32"), 1)
    line = refused(tmp_path, product(tmp_path), model, "--geoid-offset", 0)
    assert line == f"Error: {model}: found no place of its heights (no geotransform); must have one"


def test_rows_askew_have_no_axes_for_netcdf(tmp_path: Path) -> None:
    """GeoTIFF says such a place, so nothing is refused there."""
    import rasterio

    pytest.importorskip("h5netcdf")
    pytest.importorskip("xarray")
    model = dem(tmp_path, flat(9))
    with rasterio.open(model, "r+") as file:
        file.transform = file.transform * file.transform.rotation(20.0)
    safe = product(tmp_path)
    line = refused(tmp_path, safe, model, "--geoid-offset", 0, "--format", "netcdf")
    assert line == (
        f"Error: {model}: found rows askew to the axes of its coordinate system; must run along them for --format "
        "netcdf; warp it (gdalwarp does), or take --format geotiff"
    )
    done = CliRunner().invoke(
        main,
        ["twin", *map(str, (safe, "--dem", model, "--geoid-offset", 0, "-o", tmp_path / "out", "--device", "cpu"))],
    )
    assert done.exit_code == 0, done.output


def test_an_orbit_that_ends_before_the_image(tmp_path: Path) -> None:
    safe = changed(
        product(tmp_path), r"(<orbitList[^>]*>(?:\s*<orbit>.*?</orbit>){2}).*</orbitList>", r"\1</orbitList>"
    )
    line = refused(tmp_path, safe, dem(tmp_path, flat(9)), "--geoid-offset", 0)
    assert re.fullmatch(
        r"Error: \S+\.xml: found state vectors of the orbit from \S+ to \S+; must reach over the image, from \S+ to "
        r"\S+ UTC", line,
    )  # fmt: skip


@pytest.mark.parametrize("count", ["0", "-5"])
def test_an_image_without_lines(tmp_path: Path, count: str) -> None:
    (annotation,) = product(tmp_path).glob("annotation/*.xml")
    safe = changed(annotation.parents[1], r"<numberOfLines>\d+", f"<numberOfLines>{count}")
    for one in (safe / "measurement").iterdir():
        one.unlink()
    line = refused(tmp_path, safe, dem(tmp_path, flat(9)), "--geoid-offset", 0)
    assert line == f"Error: {annotation}: number of lines: found {count}; must be 1 or more"


def test_a_table_without_land_cover(tmp_path: Path) -> None:
    words = ("--geoid-offset", 0, "--landcover-table", "corine")
    line = refused(tmp_path, product(tmp_path), dem(tmp_path, flat(9)), *words)
    assert line == "Error: --landcover-table: found 'corine' without --landcover; state that, too"


def test_a_file_of_no_known_format(tmp_path: Path) -> None:
    path = tmp_path / "station.json"
    path.write_text("{}")
    line = refused(tmp_path, path, dem(tmp_path, flat(9)), "--geoid-offset", 0)
    assert "choose one with --product-format: " in line


@pytest.mark.measured
def test_several_polarizations_in_one_file(measured_data: Path, tmp_path: Path) -> None:
    path = measured_data / "alos_polcal" / "calib_RSLC_ALPSRP025826990_RIO_BRANCO_CR.h5"
    line = refused(tmp_path, path, dem(tmp_path, flat(9)), "--geoid-offset", 0)
    assert line == f"Error: {path}: found images of the polarizations HH, HV, VH, VV; state one by --polarization"


@pytest.mark.skipif(os.name == "nt", reason="no /dev/null")
def test_what_cannot_be_written_is_said_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from warpsar.terrain import command

    def late(*words: object, **more: object) -> None:
        raise AssertionError("the work had begun")

    monkeypatch.setattr(command, "twin", late)
    out = Path(os.devnull) / "out"
    line = refused(tmp_path, product(tmp_path), dem(tmp_path, flat(9)), "--geoid-offset", 0, out=out)
    assert line == (
        f"Error: --out: found {out}; nothing can be written to {os.devnull}; allowed is a folder, there or new, that "
        "can be written to"
    )


def test_a_crop_over_the_edge_is_said(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = [product(tmp_path), "--dem", dem(tmp_path, flat(31)), "--geoid-offset", 0, "-o", out]
    words += ["--crop", 12.0, 46.0, 12.1, 46.1, "--device", "cpu"]
    done = CliRunner().invoke(main, ["twin", *map(str, words)])
    assert done.exit_code == 0, done.output
    said = r"warning: --crop: \S+ holds \S+ % of it, and reaches from longitude .*; that part is simulated"
    assert re.search(said, done.stderr)
