"""Where the pixels of a view's slant-plane grid lie in the world."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpsar.kernels.backproject import first_surface_kernel
from warpsar.runtime import console, devices
from warpsar.world.frame import ViewGeometry
from warpsar.world.mesh import Mesh

_ARC_STEPS = 64  # chords along a strip-map's circle of equal range: at 300 m their sagitta over 50 m is 0.3 mm


def pixel_centres(shape: tuple[int, int], spacing_m: tuple[float, float], looks: tuple[int, int]) -> list[np.ndarray]:
    """Range (rows * looks[0],) and azimuth (cols * looks[1],) [m] of each sample, about the reference point."""
    counts = [size * n for size, n in zip(shape, looks, strict=True)]
    steps = [step / n for step, n in zip(spacing_m, looks, strict=True)]
    return [(np.arange(count) + 0.5 - count / 2.0) * step for count, step in zip(counts, steps, strict=True)]


def plane_points(
    geometry: ViewGeometry,
    reference_point_m: np.ndarray,
    range_m: np.ndarray,
    azimuth_m: np.ndarray,
    height_m: np.ndarray | float = 0.0,
) -> np.ndarray:
    """World points (rows, cols, 3) at the given range, azimuth and height above the reference point [m].

    In a plane wave the range is X . d. In a strip-map it is the distance from the track less R0. NaN where there is no
    such point.
    """
    horizontal = geometry.d[:2]
    sine, cosine = float(np.hypot(*horizontal)), float(-geometry.d[2])
    r, a, z = np.broadcast_arrays(range_m[:, None], azimuth_m[None, :], np.asarray(height_m, np.float64))
    if geometry.slant_range_m is None:
        out = (r + z * cosine) / sine
    else:
        slant = geometry.slant_range_m
        with np.errstate(invalid="ignore"):
            out = np.sqrt((slant + r) ** 2 - (slant * cosine - z) ** 2) - slant * sine
    along = np.append(horizontal / sine, 0.0)
    return (
        out[..., None] * along
        + a[..., None] * geometry.u
        + z[..., None] * [0.0, 0.0, 1.0]
        + np.asarray(reference_point_m)
    )


def mesh_points(
    geometry: ViewGeometry,
    reference_point_m: np.ndarray,
    range_m: np.ndarray,
    azimuth_m: np.ndarray,
    mesh: Mesh,
    device: str | None = None,
) -> tuple[np.ndarray, int]:
    """World points (rows, cols, 3) [m] on the mesh, and how many pixels meet no surface.

    Points of equal range and azimuth lie on a curve. A pixel's point is the first one on the surface, from the top
    down. Pixels that meet no surface lie at the reference point's height.
    """
    target = devices.resolve_device(device)
    reference = np.asarray(reference_point_m, np.float64)
    corners = (mesh.vertices - reference).astype(np.float32)
    surface = wp.Mesh(
        wp.array(corners, dtype=wp.vec3, device=target),
        wp.array(mesh.faces.astype(np.int32).ravel(), dtype=int, device=target),
    )
    top, bottom = float(corners[:, 2].max()), float(corners[:, 2].min())
    margin = 0.01 * (top - bottom) + 1e-3 * max(1.0, abs(top), abs(bottom))
    steps = 1 if geometry.slant_range_m is None else _ARC_STEPS
    heights = np.linspace(top + margin, bottom - margin, steps + 1)
    points = np.empty((range_m.size, azimuth_m.size, 3))
    missed = 0
    block = max(1, (1 << 22) // (azimuth_m.size * heights.size))
    with console.progress(range_m.size, "placing pixels on the mesh", "row") as bar:
        for first in range(0, range_m.size, block):
            rows = range_m[first : first + block]
            curve = np.stack([plane_points(geometry, np.zeros(3), rows, azimuth_m, z) for z in heights], axis=2)
            curve = curve.reshape(-1, heights.size, 3).astype(np.float32)
            fraction = wp.empty(curve.shape[0], dtype=float, device=target)
            wp.launch(
                first_surface_kernel,
                dim=curve.shape[0],
                inputs=[surface.id, wp.array(curve, dtype=wp.vec3, device=target)],
                outputs=[fraction],
                device=target,
            )
            met = fraction.numpy().reshape(rows.size, azimuth_m.size).astype(np.float64)
            height = np.where(met >= 0.0, np.interp(met, np.arange(heights.size), heights), 0.0)
            missed += int((met < 0.0).sum())
            points[first : first + block] = plane_points(geometry, reference, rows, azimuth_m, height)
            bar.update(rows.size)
    return points, missed
