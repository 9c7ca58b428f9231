"""What statistics of speckle must know of an image: its compared pixels and the law of its speckle."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from warpsar.speckle.law import Law


class ComparedPixels(Protocol):
    """One image. `interior`: the pixels that are compared, shape (rows, cols), bool. `looks` are the law's
    equivalent ones."""

    @property
    def interior(self) -> np.ndarray: ...

    @property
    def looks(self) -> float: ...

    @property
    def law(self) -> Law: ...
