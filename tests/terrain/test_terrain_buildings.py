"""Buildings on the ground, against closed forms: an upright box, its places, its layover, shadow and power."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from product_files import SITE, Band, nearest, place
from terrain_files import EAST_M, NORTH_M, dem, flat, product, town

import warpsar
from warpsar.errors import InputError
from warpsar.terrain.result import SimulatedProduct
from warpsar.terrain.scenery import surface_sigma0
from warpsar.world.earth import LocalEarth, geodetic_to_ecef

BOX = (10.0, -15.0, 80.0, 120.0, 40.0)
"""East and north of the site, sides along east and north, height [m]."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SimulatedProduct, SimulatedProduct]:
    """With the box and without it."""
    folder = tmp_path_factory.mktemp("box")
    safe, model = product(folder), dem(folder, flat(61))
    options: dict = {"geoid_offset_m": 0.0, "device": "cpu"}
    return warpsar.twin(safe, model, buildings=town(folder, BOX), **options), warpsar.twin(safe, model, **options)


def look() -> np.ndarray:
    """East, north, up: from the site to the radar, by the orbit in closed form."""
    time, _ = nearest(SITE)
    found = LocalEarth(*SITE).axes @ (place(time) - geodetic_to_ecef(np.array(SITE)))
    return found / np.linalg.norm(found)


def roof_corners() -> np.ndarray:
    """Lines and pixels by a minimum of distances, (4, 2)."""
    east, north, wide, deep, height = BOX
    start, near = Band(lines=64, pixels=256, centre=(31.5, 127.5)).start()
    found = []
    for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        where = SITE[0] + (north + y * deep / 2) / NORTH_M, SITE[1] + (east + x * wide / 2) / EAST_M, SITE[2] + height
        time, distance = nearest(where)
        found.append(((time - start) / 2.0e-3, (distance - near) / 2.5))
    return np.array(found)


def test_the_roof_lies_where_the_orbit_puts_it(made: tuple[SimulatedProduct, SimulatedProduct]) -> None:
    """Where nothing else lies over it, a pixel's middle shows the roof inside of its four corners, and only there."""
    import shapely

    found, _ = made
    roof = found.image["cover"] == found.scenery.surfaces.index("roof_tiles")
    outline = shapely.Polygon(roof_corners())
    lines, pixels = (np.arange(*ends) for ends in (found.window.lines, found.window.pixels))
    at = shapely.points(*np.meshgrid(lines, pixels, indexing="ij"))
    assert not roof[~shapely.contains(outline.buffer(0.05), at)].any()
    inside = shapely.contains(outline.buffer(-0.05), at)
    # 3 sin^2: ground and walls lie over the rest; the roof is brighter than both where the radar sees them
    assert roof[inside & (found.image["layover"] < 0.01)].all()
    assert (inside & (found.image["layover"] < 0.01)).sum() > 50
    heights = found.image["height"][roof]
    np.testing.assert_allclose(heights, SITE[2] + BOX[4], atol=0.01)


def test_power_and_areas_of_the_box(made: tuple[SimulatedProduct, SimulatedProduct]) -> None:
    """Sums over the image. The box hides its foot and throws a shadow of H tan(theta) times its width across the look;
    its roof and the walls that face the radar are lit. What is seen from the radar adds up to level ground's."""
    found, level = made
    _, _, wide, deep, height = BOX
    toward = look()
    cosine = toward[2]
    width = wide * abs(toward[1]) + deep * abs(toward[0])  # across the look, times sin(theta)
    shadow = height * width / cosine

    def total(one: SimulatedProduct, layer: str) -> float:
        return float(np.nansum(one.image[layer] * (one.image["area_beta"] if layer == "beta0" else 1.0)))

    walls = ((deep * height, abs(toward[0])), (wide * height, abs(toward[1])))
    area = sum(wall for wall, _ in walls) - shadow  # the roof is as large as the foot
    # A piece is lit as a whole or not at all: 44 m2 with an error of 1 / sqrt(12), of some 85 pieces along the borders
    # of foot and shadow; twice that.
    border = 2.0 * 44.0 * np.sqrt(85.0 / 12.0)
    assert total(found, "area_sigma") - total(level, "area_sigma") == pytest.approx(area, abs=border)
    assert total(found, "area_gamma") == pytest.approx(total(level, "area_gamma"), rel=2e-4)

    def sigma0(name: str, cos: float) -> float:
        table = surface_sigma0(name, found.product)
        return float(np.interp(np.degrees(np.arccos(cos)), np.linspace(0.0, 90.0, table.size), table))

    power = sigma0("roof_tiles", cosine) * wide * deep - sigma0("grass", cosine) * (wide * deep + shadow)
    power += sum(wall * sigma0("brick", cos) for wall, cos in walls)
    difference = total(found, "beta0") - total(level, "beta0")
    assert difference == pytest.approx(power, abs=border * sigma0("grass", cosine))


