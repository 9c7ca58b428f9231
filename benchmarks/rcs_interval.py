"""The interval of a whole value: fitted to bodies whose RCS is known, and judged on bodies left out one by one.

    python benchmarks/rcs_interval.py DATA -o out/ --write

DATA is the folder of measured data, with austin_rcs/ and austin_bodies/ in it. Known are measured curves of six bodies
of metal, six bodies of revolution by the method of moments (`rcs_revolved.py`) in two sizes each, and a sphere by Mie's
series. The three numbers of `warpsar.coherent.interval` are those of the least interval score in dB (Gneiting and
Raftery, JASA 102, 2007): the width, and 40 times what a value lies outside. Each body counts the same. Rivals are an
interval of constant width in dB about the model, and a constant error in m2, fitted in the same way.

Printed for each body left out: how many of its values lie inside the 95 % interval, and the score.
`out/rcs_interval.json` has it all; --write puts the table into docs/coherent-checks.md.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import rcs_checks
import rcs_revolved as revolved
import tables
import trimesh
from numpy.typing import NDArray
from scipy.optimize import minimize

import warpsar
from warpsar.coherent import interval
from warpsar.coherent.rcs import Rcs, rcs
from warpsar.curves.observe import amplitudes
from warpsar.curves.sectors import apertures
from warpsar.io import curves
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.mesh import read_mesh

ROOT = Path(__file__).resolve().parent.parent
STEP_DEG, DUCT_STEP_DEG = 2.0, 6.0
RADIUS_M, SIZES = 0.1, (3.0, 5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 38.0)
"""Of the ball; ka from each size to a third more."""
WAVELENGTH_M = 0.03
INCIDENCE_DEG = np.arange(0.0, 180.5, 3.0)
AROUND = 120
SHAPES: dict[str, tuple[list[tuple[float, float]], tuple[float, float]]] = {
    "ogive": (revolved.ogive(2.0, 22.62, 60), (1.0, 2.0)),
    "spheroid": (revolved.spheroid(1.0, 2.0, 60), (1.0, 2.0)),
    "cylinder": (revolved.cylinder(1.0, 3.0), (1.0, 1.6)),
    "disc": (revolved.cylinder(1.5, 0.4), (1.0, 1.6)),
    "cone": (revolved.cone(1.0, 3.7), (1.0, 1.6)),
    "top-hat": (revolved.top_hat(0.9, 1.5, 2.2, 0.2), (1.0, 1.4)),
}
"""Outlines (rho, z) in wavelengths, and the factors by which they are made larger."""
LEAST_M2 = 1e-9
SATURATED = ("closed box", "cobra duct")  # about phi = 90, by the descriptions of the suite and by the curves
START = {"interval": (0.5, 0.8, 0.9), "constant width": (6.0, 16.0), "constant error": (0.05,)}
HEADERS = (
    "body",
    "values",
    "inside",
    "score [dB]",
    "constant width: inside",
    "score",
    "constant error: inside",
    "score",
)


@dataclass(frozen=True)
class Rows:
    """Values of one body, (n,) each: wavelength [m], known and modelled power, that of two terms [m2]."""

    wavelength_m: NDArray[np.float64]
    known_m2: NDArray[np.float64]
    modelled_m2: NDArray[np.float64]
    edges_m2: NDArray[np.float64]
    bounced_m2: NDArray[np.float64]
    fresnel_number: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        wavelength_m: NDArray[np.float64],
        known_m2: NDArray[np.float64],
        terms: dict[str, NDArray[np.complex128]],
        number: NDArray[np.float64],
    ) -> Rows:
        """`terms` are sqrt(4 pi) A, (n,) each."""
        powers = (np.abs(each) ** 2 for each in (sum(terms.values()), terms["edges"], terms["multibounce"]))
        return cls(wavelength_m, np.maximum(known_m2, LEAST_M2), *powers, number)

    @classmethod
    def joined(cls, parts: Iterator[Rows]) -> Rows:
        every = list(parts)
        return cls(*(np.concatenate([getattr(one, field.name) for one in every]) for field in fields(cls)))

    def ends_m2(self, kind: str, of: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        modelled = np.maximum(self.modelled_m2, LEAST_M2)
        if kind == "constant width":
            low, high = 10.0 ** (-np.abs(of) / 10.0 * (1.0, -1.0))
            return modelled * low, modelled * high
        if kind == "constant error":
            return interval.ends_m2(self.modelled_m2, np.full(len(modelled), of[0] ** 2))
        c, q, d = np.abs(of).tolist()
        error = interval.error_m2(self.wavelength_m, self.edges_m2, self.bounced_m2, self.fresnel_number, (c, q, d))
        return interval.ends_m2(self.modelled_m2, error)

    def judged(self, kind: str, of: NDArray[np.float64]) -> tuple[float, float]:
        """Share of the values in their intervals, and the mean score [dB]."""
        ends = (10.0 * np.log10(np.maximum(each, LEAST_M2)) for each in (*self.ends_m2(kind, of), self.known_m2))
        low, high, value = ends
        outside = np.maximum(low - value, 0.0) + np.maximum(value - high, 0.0)
        return float((outside == 0.0).mean()), float((high - low + 2.0 / (1.0 - interval.CONFIDENCE) * outside).mean())


def scene(mesh: warpsar.Mesh) -> warpsar.Scene:
    return rcs_checks.scene_of(mesh, terms=("single", "edges", "multibounce"))


def measured(mesh: warpsar.Mesh, files: list[Path], cache: Path, saturated: bool, rays: float = 10.0) -> Iterator[Rows]:
    step = DUCT_STEP_DEG if len(apertures(mesh)) else STEP_DEG  # a duct takes as long as ten bodies without
    for path in files:
        table = curves.read(path)
        phi = 90.0 - table.azimuth_deg
        keep = np.isfinite(table.rcs_m2) & np.isclose((phi + 0.01) % step, 0.01)
        keep &= ~(saturated & (np.abs(phi - 90.0) <= rcs_checks.SATURATED_DEG))
        frequency = float(np.median(table.frequency_hz))
        made = amplitudes(scene(mesh), table.azimuth_deg[keep], 90.0, frequency, cache=cache, rays_per_wavelength=rays)
        wavelength = np.full(keep.sum(), SPEED_OF_LIGHT / frequency)
        yield Rows.of(wavelength, table.rcs_m2[keep], made.of(table.polarization[0]), made.fresnel_number)


def solved(name: str, cache: Path) -> Iterator[Rows]:
    """A body of revolution; what the method of moments gives is kept in `cache`."""
    outline, factors = SHAPES[name]
    for factor in factors:
        corners = [(rho * factor * WAVELENGTH_M, z * factor * WAVELENGTH_M) for rho, z in outline]
        points = revolved.pieces(corners, WAVELENGTH_M / 12.0)
        path = cache / f"{name}-{factor:g}.npz"
        if not path.exists():
            cache.mkdir(parents=True, exist_ok=True)
            np.savez(path, amplitude=revolved.amplitudes(points, 2.0 * np.pi / WAVELENGTH_M, INCIDENCE_DEG))
        exact = 4.0 * np.pi * np.abs(np.load(path)["amplitude"]) ** 2
        found = rcs(scene(revolved.mesh(corners, AROUND)), [0.0], INCIDENCE_DEG, [SPEED_OF_LIGHT / WAVELENGTH_M])
        for p, polarization in enumerate(("VV", "HH")):
            at = found.polarizations.index(polarization)
            terms = _terms(found, np.index_exp[0, :, 0, at])
            wavelength = np.full(len(exact), WAVELENGTH_M)
            yield Rows.of(wavelength, exact[:, p], terms, found.fresnel_number[0, :, 0])


def ball() -> Iterator[Rows]:
    made = trimesh.creation.icosphere(5, RADIUS_M)
    mesh = warpsar.Mesh.of(made.vertices, made.faces)
    for size in SIZES:
        ka = np.linspace(size, 4.0 * size / 3.0, 16)
        frequency = ka / RADIUS_M * SPEED_OF_LIGHT / (2.0 * np.pi)
        found = rcs(scene(mesh), [10.0], 90.0, frequency)
        exact = np.pi * np.array([abs(revolved.mie(x)) * RADIUS_M for x in ka]) ** 2
        terms = _terms(found, np.index_exp[0, 0, :, 0])
        yield Rows.of(SPEED_OF_LIGHT / frequency, exact, terms, found.fresnel_number[0, 0])


def _terms(found: Rcs, at: tuple[int | slice, ...]) -> dict[str, NDArray[np.complex128]]:
    return {name: np.sqrt(4.0 * np.pi) * term[at] for name, term in found.terms_m.items()}


def every_body(data: Path, cache: Path) -> dict[str, Rows]:
    suite, others = data / "austin_rcs", data / "austin_bodies"
    made: dict[str, Callable[[], Iterator[Rows]]] = {}
    for name, (code, make) in rcs_checks.BODIES.items():
        if name not in rcs_checks.MATERIALS:
            files = sorted((suite / "measured").glob(f"meas_rcs.{code}.*.txt"))
            made[name] = lambda name=name, make=make, files=files: measured(
                make(suite), files, cache, name in SATURATED
            )
    for name, code, rays in (("almond", "III.A", 20.0), ("prime_closed_duct", "IV.A", 10.0)):
        files = sorted((others / "measured").glob(f"meas_rcs.{code}.*"))  # the almond is less than a wavelength thick
        made[name] = lambda name=name, files=files, rays=rays: measured(
            read_mesh(others / f"{name}.obj"), files, cache, False, rays
        )
    for name in SHAPES:
        made[name] = lambda name=name: solved(name, cache)
    made["sphere"] = ball
    found = {}
    for name, make in made.items():
        print(name, file=sys.stderr)
        found[name] = Rows.joined(make())
    return found


def fitted(some: list[Rows], kind: str, start: tuple[float, ...]) -> NDArray[np.float64]:
    def loss(x: NDArray[np.float64]) -> float:
        return float(np.mean([one.judged(kind, np.exp(x))[1] for one in some]))

    options = {"maxiter": 80, "xatol": 0.02, "fatol": 0.01}
    return np.asarray(np.exp(minimize(loss, np.log(start), method="Nelder-Mead", options=options).x))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("WARPSAR_MEASURED") or ROOT.parent / "shared" / "data")
    parser.add_argument("data", type=Path, nargs="?", default=default, help="the folder of measured data")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for rcs_interval.json and the cache")
    tables.add_write(parser)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    there = every_body(options.data, options.out / "cache")
    result: dict[str, Any] = {"made": tables.made()}
    judged: dict[str, dict[str, tuple[float, float]]] = {name: {} for name in there}
    for kind, start in START.items():
        of_all = fitted(list(there.values()), kind, start)
        for left_out, one in there.items():
            others = [each for name, each in there.items() if name != left_out]
            judged[left_out][kind] = one.judged(kind, fitted(others, kind, tuple(of_all)))
        result[kind] = {
            "of_all": of_all.tolist(),
            "left_out": {name: dict(zip(("inside", "score_db"), each[kind], strict=True))
                         for name, each in judged.items()},
        }  # fmt: skip
        print(kind, of_all, file=sys.stderr)
    (options.out / "rcs_interval.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    lines = [_line(name, len(there[name].known_m2), [each[kind] for kind in START]) for name, each in judged.items()]
    mean = [tuple(np.mean([each[kind] for each in judged.values()], axis=0)) for kind in START]
    lines.append(_line("mean of the bodies", sum(len(each.known_m2) for each in there.values()), mean))
    tables.publish({"rcs_interval": tables.markdown(HEADERS, lines)}, result, options.write)
    return 0


def _line(name: str, count: int, found: list[tuple[float, float]]) -> list[str]:
    cells = [cell for inside, score in found for cell in (f"{100 * inside:.0f} %", f"{score:.1f}")]
    return [name, f"{count:,}", *cells]


if __name__ == "__main__":
    raise SystemExit(main())
