"""How far off the engine is at edges of coated metal, and a published heuristic beside it: backscatter of wedges.

    python benchmarks/coated_edges.py [--write]

Exact is Maliuzhinets's wedge with a surface impedance on both faces (Sov. Phys. Dokl. 3, 1958; the diffraction
coefficient of Tiberio, Pelosi, Manara, IEEE TAP 33(8), 1985), for waves across the edge. The impedance is that of a
layer on metal from above. `engine`: fringe currents of a conductor, and physical optics with the layer's coefficient of
reflection, as the engine adds them. `Luebbers` has Fresnel's coefficients in it (IEEE TAP 32(1), 1984). Printed: mean
|dB| over angle, from 5 degrees above a face to 5 degrees from the plane of symmetry, without the 10 degrees about each
mirror direction. The program stops where the exact form does not give Keller's of a conductor.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
import tables
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

OUTER = {"half-plane": 2.0, "right angle": 1.5}
"""Outer angle over pi."""
LAYERS = {
    "eps_r 3, a fiftieth of a wavelength": (3.0 - 0.06j, 0.02),
    "eps_r 3, a twentieth": (3.0 - 0.06j, 0.05),
    "eps_r 10 - 5j, a fiftieth": (10.0 - 5.0j, 0.02),
    "matched from above": None,
}
"""Permittivity, and thickness in wavelengths."""
_NODE, _WEIGHT = leggauss(400)
_S, _W = 10.0 * (_NODE + 1.0), 10.0 * _WEIGHT


def impedance(layer: tuple[complex, float] | None) -> complex:
    """Of the surface from above, over that of space; time e^{+jwt}."""
    if layer is None:
        return 1.0 + 0j
    index = np.sqrt(layer[0])
    return complex(1j * np.tan(2.0 * np.pi * index * layer[1]) / index)


def psi(z: complex, half: float) -> complex:
    """Maliuzhinets's function of a wedge whose outer angle is 2 `half`."""
    if z.real < 0.0:
        return psi(-z, half)
    if z.real > 1.5 * half:
        return psi(np.pi / 2 + 0j, half) ** 2 * np.cos(np.pi * (z - np.pi / 2) / (4 * half)) / psi(z - np.pi, half)
    integrand = (np.cosh(z * _S) - 1.0) / (_S * np.cosh(np.pi * _S / 2) * np.sinh(2 * half * _S))
    return complex(np.exp(-0.5 * (integrand * _W).sum()))


def exact(phi: float, n: float, sine: complex) -> complex:
    """Of a wave that comes and goes at `phi` from one face; `sine` is Z / Z0 for H along the edge, Z0 / Z for E."""
    half = n * np.pi / 2.0
    theta, at, mu = np.arcsin(complex(sine)), half - phi, 1.0 / n

    def spectrum(a: float) -> complex:
        turned = (
            half + np.pi / 2 - theta,
            half - np.pi / 2 + theta,
            -half - np.pi / 2 + theta,
            -half + np.pi / 2 - theta,
        )
        total = complex(np.prod([psi(a + each, half) / psi(at + each, half) for each in turned]))
        return mu * np.cos(mu * at) / (np.sin(mu * a) - np.sin(mu * at)) * total

    return spectrum(at - np.pi) - spectrum(at + np.pi)


def keller(phi: float, n: float, first: complex, second: complex) -> complex:
    """With the coefficients of reflection of both faces: +1 and -1 for H and E along the edge of a conductor."""

    def cot(x: float) -> float:
        return 1.0 / np.tan(x / (2.0 * n))

    reflected = first * cot(np.pi - 2.0 * phi) + second * cot(np.pi + 2.0 * phi)
    return (2.0 * cot(np.pi) + reflected) / (2.0 * n)


def engine(phi: float, n: float, first: complex, second: complex, metal: float) -> complex:
    """A conductor's, with physical optics of coated faces instead of a conductor's: R tan(phi) / 2 of a lit face."""
    lit = [(each, at) for each, at in ((first, phi), (second, n * np.pi - phi)) if at < np.pi]
    return keller(phi, n, metal, metal) + sum((each - metal) * np.tan(at) / 2.0 for each, at in lit)


def angles(n: float) -> NDArray[np.float64]:
    """From a face [rad], up to the plane of symmetry."""
    every = np.arange(5.0, 90.0 * n - 4.9, 5.0)
    return np.deg2rad(every[np.abs(every - 90.0) > 5.1])


def errors(n: float, eta: complex, polarization: str) -> dict[str, float]:
    """Mean |dB| of both forms."""
    sine, metal = (eta, 1.0) if polarization == "H" else (1.0 / eta, -1.0)
    off: dict[str, list[float]] = {"engine": [], "Luebbers": []}
    for phi in angles(n):
        true = exact(phi, n, sine)
        up = abs(np.sin(phi)), abs(np.sin(n * np.pi - phi))
        faces = [(each - sine) / (each + sine) for each in up]
        for name, form in (("engine", engine(phi, n, *faces, metal)), ("Luebbers", keller(phi, n, *faces))):
            off[name].append(abs(20.0 * np.log10(abs(form / true))))
    return {name: float(np.mean(each)) for name, each in off.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    tables.add_write(parser)
    options = parser.parse_args()
    for n in OUTER.values():
        for sine, metal in ((1e-7, 1.0), (1e7, -1.0)):
            for phi in angles(n):
                if abs(abs(exact(phi, n, sine) / keller(phi, n, metal, metal)) - 1.0) > 1e-3:
                    raise SystemExit(f"a conductor, outer angle {n} pi, {phi} rad: {exact(phi, n, sine)}")
    rows = []
    for layer, made in LAYERS.items():
        for wedge, n in OUTER.items():
            of = {pol: errors(n, impedance(made), pol) for pol in "EH"}
            eta = impedance(made)
            cells = [f"{of[pol][name]:.1f}" for name in ("engine", "Luebbers") for pol in "EH"]
            rows.append((layer, f"{eta.real:.2f} {eta.imag:+.2f}j", wedge, *cells))
    head = ("layer", "impedance", "wedge", "engine, E along the edge", "H along it", "Luebbers, E along", "H along it")
    tables.publish({"coated_edges": tables.markdown(head, rows)}, {"made": tables.made()}, options.write)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
