"""A diagnosis judged on all views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from os import PathLike

import numpy as np
from scipy.special import chdtri

from warpsar.compare.comparison import Comparison
from warpsar.compare.contract import ROLES
from warpsar.compare.judgement import SHARE, Finding, Judgement, judge, level_within, speckle_of
from warpsar.compare.metrics import difference, likelihood_gain
from warpsar.diagnosis.alternatives import Deciding, deciding
from warpsar.diagnosis.found import REFUSES, Candidate, DiagnoseOptions, Diagnosis, EffectRival
from warpsar.diagnosis.geometry.registry import changes, is_geometry, of
from warpsar.diagnosis.known import leaves_tolerance
from warpsar.diagnosis.left.place import ResidualPlace, place
from warpsar.diagnosis.left.summary import Left, left_of
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.judge import Judge, under, with_speckle
from warpsar.diagnosis.models.left_out import LARGEST_DIFFERENCE, clipped
from warpsar.diagnosis.models.movable import may_move
from warpsar.diagnosis.models.names import kind_of, object_of
from warpsar.diagnosis.models.refit import Fitted, refit_without
from warpsar.diagnosis.role_metrics import RoleMetrics, role_metrics
from warpsar.diagnosis.search.geometry_confirmation import taken_back
from warpsar.diagnosis.search.procedure import diagnose_scene
from warpsar.diagnosis.single_views import may_be_angles, with_own_angles
from warpsar.effects.registry import get
from warpsar.errors import refuse_kind
from warpsar.learning.pose_sharing import Box, boxes
from warpsar.learning.trust import doubts, outside_domains
from warpsar.runtime import devices, once
from warpsar.scene.scene import Scene, scene_or_file
from warpsar.speckle.covariance import correlated
from warpsar.speckle.facts import SpeckleFact
from warpsar.speckle.likelihood import loss_terms
from warpsar.speckle.own import Patch, own_autocovariance
from warpsar.speckle.scan import Spot

# ---- which names of the final model are earned


def not_established(
    diagnosis: Diagnosis,
    verdicts: Mapping[str, Judgement],
    leaving: Sequence[str] = (),
    images: Sequence[Comparison] = (),
) -> dict[str, str]:
    """Names of the final model that are not earned, with their objects, and why, in words.

    What the time left on trial is none. Beside edges that do not agree, nothing that moves edges is, be it a body, an
    angle or a shift of images, nor an effect whose own test does not confirm it. Beside structure, or what the scan of
    the train views finds, such effects and angles and spacings of the sensor are not. A body lies at one place, and
    what is left may lie at another: its pose and its size are not where the strongest window lies on it or its shadow,
    nor where the train `images` there are less like the model than speckle is. The nearest size explains a part of any
    error of shape, and the true one leaves nothing. Beside values that are `leaving` their tolerance an effect may
    stand in for their error, unless its own test confirms it.
    """
    left = {one for verdict in verdicts.values() for one in verdict.findings}
    if diagnosis.unexplained and not diagnosis.withdrawn:
        left.add("structure")
    why = {}
    for name in diagnosis.held:
        if name in diagnosis.on_trial:
            why[name] = "the time was over before it was asked beside the others"
        elif is_geometry(name):
            if "edges" in left and of(name).edges_doubt:
                why[name] = "edges do not agree with it"
            elif "structure" in left and of(name).structure_doubts == "anywhere":
                why[name] = "structure is left with it"
            elif of(name).structure_doubts == "on it":
                if _is_left_on(diagnosis, verdicts, object_of(name)):
                    why[name] = "structure is left on it"
                elif excess := _excess_on(diagnosis, images, verdicts, object_of(name)):
                    why[name] = excess
        elif "edges" in left and get(name).stage == "position":
            why[name] = "edges do not agree with it"
        elif {"edges", "structure"} & left and not diagnosis.signed(name):
            why[name] = "what is left may be what it stands in for, and its own test does not confirm it"
        elif leaving and not diagnosis.signed(name):
            why[name] = f"it may stand in for an error of {', '.join(leaving)}, and its own test does not confirm it"
    return why


def _is_left_on(diagnosis: Diagnosis, verdicts: Mapping[str, Judgement], label: str) -> bool:
    """Whether the strongest window of a role, if no speckle makes it, meets the pixels of a body and its shadow."""
    for verdict in verdicts.values():
        if "structure" not in verdict.findings or verdict.p_window >= SHARE:
            continue
        scene, window = diagnosis.final.scene, verdict.window
        view = next(view for view in scene.views if view.name == window.view)
        body = (boxes(scene, view) or {}).get(label)
        low = window.row - window.rows // 2, window.col - window.columns // 2
        if body is not None and body.meets(Box(low, (low[0] + window.rows, low[1] + window.columns))):
            return True
    return False


def _excess_on(
    diagnosis: Diagnosis, images: Sequence[Comparison], verdicts: Mapping[str, Judgement], label: str
) -> str:
    """How far the pixels of a body and its shadow are from the model, in words; empty where speckle may be as far."""
    inside = []
    for image in images:
        body, whole = (boxes(diagnosis.final.scene, image.view) or {}).get(label), np.ones(image.usable.shape)
        inside.append(np.zeros(whole.shape, bool) if body is None else body.alone(whole) > 0.0)
    found = level_within(images, inside, verdicts["train"]) if images else None
    if found is None or found.p >= SHARE:
        return ""
    return f"on it and its shadow the deviance is {found.deviance:.2f}, where speckle leaves {found.expected:.2f}"


OPEN = 1e-3  # chance that a surface which explains all views costs train views more likelihood than is allowed
OPEN_WORDS = "the train views leave the surface open, so it was fitted to the test views, too"
OF_SURFACES = {"structure", "level"}  # what a surface that is wrong does to images


@dataclass(frozen=True)
class Diagnosed:
    """A diagnosis with what came of it on all views.

    `models`: the declared model, the one after every addition, and the final one, each beside the images of train and
    test views. `speckle`: what the final model says of the declared looks and texture. `verdicts`, by role: the
    judgement on the final model, under the speckle that was found; `own_numbers`: whether what effects hold for each
    view by itself was fitted to the test views for it. `foretold`: the judgement of the test views before the surface
    was fitted to them, too, since the train views leave it open; None where they foretell it, or no surface explains
    both. `reasons`: what speaks against an all-clear, a sentence each.
    `place`: the strongest window of what is left at the end; `left`: what is left altogether. `alternatives`: rivals
    that the data do not decide against, and which measurement would. `not_established`: names of the final model that
    are not earned, and why. `leaving`: values that leave the tolerance to which the scene knows them. `doubts`: why
    values of surfaces and effects mean little, whatever the images say: they lie on bounds, or outside the domain of
    their model.
    """

    diagnosis: Diagnosis
    models: list[list[Comparison]]
    speckle: SpeckleFact
    verdicts: dict[str, Judgement]
    reasons: list[str]
    own_numbers: bool
    foretold: Judgement | None
    place: ResidualPlace
    left: Left
    alternatives: list[tuple[EffectRival, Deciding]] = field(default_factory=list)
    not_established: dict[str, str] = field(default_factory=dict)
    doubts: list[str] = field(default_factory=list)
    leaving: list[str] = field(default_factory=list)

    def __repr__(self) -> str:
        names = ", ".join(self.verdict) or "nothing missing"
        return f"<Diagnosed: {names}{'; something is unexplained' if self.unexplained else ''}>"

    @cached_property
    def before(self) -> dict[str, RoleMetrics | None]:
        """Metrics of the declared model, fitted, on `train` and `test`."""
        return {role: role_metrics(of_role(self.models[0], role)) for role in ROLES}

    @cached_property
    def after(self) -> dict[str, RoleMetrics | None]:
        """The same of the model with every added effect."""
        return {role: role_metrics(of_role(self.models[-1], role)) for role in ROLES}

    @cached_property
    def gain(self) -> dict[str, tuple[float, float] | None]:
        """Mean deviance before less after, pixel by pixel, with its error, by role."""
        first, last = (self.models[k] for k in (0, -1))
        return {role: difference(of_role(first, role), of_role(last, role)) for role in ROLES}

    @property
    def verdict(self) -> list[str]:
        """The plain names that are earned: effects, bodies, looks and texture."""
        held = (kind_of(name) for name in self.diagnosis.held if name not in self.not_established)
        return [*dict.fromkeys(held), *self.speckle.names]

    @property
    def changed(self) -> bool:
        """Whether the final model has anything that the scene file does not declare."""
        return bool(self.diagnosis.held or self.speckle.names)

    @property
    def unexplained(self) -> bool:
        """Whether something is left that nothing found explains, or test views speak against what was found."""
        return bool(self.reasons)

    @property
    def findings(self) -> set[Finding]:
        """What departs from speckle beside the final model, in train or test views."""
        return {one for verdict in self.verdicts.values() for one in verdict.findings}

    @property
    def open_surface(self) -> str:
        """What the surface of the train views makes of the test views, in words; empty where it foretells them."""
        if self.foretold is None:
            return ""
        return f"test views, by the surface that the train views tell: {self.foretold.words}"


def of_role(images: Sequence[Comparison], role: str) -> list[Comparison]:
    return [image for image in images if image.role == role]


def diagnose(
    scene: Scene | PathLike[str] | str, *, device: str | None = None, options: DiagnoseOptions | None = None
) -> Diagnosed:
    """Run the procedure of docs/diagnosis-method.md on the train views. Then judge every turn's model on all views.

    Several processes share the work, and all return the same. Raises InputError for scenes without
    measured train views.
    """
    scene = scene_or_file(scene)
    options = options or DiagnoseOptions()
    refuse_kind(options, DiagnoseOptions, "options")
    where = devices.resolve_device(device)
    found = diagnose_scene(scene, where, options)
    return once.alone(lambda: judged(found))


def judged(diagnosis: Diagnosis) -> Diagnosed:
    """Judge every turn's model on all views.

    What test views speak against is taken out of the answer, one after the other: it is `withdrawn`, and what it was to
    explain is left unexplained.
    """
    judge_of = diagnosis.judge
    diagnosis = _without_what_hurts(diagnosis)
    fitted = diagnosis.final.scene
    speckle = _earned(diagnosis.scene, fitted, judge_of(fitted, "train"))
    final = with_speckle(_with_views(fitted, diagnosis.scene), speckle)
    if final.views != fitted.views:
        diagnosis = replace(diagnosis, final=replace(diagnosis.final, scene=final))
    own = judge_of.with_own_numbers(fitted)
    verdicts = _verdicts(judge_of, fitted, final, own)
    foretold, opened = None, _with_open_surface(diagnosis, fitted, final, verdicts)
    may = may_be_angles(verdicts) and may_move(diagnosis.final.problem)
    if opened is None and may and own is judge_of(fitted, "test"):
        diagnosis = with_own_angles(diagnosis, final)
        if diagnosis.of_test_views:
            fitted = diagnosis.final.scene
            own, final = judge_of(fitted, "test"), _with_views(fitted, final)
            verdicts = _verdicts(judge_of, fitted, final, own)
            opened = _with_open_surface(diagnosis, fitted, final, verdicts)
    if opened is not None:
        foretold, verdicts = verdicts["test"], opened
    models = [
        [image for role in ROLES for image in under(judge_of(one.scene, role, edges=False), diagnosis.scene)]
        for one in fitted_models(diagnosis)[:-1]
    ]
    models.append([image for role in ROLES for image in under(judge_of(fitted, role), final)])
    first = judge_of.with_own_numbers(diagnosis.declared.scene, edges=False)
    paying = under(first, diagnosis.scene), under(own, final)
    leaving = leaves_tolerance(diagnosis)
    doubted = not_established(diagnosis, verdicts, leaving, of_role(models[-1], "train"))
    reasons = _reasons(diagnosis, [*diagnosis.verdict, *speckle.names], verdicts, paying, leaving)
    reasons = reasons or [f"{name}: {why}" for name, why in doubted.items()]
    named = [name for name in diagnosis.held if name not in doubted]
    undecided = [rival for rival in diagnosis.rivals if rival.undecided and rival.effect in named]
    looks = float(np.median([seen.looks for seen in diagnosis.observations]))
    alternatives = [(one, deciding(final, one.scene, looks, diagnosis.setup.device)) for one in undecided]
    last = models[-1]
    spot = _spot(diagnosis, verdicts["train"])
    where = place(diagnosis, last, spot)
    left = left_of(diagnosis, last, spot, bool(reasons))
    own_numbers = own is not judge_of(fitted, "test")
    problem, x = diagnosis.final.problem, diagnosis.final.x
    little = doubts(problem, x, {}, outside_domains(problem, x))
    return Diagnosed(
        diagnosis,
        models,
        speckle,
        verdicts,
        reasons,
        own_numbers,
        foretold,
        where,
        left,
        alternatives,
        doubted,
        little,
        leaving,
    )


def _verdicts(judge_of: Judge, fitted: Scene, final: Scene, test: Sequence[Comparison]) -> dict[str, Judgement]:
    """The judgement of each role on the fitted scene's images, under the looks and texture of the `final` one."""
    tested = {"train": judge_of(fitted, "train"), "test": test}
    return {role: judge_of.judgement(under(images, final)) for role, images in tested.items() if images}


