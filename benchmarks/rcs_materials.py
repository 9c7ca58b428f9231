"""Bodies of the Austin suite with something undeclared: what their curves say where the scene says otherwise.

    python benchmarks/rcs_materials.py DATA -o out/

DATA is the folder of measured data, with austin_rcs/ and austin_bodies/ in it. The almond (III.A all metal, III.C with
a tip of resin) is asked about its tip, with metal and with resin declared for it. Boxes and the aircraft PRIME are of
one material, and are asked about all of it, and about each flat part that an opening may lie behind. Bare are the
bodies that are declared as they are: nothing may be named there. 7 GHz is test, the rest train.

Printed: mean abs(dB) of every curve as declared, then what was asked and the answers. `out/rcs_materials.json` has all
numbers, and the table is printed last.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rcs_bodies as bodies
import tables
from rcs_curves import SATURATED_DEG

import warpsar
from warpsar.compare.curve import compare_curves
from warpsar.curves.materials import MaterialTest
from warpsar.diagnosis.curve_materials import ask
from warpsar.simulation.outputs import plain
from warpsar.world.curve import Curve
from warpsar.world.mesh import read_mesh
from warpsar.world.world import NO_IMAGE

ROOT = Path(__file__).resolve().parent.parent
TIP = "tip_ogive"
METAL = warpsar.Material(conductor=True)
RESIN = warpsar.Material(eps_r=(2.92, -0.087), rms_height_m=0.0)
"""The suite's value at 5 GHz; it is 2.96 at 2.58 GHz and 2.90 at 7 GHz."""
FRONT = "x 0.000 to 0.000"
"""Of the boxes: the plane that the mouths lie in."""
TERMS = ("single", "edges", "multibounce")


def almond(data: Path) -> warpsar.Mesh:
    """The body with the flat face between tail and tip."""
    body, face = read_mesh(data / "almond.obj"), read_mesh(data / "almond_interface.obj")
    return warpsar.Mesh(
        np.concatenate([body.vertices, face.vertices]),
        np.concatenate([body.faces, face.faces + len(body.vertices)]).astype(np.int32),
        np.concatenate([body.face_material, np.full(len(face.faces), len(body.materials))]).astype(np.int32),
        (*body.materials, "interface"),
    )


@dataclass(frozen=True)
class Case:
    """A body as measured, and as declared."""

    measured: str
    declared: str
    right: tuple[str, str] | None
    """Kind and a word of the part that are to be named or tied; None where nothing is."""
    scene: warpsar.Scene
    parts: tuple[str, ...] | None = None


def scene_of(
    mesh: warpsar.Mesh, materials: dict[str, warpsar.Material], data: Path, code: str, saturated: bool = False
) -> warpsar.Scene:
    """A body in space beside the curves of a set of the suite; 7 GHz (fx3 of the almonds, else fx1 or fx2) is test."""
    radar = warpsar.Radar(frequency_hz=5.125e9, polarizations=("HH", "VV"), terms=TERMS)
    if not all(one.conductor for one in materials.values()):
        radar = radar.model_copy(update={"terms": (*TERMS, "transmission")})
    mask = [(-90.0, -SATURATED_DEG - 0.5), (SATURATED_DEG + 0.5, 90.0)] if saturated else None
    curves = []
    for path in sorted((data / "measured").glob(f"meas_rcs.{code}.*")):
        frequency = float(np.loadtxt(path)[0, 0])
        curves.append(Curve(file=path, role="test" if frequency > 6e9 else "train", mask=mask))
    return warpsar.Scene(mesh=mesh, radar=radar, grid=NO_IMAGE, materials=materials, views=[], curves=tuple(curves))


