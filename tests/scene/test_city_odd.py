"""`warpsar new` for buildings as files in the wild hold them: feet, holes, axes in another order."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_city import EAST_M, LATITUDE, LONGITUDE, NORTH_M, areas, box, cube, feature, gable, geojson, heights

from warpsar.errors import InputError
from warpsar.scene.city import mesh_of
from warpsar.world.mesh import Mesh

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(
    ("said", "height_m"),
    [
        ("12.5 m", 12.5),
        ("12,5 m", 12.5),
        (12.5, 12.5),
        ("39'4\"", 11.989),
        ("39' 4\"", 11.989),
        ("40 ft", 12.192),
        ("40'", 12.192),
        ("-3", 6.0),
        (None, 6.0),
        ("tall", 6.0),
    ],
)
def test_heights_as_people_write_them(said: Any, height_m: float, tmp_path: Path) -> None:
    """Feet as OpenStreetMap's page on the key `height` has them; 6 m where nothing can be read."""
    mesh, _ = mesh_of(geojson(tmp_path / "a.geojson", feature(box(0, 0, 5), height=said)), None)
    assert heights(mesh, "roofs").max() == pytest.approx(height_m, abs=1e-3)


def test_every_kind_of_area_is_read(tmp_path: Path) -> None:
    """Two parts of a MultiPolygon, one of them with a court; a collection; corners with a height; none without area."""
    several = {"type": "MultiPolygon", "coordinates": [[box(0, 0, 5), box(0, 0, 2)], [box(30, 0, 5)]]}
    inside = {"type": "Polygon", "coordinates": [[[*corner, 500.0] for corner in box(60, 0, 5)]]}
    collection = {"type": "GeometryCollection", "geometries": [inside, {"type": "Point", "coordinates": [0, 0]}]}
    point = {"type": "Feature", "properties": None, "geometry": None}
    path = geojson(
        tmp_path / "a.geojson",
        {"type": "Feature", "properties": {"height": 9}, "geometry": several},
        {"type": "Feature", "properties": {"height": 9}, "geometry": collection},
        point,
    )
    mesh, _ = mesh_of(path, None)
    assert areas(mesh, "roofs") == pytest.approx(100 - 16 + 100 + 100, rel=1e-4)


def test_outlines_that_cross_themselves_are_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b, c, d, _ = box(30, 0, 5)
    path = geojson(tmp_path / "a.geojson", feature(box(0, 0, 5)), feature([a, c, b, d, a]), feature([a, a, a, a]))
    mesh, _ = mesh_of(path, None)
    assert areas(mesh, "walls") == pytest.approx(40 * 6.5, rel=1e-4)
    assert "2 outlines cross themselves or have no area, and are left out" in capsys.readouterr().err
    with pytest.raises(InputError, match="found 1 outlines that cross themselves"):
        mesh_of(geojson(tmp_path / "b.geojson", feature([a, c, b, d, a])), None)


def volume(mesh: Mesh) -> float:
    """Volume inside walls and roofs, by the divergence theorem about a point below; positive if they look out."""
    owner = [mesh.materials.index(name) for name in ("walls", "roofs")]
    p = mesh.vertices[mesh.faces[np.isin(mesh.face_material, owner)]] - (0.0, 0.0, mesh.vertices[:, 2].min())
    return float(np.einsum("ij,ij->i", p[:, 0], np.cross(p[:, 1], p[:, 2])).sum() / 6.0)


@pytest.mark.parametrize("turned", [1, -1])
def test_faces_look_outward(turned: int, tmp_path: Path) -> None:
    """Whatever the order of an outline, and for both levels of CityGML."""
    path = geojson(tmp_path / "a.geojson", feature(box(0, 0, 10)[::turned], box(0, 0, 5)[::turned], height=6))
    assert volume(mesh_of(path, None)[0]) == pytest.approx((400 - 100) * 6.5, rel=1e-3)
    assert volume(mesh_of(cube(tmp_path / "cube.gml"), None)[0]) == pytest.approx(10 * 8 * 5, rel=2e-3)
    assert volume(mesh_of(gable(tmp_path / "gable.gml"), None)[0]) == pytest.approx(10 * 8 * (5 + 3 / 2), rel=2e-3)


