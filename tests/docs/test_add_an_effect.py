"""docs/add-an-effect.md does what it says: its files and commands, in a copy of the repository."""

import json
import re
from pathlib import Path

import pytest
from written_page import WrittenPage, run

SLOPE_DB_PER_M = 0.05


@pytest.mark.full
def test_a_reader_gets_from_nothing_to_a_diagnosis_that_finds_it(tmp_path: Path) -> None:
    page = WrittenPage("add-an-effect.md")
    assert len(page.files) == 5
    checkout = page.checkout(tmp_path)
    tests, make, diagnose = page.commands
    said = run(tests, checkout)
    # its own physics, and of all effects' tests: its tables, tests and section, its image, neutral values, derivatives
    passed = re.search(r"(\d+) passed", said)
    assert passed is not None
    assert int(passed[1]) >= 10
    run(make, checkout)
    assert run(diagnose, checkout).startswith("azimuth_drift; edges agree to ")
    found = json.loads((checkout / "out" / "found" / "diagnosis.json").read_text())
    assert found["verdict"] == ["azimuth_drift"]
    at = found["identifiability"]["parameters"].index("azimuth_drift.db_per_m")
    span = 0.1  # of the page's Parameter: a unit of the coordinate that is learned
    error = span * found["identifiability"]["standard_deviation"][at]
    assert error < 0.2 * SLOPE_DB_PER_M
    assert abs(found["effects"]["azimuth_drift"]["db_per_m"] - SLOPE_DB_PER_M) < 3.5 * error
