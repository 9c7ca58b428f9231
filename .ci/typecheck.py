#!/usr/bin/env python3
"""Type-check warpsar/, cli/ and kernels/ as the one package they are once installed, and leave no file out.

In the checkout `mypy -p warpsar` sees neither `warpsar.cli` nor `warpsar.kernels`: they lie in folders of
their own, put in place by setuptools' package-dir. So mypy gets a copy that is laid out as a wheel is.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PYPROJECT = ROOT / "pyproject.toml"
MYPY = [sys.executable, "-m", "mypy", f"--config-file={PYPROJECT}", "--cache-dir=/dev/null"]


def main() -> int:
    setuptools = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["tool"]["setuptools"]
    with tempfile.TemporaryDirectory() as folder:
        installed = Path(folder)
        for package, source in setuptools["package-dir"].items():
            shutil.copytree(ROOT / source, installed.joinpath(*package.split(".")), dirs_exist_ok=True)
        result = subprocess.run([*MYPY, "-p", "warpsar"], cwd=installed, stdout=subprocess.PIPE, text=True)
    print(result.stdout, end="")
    if result.returncode:
        return result.returncode

    there = sum(1 for room in ("warpsar", "cli", "kernels") for _ in (ROOT / room).rglob("*.py"))
    found = re.search(r"no issues found in (\d+) source file", result.stdout)
    checked = int(found[1]) if found else 0
    if checked != there:
        print(f"mypy checked {checked} files; warpsar/, cli/ and kernels/ hold {there}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
