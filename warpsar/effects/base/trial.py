"""How a score test looks for an effect: finite steps from the image without it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from warpsar.world.world import World


@dataclass(frozen=True)
class ScoreStep:
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

    steps: tuple[ScoreStep, ...]
    starts: tuple[Mapping[str, Any], ...]
    label: str = ""
    survey: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Context:
    """What steps are chosen by: the scene, and the median beta0 of the declared model's lit pixels."""

    scene: World
    level: float
    extent_m: float = field(init=False)
    """Half the largest distance across the image or the mesh, whichever is smaller."""

    def __post_init__(self) -> None:
        grid = self.scene.grid
        image = math.hypot(*(n * step for n, step in zip(grid.shape, grid.spacing_m, strict=True)))
        corners = np.asarray(self.scene.mesh.vertices, float)
        mesh = float(np.linalg.norm(np.ptp(corners, axis=0)))
        object.__setattr__(self, "extent_m", min(image, mesh) / 2)
