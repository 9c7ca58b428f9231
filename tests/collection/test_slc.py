"""Complex images: one point's place and phase, both ways of making them, and SICD files."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from collected_scenes import ROUGH, field, scene
from scipy.signal import resample

import warpsar
from warpsar.collection.bodies import Bodies
from warpsar.collection.command import run
from warpsar.collection.direct import direct, direct_of_rough
from warpsar.collection.history import phase_history as recorded
from warpsar.collection.plan import Plan, plan_of
from warpsar.collection.scatterers import ScattererPart, Scatterers, scatterers_of
from warpsar.collection.slc import Slc, focused
from warpsar.formats import registry
from warpsar.formats.base.data import ImageChip
from warpsar.measured.placed import frame_of
from warpsar.runtime import devices
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import Origin

STRIPMAP = {
    "mode": "stripmap",
    "antenna": {"azimuth_deg": 2.5},
    "aperture_deg": 6.0,
    "resolution_m": None,
    "bandwidth_hz": 3.6e8,
}
MODES = {
    "spotlight": {},
    "stripmap": STRIPMAP,
    "a narrow beam": {"antenna": {"azimuth_deg": 0.1, "elevation_deg": 0.08}},
}
SHAPE, SPACING = (96, 96), (0.2, 0.25)


def planned(mode: str = "spotlight", **more: object) -> tuple[warpsar.Scene, Plan]:
    made = scene(field(30.0, 30.0), shape=SHAPE, spacing=SPACING, collection=MODES.get(mode, {}), **more)
    return made, plan_of(made, made.views[0], devices.resolve_device("cpu"))


def points(plan: Plan, place: np.ndarray, amplitude: np.ndarray) -> Scatterers:
    part = ScattererPart(place, amplitude.astype(np.complex64)[None], np.ones(len(plan.track), np.float32))
    return Scatterers((part,), 0.0)


def backprojected(made: warpsar.Scene, plan: Plan, found: Scatterers, device: str) -> Slc:
    where = devices.resolve_device(device)
    return focused(recorded(plan, found, ("HH",), where), made.grid, where)


@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
def test_a_point_is_where_its_range_and_azimuth_are(mode: str, device: str) -> None:
    """Its power, times the response's area over the pixel's, is its RCS; its phase is -4 pi f r / c."""
    made, plan = planned(mode)
    r, a = -2.5 * SPACING[0], 7.5 * SPACING[1]  # in a pixel's middle
    place = r * plan.geometry.d + a * plan.geometry.u
    image = backprojected(made, plan, points(plan, place[None], np.array([3.0 * np.exp(0.7j)])), device).images["HH"]
    at = np.unravel_index(np.abs(image).argmax(), image.shape)
    assert at == (SHAPE[0] // 2 - 3, SHAPE[1] // 2 + 7)
    # A point aside of a stripmap's track passes through the whole beam, the middle's less one end of its tail.
    assert np.abs(image[at]) ** 2 * plan.response_m2 == pytest.approx(9.0, rel=0.01)
    way = np.hypot(plan.slant_range_m + r, a * (mode == "spotlight")) - plan.slant_range_m
    phase = np.angle(image[at] * np.exp(4j * np.pi * plan.centre_hz / SPEED_OF_LIGHT * way))
    assert phase == pytest.approx(0.7, abs=0.01)


@pytest.mark.parametrize("mode", MODES)
def test_both_ways_make_one_image(mode: str, device: str) -> None:
    """To 2 %: a separable response has no bend of the band's arcs, B / f and aperture^2 of it."""
    made, plan = planned(mode)
    place = np.array([[3.0, -2.0, 0.5], [0.0, 0.0, 0.0], [-6.0, 5.0, 1.0]])
    found = points(plan, place, np.array([1.0, 1j, -2.0]))
    one = backprojected(made, plan, found, device).images["HH"]
    other = direct(plan, found, ("HH",), made.grid, devices.resolve_device(device)).images["HH"]
    assert np.abs(one - other).max() < 0.02 * np.abs(one).max()


