"""Is anything left beside speckle? One answer for each role's images, at a declared error rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from scipy.special import erfc

from warpsar.learning.observation import Observation
from warpsar.runtime import threads
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import hit_grid
from warpsar.speckle.draws import Speckle
from warpsar.speckle.likelihood import deviance, expected_deviance
from warpsar.speckle.own import Patch, own_autocovariance
from warpsar.speckle.scan import Scan
from warpsar.speckle.tail import Tail

ERROR_RATE = 0.01  # chance that speckle alone is called anything else: half for the scan, half for the level
SIDES = (1, 3, 5, 9, 17)  # pixels on a side of a window
LOOKS_SD = 0.01  # relative standard deviation that stated looks are granted
ESTIMATED_LOOKS_SD = 0.06  # of estimated ones, which are right to 12 % (docs/import.md)
WIDEST = 0.1  # standard deviation of the mean deviance beyond which nothing can be told
TRACE = 0.1  # of the median beta0: less is a border pixel's share of light
DRAWN, MOST_DRAWS, FEWEST_DRAWS = 2e7, 1000, 200  # pixels drawn altogether, and draws
BATCH = 2e6  # pixels drawn at once
SAMPLE, TILE = 200_000, 256  # compared pixels that are drawn; beyond them tiles stand for the whole
SEED = 20  # of the draws

Finding = Literal["speckle", "structure", "level", "cannot be told"]


@dataclass(frozen=True)
class Window:
    """A window of `pixels` x `pixels` about (`row`, `col`), or (`range_m`, `azimuth_m`) about the reference point.

    `ratio_db`: measured over modelled power of its compared pixels [dB]; -infinity where all measure 0. `z`: the
    mean residual over the standard deviation that speckle gives it.
    """

    view: str
    polarization: str
    row: int
    col: int
    pixels: int
    range_m: float
    azimuth_m: float
    ratio_db: float
    z: float


@dataclass(frozen=True)
class Verdict:
    """What is left of the images of one role.

    `deviance`: mean of d / E[d]; `deviance_error`: how far it would scatter about 1 by speckle, by what is known of
    the looks, and by the rays. `p_level`, `p_structure`: chances of a deviance so far from 1 and of a window so strong,
    by speckle alone. `window`: the strongest one, whatever its chance.
    """

    finding: Finding
    deviance: float
    deviance_error: float
    p_level: float
    p_structure: float
    pixels: int
    window: Window

    @property
    def wrong(self) -> bool:
        """Whether something speaks against the model; a deviance under 1 speaks against the looks alone."""
        return self.finding == "structure" or (self.finding == "level" and self.deviance > 1.0)

    @property
    def words(self) -> str:
        """One sentence."""
        w = self.window
        level = f"deviance {self.deviance:.3f}, where speckle leaves 1 +- {self.deviance_error:.3f}"
        if self.finding == "structure":
            size = "is one pixel" if w.pixels == 1 else f"has {w.pixels} x {w.pixels} pixels"
            return (
                f"structure is left ({_p(self.p_structure)}): the strongest window {size}, in "
                f"{w.view} {w.polarization} at range {w.range_m:.1f} m, azimuth {w.azimuth_m:.1f} m, "
                f"{w.ratio_db:+.1f} dB; {level}"
            )
        if self.finding == "level":
            return (
                f"the level is off ({_p(self.p_level)}): {level}; the looks are stated wrongly, or the model is wrong"
            )
        if self.finding == "speckle":
            return f"nothing but speckle is found: {level}"
        return f"cannot be told from {self.pixels} pixels: {level}"

    def content(self) -> dict[str, Any]:
        """For the JSON files."""
        return {**asdict(self), "error_rate": ERROR_RATE, "words": self.words}


def _p(chance: float) -> str:
    return f"p {chance:.1g}" if chance >= 1e-6 else "p < 1e-6"


def verdict(scene: Scene, images: Sequence[tuple[Observation, np.ndarray]], ray_noise: float = 0.0) -> Verdict:
    """The verdict on measured images, each with the model's beta0 with its gain, shape (rows, cols).

    Two tests share `ERROR_RATE`. The scan asks for the strongest window of the residual (`Scan`), calibrated by draws
    of speckle with the residual's own correlation. They have the looks that the residual shows, where these are fewer
    than stated: wrong looks alone are no structure. The level asks whether the mean deviance is 1 within the error of
    the same draws and of the looks. `ray_noise` is what the model's rays add to it.
    """
    patches = [_patch(seen, modelled) for seen, modelled in images]
    sample, share = _sample(patches)
    correlation, variance = own_autocovariance(sample)
    shown = max(variance, 1.0)
    strongest, levels = _drawn(sample, correlation, shown)
    scan = Scan([seen for seen, _ in images], correlation, _silent(images, shown), SIDES)
    spot = scan.strongest([np.sqrt(p.looks / shown) * (p.values - 1.0) for p in patches])
    in_sample = min(np.exp(-float(Tail.of(strongest)(abs(spot.z)))), 1.0 - 1e-9)
    p_structure = float(-np.expm1(np.log1p(-in_sample) / share))

    counts = np.array([seen.count for seen, _ in images])
    mean = float(sum(_level(p.values, p.looks).sum() for p in patches) / counts.sum())
    looks_sd = [ESTIMATED_LOOKS_SD if seen.looks_estimated else LOOKS_SD for seen, _ in images]
    speckle_sd = float(levels.std() * np.sqrt(share))
    error = float(np.hypot(speckle_sd, counts @ looks_sd / counts.sum()))
    off = mean - 1.0 if mean < 1.0 else max(mean - 1.0 - ray_noise, 0.0)
    p_level = float(erfc(abs(off) / error / np.sqrt(2.0)))

    finding: Finding = "speckle"
    if p_structure < ERROR_RATE / 2:
        finding = "structure"
    elif p_level < ERROR_RATE / 2:
        finding = "level"
    elif speckle_sd > WIDEST:
        finding = "cannot be told"
    seen, modelled = images[spot.observation]
    window = _window(scene, seen, modelled, spot.row, spot.col, spot.window, spot.z)
    return Verdict(finding, mean, error, p_level, p_structure, int(counts.sum()), window)


def _patch(seen: Observation, modelled: np.ndarray) -> Patch:
    ratio = np.ones(modelled.shape)
    ratio[seen.interior] = seen.values / modelled[seen.interior]
    return Patch(seen.interior, ratio, seen.looks)


def _level(ratio: np.ndarray, looks: float) -> np.ndarray:
    """d / E[d] of each pixel, any shape."""
    return deviance(ratio, np.ones(()), looks) / expected_deviance(looks)


def _sample(patches: Sequence[Patch]) -> tuple[list[Patch], float]:
    """What is drawn, and its share of all compared pixels: everything, or tiles of it taken at random."""
    total = sum(int(p.interior.sum()) for p in patches)
    if total <= SAMPLE:
        return list(patches), 1.0
    tiles = [
        (p, slice(row, row + TILE), slice(col, col + TILE))
        for p in patches
        for row in range(0, p.interior.shape[0], TILE)
        for col in range(0, p.interior.shape[1], TILE)
    ]
    found: list[Patch] = []
    taken = 0
    for k in np.random.default_rng(SEED).permutation(len(tiles)):
        p, rows, cols = tiles[k]
        count = int(p.interior[rows, cols].sum())
        if count and taken < SAMPLE:
            found.append(Patch(p.interior[rows, cols], p.ratio[rows, cols], p.looks))
            taken += count
    return found, taken / total


def _drawn(sample: Sequence[Patch], correlation: np.ndarray, shown: float) -> tuple[np.ndarray, np.ndarray]:
    """The strongest window and the mean deviance of draws of speckle alone, shape (draws,) each; `shown`: the variance
    of the residual over that of the stated looks."""
    patches = [Patch(p.interior, p.ratio, p.looks / shown) for p in sample]
    counts = [int(p.interior.sum()) for p in patches]
    speckle, scan = Speckle(patches, correlation), Scan(patches, correlation, sides=SIDES)
    draws = int(np.clip(DRAWN / sum(counts), FEWEST_DRAWS, MOST_DRAWS))
    size = int(np.clip(BATCH / sum(counts), 1, 25))

    def batch(sequence: np.random.SeedSequence) -> tuple[np.ndarray, np.ndarray]:
        parts = np.split(speckle(np.random.default_rng(sequence), size), np.cumsum(counts)[:-1])
        powers = [np.maximum(1.0 + part / np.sqrt(p.looks), 1e-12) for part, p in zip(parts, patches, strict=True)]
        total = sum(_level(power, p.looks).sum(axis=0) for power, p in zip(powers, patches, strict=True))
        return scan.largest(parts), np.asarray(total / sum(counts))

    seeds = np.random.SeedSequence(SEED).spawn(-(-draws // size))
    strongest, levels = zip(*threads.in_threads(partial(batch, one) for one in seeds), strict=True)
    return np.concatenate(strongest), np.concatenate(levels)


def _silent(images: Sequence[tuple[Observation, np.ndarray]], shown: float) -> list[np.ndarray]:
    """The residual of pixels that measure exactly 0 where the model puts more than a trace of light, 0 elsewhere."""
    return [
        np.where(seen.silent & (mu > TRACE * np.median(mu[seen.interior])), -np.sqrt(seen.looks / shown), 0.0)
        for seen, mu in images
    ]


def _window(scene: Scene, seen: Observation, modelled: np.ndarray, row: int, col: int, pixels: int, z: float) -> Window:
    grid = hit_grid(scene)
    place = [a + (k + 0.5) * s for a, k, s in zip(grid.start_m, (row, col), grid.spacing_m, strict=True)]
    around = tuple(slice(max(k - pixels // 2, 0), k + pixels // 2 + 1) for k in (row, col))
    counted = (seen.interior | seen.silent)[around]
    with np.errstate(divide="ignore"):
        ratio_db = 10.0 * np.log10(seen.measured[around][counted].sum() / modelled[around][counted].sum())
    return Window(
        seen.view.name, seen.polarization, row, col, pixels, float(place[0]), float(place[1]), float(ratio_db), z
    )
