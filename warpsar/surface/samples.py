"""Shading samples: where bins are finer than pixels, one sample for each face and pixel serves all of its bins."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from warpsar.trace.hits import Hits


def shading_samples(hits: Hits) -> tuple[Hits, wp.array | None]:
    """Hits merged to one for each face and pixel, and the merged hit that each of `hits` belongs to.

    The second is int, shape (n,), on the device; it is None where the hits are merged already. As with the merging of
    rays, a face's parameters are taken at the mean of its places in the pixel. The finer hits still say where in the
    pixel the power falls.
    """
    if hits.grid.bins_per_pixel == 1 or not hits.count:
        return hits, None
    if "shading" not in hits.derived:
        hits.derived["shading"] = _merged(hits)
    found: tuple[Hits, wp.array | None] = hits.derived["shading"]
    return found


def _merged(hits: Hits) -> tuple[Hits, wp.array]:
    grid, fine = hits.grid, hits.grid.bins_per_pixel
    coarse = replace(
        grid,
        shape=(grid.shape[0] // fine, grid.shape[1] // fine),
        spacing_m=(grid.spacing_m[0] * fine, grid.spacing_m[1] * fine),
        bins_per_pixel=1,
    )
    row, col = np.divmod(hits.pixel.numpy().astype(np.int64), grid.shape[1])
    pixel, face = row // fine * coarse.shape[1] + col // fine, hits.face.numpy()
    faces = int(face.max(initial=0)) + 1
    keys, sample = np.unique(pixel * faces + face, return_inverse=True)
    weight = hits.weight.numpy().astype(float)
    total = np.bincount(sample, weight, keys.size)

    def mean(name: str) -> wp.array:
        array = getattr(hits, name)
        columns = array.numpy().reshape(sample.size, -1).T
        means = np.stack([np.bincount(sample, weight * c, keys.size) / total for c in columns], axis=1)
        return upload(means.astype(np.float32).reshape(keys.size, *array.numpy().shape[1:]), array.dtype)

    def upload(array: np.ndarray, dtype: type) -> wp.array:
        return wp.array(array, dtype=dtype, device=hits.pixel.device)

    means: dict[str, Any] = {n: mean(n) for n in ("barycentric", "point", "cos_incidence", "cos_twist", "cos2_azimuth")}
    merged = replace(
        hits,
        grid=coarse,
        pixel=upload((keys // faces).astype(np.int32), int),
        face=upload((keys % faces).astype(np.int32), int),
        weight=upload(total.astype(np.float32), float),
        derived={},
        **means,
    )
    return merged, upload(sample.astype(np.int32), int)


def image_pixels(shaded: Hits, shape: tuple[int, int]) -> np.ndarray:
    """The pixel (row * cols + col) of an image of `shape` in which each shading sample lies, shape (n,).

    It is -1 outside of the image: effects may put power into bins beyond the image's edges.
    """
    row, col = np.divmod(shaded.pixel.numpy(), shaded.grid.shape[1])
    row -= (shaded.grid.shape[0] - shape[0]) // 2
    col -= (shaded.grid.shape[1] - shape[1]) // 2
    inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
    return np.where(inside, row * shape[1] + col, -1)