@pytest.mark.parametrize("mode", MODES)
def test_rough_ground_alone_stays_on_the_device(mode: str, device: str) -> None:
    """The same image as of scatterers on the host, whose columns and signs are their own; float32 sums."""
    radar = {"polarizations": ("HH", "HV", "VV"), "terms": ("rough",)}
    made, plan = planned(mode, radar=radar)
    where = devices.resolve_device(device)
    bodies = Bodies(made, [plan], where, 5)
    one = direct_of_rough(bodies, plan)
    found = scatterers_of(made, plan, bodies.of(plan), once=True)
    other = direct(plan, found, made.radar.polarizations, made.grid, where)
    assert one.scatterers == other.scatterers
    for name, image in other.images.items():
        assert np.abs(one.images[name] - image).max() < 1e-5 * np.abs(image).max()


def test_direct_is_refused_where_it_has_no_one_response() -> None:
    for table in (
        {"squint_deg": 10.0},
        {"mode": "circular", "aperture_deg": 10.0, "resolution_m": None, "bandwidth_hz": 1e8},
    ):
        made = scene(field(4.0, 4.0), collection={**table, "focus": "direct"})
        with pytest.raises(warpsar.InputError, match="backprojection"):
            warpsar.slc(made, device="cpu")


KINDS = {
    "spotlight": {},
    "squinted": {"squint_deg": 15.0},
    "stripmap": STRIPMAP,
    "circle": {"mode": "circular", "aperture_deg": 6.0},
}


SPACINGS = {"spotlight": (0.3, 0.3), "squinted": (0.3, 0.3), "stripmap": (0.25, 0.13), "circle": (0.3, 0.13)}
"""The checker asks for 1.1 to 2.2 pixels in a cell."""


@pytest.fixture(scope="module", params=KINDS)
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plate that shines, 3 m east and 2 m north of the reference point, and half a metre up."""
    pytest.importorskip("sarkit")
    folder = tmp_path_factory.mktemp(request.param)
    from collected_scenes import square_trihedral

    corner = square_trihedral(0.3)
    mesh = warpsar.Mesh.of(corner.vertices + np.array([3.0, 2.0, 0.5]), corner.faces)
    made = scene(
        mesh,
        material={"conductor": True},
        view={"azimuth_deg": 45.0, "incidence_deg": 50.0},
        origin=Origin(latitude_deg=48.1, longitude_deg=11.6, height_m=500.0),
        collection={"resolution_m": (0.6, 0.6)} | KINDS[request.param],
        shape=(80, 64),
        spacing=SPACINGS[request.param],
        reference_point_m=(0.0, 0.0, 0.0),
    )
    made.save(folder / "scene.toml")
    run(folder / "scene.toml", folder / "out", "slc", device="cpu")
    return folder


@pytest.mark.full
def test_sicd_passes_the_checker(written: Path) -> None:
    from sarkit.verification._sicd_consistency import SicdConsistency

    with (written / "out" / "one.nitf").open("rb") as file:
        checker = SicdConsistency.from_file(file)
        checker.check()
    assert checker.failures() == {}


@pytest.mark.full
def test_sicd_holds_the_image_and_places_it(written: Path) -> None:
    """sarkit's own projection of the corner finds the brightest pixel, to half a pixel."""
    made = warpsar.Scene.load(written / "scene.toml")
    (own,) = warpsar.slc(made, device="cpu")
    read = registry.read([written / "out" / "one.nitf"], frame=frame_of(made))
    assert isinstance(read, ImageChip)
    rows, columns = own.images["HH"].shape
    pixels = read.samples[slice(0, rows), slice(0, columns)]
    assert np.array_equal(pixels, own.images["HH"])
    assert read.locate is not None
    found = read.locate(np.array([[3.0, 2.0, 0.5]]))[0]
    brightest = np.unravel_index(np.abs(pixels).argmax(), pixels.shape)
    assert np.abs(found - brightest).max() < 0.6
    facts = read.facts(np.zeros(3))
    assert facts.azimuth_deg == pytest.approx(45.0, abs=0.05)
    assert facts.incidence_deg == pytest.approx(50.0, abs=0.05)


