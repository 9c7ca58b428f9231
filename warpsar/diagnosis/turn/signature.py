"""Whether an effect's name is earned: a test of what this effect leaves, and no other does.

The likelihood asks whether a model with the effect is better. It does not ask whether the effect is what the name
says. So each effect names places that must hold it alike (`Effect.parts`), and may have a test of its own
(`Effect.own_test`). In each place the effect's amplitude is estimated by itself, with everything else that is fitted
left free there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.refit import Fitted
from warpsar.diagnosis.scores.templates import with_effect
from warpsar.diagnosis.turn.field_projection import left_beside
from warpsar.effects.base.parameter import EffectParameter
from warpsar.effects.base.signature import (
    AT_LEAST,
    AT_MOST,
    KNOWN,
    SURE,
    SeenImage,
    Signature,
    of_all,
)
from warpsar.effects.registry import get
from warpsar.learning.problem import FitProblem
from warpsar.scene.scene import Scene
from warpsar.speckle.residual import residual_autocovariance

STEP = 0.05  # of the effect's amplitude, by which it is changed for a derivative
CUT = 5.0  # standard deviations at which a residual is cut off
BLOCK = 4  # pixels on a side of the blocks that the error of an amplitude comes from
FEWEST_BLOCKS = 4
FEWEST = 20  # pixels of a place; fewer say nothing
RANK = 1e-5  # of the strongest direction of the fitted parameters in a place; weaker ones are rounding


LeftOf = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""A mask of pixels, the roots of their looks, and a standardised slope there -> what is left of the slope."""


@dataclass(frozen=True)
class Amplitude:
    """The effect in one place, over what it is in the whole: 1 where the place holds as much, and its standard error;
    infinite where the place says nothing."""

    part: str
    value: float
    error: float


def signature(setup: FitSetup, base: Fitted, fitted: Fitted, effect: str) -> Signature:
    """The outcome of the tests of `effect`, which `fitted` has and `base` has not."""
    images = seen_images(setup, base.scene, fitted.scene)
    table = fitted.scene.effects[effect]
    found = [] if (own := get(effect).own_test(images, table)) is None else [own]
    parts = [get(effect).parts(image, table) for image in images]
    if any(parts):
        found.append(_judged(amplitudes(setup, fitted, effect, parts)))
    return of_all(found)


def _judged(found: Sequence[Amplitude]) -> Signature:
    """Several places: one that holds less than half of the effect or more than twice speaks against it."""
    known = [one for one in found if one.error < KNOWN]
    numbers = {f"{one.part}: {key}": getattr(one, key) for one in known for key in ("value", "error")}
    parts = ", ".join(f"{one.part} {one.value:.2f} +- {one.error:.2f}" for one in known)
    whole = Amplitude("the whole", 1.0, 0.0)
    wrong = [
        one for one in found if _less(one, whole) or _less(whole, one) or any(_less(one, other) for other in found)
    ]
    if wrong:
        some = ", ".join(f"{one.part} holds {one.value:.2f} +- {one.error:.2f} of it" for one in wrong)
        numbers |= {f"{one.part}: {key}": getattr(one, key) for one in wrong for key in ("value", "error")}
        return Signature("against", f"{some}, where all must hold 1", numbers)
    held = [one for one in known if AT_LEAST < one.value < AT_MOST and one.value > SURE * one.error]
    if any(_apart(one, other) for one, other in combinations(known, 2)):
        return Signature("none", f"its size differs from place to place: {parts}", numbers)
    if len(held) > 1 and len(held) == len(known):
        return Signature("confirmed", f"its size by place, 1 in all: {parts}", numbers)
    return Signature("none", f"too few data for a test by place{': ' if parts else ''}{parts}", numbers)


def _apart(one: Amplitude, other: Amplitude) -> bool:
    """Whether two places surely hold different amounts of the effect. That confirms no name, and refuses none: a small
    misfit of something else does as much."""
    return abs(one.value - other.value) > SURE * math.hypot(one.error, other.error)


