"""How far images are from the model: of one image, of several together, and the level that explains the dark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from scipy.optimize import minimize_scalar

from warpsar.evaluation.image import EvaluatedImage, ImageMetrics, PooledMetrics
from warpsar.learning.identify import residual_autocovariance
from warpsar.learning.observation import Observation
from warpsar.speckle.likelihood import deviance, expected_deviance, metrics


def nuisance_floor(measured: np.ndarray, modelled: np.ndarray) -> float:
    """The level N >= 0 that maximises the gamma likelihood of `measured` about `modelled` + N; flat arrays of the
    positive pixels. The number of looks does not move it."""

    def loss(log_level: float) -> float:
        mean = modelled + np.exp(log_level)
        return float(np.mean(measured / mean + np.log(mean)))

    # 14 decades below the brightest pixel a floor is none to float32
    grid = np.log(measured.max()) - np.linspace(32.0, 0.0, 33)
    at = int(np.argmin([loss(g) for g in grid]))
    best = minimize_scalar(
        loss, bounds=(grid[max(at - 1, 0)], grid[min(at + 1, 32)]), method="bounded", options={"xatol": 1e-6}
    )
    if modelled.min() > 0 and np.mean(measured / modelled + np.log(modelled)) <= best.fun:
        return 0.0
    return float(np.exp(best.x))


def mean_deviance(seen: Observation, modelled: np.ndarray, mask: np.ndarray) -> tuple[float, float]:
    """Mean of d / E[d] over the pixels of `mask`, and its standard error; `modelled` is beta0, shape (rows, cols).

    The error is sqrt(variance / n) with the residual's own autocovariance: speckle is correlated from pixel to pixel.
    """
    d = deviance(seen.measured[mask].astype(float), modelled[mask], seen.looks) / expected_deviance(seen.looks)
    mean = float(d.mean())
    covariance = residual_autocovariance([(replace(seen, interior=mask), d - mean)])
    return mean, float(np.sqrt(covariance.sum() / d.size))


def image_metrics(seen: Observation, simulated: np.ndarray, valid: np.ndarray, floor: float) -> ImageMetrics:
    """Metrics of one image; arguments as `EvaluatedImage` has them."""
    found: dict[str, float] = metrics(seen.values, simulated[seen.interior], seen.looks)
    found["deviance"], found["deviance_error"] = mean_deviance(seen, simulated, seen.interior)
    found["deviance_all"], found["deviance_all_error"] = mean_deviance(seen, simulated + floor, valid)
    count, count_all = int(seen.interior.sum()), int(valid.sum())
    counts = {
        "floor": floor,
        "pixels": count,
        "left_out": seen.measured.size - count,
        "zeros": seen.zeros,
        "pixels_all": count_all,
        "left_out_all": seen.measured.size - count_all,
    }
    return cast(ImageMetrics, found | counts)


def pool(images: Sequence[EvaluatedImage]) -> PooledMetrics | None:
    """Metrics over the pixels of several images together; None where there are none."""
    if not images:
        return None
    measured = np.concatenate([i.observation.values for i in images])
    found = metrics(measured, np.concatenate([i.simulated[i.interior] for i in images]), 1.0)
    tables = [cast(dict[str, float], image.metrics) for image in images]
    for key in ("pixels", "left_out", "zeros", "pixels_all", "left_out_all"):
        found[key] = sum(table[key] for table in tables)
    for key, n in (("deviance", "pixels"), ("deviance_all", "pixels_all")):
        weights = np.array([table[n] for table in tables]) / found[n]
        found[key] = float(weights @ [table[key] for table in tables])
        found[f"{key}_error"] = float(np.linalg.norm(weights * [table[f"{key}_error"] for table in tables]))
    return cast(PooledMetrics, found | {"images": len(images)})
