"""A phase error in an own SICD, through `warpsar import` to what `diagnose` asks of the phase."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from collected_scenes import field, scene
from test_import_slc import COARSE, FINE, imported, yard_scene

import warpsar
from warpsar.collection.command import run
from warpsar.diagnosis.phase.declared import PhaseAsked, ask_phase, with_phase_errors
from warpsar.world.tables import Origin

pytest.importorskip("sarkit")
TURN = 2.0 * np.pi
VIEW = warpsar.View(name="v0", azimuth_deg=0.0, incidence_deg=45.0)


def asked_of(folder: Path, made: warpsar.Scene, quadratic_rad: float) -> tuple[warpsar.Scene, PhaseAsked]:
    """The scene of the imported SICD, which declares no phase error, and what is said of its view."""
    if quadratic_rad:
        made = replace(made, effects={**made.effects, "phase_error": {"quadratic_rad": {"v0": quadratic_rad}}})
    made.save(folder / "fine.toml")
    run(folder / "fine.toml", folder / "slc", "slc", device="cpu")
    path, _ = imported(folder, folder / "slc", [VIEW], COARSE)
    read = warpsar.Scene.load(path)
    (found,) = ask_phase(read)
    return read, found


@pytest.mark.full
def test_an_error_in_an_own_sicd_is_named_and_measured(tmp_path: Path) -> None:
    """A yard with a wall, a roof and their shadows: edges, and no points. 2 pi at the band's edge, to 5 %."""
    read, one = asked_of(tmp_path, yard_scene(FINE, [VIEW]), TURN)
    assert one.found.outcome == "named", one.words
    table = with_phase_errors(read, [one]).effects["phase_error"]
    assert table["quadratic_rad"]["v0"] == pytest.approx(TURN, rel=0.05)
    assert table["fixed"] is True


@pytest.mark.full
def test_a_yard_without_an_error_is_told_so(tmp_path: Path) -> None:
    _, one = asked_of(tmp_path, yard_scene(FINE, [VIEW]), 0.0)
    assert one.found.outcome == "absent", one.words


@pytest.mark.full
def test_a_lawn_alone_cannot_tell(tmp_path: Path) -> None:
    """Homogeneous speckle has the same distribution under any phase."""
    lawn: Any = scene(
        field(80.0, 80.0),
        shape=FINE[0],
        spacing=FINE[1],
        radar={"terms": ("rough",)},
        collection={"focus": "direct", "resolution_m": (0.6, 0.7)},
        origin=Origin(latitude_deg=48.1, longitude_deg=11.6, height_m=500.0),
    )
    _, one = asked_of(tmp_path, replace(lawn, views=[VIEW]), TURN)
    assert one.found.outcome == "not testable", one.words
