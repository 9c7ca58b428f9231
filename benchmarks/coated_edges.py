"""Edges of coated metal against exact fields: wedges with surface impedances, and a square cylinder under a layer.

    python benchmarks/coated_edges.py [--write]

Backscatter of waves across the edge. `half-plane` and `right angle`: Maliuzhinets's wedge (Sov. Phys. Dokl. 3, 1958;
the diffraction coefficient of Tiberio, Pelosi, Manara, IEEE TAP 33(8), 1985), its function by a quadrature of its own.
The impedances of both faces are those of the layer at the angles at which they are met. They say whether the engine's
fringe currents and physical optics add up to the exact field. `square`: a metal cylinder of four wavelengths under the
layer, whose sides the coated box of the engine has, by boundary integrals for the fields in the layer and outside of
it. It says what the model of an impedance leaves out. Printed: mean |dB| over angle, of the engine, and of the same
physical optics with the fringe currents of bare metal. The program stops where the exact wedge does not give Keller's
of a conductor.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
import tables
import trimesh
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.special import hankel2

import warpsar
from warpsar.coherent.wedge import fringes
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import MaterialLayer

OUTER = {"half-plane": 2.0, "right angle": 1.5}
"""Outer angle over pi."""
Layer = tuple[complex, complex, float]
"""Permittivity, permeability, and thickness in wavelengths."""
LAYERS: dict[str, Layer] = {
    "eps_r 3, a fiftieth of a wavelength": (3.0 - 0.06j, 1.0, 0.02),
    "eps_r 3, a twentieth": (3.0 - 0.06j, 1.0, 0.05),
    "eps_r 10 - 5j, a fiftieth": (10.0 - 5.0j, 1.0, 0.02),
    "eps_r 1.5 - 3j, an eighth": (1.5 - 3.0j, 1.0, 0.125),
    "eps_r and mu_r 2 - 2j, a tenth": (2.0 - 2.0j, 2.0 - 2.0j, 0.1),
}
WIDE = 4.0
"""Side of the square in wavelengths."""
PANELS = 200
"""Of each side."""
K = 2.0 * np.pi
_NODE, _WEIGHT = leggauss(400)
_S, _W = 10.0 * (_NODE + 1.0), 10.0 * _WEIGHT


def impedance(layer: Layer, up: float, polarization: str) -> complex:
    """Of the surface over that of space, at an angle of sine `up` from it; E or H along the edge, time e^{+jwt}."""
    eps, mu, thick = layer
    q = np.sqrt(eps * mu - 1.0 + up**2 + 0j)
    return complex(1j * np.tan(K * q * thick) * (mu / q if polarization == "E" else q / eps))


def sines(layer: Layer, phi: float, n: float, polarization: str) -> list[complex]:
    """Z / Z0 for H along the edge and Z0 / Z for E, of both faces."""
    found = [impedance(layer, abs(np.sin(at)), polarization) for at in (phi, n * np.pi - phi)]
    return found if polarization == "H" else [1.0 / each for each in found]


def psi(z: complex, half: float) -> complex:
    """Maliuzhinets's function of a wedge whose outer angle is 2 `half`."""
    if z.real < 0.0:
        return psi(-z, half)
    if z.real > 1.5 * half:
        return psi(np.pi / 2 + 0j, half) ** 2 * np.cos(np.pi * (z - np.pi / 2) / (4 * half)) / psi(z - np.pi, half)
    integrand = (np.cosh(z * _S) - 1.0) / (_S * np.cosh(np.pi * _S / 2) * np.sinh(2 * half * _S))
    return complex(np.exp(-0.5 * (integrand * _W).sum()))


def exact(phi: float, n: float, first: complex, second: complex) -> complex:
    """Of a wave that comes and goes at `phi` from the first face, by the `sines` of both."""
    half = n * np.pi / 2.0
    one, two = np.arcsin(complex(first)), np.arcsin(complex(second))
    at, mu = half - phi, 1.0 / n

    def spectrum(a: float) -> complex:
        turned = (
            half + np.pi / 2 - one,
            half - np.pi / 2 + one,
            -half - np.pi / 2 + two,
            -half + np.pi / 2 - two,
        )
        total = complex(np.prod([psi(a + each, half) / psi(at + each, half) for each in turned]))
        return mu * np.cos(mu * at) / (np.sin(mu * a) - np.sin(mu * at)) * total

    return spectrum(at + np.pi) - spectrum(at - np.pi)


