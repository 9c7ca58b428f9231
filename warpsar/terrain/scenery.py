"""What lies on the ground: surfaces of the library, land cover, buildings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.products.product import Product
from warpsar.simulation.materials import sigma0_db
from warpsar.terrain.buildings import TerrainBuildings
from warpsar.terrain.landcover import LandCover
from warpsar.world.library.fill import material

F64 = NDArray[np.float64]
ANGLES_DEG = np.linspace(0.0, 90.0, 361)
STEEPEST_DEG, SHALLOWEST_DEG = 1.0, 89.0
"""Backscatter models are asked between; beyond, they have the outer values."""
POLARIZATIONS = ("HH", "HV", "VH", "VV")


@dataclass(frozen=True)
class Scenery:
    """`sigma0`, (surfaces, n): linear, at equal steps of incidence from 0 to 90 degrees, by surface of the library."""

    surfaces: tuple[str, ...]
    """The first one lies wherever nothing else is said."""
    sigma0: F64
    landcover: LandCover | None = None
    buildings: TerrainBuildings | None = None

    @property
    def ground_row(self) -> int:
        """Of facets of the ground, as kernels take it: -1 where land cover says it."""
        return 0 if self.landcover is None else -1

    def classes_at(self, geodetic: F64) -> tuple[NDArray[np.int32], F64]:
        """Rows of sigma0 about places (n, 3), (r, c), and the column and row of each place there, (n, 2)."""
        if self.landcover is None:
            return np.zeros((1, 1), np.int32), np.zeros((len(geodetic), 2))
        return self.landcover.around(geodetic)


def surface_sigma0(surface: str, product: Product) -> F64:
    """Linear sigma0 of a surface of the library at equal steps of incidence from 0 to 90 degrees."""
    angles = np.clip(ANGLES_DEG, STEEPEST_DEG, SHALLOWEST_DEG)
    polarization = product.polarization if product.polarization in POLARIZATIONS else "VV"
    hertz = product.frequency_hz
    found = sigma0_db(material(surface, hertz), polarization, hertz, angles)
    return np.asarray(10.0 ** (found / 10.0))
