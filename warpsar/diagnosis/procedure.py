"""The procedure: fit, look at what is left, add the effect that explains it, and again until nothing is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from warpsar.diagnosis.bench import Bench
from warpsar.diagnosis.bootstrap import Bootstrap, bootstrap
from warpsar.diagnosis.carried import carried_over
from warpsar.diagnosis.evidence import Evidence
from warpsar.diagnosis.found import Candidate, DiagnoseOptions, Diagnosis, Step
from warpsar.diagnosis.frozen import frozen
from warpsar.diagnosis.left_out import leave_one_view_out, varies_over_columns
from warpsar.diagnosis.refit import Fitted, fit_model, fit_robustly, narrow, refit_without, settle
from warpsar.diagnosis.scan import Scan, Spot
from warpsar.diagnosis.score import NOT_TESTABLE, Group, Projection, group
from warpsar.diagnosis.screening import Screening
from warpsar.diagnosis.survey import surveyed
from warpsar.diagnosis.templates import Template, TemplateMaker
from warpsar.effects.registry import get, names
from warpsar.errors import InputError
from warpsar.learning.observation import looks_of
from warpsar.learning.problem import FitProblem
from warpsar.runtime import console
from warpsar.runtime.distributed import ONE, Ranks
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.simulation.sampling import choose_density
from warpsar.surface.stage import Stage
from warpsar.world.tables import View

MU_NOISE = 10.0  # looks x pixels x relative sampling variance of mu: the gain in 2 ln L that denoising mu could bring


CLASS_COSINE = 0.9  # templates closer than this are one class: the data hardly tell them apart


DARK_PIXELS = 50  # fewer dark pixels than this say nothing


GLANCED = 8  # candidates that get a few iterations


OFFERED = 40  # of an effect's best trials that its refit may try


TRACE = 0.1  # of the median beta0: less is a border pixel's share of light


SILENT_SHARE = 0.01  # of the dark pixels that may measure exactly 0 under a floor


def diagnose_scene(scene: Scene, device: Any, options: DiagnoseOptions, ranks: Ranks = ONE) -> Diagnosis:
    """Run the procedure on the training views of a scene with uniform materials.

    Every one of the `ranks` goes through all of it; they share the fits, folds and draws, and decide as the first one
    does. Raises InputError for scenes without measured training views, or with learned fields.
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
    base = declared = fit_model(bench, scene, options.starts, options.seed)
    steps: list[Step] = []
    turn = bench  # the pixels of the turn: fewer where an added effect has moved the light
    while True:
        step, evidence = _step(scene, turn, other_rays, base, options, len(steps), bar)
        steps.append(step)
        if step.fitted is None or len(steps) > options.most_effects:
            break
        _prune(turn, step, [s.added for s in steps[:-1] if s.added], _effective_pixels(evidence, ranks))
        turn, base = narrow(turn, step.fitted)
    bar.close()
    last = steps[-1]
    # what was refused because something may stand there is left, whatever the scan makes of it
    left = last.scan_minus_log_p > last.threshold or any(c.shared for c in last.candidates)
    unexplained = last.added is None and left
    return Diagnosis(scene, declared, base, steps, unexplained, density, bench, evidence)


def _training(scene: Scene, device: Any) -> tuple[Stage, list[View], list[float]]:
    """What is tested: the surface, the training views and their looks."""
    stage = Stage.of(scene, device)
    if any(block.learn and block.size > 1 for block in stage.surface.blocks):
        raise InputError(
            f"{scene.path}: materials: found a learned field (layout vertex or texture); diagnose tests scenes of "
            f"uniform materials, because a field can imitate most effects"
        )
    views = [view for view in scene.views if view.role == "train" and view.images]
    if not views:
        raise InputError(f"{scene.path}: views: none with role train has measured images")
    return stage, views, [looks_of(scene, view) for view in views]


