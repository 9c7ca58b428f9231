"""The curves of the Austin RCS Benchmark Suite beside the models of its bodies, for `rcs.py` and its parts."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rcs_bodies as bodies
from numpy.typing import NDArray

import warpsar
from warpsar.curves import sectors
from warpsar.curves.angles import independent_deg, width_m
from warpsar.curves.observe import amplitudes
from warpsar.curves.observed import ObservedCurve
from warpsar.curves.search import CANDIDATES, DECLARED, TermSearch, by_sector
from warpsar.errors import InputError
from warpsar.io import curves

SUITE_FILE = re.compile(
    r"(?P<kind>\w*)_rcs\.(?P<body>[IVX]+S?\.?[A-Z])\.(?P<size>s\w+)\.(?P<code>f\w+)\.", re.IGNORECASE
)
FIRST = re.compile(r"meas_rcs\.\w+\.\w\.s\w*\.(f9|f10|fx1)\.[HV]\.txt")
TRAIN = ("f9", "f10")
SATURATED_DEG = 5.0
"""About phi = 90 the range saturated on two of the boxes: their descriptions say so at 10 GHz, the curves at 5."""
PER_DIRECTION = 6.0
LOBES_DEG = 55.0
"""Of the dielectric plate: beyond them the background is stronger."""
DUCT_DB, OTHER_DB = 40.0, 80.0
"""How far under a curve's peak values still count, with and without an aperture: the suite's measure is the second."""


@dataclass(frozen=True)
class Body:
    """A body of the suite."""

    key: str
    code: str
    make: Callable[[Path], warpsar.Mesh]
    saturated: bool = False
    size: str = "s1"
    material: Mapping[float, Mapping[str, object]] | None = None
    """By frequency [Hz]; a conductor without."""

    def scene(self, mesh: warpsar.Mesh, frequency_hz: float) -> warpsar.Scene:
        if self.material is None:
            return bodies.scene(mesh)
        nearest = min(self.material, key=lambda each: abs(each - frequency_hz))
        return bodies.scene(mesh, self.material[nearest])


DIELECTRIC = {f: {"eps_r": e, "thickness_m": bodies.DIELECTRIC_THICKNESS_M, "rms_height_m": 0.0}
              for f, e in bodies.DEBYE.items()}  # fmt: skip
BODIES = (
    Body("pec_plate", "II.B", lambda data: bodies.pec_plate(), size="sx1"),
    Body("dielectric_plate", "II.C", lambda data: bodies.sheet(), size="sx1", material=DIELECTRIC),
    Body("box_closed", "IIIS.A", lambda data: bodies.closed_box(), saturated=True),
    Body("box_cobra", "IIIS.B", lambda data: bodies.stl_box(data, "cobra"), saturated=True),
    Body("box_cylinder", "IIIS.C", lambda data: bodies.cylinder_box()),
)


@dataclass(frozen=True)
class Measured:
    """A curve file of the folder."""

    path: Path
    table: curves.RcsTable
    body: str
    size: str
    first: bool
    """Whether it is of the first measurement at a known frequency: these alone name anything."""
    role: str


def measured(data: Path) -> list[Measured]:
    """Every curve under the folder, sorted. A file whose name is of the suite's kind and that is no curve is said."""
    found = []
    for path in sorted(p for p in data.rglob("*") if p.suffix.lower() in (".txt", ".csv")):
        named = SUITE_FILE.search(path.name)
        try:
            table = curves.read(path)
            for frequency in table.frequencies_hz():
                for pol in sorted({*table.polarization}):
                    first = path.parent.name == "measured" and FIRST.fullmatch(path.name) is not None
                    role = "train" if first and any(f".{code}." in path.name for code in TRAIN) else "test"
                    one = table.select(frequency, pol or None)
                    body, size = (path.stem, "") if named is None else (named["body"].upper(), named["size"].lower())
                    body = body if named is None or "." in body else f"{body[:-1]}.{body[-1]}"
                    found.append(Measured(path, one, body, size, first, role))
        except InputError as error:
            if named is not None:  # a licence is a text, too
                print(f"left out: {error}", file=sys.stderr)
    return found


class Work:
    """One body: its curves beside its model, sector by sector."""

    def __init__(
        self, body: Body, files: Sequence[Measured], data: Path, cache: Path, device: str | None, jobs: int = 1
    ) -> None:
        self.body, self.files, self.cache, self.device, self.jobs = body, files, cache, device, jobs
        self.mesh = body.make(data)
        self.normals = sectors.apertures(self.mesh)
        self.low_db = DUCT_DB if len(self.normals) else OTHER_DB
        self.curves = [self.observed(one, self.mesh) for one in files]

    def observed(self, one: Measured, mesh: warpsar.Mesh) -> ObservedCurve:
        """A curve with all its rows and the terms of a mesh."""
        table = one.table
        phi = 90.0 - table.azimuth_deg
        keep = np.isfinite(table.rcs_m2) & ~(self.body.saturated & (np.abs(phi - 90.0) <= SATURATED_DEG))
        half = np.isclose((phi * 2.0 + 0.5) % 1.0, 0.5)  # every half degree, as the suite's error has it
        keep &= half if half.any() else True
        azimuth, frequency, pol = table.azimuth_deg[keep], float(table.frequency_hz[0]), table.polarization[0]
        theta = float(np.median(table.incidence_deg))
        scene = self.body.scene(mesh, frequency)
        made = amplitudes(scene, azimuth, theta, frequency, cache=self.cache, device=self.device)
        incidence = np.full(len(azimuth), theta)
        step = independent_deg(width_m(mesh, azimuth, incidence), frequency)
        terms = made.of(pol)
        if self.body.material is not None:
            # A slab's edges are what its polarization sends beyond physical optics, and nothing else.
            terms["normal"], terms["edges"] = terms["edges"], np.zeros_like(terms["edges"])
        return ObservedCurve(
            one.path.name, frequency, pol, one.role, azimuth, incidence, table.rcs_m2[keep], terms, step
        )

    def sector(self, one: ObservedCurve, name: str) -> NDArray[np.bool_]:
        return sectors.sectors(self.normals, one.azimuth_deg, one.incidence_deg)[name]

    def part(self, curves: Sequence[ObservedCurve] | None = None) -> list[ObservedCurve]:
        """The curves that may name something, without rows that say nothing new."""
        given = [one for file, one in zip(self.files, curves or self.curves, strict=True) if file.first]
        if self.body.material is not None:
            given = [one.where(90.0 - one.azimuth_deg < LOBES_DEG) for one in given]
        return [one.thinned(PER_DIRECTION) for one in given]


def find(work: Work, curves: Sequence[ObservedCurve] | None = None) -> dict[str, TermSearch]:
    """What each sector names, with the declared terms or other ones."""
    if work.body.material is None:
        return by_sector(work.part(curves), work.normals)
    return by_sector(work.part(curves), work.normals, DECLARED, {"normal_currents": "normal", **CANDIDATES})
