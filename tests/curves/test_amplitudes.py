"""Amplitudes that are kept on disk: they serve again only where nothing that they depend on has changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import warpsar
from warpsar.curves import observe as kept

pytestmark = pytest.mark.unit


def scene(seed: int = 0) -> warpsar.Scene:
    vertices = np.array([[0.0, -0.1, -0.1], [0.0, 0.1, -0.1], [0.0, 0.1, 0.1], [0.0, -0.1, 0.1]])
    return warpsar.Scene(
        mesh=warpsar.Mesh.of(vertices, np.array([[0, 1, 2], [0, 2, 3]])),
        radar=warpsar.Radar(frequency_hz=5e9, polarizations=("VV",)),
        grid=warpsar.Grid(shape=(4, 4), spacing_m=(1.0, 1.0)),
        sampling=warpsar.Sampling(seed=seed),
        materials={"default": warpsar.Material(conductor=True)},
        views=[warpsar.View(name="none", azimuth_deg=0.0, incidence_deg=45.0)],
    )


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """One entry for each run of the engine."""
    made: list[int] = []
    engine = kept.rcs

    def counted(*args: Any, **kwargs: Any) -> Any:
        made.append(1)
        return engine(*args, **kwargs)

    monkeypatch.setattr(kept, "rcs", counted)
    return made


def test_an_engine_that_has_changed_works_them_out_again(
    runs: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources = tmp_path / "coherent"
    sources.mkdir()
    (sources / "tubes.py").write_text("sign = +1\n")
    monkeypatch.setattr(kept, "ENGINE", (sources,))
    for text, expected in (("sign = +1\n", 1), ("sign = +1\n", 1), ("sign = -1\n", 2), ("sign = +1\n", 2)):
        (sources / "tubes.py").write_text(text)
        kept.engine_digest.cache_clear()
        kept.amplitudes(scene(), np.array([80.0]), 90.0, 5e9, cache=tmp_path / "cache")
        assert len(runs) == expected
    kept.engine_digest.cache_clear()


def test_the_digest_is_that_of_the_engine_in_use() -> None:
    files = {path.name for folder in kept.ENGINE for path in folder.glob("*.py")}
    assert {"sweep.py", "shape.py", "tubes.py", "radiate.py", "edges.py", "scattering.py", "mesh.py"} <= files


def test_another_seed_has_other_scatterers(runs: list[int], tmp_path: Path) -> None:
    for seed in (1, 2, 1):
        kept.amplitudes(scene(seed), np.array([80.0]), 90.0, 5e9, cache=tmp_path)
    assert len(runs) == 2
