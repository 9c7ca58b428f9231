"""Layers beside the image: incidence, layover count, shadow and material of every pixel."""

from __future__ import annotations

from functools import partial

import numpy as np
import warp as wp
from scipy.ndimage import binary_closing, label

from warpsar.kernels import layers as kernels
from warpsar.runtime import devices, threads
from warpsar.trace.hits import BinGrid, Hits
from warpsar.trace.rays import ray_grid
from warpsar.trace.target import Target
from warpsar.world.frame import ViewGeometry
from warpsar.world.mesh import Mesh


def layers(target: Target, mesh: Mesh, hits: Hits, rays_per_m2: float) -> dict[str, np.ndarray]:
    """Layers of one view, each float32 of shape (rows, cols).

    `incidence_deg`: local incidence angle on the lit surface [deg], averaged over its area; NaN where nothing is lit.
    `layover`: how many separate stretches of lit surface fall into the pixel, averaged over its azimuth cells.
    `shadow`: 1 where all surfaces in the pixel are hidden from the radar, else 0.
    `material`: index into the mesh's materials of the one with the largest lit area; -1 where nothing is lit.
    """
    rows, cols = hits.grid.shape
    n = rows * cols
    pixel, weight = hits.pixel.numpy(), hits.weight.numpy().astype(float)
    area = np.bincount(pixel, weight, n)
    lit = area > 0
    theta = np.rad2deg(np.arccos(hits.cos_incidence.numpy().astype(float)))
    with np.errstate(invalid="ignore"):
        incidence = np.bincount(pixel, weight * theta, n) / area
    material = mesh.face_material[hits.face.numpy()]
    best, largest = np.full(n, -1.0), np.zeros(n)
    for index in range(len(mesh.materials)):
        share = np.bincount(pixel[material == index], weight[material == index], n)
        best[share > largest] = index
        largest = np.maximum(largest, share)
    visits, hidden = launch_layers(target, hits.geometry, hits.grid, rays_per_m2)
    found = {
        "incidence_deg": np.where(lit, incidence, np.nan),
        "layover": np.where(lit, np.maximum(visits, 1.0), 0.0),
        "shadow": np.where(hidden & ~lit, 1.0, 0.0),
        "material": best,
    }
    return {name: values.reshape(rows, cols).astype(np.float32) for name, values in found.items()}


FEW = 4.0  # rays per pixel that tell where a surface lies, for pictures
HOLES = 2  # pixels: how wide holes between those rays are closed
SMALL = 64  # pixels of a hole that is filled: no mesh has one so small that a picture must show


def covered(target: Target, geometry: ViewGeometry, grid: BinGrid) -> np.ndarray:
    """Where a surface lies in an image, lit or hidden, bool of shape (rows, cols).

    For pictures: of few rays, so a border is known to a pixel or two. Ground at grazing angles has holes, which are
    filled up to `SMALL` pixels.
    """
    visits, hidden = launch_layers(target, geometry, grid, FEW / grid.pixel_area_m2)
    found = ((visits > 0) | hidden).reshape(grid.shape)
    found = np.asarray(binary_closing(np.pad(found, HOLES), iterations=HOLES)[HOLES:-HOLES, HOLES:-HOLES])
    number, _ = label(~found)
    return found | (np.bincount(number.ravel())[number] <= SMALL)


def launch_layers(
    target: Target, geometry: ViewGeometry, grid: BinGrid, rays_per_m2: float
) -> tuple[np.ndarray, np.ndarray]:
    """Stretches of lit surface per pixel (float32), and whether a hidden surface lies there (bool): (rows * cols,)."""
    device = target.device
    rays = ray_grid(target, geometry, grid, rays_per_m2, grid.pixel_area_m2)
    first, last = rays.first_cell, rays.end_cell
    visits = wp.zeros(grid.shape[0] * grid.shape[1], dtype=float, device=device)
    hidden = wp.zeros(grid.shape[0] * grid.shape[1], dtype=int, device=device)
    width = max(1, -(-(last - first) // rays.cells_per_column // 8)) * rays.cells_per_column

    def band(begin: int) -> None:
        # bands are whole columns of pixels: no two threads write into one
        wp.launch(
            kernels.layers_kernel,
            min(width, last - begin),
            inputs=[rays, target.triangles, target.bvh.id, begin],
            outputs=[visits, hidden],
            device=device,
        )

    if last > first:
        devices.load_kernels(device, "layers")
        for _ in threads.ordered([partial(band, begin) for begin in range(first, last, width)], device):
            pass
    return visits.numpy(), hidden.numpy() > 0
