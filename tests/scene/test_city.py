"""`warpsar new` for buildings of a real place: GeoJSON and CityGML, on level ground and on an elevation model."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from warpsar.cli.main import main
from warpsar.errors import InputError
from warpsar.io.images import read_channel
from warpsar.scene.city import mesh_of
from warpsar.scene.scene import Scene
from warpsar.world.mesh import Mesh

pytest.importorskip("rasterio")
pytest.importorskip("shapely")

LATITUDE, LONGITUDE = 48.0, 11.0
E2 = 0.00669437999014
"""First eccentricity of WGS 84, squared."""
_W = math.sqrt(1.0 - E2 * math.sin(math.radians(LATITUDE)) ** 2)
EAST_M = math.radians(1.0) * 6378137.0 / _W * math.cos(math.radians(LATITUDE))
NORTH_M = math.radians(1.0) * 6378137.0 * (1.0 - E2) / _W**3
"""Metres of a degree of longitude and of latitude, from the ellipsoid's radii of curvature."""


def box(east: float, north: float, half: float) -> list[list[float]]:
    """A square about a place, in degrees of `LATITUDE`, from metres."""
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    return [[LONGITUDE + (east + x * half) / EAST_M, LATITUDE + (north + y * half) / NORTH_M] for x, y in corners]


def feature(*rings: list[list[float]], **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": list(rings)}}


def geojson(path: Path, *features: dict[str, Any]) -> Path:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features)}))
    return path


@pytest.fixture
def town(tmp_path: Path) -> Path:
    """A block with a court of 10 m, 12 m high; a house of two storeys; a shed that says nothing."""
    return geojson(
        tmp_path / "town.geojson",
        feature(box(-40, 0, 10), box(-40, 0, 5), height="12 m"),
        feature(box(40, 0, 6), **{"building:levels": "2"}),
        feature(box(0, 20, 3)),
        {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [LONGITUDE, LATITUDE]}},
    )


def areas(mesh: Mesh, name: str) -> float:
    p = mesh.vertices[mesh.faces[mesh.face_material == mesh.materials.index(name)]]
    return float(np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum() / 2.0)


def heights(mesh: Mesh, name: str) -> np.ndarray:
    return mesh.vertices[np.unique(mesh.faces[mesh.face_material == mesh.materials.index(name)])][:, 2]


def test_outlines_become_walls_and_roofs(town: Path) -> None:
    """Areas as laid out, to 1e-4; the plane about the origin bends by less over 100 m."""
    mesh, origin = mesh_of(town, None)
    assert mesh.materials == ("ground", "walls", "roofs")
    assert areas(mesh, "roofs") == pytest.approx(400 - 100 + 144 + 36, rel=1e-4)
    walls = (80 + 40) * 12.5 + 48 * 6.5 + 24 * 6.5  # half a metre of each is in the ground
    assert areas(mesh, "walls") == pytest.approx(walls, rel=1e-4)
    assert sorted(set(heights(mesh, "roofs").round(6))) == [6.0, 12.0]
    assert (heights(mesh, "ground") == 0).all()
    # the middle of all outlines: from -50 to 46 m east, from -10 to 23 m north
    assert (origin.longitude_deg - LONGITUDE) * EAST_M == pytest.approx(-2.0, abs=0.01)
    assert (origin.latitude_deg - LATITUDE) * NORTH_M == pytest.approx(6.5, abs=0.01)


