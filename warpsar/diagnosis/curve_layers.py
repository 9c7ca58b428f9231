"""A layer on the metal of a part: the likeliest one beside curves, and what the curves tell of it.

The amplitude of `single` is linear in the two coefficients of reflection, which are functions of the angle to a face,
and that of `edges` in the coefficients of diffraction. So a few sweeps with known layers, `PROBES`, foretell those of
every other one: where the coefficients of a layer are a sum of the probes' own, with weights that add up to one, its
amplitude is the same sum. Of edges a half-plane stands for all. Ways over several faces are not linear, so the
likeliest layer is swept itself, becomes a probe, and is sought again beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from warpsar.coherent.wedge import fringes
from warpsar.curves.materials import MODEL, Kind, MaterialHypothesis
from warpsar.curves.noise import Noise, densities, fit_each
from warpsar.curves.observed import ObservedCurve
from warpsar.curves.shape import TWICE_LOG_LIMIT, ProfileInterval
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import Material, MaterialLayer

MAGNETIC_EPS = 8.0
"""Permittivity of a magnetic layer that is tried, of iron powder in resin: a thin one on metal hardly shows it, since
the electric field along metal is 0."""
PROBES = (
    *((3.0, 1.0, share) for share in (0.02, 0.05, 0.08, 0.12, 0.17, 0.24)),
    *((9.0 - 3.0j, 1.0, share) for share in (0.02, 0.045, 0.075)),
    *((MAGNETIC_EPS, 2.0 - 2.0j, share) for share in (0.01, 0.03)),
)
"""eps_r, mu_r, and thickness over the shortest wavelength."""
AGAIN = 1
"""How often the likeliest layer becomes a probe."""
STARTS = 2
"""Of the places of the grid: from so many of the likeliest a fit goes on."""
_SLOPE = 1e-3  # step of a difference
_COS = np.linspace(0.04, 1.0, 25)
_PHI = np.deg2rad([20.0, 50.0, 75.0, 105.0, 130.0, 160.0, 200.0, 230.0, 310.0, 340.0])  # off the poles
_STEPS = 25
_WALK, _FIRST, _WIDER = 10, 0.02, 1.8  # steps of a profile to a side, the first of them, and how much each grows


@dataclass(frozen=True)
class Family:
    """Layers of three numbers, the logarithms of which a fit moves: thickness over the shortest wavelength, real part,
    loss tangent."""

    kind: Kind
    ends: tuple[tuple[float, float], ...]
    products: dict[str, tuple[float, ...]]
    """What is reported, as the powers in a product of the three numbers."""

    def layer(self, u: NDArray[np.float64], shortest_m: float) -> MaterialLayer:
        thickness, real, tangent = np.exp(u).tolist()
        value = real, -tangent * real
        filling = {"eps_r": value} if self.kind == "dielectric layer" else {"eps_r": MAGNETIC_EPS, "mu_r": value}
        return MaterialLayer(thickness_m=thickness * shortest_m, **filling)  # type: ignore[arg-type]


THICKNESS = "thickness_m"
FAMILIES = (
    Family(
        "dielectric layer",
        ((0.003, 0.3), (1.3, 12.0), (0.003, 1.5)),
        {"eps_r": (0, 1, 0), "loss tangent": (0, 0, 1), THICKNESS: (1, 0, 0), "sqrt(eps_r) x thickness_m": (1, 0.5, 0)},
    ),
    Family(
        "magnetic layer",
        ((0.003, 0.08), (1.0, 8.0), (0.03, 4.0)),
        {THICKNESS: (1, 0, 0), "mu_r x thickness_m": (1, 1, 0), "mu_r loss x thickness_m": (1, 1, 1)},
    ),
)
"""In a thin layer on metal the magnetic field alone is strong, so its curves tell mu_r x thickness, and the loss that
goes with it. A dielectric one shows from a tenth of a wavelength inside it on, by the phase sqrt(eps_r) x thickness."""

SWEEPS = 1 + len(PROBES) + len(FAMILIES) * (AGAIN + 1)
"""Of a part: bare, of the probes, and of each family's likeliest layers."""


def coated(layer: MaterialLayer) -> Material:
    return Material(conductor=True, layers=(layer,))