def _step(
    scene: Scene,
    bench: Bench,
    other_rays: Rays,
    base: Fitted,
    options: DiagnoseOptions,
    number: int,
    bar: Any,
) -> tuple[Step, Evidence]:
    """Score every effect that is not declared, refit the best, and add the one that holds on views left out."""
    ranks = bench.ranks
    point = fit_robustly(base, scene, bench)
    evidence = Evidence.of(base.problem, point.x, ranks)
    projection, found = ranks.agree(lambda: _grouped(scene, bench, other_rays, base, point.scene, evidence))
    candidates = {name: _candidate(name, members) for name, members in found.items()}
    testable = ranks.gather([c.effect for c in candidates.values() if c.testability == "testable"])[0]
    groups = {name: found[name] for name in testable}
    scan = Scan(evidence.observations, evidence.autocovariance, _silent(base.problem, point.x, evidence))
    boot = bootstrap(evidence, projection, groups, scan, options.draws, options.seed + number, bar.update, ranks)
    spot = scan.strongest(evidence.split(evidence.standardised))
    best = _score(candidates, groups, projection(evidence.standardised), boot)
    scanned = float(boot.tails["scan"](abs(spot.z)))
    step = Step(
        list(candidates.values()),
        None,
        spot,
        scanned,
        boot.p_family(scanned),
        boot.threshold(options.family_error),
        base,
    )
    _as_the_first(step, ranks)
    dark = _dark(base)
    passing = _passing(step.candidates, step.threshold, dark)
    _say(step, number, passing)
    if number >= options.most_effects:
        return step, evidence

    pixels = _effective_pixels(evidence, ranks)
    refitted: list[tuple[float, Candidate, Fitted]] = []
    for candidate, fitted in _screened(bench, base, point.scene, scene, passing, best, dark, options.refits):
        candidate.refit_gain = 2.0 * (fitted.log_likelihood - base.log_likelihood)
        candidate.refit_size = fitted.size - base.size
        penalty = (fitted.size - base.size) * np.log(pixels)
        refitted.append((candidate.refit_gain - penalty, candidate, fitted))
    if dark.asks:
        # Without such an effect the dark pixels are impossible: of those that make them possible the likeliest is
        # needed, whatever it gains in the light.
        able = [(candidate, fitted) for _, candidate, fitted in refitted if get(candidate.effect).additive]
        if able:
            candidate, fitted = max(able, key=lambda pair: pair[1].whole)
            fitted = settle(bench, fitted, options.starts, options.seed)
            candidate.refit_gain = 2.0 * (fitted.log_likelihood - base.log_likelihood)
            step.added, step.fitted = candidate.effect, fitted
            console.say(f"added: {step.added} {fitted.scene.effects[step.added]}, which the dark pixels ask for")
            return step, evidence
    for gain, candidate, fitted in sorted(refitted, key=lambda item: -item[0]):
        if gain <= 0:
            break
        fitted = settle(bench, fitted, options.starts, options.seed)
        candidate.refit_gain = 2.0 * (fitted.log_likelihood - base.log_likelihood)
        candidate.left_out = leave_one_view_out(bench, base, fitted, candidate.effect)
        console.say(
            f"  {candidate.effect}: views left out gain {candidate.left_out.gain:.1f} +- {candidate.left_out.error:.1f}"
        )
        if not candidate.left_out.passed:
            continue
        if varies_over_columns(bench, base, fitted, candidate.effect):
            candidate.note = "not one value for a view: it varies over the view's columns"
            console.say(f"  {candidate.effect}: {candidate.note}")
            continue
        if get(candidate.effect).in_image:
            candidate.carried = carried_over(bench, fitted, candidate.effect)
        if candidate.shared:
            candidate.note += f"{'; ' if candidate.note else ''}{_shared_note(candidate)}"
            console.say(f"  {candidate.effect}: {candidate.note}")
            if get(candidate.effect).additive:
                continue
        step.added, step.fitted = candidate.effect, fitted
        console.say(f"added: {candidate.effect} {fitted.scene.effects[candidate.effect]}")
        break
    return step, evidence


def _shared_note(candidate: Candidate) -> str:
    """Power that was added in an image can as well come from something that stands there; every radar blurs, so of a
    blur the amount alone is in doubt."""
    share = f"the surface takes {100.0 * (candidate.carried or 0.0):.0f} % of its gain over from view to view"
    if candidate.left_out is not None and candidate.left_out.views == 1:
        share = "one view alone"
    if get(candidate.effect).additive:
        return f"{share}: it cannot be told from something that stands there"
    return f"{share}: its size cannot be told from errors of the mesh, and is that of both"


