"""What the data tell about a few parameters: Fisher information, intervals, and sentences (docs/learn-method.md)."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from warpsar.compare.observation import Observation
from warpsar.effects import registry as effects
from warpsar.learning.problem import FitProblem
from warpsar.models import registry
from warpsar.models.base.parameters import OF_SURFACES
from warpsar.speckle.covariance import correlated
from warpsar.speckle.likelihood import residual_sd
from warpsar.speckle.residual import residual_autocovariance

# A log coordinate known to worse than this (a factor e either way within two standard deviations) is not determined.
UNDETERMINED_SD = 0.5
# A pair's product or ratio is named where it is at least this much better known than both of its members.
BETTER = 3.0
Z_95 = 1.96  # standard deviations to either side, within which a normal variable lies with 95 %
# Eigenvalues below this share of the largest, in a matrix scaled to a unit diagonal, are zero to float32 images.
RANK_TOLERANCE = 1e-9


@dataclass
class Identified:
    """Fisher information of x at a solution, and what follows.

    `information` F and `covariance` have shape (p, p), in the coordinates of x. `covariance` is the sandwich
    F^-1 S F^-1; S, `products`, comes from the residuals' own autocovariance, so correlated speckle counts. The variance
    of an element is infinite where it has a part in a direction that the data do not see. `eigenvalues` of the
    information ascend; `eigenvectors` are in columns. `words` are sentences for people. `ends`, shape (p, 2),
    are 95 % intervals by the profile of the likelihood (`learning.profiles`), where these were asked for; `by_profile`,
    (p,), says which of them are, and which are 1.96 standard deviations to either side.
    """

    labels: list[str]
    information: np.ndarray
    covariance: np.ndarray
    products: np.ndarray
    eigenvalues: np.ndarray
    eigenvectors: np.ndarray
    words: list[str] = field(default_factory=list)
    ends: np.ndarray | None = None
    by_profile: np.ndarray | None = None

    @property
    def sd(self) -> np.ndarray:
        """Standard deviation of every element of x, shape (p,); infinite where the data say nothing."""
        return np.sqrt(np.diag(self.covariance))

    def interval_95(self, at: int, value: float) -> np.ndarray:
        """Both ends, shape (2,), of element `at` of x about its `value`, in its coordinate; infinite where it is open.

        By the profile of the likelihood where that is known (`ends`; both are infinite where every value fits, and one
        is a bound of the fit where nothing on that side is refused), else value +- 1.96 standard deviations.
        """
        if self.ends is not None:
            return np.asarray(self.ends[at])
        return value + np.array([-Z_95, Z_95]) * self.sd[at]

    def tells(self, at: int) -> bool:
        """Whether the interval of an element is worth printing."""
        if self.ends is not None:
            return bool(np.isfinite(self.ends[at]).any())
        return bool(self.sd[at] < 3.0)

    def interval_from(self, at: int) -> str:
        """Where `interval_95` comes from."""
        return "profile" if self.by_profile is not None and self.by_profile[at] else "standard deviation"

    @property
    def undetermined(self) -> list[str]:
        """Those of `words` that tell of a value which the data do not determine alone."""
        lost = self.sd >= UNDETERMINED_SD
        return [
            words
            for words, members in zip(self.words, _groups(self.labels).values(), strict=True)
            if lost[members].any()
        ]

    def summary(self) -> dict[str, Any]:
        return {
            "parameters": self.labels,
            "standard_deviation": self.sd,
            "identifiable": [bool(sd < UNDETERMINED_SD) for sd in self.sd],
            "eigenvalues": self.eigenvalues,
            "eigenvectors": self.eigenvectors.T,
            "words": self.words,
        }


def score_products(scaled: np.ndarray, autocovariance: np.ndarray, seen: Observation) -> np.ndarray:
    """Variance of sum(scaled * standardised residual), shape (p, p), for residuals of the given autocovariance.

    `scaled`, shape (pixels, p), is what a residual of one standard deviation adds to the score.
    """
    products = scaled.T @ correlated(scaled, seen.interior, autocovariance)
    return (products + products.T) / 2.0


def identify(problem: FitProblem, x: np.ndarray, columns: Sequence[int] | None = None) -> Identified:
    """Fisher information and intervals of a handful of parameters at the solution x; the prior counts with the data.

    `columns`: the elements of x that move, and all others are held; by default all move.
    """
    modelled = problem.modelled(x)
    moved = list(range(x.size)) if columns is None else list(columns)
    information, products = information_of(problem, modelled, problem.jacobian(x, columns), len(moved))
    known = problem.prior.information(x, columns)  # as of one more measurement, whose error is its own
    labels = [problem.labels[k] for k in moved]
    return of_information(labels, information + known, products + known, problem.zero_sum_means[:, moved])


def information_of(
    problem: FitProblem, modelled: Sequence[np.ndarray], jacobians: Iterable[np.ndarray], size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Fisher information of the loss and variance of its gradient, (p, p) each, of all views, without any prior.

    `modelled` is beta0 of each observation, `jacobians` d ln(beta0) of it to `size` = p values, (pixels, p).
    """
    curvatures = problem.curvatures(modelled)
    spreads = [residual_sd(problem.loss, seen.looks) for seen in problem.observations]
    autocovariance = residual_autocovariance(
        [(s, c.residual / spread) for s, c, spread in zip(problem.observations, curvatures, spreads, strict=True)],
        over_views=problem.over_views,
    )
    information = np.zeros((size, size))
    products = np.zeros_like(information)
    for seen, j, c, spread in zip(problem.observations, jacobians, curvatures, spreads, strict=True):
        weighted = c.weight[:, None] * j
        information += j.T @ weighted
        products += score_products(spread * weighted, autocovariance, seen)
    return problem.over_views(information), problem.over_views(products)


