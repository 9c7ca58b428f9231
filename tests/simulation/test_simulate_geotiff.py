"""GeoTIFF of `simulate`: in slant range with its geometry, and on the ground where it belongs."""

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from test_cli_simulate import MESH, SCENE
from worlds import BRICK, SOIL, axes, ground, join, mesh_of, plate, scene_of, view

from warpsar import __version__
from warpsar.cli.main import main
from warpsar.effects.registry import validate
from warpsar.errors import InputError
from warpsar.io import geotiff
from warpsar.io.geotiff import RasterPlace, write_cog
from warpsar.io.images import read_channel
from warpsar.runtime import extra
from warpsar.runtime.devices import resolve_device
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate as images_of
from warpsar.simulation.ground import MapGround
from warpsar.surface.stage import Stage
from warpsar.world.earth import LocalEarth as Earth
from warpsar.world.earth import ecef_to_geodetic
from warpsar.world.tables import Origin

rasterio = pytest.importorskip("rasterio", reason="rasterio comes with the extra `geo`")
from rasterio.warp import transform as project  # noqa: E402

MUNICH = Origin(latitude_deg=48.1486, longitude_deg=11.5683, height_m=515.0)
BRIGHT = {**SOIL, "eps_r": 40.0}


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "scene.obj").write_text(MESH)
    origin = "[scene]\norigin = { latitude_deg = 48.1486, longitude_deg = 11.5683, height_m = 515.0 }"
    (tmp_path / "scene.toml").write_text(SCENE.replace("[scene]", origin))
    return tmp_path / "scene.toml"


def simulate(scene: Path, *arguments: str) -> tuple[int, str]:
    out = scene.parent / "out"
    done = CliRunner().invoke(main, ["simulate", str(scene), "-o", str(out), "--device", "cpu", *arguments])
    return done.exit_code, done.output


def on_the_ground(scene: Scene) -> tuple[np.ndarray, RasterPlace]:
    """The first view's HH on the map."""
    shown = MapGround.of(scene, Stage.of(scene, resolve_device("cpu")))
    assert shown is not None
    bands, place = shown.project(scene.views[0], images_of(scene, device="cpu")[0].beta0)
    return bands["HH"], place


def pixel_of(place: RasterPlace, world_m: tuple[float, float, float], origin: Origin = MUNICH) -> tuple[float, float]:
    """Row and column on the map of a point of the world, by way of earth-centred coordinates."""
    earth = Earth(origin.latitude_deg, origin.longitude_deg, origin.height_m)
    latitude, longitude, _ = ecef_to_geodetic(earth.to_ecef(np.array(world_m)))
    (x,), (y,) = project("EPSG:4326", place.crs, [longitude], [latitude])
    return (place.top - y) / place.pixel, (x - place.left) / place.pixel


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_slant_range(scene: Path) -> None:
    """The values of the EXR, a band for each polarization, and the geometry in tags."""
    assert simulate(scene, "--format", "geotiff", "--format", "exr", "--layers")[0] == 0
    out = scene.parent / "out"
    with rasterio.open(out / "east.tif") as source:
        assert source.descriptions == ("HH", "VV")
        assert source.dtypes == ("float32", "float32")
        assert source.crs is None
        for band, polarization in enumerate(("HH", "VV"), start=1):
            np.testing.assert_array_equal(source.read(band), read_channel(out / "east.exr", polarization))
        tags = source.tags()
    assert (float(tags["azimuth_deg"]), float(tags["incidence_deg"]), float(tags["frequency_hz"])) == (90, 50, 9.6e9)
    assert json.loads(tags["spacing_m"]) == [0.5, 0.5]
    np.testing.assert_allclose(json.loads(tags["azimuth_axis"]), [0, -1, 0], atol=1e-12)
    assert json.loads(tags["polarizations"]) == ["HH", "VV"]
    assert (tags["quantity"], tags["units"], tags["scale"]) == ("beta0", "1", "linear power")
    assert tags["software"] == f"warpsar {__version__}"
    assert "sigma0" in tags["calibration"]
    with rasterio.open(out / "east_layers.tif") as source:
        assert "incidence_deg" in source.descriptions