def dem(path: Path, slope: float = 0.1, size: int = 60, hole: bool = False) -> Path:
    """A plane that rises to the east, 500 m high in the middle, in pixels of 5 m of UTM zone 32."""
    import rasterio
    from rasterio.warp import transform

    ((x,), (y,)) = transform("EPSG:4326", "EPSG:32632", [LONGITUDE], [LATITUDE])
    columns = (np.arange(size) - size / 2 + 0.5) * 5.0
    z = np.tile(500.0 + slope * columns, (size, 1)).astype(np.float32)
    if hole:
        z[size // 2, size // 2] = -9999.0
    place = rasterio.Affine(5.0, 0.0, x - 2.5 * size, 0.0, -5.0, y + 2.5 * size)
    how = {"driver": "GTiff", "height": size, "width": size, "count": 1, "dtype": "float32", "crs": "EPSG:32632"}
    with rasterio.open(path, "w", transform=place, nodata=-9999.0, **how) as target:
        target.write(z, 1)
    return path


def test_buildings_stand_on_the_elevation_model(town: Path, tmp_path: Path) -> None:
    """Ground and roofs follow the plane. UTM is turned by 1.5 degrees here and scaled by 4e-4: 2 cm at these slopes."""
    mesh, origin = mesh_of(town, dem(tmp_path / "dem.tif"))
    assert origin.height_m == pytest.approx(500.0 - 0.1 * 2.0, abs=0.02)  # two metres west of its middle
    at = mesh.vertices[np.unique(mesh.faces[mesh.face_material == 0])]
    np.testing.assert_allclose(at[:, 2], 0.1 * at[:, 0], atol=0.2)
    found = np.unique(heights(mesh, "roofs").round(3))
    expected = sorted((12.0 + 0.1 * (-40 + 2), 6.0 + 0.1 * (40 + 2), 6.0 + 0.1 * 2))
    np.testing.assert_allclose(np.sort(found), expected, atol=0.1)
    # no wall ends above the ground
    walls = mesh.vertices[np.unique(mesh.faces[mesh.face_material == 1])]
    feet = walls[walls[:, 2] < 0.1 * walls[:, 0] + 1.0]
    assert (feet[:, 2] < 0.1 * feet[:, 0] + 0.1).all()


HOUSE = """<?xml version="1.0"?>
<core:CityModel xmlns:core="http://www.opengis.net/citygml/2.0" xmlns:gml="http://www.opengis.net/gml"
 xmlns:bldg="http://www.opengis.net/citygml/building/2.0">
<gml:boundedBy><gml:Envelope srsName="urn:ogc:def:crs,crs:EPSG::25832,crs:EPSG::5783" srsDimension="3"/></gml:boundedBy>
<core:cityObjectMember><bldg:Building>{body}</bldg:Building></core:cityObjectMember>
</core:CityModel>
"""
_X, _Y = 691000.0, 5335000.0


def polygon(*corners: tuple[float, float, float]) -> str:
    ring = [*corners, corners[0]]
    text = " ".join(f"{_X + x} {_Y + y} {520 + z}" for x, y, z in ring)
    return (
        "<gml:Polygon><gml:exterior><gml:LinearRing><gml:posList>"
        f"{text}</gml:posList></gml:LinearRing></gml:exterior></gml:Polygon>"
    )


def surface(kind: str, *corners: tuple[float, float, float]) -> str:
    inner = f"<bldg:lod2MultiSurface><gml:MultiSurface><gml:surfaceMember>{polygon(*corners)}"
    inner += "</gml:surfaceMember></gml:MultiSurface></bldg:lod2MultiSurface>"
    return f"<bldg:boundedBy><bldg:{kind}>{inner}</bldg:{kind}></bldg:boundedBy>"


def gable(path: Path) -> Path:
    """10 x 8 m, eaves at 5 m, a ridge at 8 m along x."""
    body = surface("GroundSurface", (0, 0, 0), (0, 8, 0), (10, 8, 0), (10, 0, 0))
    body += surface("WallSurface", (0, 0, 0), (10, 0, 0), (10, 0, 5), (0, 0, 5))
    body += surface("WallSurface", (10, 8, 0), (0, 8, 0), (0, 8, 5), (10, 8, 5))
    body += surface("WallSurface", (10, 0, 0), (10, 8, 0), (10, 8, 5), (10, 4, 8), (10, 0, 5))
    body += surface("WallSurface", (0, 8, 0), (0, 0, 0), (0, 0, 5), (0, 4, 8), (0, 8, 5))
    body += surface("RoofSurface", (0, 0, 5), (10, 0, 5), (10, 4, 8), (0, 4, 8))
    body += surface("RoofSurface", (10, 8, 5), (0, 8, 5), (0, 4, 8), (10, 4, 8))
    path.write_text(HOUSE.format(body=body))
    return path


def cube(path: Path) -> Path:
    """LoD1: a solid of 10 x 8 x 5 m without kinds."""
    corners = [(0, 0), (10, 0), (10, 8), (0, 8)]
    faces = [[(x, y, 5) for x, y in corners], [(x, y, 0) for x, y in reversed(corners)]]
    for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
        faces.append([(*a, 0), (*b, 0), (*b, 5), (*a, 5)])
    shells = "".join(f"<gml:surfaceMember>{polygon(*face)}</gml:surfaceMember>" for face in faces)
    body = f"<bldg:lod1Solid><gml:Solid><gml:exterior><gml:CompositeSurface>{shells}"
    body += "</gml:CompositeSurface></gml:exterior></gml:Solid></bldg:lod1Solid>"
    path.write_text(HOUSE.format(body=body))
    return path


def test_citygml_of_both_levels(tmp_path: Path) -> None:
    """Areas of walls and roofs; UTM's scale there is within 4e-4 of 1, so areas within 1e-3."""
    mesh, origin = mesh_of(gable(tmp_path / "house.gml"), None)
    assert areas(mesh, "roofs") == pytest.approx(2 * 10 * 5, rel=1e-3)
    assert areas(mesh, "walls") == pytest.approx(2 * 10 * 5 + 2 * (8 * 5 + 8 * 3 / 2), rel=1e-3)
    assert heights(mesh, "roofs").max() == pytest.approx(8.0)
    assert heights(mesh, "walls").min() == 0.0
    assert (origin.latitude_deg, origin.longitude_deg) == pytest.approx((48.14, 11.57), abs=0.05)  # Munich
    solid, _ = mesh_of(cube(tmp_path / "cube.gml"), None)
    assert areas(solid, "roofs") == pytest.approx(80.0, rel=1e-3)  # the underside is left out
    assert areas(solid, "walls") == pytest.approx(36 * 5, rel=1e-3)


def run(*arguments: object, status: int = 0) -> str:
    done = CliRunner().invoke(main, [str(each) for each in arguments])
    assert done.exit_code == status, done.output
    return done.output


@pytest.mark.full
def test_the_new_scene_simulates_as_it_is(town: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    said = run("new", out, town, "--dem", dem(tmp_path / "dem.tif"))
    assert "3 buildings; 1 without a height are 6 m high" in said
    run(
        "simulate",
        out / "scene.toml",
        "-o",
        out / "images",
        "--device",
        "cpu",
        "--format",
        "geotiff",
        "--format",
        "exr",
    )
    scene = Scene.load(out / "scene.toml")
    assert {name: one.library for name, one in scene.materials.items()} == {
        "ground": "grass",
        "walls": "brick",
        "roofs": "roof_tiles",
    }
    assert scene.origin is not None
    assert (out / "images" / "az020_ground.tif").is_file()
    assert read_channel(out / "images" / "az020.exr").max() > 0


@pytest.mark.parametrize("make", [gable, cube])
def test_citygml_becomes_the_scene_that_outlines_become(
    make: Callable[[Path], Path], town: Path, tmp_path: Path
) -> None:
    """Bounces, the noise and response of the sensor, and surfaces of the library, as for GeoJSON."""
    source = make(tmp_path / "house.gml")
    texts = []
    for number, buildings in enumerate((source, town)):
        folder = tmp_path / f"{number}"
        run("new", folder, buildings, "--sensor", "terrasar-x")
        texts.append(Scene.load(folder / "scene.toml"))
    house, outlines = texts
    assert {name: one.library for name, one in house.materials.items()} == {
        "ground": "grass",
        "walls": "brick",
        "roofs": "roof_tiles",
    }
    assert house.materials == outlines.materials
    assert {"multibounce", "noise_floor", "point_spread"} <= set(house.effects)
    assert house.effects == outlines.effects


@pytest.mark.full
def test_citygml_becomes_an_image_with_bounces_and_noise(tmp_path: Path) -> None:
    """What the wall that faces the radar and the ground send back together is in the image, and noise everywhere."""
    out = tmp_path / "images"
    run("new", tmp_path / "house", gable(tmp_path / "house.gml"), "--sensor", "terrasar-x")
    run("simulate", tmp_path / "house" / "scene.toml", "-o", out, "--device", "cpu", "--layers")
    image = read_channel(out / "az020.exr")
    layers = read_channel(out / "az020_layers.exr", "beta0_2_bounces_HH")
    assert image.min() > 0.0  # the noise, in shadows and beyond the mesh
    assert layers.sum() > 0.0


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.geojson", "{", "cannot be read as GeoJSON"),
        ("a.geojson", "[]", "cannot be read as GeoJSON"),
        ("a.geojson", '{"type": "FeatureCollection", "features": []}', "found no building"),
        (
            "a.geojson",
            '{"type": "FeatureCollection", "features": [], "crs": {"properties": {"name": "here"}}}',
            "'here'",
        ),
        ("a.gml", "<a>", "cannot be read as CityGML"),
        ("a.gml", "<!DOCTYPE a><a/>", "a document type or an entity"),
        ("a.gml", "<a/>", "found no srsName"),
        ("a.gml", '<a srsName="EPSG:25832"/>', "found no building"),
    ],
)
def test_broken_files_are_refused(name: str, text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=said):
        mesh_of(tmp_path / name, None)


def test_a_ring_of_two_numbers_a_corner_is_refused(tmp_path: Path) -> None:
    path = cube(tmp_path / "a.gml")
    path.write_text(path.read_text().replace(" 525", "", 1))
    with pytest.raises(InputError, match="must be three for each corner"):
        mesh_of(path, None)


def test_an_elevation_model_must_reach(town: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not reach under all buildings"):
        mesh_of(town, dem(tmp_path / "small.tif", size=20))
    with pytest.raises(InputError, match="pixels without a height"):
        mesh_of(town, dem(tmp_path / "hole.tif", hole=True))


def test_options_that_do_not_fit_are_refused(town: Path, tmp_path: Path) -> None:
    plate = tmp_path / "plate.obj"
    plate.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    model = dem(tmp_path / "dem.tif")
    assert "--dem: found" in run("new", tmp_path / "a", plate, "--dem", model, status=2)
    assert "--units: found cm" in run("new", tmp_path / "b", town, "--units", "cm", status=2)