def of_information(
    labels: list[str], information: np.ndarray, products: np.ndarray, known: np.ndarray | None = None
) -> Identified:
    """Eigenvalues, covariance and words from F and S.

    `known`, shape (n, p): unit vectors along which x is known without data, such as the mean of values that sum to
    zero. The data see nothing there, and rounding alone would decide whether that counts as undetermined.
    """
    values, vectors = np.linalg.eigh(information)
    inverse, unseen = pseudo_inverse(information, known)
    covariance = inverse @ products @ inverse
    reported = covariance.copy()
    np.fill_diagonal(reported, [_sd(row, covariance, unseen) ** 2 for row in np.eye(len(labels))])
    return Identified(labels, information, reported, products, values, vectors, describe(labels, covariance, unseen))


def of_first(whole: Identified, size: int, known: np.ndarray) -> Identified:
    """What `whole` says of the first `size` elements of x, whatever the others are, with its intervals for them.

    The others have an information of their own, such as a prior, and go by Schur's complement: the inverse of what is
    left is their part of the whole inverse. `known` as in `of_information`, shape (n, p).
    """
    first, rest = slice(0, size), slice(size, None)
    f, s = whole.information, whole.products
    along = np.linalg.solve(f[rest, rest], f[rest, first]).T
    left = f[first, first] - along @ f[rest, first]
    products = s[first, first] - along @ s[rest, first] - s[first, rest] @ along.T + along @ s[rest, rest] @ along.T
    found = of_information(whole.labels[first], left, products, known[:, first])
    if whole.ends is not None and whole.by_profile is not None:
        found = replace(found, ends=whole.ends[first], by_profile=whole.by_profile[first])
    return found