def _less(one: Amplitude, other: Amplitude) -> bool:
    """Whether one place holds less than half of what the other does, surely."""
    if not math.isfinite(one.error + other.error):
        return False
    return AT_LEAST * other.value - one.value > SURE * math.hypot(one.error, AT_LEAST * other.error)


def amplitudes(
    setup: FitSetup, fitted: Fitted, effect: str, parts: Sequence[Mapping[str, np.ndarray]]
) -> list[Amplitude]:
    """The effect's amplitude in each part, in the order of the parts' names; `parts` has masks (rows, cols) for each
    observation.

    One step of least squares from the fit, in units of sqrt(L): the residual against the derivative by the amplitude.
    What the other fitted parameters can imitate in this part is taken out of both.
    """
    problem = setup.problem(fitted.scene, dark=False)
    seen = problem.observations
    modelled = problem.modelled(problem.x0)
    residual = [
        np.clip(np.sqrt(one.looks) * (one.values / (gain * mu) - 1.0), -CUT, CUT)
        for one, mu, gain in zip(seen, modelled, problem.gains(modelled), strict=True)
    ]
    inflation = float(residual_autocovariance(list(zip(seen, residual, strict=True))).sum())
    own = [c.effect == effect for c in problem.effect_coordinates]
    others = np.flatnonzero(~np.concatenate([np.zeros(problem.learned.size, bool), np.array(own, bool)]))
    left_of = left_beside(problem, others, setup.roughness) if setup.roughness else _left_of(problem, others)
    slope = np.concatenate(_slope(setup, fitted.scene, effect))
    everything, roots = np.concatenate(residual), np.concatenate([np.full(o.count, np.sqrt(o.looks)) for o in seen])
    numbers = np.concatenate([_block_numbers(problem, k) for k in range(len(seen))])
    found = []
    for name in dict.fromkeys(name for one in parts for name in one):
        mask = np.concatenate(
            [
                one.get(name, np.zeros_like(image.interior))[image.interior]
                for one, image in zip(parts, seen, strict=True)
            ]
        )
        found.append(Amplitude(name, *_amplitude(mask, roots, everything, slope, left_of, numbers, inflation)))
    return found


def _left_of(problem: FitProblem, others: np.ndarray) -> LeftOf:
    """What the fitted parameters `others` cannot imitate within a mask of pixels."""
    tangent = np.concatenate([j[:, others] for j in problem.linearised(problem.x0)[1]])

    def left_of(mask: np.ndarray, roots: np.ndarray, slope: np.ndarray) -> np.ndarray:
        part = roots[:, None] * tangent[mask]
        norms = np.linalg.norm(part, axis=0)
        left, strength, _ = np.linalg.svd(part[:, norms > 0] / norms[norms > 0], full_matrices=False)
        left = left[:, strength > RANK * strength.max(initial=0.0)]
        return np.asarray(slope - left @ (left.T @ slope))

    return left_of


def _amplitude(
    mask: np.ndarray,
    roots: np.ndarray,
    residual: np.ndarray,
    slope: np.ndarray,
    left_of: LeftOf,
    blocks: np.ndarray,
    inflation: float,
) -> tuple[float, float]:
    """The amplitude in a mask of pixels and its error: that of speckle, or of the scatter from block to block if this
    is larger."""
    residual, blocks = residual[mask], blocks[mask]
    if residual.size < FEWEST:
        return 1.0, math.inf
    scaled = roots[mask] * slope[mask]
    free = left_of(mask, roots[mask], scaled)
    energy = float(free @ free)
    if energy <= 0 or np.unique(blocks[free != 0]).size < FEWEST_BLOCKS:
        return 1.0, math.inf
    step = float(free @ residual) / energy
    score = np.bincount(blocks, free * (residual - step * free))
    error = max(np.sqrt(inflation / energy), np.sqrt(float(score @ score)) / energy)
    return 1.0 + step, float(error)