def _with_open_surface(
    diagnosis: Diagnosis, fitted: Scene, final: Scene, verdicts: Mapping[str, Judgement]
) -> dict[str, Judgement] | None:
    """The judgement of each role with the surface fitted to all views, where train views leave it open and nothing is
    left then; else None. It comes before a test view's own angle, which takes up what a surface lacks, too."""
    if not _may_be_open(verdicts):
        return None
    images = diagnosis.judge.with_open_surface(final, diagnosis.setup.roughness)
    opened = {role: judge(of) for role, of in images.items()}
    cost = _train_cost(under(diagnosis.judge(fitted, "train"), final), images["train"]) / verdicts["train"].sharing
    allowed = float(chdtri(diagnosis.final.problem.learned.size, OPEN))
    return opened if cost < allowed and not any(one.wrong for one in opened.values()) else None


def _train_cost(before: Sequence[Comparison], after: Sequence[Comparison]) -> float:
    """2 ln L that the train views lose."""
    return -2.0 * likelihood_gain(before, after) * sum(image.seen.count for image in before)


def _may_be_open(verdicts: Mapping[str, Judgement]) -> bool:
    """Whether test views alone are wrong, by what a surface can do."""
    return "test" in verdicts and not verdicts["train"].wrong and bool(OF_SURFACES & set(verdicts["test"].findings))


