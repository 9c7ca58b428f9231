"""A diagnosis judged on all views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike

import numpy as np
from scipy.special import chdtri

from warpsar.compare.comparison import Comparison
from warpsar.compare.contract import ROLES
from warpsar.compare.judgement import SHARE, Finding, Judgement, judge, speckle_of
from warpsar.compare.metrics import difference, likelihood_gain
from warpsar.diagnosis.alternatives import Deciding, deciding
from warpsar.diagnosis.found import Candidate, DiagnoseOptions, Diagnosis, EffectRival
from warpsar.diagnosis.left.place import ResidualPlace, place
from warpsar.diagnosis.left.summary import Left, left_of
from warpsar.diagnosis.models.change import ABSENT, MISSING, changes, is_geometry
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.judge import under, with_speckle
from warpsar.diagnosis.models.names import kind_of, object_of
from warpsar.diagnosis.models.refit import Fitted, refit_without
from warpsar.diagnosis.models.sensor import is_own_angle, is_sensor
from warpsar.diagnosis.role_metrics import RoleMetrics, role_metrics
from warpsar.diagnosis.search.geometry_confirmation import taken_back
from warpsar.diagnosis.search.procedure import diagnose_scene
from warpsar.effects.registry import get
from warpsar.errors import refuse_kind
from warpsar.runtime import devices, once
from warpsar.scene.scene import Scene, scene_or_file
from warpsar.speckle.facts import SpeckleFact
from warpsar.speckle.scan import Spot

# ---- which names of the final model are earned


PLACED = {ABSENT, MISSING}  # bodies that are there or are not: no remainder elsewhere puts them in doubt


def not_established(found: Diagnosis, verdicts: Mapping[str, Judgement]) -> dict[str, str]:
    """Names of the final model that are not earned, with their objects, and why, in words.

    What the time left on trial is none. Beside edges that do not agree, nothing that moves edges is, be it a body, an
    angle or a shift of images, nor an effect whose own test does not confirm it. Beside structure, such effects and
    angles and spacings of the sensor are not: a body lies at one place, and what is left may lie at another.
    """
    left = {one for verdict in verdicts.values() for one in verdict.findings}
    why = {}
    for name in found.held:
        if name in found.on_trial:
            why[name] = "the time was over before it was asked beside the others"
        elif is_geometry(name):
            if "edges" in left and kind_of(name) not in PLACED:
                why[name] = "edges do not agree with it"
            elif "structure" in left and is_sensor(name):
                why[name] = "structure is left with it"
        elif "edges" in left and get(name).stage == "position":
            why[name] = "edges do not agree with it"
        elif {"edges", "structure"} & left and not found.signed(name):
            why[name] = "what is left may be what it stands in for, and its own test does not confirm it"
    return why


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
    are not earned, and why.
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
        """Whether something is left that nothing found explains, or what was found does not pay on test views."""
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


def judged(found: Diagnosis) -> Diagnosed:
    """Judge every turn's model on all views.

    Whatever makes the test views worse is taken out of the answer, one after the other: it is `withdrawn`, and what it
    was to explain is left unexplained.
    """
    judge_of = found.judge
    found = _without_what_hurts(found)
    fitted = found.final.scene
    speckle = _earned(found.scene, fitted, judge_of(fitted, "train"))
    final = with_speckle(_with_views(fitted, found.scene), speckle)
    if final.views != fitted.views:
        found = replace(found, final=replace(found.final, scene=final))
    own = judge_of.with_own_numbers(fitted)
    tested = {"train": judge_of(fitted, "train"), "test": own}
    verdicts = {role: judge_of.judgement(under(images, final)) for role, images in tested.items() if images}
    foretold = None
    if _may_be_open(verdicts):
        images = judge_of.with_open_surface(final, found.setup.roughness)
        opened = {role: judge(of) for role, of in images.items()}
        cost = _train_cost(under(judge_of(fitted, "train"), final), images["train"]) / verdicts["train"].sharing
        allowed = float(chdtri(found.final.problem.learned.size, OPEN))
        if cost < allowed and not any(one.wrong for one in opened.values()):
            foretold, verdicts = verdicts["test"], opened
    models = [
        [image for role in ROLES for image in under(judge_of(one.scene, role, edges=False), found.scene)]
        for one in fitted_models(found)[:-1]
    ]
    models.append([image for role in ROLES for image in under(judge_of(fitted, role), final)])
    first = judge_of.with_own_numbers(found.declared.scene, edges=False)
    paying = under(first, found.scene), under(own, final)
    reasons = _reasons(found, [*found.verdict, *speckle.names], verdicts, paying)
    doubted = not_established(found, verdicts)
    named = [name for name in found.held if name not in doubted]
    undecided = [rival for rival in found.rivals if rival.undecided and rival.effect in named]
    looks = float(np.median([seen.looks for seen in found.observations]))
    alternatives = [(one, deciding(final, one.scene, looks, found.setup.device)) for one in undecided]
    last = models[-1]
    spot = _spot(found, verdicts["train"])
    where = place(found, last, spot)
    left = left_of(found, last, spot, bool(reasons))
    own_numbers = own is not judge_of(fitted, "test")
    return Diagnosed(
        found, models, speckle, verdicts, reasons, own_numbers, foretold, where, left, alternatives, doubted
    )


def _train_cost(before: Sequence[Comparison], after: Sequence[Comparison]) -> float:
    """2 ln L that the train views lose."""
    return -2.0 * likelihood_gain(before, after) * sum(image.seen.count for image in before)


def _may_be_open(verdicts: Mapping[str, Judgement]) -> bool:
    """Whether test views alone are wrong, by what a surface can do."""
    return "test" in verdicts and not verdicts["train"].wrong and bool(OF_SURFACES & set(verdicts["test"].findings))


def _earned(declared: Scene, fitted: Scene, images: Sequence[Comparison]) -> SpeckleFact:
    """What even ground says of the declared looks and texture; no name for it where structure is left beside it."""
    told = speckle_of(under(images, declared))
    if not told.names:
        return told
    with_it = judge(under(images, with_speckle(_with_views(fitted, declared), told)))
    return told.beside_structure if {"structure", "edges"} & set(with_it.findings) else told


def _spot(found: Diagnosis, verdict: Judgement) -> Spot:
    """The strongest window: of the search's scan where it has an alarm, else of the judgement on all pixels."""
    last, window = found.turns[-1], verdict.window
    if last.alarms or verdict.p_window >= SHARE:
        return last.spot
    names = [(seen.view.name, seen.polarization) for seen in found.observations]
    at = names.index((window.view, window.polarization))
    return Spot(window.z, at, window.row, window.col, (window.rows, window.columns))


