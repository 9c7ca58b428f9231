"""The costs of the measured studies: the READMEs' commands are found, and each is measured by itself."""

import json
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, benchmark


@pytest.fixture(scope="module")
def costs() -> Any:
    return benchmark("measured_costs")


def test_every_study_says_its_commands_and_its_data(costs: Any) -> None:
    where = (ROOT / "docs" / "measured.md").read_text(encoding="utf-8")
    folders = {path.name for path in (ROOT / "examples" / "measured").iterdir() if path.is_dir()}
    assert set(costs.studies()) == folders
    for name in folders:
        commands, data = costs.commands(name)
        assert "warpsar diagnose" in commands or "warpsar evaluate" in commands
        assert f"`{data}" in where


def test_a_command_in_short(costs: Any) -> None:
    assert costs.label(["diagnose", "scene.toml", "-o", "diagnosed"]) == "diagnose"
    assert costs.label(["evaluate", "diagnosed/scene.toml"]) == "evaluate"
    assert costs.label(["diagnose", "plate.toml", "-o", "diagnosed_plate"]) == "diagnose plate.toml"


def test_times_of_a_command_that_is_given_again_are_added(costs: Any) -> None:
    rows = [
        {"command": name, "wall_s": k, "cpu_s": 2 * k, "peak_gib": k}
        for name, k in [("import", 2), ("learn", 5), ("import", 1)]
    ]
    of_import, of_learn = costs.added(rows)
    assert of_import == {"command": "import", "wall_s": 3, "cpu_s": 6, "peak_gib": 2}
    assert of_learn == rows[1]


@pytest.mark.parametrize(("words", "status"), [(["evaluate", "--help"], 0), (["evaluate", "no such scene.toml"], 2)])
def test_a_command_is_measured(
    costs: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], status: int
) -> None:
    """An interpreter with click alone takes more than 5 MiB, and some milliseconds."""
    monkeypatch.setenv(costs.LOG, str(tmp_path / "log.jsonl"))
    monkeypatch.setenv(costs.DEVICE, "cpu")
    assert costs.stand_in(words) == status
    (row,) = map(json.loads, (tmp_path / "log.jsonl").read_text().splitlines())
    assert row["exit_status"] == status
    assert row["wall_s"] > 0.0
    assert row["cpu_s"] > 0.001
    assert 0.005 < row["peak_gib"] < 1.0


def test_a_study_whose_commands_fail_is_refused(costs: Any, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="slicy: failed: import"):
        costs.one_run(("slicy", "cpu"), str(tmp_path))
