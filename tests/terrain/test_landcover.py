"""Land cover becomes surfaces of the library, pixel by pixel; tables and rasters are checked at the door."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from product_files import SITE
from terrain_files import COVER_M, EAST_M, NORTH_M, dem, flat, landcover, product

import warpsar
from warpsar.errors import InputError
from warpsar.terrain.landcover import CORINE, WORLDCOVER, table_of
from warpsar.world.library.surfaces import SURFACES


def test_each_class_has_the_level_of_its_surface(tmp_path: Path) -> None:
    """West of the site water, east of it grassland: each pixel off the border has beta0 of a ground of that alone.

    The border lies between cells of 8 m, and not between posts of 20 m: it is right to a pixel (3.2 m on the ground).
    """
    safe, model = product(tmp_path), dem(tmp_path, flat(31))
    classes = np.full((90, 90), 30, np.uint8)
    classes[:, :43] = 80  # two cells west of the middle
    options: dict = {"geoid_offset_m": 0.0, "device": "cpu"}
    found = warpsar.twin(safe, model, landcover=landcover(tmp_path, classes), **options)
    assert found.scenery.surfaces == ("grass", "water_calm")
    east = (found.image["longitude"] - SITE[1]) * EAST_M + 2.0 * COVER_M
    for surface, side in (("grass", east > 4.0), ("water_calm", east < -4.0)):
        alone = warpsar.twin(safe, model, surface=surface, **options)
        assert side.sum() > 500
        np.testing.assert_allclose(found.image["beta0"][side], alone.image["beta0"][side], rtol=1e-4)
        assert (found.image["cover"][side] == found.scenery.surfaces.index(surface)).all()


def test_where_the_raster_says_nothing_lies_the_default(tmp_path: Path) -> None:
    """A raster of 20 cells (160 m) about the site, with a hole of no data in its middle."""
    classes = np.full((20, 20), 3, np.int16)
    classes[8:12, 8:12] = -1
    table = tmp_path / "own.toml"
    table.write_text('[surfaces]\n3 = "asphalt"\n')
    found = warpsar.twin(
        product(tmp_path), dem(tmp_path, flat(31)), geoid_offset_m=0.0, device="cpu", surface="soil_wet",
        landcover=landcover(tmp_path, classes, nodata=-1), landcover_table=str(table),
    )  # fmt: skip
    assert found.scenery.surfaces == ("soil_wet", "asphalt")
    east = (found.image["longitude"] - SITE[1]) * EAST_M
    north = (found.image["latitude"] - SITE[0]) * NORTH_M
    far = np.maximum(np.abs(east), np.abs(north))
    cover = found.image["cover"]
    assert (cover[far < 14.0] == 0).all()
    assert (cover[(far > 18.0) & (far < 78.0)] == 1).all()
    assert (cover[far > 82.0] == 0).all()
    assert min((far < 14.0).sum(), (far > 82.0).sum()) > 10


def test_tables_name_surfaces_that_exist() -> None:
    """WorldCover has 11 classes (Zanaga et al. 2022); CORINE's nomenclature 44, the raster's 1 to 44 in that order."""
    assert sorted(WORLDCOVER) == [10, 20, 30, 40, 50, 60, 70, 80, 90, 95, 100]
    three = sorted(code for code in CORINE if code > 44)
    assert (len(three), three[0], three[-1]) == (44, 111, 523)
    assert [CORINE[k] for k in range(1, 45)] == [CORINE[code] for code in three]
    assert set(WORLDCOVER.values()) | set(CORINE.values()) <= set(SURFACES)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[surfaces]\n10 = "gras"\n', "must be one of .*grass"),
        ('[surfaces]\ntrees = "grass"\n', "must be a whole number"),
        ('[classes]\n10 = "grass"\n', r"must hold one table \[surfaces\]"),
        ("10 = \n", "cannot be read as TOML"),
    ],
)
def test_a_bad_table_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=f"own.toml: .*{said}"):
        table_of(str(path))


def test_a_bad_raster_is_refused(tmp_path: Path) -> None:
    def refused(classes: np.ndarray, said: str, **more: str) -> None:
        with pytest.raises(InputError, match=said):
            warpsar.twin(
                product_path, model, geoid_offset_m=0.0, landcover=landcover(tmp_path, classes), device="cpu", **more
            )

    product_path, model = product(tmp_path), dem(tmp_path, flat(9))
    refused(np.full((9, 9), 77, np.uint8), r"cover.tif: found the classes 77; the table knows 10, .*corine")
    refused(np.full((9, 9), 10.0, np.float32), "must be one band of whole numbers")
    refused(np.zeros((9, 9), np.uint8), "found no class")
    refused(
        np.full((9, 9), 10, np.uint8), "--landcover-table: found 'worldcove'.*worldcover", landcover_table="worldcove"
    )


def test_a_raster_of_elsewhere_is_refused(tmp_path: Path) -> None:
    """Its classes would say nothing, and the report would name a land cover that is not there."""
    import rasterio
    from rasterio.transform import from_origin

    path = tmp_path / "elsewhere.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=9, height=9, count=1, dtype="uint8", crs="EPSG:4326",
        transform=from_origin(100.0, 10.0, 0.001, 0.001),
    ) as file:  # fmt: skip
        file.write(np.full((9, 9), 10, np.uint8), 1)
    with pytest.raises(InputError, match=r"elsewhere.tif: it holds no place of .*dem.tif; must overlap"):
        warpsar.twin(product(tmp_path), dem(tmp_path, flat(9)), landcover=path, geoid_offset_m=0.0, device="cpu")
