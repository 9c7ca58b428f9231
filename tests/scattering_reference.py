"""Backscatter models in NumPy, float64, from their papers: the tests' own statement beside the kernels'.

I2EM is written with the bistatic coefficients as Fung, Liu, Chen and Tsay 2002 print them, not with the closed forms
that the kernels have.
"""

import math
from collections.abc import Callable

import numpy as np


def fresnel(theta: float, eps: complex) -> tuple[complex, complex]:
    """R_v and R_h."""
    c, q = math.cos(theta), np.sqrt(eps - math.sin(theta) ** 2 + 0j)
    return (eps * c - q) / (eps * c + q), (c - q) / (c + q)


def power_spectrum(n: int, kl: float, k_wave: np.ndarray | float, spectrum: str) -> np.ndarray:
    """k^2 W^(n): the transform of the correlation's n-th power, K in units of k."""
    square = (np.asarray(k_wave) * kl) ** 2
    if spectrum == "exponential":
        return (kl / n) ** 2 * (1 + square / n**2) ** -1.5
    return kl**2 / (2 * n) * np.exp(-square / (4 * n))


def published_coefficients(polarization: str, theta: float, eps: complex, case: int, up: int) -> complex:
    """F of I2EM in backscatter with k = 1: case 1 along the incident wave, 2 along the scattered one."""
    c = math.cos(theta)
    return sum(above_and_below(polarization, theta, eps, case, up, phase=up * c))


def above_and_below(
    polarization: str, theta: float, eps: complex, case: int, up: int, phase: float | None = None
) -> tuple[complex, complex]:
    """The parts of F that belong to the wave above and to the one below (Fung, Liu, Chen and Tsay 2002, equation 3).

    `phase`: the vertical wave number in both waves' phases; None: each has its own, as in the advanced model.
    """
    c, s = math.cos(theta), math.sin(theta)
    below = np.sqrt(eps - s * s + 0j)
    r = fresnel(theta, eps)[polarization == "HH"]
    across = -2 * s  # sin(theta_s) cos(phi_s) - sin(theta)

    def five(g: complex) -> tuple[complex, ...]:
        q = g if phase is None else phase
        if case == 1:
            return (
                -(c - q),
                -c * (s * across + g * (c - q)),
                s * (-s * (c - q) + g * across),
                c * (-c * (c - q) + s * across),
                g * (-c * (q - c) - s * across),
            )
        inner = -(c * (c + q) - s * across)
        return (-(c + q), g * inner, s * (c * across + s * (c + q)), c * inner, -c * (s * across - g * (c + q)))

    a, b = five(up * c), five(up * below)
    p, m = 1 + r, 1 - r
    if polarization == "VV":
        return (
            (-p * m * a[0] + m * m * a[1] + p * m * a[2] + m * p * a[3] + p * p * a[4]) / c,
            (p * p * b[0] - m * p * b[1] - p * p * b[2] / eps - eps * m * m * b[3] - p * m * b[4]) / below,
        )
    return (
        (p * m * a[0] - m * m * a[1] - p * m * a[2] - m * p * a[3] - p * p * a[4]) / c,
        (-eps * p * p * b[0] + m * p * b[1] + p * p * b[2] + m * m * b[3] + p * m * b[4]) / below,
    )


def i2em(
    polarization: str,
    theta: float,
    eps: complex,
    kh: float,
    kl: float,
    spectrum: str = "exponential",
    *,
    reciprocal: bool = True,
    transition: bool = False,
    sine_power: int = 2,
    opposed: bool = False,
    shadow: bool = True,
) -> float:
    """HH or VV. `reciprocal`: the wave that goes down along the scattered one as the one up along the incident one.

    `transition`: Fresnel coefficients by Fung and Chen 2004, between the local angle and normal incidence; `sine_power`
    and `opposed` as in `transition_share`.
    """
    c, s = math.cos(theta), math.sin(theta)
    terms = range(1, 160)
    sign = 1 if polarization == "VV" else -1
    r = reflected = fresnel(theta, eps)[polarization == "HH"]
    if transition:
        r0 = sign * (np.sqrt(eps + 0j) - 1) / (np.sqrt(eps + 0j) + 1)
        share = transition_share(theta, eps, kh, kl, spectrum, sine_power, opposed=opposed and sign < 0)
        reflected = r + (r0 - r) * share
    kirchhoff = sign * 2 * reflected / c
    up_i = published_coefficients(polarization, theta, eps, 1, 1)
    down_i = published_coefficients(polarization, theta, eps, 1, -1)
    up_s = published_coefficients(polarization, theta, eps, 2, 1)
    down_s = published_coefficients(polarization, theta, eps, 2, -1)
    a = (kh * c) ** 2
    total = 0.0
    log_share = 0.0  # of kh^2n / n! times (2 c)^2n
    for n in terms:
        log_share += math.log(4 * a / n)
        # divided by (2 c)^n
        amplitude = kirchhoff + (down_i + up_s) / (8 * c)
        if reciprocal:
            # what the first power must be, less the wave that is replaced: the second power's amplitude
            amplitude += (down_s - up_i) / (8 * c)
        if n == 1:
            amplitude += (up_i + (up_i if reciprocal else down_s)) / (8 * c)
        w = float(power_spectrum(n, kl, 2 * s, spectrum))
        total += abs(amplitude) ** 2 * math.exp(log_share - 4 * a) * w
    return total / 2 * (shadowed(theta, kh, kl, spectrum, ways=2) if shadow else 1.0)


