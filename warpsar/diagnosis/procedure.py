"""The procedure: fit, look at what is left, add the effect that explains it, and repeat until nothing is left."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import warp as wp

from warpsar.diagnosis.addition import add_the_best
from warpsar.diagnosis.bench import Bench
from warpsar.diagnosis.course import Course
from warpsar.diagnosis.dark import Dark, worth_a_refit
from warpsar.diagnosis.evidence import Evidence
from warpsar.diagnosis.found import Candidate, DiagnoseOptions, Diagnosis, Turn
from warpsar.diagnosis.frozen import frozen
from warpsar.diagnosis.outcome import score_text, turn_lines
from warpsar.diagnosis.pruning import prune
from warpsar.diagnosis.refit import Fitted, fit_model, fit_robustly, narrow
from warpsar.diagnosis.scoring import score_effects
from warpsar.diagnosis.shortlist import refits
from warpsar.errors import InputError
from warpsar.learning.observation import looks_of
from warpsar.runtime import console
from warpsar.runtime.distributed import ONE, Ranks
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.simulation.sampling import choose_density
from warpsar.surface.stage import Stage
from warpsar.world.tables import View

MU_NOISE = 10.0  # looks x pixels x relative sampling variance of mu: the gain in 2 ln L that denoising mu could bring


def diagnose_scene(
    scene: Scene, device: wp.Device, options: DiagnoseOptions, ranks: Ranks = ONE, course: Course | None = None
) -> Diagnosis:
    """Run the procedure on the training views of a scene with uniform materials.

    All `ranks` go through the whole procedure. They share the fits, folds and draws, and decide as the first one does.
    What the `course` holds of an earlier part of the run is not done again. Raises InputError for scenes without
    measured training views, or with learned fields.
    """
    stage, views, looks = ranks.agree(lambda: _training(scene, device))
    density = choose_density(scene, stage, views, looks, MU_NOISE, total=True, ranks=ranks)
    console.say(
        f"rays: {density.rays_per_pixel:g} per pixel; looks x pixels x relative sampling variance "
        f"{density.noise:.2g} (wanted: under {MU_NOISE:g})"
    )
    rays = Rays(stage, density.rays_per_m2, 2 * scene.sampling.seed)
    other_rays = Rays(stage, density.rays_per_m2, 2 * scene.sampling.seed + 1)
    one, other = (Bench(device, each, {}, ranks) for each in (rays, other_rays))
    bench = replace(one, observations=frozen(one, other, scene))

    bar = console.progress(2 * options.draws, "diagnose", "")
    console.say("fit of the declared model")
    course = course or Course()
    base = declared = course.declared(bench, scene, partial(fit_model, bench, scene, options.starts, options.seed))
    turns: list[Turn] = []
    narrowed = bench  # fewer pixels where an added effect has moved the light
    while True:
        run = partial(_turn, scene, narrowed, other_rays, base, options, turns, bar.update)
        turn = course.turn(len(turns), narrowed, base, run)
        console.say("\n".join(turn_lines(turn, len(turns))))
        turns.append(turn)
        if turn.fitted is None or len(turns) > options.most_effects:
            break
        narrowed, base = narrow(narrowed, turn.fitted)
    bar.close()
    last = turns[-1]
    # an effect that was refused because something may stand there is left over, whatever the scan says
    left = last.alarms or any(c.shared for c in last.candidates)
    unexplained = last.added is None and left
    return Diagnosis(scene, declared, base, turns, unexplained, density, bench)


def _training(scene: Scene, device: wp.Device) -> tuple[Stage, list[View], list[float]]:
    """What is tested: the surface, the training views and their looks."""
    stage = Stage.of(scene, device)
    if any(block.learn and block.size > 1 for block in stage.surface.blocks):
        raise InputError(
            f"{scene.name}: materials: found a learned field (layout vertex or texture); diagnose tests scenes of "
            f"uniform materials, because a field can imitate most effects"
        )
    views = [view for view in scene.views if view.role == "train" and view.images]
    if not views:
        raise InputError(f"{scene.name}: views: none with role train has measured images")
    return stage, views, [looks_of(scene, view) for view in views]


def _turn(
    scene: Scene,
    bench: Bench,
    other_rays: Rays,
    base: Fitted,
    options: DiagnoseOptions,
    earlier: Sequence[Turn],
    progress: Callable[[int], object],
) -> Turn:
    """Score every effect that is not declared, refit the best, and add the one that holds on views left out. Drop
    those of `earlier` turns that it makes needless."""
    number = len(earlier)
    point = fit_robustly(base, scene, bench)
    evidence = Evidence.of(base.problem, point.x, bench.ranks)
    turn, templates = score_effects(scene, bench, other_rays, base, point.scene, evidence, options, number, progress)
    dark = Dark.of(base)
    passing = worth_a_refit(turn.candidates, turn.threshold, dark)
    _say(turn, number, passing)
    if number < options.most_effects:
        looks = _effective_looks(evidence, bench.ranks)
        fitted = refits(bench, base, point.scene, scene, passing, templates, dark, options.refits)
        add_the_best(bench, turn, fitted, dark, looks, options)
        if turn.fitted is not None:
            prune(bench, turn, [t.added for t in earlier if t.added], looks)
    return turn


def _effective_looks(evidence: Evidence, ranks: Ranks) -> float:
    """Independent looks in the data: pixels over the correlation area, times looks."""
    area = max(float(evidence.autocovariance.sum() / evidence.autocovariance.max()), 1.0)
    return float(ranks.same(np.sum(evidence.root_looks**2) / area))


def _say(turn: Turn, number: int, passing: Sequence[Candidate]) -> None:
    scores = ", ".join(f"{c.effect} {score_text(c.minus_log_p)}" for c in passing) or "none"
    dark = "" if turn.dark is None else f", of dark pixels {score_text(turn.dark.minus_log_p)} (z {turn.dark.z:+.1f})"
    console.say(
        f"turn {number + 1}: worth a fit, by score (-ln p, threshold {turn.threshold:.1f}): {scores}; "
        f"scan {score_text(turn.scan_minus_log_p)} (z {turn.spot.z:+.1f}){dark}"
    )
