"""Bodies whose curves come from a solver of the full equations, declared as they are and as another material.

    python benchmarks/rcs_trials.py -o out/ [--only WORD] [--write]

Bodies of revolution of metal come from the method of moments (`rcs_revolved.py`), blocks of plastic from a lattice of
dipoles (`rcs_dipoles.py`). Neither knows of rays, and no number of the diagnosis was chosen on them. Each curve gets
noise: 0.2 dB, and a background 25 dB under its mean. Each frequency is held back in turn, and every second sector of 20
degrees. Printed as a table: what was named or tied, and for plastic whether eps_r lies in its interval. What is in
`out/rcs_trials.json` is not asked again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rcs_dipoles as dipoles
import rcs_materials as materials
import rcs_revolved as revolved
import tables
from numpy.typing import NDArray

import warpsar
from warpsar.curves.noise import share_of
from warpsar.diagnosis.curve_materials import ask
from warpsar.simulation.outputs import plain
from warpsar.world.frame import SPEED_OF_LIGHT

METAL_HZ, PLASTIC_HZ = (6e9, 8e9, 10e9), (3.5e9, 5e9, 6.5e9)
AROUND = 96
OUTLINES: dict[str, list[tuple[float, float]]] = {
    "cone": revolved.cone(0.035, 0.14),
    "cylinder": revolved.cylinder(0.035, 0.12),
    "spheroid": revolved.spheroid(0.04, 0.08, 40),
    "top-hat": revolved.top_hat(0.03, 0.06, 0.075, 0.01),
}
"""(rho, z) in metres."""
BLOCKS = {"long-block": ((0.096, 0.06, 0.048), 2.5), "upright-block": ((0.06, 0.12, 0.036), 3.6)}
"""Size [m] and permittivity; the loss tangent is that of a solid that is tried."""
CUBE_M = 0.003
LOSS = 0.03
ERROR_DB, UNDER_DB = 0.2, 25.0


def metal_m2(name: str, frequency: float, phi: NDArray[np.float64]) -> NDArray[np.float64]:
    """RCS of HH and VV, (angles, 2). The axis lies along x, so theta-hat of the solver is horizontal."""
    points = revolved.pieces(OUTLINES[name], SPEED_OF_LIGHT / frequency / 12.0)
    found = revolved.amplitudes(points, 2.0 * np.pi * frequency / SPEED_OF_LIGHT, phi)
    return np.asarray(4.0 * np.pi * np.abs(found) ** 2)


def plastic_m2(name: str, frequency: float, phi: NDArray[np.float64]) -> NDArray[np.float64]:
    """RCS of HH and VV, (angles, 2)."""
    size, eps = BLOCKS[name]
    filled = np.ones([round(each / CUBE_M) for each in size], bool)
    made = dipoles.Lattice(filled, CUBE_M, 2.0 * np.pi * frequency / SPEED_OF_LIGHT, eps * (1.0 + LOSS * 1j))
    found = []
    for angle in np.deg2rad(phi):
        c, s = float(np.cos(angle)), float(np.sin(angle))
        found.append([made.rcs_m2(np.array([c, s, 0.0]), e) for e in (np.array([-s, c, 0.0]), np.array([0.0, 0, 1]))])
    return np.array(found)


def write(folder: Path, name: str, plastic: bool) -> None:
    """The curves of a body in the suite's format, with noise, once."""
    solve, last = (plastic_m2, 90.0) if plastic else (metal_m2, 180.0)
    phi = np.arange(0.0, last + 0.1, 4.5 if plastic else 2.0)
    for i, frequency in enumerate(PLASTIC_HZ if plastic else METAL_HZ):
        paths = [folder / f"meas_rcs.{name}.fx{i + 1}.{p}.txt" for p in "HV"]
        if all(path.exists() for path in paths):
            continue
        exact = solve(name, frequency, phi)
        rng = np.random.default_rng([i, *name.encode()])
        folder.mkdir(parents=True, exist_ok=True)
        for p, path in enumerate(paths):
            a = np.sqrt(exact[:, p]) + 0j
            draws = (rng.normal(size=(2, len(a))) + 1j * rng.normal(size=(2, len(a)))) / np.sqrt(2.0)
            level = 10.0 ** (-UNDER_DB / 10.0) * exact[:, p].mean()
            power = np.abs(a + np.sqrt(share_of(ERROR_DB)) * np.abs(a) * draws[0] + np.sqrt(level) * draws[1]) ** 2
            rows = np.stack([np.full(len(phi), frequency), np.full(len(phi), 90.0), phi, 10.0 * np.log10(power)], 1)
            np.savetxt(path, rows, fmt="%.6f")


def block(size: tuple[float, float, float]) -> warpsar.Mesh:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return warpsar.Mesh.of(corners, np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]))


def lying(outline: list[tuple[float, float]]) -> warpsar.Mesh:
    """The body of revolution with its axis along x."""
    made = revolved.mesh(outline, AROUND)
    return warpsar.Mesh.of(made.vertices[:, [2, 0, 1]], made.faces)


def cases(out: Path, only: str) -> Iterator[materials.Case]:
    for name in (*OUTLINES, *BLOCKS):
        plastic = name in BLOCKS
        if only not in name:
            continue
        folder = out / "curves" / name
        write(folder / "measured", name, plastic)
        mesh = block(BLOCKS[name][0]) if plastic else lying(OUTLINES[name])
        eps = BLOCKS[name][1] if plastic else materials.RESIN_EPS
        resin = warpsar.Material(eps_r=(eps, -LOSS * eps), rms_height_m=0.0)
        of = "plastic" if plastic else "metal"
        for declared, material in (("metal", materials.METAL), ("plastic", resin)):
            right = None if declared == of else ({"metal": "metal", "plastic": "dielectric"}[of], "")
            table = dict.fromkeys(mesh.materials, material)
            scene = materials.scene_of(mesh, table, folder, name)
            yield materials.Case(f"{name} of {of}", declared, right, scene)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "-o", "--out", type=Path, required=True, help="folder for curves, rcs_trials.json and the cache"
    )
    parser.add_argument("--only", default="", help="bodies whose name has this word")
    tables.add_write(parser)
    options = parser.parse_args()
    path = options.out / "rcs_trials.json"
    result: dict[str, Any] = {"made": tables.made(), "rows": []}
    if path.exists():
        result["rows"] = json.loads(path.read_text())["rows"]
    there = {(row["measured"], row["declared"], row["held_back"]) for row in result["rows"]}
    for case in cases(options.out, options.only):
        for what, scene in materials.held_back(case, options.out, options.out):
            if (case.measured, case.declared, what) in there:
                continue
            row = materials.row_of(case, what, ask(scene, options.out / "cache", parts=case.parts))
            result["rows"].append(row)
            path.write_text(json.dumps(plain(result), indent=1) + "\n", encoding="utf-8")
            print(case.measured, case.declared, what, row["answer"], "right" if row["right"] else "wrong", sep="; ",
                  flush=True)  # fmt: skip
    inside = [
        one["eps_r"]["low"] <= eps <= one["eps_r"]["high"]
        for row in plain(result)["rows"]
        for name, (_, eps) in BLOCKS.items()
        if name in row["measured"]
        for one in row["asked"]
        if one["kind"] == "dielectric" and one["eps_r"]
    ]
    print(f"eps_r of plastic: inside its interval in {sum(inside)} of {len(inside)}")
    tables.publish({"rcs_trials": materials.counted(result["rows"])}, result, options.write)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
