"""Bodies whose curves come from a solver of the full equations, declared as they are and as another material.

    python benchmarks/rcs_trials.py -o out/ [--only WORD] [--write]

Bodies of revolution of metal come from the method of moments (`rcs_revolved.py`), blocks of plastic from a lattice of
dipoles (`rcs_dipoles.py`). Neither knows of rays, and no number of the diagnosis was chosen on them. Each curve gets
noise: 0.2 dB, and a background 25 dB under its mean. Each frequency is held back in turn, and every second sector of 20
degrees. Printed as a table: what was named or tied, and for plastic whether eps_r lies in its interval. What is in
`out/rcs_trials.json` is not asked again.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rcs_dipoles as dipoles
import rcs_revolved as revolved
import tables
from numpy.typing import NDArray

import warpsar
from warpsar.curves.materials import MaterialTest
from warpsar.curves.noise import share_of
from warpsar.diagnosis.curve_materials import ask
from warpsar.simulation.outputs import plain
from warpsar.world.curve import Curve
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.world import NO_IMAGE

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
SECTOR_DEG = 20.0
RESIN_EPS = 2.92  # declared for bodies of metal
METAL = warpsar.Material(conductor=True)


@dataclass(frozen=True)
class RcsTrial:
    """A body as its solver has it, and as declared."""

    measured: str
    declared: str
    right: str | None
    """The kind that is to be named or tied; None where nothing is."""
    scene: warpsar.Scene


def scene_of(mesh: warpsar.Mesh, material: warpsar.Material, folder: Path) -> warpsar.Scene:
    """A body in space beside its curves."""
    terms = ("single", "edges", "multibounce", *(() if material.conductor else ("transmission",)))
    radar = warpsar.Radar(frequency_hz=5.125e9, polarizations=("HH", "VV"), terms=terms)
    curves = tuple(Curve(file=path) for path in sorted(folder.glob("meas_rcs.*")))
    materials = dict.fromkeys(mesh.materials, material)
    return warpsar.Scene(mesh=mesh, radar=radar, grid=NO_IMAGE, materials=materials, views=[], curves=curves)


def held_back(scene: warpsar.Scene) -> Iterator[tuple[str, warpsar.Scene]]:
    """The scene with other curves as test, each with words for what these are. All other curves are train."""

    def chosen(curves: Iterable[Curve]) -> warpsar.Scene:
        return replace(scene, curves=tuple(curves))

    each = {one: float(np.loadtxt(one.file, max_rows=1)[0]) for one in scene.curves}
    for test in sorted(set(each.values())):
        roles = {one: "test" if frequency == test else "train" for one, frequency in each.items()}
        yield f"{test / 1e9:.3g} GHz", chosen(one.model_copy(update={"role": role}) for one, role in roles.items())
    halves = {role: sectors(first) for first, role in enumerate(("train", "test"))}
    yield (
        "sectors",
        chosen(
            one.model_copy(update={"role": role, "mask": mask}) for one in scene.curves for role, mask in halves.items()
        ),
    )


def sectors(first: int) -> list[tuple[float, float]]:
    """Every second sector from -90 to 90 degrees."""
    starts = np.arange(-90.0 + first * SECTOR_DEG, 90.0, 2.0 * SECTOR_DEG).tolist()
    return [(start, min(start + SECTOR_DEG - 0.01, 90.0)) for start in starts]


def counted(rows: Sequence[dict[str, Any]]) -> str:
    """A line for each body and declaration: what was answered with which curves held back."""
    lines = []
    for measured, declared in dict.fromkeys((row["measured"], row["declared"]) for row in rows):
        mine = [row for row in rows if (row["measured"], row["declared"]) == (measured, declared)]
        good = [row["held_back"] for row in mine if row["right"]]
        bad = [f"{row['held_back']}: {row['answer']}" for row in mine if not row["right"]]
        wanted = mine[0]["wanted"] or "nothing"
        lines.append((measured, declared, wanted, f"{len(good)} of {len(mine)}", "; ".join(bad) or "none"))
    for what, some in (
        ("declared wrongly", [row for row in rows if row["wanted"]]),
        ("declared as they are", [row for row in rows if not row["wanted"]]),
    ):
        right = sum(row["right"] for row in some)
        lines.append((what, "", "", f"{right} of {len(some)}", ""))
    return tables.markdown(("measured", "declared", "to be found", "right", "wrong answers"), lines)


def row_of(case: RcsTrial, what: str, asked: Sequence[MaterialTest]) -> dict[str, Any]:
    """For JSON and `counted`: what was answered with `what` held back, and whether it is what is there."""
    said = [one for one in asked if one.outcome in ("named", "tied")]
    return {
        "measured": case.measured,
        "declared": case.declared,
        "held_back": what,
        "answer": f"{said[0].outcome}: " + "; ".join(f"{one.part}, {one.kind}" for one in said) if said else "nothing",
        "wanted": case.right,
        "right": any(one.kind == case.right for one in said) if case.right else not said,
        "asked": [asdict(one) for one in asked],
    }


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


def cases(out: Path, only: str) -> Iterator[RcsTrial]:
    for name in (*OUTLINES, *BLOCKS):
        plastic = name in BLOCKS
        if only not in name:
            continue
        folder = out / "curves" / name
        write(folder / "measured", name, plastic)
        mesh = block(BLOCKS[name][0]) if plastic else lying(OUTLINES[name])
        eps = BLOCKS[name][1] if plastic else RESIN_EPS
        resin = warpsar.Material(eps_r=(eps, -LOSS * eps), rms_height_m=0.0)
        of = "plastic" if plastic else "metal"
        for declared, material in (("metal", METAL), ("plastic", resin)):
            right = None if declared == of else {"metal": "metal", "plastic": "dielectric"}[of]
            yield RcsTrial(f"{name} of {of}", declared, right, scene_of(mesh, material, folder / "measured"))


def main() -> int:
    parser = tables.parser(__doc__, stored=False)
    parser.add_argument(
        "-o", "--out", type=Path, required=True, help="folder for curves, rcs_trials.json and the cache"
    )
    parser.add_argument("--only", default="", help="bodies whose name has this word")
    options = parser.parse_args()
    path = options.out / "rcs_trials.json"
    result: dict[str, Any] = {"made": tables.made(), "rows": []}
    if path.exists():
        result["rows"] = json.loads(path.read_text())["rows"]
    there = {(row["measured"], row["declared"], row["held_back"]) for row in result["rows"]}
    for case in cases(options.out, options.only):
        for what, scene in held_back(case.scene):
            if (case.measured, case.declared, what) in there:
                continue
            row = row_of(case, what, ask(scene, options.out / "cache"))
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
    tables.publish({"rcs_trials": counted(result["rows"])}, result, options.write)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
