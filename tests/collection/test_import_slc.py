"""Complex images through `warpsar import`: phase, declared widths, and what `diagnose` does with them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from collected_scenes import scene
from measured_files import write_phoenix
from test_rough_ground import MATERIALS, yard

import warpsar
from warpsar.cli.main import main
from warpsar.collection.command import run
from warpsar.formats import registry
from warpsar.formats.base.data import Facts, ImageChip
from warpsar.formats.base.declared import WINDOWS
from warpsar.io import complex_image
from warpsar.measured.gridding import sample_complex
from warpsar.measured.importer import Imported, import_measured
from warpsar.world.tables import Origin
from warpsar.world.taper import width_in_cells

pytest.importorskip("sarkit")
RESOLUTION = (0.6, 0.7)
FINE, COARSE = ((120, 120), (0.3, 0.35)), ((60, 60), (0.6, 0.7))
FLOOR = 3e-4
AZIMUTHS = (0.0, 90.0, 180.0, 270.0)
PASSES = (40.0, 40.02)
"""Incidences of two passes [deg], a fiftieth of the critical baseline apart."""


def yard_scene(grid: tuple[tuple[int, int], tuple[float, float]], views: list[warpsar.View], **more: Any) -> Any:
    """The yard of `test_rough_ground`, from any directions."""
    made = scene(
        yard(),
        shape=grid[0],
        spacing=grid[1],
        radar={"terms": ("rough",)},
        collection={"focus": "direct", "resolution_m": RESOLUTION, "noise_beta0": FLOOR},
        origin=Origin(latitude_deg=48.1, longitude_deg=11.6, height_m=500.0),
    )
    return replace(made, views=views, materials={n: warpsar.Material(**(t | more)) for n, t in MATERIALS.items()})


def simulated(folder: Path, views: list[warpsar.View]) -> Path:
    """SICDs of the yard, at two pixels to a cell."""
    yard_scene(FINE, views).save(folder / "fine.toml")
    run(folder / "fine.toml", folder / "slc", "slc", device="cpu")
    return folder / "slc"


def imported(folder: Path, source: Path, views: list[warpsar.View], grid: Any = COARSE) -> tuple[Path, list[Imported]]:
    """The files on the grid of another scene, which has no collection."""
    path = folder / "measured.toml"
    effects = {"noise_floor": {"level": FLOOR}}
    replace(yard_scene(grid, views), collection=None, effects=effects).save(path)
    return path, [import_measured([source / f"{view.name}.nitf"], path, view.name, device="cpu") for view in views]


@pytest.fixture(scope="module")
def passes(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Imported], list[np.ndarray]]:
    """Two passes, imported onto the simulation's own grid; and the simulated images."""
    folder = tmp_path_factory.mktemp("passes")
    views = [warpsar.View(name=f"p{i}", azimuth_deg=0.0, incidence_deg=angle) for i, angle in enumerate(PASSES)]
    source = simulated(folder, views)
    path, done = imported(folder, source, views, FINE)
    return path, done, [complex_image.read(source / f"{view.name}.npz", "HH")[0] for view in views]


def test_the_complex_image_comes_back(passes: tuple[Path, list[Imported], list[np.ndarray]]) -> None:
    """At 10 km the wavefront bends by 10 mm over the yard, 4 hundredths of a pixel: what is left of the two images is
    a shift of that size, and what the border cuts off."""
    path, done, own = passes
    read = warpsar.Scene.load(path)
    inner = (slice(20, -20), slice(20, -20))
    for view, one, image in zip(read.views, done, own, strict=True):
        values, range_m, azimuth_m = complex_image.read(view.slc["HH"], "HH")
        assert values.shape == (len(range_m), len(azimuth_m))
        assert np.diff(range_m) == pytest.approx(FINE[1][0])
        assert np.abs(values) ** 2 == pytest.approx(
            one.power, rel=0.02, abs=0.005 * float(np.nanmax(one.power)), nan_ok=True
        )
        a, b = values[inner], image[inner]
        assert np.vdot(a, b) / np.linalg.norm(a) / np.linalg.norm(b) == pytest.approx(1.0, abs=0.01)


