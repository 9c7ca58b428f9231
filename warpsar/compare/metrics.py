"""How far images are from the model: of one image, of several together, and the level that explains the dark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol, TypedDict, cast

import numpy as np
from scipy.optimize import minimize_scalar

from warpsar.compare.observation import Observation
from warpsar.speckle.law import Law
from warpsar.speckle.likelihood import metrics, scaled_deviance
from warpsar.speckle.residual import residual_autocovariance


class Metrics(TypedDict):
    """How far compared pixels are from the model, as in the JSON files (docs/evaluate.md).

    `rmse` is in beta0, `deviance` in units of its mean under speckle, with its standard error.
    """

    rmse: float
    nrmse: float
    rmse_db: float
    deviance: float
    correlation: float
    deviance_error: float
    pixels: int
    left_out: int
    zeros: int


class WholeMetrics(Metrics):
    """The same, and the deviance over all valid pixels, with a nuisance level added to the model."""

    deviance_all: float
    deviance_all_error: float
    pixels_all: int
    left_out_all: int


class ImageMetrics(WholeMetrics):
    """Of one image; `floor` is the nuisance level [beta0]."""

    floor: float


class PooledMetrics(WholeMetrics):
    """Of the pixels of several images together."""

    images: int


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
    d = scaled_deviance(seen.measured[mask].astype(float), modelled[mask], seen.law)
    mean = float(d.mean())
    covariance = residual_autocovariance([(replace(seen, interior=mask), d - mean)])
    return mean, float(np.sqrt(covariance.sum() / d.size))


def image_metrics(seen: Observation, simulated: np.ndarray, valid: np.ndarray) -> ImageMetrics:
    """Metrics of one image: its interior, and all its `valid` pixels; `simulated` is beta0, shape (rows, cols)."""
    floor = nuisance_floor(seen.measured[valid].astype(float), simulated[valid])
    found: dict[str, float] = metrics(seen.values, simulated[seen.interior], seen.law)
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


class Image(Protocol):
    """What metrics of several images take of each: a comparison."""

    @property
    def seen(self) -> Observation: ...

    @property
    def simulated(self) -> np.ndarray: ...

    @property
    def metrics(self) -> ImageMetrics: ...


def pool(images: Sequence[Image]) -> PooledMetrics | None:
    """Metrics over the pixels of several images together; None where there are none."""
    if not images:
        return None
    measured = np.concatenate([image.seen.values for image in images])
    simulated = np.concatenate([image.simulated[image.seen.interior] for image in images])
    found = metrics(measured, simulated, Law(1.0))  # the deviance of several laws is that of their images
    tables = [cast(dict[str, float], image.metrics) for image in images]
    for key in ("pixels", "left_out", "zeros", "pixels_all", "left_out_all"):
        found[key] = sum(table[key] for table in tables)
    for key, n in (("deviance", "pixels"), ("deviance_all", "pixels_all")):
        weights = np.array([table[n] for table in tables]) / found[n]
        found[key] = float(weights @ [table[key] for table in tables])
        found[f"{key}_error"] = float(np.linalg.norm(weights * [table[f"{key}_error"] for table in tables]))
    return cast(PooledMetrics, found | {"images": len(images)})


def difference(before: Sequence[Image], after: Sequence[Image]) -> tuple[float, float] | None:
    """Mean deviance before less that after, pixel by pixel, and its standard error: of the same speckle, so that it is
    known far better than either. On the pixels that both compare. None without images."""
    if not before:
        return None
    parts, errors = [], []
    for a, b in zip(before, after, strict=True):
        both = a.seen.interior & b.seen.interior
        measured = a.seen.measured[both].astype(float)
        one, two = (scaled_deviance(measured, image.simulated[both], image.seen.law) for image in (a, b))
        part = one - two
        pair = (replace(a.seen, interior=both), part - part.mean() if part.size else part)
        parts.append(part)
        errors.append(np.sqrt(max(float(residual_autocovariance([pair]).sum()), 0.0) / max(part.size, 1)))
    sizes = np.array([part.size for part in parts])
    shares = sizes / sizes.sum()
    return float(np.concatenate(parts).mean()), float(np.linalg.norm(shares * errors))


def likelihood_gain(before: Sequence[Image], after: Sequence[Image]) -> float:
    """Mean log-likelihood of a pixel after less before, each under the looks and texture of its own observation: what
    deviances of two laws cannot say. On the pixels that both compare."""
    parts = []
    for a, b in zip(before, after, strict=True):
        both = a.seen.interior & b.seen.interior
        measured = a.seen.measured[both].astype(float)
        one, two = (
            image.seen.law.log_density(measured / image.simulated[both]) - np.log(image.simulated[both])
            for image in (a, b)
        )
        parts.append(two - one)
    return float(np.concatenate(parts).mean())