def keller(phi: float, n: float, reflected: float) -> float:
    """Of a conductor: 1 for H along the edge, -1 for E."""

    def cot(x: float) -> float:
        return float(1.0 / np.tan(x / (2.0 * n)))

    return (2.0 * cot(np.pi) + reflected * (cot(np.pi - 2.0 * phi) + cot(np.pi + 2.0 * phi))) / (2.0 * n)


def optics(phi: float, n: float, first: complex, second: complex) -> complex:
    """Physical optics of the endless faces by their `sines`: R tan(phi) / 2 of a lit one."""
    lit = [(v, at) for v, at in ((first, phi), (second, n * np.pi - phi)) if at < np.pi]
    return complex(sum((np.sin(at) - v) / (np.sin(at) + v) * np.tan(at) / 2.0 for v, at in lit))


def material(layer: Layer | None, wavelength_m: float) -> warpsar.Material:
    """The layer on metal; bare metal without one."""
    if layer is None:
        return warpsar.Material(conductor=True)
    eps, mu = ((complex(each).real, complex(each).imag) for each in layer[:2])
    made = MaterialLayer(eps_r=eps, mu_r=mu, thickness_m=layer[2] * wavelength_m)
    return warpsar.Material(conductor=True, layers=(made,))


def angles(n: float) -> NDArray[np.float64]:
    """From a face [rad], up to the plane of symmetry: 5 degrees from both, without 10 degrees about a mirror's."""
    every = np.arange(5.0, 90.0 * n - 4.9, 5.0)
    return np.deg2rad(every[np.abs(every - 90.0) > 5.1])


def of_wedge(layer: Layer, n: float, polarization: str) -> list[NDArray[np.complex128]]:
    """Exact, by the engine, and with the fringe currents of bare metal."""
    phi = angles(n)
    pairs = [(float(each), sines(layer, float(each), n, polarization)) for each in phi]
    true = np.array([exact(each, n, *of) for each, of in pairs])
    faces = np.array([optics(each, n, *of) for each, of in pairs])
    both = [fringes(material(each, 1.0), SPEED_OF_LIGHT, phi, n) for each in (layer, None)]
    return [true, *(faces + each["EH".index(polarization)] for each in both)]


Panels = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def square(side: float, count: int) -> Panels:
    """Middles, normals and lengths of its panels, which are shorter to the corners."""
    ends = -0.5 * side * np.cos(np.pi * np.arange(count + 1) / count)
    middle, length = 0.5 * (ends[1:] + ends[:-1]), np.diff(ends)
    normals = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    places = [side / 2 * n + middle[:, None] * np.array([-n[1], n[0]]) for n in normals]
    return np.concatenate(places), np.repeat(normals, count, axis=0), np.tile(length, 4)


def layers_of(at: Panels, source: Panels, k: complex) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Single and double layer of the panels `source`, whose fields are those of H0(2)(kr) / 4j, at the middles `at`."""
    place, normal, length = source
    along = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    single = np.zeros((len(at[0]), len(place)), complex)
    double = np.zeros_like(single)
    same = at is source
    for node, weight in zip(*leggauss(4), strict=True):
        way = at[0][:, None] - (place + 0.5 * node * length[:, None] * along)
        r = np.linalg.norm(way, axis=2)
        if same:
            np.fill_diagonal(r, 1.0)
        step = 0.5 * weight * length / 4j
        single += hankel2(0, k * r) * step
        double += k * hankel2(1, k * r) / r * (way * normal).sum(axis=2) * step
    if same:  # a straight panel's own: the logarithm by hand
        np.fill_diagonal(single, length / 4j * (1.0 - 2j / np.pi * (np.log(k * length / 4.0) + np.euler_gamma - 1.0)))
        np.fill_diagonal(double, 0.0)
    return single, double


def far_field(
    at: Panels, u: NDArray[np.complex128], slope: NDArray[np.complex128], s: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Of fields and slopes on panels, (panels, n), to directions (n, 2): times sqrt(pi k r / 2) e^{jkr - j pi/4}."""
    wave = np.exp(1j * K * at[0] @ s.T)
    return np.asarray(((1j * K * u * (at[1] @ s.T) - slope) * wave * at[2][:, None]).sum(axis=0) / 4j)


