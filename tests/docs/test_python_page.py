"""docs/python.md does what it says: its Python runs, in order, in an empty folder."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "python.md"
TEXT = PAGE.read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
OPTIONAL = ("torch", "jax")


def run(blocks: list[str]) -> None:
    names: dict[str, object] = {}
    for block in blocks:
        line = TEXT[: TEXT.index(block)].count("\n")
        exec(compile("\n" * line + block, str(PAGE), "exec"), names)  # so that a traceback shows the page's line


def needs(block: str, library: str) -> bool:
    return f"import {library}\n" in block


@pytest.mark.full
def test_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    run([block for block in BLOCKS if not any(needs(block, library) for library in OPTIONAL)])
    printed = capsys.readouterr().out
    assert "south (32, 32) float32" in printed
    assert "found index 3; must be from 0 to 2: there are 3 vertices" in printed
    (eps_r,) = re.findall(r"eps_r of the lawn: ([\d.]+)", printed)
    assert abs(float(eps_r) - 6.0) < 0.5
    assert re.search(r"deviance: [01]\.\d\d", printed)
    assert (tmp_path / "site_mesh.obj").is_file()
    assert re.search(r"^materials.lawn.eps_r 6.0 1.01 300.0$", printed, re.MULTILINE)


@pytest.mark.full
@pytest.mark.parametrize("library", OPTIONAL)
def test_optional_blocks_run(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip(library, reason=f"{library} is not installed: pip install 'warpsar[{library}]'")
    monkeypatch.chdir(tmp_path)
    others = [other for other in OPTIONAL if other != library]
    run([block for block in BLOCKS if not any(needs(block, other) for other in others)])
    printed = capsys.readouterr().out
    found = {"torch": r"eps_r by PyTorch: (6.0|5.9|6.1)$", "jax": r"slope by JAX: -\d"}[library]
    assert re.search(found, printed, re.MULTILINE), printed
