"""What statistics of speckle must know of an image: its compared pixels and its looks."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Compared(Protocol):
    """One image. `interior`: the pixels that are compared, shape (rows, cols), bool."""

    @property
    def interior(self) -> np.ndarray: ...

    @property
    def looks(self) -> float: ...
