"""What a stack of layers reflects, by the impedance that a layer hands to the next; nothing of the package is used."""

from collections.abc import Sequence

import numpy as np

SPEED_OF_LIGHT = 299792458.0
Stack = Sequence[tuple[complex, complex, float]]  # eps_r, mu_r, thickness_m from the outermost one inward


def reflection(stack: Stack, metal: bool, frequency_hz: float, across: bool, sin: np.ndarray) -> np.ndarray:
    """A stack's coefficient by the impedance that one layer hands to the next (Ramo, Whinnery, Van Duzer, ch. 6):
    `across` with E across the plane of incidence, as in VV of an upright plate in a level sweep."""
    k = 2.0 * np.pi * frequency_hz / SPEED_OF_LIGHT
    cos = np.sqrt(1.0 - sin**2)
    air = 1.0 / cos if across else cos
    load = np.zeros_like(sin, complex) if metal else air.astype(complex)
    for eps, mu, thickness in reversed(stack):
        root = np.sqrt(eps * mu - sin**2 + 0j)
        own = mu / root if across else root / eps
        turn = 1j * np.tan(k * thickness * root)
        load = own * (load + own * turn) / (own + load * turn)
    return (load - air) / (load + air)