def _block_numbers(problem: FitProblem, index: int) -> np.ndarray:
    """A number for each pixel of an observation: that of its block, no two observations sharing one."""
    seen = problem.observations[index]
    rows, cols = np.nonzero(seen.interior)
    across = -(-seen.interior.shape[1] // BLOCK)
    down = -(-seen.interior.shape[0] // BLOCK)
    return np.asarray((index * down + rows // BLOCK) * across + cols // BLOCK)


def _slope(setup: FitSetup, scene: Scene, effect: str) -> list[np.ndarray]:
    """d ln(mu) by the effect's amplitude, about 1, of every observation."""
    table = scene.effects[effect]
    both = []
    for amplitude in (1.0 + STEP, 1.0 - STEP):
        changed = with_effect(scene, effect, scaled(effect, table, amplitude))
        both.append(setup.problem(changed, dark=False).modelled_as_declared())
    return [np.log(more / less) / (2.0 * STEP) for more, less in zip(*both, strict=True)]


def scaled(effect: str, table: Mapping[str, Any], amplitude: float) -> dict[str, Any]:
    """The table with the effect times `amplitude`, by every parameter's distance from neutral.

    A parameter without a neutral value stays. One whose neutral value is infinite (a beam's width) acts by the inverse
    of its square.
    """

    def one(p: EffectParameter, value: float) -> float:
        if math.isnan(p.neutral):
            return value
        if math.isinf(p.neutral):
            return value / math.sqrt(amplitude)
        return float(np.clip(p.neutral + amplitude ** (1.0 / p.grows_by) * (value - p.neutral), p.low, p.high))

    found = dict(table)
    for p in get(effect).parameters:
        if p.name in table:
            value = table[p.name]
            found[p.name] = {v: one(p, x) for v, x in value.items()} if p.keyed_by else one(p, value)
    return found


def seen_images(setup: FitSetup, without: Scene, with_it: Scene) -> list[SeenImage]:
    """Every train image beside both models, with the gains of each."""
    problem = setup.problem(with_it, dark=False)
    planes = [_whole(setup.problem(scene, dark=False)) for scene in (without, with_it)]
    gains = problem.gains(problem.modelled_as_declared())
    found = []
    for seen, before, after, gain in zip(problem.observations, *planes, gains, strict=True):
        found.append(
            SeenImage(
                seen.view,
                seen.polarization,
                seen.looks,
                seen.looks_estimated,
                with_it.grid.spacing_m,
                seen.measured.astype(float),
                before,
                after,
                seen.interior & ~seen.dark,
                seen.dark,
                surface_in_pixels(setup, with_it, seen.view)[0],
                with_it.mesh.materials,
                float(gain),
            )
        )
    return found


def _whole(problem: FitProblem) -> list[np.ndarray]:
    """Images with their gains, shape (rows, cols); not darker than the compared pixels may be."""
    gains = problem.gains(problem.modelled_as_declared())
    found = []
    pairs = [(view, seen) for view in problem.views for seen in view.observations]
    for (view, seen), gain in zip(pairs, gains, strict=True):
        image = view.render.images[seen.polarization].numpy().reshape(seen.interior.shape).astype(float)
        image[seen.interior] = np.maximum(image[seen.interior], seen.darkest)
        found.append(gain * image)
    return found


def surface_in_pixels(setup: FitSetup, scene: Scene, view: Any) -> tuple[np.ndarray, np.ndarray]:
    """Of each pixel the material (an index, -1 where nothing is lit) with the largest lit area, and the mean incidence
    angle [deg] by lit area (NaN there), both of shape (rows, cols)."""
    hits = setup.rays_of(scene).hits(replace(scene, effects={}), view, [])
    rows, cols = scene.grid.shape
    pixel, weight = hits.pixel.numpy(), hits.weight.numpy().astype(float)
    material = scene.mesh.face_material[hits.face.numpy()]
    area = np.stack(
        [np.bincount(pixel, weight * (material == k), rows * cols) for k in range(len(scene.mesh.materials))]
    )
    total = area.sum(axis=0)
    angle = np.degrees(np.arccos(np.clip(hits.cos_incidence.numpy(), -1.0, 1.0)))
    mean = np.bincount(pixel, weight * angle, rows * cols) / np.where(total > 0, total, 1.0)
    main = np.where(total > 0, area.argmax(axis=0), -1)
    return main.reshape(rows, cols), np.where(total > 0, mean, np.nan).reshape(rows, cols)