@pytest.mark.full
def test_files_and_a_measured_image_of_ones_own(scene: Path) -> None:
    assert simulate(scene, "--format", "geotiff", "--looks", "2")[0] == 0
    said = json.loads((scene.parent / "out" / "simulate.json").read_text())["views"][0]
    assert said["files"] == {
        "quick_look": "north.png",
        "image": "north.tif",
        "ground": "north_ground.tif",
        "speckled_quick_look": "north_looks2.png",
        "speckled": "north_looks2.tif",
        "speckled_ground": "north_looks2_ground.tif",
    }
    assert said["origin_latitude_deg"] == 48.1486
    with rasterio.open(scene.parent / "out" / "north_looks2_ground.tif") as source:
        assert source.crs == rasterio.crs.CRS.from_epsg(32632)
        assert source.tags()["looks"] == "2.0"
        assert np.isnan(source.nodata)


def test_without_an_origin_there_is_no_ground(scene: Path) -> None:
    scene.write_text(SCENE)
    status, said = simulate(scene, "--format", "geotiff")
    assert status == 0
    assert "note: [scene] has no origin" in said
    assert not list((scene.parent / "out").glob("*_ground.tif"))


def test_is_cloud_optimized(tmp_path: Path) -> None:
    """Tiles, overviews that are means, and every directory before any pixel, the whole image's first."""
    image = np.random.default_rng(1).gamma(1.0, size=(1500, 1300)).astype(np.float32)
    place = RasterPlace(rasterio.crs.CRS.from_epsg(32632), 600000.0, 5400000.0, 0.5)
    write_cog(tmp_path / "a.tif", {"HH": image, "VV": 2 * image}, {"spacing_m": [0.5, 0.3]}, place)
    with rasterio.open(tmp_path / "a.tif") as source:
        assert source.block_shapes == [(512, 512)] * 2
        assert source.overviews(1) == [2, 4]
        assert source.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        np.testing.assert_array_equal(source.read(2), 2 * image)
        half = source.read(1, out_shape=(750, 650))
        assert source.transform == rasterio.transform.from_origin(600000.0, 5400000.0, 0.5, 0.5)
    np.testing.assert_allclose(half, image.reshape(750, 2, 650, 2).mean(axis=(1, 3)), rtol=1e-5)
    directories, pixels = ifds(tmp_path / "a.tif")
    assert len(directories) == 3
    assert directories == sorted(directories)
    assert directories[-1] < min(map(min, pixels))
    # the coarsest overview's pixels first, as a reader meets them
    assert [min(each) for each in pixels] == sorted((min(each) for each in pixels), reverse=True)


def test_a_raster_larger_than_memory_is_the_same_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = np.random.default_rng(1).gamma(1.0, size=(1100, 700)).astype(np.float32)
    write_cog(tmp_path / "memory.tif", {"HH": image, "VV": 2 * image}, {"a": 1})
    monkeypatch.setattr(geotiff, "IN_MEMORY", 0)
    write_cog(tmp_path / "file.tif", {"HH": image, "VV": 2 * image}, {"a": 1})
    assert sorted(each.name for each in tmp_path.iterdir()) == ["file.tif", "memory.tif"]
    for level in ({}, {"overview_level": 0}, {"overview_level": 1}):
        found = []
        for name in ("memory", "file"):
            with rasterio.open(tmp_path / f"{name}.tif", **level) as source:
                if not level:
                    assert source.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
                    assert source.tags()["a"] == "1"
                    assert source.descriptions == ("HH", "VV")
                found.append(source.read())
        # overviews are means in float32, of pieces that are added in another order
        np.testing.assert_allclose(*found, rtol=1e-6 if level else 0.0)


