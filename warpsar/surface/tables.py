"""Tables of sigma0 over incidence on a device: those of the materials that have the model `facet`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import warp as wp

from warpsar.kernels.codes import Polarization
from warpsar.world import sigma0_table


@dataclass(frozen=True)
class Tables:
    """Rows of all tables, one after the other."""

    rows: wp.array
    """vec2i, (materials,): the first row of a material's table and how many there are"""
    incidence_deg: wp.array
    """float, (rows,)"""
    sigma0_db: wp.array
    """float, (rows, polarizations)"""

    def copied(self) -> Tables:
        """The same, with values of its own, which take a gradient."""
        return replace(self, sigma0_db=wp.clone(self.sigma0_db, requires_grad=True))

    @classmethod
    def of(cls, files: Sequence[Path | None], device: wp.Device) -> Tables | None:
        """Read the materials' files; None without any. Raises InputError."""
        if not any(file is not None for file in files):
            return None
        rows = np.zeros((len(files), 2), np.int32)
        angles, values = [np.zeros(0)], [np.zeros((0, len(Polarization)))]
        for m, file in enumerate(files):
            if file is None:
                continue
            table = sigma0_table.read(file)
            rows[m] = sum(map(len, angles)), table.incidence_deg.size
            angles.append(table.incidence_deg)
            values.append(np.stack([table.channel(one.name) for one in Polarization], axis=1))
        return cls(
            wp.array(rows, dtype=wp.vec2i, device=device),
            wp.array(np.concatenate(angles).astype(np.float32), dtype=float, device=device),
            wp.array(np.concatenate(values).astype(np.float32), dtype=float, device=device),
        )
