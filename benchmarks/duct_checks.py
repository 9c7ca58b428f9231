"""The box with the cobra duct: what of its error is the rays', by the exact modes of the duct.

    python benchmarks/duct_checks.py DATA [--out duct_checks.json] [--write]

DATA is the folder of the Austin RCS suite, as in rcs_checks.py. The box outside and all edges are `warpsar.rcs`'s in
every row. The inside is, row by row:

| inside | what |
|---|---|
| engine | `warpsar.rcs`, 40 rays per wavelength |
| at hits | rays of duct_rays.py in cells of 0.5 mm, not cut; every hit that the radar sees sends, as in the engine |
| from the mouth | the same rays; they send where they leave |
| modes | duct_modes.py |
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import duct_rays
import numpy as np
import rcs_checks
import tables
from duct_modes import COBRA, COBRA_CORNER_M, across_bend

import warpsar
from warpsar.world.frame import SPEED_OF_LIGHT

CELLS_M = (1e-3, 0.5e-3)
RAYS_PER_WAVELENGTH = 40.0
INSIDES = ("engine", "at hits", "from the mouth", "modes")


def check(data: Path) -> list[dict[str, Any]]:
    """One row for each frequency, polarization and way to know the inside."""
    body, make = rcs_checks.BODIES["cobra duct"]
    mesh, cap = make(data), rcs_checks.closed_box(data)
    cap = warpsar.Mesh.of(cap.vertices - [0.0, cap.vertices[:, 1].max(), 0.0], cap.faces)
    rows = []
    for name, code in rcs_checks.FREQUENCIES.items():
        curves = {pol: rcs_checks.measured(data, body, code, pol) for pol in "HV"}
        angle = curves["V"][:, 2]
        keep = np.isclose(angle % 0.5, 0.0) & (np.cos(np.deg2rad(angle)) >= 0.5 - 1e-9)
        phi, frequency = np.deg2rad(angle[keep]), float(curves["V"][0, 0])
        k = 2.0 * np.pi * frequency / SPEED_OF_LIGHT
        found = warpsar.rcs(
            rcs_checks.scene_of(mesh), 90.0 - angle[keep], 90.0, frequency, rays_per_wavelength=RAYS_PER_WAVELENGTH
        )
        box = warpsar.rcs(rcs_checks.scene_of(cap), 90.0 - angle[keep], 90.0, frequency)
        rays = np.array(
            [[duct_rays.amplitudes(COBRA, COBRA_CORNER_M, p, k, cell) for p in phi] for cell in CELLS_M]
        )  # (cells, angles, hits or mouth, HH or VV)
        for i, (pol, at) in enumerate((("HH", 1), ("VV", 0))):
            lid = -1j * k / (2.0 * np.pi) * np.cos(phi) * COBRA.width_m * COBRA.height_m
            x = 2.0 * k * np.sin(phi)
            lid = (
                lid * np.exp(1j * x * (COBRA_CORNER_M[0] + COBRA.width_m / 2)) * np.sinc(x * COBRA.width_m / 2 / np.pi)
            )
            outside = box.terms_m["single"][:, 0, 0, at] - lid
            edges = found.terms_m["edges"][:, 0, 0, at]
            modes = across_bend(COBRA, phi, k, COBRA_CORNER_M, pol == "HH")
            engine = found.amplitude_m[:, 0, 0, at] - edges - outside
            reference = curves[pol[0]][:, 3]
            low = reference.max() - 40.0
            for inside, amplitude, coarse in zip(
                INSIDES,
                (engine, *rays[-1, :, :, i].T, modes),
                (None, *rays[0, :, :, i].T, None),
                strict=True,
            ):
                whole = 4.0 * np.pi * np.abs(amplitude + outside + edges) ** 2
                decibels = np.maximum(10.0 * np.log10(whole), low)
                there = np.maximum(reference[keep], low)
                size = np.linalg.norm(amplitude) * np.linalg.norm(modes)
                rows.append(
                    {
                        "frequency": name,
                        "polarization": pol,
                        "inside": inside,
                        "error_db": float(np.abs(decibels - there).mean()),
                        "correlation": float(np.corrcoef(decibels, there)[0, 1]),
                        "coherence": float(abs(np.vdot(modes, amplitude)) / size),
                        "level_db": float(20.0 * np.log10(np.linalg.norm(amplitude) / np.linalg.norm(modes))),
                        "change": None
                        if coarse is None
                        else float(np.linalg.norm(amplitude - coarse) / np.linalg.norm(amplitude)),
                    }
                )
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    header = ("GHz", "pol.", "inside", "mean abs(dB)", "correlation of dB", "coherence with the modes",
              "level over the modes [dB]", "change from cells of 1 mm")  # fmt: skip
    return tables.markdown(
        header,
        [
            (
                r["frequency"].removesuffix(" GHz"), r["polarization"], r["inside"], f"{r['error_db']:.2f}",
                f"{r['correlation']:.2f}", f"{r['coherence']:.2f}", f"{r['level_db']:.1f}",
                "none" if r["change"] is None else f"{100 * r['change']:.0f} %",
            )
            for r in rows
        ],
    )  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("WARPSAR_MEASURED") or rcs_checks.ROOT.parent / "shared" / "data") / "austin_rcs"
    parser.add_argument("data", type=Path, nargs="?", default=default, help="the suite's folder")
    tables.add_options(parser)
    options = parser.parse_args()
    result = tables.stored(options.source) if options.source else {"made": tables.made(), "rows": check(options.data)}
    tables.save(options.out, result)
    tables.publish({"duct_checks": table(result["rows"])}, result, options.write)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
