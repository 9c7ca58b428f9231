"""A phase error in an own SICD or CPHD, through `warpsar import` to what `diagnose` asks of the phase."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from collected_scenes import ROUGH, WAVELENGTH, scene
from worlds import mesh_of, plate

import warpsar
from warpsar.collection.command import run
from warpsar.diagnosis.phase.declared import PhaseAsked, ask_phase, named_in, with_phase_errors
from warpsar.effects.base.product import Product
from warpsar.measured.importer import import_measured
from warpsar.world.collection import CollectionErrors
from warpsar.world.tables import Origin
from warpsar.world.taper import width_in_cells

pytest.importorskip("sarkit")
TURN = 2.0 * np.pi
VIEW = warpsar.View(name="v0", azimuth_deg=0.0, incidence_deg=45.0)
PIXELS, FINE_M = 160, (0.3, 0.35)
"""Two pixels to a cell."""
BLUR = {"range_fwhm_m": 0.6, "azimuth_fwhm_m": 0.7, "window": "taylor"}
BRIGHT = {"eps_r": 80.0, "rms_height_m": 0.003, "correlation_length_m": 0.03}
NOISE = {"noise_floor": {"level": 3e-4}}


def lawn(width_m: float = 120.0) -> warpsar.Mesh:
    return mesh_of(soil=plate((-0.5 * width_m, -60.0, 0.0), (width_m, 0.0, 0.0), (0.0, 120.0, 0.0)))


def lawn_with_plates() -> warpsar.Mesh:
    """Twenty gently rough plates of half a metre that face the radar: each in one cell, far brighter than the lawn."""
    random, vertices, faces = np.random.default_rng(4), [], []
    for k in range(20):
        x, y = random.uniform(-15.0, 15.0), random.uniform(-25.0, 25.0)
        corners, triangles = plate((x, y, 0.3), (0.0, -0.35, 0.35), (0.5, 0.0, 0.0))
        vertices.append(corners)
        faces.append(triangles + k * len(corners))
    soil = plate((-60.0, -60.0, 0.0), (120.0, 0.0, 0.0), (0.0, 120.0, 0.0))
    return mesh_of(soil=soil, plates=(np.concatenate(vertices), np.concatenate(faces)))


def asked_of(
    folder: Path, mesh: warpsar.Mesh, quadratic_rad: float, product: Product = "slc", **collection: Any
) -> tuple[warpsar.Scene, PhaseAsked]:
    """The scene of the imported SICD or CPHD, which declares no phase error, and what is said of its view."""
    made: Any = scene(
        mesh,
        shape=(PIXELS, PIXELS),
        spacing=FINE_M,
        radar={"terms": ("rough",)},
        collection={"focus": "direct" if product == "slc" else "backprojection", "resolution_m": None} | collection,
        origin=Origin(latitude_deg=48.1, longitude_deg=11.6, height_m=500.0),
    )
    error = {"phase_error": {"quadratic_rad": {"v0": quadratic_rad}}} if quadratic_rad else {}
    materials = {name: warpsar.Material(**(BRIGHT if name == "plates" else ROUGH)) for name in mesh.materials}
    made = replace(made, views=[VIEW], materials=materials, effects={"point_spread": BLUR, **NOISE, **error})
    made.save(folder / "fine.toml")
    run(folder / "fine.toml", folder / product, product, device="cpu")
    grid = warpsar.Grid(shape=(PIXELS // 2, PIXELS // 2), spacing_m=(2.0 * FINE_M[0], 2.0 * FINE_M[1]))
    seen = [VIEW.model_copy(update={key: collection[key] for key in ("slant_range_m",) if key in collection})]
    replace(made, collection=None, grid=grid, effects=NOISE, views=seen).save(folder / "measured.toml")
    source = folder / product / ("v0.nitf" if product == "slc" else "v0.cphd")
    windows = {} if product == "slc" else {"window_range": "taylor", "window_azimuth": "taylor"}
    import_measured([source], folder / "measured.toml", "v0", samples=(2, 2), device="cpu", **windows)
    read = warpsar.Scene.load(folder / "measured.toml")
    (found,) = ask_phase(read)
    return read, found


@pytest.mark.full
@pytest.mark.parametrize("mesh", [lawn_with_plates(), lawn(22.0)], ids=["points", "edges"])
def test_an_error_in_an_own_sicd_is_named_and_measured(mesh: warpsar.Mesh, tmp_path: Path) -> None:
    """2 pi at the band's edge, to 5 %: from bright plates, and from a lawn that ends in the image."""
    read, one = asked_of(tmp_path, mesh, TURN)
    assert one.found.outcome == "named", one.words
    table = with_phase_errors(read, [one]).effects["phase_error"]
    assert table["quadratic_rad"]["v0"] == pytest.approx(TURN, rel=0.05)
    assert table["fixed"] is True
    (again,) = ask_phase(with_phase_errors(read, [one]))
    assert again.found.outcome == "declared"


