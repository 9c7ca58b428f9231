"""What every render of a view offers, whether it keeps its hits (`render.py`) or traces them again (`bands.py`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import warp as wp

from warpsar.effects.base.effect import DeclaredEffect
from warpsar.trace.hits import Hits

COVERED = 0.125
"""Lit surface in a pixel, over the pixel's area, from which a pixel is compared with a measured one. A few rays alone
tell how much smaller a sliver is, and what they tell of it is noise."""


class Replayed(Protocol):
    """A recorded sequence of launches; `warpsar.runtime.program.Program` says what each method does."""

    @property
    def device(self) -> wp.Device: ...

    def array(
        self, shape: int | tuple[int, ...], dtype: Any = float, *, grad: bool = True, sum_into: bool = False
    ) -> wp.array: ...

    def launch(self, kernel: wp.Kernel, dim: int, inputs: Sequence[Any], outputs: Sequence[Any]) -> None: ...

    def forward(self, *, gradient: bool = False) -> None: ...

    def zero_gradients(self) -> None: ...

    def backward(self, seeds: dict[Any, Any], *, zero: bool = True) -> None: ...


class RenderPiece(Protocol):
    """A render whose hits are in memory: those of a whole view, or of one band of its columns.

    `shaded` holds one sample per face and pixel, `zeta` its learned coordinates, shape (n,), vec4.
    """

    @property
    def shaded(self) -> Hits: ...

    @property
    def zeta(self) -> wp.array: ...

    @property
    def hits(self) -> Hits: ...

    @property
    def images(self) -> Mapping[str, wp.array]: ...

    @property
    def program(self) -> Replayed: ...


class Rendered(Protocol):
    """One view's images as a function of the surface's nodes and the effects' parameters.

    `images[pol]` is beta0, shape (rows * cols,), float32, on the device after a forward run of `program`; `nodes` and
    `effect_values[name]` are the parameters on the device, float32, with their gradients after a backward run.
    """

    @property
    def program(self) -> Replayed: ...

    @property
    def images(self) -> Mapping[str, wp.array]: ...

    @property
    def nodes(self) -> wp.array: ...

    @property
    def effect_values(self) -> Mapping[str, wp.array]: ...

    @property
    def keeps_hits(self) -> bool:
        """Whether all hits of the view stay in memory."""

    @property
    def whole(self) -> RenderPiece:
        """The render with all hits of the view. Raises InputError where they are not kept."""

    def pieces(self) -> Iterable[RenderPiece]:
        """Renders that together hold the view's hits, each after a forward run: one, or one for each band in turn."""

    def lit(self, polarization: str) -> np.ndarray:
        """Pixels that single-bounce light reached in the last run, (rows, cols) bool.

        A blur or a noise floor lights nothing.
        """

    def covered(self, polarization: str) -> np.ndarray:
        """Those of the `lit` pixels in which the lit surface has `COVERED` of the pixel's area or more."""

    def set_parameters(self, nodes: np.ndarray | None, effects: Mapping[str, np.ndarray] | None = None) -> None:
        """Parameters of the next run: nodes in learned coordinates (None: as before), effects' values by name."""

    def forward(self) -> dict[str, np.ndarray]:
        """beta0 by polarization, shape (rows, cols), float32."""

    def image_with(self, effect: DeclaredEffect, image: np.ndarray) -> np.ndarray:
        """What one effect of the image stage makes of a finished image, shape (rows, cols), float32.

        It shades no ray: a score test asks for hundreds of offsets and lines.
        """
