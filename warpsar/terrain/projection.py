"""A block's facets into its pixels, and into cells of the map, on the device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.kernels.terrain import (
    Backscatter,
    CellPlaces,
    GroundFacets,
    MapGrid,
    PixelEdges,
    PixelSums,
    PostPlaces,
    hiding_kernel,
    map_kernel,
    place_kernel,
    project_kernel,
)
from warpsar.runtime.structs import element_types, fill
from warpsar.terrain.ground import GroundPosts

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
CLEAR_SHARE = 0.002
"""Of the posts' spacing: how far from the ground a ray to the radar starts. Float32 holds places to 1 mm in a block."""
LEAST_CLEAR_M = 0.02


@dataclass(frozen=True)
class BlockPixels:
    """Of each pixel, (lines, pixels)."""

    area: F32
    """Lit area [m2]; `across` as seen from the radar; `power` times sigma0."""
    across: F32
    power: F32
    surfaces: F32
    """Lit surfaces, a part of one where it fills a part of the pixel; `folded`: those whose far side is nearer to the
    radar; `covered`: 1 where the pixel shows ground only, lit or not, and less at the edge of the elevation model."""
    folded: F32
    covered: F32
    longitude: F64
    """Of what is seen at the middle [deg], NaN where nothing is lit; and its height [m] and incidences [deg]."""
    latitude: F64
    height: F32
    incidence: F32
    ellipsoid_incidence: F32
    cover: F32
    """Row of sigma0 there."""


@dataclass(frozen=True)
class BlockCells:
    """Of cells of the map (rows, columns): which of the block's pixels, (lines * pixels,), shows it; -1 for none. Its
    line and pixel in the block, fractional; local incidence [deg]; whether it is lit, and on a facet that lies over
    others. Where no pixel shows it these say nothing."""

    pixel: NDArray[np.int32]
    line_at: F64
    pixel_at: F64
    incidence: F32
    lit: NDArray[np.uint8]
    folded: NDArray[np.uint8]


class BlockProjection:
    """A block on the device. `edges_m` (lines, pixels + 1): where pixels begin and end [m]; either way along."""

    def __init__(
        self,
        ground: GroundPosts,
        edges_m: F64,
        sigma0: F64,
        spacing_m: float,
        device: wp.Device,
    ) -> None:
        self._turned = bool(edges_m[0, 0] > edges_m[0, -1])
        edges = np.ascontiguousarray((edges_m[:, ::-1] if self._turned else edges_m) - ground.start_m, np.float32)
        self.shape = edges.shape[0], edges.shape[1] - 1
        self.device = device
        self._ground = ground
        points: wp.array = wp.array(ground.point_m, dtype=wp.vec3, device=device)
        corners: wp.array = wp.array(ground.facets.ravel(), dtype=int, device=device)
        self._facets = fill(
            GroundFacets,
            points=points,
            corners=corners,
            line=wp.array(ground.line, dtype=wp.float64, device=device),
            slant=wp.array(ground.slant_m, dtype=wp.float64, device=device),
            look=wp.array(ground.look, dtype=wp.vec3, device=device),
            cover=wp.array(ground.cover, dtype=int, device=device),
            place=wp.array(ground.class_place, dtype=wp.vec2, device=device),
            ground=ground.ground_facets,
            forward=ground.forward,
        )
        self._tree = wp.Mesh(points, self._hiding(corners))
        self._edges = fill(PixelEdges, slant=wp.array(edges, dtype=float, device=device))
        self._backscatter = fill(
            Backscatter,
            sigma0=wp.array(sigma0, dtype=float, device=device),
            classes=wp.array(ground.classes, dtype=int, device=device),
        )
        self._pixel_m = float(np.abs(np.diff(edges[0])).mean())
        extent = np.ptp(ground.point_m, axis=0)
        self._reach_m = float(np.linalg.norm(extent)) + 1.0
        self._clear_m = max(CLEAR_SHARE * spacing_m, LEAST_CLEAR_M)

    def _hiding(self, corners: wp.array) -> wp.array:
        """Corners of the facets that may hide others from the radar: some in a hundred of most terrain.

        A ray can come below the ground through a hole in it; then all may be met.
        """
        ground = self._ground
        if (ground.cell < 0).any():
            return corners
        hides = wp.zeros(len(ground.facets), dtype=wp.uint8, device=self.device)
        wp.launch(hiding_kernel, dim=len(hides), inputs=[self._facets], outputs=[hides], device=self.device)
        chosen = np.flatnonzero(hides.numpy())
        kept = ground.facets[chosen if chosen.size else [0]]  # a tree must have one
        found: wp.array = wp.array(kept.ravel(), dtype=int, device=self.device)
        return found

    def pixels(self) -> BlockPixels:
        """Facets into pixels."""
        names = ("area", "across", "power", "surfaces", "folded", "covered")
        found = {name: wp.zeros(self.shape, dtype=float, device=self.device) for name in names}
        place = wp.zeros(self.shape, dtype=wp.int64, device=self.device)
        sums = fill(PixelSums, place=place, **found)
        inputs = [
            self._facets, self._edges, self._backscatter, self._tree.id, self._pixel_m, self._clear_m, self._reach_m
        ]  # fmt: skip
        wp.launch(project_kernel, dim=len(self._ground.facets), inputs=inputs, outputs=[sums], device=self.device)
        geodetic = self._ground.geodetic
        origin = self._ground.origin
        posts = fill(
            PostPlaces,
            longitude=wp.array(geodetic[:, 1] - origin.longitude_deg, dtype=wp.float64, device=self.device),
            latitude=wp.array(geodetic[:, 0] - origin.latitude_deg, dtype=wp.float64, device=self.device),
            height=wp.array(geodetic[:, 2], dtype=wp.float64, device=self.device),
            up=wp.array(self._ground.up, dtype=wp.vec3, device=self.device),
        )
        seen = [wp.empty(self.shape, dtype=kind, device=self.device) for kind in (wp.float64,) * 2 + (float,) * 4]
        wp.launch(
            place_kernel, dim=self.shape, 
            inputs=[self._facets, posts, self._edges, place, self._backscatter, self._pixel_m],
            outputs=seen, device=self.device,
        )  # fmt: skip
        longitude, latitude, height, incidence, ellipsoid, cover = (self._straight(each.numpy()) for each in seen)
        area, across, power, surfaces, folded, covered = (self._straight(found[name].numpy()) for name in names)
        return BlockPixels(
            area, across, power, surfaces, folded, covered, longitude + origin.longitude_deg,
            latitude + origin.latitude_deg, height, incidence, ellipsoid, cover,
        )  # fmt: skip

    def cells(self, fine: int) -> BlockCells:
        """Cells of the map, `fine` by `fine` about each post of the block."""
        ground = self._ground
        grid = fill(
            MapGrid,
            facet=wp.array(ground.cell, dtype=int, device=self.device),
            fine=fine,
            turned=int(ground.turned),
            backwards=int(self._turned),
        )
        shape = tuple((n + 1) * fine for n in ground.cell.shape)
        found = {
            name: wp.empty(shape, dtype=kind, device=self.device) for name, kind in element_types(CellPlaces).items()
        }
        wp.launch(
            map_kernel, dim=shape,
            inputs=[grid, self._facets, self._edges, self._tree.id, self._clear_m, self._reach_m],
            outputs=[fill(CellPlaces, **found)], device=self.device,
        )  # fmt: skip
        return BlockCells(**{name: values.numpy() for name, values in found.items()})

    def _straight(self, found: np.ndarray) -> np.ndarray:
        return found[:, ::-1] if self._turned else found
