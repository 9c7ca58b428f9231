"""docs/add-an-effect.md does what it says: its files and commands, in a copy of the repository."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "add-an-effect.md").read_text(encoding="utf-8")
FILES: dict[str, str] = dict(
    re.findall(r"^`([\w./]+)`\n\n```(?:python|markdown)\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
)
COMMANDS = [
    line for block in re.findall(r"^```sh\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE) for line in block.splitlines()
]
SLOPE_DB_PER_M = 0.05


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The repository with the page's files; `installed/` is the package as pip would lay it out."""
    root = tmp_path_factory.mktemp("checkout")
    for name in ("warpsar", "cli", "kernels", "tests", "docs", "data"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__", "figures"))
    shutil.copy(ROOT / "pyproject.toml", root)
    for name, text in FILES.items():
        path = root / name
        path.parent.mkdir(exist_ok=True)
        before = path.read_text(encoding="utf-8") + "\n" if path.suffix == ".md" else ""
        assert before or not path.exists(), f"{name} is there already"
        path.write_text(before + text, encoding="utf-8")
    (root / "installed").mkdir()
    (root / "installed" / "warpsar").symlink_to(root / "warpsar")
    for name in ("cli", "kernels"):
        (root / "warpsar" / name).symlink_to(root / name)
    return root


def run(command: str, checkout: Path) -> str:
    program, *words = shlex.split(command)
    python = {
        "python": [],
        "pytest": ["-m", "pytest"],
        "warpsar": ["-c", "from warpsar.cli.main import main; main()"],
    }[program]
    done = subprocess.run(
        [sys.executable, *python, *words],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout / "installed")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def test_a_reader_gets_from_nothing_to_a_diagnosis_that_finds_it(checkout: Path) -> None:
    assert len(FILES) == 5
    tests, make, diagnose = COMMANDS
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