def _earned(declared: Scene, fitted: Scene, images: Sequence[Comparison]) -> SpeckleFact:
    """What even ground says of the declared looks and texture; no name for it where structure is left beside it."""
    speckle = speckle_of(under(images, declared))
    if not speckle.names:
        return speckle
    with_it = judge(under(images, with_speckle(_with_views(fitted, declared), speckle)))
    return speckle.beside_structure if {"structure", "edges"} & set(with_it.findings) else speckle


def _spot(diagnosis: Diagnosis, verdict: Judgement) -> Spot:
    """The strongest window: of the search's scan where it has an alarm, else of the judgement on all pixels."""
    last, window = diagnosis.turns[-1], verdict.window
    if last.alarms or verdict.p_window >= SHARE:
        return last.spot
    names = [(seen.view.name, seen.polarization) for seen in diagnosis.observations]
    at = names.index((window.view, window.polarization))
    return Spot(window.z, at, window.row, window.col, (window.rows, window.columns))


def _with_views(scene: Scene, given: Scene) -> Scene:
    """The scene with the looks and textures that another one's views declare."""
    stated = {view.name: {"looks": view.looks, "texture": view.texture} for view in given.views}
    return replace(scene, views=[view.model_copy(update=stated[view.name]) for view in scene.views])


def _reasons(
    diagnosis: Diagnosis,
    names: Sequence[str],
    verdicts: Mapping[str, Judgement],
    tested: tuple[Sequence[Comparison], Sequence[Comparison]],
    leaving: Sequence[str],
) -> list[str]:
    """What speaks against an all-clear, a sentence each. `tested`: the test images beside the declared and the final
    model, with what each of these holds for each view by itself fitted to them. `leaving`: values that the images pull
    out of their tolerance, so that either they or what the scene knows of them is wrong."""
    reasons = [f"{role} views: {one.words}" for role, one in verdicts.items() if one.wrong]
    if diagnosis.withdrawn:
        reasons.append(f"{', '.join(diagnosis.withdrawn)} held on train views, but the test views speak against it")
    if trial := [name for name in diagnosis.on_trial if name in diagnosis.held]:
        reasons.append(f"the time was over before it was asked whether {', '.join(trial)} holds")
    if diagnosis.unexplained and not reasons:
        reasons.append("train views: the scan finds something that no effect explains")
    before, after = tested
    other_laws = any(a.seen.law != b.seen.law for a, b in zip(before, after, strict=True))
    if names and other_laws and likelihood_gain(before, after) <= 0.0:
        reasons.append(f"{', '.join(names)} does not pay on test views: their likelihood did not rise")
    return reasons + [f"{label} leaves its tolerance" for label in leaving]