@pytest.mark.parametrize(
    "ring",
    [[[151.2, -33.8], [151.3, -33.8], [151.3, -33.7]], [[690000.0, 5330000.0], [690020.0, 5330000.0], [1.0, 2.0]]],
)
def test_what_is_no_longitude_and_latitude_is_refused(ring: list[list[float]], tmp_path: Path) -> None:
    """Latitude first, and metres without a name of their system."""
    ring = ring if ring[0][0] > 1000 else [corner[::-1] for corner in ring]
    with pytest.raises(InputError, match=r"must lie within 180 and 90 degrees.*longitude comes first"):
        mesh_of(geojson(tmp_path / "a.geojson", feature([*ring, ring[0]])), None)


def test_metres_with_a_name(tmp_path: Path) -> None:
    """The member `crs` of the GeoJSON of 2008: UTM zone 32, 20 x 20 m, with a scale of 4e-4."""
    ring = [[690000.0, 5330000.0], [690020.0, 5330000.0], [690020.0, 5330020.0], [690000.0, 5330020.0]]
    path = geojson(tmp_path / "a.geojson", feature([*ring, ring[0]]))
    content = json.loads(path.read_text())
    content["crs"] = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    path.write_text(json.dumps(content))
    assert areas(mesh_of(path, None)[0], "roofs") == pytest.approx(400.0, rel=2e-3)


def rewritten(path: Path, system: str, place: Any) -> Path:
    """The same CityGML with every corner (x, y) [m] about its first replaced by `place(x, y)`."""
    text = cube(path).read_text().replace("urn:ogc:def:crs,crs:EPSG::25832,crs:EPSG::5783", system)
    head, *rings = text.split("<gml:posList>")
    for at, ring in enumerate(rings):
        corners, rest = ring.split("</gml:posList>")
        moved = [
            "{:.10f} {:.10f} {}".format(*place(float(x) - 691000.0, float(y) - 5335000.0), z)
            for x, y, z in zip(*[iter(corners.split())] * 3, strict=True)
        ]
        rings[at] = " ".join(moved) + "</gml:posList>" + rest
    path.write_text("<gml:posList>".join([head, *rings]))
    return path


@pytest.mark.parametrize("code", ["4979", "6697"])
def test_citygml_in_degrees_has_latitude_first(code: str, tmp_path: Path) -> None:
    """As EPSG defines both systems; Japan's PLATEAU is in 6697."""
    path = rewritten(
        tmp_path / "a.gml",
        f"http://www.opengis.net/def/crs/EPSG/0/{code}",
        lambda x, y: (LATITUDE + y / NORTH_M, LONGITUDE + x / EAST_M),
    )
    mesh, origin = mesh_of(path, None)
    assert areas(mesh, "roofs") == pytest.approx(80.0, rel=1e-3)
    assert (origin.latitude_deg, origin.longitude_deg) == pytest.approx((LATITUDE, LONGITUDE), abs=1e-4)


def test_exchanged_axes_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """North before east in UTM lies far outside of the zone, where its metre is none."""
    system = "urn:ogc:def:crs:EPSG::25832"
    mesh_of(rewritten(tmp_path / "a.gml", system, lambda x, y: (691000.0 + x, 5335000.0 + y)), None)
    assert "are they exchanged?" not in capsys.readouterr().err
    mesh_of(rewritten(tmp_path / "b.gml", system, lambda x, y: (5335000.0 + y, 691000.0 + x)), None)
    assert "x was taken as east and y as north: are they exchanged?" in capsys.readouterr().err


def test_the_place_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exchanged axes that are still degrees show there."""
    mesh_of(geojson(tmp_path / "a.geojson", feature(box(0, 0, 5))), None)
    assert "about latitude 48.0000, longitude 11.0000" in capsys.readouterr().err
