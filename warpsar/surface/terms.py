"""Learned terms of sigma0 on a device: those of the materials that name one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import warp as wp

from warpsar.kernels.codes import Polarization
from warpsar.world import scattering_term


@dataclass(frozen=True)
class Terms:
    """The units of all materials, one after the other."""

    first: wp.array
    """vec2i, (materials,): a material's first unit, and how many it has"""
    inverse_width: wp.array
    """vec4, (materials,)"""
    places: wp.array
    """vec4, (units,)"""
    weights: wp.array
    """float, (units, polarizations)"""

    def copied(self) -> Terms:
        """The same, with weights of its own, which take a gradient."""
        return replace(self, weights=wp.clone(self.weights, requires_grad=True))

    @classmethod
    def of(cls, files: Sequence[Path | None], device: wp.Device) -> Terms | None:
        """Read the materials' files; None without any. Raises InputError."""
        if not any(file is not None for file in files):
            return None
        first, scale = np.zeros((len(files), 2), np.int32), np.ones((len(files), 4), np.float32)
        places, weights = [np.zeros((0, 4))], [np.zeros((0, len(Polarization)))]
        for m, file in enumerate(files):
            if file is None:
                continue
            term = scattering_term.read(file)
            n = len(term.places)
            first[m] = sum(map(len, places)), n
            scale[m] = 1.0 / term.width
            places.append(term.places)
            names = ["HV" if one == Polarization.VH else one.name for one in Polarization]
            weights.append(np.stack([term.weights.get(name, np.zeros(n)) for name in names], axis=1))
        return cls(
            wp.array(first, dtype=wp.vec2i, device=device),
            wp.array(scale, dtype=wp.vec4, device=device),
            wp.array(np.concatenate(places).astype(np.float32), dtype=wp.vec4, device=device),
            wp.array(np.concatenate(weights).astype(np.float32), dtype=float, device=device),
        )