def _without_what_hurts(diagnosis: Diagnosis) -> Diagnosis:
    """The diagnosis without what test views speak against.

    A name is asked beside all the others, and only where a step from one turn's model to the next, or all steps
    together, are refuted. What hurts most goes first, and the rest is fitted and judged again. A train view's own angle
    moves no other image: what the surface that follows it changes there is chance.
    """
    judge_of, setup = diagnosis.judge, replace(diagnosis.setup, bound=0.0)
    withdrawn, kept = list[str](), diagnosis.final

    def gain_of(without: Fitted, with_it: Fitted) -> _TestGain:
        return _test_gain(*(judge_of.with_own_numbers(one.scene, edges=False) for one in (without, with_it)))

    names = _withdrawable(diagnosis, kept)
    steps = [(diagnosis.declared, kept), *pairwise(fitted_models(diagnosis))]
    if not names or not judge_of(kept.scene, "test", edges=False) or not any(gain_of(*step).refuted for step in steps):
        return diagnosis
    while names:
        alone = len(_added(diagnosis, kept)) == 1
        without = [diagnosis.declared if alone else _without(setup, kept, diagnosis.scene, name) for name in names]
        answers = [gain_of(one, kept) for one in without]
        hurting = [k for k, one in enumerate(answers) if one.refuted]
        if not hurting:
            break
        worst = min(hurting, key=lambda k: answers[k].gain)
        withdrawn.append(names[worst])
        kept = without[worst]
        names = _withdrawable(diagnosis, kept)
    if not withdrawn:
        return diagnosis
    objects = {name: one for name, one in diagnosis.objects.items() if name not in map(object_of, withdrawn)}
    plain = list(dict.fromkeys(kind_of(name) for name in withdrawn))
    return replace(diagnosis, final=kept, withdrawn=plain, unexplained=True, objects=objects)