def ifds(path: Path) -> tuple[list[int], list[list[int]]]:
    """Offsets of a little-endian classic TIFF's directories, and of the tiles of each (TIFF 6.0)."""
    data = path.read_bytes()
    assert data[:4] == b"II*\0"
    at, places, tiles = struct.unpack_from("<I", data, 4)[0], [], []
    while at:
        places.append(at)
        (count,) = struct.unpack_from("<H", data, at)
        for k in range(count):
            tag, _, n, value = struct.unpack_from("<HHII", data, at + 2 + 12 * k)
            if tag == 324:  # TileOffsets
                tiles.append([value] if n == 1 else list(struct.unpack_from(f"<{n}I", data, value)))
        (at,) = struct.unpack_from("<I", data, at + 2 + 12 * count)
    return places, tiles


LOOK = (135.0, 50.0)
PIXEL = (52, 74)  # of 160 x 160, of 0.25 m: the reflector's
D, U, _ = axes(*LOOK)
RANGE, AZIMUTH = ((index + 0.5 - 80) * 0.25 for index in PIXEL)
TRIHEDRAL_AT = (*(AZIMUTH * U + RANGE * D / (D[0] ** 2 + D[1] ** 2))[:2].tolist(), 0.0)
"""On level ground, where that pixel's middle is."""


def corner_reflector(**options: Any) -> Scene:
    """A trihedral of 1 m on dark ground, open to the south-east, apex at TRIHEDRAL_AT."""
    apex = np.array(TRIHEDRAL_AT)
    a, b, up = np.array([1.0, 0, 0]), np.array([0, -1.0, 0]), np.array([0, 0, 1.0])
    lifted = apex + 0.01 * up  # its floor above the ground
    plates = [plate(lifted, a, b, 4), plate(lifted, a, up, 4), plate(lifted, b, up, 4)]
    mesh = mesh_of(soil=ground(60), steel=join(plates))
    scene = scene_of(
        mesh,
        view(*LOOK),
        shape=(160, 160),
        spacing_m=(0.25, 0.25),
        materials={"steel": {**BRICK, "eps_r": 80.0}},
        **options,
    )
    return replace(
        scene, effects={"multibounce": validate("multibounce", {"strength": 1.0}, "multibounce")}, origin=MUNICH
    )


@pytest.mark.full
@pytest.mark.parametrize("slant_range_m", [None, 800.0])
def test_a_corner_reflector_lands_where_it_stands(slant_range_m: float | None) -> None:
    """Within a pixel of its apex, in latitude and longitude."""
    scene = corner_reflector(slant_range_m=slant_range_m)
    image, place = on_the_ground(scene)
    row, col = np.unravel_index(np.nanargmax(image), image.shape)
    expected = pixel_of(place, TRIHEDRAL_AT)
    assert (row + 0.5, col + 0.5) == pytest.approx(expected, abs=1.0)
    slant = images_of(scene, device="cpu")[0].beta0["HH"]
    assert np.unravel_index(slant.argmax(), slant.shape) == PIXEL
    assert 0.4 * slant.max() < np.nanmax(image) <= slant.max()  # bilinear: less between two pixels


def bright_patch(height: float) -> Scene:
    """A table of 10 m about (6, 4) of bright soil, `height` above wide ground."""
    x, y, half = 6.0, 4.0, 5.0
    top = plate((x - half, y - half, height), (2 * half, 0, 0), (0, 2 * half, 0))
    mesh = mesh_of(soil=ground(90), bright=top)
    scene = scene_of(mesh, view(30.0, 40.0), shape=(200, 200), spacing_m=(0.25, 0.25), materials={"bright": BRIGHT})
    return replace(scene, origin=MUNICH)


