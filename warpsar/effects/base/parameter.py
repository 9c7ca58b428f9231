"""What scene.toml may say about an effect: continuous parameters and discrete settings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from warpsar.world.transform import Transform


@dataclass(frozen=True)
class EffectParameter:
    """A continuous parameter of an effect, as it stands in scene.toml.

    `neutral`: the value at which the effect is not there. NaN says that the parameter means nothing while the others
    are neutral (an offset, an albedo); it is then `start` where scene.toml says nothing. `unstated`: the value where
    the effect's table stands without it, for a parameter whose natural value is known (all of the bounces' power);
    None leaves it neutral. `low` and `high`: the smallest and largest value allowed. `unit` and `description`, a
    sentence, are for people. `per_view`: a table of view name -> value. `zero_sum`: only differences from the mean over
    the scene's views act. `per_material`: a table of material name -> value; it has a value for each of the mesh's
    materials, and stands last among the parameters. `grows_by`: the power of its distance from neutral by which the
    effect grows: 2 for a width, whose blur grows by the square.

    A fit moves the coordinate x = ln(value / `span`) where `scale` is "log", and value / `span` where it is "linear".
    `span` is a large step of the value. The fit stays inside `fit_low` and `fit_high` (default: `low` and `high`).
    """

    name: str
    unit: str
    neutral: float
    low: float
    high: float
    start: float
    _: KW_ONLY
    description: str
    per_view: bool = False
    zero_sum: bool = False
    per_material: bool = False
    unstated: float | None = None
    grows_by: float = 1.0
    scale: Literal["linear", "log"] = "linear"
    span: float = 1.0
    fit_low: float | None = None
    fit_high: float | None = None

    @property
    def keyed_by(self) -> str | None:
        """What a table of its values names: "view" or "material"; None where it is one number."""
        return "view" if self.per_view else "material" if self.per_material else None

    @property
    def default(self) -> float:
        """The value where the effect's table stands and does not state it."""
        if self.unstated is not None:
            return self.unstated
        return self.start if math.isnan(self.neutral) else self.neutral

    @property
    def brings_it(self) -> bool:
        """Whether a value of it can bring the effect by itself; others only shape one that is there."""
        return not math.isnan(self.neutral) and not self.per_material

    @property
    def fit_bounds(self) -> tuple[float, float]:
        """Smallest and largest value of a fit."""
        return (
            self.low if self.fit_low is None else self.fit_low,
            self.high if self.fit_high is None else self.fit_high,
        )

    @property
    def transform(self) -> Transform:
        """The coordinate that a fit moves."""
        return Transform(self.scale, self.span)

    def to_coordinate(self, value: ArrayLike) -> Any:
        """x of a value, of its shape; a value outside `fit_bounds` counts as the nearest one inside."""
        return self.transform.to_coordinate(np.clip(np.asarray(value, float), *self.fit_bounds))

    def from_coordinate(self, x: ArrayLike) -> Any:
        """The value at x, of its shape."""
        return self.transform.from_coordinate(x)

    def slope(self, x: ArrayLike) -> Any:
        """d value / dx at x, of its shape."""
        return self.transform.slope(x)


def amount(
    name: str, unit: str, high: float, start: float, fit: tuple[float, float], description: str, **more: Any
) -> EffectParameter:
    """Of what there is none at 0, the neutral value: a fit moves its logarithm between the two values of `fit`."""
    low, top = fit
    return EffectParameter(
        name, unit, 0.0, 0.0, high, start, description=description, scale="log", fit_low=low, fit_high=top, **more
    )


@dataclass(frozen=True)
class Column:
    """One number of each row of a setting that is a table. `low` and `high`: the smallest and largest allowed."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Setting:
    """A discrete choice of an effect: never differentiated, never learned.

    `accepts` says whether a value may stand in scene.toml. `allowed` says the same in words, and `schema` as the JSON
    schema of a value. `description`, a sentence, says what it means. `per_view`: a table of view name -> value.
    `columns`: those of a value that is a list of rows, whose numbers are parameters of the scene.
    """

    name: str
    default: Any
    accepts: Callable[[Any], bool]
    allowed: str
    _: KW_ONLY
    description: str
    schema: Mapping[str, Any] = field(compare=False)
    per_view: bool = False
    columns: tuple[Column, ...] = ()

    def column(self, name: str) -> int:
        """The place in a row of the number called so."""
        return [one.name for one in self.columns].index(name)


def one_of(name: str, default: Any, *choices: Any, description: str) -> Setting:
    """A setting with a few possible values."""
    return Setting(
        name,
        default,
        lambda value: any(type(value) is type(choice) and value == choice for choice in choices),
        " or ".join(repr(choice) for choice in choices),
        description=description,
        schema={"enum": list(choices)},
    )
