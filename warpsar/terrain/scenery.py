"""What lies on the ground: surfaces of the library, land cover, buildings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.terrain.buildings import TerrainBuildings
from warpsar.terrain.landcover import LandCover

F64 = NDArray[np.float64]


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
