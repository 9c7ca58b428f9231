"""A constant floor beside what sidelobes leave: power in the dark that falls with distance from what is bright."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.optimize import nnls
from scipy.special import gammaincinv

from warpsar.effects.base.signature import SHARED, SeenImage

REACHES = (8, 11, 16, 23, 32, 45, 64, 91, 128, 181, 256)
"""Pixels along range and azimuth to which a part of the response goes, by half octaves."""
_TAIL = 2.0  # pixels over which the far response off both axes falls: the product of two that fall as 1 / x^2
_ODD = 1e-4  # chance under the model of a pixel that is left out: something bright stands in the shadow
_STEPS, _SETTLED = 60, 1e-4  # of Fisher scoring
_OWN = 0.01  # of the measured power: a model that has less is no explanation, and its rounding none at all
_FAINT = 1e-6  # of the mean, below which no pixel's expected power is taken
_NEGLIGIBLE = 1e-6  # of the power, under which a part of the response is none


def beside_sidelobes(images: Sequence[SeenImage], floors: Sequence[float]) -> tuple[float, float, int]:
    """The share of a floor that the dark pixels measure beside sidelobes, its standard error, and their number.

    `floors` [beta0] is the floor of each image. The dark pixels' mean is

        mu = share * floor + part * without + sum of parts of a response

    where `without` is the model without the floor, above its least, and the response is any that falls with distance
    along range and along azimuth: the sum of boxes of several reaches, each times the measured power of all lit pixels
    in its reach. It is the same in all images. All parts are 0 or more. They are those of the largest quasi-likelihood
    under a gamma law of the images' looks (Fisher scoring, each step one of least squares with bounds: Lawson and
    Hanson, "Solving least squares problems", 1974).
    The error is that of the Fisher information, the other parts free. (NaN, infinity, n) where there is no floor or no
    dark pixel, and zeros where none of them measures power.
    """
    power = np.concatenate([np.nan_to_num(one.measured)[one.dark] for one in images])
    looks = np.concatenate([np.full(int(one.dark.sum()), one.looks) for one in images])
    columns = np.concatenate(
        [
            np.column_stack([np.full(int(one.dark.sum()), floor), _above_its_least(one), _response(one)])
            for one, floor in zip(images, floors, strict=True)
        ]
    )
    unit = columns.mean(axis=0) if power.size else np.zeros(columns.shape[1])
    if power.size == 0 or not unit[0] > 0:
        return float("nan"), float("inf"), power.size
    if not power.any():
        return 0.0, 0.0, power.size
    used = unit > 0
    used[1] = unit[1] > _OWN * power.mean()
    columns = columns[:, used] / unit[used]
    weights, kept = _fitted(columns, power, looks)
    mu = columns @ weights
    active = weights * columns.mean(axis=0) > _NEGLIGIBLE * mu.mean()
    active[0] = True
    slopes = (columns[:, active] / mu[:, None] * np.sqrt(looks / SHARED)[:, None])[kept]
    spread = np.linalg.pinv(slopes.T @ slopes)[0, 0]
    return float(weights[0] / unit[0]), float(np.sqrt(spread) / unit[0]), power.size


def _above_its_least(one: SeenImage) -> NDArray[np.float64]:
    """The model without the floor in the dark pixels; what is the same in all of them is no sidelobe."""
    own = one.without[one.dark]
    return np.asarray(own - own.min(initial=np.inf) if own.size else own)


def _response(one: SeenImage) -> NDArray[np.float64]:
    """What each box of the response sums up in the dark pixels, shape (pixels, boxes)."""
    source = np.where(one.lit, np.nan_to_num(one.measured), 0.0)
    found = [_box(source, axis, reach)[one.dark] for axis in (0, 1) for reach in _reaches(source.shape[axis])]
    tails = [1.0 / (1.0 + (np.arange(1 - n, n) / _TAIL) ** 2) for n in source.shape]
    found.append(np.maximum(_smeared(source, np.outer(*tails)), 0.0)[one.dark])
    return np.stack(found, axis=1)


def _smeared(source: NDArray[np.float64], response: NDArray[np.float64]) -> NDArray[np.float64]:
    """The `source`, shape (rows, cols), convolved with a `response` (2 rows - 1, 2 cols - 1) about the middle pixel."""
    rows, cols = source.shape
    whole = [next_fast_len(3 * n - 2, real=True) for n in source.shape]
    found = irfft2(rfft2(source, whole) * rfft2(response, whole), whole)
    return np.asarray(found[rows - 1 : 2 * rows - 1, cols - 1 : 2 * cols - 1])


def _reaches(count: int) -> list[int]:
    return [*(reach for reach in REACHES if reach < count), count]


def _box(source: NDArray[np.float64], axis: int, reach: int) -> NDArray[np.float64]:
    """The sum of `source` over all pixels up to `reach` before and behind along an axis."""
    count = source.shape[axis]
    total = np.concatenate([np.zeros_like(source.take([0], axis)), np.cumsum(source, axis=axis)], axis=axis)
    at = np.arange(count)
    low, high = np.maximum(at - reach, 0), np.minimum(at + reach + 1, count)
    return np.asarray(total.take(high, axis) - total.take(low, axis))


def _fitted(
    columns: NDArray[np.float64], power: NDArray[np.float64], looks: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The parts, and which pixels they rest on: those that are far too bright for the parts are left out."""
    highest = gammaincinv(looks, 1.0 - _ODD) / looks
    middle = float(np.median(power * looks / gammaincinv(looks, 0.5)))
    faintest = _FAINT * float(power.mean())
    mu = np.full(power.size, max(middle, faintest))
    weights = np.zeros(columns.shape[1])
    for _ in range(_STEPS):
        kept = power <= highest * mu
        rows = np.sqrt(looks[kept]) / mu[kept]
        # least squares of n equations with parts of 0 or more: those of its triangle are as many as parts
        triangle = np.asarray(np.linalg.qr(np.column_stack([columns[kept], power[kept]]) * rows[:, None], mode="r"))
        before, weights = weights, nnls(triangle[:, :-1], triangle[:, -1])[0]
        mu = np.maximum(columns @ weights, faintest)
        if np.allclose(weights, before, rtol=_SETTLED, atol=_SETTLED * weights.max()):
            break
    return weights, power <= highest * mu
