"""Power into images on the CPU, many elements to a thread, against sums by NumPy and kernels of one element each."""

from typing import Any

import numpy as np
import pytest
import warp as wp

from warpsar.kernels import binning, deposit_lanes, tangents
from warpsar.runtime.structs import fill

ROWS, COLS, FINE, BESIDE = 9, 70, 4, 2  # several stretches of `WIDEST` bins
BIN_ROWS, BIN_COLS = (ROWS + 2 * BESIDE) * FINE, (COLS + 2 * BESIDE) * FINE
ROUNDING = 1e-5  # of sums of some thirty float32 values, relative to the largest


def _on_cpu(values: np.ndarray, dtype: Any) -> wp.array:
    return wp.array(values, dtype=dtype, device="cpu")


def _bins() -> Any:
    return fill(binning.Bins, bin_rows=BIN_ROWS, bin_cols=BIN_COLS, bins_per_pixel=FINE, rows=ROWS, cols=COLS)


@pytest.mark.parametrize("shared", [True, False])
def test_deposits_are_sums_of_weighted_samples(shared: bool) -> None:
    rng = np.random.default_rng(1)
    pixel = np.sort(rng.integers(0, 300, 2000)).astype(np.int32)
    weight = rng.random(pixel.size, np.float32)
    sample = rng.integers(0, 40, pixel.size).astype(np.int32) if shared else np.arange(pixel.size, dtype=np.int32)
    sigma = rng.random(sample.max() + 1, np.float32)
    first = np.flatnonzero(np.diff(pixel, prepend=-1)).astype(np.int32)
    image: wp.array = wp.zeros(300, dtype=float, device="cpu")
    given = _on_cpu(sample if shared else np.zeros(0, np.int32), int)
    inputs = [_on_cpu(first, int), _on_cpu(pixel, int), _on_cpu(weight, float), given, _on_cpu(sigma, float)]
    threads = -(-first.size // deposit_lanes.EACH)
    assert threads > 1
    wp.launch(deposit_lanes.deposit_kernel, threads, inputs=inputs, outputs=[image], device="cpu")
    expected = np.bincount(pixel, weight.astype(float) * sigma[sample], 300)
    np.testing.assert_allclose(image.numpy(), expected, atol=ROUNDING * expected.max())


def test_the_adjoint_adds_up_what_samples_get() -> None:
    rng = np.random.default_rng(2)
    pixel, sample = (rng.integers(0, n, 500).astype(np.int32) for n in (60, 7))
    weight, slope = rng.random(500, np.float32), rng.random(60, np.float32)
    found: wp.array = wp.zeros(7, dtype=float, device="cpu")
    inputs = [_on_cpu(pixel, int), _on_cpu(weight, float), _on_cpu(sample, int), _on_cpu(slope, float)]
    wp.launch(deposit_lanes.deposit_adjoint_kernel, 1, inputs=inputs, outputs=[found], device="cpu")
    expected = np.bincount(sample, weight.astype(float) * slope[pixel], 7)
    np.testing.assert_allclose(found.numpy(), expected, rtol=ROUNDING)


SHIFTS = [(0.0, 0.0), (0.3, -0.45), (-1.0, 2.0), (-5.9, 3.31)]  # the last one moves bins out of both edges


@pytest.mark.parametrize("shift", SHIFTS)
def test_bins_slide_as_one_by_one(shift: tuple[float, float]) -> None:
    filled = _on_cpu(np.random.default_rng(3).random(BIN_ROWS * BIN_COLS, np.float32), float)
    inputs = [_bins(), _on_cpu(np.array(shift, np.float32), float), filled]
    found, expected = (wp.zeros(ROWS * COLS, dtype=float, device="cpu") for _ in range(2))
    wp.launch(deposit_lanes.slide_kernel, ROWS, inputs=inputs, outputs=[found], device="cpu")
    wp.launch(binning.slide_kernel, (ROWS, COLS), inputs=inputs, outputs=[expected], device="cpu")
    np.testing.assert_allclose(found.numpy(), expected.numpy(), atol=ROUNDING * expected.numpy().max())


def test_whole_bins_slide_by_whole_pixels() -> None:
    """Power is moved and none is lost: each pixel has the sum of its bins, one row and two columns further."""
    filled = np.random.default_rng(4).random((BIN_ROWS, BIN_COLS), np.float32)
    image: wp.array = wp.zeros(ROWS * COLS, dtype=float, device="cpu")
    inputs = [_bins(), _on_cpu(np.array([1.0, 2.0], np.float32), float), _on_cpu(filled.ravel(), float)]
    wp.launch(deposit_lanes.slide_kernel, ROWS, inputs=inputs, outputs=[image], device="cpu")
    pixels = filled.astype(float).reshape(BIN_ROWS // FINE, FINE, BIN_COLS // FINE, FINE).sum(axis=(1, 3))
    expected = pixels[BESIDE - 1 : BESIDE - 1 + ROWS, BESIDE - 2 : BESIDE - 2 + COLS]
    np.testing.assert_allclose(image.numpy().reshape(ROWS, COLS), expected, rtol=ROUNDING)


@pytest.mark.parametrize("shift", [None, *SHIFTS])
@pytest.mark.parametrize("shared", [True, False])
def test_slopes_fall_where_power_does(shift: tuple[float, float] | None, shared: bool) -> None:
    rng, n, samples = np.random.default_rng(5), 1000, 30
    of = rng.integers(0, samples, n) if shared else np.arange(n)
    count = samples if shared else n
    column = np.array([[0, 1, -1, 2], [3, -1, 4, -1]], np.int32)
    deposits = fill(
        tangents.Deposits,
        sample=_on_cpu(of.astype(np.int32) if shared else np.zeros(0, np.int32), int),
        bin=_on_cpu(np.sort(rng.integers(0, BIN_ROWS * BIN_COLS if shift else ROWS * COLS, n)).astype(np.int32), int),
        weight=_on_cpu(rng.random(n, np.float32), float),
        face=_on_cpu(rng.integers(0, 5, count).astype(np.int32), int),
        face_material=_on_cpu(np.array([0, 1, 1, 0, 1], np.int32), int),
        column=_on_cpu(column, wp.vec4i),
        slopes=_on_cpu(rng.normal(size=(count, 4)).astype(np.float32), wp.vec4),
    )
    found, expected = (wp.zeros((5, ROWS * COLS), dtype=float, device="cpu") for _ in range(2))
    threads = -(-n // deposit_lanes.EACH)
    if shift is None:
        wp.launch(deposit_lanes.tangent_kernel, threads, inputs=[deposits], outputs=[found], device="cpu")
        wp.launch(tangents.tangent_kernel, n, inputs=[deposits], outputs=[expected], device="cpu")
    else:
        bins, moved = _bins(), _on_cpu(np.array(shift, np.float32), float)
        pixel = wp.empty(BIN_ROWS + BIN_COLS, dtype=int, device="cpu")
        share = wp.empty(BIN_ROWS + BIN_COLS, dtype=wp.vec2, device="cpu")
        wp.launch(deposit_lanes.place_kernel, 1, inputs=[bins, moved], outputs=[pixel, share], device="cpu")
        inputs = [bins, pixel, share, deposits]
        wp.launch(deposit_lanes.moved_tangent_kernel, threads, inputs=inputs, outputs=[found], device="cpu")
        wp.launch(tangents.moved_tangent_kernel, n, inputs=[bins, moved, deposits], outputs=[expected], device="cpu")
    assert np.abs(expected.numpy()).max() > 0
    np.testing.assert_allclose(found.numpy(), expected.numpy(), atol=ROUNDING * np.abs(expected.numpy()).max())
