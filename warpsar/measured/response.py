"""The response of a system to a point: `[effects.point_spread]`, as the header of a complex image declares it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from warpsar.formats.base.data import ImageChip, PhaseHistory
from warpsar.measured.focus import cell_m
from warpsar.measured.ground import plane_points
from warpsar.world.tables import View
from warpsar.world.taper import width_in_cells
from warpsar.world.world import World, geometry_of

KNOWN = 0.05
"""Share of its width to which a header knows it: products round it, and weights are not told to the last digit."""
_ALONG = 0.2
"""How far the image's axes may be turned from range and azimuth."""
_BOX = 8.0 * np.log(2.0) / 12.0
"""Square of the half-power width of a Gaussian over that of a box, whose variances are equal."""


def point_spread(
    chip: ImageChip, world: World, view: View, samples: tuple[int, int]
) -> tuple[dict[str, Any] | None, list[str]]:
    """The table `[effects.point_spread]` of a chip, and what to tell the user; no table where nothing is declared.

    The image's own projection brings its widths into slant range and azimuth. A width is known to 5 %, and to what the
    pixels of the scene add: the kernel stands at pixel centres, and a pixel has the mean of `samples`. To the second
    moment a box of the pixel's width then counts in the model, and samples^2 of it do not in the image.
    """
    if chip.response is None:
        return None, []
    messages = chip.response.contradictions(chip.source)
    widths = list(chip.response.width_m)
    if chip.locate is not None:
        geometry, reference = geometry_of(world, view), np.asarray(world.reference_point_m, np.float64)
        ends = np.array([-0.5, 0.5])
        points = plane_points(geometry, reference, ends, ends)
        place = chip.locate(points) * chip.spacing_m  # (range, azimuth, row and column) [m]
        slopes = np.stack([place[1] - place[0], place[:, 1] - place[:, 0]]).mean(axis=1)  # (range or azimuth, 2)
        size = np.abs(slopes)
        aside = (size - np.diag(np.diag(size))).sum(axis=0)
        if (aside > _ALONG * np.diag(size)).any():
            message = "its rows and columns are not along range and azimuth: no point_spread is declared"
            return None, [*messages, f"{chip.source}: {message}"]
        widths = (np.asarray(widths) / np.diag(size)).tolist()
    cells = np.prod(chip.response.width_m) * np.prod(chip.response.band)
    return _table(widths, "sinc" if cells < 1.0 else "taylor", world, samples), messages


def of_focus(
    history: PhaseHistory, windows: tuple[str, str], world: World, samples: tuple[int, int]
) -> dict[str, Any] | None:
    """The table of a phase history that was focused as one aperture: of its band, its track and the tapers of both.

    None where a taper is none that `point_spread` knows.
    """
    names = [_OF_TAPER.get(window) for window in windows]
    if None in names:
        return None
    cells = cell_m(history, np.asarray(world.reference_point_m, np.float64))
    widths = [cell * width_in_cells(window) for cell, window in zip(cells, windows, strict=True)]
    window = names[0] if names[0] == names[1] else names
    return _table(widths, window, world, samples)


_OF_TAPER = {"none": "sinc", "taylor": "taylor"}


def _table(widths: Sequence[float], window: Any, world: World, samples: tuple[int, int]) -> dict[str, Any]:
    """The table of widths in range and azimuth [m] that are known to 5 % and to what pixels add."""
    box = [_BOX * (step / count) ** 2 for step, count in zip(world.grid.spacing_m, samples, strict=True)]
    sds = []
    for width, part in zip(widths, box, strict=True):
        sharper = width - np.sqrt(max(width**2 - part, 0.0))
        sds.append(float(np.hypot(KNOWN * width, sharper)))
    names = ("range_fwhm_m", "azimuth_fwhm_m")
    return {
        **dict(zip(names, (_digits(width) for width in widths), strict=True)),
        "window": window,
        "tolerance": dict(zip(names, map(_digits, sds), strict=True)),
    }


def contradicts(table: Mapping[str, Any], stated: Mapping[str, Any]) -> list[str]:
    """Where a declared table and that of the scene file differ by more than three times the declared tolerance."""
    return [
        f"{key} = {stated.get(key, 0.0):g} m, but the file says {table[key]:g} m (within {3.0 * sd:g})"
        for key, sd in table["tolerance"].items()
        if abs(float(stated.get(key, 0.0)) - table[key]) > 3.0 * sd
    ]


def _digits(value: float) -> float:
    return float(f"{value:.4g}")
