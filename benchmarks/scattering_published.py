"""Published models of the integral equation's family on the full-wave table, and the exact limit of small roughness.

    python benchmarks/scattering_published.py DATA/nmm3d/NMM3D_LUT_NRCS_40degree.dat [--write]

The models are those of tests/scattering_reference.py, in NumPy from their papers. The limit is perturbation theory to
the fourth order of h in power (tests/perturbation_reference.py): it knows no model of the surface's fields.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tables
from scattering import read

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import scattering_reference as reference
from perturbation_reference import backscatter

MODELS: dict[str, Callable[..., float]] = {
    "IEM (Fung, Li and Chen 1992)": reference.iem,
    "I2EM (Fung et al. 2002), as here": reference.i2em,
    "I2EM with the transition (Fung and Chen 2004)": lambda *a: reference.i2em(*a, transition=True),
    "AIEM with the transition (Chen et al. 2003)": reference.aiem,
}
SMOOTH = 0.3  # kh, below which the limit is compared
CUTS = (8.0, 32.0)


def off_db(model: Callable[..., float], rows: np.ndarray) -> np.ndarray:
    """Model minus full wave in VV and HH [dB], (n, 2)."""
    found = []
    for incidence, ratio, re, im, height, vv, hh, _hv in rows:
        kh = 2 * np.pi * height
        surface = np.radians(incidence), re - 1j * im, kh, kh * ratio
        found.append(10 * np.log10([model(p, *surface) for p in ("VV", "HH")]) - (vv, hh))
    return np.array(found)


def published(rows: np.ndarray) -> str:
    heights = np.unique(rows[:, 4])
    lines = []
    for name, model in MODELS.items():
        off = off_db(model, rows)
        apart = off[:, 0] - off[:, 1]
        rms = np.sqrt(np.mean(off**2, axis=0))
        cells = [f"{apart[rows[:, 4] == h].mean():+.2f}" for h in heights]
        lines.append([name, f"{rms[0]:.2f}", f"{rms[1]:.2f}", *cells])
    head = ["model", "VV rms", "HH rms", *(f"kh {2 * np.pi * h:.2f}" for h in heights)]
    return tables.markdown(head, lines)


def limit(rows: np.ndarray) -> str:
    """VV - HH by permittivity and roughness: full wave, and perturbation theory of second and of fourth order."""
    lines = []
    for height in np.unique(rows[:, 4]):
        kh = 2 * np.pi * height
        if kh > SMOOTH:
            continue
        for re in np.unique(rows[:, 2]):
            mine = rows[(rows[:, 4] == height) & (rows[:, 2] == re)]
            found = []
            for incidence, ratio, _re, im, _height, *_ in mine:
                orders = [backscatter(np.radians(incidence), re - 1j * im, kh, kh * ratio, cut) for cut in CUTS]
                powers = [orders[0][0], *(fourth for _, fourth in orders)]
                found.append([10 * np.log10(one[1, 1] / one[0, 0]) for one in powers])
            truth = mine[:, 5] - mine[:, 6]
            apart = [f"{np.min(one):.2f} to {np.max(one):.2f}" for one in (truth, *np.transpose(found)[1:])]
            lines.append([f"{kh:.2f}", f"{re:g}", apart[0], f"{np.mean(found, axis=0)[0]:.2f}", *apart[1:]])
    head = ["kh", "eps'", "full wave", "second order", *(f"fourth order, waves to {cut:g} k" for cut in CUTS)]
    return tables.markdown(head, lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", type=Path, help="the full-wave table")
    tables.add_write(parser)
    given = parser.parse_args()
    rows = read(given.table)
    made = {"scattering.published": published(rows), "scattering.limit": limit(rows)}
    tables.publish(made, {"made": tables.made()}, given.write)


if __name__ == "__main__":
    main()