def coated_square(layer: Layer, polarization: str, s: NDArray[np.float64], count: int) -> NDArray[np.complex128]:
    """Backscatter of a square of metal under a layer, whose outside is WIDE; as `far_field`."""
    eps, mu, thick = layer
    outside, inside, k = square(WIDE, count), square(WIDE - 2.0 * thick, count), K * np.sqrt(eps * mu + 0j)
    ratio = eps if polarization == "H" else mu  # of the slopes on both sides of the outer surface
    single, double = layers_of(outside, outside, K)
    (s11, d11), (s12, d12) = layers_of(outside, outside, k), layers_of(outside, inside, k)
    (s21, d21), (s22, d22) = layers_of(inside, outside, k), layers_of(inside, inside, k)
    half, none = 0.5 * np.eye(len(single)), np.zeros_like(single)
    core = (-d12, half - d22) if polarization == "H" else (s12, s22)  # no slope on metal, or no field
    matrix = np.block(
        [[half - double, single, none], [half + d11, -ratio * s11, core[0]], [d21, -ratio * s21, core[1]]]
    )
    wave = np.exp(1j * K * outside[0] @ s.T)
    found = np.linalg.solve(matrix, np.concatenate([wave, 0.0 * wave, 0.0 * wave]))
    return far_field(outside, found[: len(wave)], found[len(wave) : 2 * len(wave)], s)


def box_amplitudes(
    azimuths: NDArray[np.float64], side: float, made: warpsar.Material, *terms: str
) -> NDArray[np.complex128]:
    """HH and VV of a metre of a square cylinder, (azimuths, 2): boxes of two heights have the same ends."""
    found = []
    for height in (0.2, 0.4):
        box = trimesh.creation.box((side, side, height))
        mesh = warpsar.Mesh.of(box.vertices, box.faces)
        scene = warpsar.Scene(
            mesh=mesh,
            radar=warpsar.Radar(frequency_hz=10.0 * SPEED_OF_LIGHT, polarizations=("HH", "VV"), terms=terms),
            grid=warpsar.Grid(shape=(4, 4), spacing_m=(1.0, 1.0)),
            materials={"default": made},
            views=[warpsar.View(name="none", azimuth_deg=0.0, incidence_deg=45.0)],
        )
        found.append(warpsar.rcs(scene, azimuths, 90.0, device="cpu").amplitude_m[:, 0, 0])
    return np.asarray((found[1] - found[0]) / 0.2)


def of_square(layer: Layer, polarization: str, count: int = PANELS) -> list[NDArray[np.complex128]]:
    """As `of_wedge`, of the square."""
    azimuths = np.arange(5.0, 46.0, 2.0)
    turned = np.deg2rad(90.0 - azimuths)
    true = coated_square(layer, polarization, np.stack([np.cos(turned), np.sin(turned)], axis=1), count)
    which = "HE".index(polarization)
    side = 0.1 * WIDE
    faces = box_amplitudes(azimuths, side, material(layer, 0.1), "single")[:, which]
    both = (box_amplitudes(azimuths, side, material(each, 0.1), "edges")[:, which] for each in (layer, None))
    return [true, *((-1j if polarization == "E" else 1j) * np.pi * (faces + each) for each in both)]


def main() -> int:
    options = tables.parser(__doc__, stored=False).parse_args()
    made = tables.made()
    for n in OUTER.values():
        for sine, metal in ((1e-7, 1.0), (1e7, -1.0)):
            for phi in angles(n):
                if abs(exact(phi, n, sine, sine) / keller(phi, n, metal) - 1.0) > 1e-3:
                    raise SystemExit(f"a conductor, outer angle {n} pi, {phi} rad: {exact(phi, n, sine, sine)}")
    rows = []
    for name, layer in LAYERS.items():
        eta = impedance(layer, 1.0, "H")
        for body in (*OUTER, "square"):
            cells = []
            for polarization in "EH":
                found = of_square(layer, polarization) if body == "square" else None
                true, *others = found or of_wedge(layer, OUTER[body], polarization)
                cells += [f"{np.abs(20.0 * np.log10(np.abs(each / true))).mean():.2f}" for each in others]
            rows.append((name, f"{eta.real:.2f} {eta.imag:+.2f}j", body, *cells))
    head = ["layer", "impedance from above", "body"]
    head += [f"{pol} along the edge, {of}" for pol in "EH" for of in ("engine", "fringe of bare metal")]
    tables.publish({"coated_edges": tables.markdown(head, rows)}, {"made": made}, options.write)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
