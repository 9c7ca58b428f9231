"""`rcs` says before the work how long it takes, and refuses what does not fit into the memory allowed."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from warpsar.cli.main import main
from warpsar.coherent import forecast as forecasting
from warpsar.coherent.forecast import forecast
from warpsar.coherent.rcs import RcsRequest, swept, working_gib
from warpsar.coherent.sweep import RAYS_PER_WAVELENGTH
from warpsar.errors import InputError
from warpsar.scene.scene import Scene

pytestmark = pytest.mark.unit

TRIHEDRAL = Path(__file__).resolve().parents[2] / "data" / "coherent" / "trihedral.toml"


def asked(scene: Scene, azimuths: list[float], gib: float | None = None) -> RcsRequest:
    return RcsRequest.of(scene, azimuths, [60.0], None, "cpu", RAYS_PER_WAVELENGTH, max_memory_gib=gib)


def test_the_tubes_of_a_forecast(monkeypatch: pytest.MonkeyPatch) -> None:
    """It counts the tubes of all directions: each ray of the sweep meets a face or none."""
    monkeypatch.setattr(forecasting, "LONG_S", 0.0)
    scene = Scene.load(TRIHEDRAL)
    few, many = (forecast(scene, asked(scene, azimuths)) for azimuths in ([45.0], [30.0, 45.0, 45.0, 60.0]))
    assert few is not None
    assert many is not None
    assert (few.directions, many.directions) == (1, 4)
    assert 2.0 * few.tubes < many.tubes < 6.0 * few.tubes
    assert 0 < swept(scene, asked(scene, [45.0])).segments <= scene.radar.max_bounces * few.tubes
    assert "1 direction, " in str(few)
    assert " tubes: about " in str(many)


def test_short_work_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forecasting, "LONG_S", 3600.0)
    scene = Scene.load(TRIHEDRAL)
    assert forecast(scene, asked(scene, [45.0])) is None


def test_what_does_not_fit_is_refused() -> None:
    scene = Scene.load(TRIHEDRAL)
    needed = working_gib(scene, asked(scene, [45.0]), False)
    assert len(asked(scene, [45.0], 1.01 * needed + 1.0).directions) == 1
    with pytest.raises(InputError, match=r"--max-memory allows .* GiB|must be up to .* GiB"):
        asked(scene, [45.0], 0.5 * needed)


def test_on_the_console(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forecasting, "LONG_S", 0.0)
    words = ["rcs", str(TRIHEDRAL), "--azimuths", "45", "--incidences", "60", "--device", "cpu", "-o"]
    done = CliRunner().invoke(main, [*words, str(tmp_path / "refused"), "--max-memory", "0.001"])
    assert done.exit_code == 2
    assert not (tmp_path / "refused").exists()
    done = CliRunner().invoke(main, [*words, str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert done.stderr.index(" tubes: about ") < done.stderr.index("rcs.csv")
