"""Whether edges and borders of shadows lie where the model has them.

An outline that lies off by delta changes a pixel by slope * delta, whatever its speckle. So the mean square of measured
less modelled power, beyond that of speckle, tells the root mean square of delta. It needs no hypothesis of what is
wrong: a view's angle, a spacing, a wall, or a blur that nobody declared.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from scipy.special import gammaincc

from warpsar.compare.comparison import Comparison
from warpsar.compare.modelled import SURE_SDS

RESOLVED_PX = 0.5  # of a pixel: what an image's edges must be able to tell, by their errors, to be judged
GROUPS = (0.0, 0.1, 1.0, np.inf)  # of pixels, by the granted part of their variance over that of speckle
FEWEST = 20  # pixels of a group
CUT = 4.0  # standard deviations at which a pixel is cut off: the square of one of a few looks is far-tailed
SURE = 1e-3  # chance under which a group tells the displacement
_NOT_JUDGED = {"displacement_m": None, "most_m": None, "p": None}
SDS = 2.0  # standard errors about the mean square of the displacement, that are reported
TILE = 16  # pixels on a side: outlines within it are taken to be displaced alike, and others by themselves


@dataclass(frozen=True)
class EdgesOf:
    """One image's edges. `displacement_m`: root mean square by which outlines lie off in the image, `most_m` its upper
    end (two standard errors), `allowed_m` what is granted them. `p`: the chance of such a mean square, if they lie off
    by what is granted. `judged`: whether half a pixel can be told."""

    image: str
    pixels: int
    displacement_m: float
    most_m: float
    allowed_m: float
    p: float
    judged: bool


@dataclass(frozen=True)
class EdgeDisplacements:
    """The edges of several images: of each by itself, and of all `together`."""

    images: list[EdgesOf]
    together: EdgesOf

    @property
    def judged(self) -> bool:
        """Whether any image's edges are."""
        return any(one.judged for one in self.images)

    @property
    def displacement_m(self) -> float:
        """Root mean square by which outlines lie off, over all images."""
        return self.together.displacement_m

    @property
    def most_m(self) -> float:
        """The upper end of `displacement_m`; infinite where no edge was judged."""
        return self.together.most_m if self.judged else math.inf

    def off(self, chance: float) -> list[EdgesOf]:
        """The images whose outlines lie off by more than is granted, at that chance of any false alarm; worst first.
        All together where no image shows it by itself."""
        judged = sorted((one for one in self.images if one.judged), key=lambda one: one.p)
        each = chance / (len(judged) + 1)
        found = [one for one in judged if one.p < each]
        return found or [one for one in [self.together] if one.judged and one.p < each]

    @property
    def words(self) -> str:
        """One sentence."""
        if not self.judged:
            count = sum(one.pixels for one in self.images)
            why = f"their {count} pixels do not tell half a pixel" if count else "no edge shows beside speckle"
            return f"edges were not judged: {why}"
        rest = [one.image for one in self.images if not one.judged]
        more = " and others" if len(rest) > 3 else ""
        beside = f"; those of {', '.join(rest[:3])}{more} were not judged" if rest else ""
        return f"edges agree to {self.most_m:.2g} m{beside}"

    def content(self) -> dict[str, Any]:
        """For the JSON files."""
        return {
            "words": self.words,
            "judged": self.judged,
            "displacement_m": self.displacement_m if self.judged else None,
            "most_m": self.most_m if self.judged else None,
            "images": [asdict(one) | ({} if one.judged else _NOT_JUDGED) for one in self.images],
        }


def edges_of(
    images: Sequence[Comparison], shown: float = 1.0, correlation: np.ndarray | None = None
) -> EdgeDisplacements:
    """How far the outlines of several images lie off.

    `shown`: the variance that the speckle shows, over that of its law. `correlation`: the speckle's, shape
    (lags, lags); None where it is white. Points and edges that a phase error smears hold one draw of speckle in so many
    cells: the variance of sums grows by as much.
    """
    own = 1.0 if correlation is None else max(float((correlation**2).sum()), 1.0)
    inflation = [own * image.smeared for image in images]
    pixels = [_Pixels.of(image, shown) for image in images]
    allowed = [float(np.max(np.array(image.reach_px) * image.spacing_m)) for image in images]
    resolved = RESOLVED_PX * float(min(images[0].spacing_m))
    each = [
        _asked(image.name, one, granted, resolved, times)
        for image, one, granted, times in zip(images, pixels, allowed, inflation, strict=True)
    ]
    together = _asked("all images together", _Pixels.joined(pixels), max(allowed), resolved, max(inflation))
    return EdgeDisplacements(each, together)


