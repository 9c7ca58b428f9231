"""What each effect scores in one turn: its templates against the residual, calibrated by draws of speckle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np

from warpsar.diagnosis.dark.scan import scan_dark
from warpsar.diagnosis.found import Candidate, DiagnoseOptions, Turn
from warpsar.diagnosis.models.change import as_declared
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.refit import Fitted
from warpsar.diagnosis.scores.bootstrap import Bootstrap, bootstrap
from warpsar.diagnosis.scores.evidence import Evidence
from warpsar.diagnosis.scores.score import NOT_TESTABLE, TangentProjection, TemplateGroup, group
from warpsar.diagnosis.scores.templates import Template, TemplateMaker
from warpsar.diagnosis.turn.field_projection import bar_those_alone, beside_fields, projection_of
from warpsar.effects.registry import get, names, refused_with
from warpsar.learning.pose import FEW_RAYS
from warpsar.runtime import once
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.speckle.scan import Scan, surest
from warpsar.speckle.tail import Tails

CLASS_COSINE = 0.9  # templates closer than this are one class: the data hardly tell them apart


def score_effects(
    scene: Scene,
    setup: FitSetup,
    other_rays: Rays,
    base: Fitted,
    evidence: Evidence,
    options: DiagnoseOptions,
    number: int,
    progress: Callable[[int], object],
) -> tuple[Turn, dict[str, list[Template]]]:
    """The turn with the score of every effect that is not declared and of the scan, and each effect's templates, best
    first; those of an effect that adds power also where lit pixels do not test it, as dark ones may. `scene` is the
    declared one, `base` the model that `evidence` was taken at; `number` counts turns from 0."""
    projection, evidence, found = once.agree(
        lambda: _grouped(scene, setup, other_rays, base, evidence, options.seed + number)
    )
    candidates = {name: _candidate(name, members, projection.alone) for name, members in found.items()}
    testable = once.find(lambda: [c.effect for c in candidates.values() if c.testability == "testable"])
    groups = {name: found[name] for name in testable}
    scan = Scan(evidence.observations, evidence.autocovariance, evidence.silent)
    residual = projection(evidence.standardised, projection.known.residual)
    spots, strength = scan.strongest(evidence.split(evidence.standardised))
    scores: dict[str, Any] = {
        name: max(float(g.largest(residual[:, None])[0]) for g in members) for name, members in groups.items()
    }
    scores["scan"] = strength

    def pays(members: list[TemplateGroup], price: float) -> bool:
        """Whether any template's score, which is about what its fit gains, is more than its numbers cost."""
        most = [(evidence.area * float(g.statistics(residual[:, None])[0].max()), len(g.one_sided)) for g in members]
        return any(gain > size * price for gain, size in most)

    def decided(so_far: Bootstrap) -> bool:
        if so_far.decides(scores, options.family_error):
            return True
        # on which side of the threshold an effect lies that would not be added is no question for more draws
        price = evidence.price()
        asked = {name: one for name, one in scores.items() if name not in groups or pays(groups[name], price)}
        return so_far.decides(asked, options.family_error)

    boot = bootstrap(evidence, projection, groups, scan, options.draws, options.seed + number, progress, decided)
    dark = scan_dark(setup, other_rays, base, evidence, options.seed + number)
    if dark is not None:
        boot = boot.with_another(options.seed + number)
    best = {name: [t for one in found[name] for t in one.templates] for name in found if get(name).additive}
    best |= _score(candidates, groups, projection, residual, boot)
    bar_those_alone(list(candidates.values()), boot.threshold(options.family_error))
    spot, scanned = surest(spots, strength, cast(Tails, boot.tails["scan"]))
    turn = Turn(
        list(candidates.values()),
        None,
        spot,
        scanned,
        boot.p_family(scanned),
        boot.threshold(options.family_error),
        base,
        dark=dark,
        draws=boot.draws,
    )
    # last bits differ from one device to another: all go on with one process's scores
    first = once.find(lambda: replace(turn, base=cast(Fitted, None)))
    return replace(first, base=base), best


def _grouped(
    scene: Scene, setup: FitSetup, other_rays: Rays, base: Fitted, evidence: Evidence, seed: int
) -> tuple[TangentProjection, Evidence, dict[str, list[TemplateGroup]]]:
    """The templates of every effect that is not in the model `base`, about it, and the tangent of what is fitted; and
    the evidence with the speckle's own correlation."""
    observations = {view.view.name: view.observations for view in base.problem.views}
    maker = TemplateMaker(base.scene, setup.device, other_rays, observations, evidence.modelled)
    # A fit without multiple bounces may have made the surface a poor mirror. Paths are invisible there, so their
    # templates are taken at the declared surface too.
    # a score sums over a template's pixels, and so hardly feels the noise of few rays
    few = other_rays.thinned(FEW_RAYS)
    paths = [
        TemplateMaker(each, setup.device, few, observations, evidence.modelled)
        for each in (base.scene, as_declared(scene, base.scene))
    ]
    projection = projection_of(maker, setup, evidence)
    evidence = beside_fields(evidence, projection, seed)
    found: dict[str, list[TemplateGroup]] = {}
    for name in names():
        if name in base.scene.effects or get(name).of_phase:
            continue
        if get(name).last_resort or any(name in refused_with(material.model) for material in scene.materials.values()):
            found[name] = []
            continue
        makers = paths if get(name).follows_rays else [maker]
        templates = [one for each in makers for one in each.templates(name)]
        found[name] = group(templates, projection, evidence)
    return projection, evidence, found


def _candidate(name: str, found: list[TemplateGroup], alone: float) -> Candidate:
    if get(name).last_resort:
        return Candidate(name, "absent", note="the last resort, where no named effect explains the residual")
    if get(name).of_left_out:
        return Candidate(name, "absent", note="asked of views that are left out alone (--folds)")
    if not found:
        return Candidate(name, "absent", note="this scene has no place for it")
    eta = max(float(one.eta.max()) for one in found)
    return Candidate(name, "testable" if eta >= NOT_TESTABLE else "not_testable", eta=eta, least=alone)


def _score(
    candidates: dict[str, Candidate],
    groups: dict[str, list[TemplateGroup]],
    projection: TangentProjection,
    residual: np.ndarray,
    boot: Bootstrap,
) -> dict[str, list[Template]]:
    """Fill in each testable candidate's score and the effects that resemble it. Returns its templates, best first."""
    ranked: dict[str, list[Template]] = {}
    bases = {}
    for name, members in groups.items():
        candidate = candidates[name]
        scored = []
        for one in members:
            statistics, minus_log_p = one.statistics(residual[:, None])
            scored += [(float(minus_log_p[t, 0]), float(statistics[t, 0]), one, t) for t in range(len(one.templates))]
        scored.sort(key=lambda item: -item[0])
        ranked[name] = [one.templates[t] for _, _, one, t in scored]
        largest, candidate.statistic, one, t = scored[0]
        candidate.minus_log_p = float(boot.tails[name](largest))
        candidate.p_value = boot.p_family(candidate.minus_log_p)
        candidate.note = one.templates[t].trial.label
        bases[name] = np.linalg.qr(projection.compared(one.columns_of(t)))[0]
    for name, mine in bases.items():
        candidates[name].resembles = [
            other
            for other, theirs in bases.items()
            if other != name and np.linalg.svd(mine.T @ theirs, compute_uv=False)[0] > CLASS_COSINE
        ]
    return ranked
