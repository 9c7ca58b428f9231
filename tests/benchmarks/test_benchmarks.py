"""Every file of benchmarks/ can be imported, and what the timing of diagnose wraps is there.

A fresh process imports them, with benchmarks/ first on its path as where one is run: a name like `effects` is a file of
benchmarks/ there and a folder of tests/ here.
"""

import ast
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from conftest import ROOT

FILES = sorted(path.stem for path in (ROOT / "benchmarks").glob("*.py"))

IMPORT_ALL = """
import importlib, json, sys, traceback
folder, *names = sys.argv[1:]
sys.path.pop(0)
said = {}
for name in names:
    sys.path[:] = [folder, *(each for each in sys.path if each != folder)]  # first again: files put others before it
    try:
        importlib.import_module(name)
    except BaseException as error:
        said[name] = {"missing": getattr(error, "name", None), "text": traceback.format_exc()}
print(json.dumps(said))
"""

PLACES = """
import json, sys
sys.path[0] = sys.argv[1]
import diagnosis_time as timed
places = [*timed.WORK.values(), *(place for phase in timed.PHASES.values() for place in phase)]
print(json.dumps([f"{holder.__name__}.{name}" for holder, name in places if not callable(getattr(holder, name, None))]))
"""

ONE_FAILS = """
import json, sys
from pathlib import Path
sys.path[0] = sys.argv[1]
import click, runs
folder = Path(sys.argv[2])
try:
    runs.append(folder, ['{"number": 1}', 'no JSON', '{"number": 2}'], json.loads, str, jobs=2)
except click.ClickException as error:
    print(json.dumps([error.message, sorted(row["number"] for row in runs.stored(folder))]))
"""


def fresh(code: str, folder: Path, *words: str) -> object:
    """What a program prints, as JSON. It runs in a process of its own."""
    done = subprocess.run([sys.executable, "-c", code, str(folder), *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def failures(folder: Path, names: list[str]) -> dict[str, dict[str, str | None]]:
    """By file: the module that its import did not find, if that was it, and the traceback."""
    said = fresh(IMPORT_ALL, folder, *names)
    assert isinstance(said, dict)
    return said


def optional() -> set[str]:
    """Libraries that an extra of pyproject.toml brings, as they are imported."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    return {re.split(r"[\[<>=]", one)[0].replace("-", "_") for each in extras.values() for one in each} - {"warpsar"}


@pytest.fixture(scope="module")
def failed() -> dict[str, dict[str, str | None]]:
    return failures(ROOT / "benchmarks", FILES)


@pytest.mark.full
@pytest.mark.parametrize("name", FILES)
def test_a_benchmark_can_be_imported(name: str, failed: dict[str, dict[str, str | None]]) -> None:
    if name in failed:
        missing = failed[name]["missing"] or ""
        if missing.partition(".")[0] in optional():
            pytest.skip(f"{missing} comes with an extra, and is not installed")
        pytest.fail(str(failed[name]["text"]))


def test_a_benchmark_that_cannot_be_imported_is_found(tmp_path: Path) -> None:
    for name, text in {
        "effects": "HERE = 1",
        "sound": "from effects import HERE",
        "moved": "from warpsar.diagnosis import no_such_module",
        "leaves": "raise SystemExit",
        "lacks": "import sarpy_of_nobody",
    }.items():
        (tmp_path / f"{name}.py").write_text(text)
    found = failures(tmp_path, ["effects", "sound", "moved", "leaves", "lacks"])
    assert set(found) == {"moved", "leaves", "lacks"}
    assert "no_such_module" in str(found["moved"]["text"])
    assert found["lacks"]["missing"] == "sarpy_of_nobody"
    assert found["lacks"]["missing"] not in optional()


@pytest.mark.full
def test_what_the_timing_of_diagnose_wraps_is_there() -> None:
    """It wraps by name what the search calls: a name that has moved would be found only when it runs."""
    assert fresh(PLACES, ROOT / "benchmarks") == []


def test_no_circle_of_benchmarks() -> None:
    """A file that imports itself, through others; imports for types alone count, too."""
    below = {
        name: {
            imported.split(".")[0]
            for node in ast.walk(ast.parse((ROOT / "benchmarks" / f"{name}.py").read_text(encoding="utf-8")))
            for imported in (
                [alias.name for alias in node.names]
                if isinstance(node, ast.Import)
                else [node.module or ""]
                if isinstance(node, ast.ImportFrom)
                else []
            )
        }
        & set(FILES)
        for name in FILES
    }
    assert below["rcs_trials"] >= {"rcs_dipoles", "rcs_revolved"}

    def reached(name: str) -> set[str]:
        found, waiting = set[str](), list(below[name])
        while waiting:
            one = waiting.pop()
            if one not in found:
                found.add(one)
                waiting += below[one]
        return found

    assert [name for name in FILES if name in reached(name)] == []


def test_a_run_that_fails_leaves_the_others(tmp_path: Path) -> None:
    found = fresh(ONE_FAILS, ROOT / "benchmarks", str(tmp_path))
    assert found == ["1 runs failed; they are not stored", [1, 2]]
