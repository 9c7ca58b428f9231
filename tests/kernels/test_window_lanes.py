"""Weighted sums over windows on the CPU, eight draws at once, against sums that NumPy takes window by window."""

import numpy as np
import pytest
import warp as wp

from warpsar.kernels import window_lanes
from warpsar.runtime.structs import fill

SIZES = ((1, 1), (3, 3), (5, 1), (3, 33))  # the last one is wider than the image
ROUNDING = 1e-4  # of differences of float32 sums over some hundred values of 1


@pytest.mark.parametrize("draws", [1, 8, 11])
def test_extremes_are_those_of_sums_window_by_window(draws: int) -> None:
    random = np.random.default_rng(3)
    inside = random.random((9, 14)) < 0.8
    values = random.normal(size=(int(inside.sum()), draws)).astype(np.float32)
    scale = random.random((len(SIZES), *inside.shape)).astype(np.float32)
    high, low, total = (
        wp.empty(shape, dtype=float, device="cpu")
        for shape in ((len(SIZES), draws), (len(SIZES), draws), (9 + 2) * (14 + 1) * window_lanes.LANES)
    )
    windows = fill(
        window_lanes.Windows,
        size=wp.array(np.array(SIZES, np.int32), dtype=wp.vec2i, device="cpu"),
        scale=wp.array(scale, device="cpu"),
        inside=wp.array(inside.astype(np.uint8), device="cpu"),
    )
    inputs = [windows, wp.array(values, device="cpu"), total]
    wp.launch(window_lanes.scan_kernel, 1, inputs=inputs, outputs=[high, low], device="cpu")

    image = np.zeros((*inside.shape, draws))
    image[inside] = values
    for k, (rows, columns) in enumerate(SIZES):
        about = [
            scale[k, r, c]
            * image[max(r - rows // 2, 0) : r + rows // 2 + 1, max(c - columns // 2, 0) : c + columns // 2 + 1].sum(
                axis=(0, 1)
            )
            for r in range(9)
            for c in range(14)
        ]
        np.testing.assert_allclose(high.numpy()[k], np.max(about, axis=0), atol=ROUNDING)
        np.testing.assert_allclose(low.numpy()[k], np.min(about, axis=0), atol=ROUNDING)
