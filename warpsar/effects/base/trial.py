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
    """A finite step from neutral along one score coordinate (docs/diagnosis-method.md, "Templates").

    `plus` and `minus` are tables of the effect as they would stand in scene.toml. A score test divides the difference
    of their images: (image(`plus`) - image(`minus`)) / (2 `size`). Where `minus` is None it takes
    (image(`plus`) - image at neutral) / `size`. `one_sided`: the coordinate is a level or a variance and cannot be
    negative. `views`: the views whose image changes; None for all. `rows`: from the first to before the last row that
    the step is of; None for all. What `plus` changes elsewhere is left out, so that steps of many rows share one image.
    """

    coordinate: str
    size: float
    plus: Mapping[str, Any]
    minus: Mapping[str, Any] | None = None
    one_sided: bool = False
    views: tuple[str, ...] | None = None
    rows: tuple[int, int] | None = None


@dataclass(frozen=True)
class Trial:
    """Steps that are tested together: their number is the degrees of freedom.

    A parameter that means nothing at neutral has one value here. The score of an effect is the largest over its
    trials. `starts` are the tables where fits begin if the trial wins, with settings and the parameters to learn.
    `survey` names linear parameters that may lie far from there, with the first step of a search for each.
    """

    steps: tuple[ScoreStep, ...]
    starts: tuple[Mapping[str, Any], ...]
    label: str = ""
    survey: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Context:
    """What an effect chooses its steps by: the scene, and `level`, the declared model's median beta0 of lit pixels."""

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