def cases(data: Path) -> Iterator[Case]:
    suite, more = data / "austin_rcs", data / "austin_bodies"
    mesh = almond(more)
    names = {"metal": METAL, "resin": RESIN}
    for code, is_of in (("III.A", "metal"), ("III.C", "resin")):
        for declared, tip in names.items():
            materials = {each: tip if each == TIP else METAL for each in mesh.materials}
            right = None if declared == is_of else ({"metal": "metal", "resin": "dielectric"}[is_of], TIP)
            made = scene_of(mesh, materials, more, f"{code}.s1")
            yield Case(f"almond, tip of {is_of}", f"tip of {declared}", right, made, (TIP,))
    box = bodies.closed_box()
    wide = bodies.closed_wide_box()
    for what, mesh, code, right, saturated in (
        ("closed box", box, "IIIS.A.s1", None, True),
        ("box with the cobra duct", box, "IIIS.B.s1", ("open", FRONT), True),
        ("box with the cylindrical duct", wide, "IIIS.C.s1", ("open", FRONT), False),
    ):
        yield Case(
            what, "closed box", right, scene_of(mesh, dict.fromkeys(mesh.materials, METAL), suite, code, saturated)
        )
    mesh = read_mesh(more / "prime_closed_duct.obj")
    made = scene_of(mesh, dict.fromkeys(mesh.materials, METAL), more, "IV.A.s1")
    yield Case("closed aircraft", "closed aircraft", None, made)


def answer(asked: Sequence[MaterialTest]) -> str:
    """What the loop says."""
    said = [one for one in asked if one.outcome in ("named", "tied")]
    if not said:
        return "nothing"
    return f"{said[0].outcome}: " + "; ".join(f"{one.part}, {one.kind}" for one in said)


def is_right(asked: Sequence[MaterialTest], right: tuple[str, str] | None) -> bool:
    """Whether what is there is named or tied, or nothing is where nothing is to be."""
    said = [one for one in asked if one.outcome in ("named", "tied")]
    if right is None:
        return not said
    return any(one.kind == right[0] and right[1] in one.part for one in said)


def table(rows: Sequence[dict[str, Any]]) -> str:
    head = ("measured", "declared", "asked", "train", "price", "7 GHz", "HH", "VV", "answer", "right")
    lines = []
    for row in rows:
        for i, one in enumerate(row["asked"]):
            left = {each["name"]: f"{each['gain']:.0f} ± {each['error']:.0f}" for each in one["left_out"]}
            value = one["eps_r"]
            eps = f"; eps_r {value['value']:.2f}, {value['low']:.2f} to {value['high']:.2f}" if value else ""
            what = f"{one['part']}: {one['kind']}"
            why = f": {one['why']}" if one["why"] else ""
            lines.append(
                (
                    row["measured"] if i == 0 else "", row["declared"] if i == 0 else "", what, f"{one['gain']:.0f}",
                    f"{one['price']:.0f}", *(left.get(key, "none") for key in ("test", "HH", "VV")),
                    f"{one['outcome']}{why}{eps}", ("yes" if row["right"] else "no") if i == 0 else "",
                )
            )  # fmt: skip
    return tables.markdown(head, lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("WARPSAR_MEASURED") or ROOT.parent / "shared" / "data")
    parser.add_argument("data", type=Path, nargs="?", default=default, help="the folder of measured data")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for rcs_materials.json and the cache")
    parser.add_argument("--only", help="cases whose measured body has this word")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    cache, result = options.out / "cache", {"made": tables.made(), "rows": []}
    for case in cases(options.data):
        if options.only and options.only not in case.measured:
            continue
        errors = {one.name: one.error_db for one in compare_curves(case.scene, cache=cache)}
        asked = ask(case.scene, cache, parts=case.parts)
        right = is_right(asked, case.right)
        print(f"{case.measured}, declared {case.declared}: {answer(asked)} ({'right' if right else 'wrong'})")
        for name, value in errors.items():
            print(f"  {name}: {value:.2f} dB")
        for one in asked:
            tests = ", ".join(f"{each.name} {each.gain:.0f} +- {each.error:.0f}" for each in one.left_out)
            print(f"  {one.words}; train {one.gain:.0f} for {one.price:.0f}; {tests}", flush=True)
        row = {"measured": case.measured, "declared": case.declared, "mean_abs_db": errors, "right": right}
        result["rows"].append({**row, "asked": [asdict(one) for one in asked]})
        (options.out / "rcs_materials.json").write_text(json.dumps(plain(result), indent=1) + "\n", encoding="utf-8")
    print(table(plain(result)["rows"]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
