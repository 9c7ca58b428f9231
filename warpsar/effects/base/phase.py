"""What an effect does to products with phase: the words of its class for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Response:
    """What is asked of a system's response to a point; None where nothing is asked."""

    width_m: tuple[float | None, float | None] = (None, None)
    """Half-power widths in slant range and azimuth [m]."""
    taper: tuple[str | None, str | None] = (None, None)
    """Of the band and of the aperture: "none" or "taylor"."""


@dataclass(frozen=True)
class Copy:
    """A second image of all scatterers."""

    azimuth_m: float
    """How far it lies from the first one."""
    power: float
    """As a share of the first one's."""


class ComplexImage(Protocol):
    """What an effect sees of the complex image that it changes."""

    def lines(self) -> NDArray[np.complex64]:
        """Circular Gaussian numbers of mean power 1, (rows, cols), other ones at each call.

        Rows are independent. Along a row they are as wide in frequency as the system's aperture.
        """

    def power(self, effect: str) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """beta0 of the image of power, with the effects that act before `effect`, and the pixels that rays meet."""
