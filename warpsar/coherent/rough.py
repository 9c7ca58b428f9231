"""The parameters of rough faces, as the kernels know them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from warpsar.coherent.records import records
from warpsar.kernels.codes import Spectrum
from warpsar.kernels.coherent import bistatic, rough
from warpsar.world.tables import Material

_CONDUCTOR = (1e9, 0.0)


def surfaces(materials: Sequence[Material]) -> Any:
    """The parameters of the surface model, one for each material. A model does not look at those that it has not."""
    packed = records(rough.RoughSurface, len(materials))
    for m, material in enumerate(materials):
        eps = _CONDUCTOR if material.conductor else material.eps_r or 1.0
        packed["spectrum"][m] = Spectrum[material.spectrum.upper()]
        packed["permittivity"][m] = eps if isinstance(eps, tuple) else (eps, 0.0)
        packed["rms_height"][m] = material.rms_height_m or 0.0
        length = material.correlation_length_m or float(bistatic.HEIGHTS) * packed["rms_height"][m] or 1.0
        packed["length"][m] = length if isinstance(length, tuple) else (length, length)
        packed["specular_fraction"][m] = material.specular_fraction
    return packed
