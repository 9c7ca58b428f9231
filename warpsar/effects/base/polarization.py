"""Polarizations by the codes that kernels take."""

from __future__ import annotations

from warpsar.surface.stage import POLARIZATIONS

_NAMES = {code: name for name, code in POLARIZATIONS.items()}


def polarization_name(code: int) -> str:
    """HH, VV, HV or VH."""
    return _NAMES[code]


def is_crossed(code: int) -> bool:
    """Whether the radar receives the polarization that it does not send (HV, VH)."""
    return polarization_name(code) in ("HV", "VH")
