"""Whether the intervals of a fit hold, and if not, why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from warpsar.kernels.codes import Model
from warpsar.learning.observation import Observation
from warpsar.learning.problem import FitProblem
from warpsar.learning.verdict import Verdict, Window, verdict

OUTSIDE = 0.5  # share of a material's lit area outside its model's domain, from which its values mean little
AT_BOUND = 1e-3  # of a log coordinate, within which a value lies on its bound


def fit_verdict(problem: FitProblem, x: np.ndarray, ray_noise: float) -> Verdict:
    """The verdict on all images of a fit at x, the same on all ranks; `ray_noise` as in `verdict`, or NaN."""
    images = _all_images(problem, x)
    first = problem.ranks.first
    found = verdict(problem.scene, images, np.nan_to_num(ray_noise)) if first else None
    told = problem.ranks.gather(None if found is None else asdict(found))[0]
    return found or Verdict(**{**told, "window": Window(**told["window"])})


def _all_images(problem: FitProblem, x: np.ndarray) -> list[tuple[Observation, np.ndarray]]:
    """Every observation beside the modelled beta0 with its gain, shape (rows, cols), on the first rank."""
    ranks = problem.ranks
    gains = iter(problem.gains(problem.modelled(x)))
    mine = []
    for one in problem.views:
        for seen in one.observations:
            image = one.render.images[seen.polarization].numpy().reshape(seen.measured.shape).astype(float)
            image[seen.interior] = np.maximum(image[seen.interior], seen.darkest)
            mine.append((seen, float(next(gains)) * image))
    if ranks.size == 1:
        return mine
    parts = ("measured", "interior", "silent", "dark")
    arrays = {f"{k} {part}": getattr(seen, part) for k, (seen, _) in enumerate(mine) for part in parts}
    arrays |= {f"{k} modelled": image for k, (_, image) in enumerate(mine)}
    said = ranks.gather([[s.view.name, s.polarization, s.looks, s.looks_estimated] for s, _ in mine])
    order = [view.name for view in problem.chosen]
    found = []
    for about, stored in zip(said, ranks.collect(arrays), strict=False):
        for k, (name, polarization, looks, estimated) in enumerate(about):
            measured, interior, silent, dark = (stored[f"{k} {part}"] for part in parts)
            of = problem.chosen[order.index(name)]
            seen = Observation(of, polarization, measured, interior, silent, dark, looks, estimated)
            found.append((seen, stored[f"{k} modelled"]))
    return sorted(found, key=lambda one: order.index(one[0].view.name))


def doubts(
    problem: FitProblem,
    x: np.ndarray,
    verdicts: Mapping[str, Verdict],
    domains: Mapping[str, Mapping[str, float]],
) -> list[str]:
    """Why the intervals at x do not hold, a sentence each; none where nothing speaks against them.

    An interval takes the model to be right, the loss to be a parabola, and no bound to be in the way. `domains` as
    `validity.outside_domains` gives them.
    """
    found = [f"{role} views: {one.words}" for role, one in verdicts.items() if one.wrong]
    return found + _at_bounds(problem, np.asarray(x)) + _outside(problem, np.asarray(x), domains)


def _at_bounds(problem: FitProblem, x: np.ndarray) -> list[str]:
    low, high = problem.bounds
    on_bound = (x - low < AT_BOUND) | (high - x < AT_BOUND)
    found, at = [], 0
    for block in (block for block in problem.surface.blocks if block.learn):
        count = int(on_bound[at : at + block.size].sum())
        if count and block.size == 1:
            end = block.kind.low if x[at] - low[at] < AT_BOUND else block.kind.high
            found.append(f"{block.material}.{block.kind.key} lies on its bound, {end:g}")
        elif count:
            found.append(f"{block.material}.{block.kind.key} lies on a bound in {count} of {block.size} nodes")
        at += block.size
    for c, value, bound in zip(problem.effect_coordinates, x[at:], on_bound[at:], strict=True):
        if bound:
            found.append(f"{c.label} lies on its bound, {float(c.parameter.from_coordinate(value)):g}")
    return found


def _outside(problem: FitProblem, x: np.ndarray, domains: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Learned materials whose lit area lies outside the models' domains, mixed as tau mixes the models."""
    nodes, found = problem.nodes(x), []
    for name in dict.fromkeys(block.material for block in problem.surface.blocks if block.learn):
        shares = domains[name]
        model = Model(problem.surface.model[problem.surface.materials.index(name)])
        if model != Model.KA_SPM:
            share = shares.get(model.name.lower(), 0.0)
            if share > OUTSIDE:
                part = f"{100.0 * share:.0f} % of its lit area"
                found.append(f"{name} lies outside the domain of {model.name.lower()} on {part}")
            continue
        tau = float(np.mean(problem.surface.values(name, "specular_fraction", nodes)))
        outside = (1.0 - tau) * shares.get("spm", 0.0) + tau * shares.get("ka", 0.0)
        if outside > OUTSIDE:
            found.append(f"{name} lies outside its model's domain on {100.0 * outside:.0f} % of its lit area")
    return found
