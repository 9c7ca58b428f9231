"""docs/getting-started.md does what it says: its commands run as written, and the diagnosis names what it hid."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "getting-started.md"


@pytest.mark.slow
def test_getting_started_runs(tmp_path: Path) -> None:
    text = PAGE.read_text(encoding="utf-8")
    (script,) = re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    install, *commands = re.findall(r"^```sh\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    assert install.startswith("python3 -m venv")  # README's commands, which .ci/run types, install the same way
    (tmp_path / "data").symlink_to(ROOT / "data")
    (tmp_path / "measure.py").write_text(script, encoding="utf-8")
    programs = {"warpsar": [sys.executable, "-m", "warpsar"], "python": [sys.executable]}
    printed = ""
    for command in commands:
        program, *arguments = command.split()
        run = [*programs[program], *arguments]
        printed += subprocess.run(run, cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    assert all((tmp_path / "out" / "example" / f"{name}.exr").is_file() for name in ("north", "south", "west"))
    assert json.loads((tmp_path / "out" / "diagnosed" / "diagnosis.json").read_text())["verdict"] == ["noise_floor"]
    for line in re.findall(r"^    (\w.*deviance.*)$", text, re.MULTILINE):
        words = [re.escape(part) for part in re.split(r"\d+\.\d+", line)]
        assert re.search(r"\d+\.\d+".join(words), printed), line
