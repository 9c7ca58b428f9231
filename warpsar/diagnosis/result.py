"""A diagnosis judged on all views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from warpsar.diagnosis.alternatives import Deciding, deciding
from warpsar.diagnosis.field_content import identify_beside
from warpsar.diagnosis.found import Candidate, DiagnoseOptions, Diagnosis, Rival
from warpsar.diagnosis.judge import ROLES, Judge, Judged, JudgedMetrics, difference, pool
from warpsar.diagnosis.left.place import Place, place
from warpsar.diagnosis.left.summary import Left, left_of
from warpsar.diagnosis.models.refit import Fitted
from warpsar.diagnosis.search.procedure import diagnose_scene
from warpsar.learning.identify import Identified, identify
from warpsar.runtime import devices, distributed
from warpsar.scene.scene import Scene

SAME_SD = 2.0  # a parameter that moved by more of its standard deviations than this is said to have moved


@dataclass(frozen=True)
class Diagnosed:
    """A diagnosis with what came of it on all views. `models`: the declared model and the one after every addition,
    each as `Judged` images of train and test views; `place`: the strongest window of what is left at the end; `left`:
    what is left altogether. `alternatives`: rivals that the data do not decide against, and which measurement would."""

    diagnosis: Diagnosis
    judge: Judge
    models: list[list[Judged]]
    place: Place
    left: Left
    alternatives: list[tuple[Rival, Deciding]] = field(default_factory=list)

    @property
    def before(self) -> dict[str, JudgedMetrics | None]:
        """Metrics of the declared model, fitted, on `train` and `test`."""
        return {role: pool(self.models[0], role) for role in ROLES}

    @property
    def after(self) -> dict[str, JudgedMetrics | None]:
        """The same of the model with every added effect."""
        return {role: pool(self.models[-1], role) for role in ROLES}


def diagnose(scene: Scene, *, device: str | None = None, options: DiagnoseOptions | None = None) -> Diagnosed:
    """Run the procedure of docs/diagnosis.md on the train views. Then judge every turn's model, once, on all views.

    Several processes (`distributed`) share the work, and all return the same. Raises InputError for scenes without
    measured train views.
    """
    where = devices.resolve_device(device)
    return judged(diagnose_scene(scene, where, options or DiagnoseOptions(), distributed.ranks(where)))


def judged(found: Diagnosis) -> Diagnosed:
    """Judge every turn's model on all views.

    A model that is farther from the test views than the declared one is never the answer: the declared model stands
    then, what was found is `withdrawn`, and what it was to explain is left unexplained.
    """
    judge = Judge(found)
    models = [judge(fitted.scene) for fitted in fitted_models(found)]
    if found.verdict and _worse(models[0], models[-1]):
        withdrawn = found.verdict
        found = replace(found, final=found.declared, withdrawn=withdrawn, unexplained=True, objects={})
        models.append(models[0])
    undecided = [rival for rival in found.rivals if rival.undecided and rival.effect in found.verdict]
    looks = float(np.median([seen.looks for seen in found.observations]))
    alternatives = [(one, deciding(found.final.scene, one.scene, looks, found.bench.device)) for one in undecided]
    last = models[-1]
    return Diagnosed(found, judge, models, place(found, last, found.turns[-1].spot), left_of(found, last), alternatives)


def _worse(before: Sequence[Judged], after: Sequence[Judged]) -> bool:
    """Whether the mean deviance of the test views rose, by more than the standard error of the rise."""
    gained = difference(before, after, "test")
    return gained is not None and gained[0] < -gained[1]


def fitted_models(found: Diagnosis) -> list[Fitted]:
    """The declared model, the one after every addition, and the final one, fitted."""
    models = [found.declared, *(turn.fitted for turn in found.turns if turn.fitted is not None)]
    return models if models[-1] is found.final else [*models, found.final]


@dataclass(frozen=True)
class Moved:
    """A surface parameter before and after the effects were added: values (SI), and standard deviations of their
    learned coordinates (ln, or logit for specular_fraction); `sds`: the move over the root of both variances' sum."""

    material: str
    key: str
    before: float
    after: float
    before_sd: float
    after_sd: float
    move: float

    @property
    def sds(self) -> float:
        return self.move / float(np.hypot(self.before_sd, self.after_sd))


def moved_parameters(found: Diagnosis) -> tuple[list[Moved], Identified]:
    """How far every uniform learned surface parameter went, and what the final model's data can say of them."""
    first, last = found.declared, found.final
    before, after = (identified(fitted) for fitted in (first, last))
    moves, at, place = [], 0, 0  # in x, and among what is identified
    ends = _uniform_ends(last)
    for block in first.problem.surface.blocks:
        if block.learn and block.size > 1:
            at += block.size
        elif block.learn:
            key = (block.material, block.kind.key)
            if key in ends:  # else what an absent object was made of is gone
                x_end, place_end = ends[key]
                a, b = float(first.x[at]), float(last.x[x_end])
                one, two = (float(block.kind.from_coordinate(x)) for x in (a, b))
                sds = float(before.sd[place]), float(after.sd[place_end])
                moves.append(Moved(block.material, block.kind.key, one, two, *sds, b - a))
            at, place = at + 1, place + 1
    return moves, after


def identified(fitted: Fitted) -> Identified:
    """What the data can say of a model's parameters; with learned fields, of all others beside them."""
    problem, x = fitted.problem, fitted.x
    return identify(problem, x) if problem.uniform else identify_beside(problem, x)


def _uniform_ends(fitted: Fitted) -> dict[tuple[str, str], tuple[int, int]]:
    """Of every uniform learned parameter, by material and key: its place in x, and among what is identified."""
    found, at, place = {}, 0, 0
    for block in fitted.problem.surface.blocks:
        if block.learn and block.size > 1:
            at += block.size
        elif block.learn:
            found[block.material, block.kind.key] = at, place
            at, place = at + 1, place + 1
    return found


def why_not(candidate: Candidate) -> str:
    """Why an effect could not be tested."""
    if candidate.testability == "absent":
        return "this scene has no place for it"
    share = 100.0 * candidate.eta
    return (
        f"all but {share:.2g} % of what it would change, the surface's parameters can change alike "
        f"(allowed: {100.0 * candidate.least:g} %): in this geometry the two cannot be told apart"
    )
