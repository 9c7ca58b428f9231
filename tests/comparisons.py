"""Measured images beside models, made of arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from worlds import view

from warpsar.compare.comparison import ALLOWED_PX, LEVEL_SHARE, Comparison
from warpsar.compare.observation import BORDER, Observation


def comparison(
    measured: np.ndarray,
    simulated: Any,
    looks: float = 4.0,
    *,
    name: str = "v0",
    role: str = "train",
    interior: np.ndarray | None = None,
    slopes: np.ndarray | None = None,
    dark: np.ndarray | None = None,
    spacing_m: tuple[float, float] = (0.5, 0.5),
    border: int = BORDER,
    by_rays: np.ndarray | None = None,
    **of_seen: Any,
) -> Comparison:
    """`interior`: by default all but the image's edge. `slopes`, (2, rows, cols), and `by_rays`: 0 by
    default."""
    shape = measured.shape
    usable = np.zeros(shape, bool)
    usable[border : shape[0] - border, border : shape[1] - border] = True
    interior = usable if interior is None else interior
    nowhere = np.zeros(shape, bool)
    image = np.broadcast_to(np.asarray(simulated, float), shape).copy()
    seen = Observation(
        view(0, 40, name=name, role=role),
        "HH",
        measured,
        interior,
        nowhere,
        nowhere if dark is None else dark,
        looks,
        **{"looks_estimated": False, **of_seen},
    )
    return Comparison(
        seen=seen,
        simulated=image,
        gain=1.0,
        level=LEVEL_SHARE * float(np.median(image[interior])),
        usable=usable,
        slopes=np.zeros((2, *shape)) if slopes is None else slopes,
        moves=np.zeros((0, *shape)),
        exact=True,
        reach_px=(ALLOWED_PX, ALLOWED_PX),
        smeared=1.0,
        by_rays=np.zeros(shape) if by_rays is None else by_rays,
        sampling_noise=0.0,
        incidence_deg=np.full(shape, 40.0),
        material=np.zeros(shape, int),
        start_m=(-shape[0] / 2 * spacing_m[0], -shape[1] / 2 * spacing_m[1]),
        spacing_m=spacing_m,
    )
