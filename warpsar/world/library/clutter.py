"""Published means of sigma0 of terrain and sea, to look at beside the library."""

from __future__ import annotations

import numpy as np

Six = tuple[float, float, float, float, float, float]
HANDBOOK: dict[tuple[str, str, str], Six] = {
    ("C", "soil", "HH"): (-24.855, 26.351, 1.146, 0.204, 0.0, 0.0),
    ("C", "soil", "VV"): (-24.951, 28.742, 1.043, -1.681, 0.0, 0.0),
    ("C", "soil", "HV"): (-26.7, 15.055, 1.816, -0.499, 0.0, 0.0),
    ("C", "grass", "HH"): (-15.75, 17.931, 2.369, -1.502, 4.592, -3.142),
    ("C", "grass", "VV"): (-93.606, 99.0, 0.22, -5.509, -2.964, 1.287),
    ("C", "grass", "HV"): (-23.109, 13.591, 1.508, -0.757, 4.491, -3.142),
    ("C", "dry snow", "HH"): (-42.864, 20.762, 10.0, 30.0, 0.763, -0.147),
    ("C", "dry snow", "VV"): (-19.765, 19.83, 10.0, 7.089, 1.54, -0.012),
    ("C", "dry snow", "HV"): (-25.543, 16.64, 10.0, -2.959, 3.116, 2.085),
    ("C", "wet snow", "HH"): (-31.91, 17.749, 11.854, 30.0, 0.421, 0.74),
    ("C", "wet snow", "VV"): (4.288, 15.642, 15.0, 30.0, 0.535, 1.994),
    ("C", "wet snow", "HV"): (-24.622, 15.102, 15.0, -3.401, 2.431, 3.142),
    ("L", "soil", "HH"): (2442.0, -3.771, -2.193, -2442.0, 0.1711, -0.07967),
    ("L", "soil", "VV"): (-94.36, 99.0, 0.365, -3.398, 5.0, -1.739),
    ("L", "soil", "HV"): (-30.2, 15.261, 3.56, -0.424, 0.0, 0.0),
    ("L", "grass", "HH"): (-29.325, 37.55, 2.332, -2.615, 5.0, -1.616),
    ("L", "grass", "VV"): (-28.022, 36.59, 2.53, -1.53, 5.0, -1.513),
    ("L", "grass", "HV"): (-40.166, 26.833, 2.029, -1.473, 3.738, -1.324),
    ("L", "dry snow", "HH"): (-74.019, 99.0, 1.592, -30.0, 1.928, 0.905),
    ("L", "dry snow", "VV"): (-77.032, 99.0, 1.415, -30.0, 1.72, 0.997),
    ("L", "dry snow", "HV"): (-91.341, 99.0, 1.202, 30.0, 1.79, -2.304),
    ("L", "wet snow", "HH"): (-73.069, 95.221, 1.548, 30.0, 1.795, -2.126),
    ("L", "wet snow", "VV"): (-75.156, 99.0, 1.446, 30.0, 1.793, -2.179),
    ("L", "wet snow", "HV"): (-90.98, 99.0, 1.129, 30.0, 1.827, -2.308),
}
"""P1 to P6 of F. T. Ulaby and M. C. Dobson, Handbook of Radar Scattering Statistics for Terrain (1989), by band, cover
and polarization. They were read from a public program that copies them, not from the book. That program says of soil at
L band in HH that it fitted the six again, because those in print gave a wrong curve."""
HANDBOOK_GHZ = {"L": (1.0, 2.0), "C": (4.0, 8.0)}
HANDBOOK_DEG = (15.0, 70.0)

GAMMA_DB: dict[str, float] = {"flatland": -20.0, "farmland": -15.0}
"""Constant gamma at 10 GHz: F. E. Nathanson, Radar Design Principles, 2nd ed. (1999)."""

NRL: dict[str, tuple[float, float, float, float, float]] = {
    "HH": (-73.0, 20.781, 7.351, 25.65, 0.0054),
    "VV": (-50.796, 25.93, 0.7093, 21.588, 0.00211),
}
"""c1 to c5 of V. Gregers-Hansen and R. Mital, IEEE Trans. AES (2012), also NRL/MR/5310-12-9346: 0.5 to 35 GHz, sea
states 0 to 6. They were read from a public program, not from the paper."""
NRL_DEG = (30.0, 89.9)

