"""Bodies of the Austin RCS Benchmark Suite, built from their drawings or read from their models; front to +X, metres.

Not every printed dimension agrees with the model of the same body: the diameter of the cylindrical duct is 0.73025 L
in the drawing, and 0.75 L in the STL. So the duct's dimensions are parameters here.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

import warpsar
from warpsar.world.mesh import read_mesh

L_M, FULL_L_M = 0.4, 12.8
"""The length of the boxes as measured, and in the STL files."""
PLATE_M = (7 / 4 * 6 * 25.4e-3, 6 * 25.4e-3)
PEC_THICKNESS_M, DIELECTRIC_THICKNESS_M = 64 * 25.4e-6, 1.5e-3
DEBYE = {2.56e9: (2.61, -0.0360), 5.12e9: (2.61, -0.0354), 7e9: (2.61, -0.0346), 10.24e9: (2.61, -0.0321)}
"""Permittivity of the dielectric plate by its description."""
BOX = np.array([(0.0, 0.0), (0.0, 0.26), (0.27, 0.53), (1.0, 0.53), (1.0, -0.27), (0.27, -0.27)]) * L_M
WIDE_BOX = np.array([(0.0, 0.0), (0.0, 0.78), (0.41, 1.19), (1.0, 1.19), (1.0, -0.41), (0.41, -0.41)]) * L_M
"""Profiles: way from the front, height."""
WIDTH_M, WIDE_WIDTH_M = 0.325 * L_M, 0.975 * L_M
SEGMENTS = 96


@dataclass(frozen=True)
class Duct:
    """A circular duct from the middle of the front, in metres."""

    radius_m: float = 0.375 * L_M
    length_m: float = 0.75 * L_M
    right_m: float = 0.0
    """Of the axis from the middle of the front, to +Y."""
    up_m: float = 0.0


MODEL = Duct()
DRAWING = Duct(radius_m=0.5 * 0.73025 * L_M)


def pec_plate() -> warpsar.Mesh:
    """II.B: a thin box of metal."""
    size = (PEC_THICKNESS_M, *PLATE_M)
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return warpsar.Mesh.of(corners, np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]))


def sheet() -> warpsar.Mesh:
    """II.C: an open sheet, whose material has a thickness."""
    corners = np.array([[0.0, y, z] for y, z in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]) * (1, *PLATE_M)
    return warpsar.Mesh.of(corners, np.array([(0, 1, 2), (0, 2, 3)]))


def closed_box() -> warpsar.Mesh:
    """III.SA: the hexagonal prism."""
    vertices, faces = _prism(BOX, WIDTH_M)
    return warpsar.Mesh.of(vertices, np.array(faces))


def closed_wide_box() -> warpsar.Mesh:
    """The prism of III.SC without its duct."""
    vertices, faces = _prism(WIDE_BOX, WIDE_WIDTH_M)
    return warpsar.Mesh.of(vertices, np.array(faces))


def cylinder_box(duct: Duct = MODEL, segments: int = SEGMENTS) -> warpsar.Mesh:
    """III.SC: the wide prism with a circular duct in its front. Raises ValueError where the duct leaves the front."""
    room = 0.5 * min(WIDE_WIDTH_M - 2 * abs(duct.right_m), WIDE_BOX[1, 1] - 2 * abs(duct.up_m))
    if duct.radius_m >= room or duct.length_m >= L_M:
        raise ValueError(f"{duct} does not fit into the box")
    vertices, faces = _prism(WIDE_BOX, WIDE_WIDTH_M)
    n = len(WIDE_BOX)
    faces = [face for face in faces if not {0, 1, n, n + 1} >= set(face)]  # the front is made anew, with a hole
    height = WIDE_BOX[1, 1]
    middle = np.array([0.0, 0.5 * WIDE_WIDTH_M + duct.right_m, 0.5 * height + duct.up_m])
    corners = np.array([(0.0, 0.0), (WIDE_WIDTH_M, 0.0), (WIDE_WIDTH_M, height), (0.0, height)])
    to_corner = np.arctan2(corners[:, 1] - middle[2], corners[:, 0] - middle[1])
    even = np.linspace(-math.pi, math.pi, segments, endpoint=False)
    # A ray of the ring goes to each corner of the front; evenly spaced ones that come close to it make way.
    kept = even[
        np.abs((even[:, None] - to_corner + math.pi) % (2 * math.pi) - math.pi).min(axis=1) > math.pi / segments / 2
    ]
    angle = np.sort(np.concatenate([kept, to_corner]))
    ray = np.stack([np.zeros_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(np.array(side) - middle[1:]) / ray[:, 1:] for side in ((0.0, 0.0), (WIDE_WIDTH_M, height))])
    reach = np.where(ends > 0.0, ends, np.inf).min(axis=(0, 2))
    outer = middle + reach[:, None] * ray
    rim = middle + duct.radius_m * ray
    floor = rim - np.array([duct.length_m, 0.0, 0.0])
    first, m = len(vertices), len(angle)
    rows = np.concatenate([vertices, outer, rim, floor, [middle - np.array([duct.length_m, 0.0, 0.0])]])
    for i in range(m):
        j = (i + 1) % m
        (a, b), (c, d), (e, f) = ((first + k * m + i, first + k * m + j) for k in range(3))
        faces += [(a, b, d), (a, d, c), (c, d, f), (c, f, e), (e, f, first + 3 * m)]
    return warpsar.Mesh.of(rows, np.array(faces))


def stl_box(data: Path, name: str) -> warpsar.Mesh:
    """A box of the suite as its STL has it: scaled, and turned by 180 degrees about z."""
    with TemporaryDirectory() as folder, zipfile.ZipFile(data / f"{name}_duct_s6_stl.zip") as packed:
        (member,) = packed.namelist()
        mesh = read_mesh(Path(packed.extract(member, folder)))
    scale = L_M / FULL_L_M
    return warpsar.Mesh.of(mesh.vertices * (-scale, -scale, scale), mesh.faces)


def scene(mesh: warpsar.Mesh, material: Mapping[str, object] | None = None) -> warpsar.Scene:
    """A body in space; a conductor, unless a material is given."""
    made = warpsar.Material(**(material or {"conductor": True}))  # type: ignore[arg-type]
    return warpsar.Scene(
        mesh=mesh,
        radar=warpsar.Radar(frequency_hz=7e9, polarizations=("VV", "HH"), terms=("single", "edges", "multibounce")),
        grid=warpsar.Grid(shape=(4, 4), spacing_m=(1.0, 1.0)),
        materials=dict.fromkeys(mesh.materials, made),
        views=[warpsar.View(name="none", azimuth_deg=0.0, incidence_deg=45.0)],
    )


def _prism(profile: NDArray[np.float64], width: float) -> tuple[NDArray[np.float64], list[tuple[int, int, int]]]:
    n = len(profile)
    ends = [np.column_stack([-profile[:, 0], np.full(n, y), profile[:, 1]]) for y in (0.0, width)]
    faces = [t for i in range(1, n - 1) for t in ((0, i, i + 1), (n, n + i + 1, n + i))]
    faces += [t for i in range(n) for j in [(i + 1) % n] for t in ((i, i + n, j), (j, i + n, j + n))]
    return np.concatenate(ends), faces
