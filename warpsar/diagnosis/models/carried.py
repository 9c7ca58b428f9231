"""Whether the surface could be what an effect of the image was taken for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from warpsar.compare.observation import Observation
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.left_out import clipped
from warpsar.diagnosis.models.projection import pixel_of, shift_px
from warpsar.diagnosis.models.refit import Fitted
from warpsar.effects.registry import get
from warpsar.runtime import once
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import loss_terms
from warpsar.world.tables import View

# Shares of an effect's gain beyond those expected, from which on the surface may be the cause. An effect that is the
# same in all views gains a part in any case: copies on both sides show in a view from the other side (0.4 seen). An
# effect of single views gains nothing so. A thin line of the world loses much at the corners of pixels (0.3 left).
CARRIED, CARRIED_ALONE = 0.5, 0.25
# Share from which on views are too much alike to tell, whatever the effect itself leads to expect.
ALIKE = 0.8


@dataclass(frozen=True)
class Carried:
    """`share` of an effect's gain that remains when the surface carries its changes from view to view, and the share
    that were `expected` if the effect is true. Shares of log-likelihood; both are 1 for a single view, which cannot
    tell."""

    share: float
    expected: float = 0.0

    def by_surface(self, effect: str) -> bool:
        """Whether the effect cannot be told from something on the surface.

        The part of the share that counts is what goes beyond the expected, on the way from there to 1.
        """
        alone = all(parameter.per_view for parameter in get(effect).parameters)
        expected = max(self.expected, 0.0) if self.expected < ALIKE else 0.0
        return self.share > expected + (1.0 - expected) * (CARRIED_ALONE if alone else CARRIED)


def carried_over(setup: FitSetup, fitted: Fitted, effect: str) -> Carried:
    """How much of an effect's gain the surface takes over from view to view.

    An effect of the radar or the processing lies in the image: another view has it elsewhere on the surface. What the
    mesh lacks lies on the surface, such as a strip of bright ground or the far side of a car. Views that look the same
    way cannot tell one from the other, nor can views left out. The comparison uses pixels that show surface which
    another view sees too. The model's other parameters are held.
    """
    names = [view.view.name for view in fitted.problem.views]
    if len(names) < 2:
        return Carried(1.0, 1.0)
    scene = fitted.scene
    without = replace(scene, effects={name: table for name, table in scene.effects.items() if name != effect})
    models = [setup.problem(model, dark=False) for model in (without, scene)]
    before, after = (problem.modelled_as_declared() for problem in models)
    gains = models[1].gains(after)
    change = [np.zeros(seen.interior.shape) for seen in models[1].observations]
    for plane, seen, a, b in zip(change, models[1].observations, before, after, strict=True):
        plane[seen.interior] = np.log(b / a)
    found = setup.share(
        [
            partial(_gained, setup, scene, models[1].observations, change, k, gains[k] * mu)
            for k, mu in enumerate(before)
        ]
    )
    shares = [carried / own if own > 0 else 0.0 for own, carried in np.sum(found, axis=0)]
    return Carried(*once.decide(shares))


def _gained(
    setup: FitSetup, scene: Scene, seen: list[Observation], change: list[np.ndarray], at: int, without: np.ndarray
) -> list[list[float]]:
    """Log-likelihood that observation number `at` gains by its own change of ln(beta0), and by what the others' views
    carry over: as it was measured, and as it would be on average were the effect true. `without`: its modelled pixels
    before."""
    mine = seen[at]
    others = [k for k, one in enumerate(seen) if one.view.name != mine.view.name]
    others = [k for k in others if seen[k].polarization == mine.polarization]
    brought = np.zeros((2, mine.interior.size))  # sums of the change, and of the light that other views see too
    for k in others:
        brought += on_the_surface(setup, scene, mine.view, seen[k], change[k])
    total, light = brought[:, mine.pixels]
    shared = light > 0
    ways = change[at][mine.interior], np.where(shared, total / np.where(shared, light, 1.0), 0.0)
    found = []
    for values in (mine.values, without * np.exp(ways[0])):
        lost = [loss_terms("gamma", values, without * np.exp(way), mine.looks) for way in (np.zeros(light.size), *ways)]
        found.append([float(clipped(lost[0] - after)[shared].sum()) for after in lost[1:]])
    return found


def on_the_surface(setup: FitSetup, scene: Scene, view: View, other: Observation, change: np.ndarray) -> np.ndarray:
    """Per pixel of `view`, (2, rows * cols): the other observation's change, summed over the lit surface in the pixel
    that the other sees too, weighted by its lit area; and the sum of the weights."""
    rows, cols = change.shape
    faces = len(scene.mesh.faces)
    hits, theirs = (setup.rays_of(scene).hits(scene, one, []) for one in (view, other.view))
    points, face = hits.point.numpy().astype(float), hits.face.numpy()

    def index(at: np.ndarray) -> np.ndarray:
        """Pixels (row * cols + col) of rows and columns, shape (2, n); -1 outside."""
        row, col = np.floor(at).astype(np.int64)
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        return np.where(inside, row * cols + col, -1)

    at = np.stack(pixel_of(scene, other.view, points))
    here, there = index(np.stack(pixel_of(scene, view, points))), index(at)
    # what is lit was binned before the model moved it
    lit = theirs.pixel.numpy().astype(np.int64) * faces + theirs.face.numpy()
    seen = np.isin(index(at - shift_px(scene, other.view)[:, None]) * faces + face, lit)
    seen &= (here >= 0) & (there >= 0) & other.interior.ravel()[there]
    weight = hits.weight.numpy()[seen].astype(float)
    sums = (np.bincount(here[seen], w, rows * cols) for w in (weight * change.ravel()[there[seen]], weight))
    return np.stack(list(sums))