def cut(image: np.ndarray, axis: int, spacing: float) -> float:
    """Half-power width of the brightest point along an axis [m], from samples made 64 times finer."""
    row, column = np.unravel_index(np.abs(image).argmax(), image.shape)
    line = image[:, column] if axis == 0 else image[row]
    power = np.abs(resample(line, 64 * len(line))) ** 2
    return np.count_nonzero(power > 0.5 * power.max()) * spacing / 64


def test_sicd_declares_the_widths_that_a_point_has(written: Path) -> None:
    """To 2 %. An antenna's beam widens the response of a stripmap, and a squint that of the image's plane."""
    sarkit_sicd = pytest.importorskip("sarkit.sicd")
    with (written / "out" / "one.nitf").open("rb") as file:
        helper = sarkit_sicd.XmlHelper(sarkit_sicd.NitfReader(file).metadata.xmltree)
    with np.load(written / "out" / "one.npz") as held:
        image = held["HH"]
    for axis, name in enumerate(("Row", "Col")):
        stated = helper.load(f"./{{*}}Grid/{{*}}{name}/{{*}}ImpRespWid")
        assert cut(image, axis, helper.load(f"./{{*}}Grid/{{*}}{name}/{{*}}SS")) == pytest.approx(stated, rel=0.02)


@pytest.mark.skipif(find_spec("sarpy") is None, reason="sarpy is not installed: pip install sarpy")
def test_sicd_opens_in_sarpy(written: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The pixels to the bit, the corner at the brightest one, and none of sarpy's own validation errors.

    One is left out: sarpy takes the area of a level plane's cell for that of the slant plane, which beta0 is about.
    """
    from sarpy.io.complex.converter import open_complex

    reader = open_complex(str(written / "out" / "one.nitf"))
    with np.load(written / "out" / "one.npz") as held:
        image = held["HH"]
    assert np.array_equal(reader[:, :], image)
    place = frame_of(warpsar.Scene.load(written / "scene.toml")).to_ecef(np.array([3.0, 2.0, 0.5]))
    found = reader.sicd_meta.project_ground_to_image(place)[0]
    assert np.abs(found - np.unravel_index(np.abs(image).argmax(), image.shape)).max() < 0.6
    with caplog.at_level("ERROR", logger="validation"):
        reader.sicd_meta.is_valid(recursive=True, stack=False)
    wrong = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    level = reader.sicd_meta.Grid.ImagePlane == "GROUND"
    assert [one for one in wrong if not (level and "BetaZeroSFPoly" in one)] == []


def test_a_scene_that_sends_nothing_back_is_dark(capsys: pytest.CaptureFixture[str]) -> None:
    """No conductor, and so no edge: said, and no error."""
    made = scene(field(6.0, 6.0), radar={"terms": ("edges",)}, shape=(16, 16))
    (image,) = warpsar.slc(made, device="cpu")
    assert not image.images["HH"].any()
    assert "nothing sends back" in capsys.readouterr().err


@pytest.mark.full
def test_several_polarizations_and_xarray(tmp_path: Path) -> None:
    made = scene(
        field(6.0, 6.0),
        material=ROUGH,
        radar={"polarizations": ("HH", "VV"), "terms": ("rough",)},
        collection={"focus": "direct"},
        shape=(24, 24),
    )
    made.save(tmp_path / "scene.toml")
    run(tmp_path / "scene.toml", tmp_path / "out", "slc", device="cpu")
    (own,) = warpsar.slc(made, device="cpu")
    with np.load(tmp_path / "out" / "one.npz") as held:
        assert np.array_equal(held["VV"], own.images["VV"])
    if pytest.importorskip("sarkit"):
        assert (tmp_path / "out" / "one_VV.nitf").exists()
    pytest.importorskip("xarray")
    data = own.to_xarray()
    assert data.slc.dims == ("range", "azimuth", "polarization")
    assert np.array_equal(data.slc.sel(polarization="HH"), own.images["HH"])
    assert data.range.values == pytest.approx((np.arange(24) - 11.5) * 0.25)
