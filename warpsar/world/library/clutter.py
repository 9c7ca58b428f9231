"""Published means of sigma0 of terrain, to look at beside the library."""

from __future__ import annotations

import numpy as np

HANDBOOK: dict[tuple[str, str], tuple[float, float, float, float, float, float]] = {
    ("soil", "HH"): (-24.855, 26.351, 1.146, 0.204, 0.0, 0.0),
    ("soil", "VV"): (-24.951, 28.742, 1.043, -1.681, 0.0, 0.0),
    ("grass", "HH"): (-15.75, 17.931, 2.369, -1.502, 4.592, -3.142),
    ("grass", "VV"): (-93.606, 99.0, 0.22, -5.509, -2.964, 1.287),
    ("dry snow", "HH"): (-42.864, 20.762, 10.0, 30.0, 0.763, -0.147),
    ("dry snow", "VV"): (-19.765, 19.83, 10.0, 7.089, 1.54, -0.012),
}
"""C band (4 to 8 GHz): P1 to P6 of F. T. Ulaby and M. C. Dobson, Handbook of Radar Scattering Statistics for Terrain
(1989). They were read from a public program that copies them, not from the book."""
HANDBOOK_GHZ = (4.0, 8.0)
HANDBOOK_DEG = (15.0, 70.0)

GAMMA_DB: dict[str, float] = {"flatland": -20.0, "farmland": -15.0}
"""Constant gamma at 10 GHz: F. E. Nathanson, Radar Design Principles, 2nd ed. (1999)."""

BESIDE: dict[str, tuple[str | None, str | None]] = {
    "soil_dry": ("soil", "flatland"),
    "soil_wet": ("soil", "farmland"),
    "grass": ("grass", "farmland"),
    "snow_dry": ("dry snow", None),
}
"""What stands beside a surface of the library: a name of `HANDBOOK`, and one of `GAMMA_DB`."""


def handbook_db(name: str, polarization: str, incidence_deg: np.ndarray) -> np.ndarray:
    """Mean sigma0 [dB]: P1 + P2 exp(-P3 t) + P4 cos(P5 t + P6), t the incidence in rad; NaN outside 15 to 70 deg."""
    p1, p2, p3, p4, p5, p6 = HANDBOOK[name, polarization]
    t = np.radians(incidence_deg)
    low, high = HANDBOOK_DEG
    inside = (incidence_deg >= low) & (incidence_deg <= high)
    return np.where(inside, p1 + p2 * np.exp(-p3 * t) + p4 * np.cos(p5 * t + p6), np.nan)


def gamma_db(name: str, frequency_hz: float, incidence_deg: np.ndarray) -> np.ndarray:
    """sigma0 [dB] = gamma cos(incidence), gamma growing as the root of the frequency; NaN outside 30 to 70 deg."""
    gamma = GAMMA_DB[name] + 5.0 * np.log10(frequency_hz / 10e9)
    inside = (incidence_deg >= 30.0) & (incidence_deg <= 70.0)
    cosine = np.cos(np.radians(incidence_deg))
    return np.where(inside, gamma + 10.0 * np.log10(np.maximum(cosine, 1e-9)), np.nan)
