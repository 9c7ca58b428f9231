"""docs/tutorial.md does what it says: its Python runs, in order, in an empty folder."""

import re
from pathlib import Path

import pytest

TUTORIAL = Path(__file__).resolve().parents[2] / "docs" / "tutorial.md"


@pytest.mark.full
def test_tutorial_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    text = TUTORIAL.read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    assert len(blocks) >= 5
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks:
        line = text[: text.index(block)].count("\n")
        exec(compile("\n" * line + block, str(TUTORIAL), "exec"), names)  # so that a traceback shows the page's line
    printed = capsys.readouterr().out
    assert re.search(r"test: deviance \d+\.\d\d, learned [01]\.\d{3} \+- 0\.\d{3}", printed)
    assert re.search(r"lawn\.eps_r: -?\d", printed)
    assert re.search(r"^brick: ", printed, re.MULTILINE)
