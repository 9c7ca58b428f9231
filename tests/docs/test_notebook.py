"""The notebooks in examples/ run, in seconds, and learn what they say."""

import math
import re
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "examples"


def printed(notebook: Any) -> str:
    return "".join(o.get("text", "") for cell in notebook["cells"] for o in cell.get("outputs", []) if "name" in o)


def run(name: str, folder: Path, *needs: str) -> tuple[str, str]:
    """What a notebook prints, and what it printed when it was stored. It draws, too."""
    for library in (*needs, "nbclient", "nbformat", "ipykernel"):
        pytest.importorskip(library, reason=f"{library} is not installed: pip install 'warpsar[examples]'")
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(FOLDER / name, as_version=4)
    kept = printed(notebook)
    client = NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": folder}})
    client.execute()
    assert any("image/png" in o.get("data", {}) for cell in notebook.cells for o in cell.get("outputs", []))
    return printed(notebook), kept


@pytest.mark.full
def test_a_network_learns_roughness(tmp_path: Path) -> None:
    found, stored = run("train-through-the-renderer.ipynb", tmp_path, "torch")
    pattern = r"error of the roughness height: ([\d.]+) % \(at the start 24 %\)"
    (error,), (kept,) = re.findall(pattern, found), re.findall(pattern, stored)
    assert float(error) < 6
    assert abs(float(error) - float(kept)) < 1


@pytest.mark.full
def test_a_height_is_found(tmp_path: Path) -> None:
    """Within three of the standard deviations that it says, from 3 m away."""
    found, stored = run("fit-a-height.ipynb", tmp_path, "torch")
    pattern = r"height: ([\d.]+) \+- ([\d.]+) m \(truth 6.00 m, start 9.00 m\)"
    ((height, sd),), ((kept, _),) = re.findall(pattern, found), re.findall(pattern, stored)
    assert float(sd) < 0.05
    assert abs(float(height) - 6.0) < 3.0 * float(sd)
    assert abs(float(height) - float(kept)) <= 0.01


@pytest.mark.full
def test_a_first_image(tmp_path: Path) -> None:
    """The foot of the wall, from (-1, -4) to (-1, 8) m, ends at -1.5 and 1.2 m of slant range; a pixel has 0.25 m."""
    found, stored = run("first-image.ipynb", tmp_path)
    assert found == stored
    ((near, far),) = re.findall(r"corner of wall and lawn: ([+-][\d.]+) to ([+-][\d.]+) m", found)
    looking = (math.sin(math.radians(70.0)), math.cos(math.radians(70.0)))
    ends = [(-1.0 * looking[0] + y * looking[1]) * math.sin(math.radians(40.0)) for y in (-4.0, 8.0)]
    assert abs(float(near) - ends[0]) < 0.3
    assert abs(float(far) - ends[1]) < 0.3


@pytest.mark.full
def test_surfaces_are_learned(tmp_path: Path) -> None:
    """To the speckle floor: 3,000 pixels of the test view leave about 0.02 of noise in its deviance."""
    found, stored = run("learn.ipynb", tmp_path)
    pattern = r"test deviance: ([\d.]+) at the start, ([\d.]+) learned"
    ((start, learned),), ((_, kept),) = re.findall(pattern, found), re.findall(pattern, stored)
    assert float(start) > 3.0
    assert abs(float(learned) - 1.0) < 0.06
    assert abs(float(learned) - float(kept)) < 0.01


@pytest.mark.slow
def test_hidden_noise_is_named(tmp_path: Path) -> None:
    found, stored = run("diagnose.ipynb", tmp_path)
    assert "verdict: noise_floor\n" in found
    assert "verdict: noise_floor\n" in stored
    ((level,),) = (re.findall(r"level: ([\d.]+) \(hidden: 0.0040\)", found),)
    assert abs(float(level) - 0.004) < 0.001


@pytest.mark.full
def test_own_data_come_in(tmp_path: Path) -> None:
    """The hidden gain is 300; some 40,000 pixels of four looks leave 0.3 % of it."""
    found, stored = run("own-data.ipynb", tmp_path)
    ((deviance, gain),) = re.findall(r"deviance ([\d.]+) \(1 is the speckle floor\), gain (\d+)", found)
    assert abs(float(deviance) - 1.0) < 0.03
    assert abs(int(gain) - 300) < 5
    assert "looks 4" in stored
