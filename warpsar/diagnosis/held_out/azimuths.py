"""How the azimuths of a table are counted: in which sense, and from which side of the target.

A table of another hand may count counterclockwise, or from the target's right side. No effect makes up for that, and a
fit with it takes long to say nothing. The declared model tells it at once: its outline lies across the measured one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from warpsar.compare.aim import best_shift
from warpsar.diagnosis.held_out.geometry import bodies
from warpsar.diagnosis.held_out.model import TrainViews
from warpsar.scene.scene import Scene

CHANCE = 0.01  # that another way is taken where the stated one is right
SIDES = ("the front", "the right side", "the rear", "the left side")


@dataclass(frozen=True)
class Counting:
    """A way to count azimuths: `sense` 1 clockwise or -1 counterclockwise, from one of `SIDES`. `gain` of the mean
    correlation of fourth roots over azimuths as they are stated, with its standard error over the views."""

    sense: int
    side: int
    gain: float = 0.0
    error: float = 0.0

    @property
    def label(self) -> str:
        return f"azimuths counted {'' if self.sense > 0 else 'counter'}clockwise from {SIDES[self.side]}"

    @property
    def words(self) -> str:
        return (
            f"{self.label}: correlation {self.gain:+.3f} +- {self.error:.3f} beside azimuths as they are stated, "
            "clockwise from the front"
        )

    def of(self, scene: Scene) -> Scene:
        """The scene with the azimuths of all views counted so."""
        views = [
            view.model_copy(update={"azimuth_deg": (self.sense * view.azimuth_deg + 90.0 * self.side) % 360.0})
            for view in scene.views
        ]
        return replace(scene, views=views)


OTHERS = (
    Counting(-1, 0),
    Counting(-1, 2),
    Counting(1, 1),
    Counting(1, 3),
    Counting(-1, 1),
    Counting(-1, 3),
)
"""All but clockwise from the rear: which end is the front, bodies are asked by fits."""


def counted(trained: TrainViews) -> Counting | None:
    """The way of counting by which the declared model surely correlates better with the train views than by the stated
    one; None where none does, or where the scene has no body. Of ways that do equally well it is the simplest."""
    if not bodies(trained.whole):
        return None
    own = _correlations(trained, lambda scene: scene)
    best, best_gain = None, np.zeros_like(own)
    for one in OTHERS:
        gain = _correlations(trained, one.of) - own
        if _surely(gain) and _surely(gain - best_gain):
            error = float(gain.std(ddof=1) / np.sqrt(gain.size))
            best, best_gain = replace(one, gain=float(gain.mean()), error=error), gain
    return best


def _surely(gain: np.ndarray) -> bool:
    """Whether a mean over views is above 0 by more than chance."""
    error = float(gain.std(ddof=1) / np.sqrt(gain.size))
    return bool(gain.mean() > stdtrit(gain.size - 1, 1.0 - CHANCE / len(OTHERS)) * error)


def _correlations(trained: TrainViews, change: Callable[[Scene], Scene]) -> np.ndarray:
    """Of each train view at its best shift, shape (views,), by the changed scene."""
    found = []
    for view, image in zip(trained.views, trained.images(change(trained.scene), trained.names), strict=True):
        each = [best_shift(trained.measured(view.name, pol), image[pol], trained.reach)[0] for pol in view.images]
        found.append(float(np.mean(each)))
    return np.array(found)