def _grouped(
    scene: Scene, bench: Bench, other_rays: Rays, base: Fitted, at: Scene, evidence: Evidence
) -> tuple[Projection, dict[str, list[Group]]]:
    """The templates of every effect that is not declared, about the scene `at`, and the tangent of what is fitted."""
    observations = {view.view.name: view.observations for view in base.problem.views}
    maker = TemplateMaker(at, bench.device, other_rays, observations, evidence.modelled)
    # A fit without the paths that a surface throws back may have made it a poor mirror, and them invisible.
    unmoved = replace(at, materials=scene.materials)
    paths = TemplateMaker(unmoved, bench.device, other_rays, observations, evidence.modelled)
    projection = Projection(maker.tangent(), evidence.root_looks)
    found = {}
    for name in names():
        if name in base.scene.effects:
            continue
        templates = maker.templates(name)
        if get(name).stage == "path":
            templates += paths.templates(name)
        found[name] = group(templates, projection, evidence)
    return projection, found


def _as_the_first(step: Step, ranks: Ranks) -> None:
    """The scores of the first rank, which all go on with: last bits differ from GPU to GPU."""
    mine = [[asdict(c) for c in step.candidates], asdict(step.spot), step.scan_minus_log_p, step.p_scan, step.threshold]
    candidates, spot, step.scan_minus_log_p, step.p_scan, step.threshold = ranks.gather(mine)[0]
    step.candidates, step.spot = [Candidate(**c) for c in candidates], Spot(**spot)


def _screened(
    bench: Bench,
    base: Fitted,
    from_scene: Scene,
    declared: Scene,
    passing: Sequence[Candidate],
    templates: Mapping[str, Sequence[Template]],
    dark: Dark,
    most: int,
) -> list[tuple[Candidate, Fitted]]:
    """Fits of the `most` candidates that look likeliest at a glance; each may be given up for what the best other one
    looks like. Where dark pixels decide, the effects that can explain them come first, and none is given up for what
    others make of the lit pixels."""

    def glance(effect: str) -> Screening:
        trials = [template.trial for template in templates[effect]][:OFFERED]
        tables = [table for trial in trials for table in surveyed(bench, from_scene, effect, trial)]
        return Screening(bench, base, from_scene, declared, effect, tables)

    screenings = bench.ranks.deal_out(
        [partial(glance, candidate.effect) for candidate in passing[:GLANCED]],
        told=Screening.told,
        heard=partial(Screening.heard, bench, base, from_scene, declared),
    )
    order = sorted(zip(passing, screenings, strict=False), key=lambda pair: -pair[1].glanced.log_likelihood)
    if dark.asks:
        order.sort(key=lambda pair: not get(pair[0].effect).additive)

    def lead_over(one: Screening) -> float:
        others = (other.glanced.log_likelihood for other in screenings if other is not one)
        return -np.inf if dark.asks else max(others, default=-np.inf)

    finished = bench.ranks.deal_out(
        [partial(screening.finish, lead_over(screening)) for _, screening in order[:most]],
        told=lambda result: [result[0].told(), result[1]],
        heard=lambda told: (Fitted.heard(bench, base.scene, told[0]), told[1]),
    )
    found = []
    for (candidate, _), (fitted, given_up) in zip(order, finished, strict=False):
        gain = 2.0 * (fitted.log_likelihood - base.log_likelihood)
        said = ", given up" if given_up else ""
        console.say(f"  refit {candidate.effect}: 2 ln L {gain:+.1f} for {fitted.size - base.size} parameters{said}")
        if given_up:
            candidate.note += f"{'; ' if candidate.note else ''}its fit was given up, far behind"
        found.append((candidate, fitted))
    return found


def _prune(bench: Bench, step: Step, earlier: Sequence[str], pixels: float) -> None:
    """Drop what was added before if the newest effect has made it needless: less likelihood is lost without it than
    its parameters cost. A blur can stand in for a shift until the shift is found."""
    for name in earlier:
        assert step.fitted is not None
        if name not in step.fitted.scene.effects or get(name).additive:
            continue
        without = refit_without(bench, step.fitted, name)
        lost = 2.0 * (step.fitted.log_likelihood - without.log_likelihood)
        if lost < (step.fitted.size - without.size) * np.log(pixels):
            step.dropped.append(name)
            step.fitted = without
            console.say(f"dropped: {name}, needless with {step.added} (2 ln L {-lost:+.1f})")


