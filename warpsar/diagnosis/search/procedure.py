"""The procedure: how many rays, which pixels, the declared model's fit, and then the search for what is missing."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import warp as wp

from warpsar.compare.judgement import speckle_of
from warpsar.compare.observation import declared_looks, looks_of
from warpsar.diagnosis.field_content import refuse_unsavable
from warpsar.diagnosis.found import DiagnoseOptions, Diagnosis
from warpsar.diagnosis.models.field_prior import has_fields, with_roughness
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.frozen import frozen
from warpsar.diagnosis.models.judge import Judge, with_speckle
from warpsar.diagnosis.models.movable import MOST_NUMBERS, may_move
from warpsar.diagnosis.models.refit import fit_model, refit_as
from warpsar.diagnosis.scores.bootstrap import BATCH
from warpsar.diagnosis.scores.evidence import Evidence
from warpsar.diagnosis.search.loop import Search
from warpsar.diagnosis.search.record import SearchRecord
from warpsar.errors import InputError
from warpsar.runtime import console, once, threads
from warpsar.runtime.forecast import LONG_S, duration, timed
from warpsar.scene.scene import Scene
from warpsar.simulation.sampling import choose_density
from warpsar.speckle.draws import Speckle
from warpsar.speckle.scan import Scan
from warpsar.speckle.tail import FIRST
from warpsar.surface.stage import Stage
from warpsar.world.tables import View
from warpsar.world.world import lacks_images, refuse_both_kinds

MU_NOISE = 10.0  # looks x pixels x relative sampling variance of mu: the gain in 2 ln L that denoising mu could bring


def diagnose_scene(
    scene: Scene, device: wp.Device, options: DiagnoseOptions, record: SearchRecord | None = None
) -> Diagnosis:
    """Run the procedure on the training views of a scene.

    All processes of a run go through the whole procedure. They share the fits, folds and draws, and decide as the
    first one does.
    What the `record` holds of an earlier part of the run is not done again. Raises InputError for scenes without
    measured training views or with curves beside them, and for a limit of time on several processes.
    """
    beginning = time.monotonic()
    refuse_both_kinds(scene)
    once.join(device)
    if once.processes() > 1 and options.time_limit_s is not None:
        raise InputError("--time-limit: found several processes; allowed with one, whose clock alone decides")
    stage, views, looks = once.agree(lambda: _training(scene, device))
    seeds = 2 * scene.sampling.seed, 2 * scene.sampling.seed + 1
    density = choose_density(scene, stage, views, looks, MU_NOISE, total=True, shared=True, kept=seeds)
    console.say(
        f"rays: {density.rays_per_pixel:g} per pixel; looks x pixels x relative sampling variance "
        f"{density.noise:.2g} (wanted: under {MU_NOISE:g})"
    )
    assert density.sets is not None  # `total` measures every scene
    one, other = (FitSetup(device, each, {}, mesh=scene.mesh) for each in density.sets)
    setup = replace(one, observations=frozen(one, other, scene))

    if once.processes() == 1 and not has_fields(scene) and (expected := forecast(setup, scene, options)) is not None:
        console.say(str(expected))
    bar = console.progress(2 * options.draws, "diagnose", "")
    console.say("fit of the declared model")
    record = record or SearchRecord()
    started = None
    if has_fields(scene):
        refuse_unsavable(scene)
        setup, started = with_roughness(setup, scene, options.seed)
    declared = record.declared(setup, scene, partial(fit_model, setup, scene, options.starts, options.seed, started))
    if options.bodies and not may_move(declared.problem):
        console.say(f"bodies, angles and spacings are not asked: the scene learns more than {MOST_NUMBERS:,} numbers")
    judge = Judge(device)
    speckle = once.find(lambda: speckle_of(judge(declared.scene, "train")))
    asked = scene
    if speckle.departs:
        console.say(f"train views: {speckle.words}")
    if speckle.names:
        asked = with_speckle(scene, speckle)
        setup = with_looks(setup, asked)
        declared = refit_as(setup, with_speckle(declared.scene, speckle))
    search = Search(asked, setup, other.rays, declared, options, record, bar.update, judge)
    limit = options.time_limit_s
    search.run(None if limit is None else limit - (time.monotonic() - beginning))
    bar.close()
    final, rivals = search.final(), search.rivals()
    values = search.values(final)
    return Diagnosis(
        scene,
        declared,
        final,
        search.turns,
        search.unexplained,
        density,
        setup,
        judge,
        speckle,
        rivals,
        objects=values["objects"],
        sensor=values["sensor"],
        not_asked=search.not_asked,
        on_trial=search.on_trial,
    )


def with_looks(setup: FitSetup, scene: Scene) -> FitSetup:
    """The setup whose pixels have the looks and the texture that the scene's views declare."""
    views = {view.name: view for view in scene.views}
    observations = {
        name: [
            replace(seen, looks=declared_looks(views[name]) or seen.looks, texture=views[name].texture or math.inf)
            for seen in found
        ]
        for name, found in setup.observations.items()
    }
    return replace(setup, observations=observations)


def _training(scene: Scene, device: wp.Device) -> tuple[Stage, list[View], list[float]]:
    """What is tested: the surface, the training views and their looks."""
    views = [view for view in scene.views if view.role == "train" and view.images]
    if not views:
        raise lacks_images(scene, "train")
    return Stage.of(scene, device), views, [looks_of(scene, view) for view in views]


# ---- how long a diagnosis takes where nothing is missing, from a timed sample of its work


# Set on the shared cases `none` and `tall`, on two cores; benchmarks/diagnosis_time.py holds them against others.
JACOBIANS = 60.0  # of a start of a fit, and of the models that are judged
BATCHES = 45.0  # of draws beside the first ones of the bootstrap, that templates, scores and the judgement are worth
EFFECT = 2.0  # times all of it, for an effect that is found: candidates' fits, the next turn, and confirmation


@dataclass(frozen=True)
class DiagnosisForecast:
    """`nothing_s`: where nothing is missing. `effect_s`: what each effect adds that is found."""

    nothing_s: float
    effect_s: float

    def __str__(self) -> str:
        return (
            f"about {duration(self.nothing_s)} if nothing is missing, and about {duration(self.effect_s)} more for "
            f"each effect that is found; --time-limit ends it earlier"
        )


def forecast(setup: FitSetup, scene: Scene, options: DiagnoseOptions) -> DiagnosisForecast | None:
    """From one Jacobian of the declared model and one batch of draws of speckle; None where it is not long.

    The Jacobian is made twice, and the second is timed: the first one compiles.
    """
    problem = setup.problem(scene)
    problem.jacobian(problem.x0)
    jacobian, _ = timed(lambda: problem.jacobian(problem.x0))
    evidence = Evidence.of(problem, problem.x0)
    speckle = Speckle(evidence.observations, evidence.autocovariance)
    scan = Scan(evidence.observations, evidence.autocovariance, evidence.silent)
    batch, _ = timed(lambda: scan.largest(evidence.split(speckle(np.random.default_rng(0), BATCH))))
    draws = min(options.draws, FIRST) / BATCH
    batches = draws / min(threads.thread_count(), draws) + BATCHES
    nothing = JACOBIANS * (1 + options.starts) * jacobian + batches * batch
    return DiagnosisForecast(nothing, EFFECT * nothing) if nothing > LONG_S else None
