"""Measured radar cross-sections of the Austin RCS Benchmark Suite against those of `warpsar.rcs`.

    python benchmarks/rcs_checks.py DATA [--only cobra] [--out rcs_checks.json] [--write]

DATA is the suite's folder: `measured/`, and the STL files of the two ducts as ZIP. Measure: the suite's own, the mean
|dB| over angle, with a threshold under the measured peak. Closed bodies: 80 dB, all angles. Bodies with an open duct:
40 dB, and the directions from which its mouth is seen at half of its area or more; the mouth is what the faces leave
open of the mesh's convex hull. The camera boxes A and B saturated the measurement within 5 degrees of phi = 90.

Bodies with a duct are swept with 10, 14 and 20 rays per wavelength. The result is that of the finest, and `spread` is
the range of all three: what the spacing of rays leaves open. Convex bodies have none: the borders of faces are exact.
`within its error`: at how many angles the coarsest sweep is as near to the finest as its `spacing_error_m` says.

`and edge waves`: with the term `edge_waves`, too. `independent` is what an independent program in float64 got with the
same method (PO + edges, or with rays).
"""

from __future__ import annotations

import io
import math
import os
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tables
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

import warpsar
from warpsar.world.mesh import read_mesh

ROOT = Path(__file__).resolve().parent.parent
FREQUENCIES = {"5.12 GHz": "f10", "7 GHz": "fx1"}
PLATE_M = (64 * 25.4e-6, 7 / 4 * 6 * 25.4e-3, 6 * 25.4e-3)  # thickness, width, height
LENGTH_M, FULL_LENGTH_M = 0.4, 12.8  # of the boxes as measured, and in the STL files
SATURATED_DEG = 5.0
LOBES_DEG = 55.0  # of the dielectric plate: beyond them the background of the range is stronger
OPEN_SHARE = 1e-3  # of a hull's plane: less is rounding
# body: (VV, HH) at 5.12 GHz, (VV, HH) at 7 GHz, with all terms
INDEPENDENT = {
    "plate": ((1.3, 4.5), (1.6, 3.0)),
    "closed box": ((0.84, 1.64), (0.76, 1.42)),
    "cylindrical duct": ((2.8, 3.0), (3.2, 2.0)),
    "cobra duct": ((5.4, 3.9), (4.9, 5.9)),
}
ALLOWED_DB = 0.6
RAYS_PER_WAVELENGTH = (10.0, 14.0, 20.0)
TERMS = ("single", "edges", "multibounce", "edge_waves")


def plate(data: Path) -> warpsar.Mesh:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * PLATE_M
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return warpsar.Mesh.of(corners, np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]))


def sheet(data: Path) -> warpsar.Mesh:
    _, y, z = np.array(PLATE_M) / 2
    return warpsar.Mesh.of(np.array([(0, -y, -z), (0, y, -z), (0, y, z), (0, -y, z)]), np.array([(0, 1, 2), (0, 2, 3)]))


def closed_box(data: Path) -> warpsar.Mesh:
    """The hexagonal prism of the drawing, front to +X."""
    profile = LENGTH_M * np.array([(0, 0), (0, 0.26), (0.27, 0.53), (1, 0.53), (1, -0.27), (0.27, -0.27)])
    n = len(profile)
    ends = [np.column_stack([-profile[:, 0], np.full(n, y), profile[:, 1]]) for y in (0.0, 0.325 * LENGTH_M)]
    faces = [t for i in range(1, n - 1) for t in ((0, i, i + 1), (n, n + i + 1, n + i))]
    faces += [t for i in range(n) for j in [(i + 1) % n] for t in ((i, i + n, j), (j, i + n, j + n))]
    return warpsar.Mesh.of(np.concatenate(ends), np.array(faces))


def duct(name: str) -> Callable[[Path], warpsar.Mesh]:
    """A box of the suite, scaled, and turned by 180 degrees about z so that phi = 0 looks into the duct."""

    def made(data: Path) -> warpsar.Mesh:
        with TemporaryDirectory() as folder, zipfile.ZipFile(data / f"{name}_duct_s6_stl.zip") as packed:
            (member,) = packed.namelist()
            stl = Path(folder) / "body.stl"
            stl.write_bytes(io.BytesIO(packed.read(member)).getvalue())
            mesh = read_mesh(stl)
        scale = LENGTH_M / FULL_LENGTH_M
        return warpsar.Mesh.of(mesh.vertices * (-scale, -scale, scale), mesh.faces)

    return made


