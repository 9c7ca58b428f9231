"""Readers: what a file says comes out as it says it; broken files end in one message."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from measured_files import SITE, C, Pass, echoes, to_ecef, write_cphd, write_mat, write_phoenix, write_sicd

from warpsar.errors import InputError
from warpsar.formats import registry
from warpsar.formats.base.data import ImageChip, PhaseHistory
from warpsar.world.earth import LocalEarth, axes_at, ecef_to_geodetic, geodetic_to_ecef

LOOK = Pass(slant_range_m=10e3, speed_m_s=100.0)
FREQUENCY_HZ = 9.5e9 + 5e6 * np.arange(32)
POSITIONS = LOOK.position(np.linspace(-40.0, 40.0, 24))
TARGET = np.array([[3.0, -5.0, 0.0]])
CLUTTER = (np.random.default_rng(0).normal(size=(256, 256, 2)) @ [1, 1j]).astype(np.complex64)
SAMPLES = echoes(POSITIONS, FREQUENCY_HZ, TARGET, np.ones(1), np.zeros(3))


def matlab(folder: Path) -> Path:
    return write_mat(folder / "made_HH.mat", SAMPLES, FREQUENCY_HZ, POSITIONS)


def cphd(folder: Path) -> Path:
    return write_cphd(folder / "made.cphd", SAMPLES, FREQUENCY_HZ, POSITIONS, LOOK)


def sicd(folder: Path) -> Path:
    image = np.random.default_rng(0).normal(size=(21, 31, 2)) @ [1, 1j]
    return write_sicd(folder / "made.nitf", image, (0.5, 0.6), LOOK, 2.0)


def mstar(folder: Path) -> Path:
    generator = np.random.default_rng(0)
    return write_phoenix(folder / "made.015", generator.rayleigh(size=(20, 24)), generator.uniform(-3, 3, (20, 24)))


def nisar(folder: Path) -> Path:
    """A straight pass in earth-centred coordinates, so that zero Doppler is where the foot of the perpendicular is."""
    import h5py

    path = folder / "made.h5"
    time = np.linspace(100.0, 120.0, 5)
    track = LOOK.position((time - 110.0) * LOOK.speed_m_s)
    with h5py.File(path, "w") as file:
        base = file.create_group("science/LSAR/SLC")
        orbit = base.create_group("metadata/orbit")
        orbit["time"], orbit["position"] = time, to_ecef(track)
        orbit["velocity"] = np.gradient(to_ecef(track), time, axis=0)
        swaths = base.create_group("swaths")
        swaths["zeroDopplerTime"] = 109.5 + 0.005 * np.arange(201)  # 0.5 m each
        band = swaths.create_group("frequencyA")
        band["slantRange"] = 10e3 - 40.0 + 0.5 * np.arange(161)
        band["processedCenterFrequency"] = 9.6e9
        band["HH"] = (np.random.default_rng(0).normal(size=(201, 161, 2)) @ [1, 1j]).astype(np.complex64)
    return path


def geotiff(folder: Path) -> Path:
    import rasterio

    path = folder / "map.tif"
    east, north = utm(SITE[1], SITE[0])
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=60,
        height=50,
        count=1,
        dtype="float32",
        crs="EPSG:32616",
        transform=rasterio.Affine(2.0, 0.0, east - 60.0, 0.0, -2.0, north + 50.0),
    ) as file:
        file.write(np.random.default_rng(0).rayleigh(size=(50, 60)).astype(np.float32), 1)
    return path


def numpy_array(folder: Path) -> Path:
    path = folder / "made.npy"
    np.save(path, np.random.default_rng(0).rayleigh(size=(20, 24)).astype(np.float32))
    return path


def exr(folder: Path) -> Path:
    from warpsar.io.images import write_exr

    path = folder / "made.exr"
    write_exr(path, {"HH": np.random.default_rng(0).rayleigh(size=(20, 24))})
    return path


def tiff(folder: Path) -> Path:
    from warpsar.io.images import write_tiff

    path = folder / "made.tif"
    write_tiff(path, np.random.default_rng(0).rayleigh(size=(20, 24)))
    return path


def jpeg(folder: Path) -> Path:
    from PIL import Image

    path = folder / "made.jpg"
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (20, 24), np.uint8)).save(path)
    return path


def png(folder: Path) -> Path:
    from PIL import Image

    path = folder / "made.png"
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (20, 24), np.uint8)).save(path)
    return path


def sentinel1(folder: Path) -> Path:
    from product_files import write_safe

    return next((write_safe(folder, CLUTTER) / "annotation").glob("*.xml"))


def gamma(folder: Path) -> Path:
    from product_files import write_gamma

    path = write_gamma(folder, np.abs(CLUTTER) ** 2)
    return path.with_name(f"{path.name}.par")


def capella(folder: Path) -> Path:
    from product_files import write_capella

    return write_capella(folder, np.ones((48, 96), np.complex64))


MADE: dict[str, Callable[[Path], Path]] = {
    "gotcha": matlab,
    "cphd": cphd,
    "sicd": sicd,
    "mstar": mstar,
    "nisar": nisar,
    "geotiff": geotiff,
    "npy": numpy_array,
    "exr": exr,
    "tiff": tiff,
    "jpeg": jpeg,
    "png": png,
    "sentinel1": sentinel1,
    "gamma": gamma,
    "capella": capella,
}
PICTURES = tuple(name for name in MADE if "quantity" in registry.get(name).asks)


def utm(longitude: float, latitude: float) -> tuple[float, float]:
    from rasterio.warp import transform

    x, y = transform("EPSG:4326", "EPSG:32616", [longitude], [latitude])
    return x[0], y[0]


def read(path: Path, **options: object) -> PhaseHistory | ImageChip:
    """Read, and touch the pixels: window readers open their file only then."""
    if registry.detect(path) in PICTURES:
        options.setdefault("quantity", "power")
    measured = registry.read([path], frame=LocalEarth(*SITE), **options)
    if isinstance(measured, ImageChip):
        rows, cols = measured.samples.shape
        measured.samples[slice(0, rows), slice(0, cols)]
    return measured


# ---- what they say ----


def test_every_format_is_read_here() -> None:
    """A new reader needs a file in `MADE`: the tests of all formats then take it."""
    assert set(MADE) == {name for name in registry.names() if registry.get(name).read is not None}


@pytest.mark.parametrize("name", MADE)
def test_format_is_told_by_the_file_itself(name: str, tmp_path: Path) -> None:
    path = MADE[name](tmp_path)
    assert registry.detect(path) == name
    if name not in PICTURES:
        assert registry.detect(path.rename(tmp_path / "no_suffix")) == name


@pytest.mark.parametrize("name", ["gotcha", "cphd", "sicd", "nisar"])
def test_direction_frequency_and_range_come_from_the_file(name: str, tmp_path: Path) -> None:
    facts = read(MADE[name](tmp_path)).facts(np.zeros(3))
    assert facts.azimuth_deg == pytest.approx(LOOK.azimuth_deg, abs=0.01)  # an aperture's middle, to its curvature
    assert facts.incidence_deg == pytest.approx(LOOK.incidence_deg, abs=0.01)
    assert facts.slant_range_m == pytest.approx(10e3, rel=1e-4)
    assert facts.frequency_hz == pytest.approx(FREQUENCY_HZ.mean() if name in ("gotcha", "cphd") else 9.6e9)
    assert facts.polarization == ("VV" if name == "sicd" else "HH")


def test_direction_is_seen_from_the_reference_point(tmp_path: Path) -> None:
    measured = read(matlab(tmp_path))
    away = 1000.0
    _, u = LOOK.axes
    facts = measured.facts(-away * u)
    ground = 10e3 * np.sin(np.deg2rad(LOOK.incidence_deg))
    assert facts.azimuth_deg - LOOK.azimuth_deg == pytest.approx(np.degrees(np.arctan(away / ground)), abs=0.01)


@pytest.mark.parametrize("sgn", [-1, 1])
def test_cphd_samples_and_positions(sgn: int, tmp_path: Path) -> None:
    path = write_cphd(tmp_path / "made.cphd", SAMPLES, FREQUENCY_HZ, POSITIONS, LOOK, sgn=sgn, bad=(3, 11))
    measured = registry.read([path])
    assert isinstance(measured, PhaseHistory)
    kept = np.delete(np.arange(24), [3, 11])
    np.testing.assert_allclose(measured.samples, SAMPLES[:, kept], atol=1e-6)
    np.testing.assert_allclose(measured.position_m, to_ecef(POSITIONS)[kept], atol=1e-6)
    np.testing.assert_allclose(measured.reference_range_m, np.linalg.norm(POSITIONS[kept], axis=1), atol=1e-6)
    np.testing.assert_allclose(measured.frequency_start_hz, FREQUENCY_HZ[0])
    np.testing.assert_allclose(measured.frequency_step_hz, 5e6)
    # Without a frame the world's origin is the file's IARP.
    np.testing.assert_allclose(measured.in_frame(np.zeros(3)), to_ecef(np.zeros(3)), atol=1e-6)


def test_several_matlab_files_are_one_aperture(tmp_path: Path) -> None:
    whole = read(matlab(tmp_path))
    paths = [
        write_mat(tmp_path / f"part{i}_HH.mat", SAMPLES[:, part], FREQUENCY_HZ, POSITIONS[part])
        for i, part in enumerate((slice(0, 10), slice(10, 24)))
    ]
    joined = registry.read(paths)
    assert isinstance(joined, PhaseHistory)
    assert isinstance(whole, PhaseHistory)
    np.testing.assert_array_equal(joined.samples, whole.samples)
    np.testing.assert_array_equal(joined.position_m, whole.position_m)


def test_matlab_frequencies_may_fall(tmp_path: Path) -> None:
    path = write_mat(tmp_path / "made_VV.mat", SAMPLES[::-1], FREQUENCY_HZ[::-1], POSITIONS)
    measured = read(path)
    assert isinstance(measured, PhaseHistory)
    np.testing.assert_allclose(measured.samples, SAMPLES, atol=1e-6)
    assert measured.polarization == "VV"


def test_phoenix_chip_is_turned_to_have_the_radar_on_top(tmp_path: Path) -> None:
    magnitude = np.arange(1.0, 7.0).reshape(2, 3)
    top = write_phoenix(tmp_path / "top", magnitude, 0 * magnitude)
    bottom = write_phoenix(tmp_path / "bottom", magnitude, 0 * magnitude, RadarPosition="bottom")
    np.testing.assert_allclose(read(top).samples, magnitude)
    np.testing.assert_allclose(read(bottom).samples, [[4, 5, 6], [1, 2, 3]])
    facts = read(top).facts(np.zeros(3))
    assert (facts.azimuth_deg, facts.incidence_deg, facts.frequency_hz) == (30.0, 40.0, 9.6e9)


@pytest.mark.parametrize("name", ["sicd", "nisar"])
def test_world_points_fall_on_their_pixels(name: str, tmp_path: Path) -> None:
    """Range is the distance to the middle of the pass, azimuth the foot of the perpendicular on a straight track."""
    points = np.array([[0.0, 0.0, 0.0], [4.0, -3.0, 0.0], [-2.0, 5.0, 1.5]])
    measured = read(MADE[name](tmp_path))
    assert isinstance(measured, ImageChip)
    assert measured.locate is not None
    found = measured.locate(points)
    s, u = LOOK.axes
    along = points @ u
    if name == "nisar":
        distance = np.linalg.norm(10e3 * s - points + along[:, None] * u, axis=1)
        expected = np.column_stack([(along / 100.0 + 0.5) / 0.005, (distance - 10e3 + 40.0) / 0.5])
    else:
        distance = np.linalg.norm(10e3 * s - points, axis=1)
        expected = np.column_stack([(distance - 10e3) / 0.5 + 10, along * 10e3 / distance / 0.6 + 15])
    # 2e-3 of a pixel, a millimetre: the projection's own stopping rule, and the ellipsoid under 5 m of ground.
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_geotiff_pixels_are_found_on_the_map(tmp_path: Path) -> None:
    measured = read(geotiff(tmp_path))
    assert isinstance(measured, ImageChip)
    assert measured.locate is not None
    # The site is the corner of pixels (24, 29) and (25, 30), 2 m each, whose centres are whole numbers.
    np.testing.assert_allclose(measured.locate(np.zeros((1, 3))), [[24.5, 29.5]], atol=1e-4)
    # UTM north is turned by (longitude - central meridian) sin(latitude), here 3 degrees x sin(40), from true north.
    row, col = (measured.locate(np.array([[0.0, 20.0, 0.0]])) - [24.5, 29.5])[0]
    turn = np.deg2rad((SITE[1] + 87.0) * np.sin(np.deg2rad(SITE[0])))
    np.testing.assert_allclose([row, col], [-10 * np.cos(turn), -10 * np.sin(turn)], atol=0.02)  # scale 1.0007
    assert measured.spacing_m == pytest.approx((2.0, 2.0), rel=2e-3)  # UTM's scale at the zone's edge


def test_quantity_is_said_or_refused_never_guessed(tmp_path: Path) -> None:
    for name in PICTURES:
        path = MADE[name](tmp_path)
        with pytest.raises(InputError, match=f"{path.name}.*amplitudes or powers.*--quantity"):
            registry.read([path], frame=LocalEarth(*SITE))
        assert registry.read([path], quantity="amplitude", frame=LocalEarth(*SITE)).quantity == "amplitude"
    with pytest.raises(InputError, match="leave --quantity out"):
        registry.read([mstar(tmp_path)], quantity="power")
    np.save(tmp_path / "complex.npy", np.ones((4, 4), complex))
    assert registry.read([tmp_path / "complex.npy"]).quantity == "complex"
    with pytest.raises(InputError, match="complex numbers"):
        registry.read([tmp_path / "complex.npy"], quantity="power")


# ---- the earth ----


def test_earth_agrees_with_sarkit() -> None:
    from sarkit import wgs84

    generator = np.random.default_rng(0)
    geodetic = np.column_stack(
        [generator.uniform(-90, 90, 200), generator.uniform(-180, 180, 200), generator.uniform(-1e3, 1e5, 200)]
    )
    ecef = geodetic_to_ecef(geodetic)
    np.testing.assert_allclose(ecef, wgs84.geodetic_to_cartesian(geodetic), atol=1e-6)
    np.testing.assert_allclose(geodetic_to_ecef(ecef_to_geodetic(ecef)), ecef, atol=1e-4)


def test_world_is_azimuthal_equidistant() -> None:
    from rasterio.warp import transform

    world = np.random.default_rng(0).uniform(-15e3, 15e3, (50, 3)) * [1, 1, 0.01]
    found = ecef_to_geodetic(LocalEarth(*SITE[:2], 100.0).to_ecef(world))
    crs = f"+proj=aeqd +lat_0={SITE[0]} +lon_0={SITE[1]} +datum=WGS84 +units=m"
    x, y = transform("EPSG:4326", crs, found[:, 1], found[:, 0])
    np.testing.assert_allclose(np.column_stack([x, y]), world[:, :2], atol=0.01)  # Euler's radius for the geodesic
    np.testing.assert_allclose(found[:, 2], world[:, 2] + 100.0, atol=1e-4)


def test_axes_at_the_origin_are_east_north_up() -> None:
    from sarkit import wgs84

    expected = np.stack([wgs84.east(SITE), wgs84.north(SITE), wgs84.up(SITE)])
    np.testing.assert_allclose(axes_at(LocalEarth(*SITE), np.zeros(3)), expected, atol=1e-6)


# ---- what is broken ----


@pytest.mark.parametrize("name", MADE)
def test_a_truncated_file_is_one_message(name: str, tmp_path: Path) -> None:
    """Cut anywhere, a file is refused with its name in the message; nothing else is raised."""
    path = MADE[name](tmp_path)
    whole = path.read_bytes()
    refused = 0
    for size in np.linspace(0, len(whole) - 1, 25).astype(int):
        path.write_bytes(whole[:size])
        try:
            read(path)
        except InputError as error:
            message = str(error)
            refused += 1
        else:
            continue
        assert str(path) in message
        assert "\n" not in message
    # A file may keep its last bytes for nothing that is read (HDF5, TIFF); all the rest must be missed.
    assert refused >= 24


@pytest.mark.parametrize("name", MADE)
def test_a_file_of_another_kind_is_one_message(name: str, tmp_path: Path) -> None:
    path = MADE[name](tmp_path)
    path.write_bytes(b"this is not it" * 1000)
    with pytest.raises(InputError, match=path.name):
        registry.read([path], file_format=name, quantity="power" if name in PICTURES else None, frame=LocalEarth(*SITE))


def test_what_no_reader_knows_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "made.xyz"
    path.write_text("0 0 0")
    with pytest.raises(InputError, match=r"made\.xyz.*--format"):
        registry.read([path])
    with pytest.raises(InputError, match="missing"):
        registry.read([tmp_path / "missing"])
    with pytest.raises(InputError, match="only AFRL"):
        registry.read([mstar(tmp_path), mstar(tmp_path)])


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("writer", [write_mat, write_cphd])
def test_one_nan_in_phase_history_is_refused(value: float, writer: Callable[..., Path], tmp_path: Path) -> None:
    samples = SAMPLES.copy()
    samples[4, 5] = value
    path = writer(tmp_path / "made_HH.mat", samples, FREQUENCY_HZ, POSITIONS, *([LOOK] if writer is write_cphd else []))
    with pytest.raises(InputError, match=r"made_HH\.mat: 1 of 768 samples are NaN or infinite"):
        registry.read([path])


def test_no_pulses_are_refused(tmp_path: Path) -> None:
    path = write_cphd(tmp_path / "made.cphd", SAMPLES, FREQUENCY_HZ, POSITIONS, LOOK, bad=tuple(range(24)))
    with pytest.raises(InputError, match=r"made\.cphd.*no pulses"):
        registry.read([path])
    path = write_mat(tmp_path / "made_HH.mat", SAMPLES[:, :0], FREQUENCY_HZ, POSITIONS[:0])
    with pytest.raises(InputError, match=r"made_HH\.mat.*\(32, 0\)"):
        registry.read([path])


def test_matlab_without_its_fields_is_refused(tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"other": 1})
    with pytest.raises(InputError, match=r"a\.mat: no structure `data`.*other"):
        registry.read([tmp_path / "a.mat"])
    savemat(tmp_path / "b.mat", {"data": {"fp": np.ones((3, 3)), "freq": np.ones(3)}})
    with pytest.raises(InputError, match=r"b\.mat.*x, y, z, r0"):
        registry.read([tmp_path / "b.mat"])
    uneven = FREQUENCY_HZ + np.where(np.arange(32) == 7, 1e6, 0)
    with pytest.raises(InputError, match="not evenly spaced"):
        registry.read([write_mat(tmp_path / "c_HH.mat", SAMPLES, uneven, POSITIONS)])


def test_phoenix_header_fields_are_named_in_refusals(tmp_path: Path) -> None:
    magnitude = np.ones((4, 4))
    with pytest.raises(InputError, match="MeasuredDepression = 'steep'"):
        registry.read([write_phoenix(tmp_path / "a", magnitude, magnitude, MeasuredDepression="steep")])
    with pytest.raises(InputError, match="RadarPosition = 'left'"):
        registry.read([write_phoenix(tmp_path / "b", magnitude, magnitude, RadarPosition="left")])


def test_earth_formats_ask_where_the_world_lies(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--origin"):
        registry.read([nisar(tmp_path)])
    with pytest.raises(InputError, match="--origin"):
        registry.read([geotiff(tmp_path)], quantity="power")


def test_channel_of_another_polarization_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"0 channels of polarization VV; the file has 1 \(HH\)"):
        registry.read([cphd(tmp_path)], polarization="VV")
    with pytest.raises(InputError, match="no image of polarization VV"):
        registry.read([nisar(tmp_path)], polarization="VV", frame=LocalEarth(*SITE))


def test_speed_of_light_is_the_projects() -> None:
    from warpsar.world.frame import SPEED_OF_LIGHT

    assert SPEED_OF_LIGHT == C
