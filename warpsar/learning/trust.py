"""Whether the intervals of a fit hold, and if not, why; what a fit made worse; and how much of the lit surface lies
outside the domain of its model (equations 9, 12, 19, corrected)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from warpsar.compare.comparison import Comparison
from warpsar.compare.judgement import Judgement
from warpsar.learning.problem import FitProblem
from warpsar.models.base.model import DEFAULT
from warpsar.render.domains import lit_areas, model_areas

OUTSIDE = 0.5  # share of a material's lit area outside its model's domain, from which its values mean little
LESS_ALIKE = 0.05  # of a correlation, by which an image must have become less like the measured one to be told
FARTHER = 1.1  # times the error of before, from which an image is told to have become worse
AT_BOUND = 1e-3  # of a log coordinate, within which a value lies on its bound


def doubts(
    problem: FitProblem,
    x: np.ndarray,
    verdicts: Mapping[str, Judgement],
    domains: Mapping[str, Mapping[str, float]],
) -> list[str]:
    """Why the intervals at x do not hold, a sentence each; none where nothing speaks against them.

    An interval takes the model to be right, the loss to be a parabola, and no bound to be in the way. `domains` as
    `outside_domains` gives them.
    """
    found = [f"{role} views: {one.words}" for role, one in verdicts.items() if one.wrong]
    return found + _at_bounds(problem, np.asarray(x)) + _outside(problem, np.asarray(x), domains)


def worse(before: Sequence[Comparison], after: Sequence[Comparison]) -> list[str]:
    """What got worse than at the start, a sentence for each image; none where nothing did.

    A likelihood can improve while an image becomes less like the measured one: then the model buys a few pixels by many
    others.
    """
    found = []
    for one, two in zip(before, after, strict=True):
        a, b = (cast(dict[str, float], image.metrics) for image in (one, two))
        sentences = [
            f"{name} {a[key]:.3f} -> {b[key]:.3f}"
            for key, name, lost in (
                ("deviance", "deviance", b["deviance"] > FARTHER * a["deviance"]),
                ("correlation", "correlation", b["correlation"] < a["correlation"] - LESS_ALIKE),
                ("nrmse", "nrmse", b["nrmse"] > FARTHER * a["nrmse"]),
                ("rmse_db", "rmse [dB]", b["rmse_db"] > FARTHER * a["rmse_db"]),
            )
            if lost
        ]
        if sentences:
            where = f"{two.name} ({two.role})"
            found.append(f"{where} is farther from the measured image than at the start: {', '.join(sentences)}")
    return found


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
    for c, value, bound in zip(
        problem.effect_coordinates, x[problem.of_effects], on_bound[problem.of_effects], strict=True
    ):
        if bound:
            found.append(f"{c.label} lies on its bound, {float(c.declared.from_coordinate(value)):g}")
    return found


def _outside(problem: FitProblem, x: np.ndarray, domains: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Learned materials whose lit area lies outside the models' domains, mixed as tau mixes the models."""
    nodes, found = problem.nodes(x), []
    for name in dict.fromkeys(block.material for block in problem.surface.blocks if block.learn):
        shares = domains[name]
        model = problem.surface.model[problem.surface.materials.index(name)]
        if model != DEFAULT:
            share = shares.get(model, 0.0)
            if share > OUTSIDE:
                part = f"{100.0 * share:.0f} % of its lit area"
                found.append(f"{name} lies outside the domain of {model} on {part}")
            continue
        tau = float(np.mean(problem.surface.values(name, "specular_fraction", nodes)))
        outside = (1.0 - tau) * shares.get("spm", 0.0) + tau * shares.get("ka", 0.0)
        if outside > OUTSIDE:
            found.append(f"{name} lies outside its model's domain on {100.0 * outside:.0f} % of its lit area")
    return found


def outside_domains(problem: FitProblem, x: np.ndarray) -> dict[str, dict[str, float]]:
    """By material: the share of its lit area, over all views, that lies outside the domain of each model.

    `spm`: small perturbation, where tau < 1. `ka`: geometric optics, where tau > 0. A model that is not in use is left
    out. A material with another model than ka_spm has that one's share, under its name.
    """
    problem.modelled(x)
    pieces = [piece for view in problem.views for piece in view.render.pieces()]
    area = problem.over_views(lit_areas(problem.stage, pieces))  # lit and outside, for SPM and KA
    surface = problem.surface
    default = surface.by_default
    other = np.zeros((default.size, 2)) if default.all() else problem.over_views(model_areas(problem.stage, pieces))
    found = {}
    for m, name in enumerate(surface.materials):
        if default[m]:
            columns = [(0, "spm"), (1, "ka")]
            found[name] = {k: float(area[m, c + 2] / area[m, c]) for c, k in columns if area[m, c] > 0}
        else:
            lit, outside = other[m]
            found[name] = {surface.model[m]: float(outside / lit)} if lit > 0 else {}
    return found