def layer_of(kind: Kind, values: dict[str, ProfileInterval]) -> MaterialLayer:
    """The likeliest layer, from what is reported of it."""
    family = next(one for one in FAMILIES if one.kind == kind)
    rows = np.array(list(family.products.values()), float)
    u, *_ = np.linalg.lstsq(rows, np.log([values[name].value for name in family.products]), rcond=None)
    return family.layer(u, 1.0)


def reflections(layer: MaterialLayer | None, frequency_hz: float) -> NDArray[np.complex128]:
    """Coefficients of a layer on metal over `_COS`, with E across the plane of incidence and in it, (2, n)."""
    if layer is None:
        return np.full((2, len(_COS)), -1.0 + 0.0j)
    eps, mu = (complex(*one) if isinstance(one, tuple) else complex(one) for one in (layer.eps_r, layer.mu_r))
    root = np.sqrt(eps * mu - 1.0 + _COS**2 + 0j)
    turn = 1j * np.tan(2.0 * np.pi * frequency_hz / SPEED_OF_LIGHT * layer.thickness_m * root)
    across, along = mu / root * turn * _COS, root / eps * turn / _COS
    return np.stack([(across - 1.0) / (across + 1.0), (along - 1.0) / (along + 1.0)])


def coefficients(layer: MaterialLayer | None, frequency_hz: float) -> NDArray[np.complex128]:
    """What amplitudes are linear in: `reflections`, and what the edge of a half-plane adds; one row."""
    edge = fringes(Material(conductor=True) if layer is None else coated(layer), frequency_hz, _PHI)
    return np.concatenate([reflections(layer, frequency_hz).ravel(), edge.ravel()])


class Probed:
    """Train curves beside any layer on one part, from sweeps of some. `sweep` makes those of a part in one material."""

    def __init__(self, sweep: Callable[[Material], MaterialHypothesis], shortest_m: float) -> None:
        self._sweep, self.shortest_m = sweep, shortest_m
        self._curves, self._layers = [sweep(Material(conductor=True)).train], list[MaterialLayer | None]([None])
        self._solving: dict[float, NDArray[np.complex128]] = {}
        for eps, mu, share in PROBES:
            pairs = [(complex(one).real, complex(one).imag) for one in (eps, mu)]
            self.add(MaterialLayer(eps_r=pairs[0], mu_r=pairs[1], thickness_m=share * shortest_m))

    def add(self, layer: MaterialLayer) -> MaterialHypothesis:
        """Sweep a layer, and take it for a probe."""
        made = self._sweep(coated(layer))
        self._curves.append(made.train)
        self._layers.append(layer)
        self._solving.clear()
        return made

    def beside(self, layer: MaterialLayer) -> list[ObservedCurve]:
        """The train curves beside a layer, as the probes foretell them."""
        found = []
        for each in zip(*self._curves, strict=True):
            first, *others = (one.terms[MODEL] for one in each)
            apart = np.stack([one - first for one in others], axis=1)
            found.append(each[0].beside({MODEL: first + apart @ self._weights(layer, each[0].frequency_hz)}))
        return found

    def _weights(self, layer: MaterialLayer, frequency_hz: float) -> NDArray[np.complex128]:
        """Of the probes but the first, whose weight is what is left of one."""
        bare = coefficients(None, frequency_hz)
        if frequency_hz not in self._solving:
            apart = np.stack([coefficients(one, frequency_hz) - bare for one in self._layers[1:]], axis=1)
            self._solving[frequency_hz] = np.asarray(np.linalg.pinv(apart, rcond=1e-4), np.complex128)
        return self._solving[frequency_hz] @ (coefficients(layer, frequency_hz) - bare)


