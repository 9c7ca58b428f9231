"""`warpsar rcs --contributors`: a body in 3D, each face and edge coloured by what it sends back in one direction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.coherent.command import scene_of
from warpsar.coherent.contributors import Contributors, contributors
from warpsar.coherent.directions import Directions
from warpsar.io.html import write
from warpsar.runtime.busy import busy
from warpsar.scene.scene import Scene
from warpsar.version import __version__
from warpsar.viewer.drapes import Drape
from warpsar.viewer.page import State, page
from warpsar.viewer.surface import Drawn, owners
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import View

NAME = "contributors.html"
WEAK_DB = 40.0
"""Under the strongest face or edge: what is weaker has the darkest colour."""
THICK = 0.006
"""Radius of an edge as it is drawn, over the body's size."""
ALL = "all terms"


def run(
    path: Path,
    out: Path,
    azimuth_deg: float,
    incidence_deg: float,
    frequency_hz: float | None,
    *,
    material: str | None = None,
    units: str | None = None,
    up: str | None = None,
    device: str | None = None,
    rays_per_wavelength: float,
) -> Path:
    """Write the page into the folder `out`, and return its path; `path`, `material`, `units` and `up` are those of
    `warpsar rcs`.

    Raises InputError.
    """
    scene, _, _ = scene_of(path, material, None if frequency_hz is None else [frequency_hz], units, up)
    with busy("finding which faces send"):
        found = contributors(
            scene, azimuth_deg, incidence_deg, frequency_hz, device=device, rays_per_wavelength=rays_per_wavelength
        )
        surface = drawn(scene, found)
    total = _total(found)
    with np.errstate(divide="ignore"):
        levels = 10.0 * np.log10(4.0 * np.pi * np.abs(total) ** 2)
    dbsm = ", ".join(f"{name} {level:.1f} dBsm" for name, level in zip(found.polarizations, levels, strict=True))
    summary = (
        f"warpsar {__version__} rcs; azimuth {azimuth_deg:g}\u00b0, incidence {incidence_deg:g}\u00b0, "
        f"{found.frequency_hz / 1e9:g} GHz: {dbsm}. Colours show what a piece of each face or edge sends, half a "
        "wavelength wide, so that they do not depend on the mesh. Neighbours may cancel. A path of several faces "
        "counts for each of them with what it sends from there."
    )
    write(out / NAME, page(f"What sends back: {path.name}", summary, [_state(scene, found, surface)]))
    return out / NAME


def drawn(scene: Scene, found: Contributors) -> Drawn:
    """Faces and edges with the RCS of a piece of half a wavelength [dBsm], term by term.

    Small faces of one material add up their fields in cells of that width; of a larger face a piece counts. What is
    `WEAK_DB` under the strongest one ends the scale.
    """
    mesh, origin = scene.mesh, np.asarray(scene.reference_point_m)
    size = float(np.ptp(mesh.vertices, axis=0).max())
    bars = _bars(found.start, found.end, THICK * size)
    corners = np.concatenate([(mesh.vertices[mesh.faces] - origin).reshape(-1, 3), bars])
    faces, edges, sides = len(mesh.faces), len(found.start), len(bars) // max(len(found.start), 1)
    of_face, of_edge = np.repeat(np.arange(faces), 3), np.repeat(np.arange(edges), sides)
    material = np.concatenate([mesh.face_material[of_face], np.full(len(of_edge), len(mesh.materials))])
    owned = np.concatenate([owners(scene)[of_face], np.full(len(of_edge), len(scene.objects) + 1)])
    half = 0.5 * SPEED_OF_LIGHT / found.frequency_hz
    cell, share = _cells(scene, half)
    along = half / np.linalg.norm(found.end - found.start, axis=1)
    shown = {}
    for p, name in enumerate(found.polarizations):
        terms = {term: amplitude[:, p] for term, amplitude in found.faces_m.items()}
        none = np.zeros(faces, np.complex128)
        parts = {ALL: (np.sum([none, *terms.values()], axis=0), found.edges_m[:, p])}
        parts |= {term: (amplitude, np.zeros(edges, np.complex128)) for term, amplitude in terms.items()}
        parts["edges"] = none, found.edges_m[:, p]
        for term, (on_faces, on_edges) in parts.items():
            summed = np.zeros(len(share), np.complex128)
            np.add.at(summed, cell, on_faces)
            power = np.concatenate([(np.abs(summed) * share)[cell][of_face], (np.abs(on_edges) * along)[of_edge]]) ** 2
            if power.any():
                shown[f"{term}, {name} [dBsm]"] = power
    least = 10.0 ** (-WEAK_DB / 10.0) * max((float(each.max()) for each in shown.values()), default=1.0)
    return Drawn(
        corners.astype(np.float32),
        np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
        material,
        (*mesh.materials, "edges"),
        owned,
        ("the scene's mesh", *(one.label for one in scene.objects), "edges"),
        levels_db={name: 10.0 * np.log10(4.0 * np.pi * np.maximum(power, least)) for name, power in shown.items()},
    )


def _cells(scene: Scene, half_m: float) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """The cell of each face, (faces,), and what share of a cell's field a piece of half a wavelength has, (cells,)."""
    mesh = scene.mesh
    p = mesh.vertices[mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    place = np.floor(p.mean(axis=1) / half_m)
    alone = np.where(area < half_m**2, 0, 1 + np.arange(len(area)))
    keys = np.column_stack([place, mesh.face_material, alone])
    cell = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    return cell, np.minimum(1.0, half_m**2 / np.maximum(np.bincount(cell, area), 1e-30))


def _total(found: Contributors) -> NDArray[np.complex128]:
    """The amplitude of all faces and edges, (p,)."""
    parts = [each.sum(axis=0) for each in (*found.faces_m.values(), found.edges_m)]
    return np.asarray(np.sum(parts, axis=0))


def _bars(start: NDArray[np.float64], end: NDArray[np.float64], radius_m: float) -> NDArray[np.float64]:
    """The corners of bars with three sides along edges (e, 3), six triangles each, (18 e, 3)."""
    if not len(start):
        return np.empty((0, 3))
    along = end - start
    other = np.eye(3)[np.abs(along).argmin(axis=1)]
    u = np.cross(along, other)
    u *= radius_m / np.linalg.norm(u, axis=1)[:, None]
    v = np.cross(along, u) / np.linalg.norm(along, axis=1)[:, None]
    turn = 2.0 * np.pi * np.arange(3)[:, None, None] / 3.0
    around = np.cos(turn) * u + np.sin(turn) * v  # (3, e, 3)
    sides = []
    for i in range(3):
        a, b = around[i], around[(i + 1) % 3]
        sides += [start + a, start + b, end + b, start + a, end + b, end + a]
    return np.stack(sides, axis=1).reshape(-1, 3)


def _state(scene: Scene, found: Contributors, surface: Drawn) -> State:
    looks = Directions.of([found.azimuth_deg], [found.incidence_deg])
    s, u, v = looks.s[0], looks.u[0], looks.v[0]
    view = View.model_construct(  # an image has no incidence of 90 degrees and more, and this is none
        name="radar", azimuth_deg=found.azimuth_deg, incidence_deg=found.incidence_deg, role=""
    )
    nothing = np.zeros((1, 1), bool)
    shown = Drape(view, np.stack([-s, u, v, s]), scene.radar.slant_range_m, np.zeros(2), nothing, nothing)
    return State("scene", surface, [shown], (1, 1), (1.0, 1.0))
