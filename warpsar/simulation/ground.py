"""Slant-range images projected onto the mesh, on a map."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import warp as wp
from scipy.ndimage import map_coordinates

from warpsar.io.geotiff import RasterPlace
from warpsar.io.images import LARGEST_IMAGE
from warpsar.kernels.backproject import first_surface_kernel
from warpsar.measured.ground import plane_points
from warpsar.measured.placed import WorldMap, frame_of, map_of
from warpsar.runtime import console
from warpsar.surface.stage import Stage
from warpsar.world.frame import ViewGeometry
from warpsar.world.tables import View
from warpsar.world.world import World, geometry_of

_BLOCK = 2**20  # pixels of the map that are placed together
_EDGE = 64  # points along each side of the image, by which its place on the map is found


@dataclass(frozen=True)
class MapGround:
    """A scene's ground on a map.

    A pixel of the map takes the topmost surface of the mesh at its centre, and the image's value at that point's range
    and azimuth, bilinear in power. It is NaN where there is no surface, where the surface is hidden from the radar, and
    outside of the image. In layover every surface has the sum that the image has there: nothing takes it apart.
    """

    scene: World
    stage: Stage
    world_map: WorldMap

    @classmethod
    def of(cls, scene: World, stage: Stage) -> MapGround | None:
        """None for a scene that does not say where on the earth it lies."""
        frame = frame_of(scene)
        return None if frame is None else cls(scene, stage, map_of(frame))

    def project(self, view: View, images: Mapping[str, np.ndarray]) -> tuple[dict[str, np.ndarray], RasterPlace]:
        """Images of shape (rows, cols) on the map, north up, float32, and where they lie.

        Pixels are square, as small as the finer of azimuth spacing and range spacing / sin(incidence).
        """
        geometry, (shape, place) = geometry_of(self.scene, view), self._grid(view)
        found = {name: np.full(shape, np.nan, np.float32) for name in images}
        step = max(1, _BLOCK // max(shape[1], 1))
        with console.progress(shape[0], f"{view.name}: onto the ground", "row") as bar:
            for first in range(0, shape[0], step):
                rows = np.arange(first, min(first + step, shape[0]))
                pixels = self._placed(geometry, place, rows, shape[1])
                for name, image in images.items():
                    found[name][rows] = _sampled(image, pixels)
                bar.update(rows.size)
        return found, place

    def _grid(self, view: View) -> tuple[tuple[int, int], RasterPlace]:
        """Shape and place of the map: what the image and the mesh both cover, in whole pixels."""
        scene, geometry = self.scene, geometry_of(self.scene, view)
        low, high = scene.mesh.vertices.min(axis=0), scene.mesh.vertices.max(axis=0)
        half = [n * step / 2 for n, step in zip(scene.grid.shape, scene.grid.spacing_m, strict=True)]
        range_m, azimuth_m = (np.linspace(-each, each, _EDGE + 1) for each in half)
        reference = np.asarray(scene.reference_point_m)
        heights = np.array([low[2], high[2]]) - reference[2]
        points = np.concatenate(
            [plane_points(geometry, reference, range_m, azimuth_m, z).reshape(-1, 3) for z in heights]
        )
        points = np.clip(points[np.isfinite(points).all(axis=1)], low, high)
        if not len(points):
            points = reference[None]
        x, y = self.world_map.to_map(points[:, 0], points[:, 1])
        fine = min(scene.grid.spacing_m[1], scene.grid.spacing_m[0] / math.sin(math.radians(view.incidence_deg)))
        pixel = max(fine / self.world_map.metres, math.sqrt(float(np.ptp(x) * np.ptp(y)) / (LARGEST_IMAGE / 2)))
        left, top = math.floor(x.min() / pixel), math.ceil(y.max() / pixel)
        cols = max(1, math.ceil(x.max() / pixel) - left)
        rows = max(1, top - math.floor(y.min() / pixel))
        return (rows, cols), RasterPlace(self.world_map.crs, left * pixel, top * pixel, pixel)

    def _placed(self, geometry: ViewGeometry, place: RasterPlace, rows: np.ndarray, cols: int) -> np.ndarray:
        """Row and column in the image of the map's pixels, shape (2, rows, cols); NaN where none is to be shown."""
        col, row = np.meshgrid(np.arange(cols) + 0.5, rows + 0.5)
        x, y = self.world_map.to_world(place.left + place.pixel * col, place.top - place.pixel * row)
        reference = np.asarray(self.scene.reference_point_m)
        corners = self.stage.target.corners
        top, bottom = float(corners[:, 2].max()), float(corners[:, 2].min())
        margin = 1e-3 * max(1.0, top - bottom)
        start = np.stack([x - reference[0], y - reference[1], np.full(x.shape, top + margin)], axis=-1).reshape(-1, 3)
        met = self._met(start, start - [0.0, 0.0, top - bottom + 2 * margin])
        points = start - met[:, None] * [0.0, 0.0, top - bottom + 2 * margin]
        points[met < 0] = np.nan
        range_m, azimuth_m, toward = _seen(geometry, points)
        reach = float(np.linalg.norm(np.ptp(corners, axis=0)))
        lift = 1e-3 * max(1.0, 0.01 * reach)  # off its own surface
        known = np.isfinite(range_m)
        hidden = np.zeros(len(points), bool)
        begin = points[known] + lift * toward[known]
        hidden[known] = self._met(begin, begin + reach * toward[known]) >= 0
        grid = self.scene.grid
        pixels = [
            values / step + n / 2 - 0.5
            for values, step, n in zip((range_m, azimuth_m), grid.spacing_m, grid.shape, strict=True)
        ]
        return np.where(hidden, np.nan, np.stack(pixels)).reshape(2, *x.shape)

    def _met(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        """How far along lines (n, 3), about the reference point, the mesh is first met, 0 to 1; -1 where it is not."""
        device = self.stage.target.device
        lines = np.stack([begin, end], axis=1).astype(np.float32)
        fraction = wp.empty(len(lines), dtype=float, device=device)
        inputs = [self.stage.target.bvh.id, wp.array(lines, dtype=wp.vec3, device=device)]
        wp.launch(first_surface_kernel, len(lines), inputs=inputs, outputs=[fraction], device=device)
        return fraction.numpy().astype(np.float64)


def _seen(geometry: ViewGeometry, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Range and azimuth [m] of points (n, 3) about the reference point, and unit vectors toward the radar."""
    azimuth = points @ geometry.u
    if geometry.slant_range_m is None:
        return points @ geometry.d, azimuth, np.broadcast_to(geometry.s, points.shape)
    away = points - azimuth[:, None] * geometry.u + geometry.slant_range_m * geometry.d
    distance = np.linalg.norm(away, axis=1)
    return distance - geometry.slant_range_m, azimuth, -away / distance[:, None]


def _sampled(image: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Bilinear between pixel centres, NaN outside of the image's edges or where `place` is NaN."""
    last = np.reshape(image.shape, (2, 1, 1)) - 0.5
    with np.errstate(invalid="ignore"):
        inside = ((place >= -0.5) & (place <= last)).all(axis=0)
    found = map_coordinates(image.astype(np.float64), np.where(inside, place, 0.0), order=1, mode="nearest")
    return np.where(inside, found, np.nan).astype(np.float32)