@dataclass(frozen=True)
class _Loss:
    """-2 ln L of the train curves over the logarithms u, which a rising wall keeps between `ends`."""

    probed: Probed
    family: Family
    ends: NDArray[np.float64]

    def layer(self, u: NDArray[np.float64]) -> MaterialLayer:
        return self.family.layer(np.clip(u, *self.ends.T), self.probed.shortest_m)

    def value(self, u: NDArray[np.float64]) -> float:
        return self._with_noise(u)[0]

    def with_slope(self, u: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """The noise is at its likeliest, so by the envelope theorem it adds nothing to a slope, and is held."""
        here, noises = self._with_noise(u)
        ahead = [self._with_noise(u + step, noises)[0] for step in _SLOPE * np.eye(len(u))]
        return here, (np.array(ahead) - here) / _SLOPE

    def _with_noise(self, u: NDArray[np.float64], noises: list[Noise] | None = None) -> tuple[float, list[Noise]]:
        curves = self.probed.beside(self.layer(u))
        held = fit_each(curves, [MODEL])[0] if noises is None else noises
        likelihood = sum(
            float(densities(one, one.amplitude([MODEL]), noise).sum()) for one, noise in zip(curves, held, strict=True)
        )
        out = float(((u - np.clip(u, *self.ends.T)) ** 2).sum())
        return 1e3 * out - 2.0 * likelihood, held


def layered(probed: Probed, family: Family) -> MaterialHypothesis:
    """The likeliest layer of a family. 2 ln L of the train curves falls by 3.84 at the ends of its intervals."""
    ends = np.log(np.array(family.ends))
    loss = _Loss(probed, family, ends)
    grid = [
        np.array(u)
        for u in product(*(np.linspace(low, high, n) for (low, high), n in zip(ends, (7, 3, 3), strict=True)))
    ]
    starts = sorted(grid, key=loss.value)[:STARTS]
    best = min((_least(loss.with_slope, u, ends) for u in starts), key=loss.value)
    for _ in range(AGAIN):
        probed.add(loss.layer(best))
        best = _least(loss.with_slope, best, ends)
    found = probed.add(loss.layer(best))
    return replace(found, kind=family.kind, parameters=len(ends), intervals=partial(_intervals, loss, best))


def _intervals(loss: _Loss, best: NDArray[np.float64]) -> dict[str, ProfileInterval]:
    return {
        name: _profile(loss, best, np.array(powers, float), loss.probed.shortest_m ** powers[0])
        for name, powers in loss.family.products.items()
    }


def _least(
    loss: Callable[[NDArray[np.float64]], tuple[float, NDArray[np.float64]]],
    u: NDArray[np.float64],
    ends: NDArray[np.float64],
) -> NDArray[np.float64]:
    found = minimize(
        loss,
        np.clip(u, *ends.T),
        jac=True,
        method="L-BFGS-B",
        bounds=ends.tolist(),
        options={"ftol": 1e-5, "maxiter": _STEPS},
    )
    return np.asarray(found.x)


def _profile(loss: _Loss, best: NDArray[np.float64], powers: NDArray[np.float64], unit: float) -> ProfileInterval:
    """The interval of a product: its logarithm walks to both sides, and the other coordinates are fitted along."""
    pivot, ends = int(np.argmax(np.abs(powers))), loss.ends
    others = np.delete(np.arange(len(best)), pivot)
    along = np.eye(len(best))[others]  # slopes of all coordinates by the free ones
    along[:, pivot] = -powers[others] / powers[pivot]
    top, centre = loss.value(best), float(powers @ best)
    reach = np.sort((powers[:, None] * ends), axis=1).sum(axis=0)
    found, is_open = [], False
    for sign in (-1.0, 1.0):
        inner, fall, step, u = centre, 0.0, _FIRST, best
        for _ in range(_WALK):
            t = float(np.clip(inner + sign * step, *reach))
            held = np.eye(len(best))[pivot] * t / powers[pivot]

            def loss_of_free(
                free: NDArray[np.float64], held: NDArray[np.float64] = held
            ) -> tuple[float, NDArray[np.float64]]:
                value, slope = loss.with_slope(held + free @ along)
                return value, along @ slope

            u = held + _least(loss_of_free, u[others], ends[others]) @ along
            now = float(np.sqrt(max(loss.value(u) - top, 0.0)))
            if now**2 > TWICE_LOG_LIMIT:
                inner += (np.sqrt(TWICE_LOG_LIMIT) - fall) / (now - fall) * (t - inner)
                break
            if t in reach:
                inner, is_open = t, True
                break
            inner, fall, step = t, now, step * _WIDER
        else:
            is_open = True
        found.append(inner)
    low, high = (float(np.exp(end)) * unit for end in found)
    return ProfileInterval(float(np.exp(centre)) * unit, low, high, is_open)