def iem(
    polarization: str,
    theta: float,
    eps: complex,
    kh: float,
    kl: float,
    spectrum: str = "exponential",
    *,
    terms: int = 60,
) -> float:
    """HH or VV of Fung, Li and Chen 1992, equations 82, 91 and 95, without shadow: what SMRT's iem_fung92 has."""
    c, s = math.cos(theta), math.sin(theta)
    vv = polarization == "VV"
    r = fresnel(theta, eps)[0 if vv else 1]
    kirchhoff = (2 if vv else -2) * r / c
    if vv:
        field = s**2 / c * (1 + r) ** 2 * (1 - 1 / eps) * (1 + (s / c) ** 2 / eps)
    else:
        field = -(s**2) / c * (1 + r) ** 2 * (eps - 1) / c**2
    total, share = 0.0, 1.0
    for n in range(1, terms):
        share *= kh**2 / n
        amplitude = (2 * c) ** n * kirchhoff * math.exp(-((kh * c) ** 2)) + c**n * field
        total += share * abs(amplitude) ** 2 * float(power_spectrum(n, kl, 2 * s, spectrum))
    return total / 2 * math.exp(-2 * (kh * c) ** 2)


def aiem(
    polarization: str,
    theta: float,
    eps: complex,
    kh: float,
    kl: float,
    spectrum: str = "exponential",
    *,
    transition: bool = True,
    opposed: bool = False,
    terms: int = 60,
) -> float:
    """HH or VV of the advanced model (Chen, Wu, Tsang, Li, Shi and Fung 2003), with Fung and Chen's transition (2004).

    Its waves below the surface keep their own phases, which I2EM takes from the waves above. `opposed` as in
    `transition_share`.
    """
    c, s = math.cos(theta), math.sin(theta)
    below = np.sqrt(eps - s * s + 0j)
    sign = 1 if polarization == "VV" else -1
    r = fresnel(theta, eps)[polarization == "HH"]
    r0 = sign * (np.sqrt(eps + 0j) - 1) / (np.sqrt(eps + 0j) + 1)
    share = transition_share(theta, eps, kh, kl, spectrum, opposed=opposed and sign < 0) if transition else 0.0
    kirchhoff = sign * 2 / c * (r + (r0 - r) * share)
    waves = []
    for case, up in ((1, 1), (1, -1), (2, 1), (2, -1)):
        own = above_and_below(polarization, theta, eps, case, up)
        for field, q in zip(own, (up * c, up * below), strict=True):
            waves.append((field * np.exp(-((kh * q) ** 2)), c - q if case == 1 else c + q))
    total, part = 0.0, 1.0
    for n in range(1, terms):
        part *= kh**2 / n
        amplitude = (2 * c) ** n * kirchhoff * math.exp(-((kh * c) ** 2))
        amplitude += sum(field * (phase ** (n - 1) if n > 1 else 1.0) for field, phase in waves) / 4
        total += part * abs(amplitude) ** 2 * float(power_spectrum(n, kl, 2 * s, spectrum))
    both_ways = shadowed(theta, kh, kl, spectrum, ways=2)
    return float(total / 2 * math.exp(-2 * (kh * c) ** 2) * both_ways)


def transition_share(
    theta: float, eps: complex, kh: float, kl: float, spectrum: str, sine_power: int = 2, *, opposed: bool = False
) -> float:
    """How far Fresnel's coefficient has gone to that of normal incidence, by V's coefficient for both channels.

    `sine_power`: 1 as programs have it. `opposed`: F_t has the other sign beside V's coefficient, as AIEM's program
    has it for H.
    """
    c, s = math.cos(theta), math.sin(theta)
    r0 = (np.sqrt(eps + 0j) - 1) / (np.sqrt(eps + 0j) + 1)
    below = np.sqrt(eps - s * s + 0j)
    f = (-8 if opposed else 8) * r0**2 * s**sine_power * (c + below) / (c * below)
    a = (kh * c) ** 2
    up = down = 0.0
    share = 1.0
    for n in range(1, 60):
        share *= a / n
        w = float(power_spectrum(n, kl, 2 * s, spectrum))
        up += share * w
        down += share * w * abs(f / 2 + 2 ** (n + 1) * r0 / c * math.exp(-a)) ** 2
    return 1 - 0.25 * abs(f) ** 2 * up / down * abs(1 + 8 * r0 / (c * f)) ** 2


