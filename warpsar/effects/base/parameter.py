"""What scene.toml may say of an effect: continuous parameters and discrete settings."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class Parameter:
    """A continuous parameter of an effect, as it stands in scene.toml.

    At `neutral` the effect is not there; NaN: the parameter means nothing while the others are at neutral (an
    offset, an albedo), and is `start` where nothing is stated. `low` and `high` are what is allowed, `unit` is for
    people. `per_view` parameters are tables of view name -> value; with `zero_sum` only their differences from the
    mean over the scene's views act.

    A fit moves x = ln(value / `span`) for `scale` "log", value / `span` for "linear" (`span`: what is a large step
    for it), between the values `fit_bounds`.
    """

    name: str
    unit: str
    neutral: float
    low: float
    high: float
    start: float
    per_view: bool = False
    zero_sum: bool = False
    scale: Literal["linear", "log"] = "linear"
    span: float = 1.0
    fit_low: float | None = None
    fit_high: float | None = None

    @property
    def default(self) -> float:
        """The value where scene.toml says nothing."""
        return self.start if math.isnan(self.neutral) else self.neutral

    @property
    def fit_bounds(self) -> tuple[float, float]:
        """Smallest and largest value of a fit."""
        return (
            self.low if self.fit_low is None else self.fit_low,
            self.high if self.fit_high is None else self.fit_high,
        )

    def to_coordinate(self, value: Any) -> Any:
        """x of a value; a value outside `fit_bounds` counts as the nearest one inside."""
        inside = np.clip(np.asarray(value, float), *self.fit_bounds) / self.span
        return np.log(inside) if self.scale == "log" else inside

    def from_coordinate(self, x: Any) -> Any:
        return self.span * (np.exp(x) if self.scale == "log" else np.asarray(x, float))

    def slope(self, x: Any) -> Any:
        """d value / dx at x."""
        return self.from_coordinate(x) if self.scale == "log" else np.full(np.shape(x), self.span)


@dataclass(frozen=True)
class Setting:
    """A discrete choice of an effect: never differentiated, never learned.

    `accepts` says whether a value may stand in scene.toml, `allowed` says it to people. `per_view` settings are
    tables of view name -> value.
    """

    name: str
    default: Any
    accepts: Callable[[Any], bool]
    allowed: str
    per_view: bool = False


def one_of(name: str, default: Any, *choices: Any) -> Setting:
    """A setting with a few possible values."""
    return Setting(
        name,
        default,
        lambda value: any(type(value) is type(choice) and value == choice for choice in choices),
        " or ".join(repr(choice) for choice in choices),
    )