@pytest.mark.full
def test_an_error_in_an_own_cphd_is_named_and_measured(tmp_path: Path) -> None:
    """The phase history is focused by `import`, which declares its blur, and the error is that of the pulses."""
    read, one = asked_of(tmp_path, lawn_with_plates(), TURN, "phase-history")
    spread = read.effects["point_spread"]
    assert (spread["range_fwhm_m"], spread["azimuth_fwhm_m"]) == pytest.approx((0.6, 0.7), rel=0.01)
    assert spread["window"] == "taylor"
    assert one.found.outcome == "named", one.words
    assert one.table()["quadratic_rad"] == pytest.approx(TURN, rel=0.05)


@pytest.mark.full
@pytest.mark.parametrize(("along_rad", "across_rad"), [(0.0, TURN), (3.1, 4.4)], ids=["across", "a mix"])
def test_an_error_of_the_track_is_told_from_one_of_the_phase(
    along_rad: float, across_rad: float, tmp_path: Path
) -> None:
    """A recorded track that leaves the true one across the line of sight: no range in the middle has an error, and
    those at the ends have 2 pi, in proportion to the sine of the angle between their look directions. And one that
    leaves it along the line of sight, too: all ranges have that part, and a search for it alone finds too little."""
    slant, speed = 500.0, 100.0
    angle = np.deg2rad(VIEW.incidence_deg)
    far = slant + 0.5 * PIXELS * FINE_M[0]
    widest = np.sin(np.arccos(slant * np.cos(angle) / (2.0 * slant - far)) - angle)  # the nearer end
    error_m = across_rad * WAVELENGTH / (4.0 * np.pi * abs(widest))
    along_m = along_rad * WAVELENGTH / (4.0 * np.pi)
    aperture_rad = width_in_cells("taylor") * WAVELENGTH / (2.0 * BLUR["azimuth_fwhm_m"])
    half_s = 0.5 * slant * aperture_rad / speed
    toward = np.array(
        [0.0, np.cos(angle), -np.sin(angle)]
    )  # as the look direction turns with range; the radar is north
    line = np.array([0.0, np.sin(angle), np.cos(angle)])
    most = error_m * toward + along_m * line
    time = np.linspace(-1.1 * half_s, 1.1 * half_s, 201)
    rows = [",".join(f"{value:.9f}" for value in (t, *((t / half_s) ** 2 * most))) for t in time]
    path = tmp_path / "error.csv"
    path.write_text("time_s,x_m,y_m,z_m\n" + "\n".join(rows) + "\n", encoding="utf-8")
    more = {"slant_range_m": slant, "speed_m_s": speed, "errors": CollectionErrors(track=path)}
    _, one = asked_of(tmp_path, lawn_with_plates(), 0.0, "phase-history", **more)
    assert one.motion is not None
    assert one.motion.outcome == "named", one.words
    assert one.aside_m * one.motion.aside[0] == pytest.approx(error_m, rel=0.05), one.words
    assert one.motion.same[0] == pytest.approx(along_rad, abs=0.05 * TURN)
    assert named_in([one]) == ["motion_error"]


@pytest.mark.full
def test_plates_without_an_error_are_told_so(tmp_path: Path) -> None:
    _, one = asked_of(tmp_path, lawn_with_plates(), 0.0)
    assert one.found.outcome == "absent", one.words


@pytest.mark.full
def test_a_lawn_alone_cannot_tell(tmp_path: Path) -> None:
    """Homogeneous speckle has the same distribution under any phase."""
    _, one = asked_of(tmp_path, lawn(), TURN)
    assert one.found.outcome == "not testable", one.words
