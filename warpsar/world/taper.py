"""Windows over a band or an aperture."""

from __future__ import annotations

from functools import cache

import numpy as np

from warpsar.errors import InputError

TAPERS = ("none", "hann", "taylor")
TAYLOR_SIDELOBE_DB = 35
TAYLOR_NBAR = 5  # the least for which the sidelobes of a -35 dB design keep falling: nbar >= 2 A^2 + 1/2


def taper(name: str, position: np.ndarray) -> np.ndarray:
    """Weights of the window `name` at `position` across the aperture, -1/2 to 1/2; any shape.

    "taylor" has sidelobes of -35 dB and nbar 5. Raises InputError for a name that is not in `TAPERS`.
    """
    if name == "none":
        return np.ones_like(position)
    if name == "hann":
        return np.cos(np.pi * position) ** 2
    if name == "taylor":
        from scipy.signal import windows

        fine = windows.taylor(4097, nbar=TAYLOR_NBAR, sll=TAYLOR_SIDELOBE_DB, norm=False)
        return np.interp(position, (np.arange(4097) + 0.5) / 4097 - 0.5, fine)
    raise InputError(f"window {name!r}: not known; use one of {', '.join(TAPERS)}")


@cache
def width_in_cells(window: str) -> float:
    """Half-power width of a tapered band's response, in cells of the band: 0.886 without a taper."""
    position = (np.arange(1024) + 0.5) / 1024 - 0.5
    weights = taper(window, position)
    low, high = 0.3, 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        power = (weights @ np.cos(np.pi * middle * position)) ** 2 / weights.sum() ** 2
        low, high = (middle, high) if power > 0.5 else (low, middle)
    return 0.5 * (low + high)
