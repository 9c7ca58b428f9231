"""What an effect does to products with phase: the words of its class for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

_CELL = {"none": 1.1288, "taylor": 0.8421, None: 1.0645}
"""Cells of a band in half-power widths: without a taper, with Taylor's of -35 dB; of a Gaussian the area of its power
over its peak, as no band has it."""


@dataclass(frozen=True)
class Response:
    """What is asked of a system's response to a point; None where nothing is asked."""

    width_m: tuple[float | None, float | None] = (None, None)
    """Half-power widths in slant range and azimuth [m]."""
    taper: tuple[str | None, str | None] = (None, None)
    """Of the band and of the aperture: "none" or "taylor"."""
    stated_cells: tuple[tuple[float, str], tuple[float, str]] | None = None
    """What `cells` are where the widths do not say it."""

    def over(self, other: Response) -> Response:
        """This response, and where it asks for nothing the other one."""
        return Response(
            (self.width_m[0] or other.width_m[0], self.width_m[1] or other.width_m[1]),
            (self.taper[0] or other.taper[0], self.taper[1] or other.taper[1]),
            self.stated_cells or other.stated_cells,
        )

    def cells(self) -> tuple[tuple[float, str], tuple[float, str]]:
        """Cells of the band and of the aperture: size [m], 0 where nothing is asked, and taper.

        A width without a taper is that of a Gaussian, whose cell has none.
        """
        if self.stated_cells is not None:
            return self.stated_cells
        sizes = [(width or 0.0) * _CELL[taper] for width, taper in zip(self.width_m, self.taper, strict=True)]
        return (sizes[0], self.taper[0] or "none"), (sizes[1], self.taper[1] or "none")


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
