"""What needs no physics.

A constant level, and a smooth curve. Each is fitted to the very curve that it is judged on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from warpsar.curves.metrics import decibels
from warpsar.curves.noise import Fit, fit
from warpsar.curves.observed import ObservedCurve

MOST_TERMS = 8
"""Of a smooth curve's polynomial; nor more than one for three independent directions."""


@dataclass(frozen=True)
class CurveRival:
    """Curves without physics, and what their parameters cost."""

    name: str
    model_m2: list[NDArray[np.float64]]
    parameters: int
    fitted: Fit
    """The noise about them."""


def constant(curves: Sequence[ObservedCurve]) -> CurveRival:
    """One level for each curve: the median of its decibels, which no other level beats in mean abs(dB)."""
    models = [np.full(len(one.measured_m2), 10 ** (np.median(decibels(one.measured_m2)) / 10)) for one in curves]
    return _rival("constant level", curves, models, len(curves))


def smooth(curves: Sequence[ObservedCurve]) -> CurveRival:
    """A polynomial in angle through the decibels of each curve.

    Its degree is what the independent directions pay for.
    """
    models, parameters = [], 0
    for one in curves:
        model, count = _smooth(one)
        models.append(model)
        parameters += count
    return _rival("smooth curve", curves, models, parameters)


def _smooth(one: ObservedCurve) -> tuple[NDArray[np.float64], int]:
    values, number = decibels(one.measured_m2), float(one.weight.sum())
    low, high = one.azimuth_deg.min(), one.azimuth_deg.max()
    place = 2.0 * (one.azimuth_deg - low) / max(high - low, 1e-9) - 1.0
    best: tuple[float, NDArray[np.float64], int] | None = None
    for count in range(1, max(min(MOST_TERMS, int(number / 3)), 1) + 1):
        basis = np.polynomial.legendre.legvander(place, count - 1)
        root = np.sqrt(one.weight)[:, None]
        solved = np.linalg.lstsq(basis * root, values * root[:, 0], rcond=None)[0]
        left = float(one.weight @ (values - basis @ solved) ** 2) / number
        price = number * np.log(max(left, 1e-12)) + count * np.log(max(number, 2.0))
        if best is None or price < best[0]:
            best = (price, 10.0 ** (basis @ solved / 10.0), count)
    assert best is not None
    return best[1], best[2]


def _rival(
    name: str, curves: Sequence[ObservedCurve], models: list[NDArray[np.float64]], parameters: int
) -> CurveRival:
    alone = [replace(one, terms={"rival": np.sqrt(m) + 0j}) for one, m in zip(curves, models, strict=True)]
    return CurveRival(name, models, parameters, fit(alone, ["rival"]))
