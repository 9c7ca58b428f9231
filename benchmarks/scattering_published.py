"""Published models of the integral equation's family on the full-wave table, and the exact limit of small roughness.

    python benchmarks/scattering_published.py DATA/nmm3d/NMM3D_LUT_NRCS_40degree.dat [--write]

The models are those of tests/scattering_reference.py and tests/double_reference.py, in NumPy from their papers. The
limit is perturbation theory to the fourth order of h in power (tests/perturbation_reference.py): it knows no model of
the surface's fields.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import tables
from scattering import read

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import scattering_reference as reference
from double_reference import double
from perturbation_reference import backscatter

Model = Callable[..., float]


def with_double(single: Model, *, crossed: bool = True, **kind: bool) -> Model:
    """`single` and double scattering; `crossed`: its part with the Kirchhoff field too."""

    def both(polarization: str, *surface: float) -> float:
        found = double(polarization, *surface, **kind)  # type: ignore[arg-type]
        return single(polarization, *surface) + (sum(found) if crossed else found[1])

    return both


turned = partial(reference.i2em, transition=True)
MODELS: dict[str, Model] = {
    "IEM (Fung, Li and Chen 1992)": reference.iem,
    "IEM (1992) with its double scattering": with_double(reference.iem),
    "I2EM (Fung et al. 2002), as here": reference.i2em,
    "I2EM as printed: not reciprocal": partial(reference.i2em, reciprocal=False),
    "I2EM with the transition (Fung and Chen 2004)": turned,
    "I2EM with the transition, sin θ for sin² θ (programs)": partial(turned, sine_power=1),
    "I2EM with the transition, F_t reversed in H": partial(turned, opposed=True),
    "I2EM with double scattering (1992)": with_double(reference.i2em),
    "I2EM with the complementary part of it alone": with_double(reference.i2em, crossed=False),
    "AIEM without a transition (Chen et al. 2003)": partial(reference.aiem, transition=False),
    "AIEM with the transition": reference.aiem,
    "AIEM with the transition, F_t reversed in H (its program)": partial(reference.aiem, opposed=True),
    "AIEM with the transition, and loops of double scattering": with_double(reference.aiem, own_phases=True),
    "AIEM with the transition, and all terms (Yang et al. 2017)": with_double(
        reference.aiem, own_phases=True, rest=True
    ),
}
SMOOTH = 0.3  # kh, below which the limit is compared
CUTS = (8.0, 32.0)


def powers(model: Model, rows: np.ndarray) -> np.ndarray:
    """VV and HH of the table's surfaces, (n, 2)."""
    found = []
    for incidence, ratio, re, im, height, *_ in rows:
        kh = 2 * np.pi * height
        found.append([model(p, np.radians(incidence), re - 1j * im, kh, kh * ratio) for p in ("VV", "HH")])
    return np.array(found)


def published(rows: np.ndarray) -> str:
    heights = np.unique(rows[:, 4])
    lines = []
    for name, model in MODELS.items():
        power = powers(model, rows)
        with np.errstate(invalid="ignore"):
            off = 10 * np.log10(power) - rows[:, 5:7]
        apart = off[:, 0] - off[:, 1]
        rms = [f"{one:.2f}" for one in np.sqrt(np.mean(off**2, axis=0))]
        cells = [f"{apart[rows[:, 4] == h].mean():+.2f}" for h in heights]
        lines.append([name, *("power < 0" if "nan" in cell else cell for cell in (*rms, *cells))])
        print(" | ".join(lines[-1]), file=sys.stderr, flush=True)
    head = ["model", "VV rms", "HH rms", *(f"kh {2 * np.pi * h:.2f}" for h in heights)]
    return tables.markdown(head, lines)


def perturbed(rows: np.ndarray) -> dict[str, np.ndarray]:
    """VV and HH of smooth surfaces [dB], (n, 2), by theory: its second order, and the fourth by the finest waves."""
    found: dict[str, list[np.ndarray]] = {}
    for incidence, ratio, re, im, height, *_ in rows:
        kh = 2 * np.pi * height
        for cut in CUTS:
            second, fourth = backscatter(np.radians(incidence), re - 1j * im, kh, kh * ratio, cut)
            found.setdefault("second order", []).append(second) if cut == CUTS[0] else None
            found.setdefault(f"fourth order, waves to {cut:g} k", []).append(fourth)
    return {name: 10 * np.log10([(one[1, 1], one[0, 0]) for one in each]) for name, each in found.items()}


def limit(rows: np.ndarray, theory: dict[str, np.ndarray]) -> str:
    """VV - HH by permittivity and roughness: full wave, and perturbation theory of second and of fourth order."""
    lines = []
    for height in np.unique(rows[:, 4]):
        for re in np.unique(rows[:, 2]):
            mine = (rows[:, 4] == height) & (rows[:, 2] == re)
            cells = []
            for channels in (rows[:, 5:7], *theory.values()):
                apart = (channels[:, 0] - channels[:, 1])[mine]
                same = np.ptp(apart) < 5e-3
                cells.append(f"{apart.mean():.2f}" if same else f"{apart.min():.2f} to {apart.max():.2f}")
            lines.append([f"{2 * np.pi * height:.2f}", f"{re:g}", *cells])
    return tables.markdown(["kh", "eps'", "full wave", *theory], lines)


def channels(rows: np.ndarray, theory: dict[str, np.ndarray]) -> str:
    """Mean of theory and of two models minus full wave, in each channel."""
    compared = dict(theory)
    for name, model in (("`i2em`", reference.i2em), ("AIEM with the transition", reference.aiem)):
        compared[name] = 10 * np.log10(powers(model, rows))
    lines = []
    for name, found in compared.items():
        off = found - rows[:, 5:7]
        line = [name]
        for height in np.unique(rows[:, 4]):
            vv, hh = off[rows[:, 4] == height].mean(axis=0)
            line.append(f"{vv:+.2f} / {hh:+.2f} / {vv - hh:+.2f}")
        lines.append(line)
    return tables.markdown(["", *(f"kh {2 * np.pi * h:.2f}" for h in np.unique(rows[:, 4]))], lines)


def grouped(rows: np.ndarray) -> str:
    """i2em minus full wave in VV / HH by permittivity and by l / h, at the roughnesses that are missed."""
    off = 10 * np.log10(powers(reference.i2em, rows)) - rows[:, 5:7]
    heights = np.unique(rows[:, 4])[:4]
    lines = []
    for name, column in (("eps'", 2), ("l / h", 1)):
        for value in np.unique(rows[:, column]):
            pairs = [off[(rows[:, column] == value) & (rows[:, 4] == h)].mean(axis=0) for h in heights]
            lines.append([f"{name} = {value:g}", *(f"{vv:+.2f} / {hh:+.2f}" for vv, hh in pairs)])
    return tables.markdown(["", *(f"kh {2 * np.pi * h:.2f}" for h in heights)], lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", type=Path, help="the full-wave table")
    tables.add_write(parser)
    given = parser.parse_args()
    rows = read(given.table)
    smooth = rows[2 * np.pi * rows[:, 4] < SMOOTH]
    theory = perturbed(smooth)
    made = {
        "published": published(rows),
        "limit": limit(smooth, theory),
        "channels": channels(smooth, theory),
        "grouped": grouped(rows),
    }
    tables.publish({f"scattering.{name}": text for name, text in made.items()}, {"made": tables.made()}, given.write)


if __name__ == "__main__":
    main()
