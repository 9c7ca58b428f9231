"""Bodies of the Austin suite with something undeclared: what their curves say where the scene says otherwise.

    python benchmarks/rcs_materials.py DATA -o out/ [--only WORD] [--held-back [--write]]

DATA is the folder of measured data, with austin_rcs/ and austin_bodies/ in it. The almond (III.A all metal, III.C with
a tip of resin) is asked about its tip, with metal and with resin declared for it. Boxes and the aircraft PRIME are of
one material, and are asked about all of it, and about each flat part that an opening may lie behind. Bare are the
bodies that are declared as they are: nothing may be named there. 7 GHz is test, the rest train.

`--held-back` asks all bodies, and four more that are declared as another material, again with other curves held back:
each frequency alone; every second sector of 20 degrees at all frequencies; and the second model of a body, which is
twice as large and was measured at half the frequency. It counts what is named or tied, and how often eps_r lies in its
interval.

Printed: mean abs(dB) of every curve as declared, then what was asked and the answers. `out/rcs_materials.json` has all
numbers, and the table is printed last.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rcs_bodies as bodies
import tables
from rcs_curves import DIELECTRIC, SATURATED_DEG

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
RESIN_EPS = 2.92
RESIN = warpsar.Material(eps_r=(RESIN_EPS, -0.087), rms_height_m=0.0)
"""The suite's value at 5 GHz; it is 2.96 at 2.58 GHz and 2.90 at 7 GHz."""
SECTOR_DEG = 20.0
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


def wrongly_declared(data: Path) -> Iterator[Case]:
    """Bodies of one material that are declared as another one."""
    suite, more = data / "austin_rcs", data / "austin_bodies"
    slab = {f: warpsar.Material(**table) for f, table in DIELECTRIC.items()}[5.12e9]
    for what, declared, mesh, material, folder, code, saturated, right in (
        ("metal plate", "a dielectric plate", bodies.sheet(), slab, suite, "II.B.sx1", False, ("metal", "")),
        ("dielectric plate", "a sheet of metal", bodies.sheet(), METAL, suite, "II.C.sx1", False, ("dielectric", "")),
        ("closed box", "a box of resin", bodies.closed_box(), RESIN, suite, "IIIS.A.s1", True, ("metal", "")),
        ("closed aircraft", "an aircraft of resin", read_mesh(more / "prime_closed_duct.obj"), RESIN, more, "IV.A.s1",
         False, ("metal", "")),
    ):  # fmt: skip
        scene = scene_of(mesh, dict.fromkeys(mesh.materials, material), folder, code, saturated)
        yield Case(what, declared, right, scene)


def held_back(case: Case, data: Path, out: Path) -> Iterator[tuple[str, warpsar.Scene]]:
    """The case with other curves as test, each with words for what these are. All other measured curves are train."""
    curves = case.scene.curves
    each = [float(np.loadtxt(one.file, max_rows=1)[0]) for one in curves]

    def scene(chosen: Iterable[Curve]) -> warpsar.Scene:
        return replace(case.scene, curves=tuple(chosen))

    for frequency in sorted(set(each)):
        yield (
            f"{frequency / 1e9:.3g} GHz",
            scene(
                one.model_copy(update={"role": "test" if f == frequency else "train"})
                for one, f in zip(curves, each, strict=True)
            ),
        )
    yield (
        "sectors",
        scene(
            one.model_copy(update={"role": role, "mask": _sectors(first, one.mask)})
            for one in curves
            for first, role in enumerate(("train", "test"))
        ),
    )
    second = [_second_model(one, data, out) for one in curves]
    if any(second):
        train = [one.model_copy(update={"role": "train"}) for one in curves]
        yield "second model", scene([*train, *(one for one in second if one is not None)])


def _sectors(first: int, mask: Sequence[tuple[float, float]] | None) -> list[tuple[float, float]]:
    """Every second sector from -90 to 90 degrees, where the mask lets them through."""
    parts = []
    for start in np.arange(-90.0 + first * SECTOR_DEG, 90.0, 2.0 * SECTOR_DEG).tolist():
        for low, high in mask or [(-90.0, 90.0)]:
            if (a := max(start, low)) < (b := min(start + SECTOR_DEG - 0.01, high)):
                parts.append((a, b))
    return parts


def _second_model(one: Curve, data: Path, out: Path) -> Curve | None:
    """The curve of the model of twice the size, at the frequency that it stands for; None where there is none."""
    name = Path(one.file).name.replace("meas_rcs", "meas.m2_rcs")
    source = data / "austin_bodies" / "measured_2x" / name
    if not source.exists():
        return None
    rows = np.loadtxt(source)
    if "III.A" in name:  # its files state the frequency at which the large model was measured
        rows[:, 0] *= 2.0
    target = out / "second_model" / name
    target.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(target, rows, fmt="%.6f")
    return one.model_copy(update={"file": target, "role": "test"})


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


def row_of(case: Case, what: str, asked: Sequence[MaterialTest]) -> dict[str, Any]:
    """For JSON and `counted`: what was answered with `what` held back."""
    return {
        "measured": case.measured,
        "declared": case.declared,
        "held_back": what,
        "answer": answer(asked),
        "wanted": case.right and case.right[0],
        "right": is_right(asked, case.right),
        "asked": [asdict(one) for one in asked],
    }


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


def count_held_back(options: argparse.Namespace) -> int:
    path = options.out / "held_back.json"
    result: dict[str, Any] = {"made": tables.made(), "rows": []}
    if path.exists():
        result["rows"] = json.loads(path.read_text())["rows"]
    there = {(row["measured"], row["declared"], row["held_back"]) for row in result["rows"]}
    for case in (*cases(options.data), *wrongly_declared(options.data)):
        if options.only and options.only not in f"{case.measured}, {case.declared}":
            continue
        for what, scene in held_back(case, options.data, options.out):
            if (case.measured, case.declared, what) in there:
                continue
            asked = ask(scene, options.out / "cache", parts=case.parts)
            row = row_of(case, what, asked)
            result["rows"].append(row)
            path.write_text(json.dumps(plain(result), indent=1) + "\n", encoding="utf-8")
            print(case.measured, case.declared, what, row["answer"], "right" if row["right"] else "wrong", sep="; ",
                  flush=True)  # fmt: skip
    resin = [one["eps_r"] for row in plain(result)["rows"] if "tip of resin" in row["measured"]
             for one in row["asked"] if one["kind"] == "dielectric" and one["eps_r"]]  # fmt: skip
    inside = sum(one["low"] <= RESIN_EPS <= one["high"] for one in resin)
    print(f"eps_r of the tip of resin, {RESIN_EPS}: inside its interval in {inside} of {len(resin)}")
    tables.publish({"rcs_held_back": counted(result["rows"])}, result, options.write)
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("WARPSAR_MEASURED") or ROOT.parent / "shared" / "data")
    parser.add_argument("data", type=Path, nargs="?", default=default, help="the folder of measured data")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for rcs_materials.json and the cache")
    parser.add_argument("--only", help="cases whose measured body has this word")
    parser.add_argument("--held-back", action="store_true", help="ask again with other curves held back, and count")
    tables.add_write(parser)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.held_back:
        return count_held_back(options)
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