@pytest.mark.parametrize("height", [0.05, 8.0])
def test_height_does_not_move_a_surface(height: float) -> None:
    """A raised surface lies at its own place on the map; on a plane it would be off by h / tan(incidence)."""
    image, place = on_the_ground(bright_patch(height))
    threshold = 0.5 * (np.nanmedian(image) + np.nanmax(image))
    rows, cols = np.nonzero(image > threshold)
    inside = [pixel_of(place, (6.0 + dx, 4.0 + dy, height)) for dx in (-4.0, 0.0, 4.0) for dy in (-4.0, 0.0, 4.0)]
    bright = image > threshold
    assert all(bright[int(r), int(c)] for r, c in inside)
    middle = pixel_of(place, (6.0, 4.0, height))
    if height < 1:  # higher up, ground in layover with it is as bright
        assert (rows.mean() + 0.5, cols.mean() + 0.5) == pytest.approx(middle, abs=1.0)


def test_what_the_radar_does_not_see_is_no_data() -> None:
    """Behind a wall, outside of the mesh, and outside of the image."""
    wall = plate((-10.0, 0.0, 0.0), (20.0, 0, 0), (0, 0, 6.0))
    flat = scene_of(mesh_of(soil=ground(40), wall=wall), view(0.0, 45.0), shape=(100, 80), spacing_m=(0.4, 0.4))
    scene = replace(flat, origin=MUNICH)
    image, place = on_the_ground(scene)

    def at(x: float, y: float) -> float:
        row, col = (int(value) for value in pixel_of(place, (x, y, 0.0)))
        inside = 0 <= row < image.shape[0] and 0 <= col < image.shape[1]
        return float(image[row, col]) if inside else float("nan")

    assert np.isnan([at(0.0, -1.0), at(0.0, -5.5), at(8.0, -3.0)]).all()  # 6 m of shadow at 45 degrees
    assert np.isfinite([at(0.0, 1.0), at(0.0, -6.6), at(12.0, -3.0), at(0.0, 18.0)]).all()
    assert np.isnan([at(0.0, 21.0), at(17.0, 0.0), at(0.0, -35.0)]).all()


def test_a_dem_is_its_own_place(tmp_path: Path) -> None:
    """The ground of a DEM's scene has the DEM's coordinate system, and a value where the image has it."""
    rows, cols, step = 60, 80, 1.0
    place = rasterio.transform.from_origin(691000.0, 5335000.0, step, step)
    with rasterio.open(tmp_path / "dem.tif", "w", "GTiff", cols, rows, 1, "EPSG:32632", place, "float32") as target:
        hill = 3.0 * np.sin(np.arange(cols) / 9.0)[None, :] * np.cos(np.arange(rows) / 7.0)[:, None]
        target.write((500.0 + hill).astype(np.float32), 1)
    (tmp_path / "scene.toml").write_text(
        SCENE[: SCENE.index("[materials.soil]")]
        .replace('mesh = "scene.obj"', 'mesh = "dem.tif"\nreference_point_m = [0.0, 0.0, 500.0]')
        .replace("[24, 20]", "[64, 60]")
        + "[materials.default]\neps_r = 6.0\nrms_height_m = 0.0012\ncorrelation_length_m = 0.010\n"
        + '[[views]]\nname = "west"\nazimuth_deg = 270.0\nincidence_deg = 40.0\n'
    )
    assert simulate(tmp_path / "scene.toml", "--format", "geotiff")[0] == 0
    with rasterio.open(tmp_path / "out" / "west_ground.tif") as source:
        assert source.crs == rasterio.crs.CRS.from_epsg(32632)
        found = source.read(1)
        middle = source.index(691040.0, 5334970.0)
    assert np.isfinite(found[middle])
    scene = Scene.load(tmp_path / "scene.toml")
    both = replace(scene, origin=MUNICH)
    with pytest.raises(InputError, match="is a DEM that says itself where it lies"):
        MapGround.of(both, Stage.of(both, resolve_device("cpu")))


