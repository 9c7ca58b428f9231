"""How far a modelled curve is from a measured one: the measure of the Austin RCS Benchmark Suite, and correlation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FLOOR_M2 = 1e-20


def decibels(power_m2: NDArray[np.float64], low_dbsm: float = -200.0) -> NDArray[np.float64]:
    """dBsm, not under `low_dbsm`."""
    found: NDArray[np.float64] = np.maximum(10.0 * np.log10(np.maximum(power_m2, FLOOR_M2)), low_dbsm)
    return found


def error_db(measured_m2: NDArray[np.float64], model_m2: NDArray[np.float64], low_dbsm: float = -200.0) -> float:
    """Mean abs(dB) over angle; what is under `low_dbsm` counts as that (the suite: 80 dB under the curve's peak)."""
    return float(np.abs(decibels(measured_m2, low_dbsm) - decibels(model_m2, low_dbsm)).mean())


def correlation(measured_m2: NDArray[np.float64], model_m2: NDArray[np.float64], low_dbsm: float = -200.0) -> float:
    """Correlation of the decibels; NaN where one of the two is constant."""
    first, second = decibels(measured_m2, low_dbsm), decibels(model_m2, low_dbsm)
    if min(np.ptp(first), np.ptp(second)) < 1e-9:
        return float("nan")
    return float(np.asarray(np.corrcoef(np.stack([first, second])))[0, 1])


def level_db(measured_m2: NDArray[np.float64], model_m2: NDArray[np.float64]) -> float:
    """Mean modelled power over mean measured power [dB]."""
    return float(decibels(np.array(model_m2.mean())) - decibels(np.array(measured_m2.mean())))