def shadowed(theta: float, kh: float, kl: float, spectrum: str, ways: int) -> float:
    slope = kh / kl * (1 if spectrum == "exponential" else math.sqrt(2))
    u = 1 / (math.tan(theta) * math.sqrt(2) * slope)
    return 1 / (1 + ways * 0.5 * (math.exp(-u * u) / (math.sqrt(math.pi) * u) - math.erfc(u)))


def i2em_hv(
    theta: float,
    eps: complex,
    kh: float,
    kl: float,
    spectrum: str = "exponential",
    rings: int = 400,
    spokes: int = 12,
    *,
    evanescent: bool = True,
) -> float:
    """The integral of Fung, Li and Chen 1992 over the whole plane, with the losses that the kernels have."""
    c, s = math.cos(theta), math.sin(theta)
    r_v, r_h = fresnel(theta, eps)
    r = (r_v - r_h) / 2
    low, high = -math.asinh(1e4), math.asinh(1e7)
    v = low + (np.arange(rings) + 0.5) * (high - low) / rings
    z = 1e-4 * np.sinh(v)  # rho^2 - 1
    weight = 1e-4 * np.cosh(v) * (high - low) / rings / 2
    phi = (np.arange(spokes) + 0.5) * math.pi / 2 / spokes
    weight = weight * ((z < 0) | evanescent)
    rho2 = np.maximum(1 + z, 0)
    q = np.sqrt(-z - 1e-4j)
    below = np.sqrt(eps - rho2 - 0.5j * eps.real)
    p, m = 1 + r, 1 - r
    f = (m / q - p / below) * (1 - 3 * r) - (m / q - p / below / eps) * p
    f = f + (p / q - m / below) * (1 + 3 * r) - (p / q - m / below * eps) * m
    x, y = np.outer(np.sqrt(rho2), np.cos(phi)), np.outer(np.sqrt(rho2), np.sin(phi))
    a = (kh * c) ** 2

    def series(k_wave: np.ndarray) -> np.ndarray:
        total, share = np.zeros_like(k_wave), math.exp(-a)
        for n in range(1, 60):
            share *= a / n
            total += share * power_spectrum(n, kl, k_wave, spectrum)
        return total

    both = series(np.hypot(x - s, y)) * series(np.hypot(x + s, y))
    total = (weight[:, None] * np.abs(f[:, None] * x * y / c) ** 2 * both).sum() * math.pi / 2 / spokes * 2
    return float(total / (4 * math.pi) * shadowed(theta, kh, kl, spectrum, ways=1))


def topp(eps_re: float) -> float:
    return -5.3e-2 + 2.92e-2 * eps_re - 5.5e-4 * eps_re**2 + 4.3e-6 * eps_re**3


def oh(polarization: str, theta: float, moisture: float, kh: float) -> float:
    """Oh 2004, equations 1 to 4."""
    p = 1 - (2 * theta / math.pi) ** (0.35 * moisture**-0.65) * math.exp(-0.4 * kh**1.4)
    q = 0.095 * (0.13 + math.sin(1.5 * theta)) ** 1.4 * (1 - math.exp(-1.3 * kh**0.9))
    hv = 0.11 * moisture**0.7 * math.cos(theta) ** 2.2 * (1 - math.exp(-0.32 * kh**1.8))
    return {"HV": hv, "VV": hv / q, "HH": p * hv / q}[polarization]


def dubois(polarization: str, theta: float, eps_re: float, kh: float, wavelength_cm: float) -> float:
    """Dubois, van Zyl and Engman 1995, equations 1 and 2 as corrected."""
    c, s, t = math.cos(theta), math.sin(theta), math.tan(theta)
    if polarization == "HH":
        return 10**-2.75 * c**1.5 / s**5 * 10 ** (0.028 * eps_re * t) * (kh * s) ** 1.4 * wavelength_cm**0.7
    return 10**-2.35 * c**3 / s**3 * 10 ** (0.046 * eps_re * t) * (kh * s) ** 1.1 * wavelength_cm**0.7


MODELS: dict[str, Callable[..., float]] = {"i2em": i2em, "oh": oh, "dubois": dubois}