def _silent(problem: FitProblem, x: np.ndarray, evidence: Evidence) -> list[np.ndarray]:
    """-sqrt(L) where a pixel measures exactly 0 and the model puts more than a trace of light, 0 elsewhere."""
    problem.modelled(x)
    modelled = iter(evidence.modelled)
    found = []
    for view in problem.views:
        for seen in view.observations:
            mu = next(modelled)
            image = view.render.images[seen.polarization].numpy().reshape(seen.interior.shape)
            lit = seen.silent & (image > TRACE * np.median(mu))
            found.append(np.where(lit, -np.sqrt(seen.looks), 0.0))
    return found


def _candidate(name: str, found: list[Group]) -> Candidate:
    if not found:
        return Candidate(name, "absent", note="this scene has no place for it")
    eta = max(float(one.eta.max()) for one in found)
    return Candidate(name, "testable" if eta >= NOT_TESTABLE else "not_testable", eta=eta)


def _score(
    candidates: dict[str, Candidate], groups: dict[str, list[Group]], residual: np.ndarray, boot: Bootstrap
) -> dict[str, list[Template]]:
    """Fill in what each testable candidate scored and whom it resembles; returns its templates, best first."""
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
        k = len(one.one_sided)
        columns = one.columns[:, t * k : (t + 1) * k]
        bases[name] = np.linalg.qr(columns if isinstance(columns, np.ndarray) else columns.toarray())[0]
    for name, mine in bases.items():
        candidates[name].resembles = [
            other
            for other, theirs in bases.items()
            if other != name and np.linalg.svd(mine.T @ theirs, compute_uv=False)[0] > CLASS_COSINE
        ]
    return ranked


@dataclass(frozen=True)
class Dark:
    """Pixels far from everything lit: how many, and how many of them measure power."""

    pixels: int
    positive: int

    @property
    def asks(self) -> bool:
        """They measure power that no multiple of a model's darkness explains."""
        return self.pixels >= DARK_PIXELS and self.positive > 0.5 * self.pixels

    @property
    def refuses_a_floor(self) -> bool:
        return self.pixels >= DARK_PIXELS and self.positive < (1.0 - SILENT_SHARE) * self.pixels


def _dark(base: Fitted) -> Dark:
    if any(get(name).additive for name in base.scene.effects):
        return Dark(0, 0)
    seen = base.problem.observations
    positive = sum(int((one.dark & (np.nan_to_num(one.measured) > 0)).sum()) for one in seen)
    return Dark(sum(int(one.dark.sum()) for one in seen), positive)


def _passing(candidates: Sequence[Candidate], threshold: float, dark: Dark) -> list[Candidate]:
    """Candidates worth a refit, best first. Power in the dark calls for an additive effect, whatever the lit pixels
    say; a floor is out of the question where many dark pixels measure exactly 0."""
    order = sorted(candidates, key=lambda c: -c.minus_log_p)
    found = [c for c in order if c.testability == "testable" and c.minus_log_p > threshold]
    if dark.refuses_a_floor:
        for candidate in found:
            if candidate.effect == "noise_floor":
                candidate.note = f"{dark.pixels - dark.positive} of {dark.pixels} dark pixels measure exactly 0"
        found = [c for c in found if c.effect != "noise_floor"]
    if dark.asks:
        additive = [c for c in order if c.testability == "testable" and get(c.effect).additive]
        for candidate in additive:
            candidate.note = f"{dark.positive} of {dark.pixels} dark pixels measure power"
        found = additive + [c for c in found if c not in additive]
    return found


def _effective_pixels(evidence: Evidence, ranks: Ranks) -> float:
    """Independent looks in the data: pixels over the correlation area, times looks."""
    area = max(float(evidence.autocovariance.sum() / evidence.autocovariance.max()), 1.0)
    return float(ranks.same(np.sum(evidence.root_looks**2) / area))


def _say(step: Step, number: int, passing: list[Candidate]) -> None:
    names = ", ".join(f"{c.effect} ({c.minus_log_p:.0f})" for c in passing[:6]) or "none"
    console.say(
        f"step {number + 1}: -ln p over {step.threshold:.1f}: {names}; "
        f"scan {step.scan_minus_log_p:.1f} (z {step.spot.z:+.1f})"
    )
