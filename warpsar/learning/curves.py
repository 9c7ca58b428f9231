"""Permittivities learned from measured curves of radar cross-section."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.coherent.left_out import left_out
from warpsar.compare.curve import CurveComparison, compare_curves, content_of
from warpsar.curves.observe import observe
from warpsar.curves.shape import ProfileInterval, likelihood, on_grid, profiles
from warpsar.errors import InputError
from warpsar.parameters.at import at
from warpsar.scene.scene import Scene

PASSES = 2
POINTS = 9
FIRST_REACH = 1.6
"""Factor by which the first grid of a learned value reaches up and down.

Each further one reaches a third of its logarithm.
"""


@dataclass(frozen=True)
class LearnedCurves:
    """A scene whose permittivities were fitted to its curves; its curves before and after."""

    scene: Scene
    found_values: dict[str, ProfileInterval]
    """Under "material.eps_r"."""
    before: list[CurveComparison]
    after: list[CurveComparison]

    def content(self) -> dict[str, Any]:
        """For learn.json."""
        return {
            "not_applied_to_curves": list(left_out(self.scene, "rcs")),
            "materials": {key: one.content() for key, one in self.found_values.items()},
            "fitted_together": len(self.found_values),
            "before": content_of(self.before),
            "after": content_of(self.after),
        }

    @property
    def words(self) -> list[str]:
        """A sentence for each value."""
        return [
            f"{key}: {one.value:.4g}, 95 % interval {one.low:.4g} to {one.high:.4g}"
            + (", which runs into an end of what was tried" if one.open else "")
            for key, one in self.found_values.items()
        ]


def learn_from_curves(scene: Scene, cache: Path, device: str | None = None) -> LearnedCurves:
    """Fit eps_r of every material that names it in `learn` to the train curves, by likelihood on grids that grow finer.

    One value is fitted at a time, twice around. Its interval is that of its profile with the others as found: where
    several trade against each other it is too narrow, and learn.json says how many there are. Raises InputError where
    there is nothing to learn or to learn it from.
    """
    if not any(curve.role == "train" for curve in scene.curves):
        raise InputError(f"{scene.name}: curves: found no train curve; must have one to learn from")
    wanted = [
        one.owner
        for one in scene.parameters.values()
        if one.key == "eps_r" and one.freed and one.layout == "number" and not scene.materials[one.owner].conductor
    ]
    if not wanted:
        raise InputError(
            f"{scene.name}: found nothing to learn from curves; a material must be no conductor and have "
            '"eps_r" in learn'
        )
    train = replace(scene, curves=tuple(curve for curve in scene.curves if curve.role == "train"))
    found_values: dict[str, ProfileInterval] = {}
    now = scene
    for turn in range(PASSES):
        for name in wanted:
            middle = float(now.parameters[f"materials.{name}.eps_r"].value) - 1.0
            reach = np.log(FIRST_REACH) / 3.0**turn
            axes = {"eps_r": 1.0 + middle * np.exp(np.linspace(-reach, reach, POINTS))}

            def twice_log(x: Any, name: str = name, now: Scene = now) -> float:
                one = now.parameters[f"materials.{name}.eps_r"]
                moved = replace(train, materials=at(now, {one: x["eps_r"]}).materials)
                return likelihood(observe(moved, device=device), scene.radar.terms)

            found = profiles(axes, on_grid(axes, twice_log))["eps_r"]
            found_values[f"{name}.eps_r"] = found
            now = at(now, {now.parameters[f"materials.{name}.eps_r"]: found.value})
    before, after = (compare_curves(one, cache=cache, device=device) for one in (scene, now))
    return LearnedCurves(now, found_values, before, after)
