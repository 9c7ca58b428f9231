"""What an effect leaves that nothing else does: the images of a model with it, as its own test sees them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.ndimage import maximum_filter, median_filter, minimum_filter
from scipy.special import gammaincinv

from warpsar.world.tables import View

Outcome = Literal["confirmed", "against", "none"]
SURE = 3.5  # standard errors from which a test says something
AT_LEAST, AT_MOST = 0.5, 2.0  # of what the effect should be in a place: outside, the place speaks against it
KNOWN = 0.3  # standard error of that share, above which a place says nothing
FEWEST = 50  # pixels of a place; fewer say nothing
STEEP = np.log(3.0)  # of ln(beta0) over 3 x 3 pixels: an edge
POINT = 4.0  # times the median of 5 x 5 pixels: a point
SHARED = 4.0  # pixels that may share one draw of speckle


@dataclass(frozen=True)
class Signature:
    """`outcome` of an effect's own test: "none" where it has none, or too few data. `text` is for people."""

    outcome: Outcome
    text: str
    numbers: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class SeenImage:
    """One measured image beside the model without the effect and with it: beta0, shape (rows, cols).

    `lit`: the compared pixels. `dark`: those far from everything lit. `material`: index of the surface with the
    largest lit area in the pixel, -1 where nothing is lit. `spacing_m`: of rows and columns.
    """

    view: View
    polarization: str
    looks: float
    looks_estimated: bool
    spacing_m: tuple[float, float]
    measured: np.ndarray
    without: np.ndarray
    with_it: np.ndarray
    lit: np.ndarray
    dark: np.ndarray
    material: np.ndarray
    materials: tuple[str, ...]
    gain: float = 1.0
    """Of the model with the effect, which its image has already."""

    @cached_property
    def points(self) -> np.ndarray:
        """Pixels within two of a bright point of the model without the effect."""
        middle = median_filter(self.without, 5)
        peak = (self.without > POINT * np.maximum(middle, 1e-30)) & (self.without == maximum_filter(self.without, 3))
        return np.asarray(maximum_filter(peak & (middle > 0), 5) & self.lit)

    @cached_property
    def edges(self) -> np.ndarray:
        """Pixels where the model without the effect is steep, and no point is near."""
        log = np.log(np.maximum(self.without, 1e-12))
        return (maximum_filter(log, 3) - minimum_filter(log, 3) > STEEP) & self.lit & ~self.points

    @property
    def even(self) -> np.ndarray:
        """Pixels of even ground."""
        return self.lit & ~maximum_filter(self.edges | self.points, 3)

    def halves(self) -> dict[str, np.ndarray]:
        """The two halves of the image in azimuth, by columns."""
        left = np.broadcast_to(np.arange(self.lit.shape[1]) < self.lit.shape[1] // 2, self.lit.shape)
        return {"the left half": left, "the right half": ~left}

    def ends_of_range(self, mask: np.ndarray) -> dict[str, np.ndarray]:
        """The pixels of a mask in the nearest and in the farthest third of its rows."""
        rows = np.flatnonzero(mask.any(axis=1))
        first, last = (rows[0], rows[-1]) if rows.size else (0, 0)
        row, third = np.arange(mask.shape[0])[:, None], (last - first) / 3.0
        return {"near range": mask & (row < first + third), "far range": mask & (row > last - third)}

    def by_material(self) -> dict[str, np.ndarray]:
        """The pixels of each material."""
        return {name: self.material == k for k, name in enumerate(self.materials)}


def power_in(images: Sequence[SeenImage], masks: Sequence[np.ndarray], what: str, where: str) -> Signature:
    """Whether the pixels of `masks` measure the power that the model with the effect has there.

    The median counts: bright things among them move it little. `what` and `where` name effect and pixels in words.
    """
    shares = np.concatenate(
        [
            np.nan_to_num(one.measured)[mask] / one.with_it[mask] * one.looks / gammaincinv(one.looks, 0.5)
            for one, mask in zip(images, masks, strict=True)
        ]
    )
    if shares.size < FEWEST:
        return Signature("none", f"{shares.size} pixels {where}: too few for a test")
    share = float(np.median(shares))
    spread = float(np.diff(np.percentile(shares, [25, 75]))[0]) / 1.35
    error = 1.25 * spread * float(np.sqrt(SHARED / shares.size))
    numbers = {"pixels": float(shares.size), "share": share, "error": error}
    facts = f"{shares.size} pixels {where} measure {share:.2f} +- {error:.2f} of the power that {what} has there"
    if share + SURE * error < AT_LEAST or share - SURE * error > AT_MOST:
        return Signature("against", facts, numbers)
    held = error < KNOWN and AT_LEAST < share < AT_MOST
    return Signature("confirmed" if held else "none", facts, numbers)


def looks_on(images: Sequence[SeenImage], masks: Sequence[np.ndarray]) -> tuple[float, float]:
    """Looks that the pixels of `masks` have, over those declared, and the standard error of its logarithm.

    From the quartiles of measured over modelled power: their ratio falls with the looks. (NaN, infinity) where pixels
    are too few.
    """
    logs, weights = [], []
    for one, mask in zip(images, masks, strict=True):
        if mask.sum() < FEWEST:
            continue
        low, high = np.percentile(one.measured[mask] / one.with_it[mask], [25, 75])
        tried = one.looks * np.exp(np.linspace(-3.0, 3.0, 241))
        ratio = gammaincinv(tried, 0.75) / gammaincinv(tried, 0.25)  # falls
        logs.append(np.interp(-high / max(low, 1e-30), -ratio, np.log(tried / one.looks)))
        weights.append(float(mask.sum()))
    if not logs:
        return float("nan"), float("inf")
    # the spread of a normal sample from its quartiles: 1.17 / sqrt(n), looks go with its square
    return float(np.exp(np.average(logs, weights=weights))), float(2.0 * 1.17 * np.sqrt(SHARED / sum(weights)))


def of_all(found: Sequence[Signature]) -> Signature:
    """Several tests of one effect as one: what speaks against it decides, then what confirms it."""
    for outcome in ("against", "confirmed", "none"):
        some = [one for one in found if one.outcome == outcome]
        if some:
            numbers = {key: value for one in found for key, value in one.numbers.items()}
            return Signature(some[0].outcome, "; ".join(one.text for one in some), numbers)
    return Signature("none", "no test of its own")


Parts = Mapping[str, np.ndarray]