@pytest.mark.parametrize(
    ("latitude", "longitude", "code"), [(-33.9, 151.2, 32756), (88.0, 10.0, 5041), (0.0, -180.0, 32601)]
)
def test_the_map_is_utm(latitude: float, longitude: float, code: int) -> None:
    flat = scene_of(mesh_of(soil=ground(20)), view(0, 40), rays_per_pixel=4.0)
    scene = replace(flat, origin=Origin(latitude_deg=latitude, longitude_deg=longitude))
    image, place = on_the_ground(scene)
    assert place.crs == rasterio.crs.CRS.from_epsg(code)
    row, col = pixel_of(place, (0.0, 0.0, 0.0), scene.origin)
    assert np.isfinite(image[int(row), int(col)])


def test_the_origin_is_read_and_written(scene: Path) -> None:
    loaded = Scene.load(scene)
    assert loaded.origin == MUNICH
    loaded.save(scene.parent / "again.toml")
    assert Scene.load(scene.parent / "again.toml").origin == MUNICH
    replace(loaded, source="").save(scene.parent / "fresh.toml")
    assert Scene.load(scene.parent / "fresh.toml").origin == MUNICH


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("latitude_deg = 48.1486", "latitude_deg = 91.0", "scene.origin.latitude_deg: found 91"),
        ("latitude_deg = 48.1486, ", "", "scene.origin.latitude_deg: missing"),
        ("height_m = 515.0", "hight_m = 515.0", "must be one of latitude_deg, longitude_deg, height_m"),
    ],
)
def test_a_wrong_origin_is_refused(old: str, new: str, message: str, scene: Path) -> None:
    scene.write_text(scene.read_text().replace(old, new))
    status, said = simulate(scene)
    assert status == 2
    assert message in said


def test_rasterio_is_asked_for_before_any_work(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extra, "find_spec", lambda name: None)
    status, said = simulate(scene, "--format", "geotiff")
    assert status == 2
    assert 'Error: --format geotiff: needs rasterio: pip install "warpsar[geo]"' in said
    assert not (scene.parent / "out").exists()


def test_import_reads_what_simulate_wrote(tmp_path: Path) -> None:
    """From the slant plane to the map and back onto the view's grid; `--origin` stays in the scene file."""
    (tmp_path / "scene.obj").write_text("usemtl soil\nv -12 -12 0\nv 12 -12 0\nv 12 12 3\nv -12 12 3\nf 1 2 3 4\n")
    text = SCENE[: SCENE.index("[materials.wall]")] + SCENE[SCENE.index("[[views]]") :]
    path = tmp_path / "scene.toml"
    path.write_text(text)
    place = ("48.1486", "11.5683", "515")
    placed = f"[scene]\norigin = {{ latitude_deg = {place[0]}, longitude_deg = {place[1]} }}"
    (tmp_path / "placed.toml").write_text(text.replace("[scene]", placed))
    assert simulate(tmp_path / "placed.toml", "--format", "geotiff", "--format", "exr")[0] == 0
    image = tmp_path / "out" / "north_ground.tif"
    asked = [
        "import",
        str(image),
        "--scene",
        str(path),
        "--view",
        "north",
        "--quantity",
        "power",
        "--polarization",
        "HH",
    ]
    done = CliRunner().invoke(main, [*asked, "--surface", "mesh", "--device", "cpu", "--origin", *place])
    assert done.exit_code == 0, done.output
    scene = Scene.load(path)
    assert scene.origin == MUNICH
    found = scene.measured(scene.views[0], "HH")
    expected = read_channel(tmp_path / "out" / "north.exr", "HH")
    both = np.isfinite(found) & (expected > 0)
    both[1:-1, 1:-1] &= both[:-2, 1:-1] & both[2:, 1:-1] & both[1:-1, :-2] & both[1:-1, 2:]
    both[[0, -1]], both[:, [0, -1]] = False, False
    assert both.sum() > 150
    assert np.median(np.abs(found[both] / expected[both] - 1)) < 0.02
    again = CliRunner().invoke(main, [*asked, "--device", "cpu", "--origin", "47", "11", "0"])
    assert again.exit_code == 2
    assert "the scene file says" in again.output