def test_layover_reaches_as_far_as_the_box_is_high(made: tuple[SimulatedProduct, SimulatedProduct]) -> None:
    """Along a line through its middle the pixels in layover are those between the nearest roof and the foot below."""
    found, _ = made
    toward = look()
    fold = BOX[4] * toward[2] / 2.5  # pixels, of an upright wall
    rows = slice(31 - found.window.lines[0], 33 - found.window.lines[0])
    layover = found.image["layover"][rows]
    assert layover.sum(axis=1) == pytest.approx([fold, fold], rel=0.02)


def test_citygml_is_the_same_as_an_outline(made: tuple[SimulatedProduct, SimulatedProduct], tmp_path: Path) -> None:
    """The box as a solid in UTM, with the heights of the ground and of its roof; the DEM's offset lifts both."""
    from rasterio.warp import transform

    outline, _ = made
    east, north, wide, deep, height = BOX
    ends = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2.0
    longitude = SITE[1] + (east + ends[:, 0] * wide) / EAST_M
    latitude = SITE[0] + (north + ends[:, 1] * deep) / NORTH_M
    flat_m = np.column_stack(transform("EPSG:4326", "EPSG:32633", longitude, latitude))
    low, high = (np.column_stack([flat_m, np.full(4, SITE[2] - 50.0 + up)]) for up in (0.0, height))
    sides = [np.stack([low[i], low[(i + 1) % 4], high[(i + 1) % 4], high[i]]) for i in range(4)]
    polygons = "".join(
        "<gml:surfaceMember><gml:Polygon><gml:exterior><gml:LinearRing><gml:posList>"
        + " ".join(f"{value:.4f}" for value in np.concatenate([ring, ring[:1]]).ravel())
        + "</gml:posList></gml:LinearRing></gml:exterior></gml:Polygon></gml:surfaceMember>"
        for ring in [high, low[::-1], *sides]
    )
    path = tmp_path / "box.gml"
    path.write_text(
        '<CityModel xmlns:gml="http://www.opengis.net/gml" xmlns:bldg="http://www.opengis.net/citygml/building/2.0">'
        '<gml:Envelope srsName="EPSG:32633"/><bldg:Building><bldg:lod1Solid><gml:Solid><gml:exterior>'
        f"<gml:CompositeSurface>{polygons}</gml:CompositeSurface></gml:exterior></gml:Solid></bldg:lod1Solid>"
        "</bldg:Building></CityModel>"
    )
    model = dem(tmp_path, flat(61) - 50.0)
    found = warpsar.twin(product(tmp_path), model, geoid_offset_m=50.0, device="cpu", buildings=path)
    for layer, least in (("area_gamma", 2e-3), ("beta0", 2e-3)):
        off = np.nansum(np.abs(found.image[layer] - outline.image[layer]))
        assert off < least * np.nansum(outline.image[layer])


def test_buildings_beyond_the_elevation_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    safe, model = product(tmp_path), dem(tmp_path, flat(15))
    options: dict = {"geoid_offset_m": 0.0, "device": "cpu"}
    both = town(tmp_path, (0.0, 0.0, 20.0, 20.0, 10.0), (400.0, 0.0, 20.0, 20.0, 10.0))
    found = warpsar.twin(safe, model, buildings=both, **options)
    assert found.scenery.buildings is not None
    assert found.scenery.buildings.count == 1
    assert "1 of 2 buildings reach beyond" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"town.geojson: none of its 1 buildings lies where"):
        warpsar.twin(safe, model, buildings=town(tmp_path, (400.0, 0.0, 20.0, 20.0, 10.0)), **options)
