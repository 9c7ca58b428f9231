"""The gate's type check sees every file of the three packages; needs the extra `dev`."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

pytest.importorskip("mypy", reason="mypy comes with the extra `dev`")

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["package-dir"]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """The type check and its settings, over packages that hold one sound module each."""
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "typecheck.py", tmp_path / ".ci")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for folder in PACKAGES.values():
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "__init__.py").touch()
        (tmp_path / folder / "sound.py").write_text("def one() -> int:\n    return 1\n", encoding="utf-8")
    return tmp_path


def typecheck(checkout: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, checkout / ".ci" / "typecheck.py"], capture_output=True, text=True)


def test_sound_packages_pass(checkout: Path) -> None:
    done = typecheck(checkout)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"no issues found in {2 * len(PACKAGES)} source files" in done.stdout


@pytest.mark.full
def test_an_error_is_found_in_every_package(checkout: Path) -> None:
    for folder in PACKAGES.values():
        (checkout / folder / "wrong.py").write_text("nothing: int = missing\n", encoding="utf-8")
    done = typecheck(checkout)
    assert done.returncode != 0
    for package in PACKAGES:
        assert f"{package.replace('.', '/')}/wrong.py:1: error: " in done.stdout


@pytest.mark.full
def test_a_file_left_out_of_any_package_is_an_error(checkout: Path) -> None:
    for folder in PACKAGES.values():
        (checkout / folder / "orphan.py").touch()
    settings = checkout / "pyproject.toml"
    text = settings.read_text(encoding="utf-8")
    settings.write_text(text.replace("[tool.mypy]", '[tool.mypy]\nexclude = ["orphan"]'), encoding="utf-8")
    done = typecheck(checkout)
    assert done.returncode == 1
    sound = 2 * len(PACKAGES)
    assert f"mypy checked {sound} files; warpsar/, cli/ and kernels/ hold {sound + len(PACKAGES)}" in done.stderr