BODIES: dict[str, tuple[str, Callable[[Path], warpsar.Mesh]]] = {
    "plate": ("II.B.sx1", plate),
    "closed box": ("IIIS.A.s1", closed_box),
    "cylindrical duct": ("IIIS.C.s1", duct("cylindrical")),
    "cobra duct": ("IIIS.B.s1", duct("cobra")),
    "dielectric plate": ("II.C.sx1", sheet),
}
MATERIALS: dict[str, dict[str, Any]] = {
    "dielectric plate": {"eps_r": (2.61, -0.035), "thickness_m": 1.5e-3, "rms_height_m": 0.0}
}


def measured(data: Path, body: str, frequency: str, polarization: str) -> NDArray[np.float64]:
    """Columns: frequency [Hz], theta [deg], phi [deg], RCS [dBsm]."""
    return np.loadtxt(data / "measured" / f"meas_rcs.{body}.{frequency}.{polarization}.txt")


def mouths(mesh: warpsar.Mesh) -> list[NDArray[np.float64]]:
    """Normals of the planes of the convex hull that the faces leave open in part."""
    hull = ConvexHull(mesh.vertices)
    corners = mesh.vertices[mesh.faces]
    normal = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    sides = mesh.vertices[hull.simplices]
    hull_area = 0.5 * np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1)
    found = []
    planes = np.round(hull.equations, 6)
    for plane in np.unique(planes, axis=0):
        near = np.abs(corners @ plane[:3] + plane[3]).max(axis=1) < 1e-4 * LENGTH_M
        whole = hull_area[(planes == plane).all(axis=1)].sum()
        if whole - area[near].sum() > OPEN_SHARE * max(whole, area.sum() / 100):
            found.append(plane[:3])
    return found


def scene_of(mesh: warpsar.Mesh, material: dict[str, Any] | None = None, **radar: Any) -> warpsar.Scene:
    """A body in space; a conductor, unless a material is given."""
    made = warpsar.Material(**(material or {"conductor": True}))
    return warpsar.Scene(
        mesh=mesh,
        radar=warpsar.Radar(frequency_hz=7e9, polarizations=("VV", "HH"), **radar),
        grid=warpsar.Grid(shape=(4, 4), spacing_m=(1.0, 1.0)),
        materials=dict.fromkeys(mesh.materials, made),
        views=[warpsar.View(name="none", azimuth_deg=0.0, incidence_deg=45.0)],
    )


