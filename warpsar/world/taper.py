"""Windows over a band or an aperture."""

from __future__ import annotations

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
