"""Glints: places of a body that return more than its mesh says, about an aspect of their own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import Column, Setting, amount
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.trial import Context, Trial
from warpsar.kernels import binning
from warpsar.kernels.codes import Polarization
from warpsar.kernels.effects import glints as kernels
from warpsar.world.world import World

ALL_ROUND_DEG = 180.0  # half width from which on a glint returns the same to all sides
_COLUMNS = (
    *(Column(name, "m", -1e8, 1e8) for name in ("east_m", "north_m", "up_m")),
    Column("azimuth_deg", "deg", -360.0, 360.0),
    Column("half_width_deg", "deg", 1e-6, 360.0),
    Column("level_dbsm", "dBsm", -300.0, 300.0),
)
_MEANING = "a list of [east, north, up, azimuth, half width, level]: metres, degrees above 0 for the width, dBsm"


@dataclass(frozen=True)
class Glint:
    """A point at `place_m` (east, north, up, about the reference point), with a lobe about an azimuth of the radar.

    `rcs_m2` is the cross-section in the lobe's middle. `half_width_deg` off it, half is left.
    """

    place_m: tuple[float, float, float]
    azimuth_deg: float
    half_width_deg: float
    rcs_m2: float

    @classmethod
    def of(cls, row: Sequence[float]) -> Glint:
        """Of a row of the setting `points`."""
        east, north, up, azimuth, half, level = (float(value) for value in row)
        return cls((east, north, up), azimuth, half, 10.0 ** (level / 10.0))

    @property
    def row(self) -> list[float]:
        """As the setting `points` has it, to a millimetre, and to hundredths of a degree and of a decibel."""
        level = 10.0 * math.log10(self.rcs_m2)
        angles = [round(value, 2) for value in (self.azimuth_deg, self.half_width_deg, level)]
        return [*(round(value, 3) for value in self.place_m), *angles]

    def rcs_at(self, azimuth_deg: float) -> float:
        """Cross-section [m2] towards a radar at an azimuth."""
        return self.rcs_m2 * float(lobe(np.asarray(azimuth_deg), self.azimuth_deg, self.half_width_deg))


def lobe(azimuth_deg: NDArray[np.float64], about_deg: float, half_width_deg: float) -> NDArray[np.float64]:
    """The share of a glint's cross-section towards azimuths: a Gaussian, 1 in its middle, or 1 all round."""
    if half_width_deg >= ALL_ROUND_DEG:
        return np.ones_like(azimuth_deg, float)
    off = (azimuth_deg - about_deg + 180.0) % 360.0 - 180.0
    return np.asarray(np.exp(-math.log(2.0) * (off / half_width_deg) ** 2))


def _points(value: Any) -> bool:
    def row(one: Any) -> bool:
        return (
            isinstance(one, list | tuple)
            and len(one) == len(_COLUMNS)
            and all(isinstance(n, int | float) and not isinstance(n, bool) for n in one)
            and all(column.low <= n <= column.high for n, column in zip(one, _COLUMNS, strict=True))
        )

    return isinstance(value, list | tuple) and all(map(row, value))


class Glints(Effect):
    """Adds the returns of points on bodies: `strength` times what `points` say, each about an azimuth of its own.

    A point stands for what is smaller than a cell of resolution and turned to a side: a lamp, a hook, a hatch's corner.
    It is fixed to the scene, so it moves through the images as the body does. Nothing hides it: its lobe says to which
    sides it is seen. It returns the same in HH and VV, and nothing in HV.
    """

    name = "glints"
    stage = "path"
    order = 40
    needs_all_hits = True  # a band of the image would have all of them once more
    of_left_out = True
    summary = "points of a body that flash about an aspect"
    example: ClassVar[dict[str, Any]] = {
        "strength": 1.0,
        "points": [[-4.0, -6.0, 3.0, 0.0, 180.0, 12.0], [6.0, 2.0, 5.0, 0.0, 180.0, 15.0]],
    }
    rate_case: ClassVar[dict[str, Any]] = {"strength": 1.0, "points": [[0.0, 0.0, 2.0, 0.0, 180.0, 10.0]]}
    parameters = (amount("strength", "1", 1e6, 1.0, (1e-3, 1e3), "Factor on the cross-sections of all points."),)
    settings = (
        Setting(
            "points",
            [],
            _points,
            _MEANING,
            description=(
                "Place about the reference point, the radar's azimuth in the lobe's middle and the angle from it at "
                "which half is left (180 or more: all round), cross-section in the middle."
            ),
            schema={
                "type": "array",
                "items": {
                    "type": "array",
                    "items": {"type": "number"},
                    "minItems": len(_COLUMNS),
                    "maxItems": len(_COLUMNS),
                },
            },
            columns=_COLUMNS,
        ),
    )

    def check(self, scene: World, table: Mapping[str, Any]) -> str | None:
        if table.get("strength", 0.0) > 0.0 and not table.get("points"):
            return f".points: missing; allowed is {_MEANING}"
        return None

    def spread_m(self, table: Mapping[str, Any]) -> float:
        return 0.0

    def trials(self, context: Context) -> list[Trial]:
        """None: their places come from what views leave (`warpsar/diagnosis/held_out/glints.py`)."""
        return []

    def paths(self, render: Recorder, p: wp.array, image: wp.array, polarization: int) -> wp.array:
        if Polarization(polarization).crossed:
            return image
        program, device = render.program, render.program.device
        share = program.array(image.shape[0], sum_into=True)
        render.layers[f"beta0_glints_{Polarization(polarization).name}"] = share
        bins, weight, rcs, points = _deposited(render, [Glint.of(row) for row in render.settings[self.name]["points"]])
        if bins.size == 0:
            return image
        sigma = program.array(bins.size)
        program.launch(kernels.glint_kernel, bins.size, [p, wp.array(rcs, dtype=float, device=device)], [sigma])
        render.collect(
            sigma,
            wp.array(weight, dtype=float, device=device),
            wp.array(points, dtype=wp.vec3, device=device),
            wp.array(bins, dtype=int, device=device),
            share,
        )
        return program.mapped(binning.add_kernel, image, [image, share])


def _deposited(render: Recorder, glints: Sequence[Glint]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where the glints' power falls in one view: bins of the hits' grid, weights, cross-sections and places, (n,) each
    but the last, in the order of the bins. A point between the bins' middles is shared by four of them, linearly."""
    grid, geometry = render.hits.grid, render.geometry
    azimuth = math.degrees(math.atan2(geometry.s[0], geometry.s[1]))
    rows, cols = grid.shape
    area = render.spacing_m[0] * render.spacing_m[1]
    found = []
    for one in glints:
        at = map(float, geometry.range_and_azimuth_m(np.array(one.place_m)))
        row, col = ((a - start) / step - 0.5 for a, start, step in zip(at, grid.start_m, grid.spacing_m, strict=True))
        first = math.floor(row), math.floor(col)
        for i in (0, 1):
            for j in (0, 1):
                r, c = first[0] + i, first[1] + j
                share = (1.0 - abs(row - r)) * (1.0 - abs(col - c))
                if 0 <= r < rows and 0 <= c < cols and share > 0.0:
                    found.append((r * cols + c, share / area, one.rcs_at(azimuth), *one.place_m))
    table = np.array(sorted(found), float).reshape(-1, 6)
    single = np.ascontiguousarray(table, np.float32)
    return table[:, 0].astype(np.int32), single[:, 1].copy(), single[:, 2].copy(), single[:, 3:].copy()


EFFECT = Glints()
