"""What an effect is: what it changes, where on the way from hits to image, and with which parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from warpsar.effects.base.parameter import Parameter, Setting
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.trial import Context, Trial
from warpsar.errors import InputError
from warpsar.world.frame import ViewGeometry
from warpsar.world.tables import Grid
from warpsar.world.world import World

StageName = Literal["surface", "gain", "position", "path", "image"]
STAGES: tuple[StageName, ...] = get_args(StageName)
"""In the order in which they act."""


class Effect:
    """One physical effect, in one file. Subclasses override the hook of their stage.

    A hook records launches on the render's program and returns the array that takes the place of the one it was
    given; it never changes that one. `p` is the device array of the effect's continuous parameters for this view,
    in the order of `parameters`, float32, with its own gradient. At neutral values the image is the one without
    the effect to float32 rounding, and every gradient is finite.
    """

    name: ClassVar[str]
    stage: ClassVar[StageName]
    order: ClassVar[int]  # among the effects of its stage: smaller ones act first
    summary: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    settings: ClassVar[tuple[Setting, ...]] = ()
    additive: ClassVar[bool] = False  # puts power where the scene has none: judged on the dark pixels too
    is_floor: ClassVar[bool] = False  # adds the same positive power to every pixel: none may measure exactly 0
    in_image: ClassVar[bool] = False  # acts at places of the image, whatever surface lies there
    bins_per_pixel: ClassVar[int] = 1  # how much finer than the image, per axis, the hits are binned for it

    def margin_m(self, grid: Grid, values: np.ndarray) -> float:
        """How far beyond the image, on each side, hits are binned for it; `values` in the order of `parameters`."""
        return 0.0

    def shift_m(self, values: np.ndarray, geometry: ViewGeometry) -> np.ndarray:
        """Range and azimuth [m], shape (2,), by which it moves the image of a view; `values` in the order of
        `parameters`."""
        return np.zeros(2)

    def trials(self, context: Context) -> list[Trial]:
        """How a score test looks for the effect; empty where this scene has no place for it."""
        raise NotImplementedError

    def refinements(
        self, scene: World, table: Mapping[str, Any], others: Sequence[Mapping[str, Any]]
    ) -> list[tuple[Mapping[str, Any], int]]:
        """Tables to be tried in the place of a fitted one, which no derivative leads to: other settings near its own,
        or more of the same; and how much each has that was chosen freely, more than the fitted one. `others` are
        tables whose trials scored too, best first."""
        return []

    def check(self, scene: World, table: Mapping[str, Any]) -> str | None:
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

    def coordinates(self, render: Recorder, p: Any, zeta: Any, points: Any) -> Any:
        """Surface effects on the learned coordinates (vec4, kernels/shade.py) at `points` (vec3 [m], about the
        reference point); arrays of one shape."""
        return zeta

    def scattering(self, render: Recorder, p: Any, zeta: Any, sigma: Any, polarization: int) -> Any:
        """Surface effects on sigma0 of the hits, shape (hits,)."""
        return sigma

    def gain(self, render: Recorder, p: Any, sigma: Any, points: Any) -> Any:
        """Gains on the power `sigma` that seems to come from `points` (vec3 [m], about the reference point).

        Of a hit that is where it lies; of a longer path the point on one bounce with its range, azimuth and mean
        elevation.
        """
        return sigma

    def deposit(self, render: Recorder, p: Any, sigma: Any, weight: Any, bins: Any, image: Any) -> None:
        """Position effects: add sigma * weight of each bin of `render.hits.grid` into `image`, shape (rows * cols,)."""
        raise NotImplementedError

    def paths(self, render: Recorder, p: Any, image: Any, polarization: int) -> Any:
        """Further ways from radar to scene and back: a new array, `image` plus their beta0 (see `render.collect`)."""
        return image

    def image(self, render: Recorder, p: Any, image: Any) -> Any:
        """What the system does to the image."""
        return image


@dataclass
class DeclaredEffect:
    """An effect with the values it has in one view: `values` in the order of `effect.parameters`."""

    effect: Effect
    values: np.ndarray
    settings: Mapping[str, Any] = field(default_factory=dict)
