"""A page of the documentation whose files and commands a reader follows: both run in a copy of the repository."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
_PROGRAMS = {
    "python": [],
    "pytest": ["-m", "pytest"],
    "warpsar": ["-c", "from warpsar.cli.main import main; main()"],
}


class WrittenPage:
    """What a page of docs/ has its reader write (`files`, by their paths) and type (`commands`)."""

    def __init__(self, name: str) -> None:
        page = (ROOT / "docs" / name).read_text(encoding="utf-8")
        self.files: dict[str, str] = dict(
            re.findall(r"^`([\w./]+)`\n\n```(?:python|markdown)\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
        )
        shells = re.findall(r"^```sh\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
        self.commands = [line for block in shells for line in block.splitlines()]

    def checkout(self, root: Path) -> Path:
        """The repository with the page's files at `root`; `installed/` is the package as pip would lay it out."""
        for name in ("warpsar", "cli", "kernels", "tests", "docs", "data"):
            # with what Python has compiled, but for files that another process is writing just now
            shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("*.pyc.*", "figures"))
        shutil.copy(ROOT / "pyproject.toml", root)
        for name, text in self.files.items():
            path = root / name
            path.parent.mkdir(exist_ok=True)
            assert path.suffix == ".md" or not path.exists(), f"{name} is there already"
            path.write_text(_with(path.read_text(encoding="utf-8"), text) if path.exists() else text, encoding="utf-8")
        (root / "installed").mkdir()
        (root / "installed" / "warpsar").symlink_to(root / "warpsar")
        for name in ("cli", "kernels"):
            (root / "warpsar" / name).symlink_to(root / name)
        return root


def _with(page: str, text: str) -> str:
    """A page with a section at its end, or with a row at the end of its first table."""
    if not text.startswith("| "):
        return f"{page}\n{text}"
    rows = re.search(r"(?:^\|.*\n)+", page, re.MULTILINE)
    assert rows is not None
    return page[: rows.end()] + text + page[rows.end() :]


def run(command: str, checkout: Path) -> str:
    """What a command of the page says. Raises AssertionError, with all it said, where it fails."""
    program, *words = shlex.split(command)
    done = subprocess.run(
        [sys.executable, *_PROGRAMS[program], *words],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout / "installed")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout
