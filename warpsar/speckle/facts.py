"""Two facts about speckle that a scene may declare wrongly: its looks, and whether the power itself has texture.

Both make the power of even ground scatter otherwise than declared. The log-cumulants of second and third order
(`even.py`) tell them apart: one gamma law of fewer looks is more skewed than a product of two laws of the same
variance. Compression of the measured power changes both cumulants, too, and is the third explanation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.optimize import least_squares
from scipy.special import polygamma

from warpsar.speckle.even import EvenGround
from warpsar.speckle.law import looks_of_second

MATTERS = 0.10  # relative departure of looks, or of the variance by texture, that is called one
SKEWED = 0.25  # relative departure of the third cumulant that is called one
SURE = 3.0  # standard errors by which a departure must exceed what matters
FLOOR = np.array([0.02, 0.06])  # of the cumulants: what ground that is not quite even adds to their errors
PRICE = 6.0  # of chi-square, for a number: an explanation with more of them must fit so much better
CLOSE = 6.0  # of chi-square, within which another explanation is listed beside the best
POOR = 4.0  # chi-square for each degree of freedom, from which an explanation is none
BETWEEN_95 = 1.96
CLUMPED = 0.01  # of the scatter, that pixels must share for sure where the power varies in clumps
WIDEST = 5.0  # of a logarithm, that an interval reaches to either side
FOUND_FACTOR = 3.0  # factor to either side, within which an interval must lie for its number to be found

Kind = Literal["declared", "looks", "texture", "looks and texture", "none of them", "not told"]


@dataclass(frozen=True)
class Scatter:
    """One image: its `name`, the looks that its view declares (None: they were estimated from itself), the shape of
    the declared texture (infinite: none), and its even ground (None: too little)."""

    name: str
    looks: float | None
    texture: float
    ground: EvenGround | None


@dataclass(frozen=True)
class Estimate:
    """A positive number and its 95 % interval."""

    value: float
    low: float
    high: float

    @classmethod
    def of_log(cls, log: float, error: float) -> Estimate:
        reach = min(BETWEEN_95 * error, WIDEST)
        return cls(*(float(np.exp(log + way)) for way in (0.0, -reach, reach)))

    def times(self, factor: float) -> Estimate:
        return Estimate(self.value * factor, self.low * factor, self.high * factor)

    @property
    def known(self) -> bool:
        """Whether the interval says something of the number."""
        return self.high < FOUND_FACTOR * self.value

    def __str__(self) -> str:
        return f"{self.value:.3g} ({self.low:.3g} to {self.high:.3g})"


@dataclass(frozen=True)
class SpeckleFact:
    """What even ground says of the declared speckle.

    `kind`: "declared" where it agrees. `looks`, by image, and `texture` are what was found; empty, or None, where the
    declared values stand. `common`: whether one factor on the declared looks serves all images. `rivals`: other
    explanations that the images do not decide against. `measured`: by image, the looks of a gamma law of the scatter.
    """

    kind: Kind
    words: str
    looks: dict[str, Estimate] = field(default_factory=dict)
    texture: Estimate | None = None
    common: bool = True
    rivals: list[str] = field(default_factory=list)
    measured: dict[str, float] = field(default_factory=dict)

    @property
    def departs(self) -> bool:
        """Whether speckle is not as declared."""
        return self.kind not in ("declared", "not told")

    @property
    def names(self) -> list[str]:
        """What was found, by name: `looks`, `texture`, both, or nothing."""
        return [name for name in ("looks", "texture") if name in self.kind]

    @property
    def known(self) -> bool:
        """Whether every number that was found has an interval that says something of it."""
        numbers = [*self.looks.values(), *([] if self.texture is None else [self.texture])]
        return all(one.known for one in numbers)

    @property
    def beside_structure(self) -> SpeckleFact:
        """The fact where structure is left: that scatters, too, so looks and texture cannot be told from it."""
        if not self.names:
            return self
        words = f"{self.words}; structure that is left may make it seem so"
        return SpeckleFact("not told", words, measured=self.measured)


def speckle_fact(images: Sequence[Scatter]) -> SpeckleFact:
    """Which law even ground has: the declared one, other looks, texture, both, or none of these."""
    grounded = [one for one in images if one.ground is not None]
    measured = {one.name: one.ground.looks for one in grounded if one.ground is not None}
    if not grounded:
        return SpeckleFact("not told", "too little even ground to tell how speckle is distributed")
    data = _Data.of(grounded)
    if not data.departs():
        words = "speckle on even ground is distributed as declared"
        if data.estimated.all():
            words = "speckle on even ground is distributed as gamma speckle; its looks were estimated from it"
        return SpeckleFact("declared", words, measured=measured)
    fits = {name: _fit(data, *of(data)) for name, of in _EXPLANATIONS.items()}
    ranked = sorted(fits, key=lambda name: fits[name].price)
    best = ranked[0]
    if fits[best].chi2 > POOR * max(2 * len(grounded) - fits[best].x.size, 1):
        return SpeckleFact("none of them", _unlike(data), measured=measured)
    simple = [name for name in ranked[1:] if fits[name].x.size <= fits[best].x.size]
    rivals = [name for name in simple if fits[name].chi2 < fits[best].chi2 + CLOSE]
    if best == "saturation":
        words = f"{_unlike(data)}: as if the measured power were compressed (saturation)"
        return SpeckleFact("none of them", words, rivals=rivals, measured=measured)
    if "texture" in best and data.clumped():
        words = (
            "beside speckle the power varies in clumps of several pixels, and not from pixel to pixel as texture does"
        )
        return SpeckleFact("none of them", words, measured=measured)
    found = _found(data, best, fits[best], rivals, measured)
    if found.known:
        return found
    words = f"{_unlike(data)}: the cumulants do not tell how much of it is looks, and how much texture"
    if data.estimated.any():
        words += "; nor whether pixels are means of correlated samples, as looks were estimated from the images"
        return SpeckleFact("not told", words, measured=measured)
    return SpeckleFact("none of them", words, measured=measured)


@dataclass(frozen=True)
class _Data:
    """Arrays over images, shape (n,): declared or estimated `looks`, `texture`; `cumulants` (n, 2) and `errors`
    (n, 2, 2), their covariances."""

    images: Sequence[Scatter]
    looks: np.ndarray
    texture: np.ndarray
    estimated: np.ndarray
    cumulants: np.ndarray
    errors: np.ndarray

    @classmethod
    def of(cls, images: Sequence[Scatter]) -> _Data:
        grounds = [one.ground for one in images if one.ground is not None]
        cumulants = np.array([[g.second, g.third] for g in grounds])
        texture = np.array([one.texture for one in images])
        estimated = np.array([one.looks is None for one in images])
        looks = np.array(
            [
                looks_of_second(max(c[0] - _of_texture(1, t), 1e-9)) if one.looks is None else one.looks
                for one, c, t in zip(images, cumulants, texture, strict=True)
            ],
            float,
        )
        return cls(images, looks, texture, estimated, cumulants, np.array([g.covariance for g in grounds]))

    def expected(self, looks: np.ndarray, texture: np.ndarray) -> np.ndarray:
        """Cumulants, shape (n, 2)."""
        pairs = zip(looks, texture, strict=True)
        return np.array([[polygamma(k, one) + _of_texture(k, other) for k in (1, 2)] for one, other in pairs])

    def departs(self) -> bool:
        """Whether any image, or all together, scatter otherwise than declared by more than matters."""
        declared = self.expected(self.looks, self.texture)
        ratio = self.cumulants / declared
        errors = np.sqrt(np.array([np.diag(one) for one in self.errors])) / np.abs(declared)
        if self.estimated.any():  # their own second cumulant says nothing
            ratio[self.estimated, 0] = 1.0
        weights = 1.0 / errors**2
        mean = (weights * ratio).sum(axis=0) / weights.sum(axis=0)
        single = _apart(ratio, np.hypot(errors, FLOOR), SURE + 0.5)
        error = np.hypot(1.0 / np.sqrt(weights.sum(axis=0)), FLOOR / 2.0)
        return bool(single.any() or _apart(mean, error, SURE).any() or self._textured(mean[0] - 1.0, error[0]))

    def clumped(self) -> bool:
        """Whether what scatters is for sure shared by pixels that share no speckle."""
        shared = np.array([one.ground.shared for one in self.images if one.ground is not None])
        weights = 1.0 / shared[:, 1] ** 2
        if not weights.any():
            return False
        mean, error = float(weights @ shared[:, 0] / weights.sum()), float(1.0 / np.sqrt(weights.sum()))
        return mean - SURE * error > CLUMPED

    def _textured(self, more: float, error: float) -> bool:
        """Whether what the second cumulant is more than declared, as a share of it, is for sure a texture whose power
        varies by more than matters. At one look that is less than looks must be off to matter."""
        least = polygamma(1, 1.0 / MATTERS) / polygamma(1, float(np.median(self.looks)))
        return bool(not self.estimated.any() and more - SURE * error > least)


def _apart(ratio: np.ndarray, error: np.ndarray, sure: float) -> np.ndarray:
    """Whether ratios of both cumulants to the declared ones, shape (..., 2), are off 1 by more than matters, for sure.

    In logarithms where the ratio is well known: a half is as far off as twice as much.
    """
    known = ratio > 5.0 * error
    log = np.abs(np.log(np.where(known, ratio, 1.0))) - sure * error / np.where(known, ratio, 1.0)
    away = np.where(known, log, np.abs(ratio - 1.0) - sure * error)
    return np.asarray(away > np.array([MATTERS, SKEWED]))


def _of_texture(order: int, shape: float) -> float:
    return 0.0 if math.isinf(shape) else float(polygamma(order, shape))


Model = Callable[[np.ndarray], np.ndarray]
"""Logarithms of what is free -> expected cumulants, shape (n, 2)."""


def _looks(data: _Data) -> tuple[Model, np.ndarray]:
    return lambda x: data.expected(data.looks * np.exp(x[0]), data.texture), np.zeros(1)


def _looks_per_view(data: _Data) -> tuple[Model, np.ndarray]:
    return lambda x: data.expected(data.looks * np.exp(x), data.texture), np.zeros(data.looks.size)


def _texture(data: _Data) -> tuple[Model, np.ndarray]:
    free = np.flatnonzero(data.estimated)

    def model(x: np.ndarray) -> np.ndarray:
        looks = data.looks.copy()
        looks[free] *= np.exp(x[1:])
        return data.expected(looks, np.full(looks.size, np.exp(x[0])))

    return model, np.concatenate([[_first_texture(data)], np.full(free.size, 0.5)])


def _both(data: _Data) -> tuple[Model, np.ndarray]:
    def model(x: np.ndarray) -> np.ndarray:
        return data.expected(data.looks * np.exp(x[0]), np.full(data.looks.size, np.exp(x[1])))

    return model, np.array([0.5, _first_texture(data)])


def _saturation(data: _Data) -> tuple[Model, np.ndarray]:
    """A power law of exponent g makes g^2 and g^3 of the cumulants. Compression has g under 1: -ln g is x^2, and no x
    stands for the reverse."""
    declared = data.expected(data.looks, data.texture)
    return lambda x: declared * np.exp(np.outer(np.ones(len(declared)), [-2.0, -3.0]) * x[0] ** 2), np.full(1, -0.2)


_EXPLANATIONS: dict[str, Callable[[_Data], tuple[Model, np.ndarray]]] = {
    "looks": _looks,
    "texture": _texture,
    "saturation": _saturation,
    "looks and texture": _both,
    "looks of each view": _looks_per_view,
}


def _first_texture(data: _Data) -> float:
    """The logarithm of the shape that explains what is too much of the second cumulant, on average."""
    more = np.mean(data.cumulants[:, 0] - polygamma(1, data.looks))
    return math.log(looks_of_second(max(float(more), 1e-3)))


@dataclass(frozen=True)
class _Fit:
    x: np.ndarray
    errors: np.ndarray
    chi2: float

    @property
    def price(self) -> float:
        return self.chi2 + PRICE * self.x.size


def _fit(data: _Data, model: Model, start: np.ndarray) -> _Fit:
    """Generalised least squares in the cumulants. The floor of their errors decides which explanation is chosen, and is
    no part of the standard errors."""
    floors = np.array([np.diag((FLOOR * one) ** 2) for one in data.cumulants])

    def whitened(errors: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        roots = np.linalg.inv(np.linalg.cholesky(errors))
        return lambda x: np.einsum("nij,nj->ni", roots, data.cumulants - model(x)).ravel()

    found = least_squares(whitened(data.errors + floors), start, bounds=(-12.0, 12.0), x_scale=0.1)
    own = least_squares(whitened(data.errors), found.x, bounds=(-12.0, 12.0), x_scale=0.1)
    slopes = np.asarray(own.jac)
    covariance = np.linalg.pinv(slopes.T @ slopes, hermitian=True)
    return _Fit(own.x, np.sqrt(np.diag(covariance)), 2.0 * float(found.cost))


def _found(data: _Data, best: str, fit: _Fit, rivals: list[str], measured: dict[str, float]) -> SpeckleFact:
    """The fact in words and numbers."""
    names = [one.name for one in data.images]
    beside = f"; {' or '.join(rivals)} would explain it as well" if rivals else ""
    if best in ("looks", "looks of each view"):
        common = best == "looks"
        steps = np.broadcast_to(fit.x, data.looks.shape), np.broadcast_to(fit.errors, data.looks.shape)
        looks = {
            name: Estimate.of_log(x, error).times(own)
            for name, own, x, error in zip(names, data.looks, *steps, strict=True)
        }
        pairs = zip(names, data.looks, strict=True)
        shown = dict.fromkeys(f"{looks[name]} looks where {own:.3g} are declared" for name, own in pairs)
        words = f"speckle has {', '.join(list(shown)[:4])}{beside}"
        return SpeckleFact("looks", words, looks, None, common, rivals, measured)
    which = 0 if best == "texture" else 1
    texture = Estimate.of_log(float(fit.x[which]), float(fit.errors[which]))
    if best == "texture":
        words = f"the power varies from pixel to pixel beside speckle: texture of shape {texture}{beside}"
        return SpeckleFact("texture", words, {}, texture, True, rivals, measured)
    factor = Estimate.of_log(float(fit.x[0]), float(fit.errors[0]))
    looks = {name: factor.times(own) for name, own in zip(names, data.looks, strict=True)}
    first = next(iter(looks.values()))
    words = f"speckle has {first} looks, and the power texture of shape {texture}"
    if np.allclose(data.looks, data.looks[0]):
        words += "; or the two the other way round: intensity is symmetric in looks and shape"
    return SpeckleFact("looks and texture", words + beside, looks, texture, True, rivals, measured)


def _unlike(data: _Data) -> str:
    declared = data.expected(data.looks, data.texture)
    second, third = np.median(data.cumulants / declared, axis=0)
    return (
        f"speckle on even ground is neither as declared nor of other looks or texture: the second and third cumulant "
        f"of its logarithm are {second:.2f} and {third:.2f} times the declared"
    )