@dataclass(frozen=True)
class _TestGain:
    """Log-likelihood that a change of the model gains on images that decided nothing, what it would gain on average
    were it true, and how far it would then scatter."""

    gain: float
    expected: float
    error: float

    @property
    def refuted(self) -> bool:
        """Whether it loses more than it scatters by, and a true change would lose as much in a hundredth of all cases.
        Images that it does not change lose as much by chance in a hundredth, too."""
        return self.gain < min(-self.error, self.expected - REFUSES * self.error)


def _test_gain(before: Sequence[Comparison], after: Sequence[Comparison]) -> _TestGain:
    """What images say of a change of the model: of all usable pixels, shadows and edges among them, above a level that
    model and measurement share. Each pixel counts `LARGEST_DIFFERENCE` at most."""
    patches = []
    for a in before:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(a.interior, a.measured / a.simulated, 1.0)
        patches.append(Patch(a.interior, ratio, a.seen.law))
    correlation, variance = own_autocovariance(patches)
    gain = expected = square = 0.0
    for a, b in zip(before, after, strict=True):
        both, level, looks = a.usable & b.usable & np.isfinite(a.measured), max(a.level, b.level), a.seen.looks
        measured, one, two = (image[both].astype(float) + level for image in (a.measured, a.simulated, b.simulated))
        now, then = (
            clipped(loss_terms("gamma", power, one, looks) - loss_terms("gamma", power, two, looks))
            for power in (measured, two)
        )
        scatter = np.minimum(np.sqrt(looks) * np.abs(two / one - 1.0), LARGEST_DIFFERENCE) * np.sign(two - one)
        shared = correlated(scatter[:, None], both, max(variance, 1.0) * correlation)[:, 0]
        gain, expected, square = gain + now.sum(), expected + then.sum(), square + scatter @ shared
    return _TestGain(float(gain), float(expected), float(np.sqrt(max(square, 0.0))))


def _added(diagnosis: Diagnosis, fitted: Fitted) -> list[str]:
    """Effects that the scene does not declare, and changes of its geometry."""
    effects = [name for name in fitted.scene.effects if name not in diagnosis.scene.effects]
    return [*effects, *changes(diagnosis.scene, fitted.scene)]


def _withdrawable(diagnosis: Diagnosis, fitted: Fitted) -> list[str]:
    return [
        name for name in _added(diagnosis, fitted) if not (is_geometry(name) and of(name).only_view(object_of(name)))
    ]


def _without(setup: FitSetup, fitted: Fitted, declared: Scene, name: str) -> Fitted:
    if is_geometry(name):
        return taken_back(setup, fitted, declared, name)
    return refit_without(setup, fitted, name)


def fitted_models(diagnosis: Diagnosis) -> list[Fitted]:
    """The declared model, the one after every addition, and the final one, fitted."""
    models = [diagnosis.declared, *(turn.fitted for turn in diagnosis.turns if turn.fitted is not None)]
    return models if models[-1] is diagnosis.final and len(models) > 1 else [*models, diagnosis.final]


def why_not(candidate: Candidate) -> str:
    """Why an effect could not be tested."""
    if candidate.testability == "absent":
        return "this scene has no place for it"
    share = 100.0 * candidate.eta
    return (
        f"the surface's parameters can imitate all but {share:.2g} % of its change (allowed: "
        f"{100.0 * candidate.least:g} %): in this geometry the two cannot be told apart"
    )
