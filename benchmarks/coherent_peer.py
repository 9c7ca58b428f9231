"""Physical optics of the closed box by `warpsar.rcs` and by Optycal, an open program for physical optics.

    python benchmarks/coherent_peer.py [--write]

Needs `pip install optycal`. Optycal 0.2.0 has no radar cross-section and no rays. Its Stratton-Chu integral
(`stratton_chu_ff`) gets what physical optics says of a conductor, at points of a mesh of a tenth of a wavelength, on
the faces that the radar sees. From the front the box throws no shadow on itself. Reference: Gordon's exact border
integral in NumPy, face by face.
"""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
import tables
import trimesh
from rcs_checks import closed_box, scene_of

import warpsar
from warpsar.coherent.directions import Directions
from warpsar.world.frame import SPEED_OF_LIGHT

FREQUENCY = 7e9
PHI = np.arange(1.0, 60.0, 1.0)  # degrees off the front: the box throws no shadow on itself
IMPEDANCE = 376.73031366857


def exact(mesh: warpsar.Mesh, k: float, s: np.ndarray, u: np.ndarray) -> complex:
    """A of physical optics in HH: -jk / (2 pi) (n.s) INT e^{2jk s.r} dS over the triangles that face the radar."""
    p = mesh.vertices[mesh.faces]
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    n /= np.linalg.norm(n, axis=1)[:, None]
    lit = n @ s > 0
    p, n = p[lit], n[lit]
    w = 2 * k * (s - (n @ s)[:, None] * n)
    total = np.zeros(len(p), complex)
    for i in range(3):
        a, along = p[:, i], p[:, (i + 1) % 3] - p[:, i]
        across = np.einsum("ij,ij->i", w, np.cross(along, n))
        shape = np.sinc(0.5 * np.einsum("ij,ij->i", w, along) / np.pi)
        total += across * shape * np.exp(2j * k * ((a + 0.5 * along) @ s))
    return complex((-1j * k / (2 * np.pi) * (n @ s) * total / (1j * (w**2).sum(axis=1))).sum())


def by_optycal(mesh: warpsar.Mesh, k: float, directions: Directions) -> tuple[np.ndarray, float]:
    from numba_progress import ProgressBar
    from optycal.solvers.strattonchuff import stratton_chu_ff

    points, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 0.1 * 2 * np.pi / k)
    p = points[faces]
    area = 0.5 * np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    size = np.linalg.norm(area, axis=1)[:, None]
    n, middle = area / size, p.mean(axis=1)

    def one(s: np.ndarray, e: np.ndarray) -> complex:
        lit = n @ s > 0
        wave = np.exp(1j * k * (middle[lit] @ s))[:, None]
        electric = (2 * (n[lit] @ e) + 1.0)[:, None] * n[lit] * wave  # n x E = 0; points without any E are left out
        magnetic = 2 * np.cross(-s, e) / IMPEDANCE * wave
        magnetic = magnetic - (n[lit] * magnetic).sum(axis=1)[:, None] * n[lit]
        angles = np.array([[np.arccos(s[2])], [np.arctan2(s[1], s[0])]])
        arrays = (np.ascontiguousarray(a.T) for a in (electric, magnetic, middle[lit], area[lit]))
        with ProgressBar(total=int(lit.sum()), disable=True) as bar:
            field, _ = stratton_chu_ff(*arrays, angles, k, bar)
        return complex(e @ field[:, 0])

    one(directions.s[0], directions.u[0])
    started = time.process_time()
    found = np.array([one(s, u) for s, u in zip(directions.s, directions.u, strict=True)])
    return found, time.process_time() - started


def measure() -> list[dict[str, Any]]:
    mesh = closed_box(Path())
    k = 2 * np.pi * FREQUENCY / SPEED_OF_LIGHT
    directions = Directions.of(90.0 - PHI, 90.0)
    reference = np.array([exact(mesh, k, s, u) for s, u in zip(directions.s, directions.u, strict=True)])
    scene = scene_of(mesh)
    radar = warpsar.Radar(frequency_hz=FREQUENCY, polarizations=("HH",), terms=("single",))
    scene = dataclasses.replace(scene, radar=radar)
    warpsar.rcs(scene, 90.0 - PHI[:1], 90.0, device="cpu")
    started = time.process_time()
    ours = warpsar.rcs(scene, 90.0 - PHI, 90.0, device="cpu").amplitude_m[:, 0, 0, 0]
    rows = [("warpsar", ours, time.process_time() - started), ("Optycal 0.2.0", *by_optycal(mesh, k, directions))]
    return [
        {
            "program": name,
            "angles": len(PHI),
            "cpu_s": seconds,
            "error": float(np.linalg.norm(found - reference) / np.linalg.norm(reference)),
            "decibels": float(np.abs(20 * np.log10(np.abs(found) / np.abs(reference))).mean()),
        }
        for name, found, seconds in rows
    ]


def main() -> None:
    parser = tables.parser(__doc__)
    options = parser.parse_args()
    result = tables.result_of(options, lambda: {"rows": measure()})
    header = ("program", "angles", "CPU [s]", "error of the amplitude", "mean abs(dB)")
    rows = [
        (r["program"], r["angles"], f"{r['cpu_s']:.2f}", f"{r['error']:.1e}", f"{r['decibels']:.3f}")
        for r in result["rows"]
    ]
    tables.publish({"coherent.peer": tables.markdown(header, rows)}, result, options.write)


if __name__ == "__main__":
    main()
