"""Relative permittivity of building materials, soil, water and snow against frequency, by published models.

All functions give eps' - j eps'' (field as exp(+j omega t)) and take the frequency in Hz.
"""

from __future__ import annotations

import math

LOSS = 17.98
"""1 / (2 pi eps0), in GHz m / S: eps'' = LOSS sigma / f. Recommendation ITU-R P.2040 rounds so."""

BUILDING: dict[str, tuple[float, float, float, float, float, float]] = {
    # name: a, b, c, d, lowest GHz, highest GHz
    "concrete": (5.24, 0.0, 0.0462, 0.7822, 1.0, 100.0),
    "brick": (3.91, 0.0, 0.0238, 0.16, 1.0, 40.0),
    "wood": (1.99, 0.0, 0.0047, 1.0718, 0.001, 100.0),
    "glass": (6.31, 0.0, 0.0036, 1.3394, 0.1, 100.0),
    "marble": (7.074, 0.0, 0.0055, 0.9262, 1.0, 60.0),
    "asphalt": (4.83, 0.0, 0.0108, 1.3969, 1.0, 40.0),
    "metal": (1.0, 0.0, 1e7, 0.0, 1.0, 100.0),
    "very dry ground": (3.0, 0.0, 0.00015, 2.52, 1.0, 10.0),
}
"""Table 3 of Recommendation ITU-R P.2040-3, the lowest band of each: eps' = a f^b, sigma = c f^d [S/m], f in GHz."""

SOILS: dict[str, tuple[float, float, float]] = {
    "sandy loam": (51.52, 13.42, 2.66),
    "loam": (41.96, 8.53, 2.70),
    "silty clay": (5.02, 47.38, 2.56),
}
"""Table 1 of Recommendation ITU-R P.527-4: sand [%], clay [%], specific gravity of the solids."""


def building(name: str, frequency_hz: float) -> complex:
    """A row of `BUILDING`: eps' = a f^b, eps'' = 17.98 c f^d / f (eqs. 58, 59 and 9b of ITU-R P.2040-1).

    A metal's eps' of 1 is 2 here, because the model of scattering needs eps' > 1. Beside an eps'' of millions it
    changes nothing.
    """
    a, b, c, d, _, _ = BUILDING[name]
    f = frequency_hz / 1e9
    real = max(a * f**b, 2.0) if name == "metal" else a * f**b
    return complex(real, -LOSS * c * f**d / f)


def pure_water(frequency_hz: float, temperature_c: float) -> complex:
    """Water without salt, 0 to 40 deg C: two Debye terms (ITU-R P.527-4, pure water)."""
    return _two_debye(frequency_hz / 1e9, *_water(temperature_c))


def sea_water(frequency_hz: float, temperature_c: float, salinity: float = 35.0) -> complex:
    """Water of `salinity` [g/kg], up to 40: two Debye terms and the ions' current (ITU-R P.527-4, sea water)."""
    t, s = temperature_c, salinity
    e_s, e_1, e_inf, f_1, f_2 = _water(t)
    e_s *= math.exp(-3.56417e-3 * s + 4.74868e-6 * s**2 + 1.15574e-5 * t * s)
    e_1 *= math.exp(-6.28908e-3 * s + 1.76032e-4 * s**2 - 9.22144e-5 * t * s)
    e_inf *= 1.0 + s * (-2.04265e-3 + 1.57883e-4 * t)
    f_1 *= 1.0 + s * (2.39357e-3 - 3.13530e-5 * t + 2.52477e-7 * t**2)
    f_2 *= 1.0 + s * (-1.99723e-2 + 1.81176e-4 * t)
    f = frequency_hz / 1e9
    return _two_debye(f, e_s, e_1, e_inf, f_1, f_2) - 1j * 18.0 * sea_conductivity(t, s) / f


def sea_conductivity(temperature_c: float, salinity: float) -> float:
    """Conductivity of sea water [S/m] (ITU-R P.527-4, sea water)."""
    t, s = temperature_c, salinity
    of_35 = 2.903602 + 8.607e-2 * t + 4.738817e-4 * t**2 - 2.991e-6 * t**3 + 4.3047e-9 * t**4
    at_15 = s * (37.5109 + 5.45216 * s + 1.4409e-2 * s**2) / (1004.75 + 182.283 * s + s**2)
    alpha_0 = (6.9431 + 3.2841 * s - 9.9486e-2 * s**2) / (84.850 + 69.024 * s + s**2)
    alpha_1 = 49.843 - 0.2276 * s + 0.198e-2 * s**2
    return of_35 * at_15 * (1.0 + alpha_0 * (t - 15.0) / (alpha_1 + t))