def check(data: Path, body: str) -> list[dict[str, Any]]:
    """One row for each frequency and polarization."""
    suite, make = BODIES[body]
    mesh = make(data)
    open_planes = [] if body in MATERIALS else mouths(mesh)
    phi = measured(data, suite, "f10", "V")[:, 2]
    keep = np.isclose(phi % 0.5, 0.0)
    if open_planes:
        s = np.stack([np.cos(np.deg2rad(phi)), np.sin(np.deg2rad(phi)), np.zeros_like(phi)], axis=1)
        keep &= np.max([s @ plane for plane in open_planes], axis=0) >= math.cos(math.radians(60.0)) - 1e-9
    elif body in MATERIALS:
        keep &= phi <= LOBES_DEG
    elif "IIIS" in suite:
        keep &= np.abs(phi - 90.0) > SATURATED_DEG
    threshold = 40.0 if open_planes else 80.0
    exact = [float(measured(data, suite, code, "V")[0, 0]) for code in FREQUENCIES.values()]
    started = time.process_time()
    finer = RAYS_PER_WAVELENGTH if open_planes else RAYS_PER_WAVELENGTH[-1:]
    scene = scene_of(mesh, MATERIALS.get(body), terms=TERMS)
    sweeps = [warpsar.rcs(scene, 90.0 - phi[keep], 90.0, exact, rays_per_wavelength=n) for n in finer]
    seconds = time.process_time() - started
    found = sweeps[-1]
    rows = []
    for f, (frequency, code) in enumerate(FREQUENCIES.items()):
        for p, polarization in enumerate(("V", "H")):
            reference = measured(data, suite, code, polarization)[:, 3]
            low = reference.max() - threshold
            reference = np.maximum(reference[keep], low)

            def error(
                names: tuple[str, ...], made=found, reference=reference, low=low, f=f, p=p
            ) -> tuple[float, float]:
                total = sum(made.terms_m[name][:, 0, f, p] for name in names)
                decibels = np.maximum(10 * np.log10(np.maximum(4 * np.pi * np.abs(total) ** 2, 1e-30)), low)
                return float(np.abs(decibels - reference).mean()), float(np.corrcoef(decibels, reference)[0, 1])

            every = TERMS[:-1]
            whole, correlation = error(every)
            each = [error(every, made)[0] for made in sweeps]
            independent = INDEPENDENT[body][f][p] if body in INDEPENDENT else None
            moved, told = np.abs(sweeps[0].amplitude_m - found.amplitude_m), sweeps[0].spacing_error_m
            rows.append(
                {
                    "body": body,
                    "frequency": frequency,
                    "polarization": polarization * 2,
                    "angles": int(keep.sum()),
                    "po": error(("single",))[0],
                    "edges": error(("single", "edges"))[0],
                    "all": whole,
                    "waves": error(TERMS)[0],
                    "spread": max(each) - min(each),
                    "spacing_error_db": float(np.nanmedian(found.spacing_error_db[:, 0, f, p])),
                    "correlation": correlation,
                    "constant": float(np.abs(reference - np.median(reference)).mean()),
                    "independent": independent,
                    "within": independent is None or whole <= independent + ALLOWED_DB,
                    "covered": float((moved <= told)[:, 0, f, p].mean()) if open_planes else None,
                    "fresnel": float(np.nanmedian(found.fresnel_number[:, 0, f]))
                    if np.isfinite(found.fresnel_number[:, 0, f]).any()
                    else None,
                    "cpu_s": seconds,
                    "segments": found.segments,
                }
            )
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    header = ("body", "GHz", "pol.", "angles", "PO", "PO + edges", "with rays", "and edge waves", "spread",
              "within its error", "independent", "a constant level", "correlation of dB", "Fresnel number")  # fmt: skip
    return tables.markdown(
        header,
        [
            (
                r["body"], r["frequency"].removesuffix(" GHz"), r["polarization"], r["angles"], f"{r['po']:.2f}",
                f"{r['edges']:.2f}", f"{r['all']:.2f}", f"{r['waves']:.2f}",
                f"{r['spread']:.2f}",
                "none" if r["covered"] is None else f"{100 * r['covered']:.0f} %", r["independent"] or "none",
                f"{r['constant']:.2f}", f"{r['correlation']:.2f}",
                "none" if r["fresnel"] is None else f"{r['fresnel']:.2g}",
            )
            for r in rows
        ],
    )  # fmt: skip


def main() -> int:
    parser = tables.parser(__doc__)
    default = Path(os.environ.get("WARPSAR_MEASURED") or ROOT.parent / "shared" / "data") / "austin_rcs"
    parser.add_argument("data", type=Path, nargs="?", default=default, help="the suite's folder")
    parser.add_argument("--only", choices=[name.split()[0] for name in BODIES], help="one body")
    options = parser.parse_args()
    if options.source:
        result = tables.stored(options.source)
    else:
        chosen = [name for name in BODIES if options.only in (None, name.split()[0])]
        result: dict[str, Any] = {"made": tables.made(), "rows": []}
        for name in chosen:
            result["rows"] += check(options.data, name)
            tables.save(options.out, result)
    tables.publish({"rcs_checks": table(result["rows"])}, result, options.write)
    outside = [r for r in result["rows"] if not r["within"]]
    for r in outside:
        print(f"{r['body']}, {r['frequency']}, {r['polarization']}: {r['all']:.2f} dB is more than {ALLOWED_DB} dB "
              f"above {r['independent']} dB", file=sys.stderr)  # fmt: skip
    return 1 if outside else 0


if __name__ == "__main__":
    raise SystemExit(main())