def test_two_imports_interfere_as_the_images_do(passes: tuple[Path, list[Imported], list[np.ndarray]]) -> None:
    """Coherence and phase of the two imports against those of the simulated images, and coherence against theory."""
    path, _, own = passes
    views = warpsar.Scene.load(path).views
    pair = [complex_image.read(view.slc["HH"], "HH")[0] for view in views]
    found, wanted = warpsar.coherence(*pair, (9, 9)), warpsar.coherence(*own, (9, 9))
    lit = (np.abs(wanted) > 0.9) & np.isfinite(found)
    assert lit.mean() > 0.1  # the yard, without its shadows, is 0.15 of the image
    assert np.abs(np.angle(found[lit] * wanted[lit].conj())).max() < 0.1
    assert np.median(np.abs(found[lit])) == pytest.approx(np.median(np.abs(wanted[lit])), abs=0.005)


def test_sicd_declares_point_spread(passes: tuple[Path, list[Imported], list[np.ndarray]]) -> None:
    path, done, _ = passes
    table = warpsar.Scene.load(path).effects["point_spread"]
    assert table["range_fwhm_m"] == pytest.approx(RESOLUTION[0], rel=0.02)
    assert table["azimuth_fwhm_m"] == pytest.approx(RESOLUTION[1], rel=0.02)
    assert table["window"] == "taylor"
    assert 0.05 * 0.6 <= table["tolerance"]["range_fwhm_m"] < 0.12 * 0.6
    assert not any("point_spread" in message or "contradicts" in message for one in done for message in one.messages)


def test_a_window_without_a_parameter_has_its_width() -> None:
    """The table of the standard's names against the tapers of our own focusing."""
    assert WINDOWS["UNIFORM"] == pytest.approx(width_in_cells("none"), abs=0.001)
    assert WINDOWS["HANNING"] == pytest.approx(width_in_cells("hann"), abs=0.001)


@pytest.fixture(scope="module")
def around(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[warpsar.View]]:
    """SICDs of the yard from four sides."""
    folder = tmp_path_factory.mktemp("around")
    views = [warpsar.View(name=f"v{i}", azimuth_deg=angle, incidence_deg=45.0) for i, angle in enumerate(AZIMUTHS)]
    return simulated(folder, views), views


def with_width(data: bytes, factor: float) -> bytes:
    """A SICD whose row width is wrong: another number of as many characters in its XML."""
    tag = b"<ImpRespWid>"
    start = data.index(tag) + len(tag)
    end = data.index(b"<", start)
    number = f"{factor * float(data[start:end]):.{end - start - 2}f}".encode()
    assert len(number) == end - start
    return data[:start] + number + data[end:]


def diagnosed(path: Path, status: int = 0) -> tuple[dict[str, Any], str]:
    out = path.parent / "out"
    words = ["diagnose", str(path), "-o", str(out), "--device", "cpu", "--draws", "400", "--starts", "0"]
    done = CliRunner().invoke(main, [*words, "--most-effects", "1"])
    assert done.exit_code == status, done.output
    return json.loads((out / "diagnosis.json").read_text(encoding="utf-8")), done.stderr


@pytest.mark.full
def test_diagnose_keeps_to_the_declared_width(around: tuple[Path, list[warpsar.View]], tmp_path: Path) -> None:
    path, done = imported(tmp_path, *around)
    assert all(one.samples_per_pixel == (2, 2) for one in done)
    content, _ = diagnosed(path)

    assert content["verdict"] == []
    assert content["leaves_tolerance"] == []