def _water(temperature_c: float) -> tuple[float, float, float, float, float]:
    """Static, middle and high-frequency permittivity, and the two relaxation frequencies [GHz]."""
    theta = 300.0 / (temperature_c + 273.15) - 1.0
    static = 77.66 + 103.3 * theta
    first = 20.20 - 146.4 * theta + 316.0 * theta**2
    return static, 0.0671 * static, 3.52 - 7.52 * theta, first, 39.8 * first


def _two_debye(f: float, static: float, middle: float, high: float, first: float, second: float) -> complex:
    return (static - middle) / (1.0 + 1j * f / first) + (middle - high) / (1.0 + 1j * f / second) + high


def bulk_density(sand: float, clay: float) -> float:
    """Density of dry soil [g/cm3] from sand and clay [%]; the rest is silt (ITU-R P.527-4, soil)."""
    silt = 100.0 - sand - clay
    return 1.072560 + 0.078886 * math.log(sand) + 0.038753 * math.log(clay) + 0.032732 * math.log(silt)


def soil(kind: str, frequency_hz: float, moisture: float, temperature_c: float = 20.0) -> complex:
    """A row of `SOILS` with `moisture` [m3/m3], 1 to 1000 GHz (ITU-R P.527-4, soil).

    The semi-empirical mixing rule of Dobson, Ulaby, Hallikainen and El-Rayes, IEEE Trans. GRS-23 (1985), alpha = 0.65.
    """
    sand, clay, gravity = SOILS[kind]
    f, density, alpha = frequency_hz / 1e9, bulk_density(sand, clay), 0.65
    sigma_1 = 0.0467 + 0.2204 * density - 0.004111 * sand - 0.006614 * clay
    sigma_2 = -1.645 + 1.939 * density - 0.0225622 * sand + 0.01594 * clay
    change = (sigma_1 - sigma_2) / (1.0 + (f / 1.35) ** 2)
    bound = 18.0 / f * (gravity - density) / (gravity * moisture)
    water = pure_water(frequency_hz, temperature_c)
    free_real = water.real + bound * change * f / 1.35
    free_loss = -water.imag + bound * (sigma_2 + change)
    solid = (1.01 + 0.44 * gravity) ** 2 - 0.062
    beta_real = 1.2748 - 0.00519 * sand - 0.00152 * clay
    beta_loss = 1.33797 - 0.00603 * sand - 0.00166 * clay
    mixed = 1.0 + density / gravity * (solid**alpha - 1.0) + moisture**beta_real * free_real**alpha - moisture
    loss = moisture ** (beta_loss / alpha) * free_loss
    return complex(mixed ** (1.0 / alpha), -loss)


def dry_snow(density: float) -> complex:
    """Snow without water of `density` [g/cm3], up to 0.41: 1 + 1.4667 v + 1.435 v^3, v the share of ice.

    C. Maetzler, J. Glaciology 42 (1996), as in Ulaby and Long, Microwave Radar and Radiometric Remote Sensing (2014),
    section 4-6. Its loss, under 1e-3, is left out.
    """
    v = density / 0.9167
    return complex(1.0 + 1.4667 * v + 1.435 * v**3, 0.0)


def wet_snow(frequency_hz: float, density: float, wetness: float) -> complex:
    """Snow of dry `density` [g/cm3] with `wetness` [% of volume], 3 to 37 GHz.

    The Debye-like model of Hallikainen, Ulaby and Abdelrazik, IEEE Trans. AP-34 (1986), as in Ulaby and Long (2014),
    section 4-6.2.
    """
    f = frequency_hz / 1e9
    a_1 = 0.78 + 0.03 * f - 0.58e-3 * f**2
    a_2 = 0.97 - 0.39e-2 * f + 0.39e-3 * f**2
    b_1 = 0.31 - 0.05 * f + 0.87e-3 * f**2
    ratio, power = f / 9.07, wetness**1.31
    real = a_1 * (1.0 + 1.83 * density + 0.02 * wetness**1.015) + b_1 + 0.073 * a_1 * power / (1.0 + ratio**2)
    return complex(real, -0.073 * a_2 * ratio * power / (1.0 + ratio**2))
