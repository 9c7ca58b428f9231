"""VV - HH of smooth surfaces to all orders of h, beside the fourth order, I2EM and the full-wave table.

    python benchmarks/scattering_orders.py DATA/nmm3d/NMM3D_LUT_NRCS_40degree.dat [--results FILE] [--write]

All orders: tests/rayleigh_reference.py, on the table's surfaces without their waves beyond `CUT` k. `--results` keeps
what is done, so that a run goes on where one has ended. `--device cuda` takes CuPy.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import tables

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import rayleigh_reference as rayleigh
import scattering_reference as reference
from perturbation_reference import backscatter

CUT = 4.0
FINEST = 32.0  # k, of the fourth order
BEYOND = 0.7  # a wave is scattered by up to `CUT` from the incident one
PERIODS = 4
SURFACES = 40
POINTS = 128
EPS = (3.0, 9.0, 30.0)
RATIOS = {0.042: (4.0, 10.0), 0.063: (10.0, 15.0)}  # by h over the wavelength: steeper ones do not converge


def computed(rows: np.ndarray, path: Path | None, device: str) -> dict[str, Any]:
    """By permittivity, l / h and height: decibels over Bragg's and their errors, and HV and VH."""
    done: dict[str, Any] = json.loads(path.read_text()) if path and path.exists() else {}
    xp = import_module("cupy") if device == "cuda" else np
    for height, ratios in RATIOS.items():
        for re in EPS:
            for ratio in ratios:
                key = f"{re:g} {ratio:g} {height:g}"
                if key in done:
                    continue
                eps = re - 1j * rows[rows[:, 2] == re][0, 3]
                period = rayleigh.Period(PERIODS, CUT + BEYOND, eps, math.radians(40.0), xp)
                kh = 2 * np.pi * height
                found, first = rayleigh.powers(period, kh, kh * ratio, CUT, SURFACES, POINTS, xp=xp)
                over, error = rayleigh.decibels(found, first)
                crossed = found.mean((0, 1))
                done[key] = {"dB": list(over), "error": list(error), "HV over VH": crossed[0, 1] / crossed[1, 0]}
                print(key, done[key], flush=True)
                if path:
                    path.write_text(json.dumps(done, indent=1))
    return done


def table(rows: np.ndarray, done: dict[str, Any]) -> str:
    theta = math.radians(40.0)
    lines = []
    for height, ratios in RATIOS.items():
        for re in EPS:
            for ratio in ratios:
                one = done[f"{re:g} {ratio:g} {height:g}"]
                row = rows[(rows[:, 2] == re) & (rows[:, 1] == ratio) & (rows[:, 4] == height)][0]
                surface = theta, re - 1j * row[3], 2 * np.pi * height, 2 * np.pi * height * ratio
                of = [*backscatter(*surface, CUT), backscatter(*surface, FINEST)[1]]
                second, fourth, finer = (10 * np.log10(p[1, 1] / p[0, 0]) for p in of)
                vv, hh = (reference.i2em(p, *surface) for p in ("VV", "HH"))
                exact = f"{second + one['dB'][2]:.2f} ± {one['error'][2]:.2f}"
                cells = [f"{each:.2f}" for each in (row[5] - row[6], 10 * math.log10(vv / hh), second, fourth)]
                reverse = f"{10 * math.log10(one['HV over VH']):+.2f}"
                lines.append(
                    [
                        f"{2 * np.pi * height:.2f}",
                        f"{re:g}",
                        f"{ratio:g}",
                        *cells,
                        exact,
                        reverse,
                        f"{finer - fourth:+.2f}",
                    ]
                )
    head = ["kh", "eps'", "l / h", "full wave", "`i2em`", "second order", "fourth order", "all orders", "HV - VH"]
    head.append("finer waves, fourth order")
    return tables.markdown(head, lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", type=Path, help="the full-wave table")
    parser.add_argument("--results", type=Path, help="keep what is done in this file, and go on from it")
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    tables.add_write(parser)
    given = parser.parse_args()
    rows = np.loadtxt(given.table)
    done = computed(rows, given.results, given.device)
    tables.publish({"scattering.orders": table(rows, done)}, {"made": tables.made()}, given.write)


if __name__ == "__main__":
    main()