CMOD5N = (
    *(-0.6878, -0.7957, 0.338, -0.1728, 0.0, 0.004, 0.1103, 0.0159, 6.7329, 2.7713, -2.2885, 0.4971, -0.725, 0.045),
    *(0.0066, 0.3222, 0.012, 22.7, 2.0813, 3.0, 8.3659, -3.3428, 1.3236, 6.2437, 2.3893, 0.3249, 4.159, 1.693),
)
"""c1 to c28 of CMOD5.N (Hersbach 2010). They were read from a public program that copies IFREMER's xsarsea."""

BESIDE: dict[str, tuple[str | None, str | None]] = {
    "soil_dry": ("soil", "flatland"),
    "soil_wet": ("soil", "farmland"),
    "grass": ("grass", "farmland"),
    "snow_dry": ("dry snow", None),
    "snow_wet": ("wet snow", None),
}
"""What stands beside a surface of the library: a cover of `HANDBOOK`, and one of `GAMMA_DB`."""
SEA: dict[str, tuple[int, float]] = {"water_calm": (0, 2.0), "water_rough": (3, 7.0)}
"""The same of water: the sea state of `NRL`, and the wind [m/s] of `CMOD5N`."""


def handbook_band(frequency_hz: float) -> str | None:
    """The band of `HANDBOOK` in which a frequency lies."""
    return next((band for band, (low, high) in HANDBOOK_GHZ.items() if low <= frequency_hz / 1e9 <= high), None)


def handbook_db(band: str, name: str, polarization: str, incidence_deg: np.ndarray) -> np.ndarray:
    """Mean sigma0 [dB]: P1 + P2 exp(-P3 t) + P4 cos(P5 t + P6), t the incidence in rad; NaN outside 15 to 70 deg."""
    p1, p2, p3, p4, p5, p6 = HANDBOOK[band, name, polarization]
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


def sea_db(sea_state: int, polarization: str, frequency_hz: float, incidence_deg: np.ndarray) -> np.ndarray:
    """Mean sigma0 [dB] of the sea by `NRL`, over all directions of the wind; NaN below 30 deg."""
    c1, c2, c3, c4, c5 = NRL[polarization]
    grazing = 90.0 - np.clip(incidence_deg, *NRL_DEG)
    by_frequency = (27.5 + c3 * grazing) * np.log10(frequency_hz / 1e9) / (1.0 + 0.95 * grazing)
    by_state = c4 * (1.0 + sea_state) ** (1.0 / (2.0 + 0.085 * grazing + 0.033 * sea_state))
    found = c1 + c2 * np.log10(np.sin(np.radians(grazing))) + by_frequency + by_state + c5 * grazing**2
    return np.where((incidence_deg >= NRL_DEG[0]) & (incidence_deg <= NRL_DEG[1]), found, np.nan)


def cmod5n_db(wind_m_s: float, incidence_deg: np.ndarray) -> np.ndarray:
    """Mean sigma0 [dB] of the sea by `CMOD5N`, C band, VV: its B0, without the terms of the wind's direction."""
    c = (0.0, *CMOD5N)
    x = (incidence_deg - 40.0) / 25.0
    a0 = c[1] + c[2] * x + c[3] * x**2 + c[4] * x**3
    a1, a2 = c[5] + c[6] * x, c[7] + c[8] * x
    gamma, s0 = c[9] + c[10] * x + c[11] * x**2, c[12] + c[13] * x
    s = a2 * wind_m_s
    at_s0 = 1.0 / (1.0 + np.exp(-s0))
    below = at_s0 * np.where(s < s0, s / s0, 1.0) ** (s0 * (1.0 - at_s0))
    a3 = np.where(s < s0, below, 1.0 / (1.0 + np.exp(-s)))
    return 10.0 * (gamma * np.log10(a3) + a0 + a1 * wind_m_s)