def pseudo_inverse(information: np.ndarray, known: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """The inverse of an information (p, p) in the directions that the data see, and unit vectors of the others (n, p).

    `known` as in `of_information`.
    """
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    held = np.zeros((0, len(scale))) if known is None else known
    stated = sum((np.outer(row, row) * (row**2 @ np.diag(information)) for row in held), np.zeros_like(information))
    values, vectors = np.linalg.eigh((information + stated) / np.outer(scale, scale))
    seen = values > RANK_TOLERANCE * values.max(initial=0.0)
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T / np.outer(scale, scale)
    unseen = vectors[:, ~seen].T / scale
    return inverse, unseen / np.linalg.norm(unseen, axis=1, keepdims=True)


def _sd(combination: np.ndarray, covariance: np.ndarray, unseen: np.ndarray) -> float:
    """Standard deviation of a weighted sum of elements of x; infinite where it has a part in an unseen direction."""
    if np.linalg.norm(unseen @ combination) > 1e-3 * np.linalg.norm(combination):
        return float("inf")
    return float(np.sqrt(max(combination @ covariance @ combination, 0.0)))


def _best_known(members: list[int], covariance: np.ndarray, unseen: np.ndarray) -> np.ndarray:
    """The weighted sum of `members` of x that is known best, as exponents of the parameters; the largest is 1."""
    span = np.eye(len(covariance))[:, members]
    if len(unseen):
        _, singular, across = np.linalg.svd(unseen[:, members])
        span = span @ across[np.count_nonzero(singular > 1e-3) :].T
    if not span.shape[1]:
        return np.zeros(len(covariance))
    direction = span @ np.linalg.eigh(span.T @ covariance @ span)[1][:, 0]
    return direction / direction[np.argmax(np.abs(direction))]


def describe(labels: Sequence[str], covariance: np.ndarray, unseen: np.ndarray) -> list[str]:
    """One sentence per material: what is determined, alone or in combination, and how well.

    `covariance` holds in the directions that the data see; `unseen`, shape (n, p), are unit vectors of the others.
    """
    unit = np.eye(len(labels))
    symbols = {one.key: one.symbol for one in (*OF_SURFACES, *registry.own_parameters().values())}
    sentences = []
    for name, members in _groups(labels).items():
        letters = {} if name in effects.names() else symbols  # keys of an effect are its own: `level` of a noise floor
        short = {i: letters.get(labels[i].rsplit(".", 1)[1], labels[i].rsplit(".", 1)[1]) for i in members}
        sd = {i: _sd(unit[i], covariance, unseen) for i in members}
        good = [i for i in members if sd[i] < UNDETERMINED_SD]
        bad = [i for i in members if i not in good]
        combinations = []
        for i, j in itertools.combinations(members, 2):
            for sign, mark in ((1.0, "*"), (-1.0, "/")):
                combined = _sd(unit[i] + sign * unit[j], covariance, unseen)
                if combined < UNDETERMINED_SD and BETTER * combined < min(sd[i], sd[j]) and (i in bad or j in bad):
                    combinations.append((combined, f"{_of(short[i])}{mark}{_of(short[j])}"))
        if len(bad) > 1 and not combinations:
            powers = _best_known(bad, covariance, unseen)
            combined = _sd(powers, covariance, unseen)
            shown = {i: f"{powers[i]:.2f}" for i in bad if abs(powers[i]) >= 0.005}
            if len(shown) > 1 and combined < UNDETERMINED_SD:
                factors = [_of(short[i]) + ("" if power == "1.00" else f"^{power}") for i, power in shown.items()]
                combinations.append((combined, "*".join(factors)))
        known = [f"{_of(short[i])} to {_percent(sd[i])}" for i in good]
        combined_known = [f"{text} to {_percent(value)}" for value, text in sorted(combinations)]
        if not bad:
            sentences.append(f"{name}: {', '.join(known)}")
        elif known or combined_known:
            lost = ", ".join(_of(short[i]) for i in bad)
            sentences.append(
                f"{name}: only {', '.join(known + combined_known)} determined; {lost} alone not identifiable"
            )
        else:
            sentences.append(f"{name}: not identifiable ({', '.join(_of(short[i]) for i in bad)})")
    return sentences


def _groups(labels: Sequence[str]) -> dict[str, list[int]]:
    """Indices of the labels of each material or effect, in their order."""
    groups: dict[str, list[int]] = {}
    for index, label in enumerate(labels):
        groups.setdefault(label.rsplit(".", 1)[0], []).append(index)
    return groups


def _of(symbol: str) -> str:
    return "(eps_r-1)" if symbol == "eps_r" else symbol


def _percent(sd: float) -> str:
    return f"{100.0 * sd:.2g} %"
