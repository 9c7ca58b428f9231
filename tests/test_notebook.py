"""The notebook in examples/ runs, in seconds, and learns what it says."""

import re
import time
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).resolve().parent.parent / "examples" / "train-through-the-renderer.ipynb"


def printed(notebook: object) -> str:
    cells = notebook["cells"]  # type: ignore[index]
    return "".join(o.get("text", "") for cell in cells for o in cell.get("outputs", []) if o.get("name") == "stdout")


def test_notebook_runs(tmp_path: Path) -> None:
    for library in ("torch", "nbclient", "nbformat", "ipykernel"):
        pytest.importorskip(library, reason=f"{library} is not installed: pip install 'warpsar[examples]'")
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(NOTEBOOK, as_version=4)
    kept = printed(notebook)
    started = time.perf_counter()
    client = NotebookClient(notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": tmp_path}})
    client.execute()
    assert time.perf_counter() - started < 60  # some 7 s on two cores, with kernels compiled
    pattern = r"error of the roughness height: ([\d.]+) % \(at the start 24 %\)"
    (found,), (stored,) = re.findall(pattern, printed(notebook)), re.findall(pattern, kept)
    assert float(found) < 6
    assert abs(float(found) - float(stored)) < 1
    assert any("image/png" in o.get("data", {}) for cell in notebook.cells for o in cell.get("outputs", []))