def _with_views(scene: Scene, given: Scene) -> Scene:
    """The scene with the looks and textures that another one's views declare."""
    stated = {view.name: {"looks": view.looks, "texture": view.texture} for view in given.views}
    return replace(scene, views=[view.model_copy(update=stated[view.name]) for view in scene.views])


def _reasons(
    found: Diagnosis,
    names: Sequence[str],
    verdicts: Mapping[str, Judgement],
    tested: tuple[Sequence[Comparison], Sequence[Comparison]],
) -> list[str]:
    """What speaks against an all-clear, a sentence each. `tested`: the test images beside the declared and the final
    model, with what each of these holds for each view by itself fitted to them."""
    said = [f"{role} views: {one.words}" for role, one in verdicts.items() if one.wrong]
    if found.withdrawn:
        said.append(f"{', '.join(found.withdrawn)} made the test views worse")
    if trial := [name for name in found.on_trial if name in found.held]:
        said.append(f"the time was over before it was asked whether {', '.join(trial)} holds")
    if found.unexplained and not said:
        said.append("train views: the scan finds something that no effect explains")
    # a train view's own angle moves no other image; the surface that follows it does, by next to nothing
    acting = any(not is_own_angle(name) for name in _added(found, found.final))
    if names and (unpaid := _unpaid(*tested, acting)):
        said.append(f"{', '.join(names)} does not pay on test views: their {unpaid}")
    return said


