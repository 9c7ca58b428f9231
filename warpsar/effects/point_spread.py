"""The finite resolution of the system."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.blur import WINDOWS, blurred
from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import EffectParameter, Setting, amount
from warpsar.effects.base.phase import Response
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial


def _width(name: str) -> EffectParameter:
    axis = name.removesuffix("_fwhm_m")
    meaning = f"Full width of the kernel in {axis}, at half its maximum."
    return amount(name, "m", 1e4, 1.0, (1e-3, 1e4), meaning, grows_by=2.0)


def _is_pair(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) == 2


def _is_window(value: Any) -> bool:
    return all(isinstance(one, str) and one in WINDOWS for one in (value if _is_pair(value) else [value]))


_TAPERS = {"sinc": "none", "taylor": "taylor", "gaussian": None}
"""Weights of band or aperture that a window means."""
_WINDOW = Setting(
    "window",
    "gaussian",
    _is_window,
    f"{' or '.join(map(repr, WINDOWS))}, or a pair of these for range and azimuth",
    description="Window of the aperture, which shapes the kernel; a pair where range and azimuth differ.",
    schema={
        "anyOf": [
            {"enum": list(WINDOWS)},
            {"type": "array", "items": {"enum": list(WINDOWS)}, "minItems": 2, "maxItems": 2},
        ]
    },
)


def _are_cells(value: Any) -> bool:
    return _is_pair(value) and all(_is_cell(one) for one in value)


def _is_cell(value: Any) -> bool:
    return _is_pair(value) and type(value[0]) in (int, float) and 0.0 <= value[0] <= 1e4 and value[1] in _CELL_TAPERS


_CELL_TAPERS = ("none", "taylor")
_CELL_SCHEMA = {
    "type": "array",
    "prefixItems": [{"type": "number", "minimum": 0.0, "maximum": 1e4}, {"enum": list(_CELL_TAPERS)}],
    "minItems": 2,
    "maxItems": 2,
}
_CELLS = Setting(
    "cells",
    None,
    _are_cells,
    "a pair for range and azimuth, each [size in m from 0 to 10000, 'none' or 'taylor']",
    description="Resolution cells in which the fields of corners add up, where a filter of the finished image has made "
    "the kernel wider: size [m], 0 for a pixel, and taper, for range and azimuth. Without it, those of the kernel.",
    schema={"type": "array", "items": _CELL_SCHEMA, "minItems": 2, "maxItems": 2},
)


class PointSpread(Effect):
    """Convolves the power image with a separable kernel, sampled at pixel centres and normalised to one.

    Its widths are full widths at half maximum; a width of 0 leaves its axis sharp. `window` is the weighting of the
    aperture: "sinc" (none: the kernel is sinc^2), "taylor" (-35 dB, nbar 5), or "gaussian" for a Gaussian kernel. Many
    systems weight the band and not the aperture: a pair of windows is that of range and that of azimuth. `cells` are
    those of the radar where the kernel is wider, as in an image that was smoothed after it had been focused.
    """

    name = "point_spread"
    stage = "image"
    acts_on = ("beta0", "slc", "phase-history")
    order = 10
    affine = True
    in_image = True
    at_edges = True
    summary = "finite resolution in range and azimuth"
    example: ClassVar[dict[str, Any]] = {"range_fwhm_m": 1.2, "azimuth_fwhm_m": 1.2, "window": "sinc"}
    rate_case: ClassVar[dict[str, Any]] = {"range_fwhm_m": 0.9, "azimuth_fwhm_m": 0.7, "window": "gaussian"}
    parameters = (_width("range_fwhm_m"), _width("azimuth_fwhm_m"))
    settings = (_WINDOW, _CELLS)

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """It shows on edges and on points alike, and is as wide at near range as at far range: a defocus that grows
        along range is no one response."""
        return {"points": image.points, **image.ends_of_range(image.edges)}

    def trials(self, context: Context) -> list[Trial]:
        """The step is one pixel's width, where the neighbours get 6 %: sampled at pixel centres, a narrower kernel is
        1 in its own pixel and has no derivative. All windows begin with the same second moment, so one is tried."""
        axes = ("range_fwhm_m", "azimuth_fwhm_m")
        spacing = dict(zip(axes, context.scene.grid.spacing_m, strict=True))
        steps = tuple(
            ScoreStep(
                f"{name} squared", spacing[name] ** 2, {name: spacing[name], "window": "gaussian"}, one_sided=True
            )
            for name in axes
        )
        starts = tuple(
            {**{name: 1.5 * spacing[name] for name in axes}, "window": window} for window in reversed(WINDOWS)
        )
        return [Trial(steps, starts)]

    def response(self, values: np.ndarray, settings: Mapping[str, Any]) -> Response:
        """Its widths are those of band and aperture. No band has a Gaussian kernel: the system's own taper stays."""
        window = settings["window"]
        pair = [window] * 2 if isinstance(window, str) else window
        width = [float(value) or None for value in values]
        taper = [_TAPERS[name] if wide else None for name, wide in zip(pair, width, strict=True)]
        cells = settings.get("cells")
        stated = None if cells is None else ((float(cells[0][0]), cells[0][1]), (float(cells[1][0]), cells[1][1]))
        return Response((width[0], width[1]), (taper[0], taper[1]), stated)

    def image(self, render: Recorder, p: wp.array, image: wp.array) -> wp.array:
        stated = render.settings[self.name]["window"]
        for index, window in enumerate([stated] * 2 if isinstance(stated, str) else stated):
            image = blurred(render, WINDOWS[window], p, index, image, axis=index)
        return image


EFFECT = PointSpread()