@pytest.mark.full
def test_a_width_that_is_declared_wrongly_is_told(around: tuple[Path, list[warpsar.View]], tmp_path: Path) -> None:
    """Three times the width: `import` holds it against the header's own band, and `diagnose` against the images."""
    source, views = around
    for view in views:
        data = (source / f"{view.name}.nitf").read_bytes()
        (tmp_path / f"{view.name}.nitf").write_bytes(with_width(data, 3.0))
    path, done = imported(tmp_path, tmp_path, views)
    assert any("ImpRespWid = 1.8 m contradicts ImpRespBW" in message for message in done[0].messages)
    content, said = diagnosed(path, status=4)

    assert "point_spread.range_fwhm_m" in content["leaves_tolerance"]
    assert "point_spread.range_fwhm_m leaves its tolerance: known as 1.8" in said


def test_phase_between_the_pixels_is_the_fields() -> None:
    """A band-limited periodic field off its carrier, in closed form, sampled far from the border.

    Splines of fifth order, on a spectrum that fills a fifth of their band."""
    random = np.random.default_rng(0)
    count, k = 64, np.arange(-20, 21)
    spectrum = random.normal(size=(41, 41)) + 1j * random.normal(size=(41, 41))

    def field(row: np.ndarray, column: np.ndarray) -> np.ndarray:
        left = np.exp(2j * np.pi * np.outer(row, k + 19) / count)
        return np.asarray(left @ spectrum @ np.exp(2j * np.pi * np.outer(column, k - 7) / count).T)

    pixels = np.arange(float(count))
    chip = ImageChip("made", field(pixels, pixels).astype(np.complex64), "complex", lambda _: Facts())
    rows, columns = np.linspace(20.3, 44.0, 60), np.linspace(20.0, 43.9, 47)
    found = sample_complex(chip, np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1))
    wanted = field(rows, columns)
    assert np.linalg.norm(found - wanted) < 5e-3 * np.linalg.norm(wanted)
    whole = sample_complex(chip, np.stack(np.meshgrid(pixels, pixels, indexing="ij"), axis=-1))
    assert np.array_equal(whole, chip.samples)


def test_a_chip_of_mstar_keeps_its_phase(tmp_path: Path) -> None:
    """Magnitude and phase of a Phoenix chip, on a grid of its own pixels: turned by 180 degrees, as its power is."""
    random = np.random.default_rng(0)
    magnitude, phase = random.rayleigh(size=(20, 24)), random.uniform(-3, 3, (20, 24))
    chip = write_phoenix(tmp_path / "chip", magnitude, phase)
    view = warpsar.View(name="v", azimuth_deg=30.0, incidence_deg=40.0)
    path = tmp_path / "scene.toml"
    replace(yard_scene(((20, 24), (0.5, 0.5)), [view]), collection=None).save(path)
    done = import_measured([chip], path, "v")
    assert done.slc_path is not None
    values = complex_image.read(done.slc_path, "HH")[0]
    assert np.abs(values) ** 2 == pytest.approx(done.power, rel=1e-5)
    assert values == pytest.approx(registry.read([chip]).samples[:, :], rel=1e-5)
    assert np.ptp(np.angle(values)) > 5.0


def test_another_import_leaves_no_samples_of_the_first(tmp_path: Path) -> None:
    """A detected image over a complex one: the view names no phase any more."""
    random = np.random.default_rng(0)
    chip = write_phoenix(tmp_path / "chip", random.rayleigh(size=(20, 24)), random.uniform(-3, 3, (20, 24)))
    np.save(tmp_path / "power.npy", random.exponential(size=(20, 24)).astype(np.float32))
    path = tmp_path / "scene.toml"
    view = warpsar.View(name="v", azimuth_deg=30.0, incidence_deg=40.0)
    replace(yard_scene(((20, 24), (0.5, 0.5)), [view]), collection=None).save(path)
    import_measured([chip], path, "v")
    assert set(warpsar.Scene.load(path).views[0].slc) == {"HH"}
    import_measured([tmp_path / "power.npy"], path, "v", quantity="power", polarization="HH")
    assert warpsar.Scene.load(path).views[0].slc == {}
