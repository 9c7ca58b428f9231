"""Two measured dihedrals at 77 GHz: one tells the level, the other is foretold; beside the closed form.

    python benchmarks/rcs_dihedrals.py DATA -o out/ --write

DATA is the folder of measured data, with hussar_dihedrals/ in it. The scene is examples/measured/dihedrals. The closed
form is that of a far radar: two bounces send like a plate of the area 2 a b sin(45 deg - |angle|), and each plate has
its own pattern. Its level is fitted to the train curve as the engine's is, and, in the last column, to the very curve
that it is judged on. `out/rcs_dihedrals.json` has it all; --write puts the table into docs/measured-record.md.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tables
from numpy.typing import NDArray

import warpsar
from warpsar.compare.curve import CurveComparison, compare_curves
from warpsar.curves.metrics import decibels
from warpsar.world.frame import SPEED_OF_LIGHT

ROOT = Path(__file__).resolve().parent.parent
EXAMPLE = ROOT / "examples" / "measured" / "dihedrals"
EDGES_M = (0.05, 0.15)
MIDDLE_DEG = 90.0
HEADERS = ("level from", "judged", "directions", "engine", "closed form", "closed form, level of the judged curve",
           "smooth curve, of the judged curve", "engine's level over the judged curve [dB]")  # fmt: skip


def closed_form_m2(edge_m: float, azimuth_deg: NDArray[np.float64], frequency_hz: float) -> NDArray[np.float64]:
    """RCS [m2] of a far square-plate dihedral in the plane across its fold: bounces and plates, by power."""
    angle = np.deg2rad(azimuth_deg - MIDDLE_DEG)
    k = 2.0 * np.pi * frequency_hz / SPEED_OF_LIGHT
    area = 2.0 * edge_m**2 * np.sin(np.clip(np.pi / 4 - np.abs(angle), 0.0, None))
    total = area**2
    for sign in (1.0, -1.0):
        off = np.pi / 4 + sign * angle  # from the plate's plane
        pattern = np.sinc(k * edge_m * np.cos(off) / np.pi)
        total += (edge_m**2 * np.sin(np.clip(off, 0.0, np.pi)) * pattern) ** 2
    return np.asarray(4.0 * np.pi * total * frequency_hz**2 / SPEED_OF_LIGHT**2)


def _decibels(one: CurveComparison, edge_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of the closed form and of the measurement, at the file's own level [dB]."""
    form = closed_form_m2(edge_m, one.seen.azimuth_deg, one.seen.frequency_hz)
    return decibels(form), decibels(one.measured) - float(one.seen.fitted_level_db or 0.0)


def judged(scene: warpsar.Scene, train: int, cache: Path) -> dict[str, Any]:
    """The curve that is not `train`, foretold with the level that `train` tells."""
    roles = [one.model_copy(update={"role": "train" if i == train else "test"}) for i, one in enumerate(scene.curves)]
    found = compare_curves(replace(scene, curves=tuple(roles)), cache=cache)
    other = 1 - train
    form, measured = _decibels(found[other], EDGES_M[other])
    mine, told = _decibels(found[train], EDGES_M[train])
    off = measured - form
    return {
        "train": found[train].name.split()[0],
        "judged": found[other].name.split()[0],
        "directions": len(off),
        "engine": found[other].error_db,
        "closed_form": float(np.abs(off - np.median(told - mine)).mean()),
        "closed_form_own_level": float(np.abs(off - np.median(off)).mean()),
        "smooth": found[other].content()["error_db"]["smooth"],
        "level_db": float(np.median(decibels(found[other].simulated) - decibels(found[other].measured))),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("WARPSAR_MEASURED") or ROOT.parent / "shared" / "data")
    parser.add_argument("data", type=Path, nargs="?", default=default, help="the folder of measured data")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for rcs_dihedrals.json and the cache")
    tables.add_write(parser)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    result: dict[str, Any] = {"made": tables.made(), "rows": []}
    with TemporaryDirectory() as folder:
        for path in EXAMPLE.iterdir():
            (Path(folder) / path.name).write_bytes(path.read_bytes())
        for path in (options.data / "hussar_dihedrals").glob("dihedral-*cm"):
            (Path(folder) / path.name).symlink_to(path.resolve())
        scene = warpsar.Scene.load(Path(folder) / "scene.toml")
        result["rows"] = [judged(scene, train, options.out / "cache") for train in (0, 1)]
    tables.save(options.out / "rcs_dihedrals.json", result)
    lines = [
        [each if isinstance(each, str | int) else f"{each:.2f}" for each in row.values()] for row in result["rows"]
    ]
    tables.publish({"rcs_dihedrals": tables.markdown(HEADERS, lines)}, result, options.write)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