def _unpaid(before: Sequence[Comparison], after: Sequence[Comparison], with_effects: bool) -> str:
    """What did not get better on images that were changed; empty where it did, or nothing was changed: looks of train
    views change test views through the surface alone, and that does not count."""
    pairs = list(zip(before, after, strict=True))
    if any(a.seen.law != b.seen.law for a, b in pairs):
        return "" if likelihood_gain(before, after) > 0.0 else "likelihood did not rise"
    touched = with_effects and any(not np.array_equal(a.simulated, b.simulated) for a, b in pairs)
    gained = difference(before, after) if touched else None
    if gained is None or gained[0] > 0.0:
        return ""
    # a noise floor leaves lit pixels as they were: shadows, of which the deviance knows nothing, decide then
    in_shadows = gained[0] >= -gained[1] and _without_power(after) < _without_power(before)
    return "" if in_shadows else "deviance did not fall"


def _without_power(images: Sequence[Comparison]) -> int:
    """Pixels that measure power where the model has none."""
    return sum(int(((image.simulated <= 0.0) & (image.seen.measured > 0.0))[image.usable].sum()) for image in images)


def _without_what_hurts(found: Diagnosis) -> Diagnosis:
    """The diagnosis without what makes the error on test views larger, by more than the standard error of the rise.

    What hurts most goes first, and the rest is fitted and judged again. A train view's own angle moves no other image:
    what the surface that follows it changes there is chance.
    """
    judge_of, setup, withdrawn, kept = found.judge, replace(found.setup, bound=0.0), list[str](), found.final
    before = judge_of.with_own_numbers(found.declared.scene, edges=False)

    def gained(fitted: Fitted) -> tuple[float, float]:
        return difference(before, judge_of.with_own_numbers(fitted.scene, edges=False)) or (0.0, 0.0)

    while before and (names := [name for name in _added(found, kept) if not is_own_angle(name)]):
        gain, error = gained(kept)
        if gain >= -error:
            break
        without = [_without(setup, kept, found.scene, name) for name in names]
        best = max(range(len(names)), key=lambda k: gained(without[k])[0])
        withdrawn.append(names[best])
        kept = without[best] if len(_added(found, kept)) > 1 else found.declared
    if not withdrawn:
        return found
    objects = {name: one for name, one in found.objects.items() if name not in map(object_of, withdrawn)}
    plain = list(dict.fromkeys(kind_of(name) for name in withdrawn))
    return replace(found, final=kept, withdrawn=plain, unexplained=True, objects=objects)


def _added(found: Diagnosis, fitted: Fitted) -> list[str]:
    """Effects that the scene does not declare, and changes of its geometry."""
    effects = [name for name in fitted.scene.effects if name not in found.scene.effects]
    return [*effects, *changes(found.scene, fitted.scene)]


def _without(setup: FitSetup, fitted: Fitted, declared: Scene, name: str) -> Fitted:
    if is_geometry(name):
        return taken_back(setup, fitted, declared, name)
    return refit_without(setup, fitted, name)


def fitted_models(found: Diagnosis) -> list[Fitted]:
    """The declared model, the one after every addition, and the final one, fitted."""
    models = [found.declared, *(turn.fitted for turn in found.turns if turn.fitted is not None)]
    return models if models[-1] is found.final and len(models) > 1 else [*models, found.final]


def why_not(candidate: Candidate) -> str:
    """Why an effect could not be tested."""
    if candidate.testability == "absent":
        return "this scene has no place for it"
    share = 100.0 * candidate.eta
    return (
        f"the surface's parameters can imitate all but {share:.2g} % of its change (allowed: "
        f"{100.0 * candidate.least:g} %): in this geometry the two cannot be told apart"
    )
