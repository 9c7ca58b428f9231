"""The notebooks in examples/ run, in seconds, and learn what they say."""

import re
import time
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "examples"


def printed(notebook: Any) -> str:
    return "".join(o.get("text", "") for cell in notebook["cells"] for o in cell.get("outputs", []) if "name" in o)


def run(name: str, folder: Path) -> tuple[str, str]:
    """What a notebook prints, and what it printed when it was stored. It draws, too, and takes less than a minute."""
    for library in ("torch", "nbclient", "nbformat", "ipykernel"):
        pytest.importorskip(library, reason=f"{library} is not installed: pip install 'warpsar[examples]'")
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(FOLDER / name, as_version=4)
    kept = printed(notebook)
    started = time.perf_counter()
    client = NotebookClient(notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": folder}})
    client.execute()
    assert time.perf_counter() - started < 60  # some 7 to 15 s on two cores, with kernels compiled
    assert any("image/png" in o.get("data", {}) for cell in notebook.cells for o in cell.get("outputs", []))
    return printed(notebook), kept


def test_a_network_learns_roughness(tmp_path: Path) -> None:
    found, stored = run("train-through-the-renderer.ipynb", tmp_path)
    pattern = r"error of the roughness height: ([\d.]+) % \(at the start 24 %\)"
    (error,), (kept,) = re.findall(pattern, found), re.findall(pattern, stored)
    assert float(error) < 6
    assert abs(float(error) - float(kept)) < 1


def test_a_height_is_found(tmp_path: Path) -> None:
    """Within three of the standard deviations that it says, from 3 m away."""
    found, stored = run("fit-a-height.ipynb", tmp_path)
    pattern = r"height: ([\d.]+) \+- ([\d.]+) m \(truth 6.00 m, start 9.00 m\)"
    ((height, sd),), ((kept, _),) = re.findall(pattern, found), re.findall(pattern, stored)
    assert float(sd) < 0.05
    assert abs(float(height) - 6.0) < 3.0 * float(sd)
    assert abs(float(height) - float(kept)) <= 0.01
