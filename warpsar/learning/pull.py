"""Where the images pull against what the scene knows to a tolerance (docs/learn.md, "Known to a tolerance")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Protocol

import numpy as np

from warpsar.learning.identify import RANK_TOLERANCE, Identified, pseudo_inverse
from warpsar.learning.prior import Known, Prior

ALARM = 3.0  # standard deviations beyond which a value leaves its tolerance: 0.3 % of the values that keep it do


@dataclass(frozen=True)
class Pull:
    """One known value before and after a fit, in its key's `unit`.

    `prior` +- `prior_sd` is what the scene knows, `posterior` +- `posterior_sd` what the fit found with it. `pull` is
    (posterior - prior) / prior_sd. `data` +- `data_sd` is what the images, with all other tolerances, say alone, to
    first order. `tension` is (data - prior) / sqrt(data_sd^2 + prior_sd^2): of standard normal distribution where model
    and tolerance are right. All three are None where the images do not tell them, and for a value whose error others
    share; `posterior_sd` is None for a scene
    with fields.
    """

    label: str
    unit: str
    prior: float
    prior_sd: float
    posterior: float
    posterior_sd: float | None
    pull: float
    data: float | None = None
    data_sd: float | None = None
    tension: float | None = None

    @property
    def alarm(self) -> bool:
        """Whether the value wants to leave its tolerance by more than three standard deviations."""
        return max(abs(self.pull), abs(self.tension or 0.0)) > ALARM

    @property
    def words(self) -> str:
        """One sentence."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        found = f"{self.posterior:.4g}" + ("" if self.posterior_sd is None else f" +- {self.posterior_sd:.2g}")
        alone = "" if self.data is None else f"; the images alone say {self.data:.4g} +- {self.data_sd:.2g}{unit}"
        tension = "" if self.tension is None else f", {self.tension:+.1f} standard deviations from it"
        verb = "leaves its tolerance" if self.alarm else "keeps its tolerance"
        return (
            f"{self.label} {verb}: known as {self.prior:.4g} +- {self.prior_sd:.2g}{unit}, found {found} "
            f"(pull {self.pull:+.1f}){alone}{tension}"
        )

    def content(self) -> dict[str, Any]:
        """For the JSON files."""
        return {key: value for key, value in asdict(self).items() if key != "label"} | {
            "alarm": self.alarm,
            "words": self.words,
        }


class FitNumbers(Protocol):
    """What a fit says of its x: `bounds`, low and high, and what is known without data (`identify.of_information`)."""

    prior: Prior

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]: ...

    @property
    def zero_sum_means(self) -> np.ndarray: ...


def pulls(problem: FitNumbers, x: np.ndarray, identified: Identified | None) -> list[Pull]:
    """Every known value of a fit that has arrived at x; `identified` as `identify` gives it, None for fields."""
    inverse = None if identified is None else pseudo_inverse(identified.information, problem.zero_sum_means)[0]
    return [_pull(problem, np.asarray(x), identified, inverse, one) for one in problem.prior.known]


def leaving(found: Sequence[Pull]) -> list[str]:
    """The labels of those that want to leave their tolerance."""
    return [one.label for one in found if one.alarm]


def _pull(
    problem: FitNumbers, x: np.ndarray, identified: Identified | None, inverse: np.ndarray | None, one: Known
) -> Pull:
    posterior, deviation = float(one.value(x[one.at])), one.deviation(x)
    found = Pull(one.label, one.unit, one.about, one.sd, posterior, None, deviation)
    if identified is None or inverse is None:
        return found
    if one.shared is not None:  # what the images say alone is not to be parted from what its survey says of it
        return replace(found, posterior_sd=abs(float(one.slope(x[one.at]))) * float(identified.sd[one.at]))
    slope = abs(float(one.slope(x[one.at])))
    found = replace(found, posterior_sd=slope * float(identified.sd[one.at]))
    bend, sd = (slope * value for value in _without_own(identified, inverse, one.at, (slope / one.sd) ** 2))
    if not np.isfinite(sd):
        return found
    # where the images' loss is lowest: their gradient is against that of the value's own prior
    data = posterior + bend**2 * deviation / one.sd
    tension = (data - one.about) / float(np.hypot(sd, one.sd))
    low, high = (float(one.value(end[one.at])) for end in problem.bounds)
    return replace(found, data=float(np.clip(data, low, high)), data_sd=sd, tension=tension)


def _without_own(identified: Identified, inverse: np.ndarray, at: int, own: float) -> tuple[float, float]:
    """Two deviations of element `at` of x without its `own` information: by the curvature alone, and by its residuals.

    Both are infinite where the images do not see it. With c the column of F^-1 at the element and f its value there,
    the column without `own` is c / (1 - own f) (Sherman and Morrison 1950).
    """
    column, products = inverse[:, at], identified.products
    left = 1.0 / column[at] - own if column[at] > 0 else 0.0
    if left <= RANK_TOLERANCE * (identified.information[at, at] - own):
        return np.inf, np.inf
    column = column / (left * column[at])
    variance = float(column @ products @ column) - own * float(column[at]) ** 2
    return float(np.sqrt(1.0 / left)), float(np.sqrt(max(variance, 0.0)))
