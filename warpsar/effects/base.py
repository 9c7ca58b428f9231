"""What an effect is: what it changes, where on the way from hits to image, and with which parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from warpsar.errors import InputError

if TYPE_CHECKING:
    from warpsar.render import ViewRender
    from warpsar.scene import Grid, Scene

Stage = Literal["surface", "gain", "position", "path", "image"]


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


@dataclass(frozen=True)
class Step:
    """A finite step from neutral along one score coordinate: what a score test differences (effects.md, step 4).

    The template is (image(`plus`) - image(`minus`)) / (2 `size`), or (image(`plus`) - image at neutral) / `size`
    where `minus` is None; `plus` and `minus` are the effect's tables as they would stand in scene.toml.
    `one_sided`: the coordinate is a level or a variance and cannot be negative. `views`: where the image changes at
    all; None for everywhere.
    """

    coordinate: str
    size: float
    plus: Mapping[str, Any]
    minus: Mapping[str, Any] | None = None
    one_sided: bool = False
    views: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Trial:
    """Steps that are tested together (their number is the degrees of freedom), at one choice of whatever is
    undefined at neutral; over the trials of an effect the score is maximised.

    `starts` are tables with the parameters to be learned, and settings: where fits begin if the trial wins. `survey`
    names parameters (linear ones) that the data may place far from there, with the first step of a search for it.
    """

    steps: tuple[Step, ...]
    starts: tuple[Mapping[str, Any], ...]
    label: str = ""
    survey: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Context:
    """What steps are chosen by: the scene, and the median beta0 of the declared model's lit pixels."""

    scene: Scene
    level: float
    extent_m: float = field(init=False)
    """Half the largest distance across the image or the mesh, whichever is smaller."""

    def __post_init__(self) -> None:
        grid = self.scene.grid
        image = math.hypot(*(n * step for n, step in zip(grid.shape, grid.spacing_m, strict=True)))
        corners = np.asarray(self.scene.mesh.vertices, float)
        mesh = float(np.linalg.norm(np.ptp(corners, axis=0)))
        object.__setattr__(self, "extent_m", min(image, mesh) / 2)


class Effect:
    """One physical effect, in one file. Subclasses override the hook of their stage.

    A hook records launches on the render's program and returns the array that takes the place of the one it was
    given; it never changes that one. `p` is the device array of the effect's continuous parameters for this view,
    in the order of `parameters`, float32, with its own gradient. At neutral values the image is the one without
    the effect to float32 rounding, and every gradient is finite.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    summary: ClassVar[str]
    example: ClassVar[dict[str, Any]]
    """Its table, strong enough to be seen in a picture of the example scene; values per view are for `v0` and `v1`."""
    rate_case: ClassVar[dict[str, Any]]
    """Its table where `diagnose` is counted (benchmarks/diagnosis_rates.py); values per view are for `v0` to `v3`."""
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    settings: ClassVar[tuple[Setting, ...]] = ()
    additive: ClassVar[bool] = False  # puts power where the scene has none: judged on the dark pixels too
    in_image: ClassVar[bool] = False  # acts at places of the image, whatever surface lies there
    bins_per_pixel: ClassVar[int] = 1  # how much finer than the image, per axis, the hits are binned for it

    def margin_m(self, grid: Grid, values: np.ndarray) -> float:
        """How far beyond the image, on each side, hits are binned for it; `values` in the order of `parameters`."""
        return 0.0

    def trials(self, context: Context) -> list[Trial]:
        """How a score test looks for the effect; empty where this scene has no place for it."""
        raise NotImplementedError

    def refinements(
        self, scene: Scene, table: Mapping[str, Any], others: Sequence[Mapping[str, Any]]
    ) -> list[tuple[Mapping[str, Any], int]]:
        """Tables to be tried in the place of a fitted one, which no derivative leads to: other settings near its own,
        or more of the same; and how much each has that was chosen freely, more than the fitted one. `others` are
        tables whose trials scored too, best first."""
        return []

    def check(self, scene: Scene, table: Mapping[str, Any]) -> str | None:
        """What is wrong with a table, sound by itself, in this scene; None if nothing."""
        return None

    def parameter(self, name: str) -> Parameter:
        """The continuous parameter `name`. Raises InputError for a setting: it has no derivative to learn by."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        known = ", ".join(p.name for p in self.parameters)
        discrete = any(s.name == name for s in self.settings)
        what = "is discrete and cannot be learned" if discrete else "is no parameter"
        raise InputError(f"effects.{self.name}.{name}: {what}; allowed are {known}")

    def coordinates(self, render: ViewRender, p: Any, zeta: Any, points: Any) -> Any:
        """Surface effects on the learned coordinates (vec4, kernels/shade.py) at `points` (vec3 [m], about the
        reference point); arrays of one shape."""
        return zeta

    def scattering(self, render: ViewRender, p: Any, zeta: Any, sigma: Any, polarization: int) -> Any:
        """Surface effects on sigma0 of the hits, shape (hits,)."""
        return sigma

    def gain(self, render: ViewRender, p: Any, sigma: Any, points: Any) -> Any:
        """Gains on the power `sigma` that seems to come from `points` (vec3 [m], about the reference point).

        Of a hit that is where it lies; of a longer path the point on one bounce with its range, azimuth and mean
        elevation.
        """
        return sigma

    def deposit(self, render: ViewRender, p: Any, sigma: Any, weight: Any, bins: Any, image: Any) -> None:
        """Position effects: add sigma * weight of each bin of `render.hits.grid` into `image`, shape (rows * cols,)."""
        raise NotImplementedError

    def paths(self, render: ViewRender, p: Any, image: Any, polarization: int) -> Any:
        """Further ways from radar to scene and back: a new array, `image` plus their beta0 (see `render.collect`)."""
        return image

    def image(self, render: ViewRender, p: Any, image: Any) -> Any:
        """What the system does to the image."""
        return image
