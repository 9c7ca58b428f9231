"""Objects whose pixels do not meet share one render: a hundred objects then cost what a few do."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from warpsar.effects.registry import get, shift_m
from warpsar.learning.geometry import GeometryCoordinate
from warpsar.scene.scene import Scene
from warpsar.world.tables import View
from warpsar.world.world import geometry_of

MARGIN = 1  # pixels about an object's own: beyond it changes by 2e-7 of the largest change, at most
BESIDE_M = 0.02  # about an object across the look direction: ten times what a difference moves it by
WIDTHS = 1.8  # full widths at half maximum, beyond which a Gaussian is under 2e-4: less than a difference is wrong by


@dataclass(frozen=True)
class Box:
    """Pixels from `low` to before `high`, (row, column) each: all that an object's move can change in a view, before
    the image stage."""

    low: tuple[int, int]
    high: tuple[int, int]

    def meets(self, other: Box) -> bool:
        return all(self.low[k] < other.high[k] and other.low[k] < self.high[k] for k in (0, 1))

    def alone(self, image: np.ndarray) -> np.ndarray:
        """The image (rows, columns) inside, and 0 outside."""
        found = np.zeros_like(image)
        inside = tuple(slice(max(low, 0), max(high, 0)) for low, high in zip(self.low, self.high, strict=True))
        found[inside] = image[inside]
        return found


def columns_of(places: Sequence[Box]) -> tuple[int, int]:
    """From the first to before the last column that any of the boxes has."""
    return min(one.low[1] for one in places), max(one.high[1] for one in places)


def boxes(scene: Scene, view: View) -> dict[str, Box] | None:
    """The pixels that each object can change with its shadow before the image stage, by label; None where an effect
    carries power further.

    What an object hides lies behind it, and not below the lowest point of the scene: (z - lowest) / cos(incidence)
    further along the ray. Where effects move the image, a box reaches from where hits lie to where their power does.
    """
    spread = _spread_m(scene)
    if spread is None or scene.slant_range_m(view) is not None or scene.assembly is None:
        return None
    geometry, spacing = geometry_of(scene, view), scene.grid.spacing_m
    away = spread + np.abs(shift_m(scene, view))
    origin, lowest = np.asarray(scene.reference_point_m), float(scene.mesh.vertices[:, 2].min())
    found = {}
    for one in scene.objects:
        vertices = scene.assembly.vertices_of(one)
        points = vertices - origin
        range_m, azimuth_m = points @ geometry.d, points @ geometry.u
        behind = range_m + (vertices[:, 2] - lowest) / -geometry.d[2]
        ends = ((range_m.min(), behind.max()), (azimuth_m.min(), azimuth_m.max()))
        low, high = [], []
        for (least, most), far, step, count in zip(ends, away, spacing, scene.grid.shape, strict=True):
            low.append(int(np.floor((least - far) / step + count / 2)) - MARGIN)
            high.append(int(np.ceil((most + far) / step + count / 2)) + MARGIN)
        found[one.label] = Box((low[0], low[1]), (high[0], high[1]))
    return found


def meetings(scene: Scene, views: Sequence[View]) -> np.ndarray | None:
    """Which bodies may change the same pixels of any of the views, shape (bodies, bodies), in the order of the scene's;
    None where an effect carries power anywhere."""
    found = np.eye(len(scene.objects), dtype=bool)
    for view in views:
        places = boxes(scene, view)
        if places is None:
            return None
        low, high = (
            np.array([getattr(places[one.label], end) for one in scene.objects]).reshape(-1, 1, 2)
            for end in ("low", "high")
        )
        found |= ((low < high.swapaxes(0, 1)) & (low.swapaxes(0, 1) < high)).all(axis=2)
    return found


def faces_about(scene: Scene, view: View, bodies: Collection[str]) -> np.ndarray:
    """The faces of the scene's mesh, shape (faces,), that bodies may hide or be hidden by, and their own, by label.

    A body changes the image where it lies across the look direction, and nowhere else. So faces whose extents meet none
    of its own there change nothing of the difference that a move of it makes.
    """
    assert scene.assembly is not None
    geometry = geometry_of(scene, view)
    axes = np.stack([geometry.u, geometry.v], axis=1)
    corners = (scene.mesh.vertices @ axes)[scene.mesh.faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    found = np.zeros(len(low), bool)
    for one in scene.objects:
        if one.label in bodies:
            own = scene.assembly.vertices_of(one) @ axes
            found |= ((low < own.max(axis=0) + BESIDE_M) & (high > own.min(axis=0) - BESIDE_M)).all(axis=1)
    return found


def _spread_m(scene: Scene) -> float | None:
    """How far effects carry power before the image stage [m]; None where one carries it anywhere."""
    found = [get(name).spread_m(table) for name, table in scene.effects.items()]
    return None if None in found else WIDTHS * sum(width for width in found if width is not None)


def shared(coordinates: Sequence[GeometryCoordinate], places: Mapping[str, Box] | None) -> list[list[int]]:
    """Coordinates that may move in one render, as lists of their numbers: one of an object, boxes that do not meet."""
    groups: list[list[int]] = []
    for k, c in enumerate(coordinates):
        for group in groups:
            if not any(_meet(c.body, coordinates[j].body, places) for j in group):
                group.append(k)
                break
        else:
            groups.append([k])
    return groups


def _meet(one: str | None, other: str | None, places: Mapping[str, Box] | None) -> bool:
    """Whether pixels may change with both. What is no object's changes all of them."""
    if one is None or other is None or places is None:
        return True
    return one == other or places[one].meets(places[other])