def _asked(name: str, pixels: _Pixels, allowed: float, resolved: float, inflation: float) -> EdgesOf:
    """What some edge pixels say; `resolved` [m] must be told by them.

    The displacement is granted to every pixel. Where it could change a pixel far beyond its speckle, and does not, that
    must not excuse others. So pixels are asked in groups, by how much of their variance is granted.
    """
    count = pixels.away.size
    whole = pixels.asked(np.ones(count, bool), allowed, inflation)
    if not 0.0 < SDS * whole.error < resolved**2:
        return EdgesOf(name, count, 0.0, 1e30, allowed, 1.0, False)
    share = allowed**2 * pixels.per_m2 / np.maximum(pixels.speckle, 1e-30)
    groups = [(share >= low) & (share < high) for low, high in itertools.pairwise(GROUPS)]
    asked = [pixels.asked(group, allowed, inflation) for group in groups if group.sum() >= FEWEST] or [whole]
    worst = min(asked, key=lambda one: one.p)
    p = min(worst.p * len(asked), 1.0)
    square = max(whole.square, worst.square if p < SURE else 0.0, 0.0)
    most = float(np.sqrt(square + SDS * whole.error))
    return EdgesOf(name, count, float(np.sqrt(square)), most, allowed, p, True)


@dataclass(frozen=True)
class _Asked:
    """Mean square displacement [m2], its standard error if outlines lie where they should, and the chance of such a one
    where they lie off by what is allowed."""

    square: float
    error: float
    p: float


@dataclass(frozen=True)
class _Pixels:
    """Edge pixels, arrays of shape (n,): measured less modelled power within +-`CUT` `sd`; the variance that speckle
    makes, and its `fourth` moment beyond three variances' squares; the variance that `stated` accuracies of objects
    and rays make, and what a mean square displacement of 1 m2 adds."""

    away: np.ndarray
    speckle: np.ndarray
    fourth: np.ndarray
    stated: np.ndarray
    per_m2: np.ndarray
    sd: np.ndarray

    @classmethod
    def of(cls, image: Comparison, shown: float) -> _Pixels:
        inside = image.at_edges
        steps = np.array(image.spacing_m)[:, None]
        looks, power, sd = image.seen.looks / shown, image.simulated[inside], image.sd[inside]
        away = np.nan_to_num(image.measured[inside]).astype(float) - power
        return cls(
            np.clip(away, -CUT * sd, CUT * sd),
            power**2 / looks,
            6.0 * power**4 / looks**3,
            (image.moves[:, inside] ** 2).sum(axis=0) / SURE_SDS**2 + image.by_rays[inside],
            ((image.slopes[:, inside] / steps) ** 2).sum(axis=0),
            sd,
        )

    @classmethod
    def joined(cls, parts: Sequence[_Pixels]) -> _Pixels:
        """The pixels of several images."""
        return cls(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(cls)))

    def asked(self, some: np.ndarray, allowed: float, inflation: float) -> _Asked:
        """Least squares of the squares: linear in the mean square displacement. Its distribution is taken for a gamma
        law of the same mean and variance (Satterthwaite, Biometrics Bulletin 2, 1946); the fourth moment of gamma
        speckle is 3 + 6 / L times the square of its variance."""
        speckle, stated, per_m2 = self.speckle[some], self.stated[some], self.per_m2[some]
        weight = per_m2 / np.maximum(self.sd[some], 1e-30) ** 4
        total = float(weight @ per_m2)
        if total <= 0.0:
            return _Asked(0.0, float("inf"), 1.0)
        weight = weight / total
        squares, fourth = self.away[some] ** 2, self.fourth[some]
        error = float(np.sqrt(inflation * (weight**2 @ (2.0 * (speckle + stated) ** 2 + fourth))))
        granted = speckle + stated + allowed**2 * per_m2
        mean, variance = float(weight @ granted), inflation * float(weight**2 @ (2.0 * granted**2 + fourth))
        shape = mean**2 / variance
        p = float(gammaincc(shape, float(weight @ squares) * shape / mean))
        return _Asked(float(weight @ (squares - speckle - stated)), error, p)


def displaced(image: Comparison, random: np.random.Generator, draws: int) -> np.ndarray:
    """Draws of what the model's edge pixels would be if outlines lay off as is granted, shape (n, draws) [beta0]."""
    inside = image.at_edges
    rows, cols = np.nonzero(inside)
    across = image.simulated.shape[1] // TILE + 1
    tile = np.unique(rows // TILE * across + cols // TILE, return_inverse=True)[1]
    power = np.repeat(image.simulated[inside][:, None], draws, axis=1)
    for reach, slope in zip(image.reach_px, image.slopes[:, inside], strict=True):
        sds = random.normal(size=(int(tile.max(initial=-1)) + 1, draws)) * (reach / SURE_SDS)
        power += slope[:, None] * sds[tile]
    for move in image.moves[:, inside]:
        power += move[:, None] * random.normal(size=draws) / SURE_SDS
    return np.maximum(power, 0.0)
