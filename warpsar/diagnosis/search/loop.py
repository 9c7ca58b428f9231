"""The search for what is missing: add on trial until nothing more is found, then take back what does not hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from warpsar.diagnosis.dark.evidence import Dark, worth_a_refit
from warpsar.diagnosis.found import Candidate, DiagnoseOptions, EffectRival, Turn
from warpsar.diagnosis.geometry.base.change import Hypothesis, Section
from warpsar.diagnosis.geometry.registry import changes, is_geometry, of
from warpsar.diagnosis.models.all_pixels import lit_shadows, log_likelihood, with_shadows
from warpsar.diagnosis.models.effect_gain import EffectGain
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.judge import Judge
from warpsar.diagnosis.models.left_out import leave_one_view_out
from warpsar.diagnosis.models.movable import may_move
from warpsar.diagnosis.models.names import object_of
from warpsar.diagnosis.models.refit import Fitted, narrow, on_bounded_ground, refit_as, settle
from warpsar.diagnosis.scores.evidence import Evidence
from warpsar.diagnosis.scores.score import minus_log_p
from warpsar.diagnosis.scores.templates import Template
from warpsar.diagnosis.search.confirmation import NOT_ELSEWHERE, Confirmation, confirm
from warpsar.diagnosis.search.outcome import confirmation_lines, score_text, turn_lines
from warpsar.diagnosis.search.record import SearchRecord
from warpsar.diagnosis.turn.addition import TOO_LITTLE, add_the_best, of_lit_pixels
from warpsar.diagnosis.turn.geometry_search import geometry_candidates, screened_bodies, worth_fits
from warpsar.diagnosis.turn.geometry_trial import (
    add_the_likeliest,
    on_its_ground,
    posed_anew,
    with_all_anew,
    with_edges,
)
from warpsar.diagnosis.turn.pruning import prune, resettled, trimmed, with_smaller
from warpsar.diagnosis.turn.rivals import rivals_of
from warpsar.diagnosis.turn.scoring import score_effects
from warpsar.diagnosis.turn.screening import NO_DARK
from warpsar.diagnosis.turn.sensor_search import screened_sensor, sensor_candidates, worth_a_fit
from warpsar.diagnosis.turn.shortlist import by_rank, refits
from warpsar.effects.base.trial import Context
from warpsar.effects.registry import get, names
from warpsar.errors import NothingLitError
from warpsar.learning.pose_search import FoundPoses
from warpsar.runtime import console, once
from warpsar.runtime.deadline import TimeUp, deadline
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays

# Times the largest score of an effect (2 ln L), from which on geometry has few rivals fitted. It is foretold on blurred
# images, which keep a quarter to an eighth of its gain; an effect's fit gains about its score.
FAR_AHEAD = 0.8
NEAR_BEST = 0.5  # of the best score (-ln p), or of what is foretold, from which on an effect is one of those few
FAR_BELOW = 0.04  # of what geometry is foretold to gain: an effect that scores less (2 ln L) is none of them
SENSOR_BEHIND = 0.5  # of what the best body is foretold: angles and spacings below it are not fitted
CHANCES = 2
"""How often one effect may be added: what is taken back may hold once something else was found. And after how many
rounds of additions, in which nothing new held, the search ends: the likeliest hypotheses were asked first."""


class Search:
    """Turns of adding on trial (stepwise forward), and their confirmation (stepwise backward), until both agree.

    `turns` in their order; the last one adds nothing. No order of additions decides: what is asked of an effect is
    asked beside all others, and an effect that was taken back has another chance once something else was found.
    """

    def __init__(
        self,
        scene: Scene,
        setup: FitSetup,
        other_rays: Rays,
        declared: Fitted,
        options: DiagnoseOptions,
        record: SearchRecord,
        progress: Callable[[int], object],
        judge: Judge,
    ) -> None:
        self.scene, self.options, self.turns = scene, options, list[Turn]()
        self.not_asked: list[str] = []  # what a limit of time left out, in words
        self.on_trial: list[str] = []  # additions that it left unconfirmed
        self._judge, self._doing = judge, ""
        self._setup = setup  # fewer pixels where an added effect has moved the light
        self._other = replace(setup, rays=other_rays)
        self._declared, self._record, self._progress = declared, record, progress
        self._base = declared
        self._refused: dict[frozenset[str], set[str]] = {}  # what was taken back, by what the model had left then
        self._held: frozenset[str] = frozenset()  # what held beside all others when that was asked last
        self._times: Counter[str] = Counter()  # that an effect was added
        self._lost: set[Hashable] = set()  # models with other settings (`resettled`)
        self._stage = 0
        self._asked: set[str] = set()  # of the model's additions: those that hold beside all the others
        self._posed: FoundPoses | None = None  # changed objects of the final model
        self._scores: Turn | None = None  # the turn that was scored last

    def run(self, left_s: float | None) -> None:
        """Search to the end, or until the time that is left is over: then what was found so far stands."""
        try:
            with deadline(left_s):
                self._search()
        except TimeUp:
            self._ended_early()

    def _search(self) -> None:
        self._look_at_shadows()
        fruitless, known = 0, set[str]()
        while fruitless < CHANCES and self._forward():
            if not self._confirmed():
                break
            self._held = frozenset(self._added(self._base))
            fruitless = fruitless + 1 if self._held <= known else 0
            known |= self._held
        if fruitless == CHANCES:
            self._look_once_more()
        self._doing = "a law of backscatter that is learned from the images"
        self._resort()

    def _look_once_more(self, scores: Turn | None = None) -> None:
        """End with a turn of which nothing is asked but what is left: with `scores`, or the model's now."""
        self.turns.append(replace(scores or self._scored()[0], added=None, fitted=None, dropped=[]))

    def _ended_early(self) -> None:
        """Say what was not asked. A run whose first scores did not come gets them now: nothing can be said without."""
        if not self.turns:
            self._look_once_more(self._scores)
        last = self.turns[-1]
        waiting = [
            c.effect
            for c in last.candidates
            if c.testability == "testable" and c.minus_log_p > last.threshold and c.refit_gain is None
        ]
        self.not_asked = [self._doing]
        if last.added is None and waiting:
            self.not_asked.append(f"whether one of these explains the residual: {', '.join(waiting)}")
        self.on_trial = [name for name in self._added(self._base) if name not in self._asked]
        if self.on_trial:
            self.not_asked.append(f"whether each of these holds beside all the others: {', '.join(self.on_trial)}")
        console.say("the time is over; not asked: " + "; ".join(self.not_asked))

    def _resort(self) -> None:
        """Learn a law of backscatter where nothing named explains what is left, if views left out bear it.

        A law over incidence bends whole images, and need not raise an alarm anywhere: the deviance of all tells it.
        """
        last = self.turns[-1]
        if len(self._added(self._base)) >= self.options.most_effects:
            return
        setup, here = on_bounded_ground(self._setup, self._base, self.scene)
        if not last.alarms and not self._left(here.scene):
            return
        price = Evidence.of(here.problem, here.x).price()
        found = learned_law(setup, here, price)
        if found is None:
            return
        candidate, fitted = found
        last.candidates = [c for c in last.candidates if c.effect != candidate.effect] + [candidate]
        console.say(f"last resort: {candidate.effect}: {candidate.refused or 'views left out bear it'}")
        if not candidate.refused:
            last.added, last.fitted = candidate.effect, fitted
            self._times[candidate.effect] += 1
            self._setup, self._base = narrow(self._setup, self._other, fitted)
            self._forward()

    def _left(self, scene: Scene) -> bool:
        """Whether the train views hold structure, or a deviance that even ground does not have, and not at edges: no
        law of backscatter moves an outline. A fit may have left all ground to a noise floor: then there is none to ask.
        """
        try:
            images = self._judge(scene, "train")
        except NothingLitError:
            return False
        findings = set(self._judge.judgement(images).findings)
        return bool(once.decide(float("edges" not in findings and bool({"structure", "level"} & findings))))

    def final(self) -> Fitted:
        """The model that the search ended with, at its best; nothing that a pixel can cost is bounded."""
        if not self._added(self._base):
            return self._declared
        plain, model = replace(self._setup, bound=0.0), self._base
        if model.problem.misfit.bound > 0:
            model = settle(plain, model, self.options.starts, self.options.seed)
        model, self._posed = with_edges(plain, model, self.scene)
        return model

    def values(self, final: Fitted) -> dict[Section, dict[str, dict[str, Any]]]:
        """What became of bodies, angles and spacings that were changed, by what they are called, in the sections of
        diagnosis.json; `final` is `final()`."""
        sections: dict[Section, dict[str, dict[str, Any]]] = {"objects": {}, "sensor": {}}
        for name in changes(self.scene, final.scene):
            change, label = of(name), object_of(name)
            added = (turn for turn in reversed(self.turns) if turn.added == name)
            first = next((c.table for turn in added for c in turn.candidates if c.effect == name), None)
            values = change.values(self.scene, final.scene, label, first or {}, self._posed)
            sections[change.section].setdefault(label, {}).update(values)
        return sections

    def rivals(self) -> list[EffectRival]:
        """Other effects in the place of those that hold."""
        setup, here = on_bounded_ground(self._setup, self._base, self.scene)
        return rivals_of(setup, here, self._effects(here), self.turns, needed)

    @property
    def unexplained(self) -> bool:
        """Whether the last scan passed, or an effect was refused because something may stand there."""
        last = self.turns[-1]
        final = self._base.scene.effects
        shared = any(c.shared and c.effect not in final for turn in self.turns for c in turn.candidates)
        return last.alarms or shared

    @property
    def _barred(self) -> set[str]:
        """What was taken back from the very model that the search is at, or from what held last: it has another chance
        beside something new that holds."""
        models = frozenset(self._added(self._base)), self._held
        return {name for model in models for name in self._refused.get(model, ())}

    def _closed(self, setup: FitSetup, here: Fitted) -> set[str]:
        """Changes of geometry that are not asked beside the model `here`: those that were taken back or tried often
        enough, and those that explained too little of what was wrong (`LEAST`), while so much of that is left that they
        would again."""
        level = log_likelihood(setup, here)
        again = {c.effect: c.again_at for turn in self.turns for c in turn.candidates}
        waiting = {name for name, least in again.items() if least is not None and level < least}
        return self._barred | waiting | {name for name, times in self._times.items() if times >= CHANCES}

    def _added(self, fitted: Fitted) -> list[str]:
        """Effects of a model that the scene does not declare, and changes of its geometry."""
        return [*self._effects(fitted), *changes(self.scene, fitted.scene)]

    def _effects(self, fitted: Fitted) -> list[str]:
        return [name for name in fitted.scene.effects if name not in self.scene.effects]

    def _forward(self) -> bool:
        """Turns until one adds nothing; whether any added something."""
        added = False
        while True:
            self._doing = f"turn {len(self.turns) + 1}: which effect explains the residual"
            turn = self._record.turn(self._stage, self._setup, self._base, self._turn)
            self._stage += 1
            console.say("\n".join(turn_lines(turn, len(self.turns))))
            self.turns.append(turn)
            if turn.fitted is None or turn.added is None:
                return added
            self._times[turn.added] += 1
            added = True
            if changes(self.scene, turn.fitted.scene):
                self._setup, self._base = on_its_ground(self._setup, self._other, turn.fitted)
            else:
                self._setup, self._base = narrow(self._setup, self._other, turn.fitted)
            self._look_at_shadows()

    def _look_at_shadows(self) -> None:
        """Let shadows fit what adds power, where no pixels lie far from what is lit."""
        if any(get(name).additive for name in self._base.scene.effects):
            self._setup, self._base = with_shadows(self._setup, self._base)

    def _turn(self) -> Turn:
        """Score every effect that is not in the model, fit the best, and add the likeliest. Drop those of earlier turns
        that it makes needless."""
        number, options = len(self.turns), self.options
        turn, setup, here, evidence, templates = self._scored()
        dark = Dark.of(here)
        shadows = options.bodies and not dark.asks and bool(once.decide(float(lit_shadows(here))))
        passing = worth_a_refit(turn.candidates, turn.threshold, dark, shadows)
        _say(turn, number, passing)
        allowed = [c for c in passing if c.effect not in self._barred and self._times[c.effect] < CHANCES]
        if dark.asks and not any(dark.answered_by(c.effect) for c in allowed):
            dark = NO_DARK  # what could answer was taken back: lit pixels decide again
        if len(self._added(here)) < options.most_effects:
            price = evidence.price()
            # geometry puts no power where nothing is lit: what the dark pixels need is added first
            geometry = options.bodies and not dark.asks and may_move(here.problem)
            alarm = bool(passing or turn.alarms or shadows)
            alarm = alarm or bool(once.decide(float(geometry and self._judged_wrong())))
            sensor, shifts = screened_sensor(self.scene, setup, here) if geometry else ([], 0.0)
            bodies = screened_bodies(self.scene, setup, here, alarm=alarm) if geometry else []
            closed = self._closed(setup, here) if geometry else set()
            sensor, bodies = ([one for one in some if one.name not in closed] for some in (sensor, bodies))
            if not alarm and not _promising([*sensor, *bodies], evidence.area, turn.threshold):
                sensor, bodies, geometry = [], [], geometry and self._has_moved
            foretold = max([0.0, *(one.foretold for one in [*sensor, *bodies])])
            if 2.0 * foretold > FAR_AHEAD * max((c.statistic for c in allowed), default=0.0):
                allowed = _beside_geometry(allowed, foretold, shifts, shadows)
            most, compared = options.refits, of_lit_pixels
            if shadows:  # which no glance at lit pixels sees
                allowed = sorted(allowed, key=lambda c: not get(c.effect).additive)
                most, compared = len(allowed), partial(log_likelihood, setup)
            for some in [allowed] if dark.asks or shadows else by_rank(allowed):
                if turn.added is None:
                    found = refits(setup, here, self.scene, some, templates, dark, most)
                    add_the_best(setup, turn, here, found, dark, price, compared)
            if geometry:
                setup = self._with_geometry(setup, turn, here, sensor, bodies, price, closed)
                setup = with_all_anew(setup, turn, self.scene)
            if turn.fitted is not None:
                prune(setup, turn, self._effects(here), price)
                left = [name for name in self._effects(here) if name in turn.fitted.scene.effects]
                paths = [name for name in left if get(name).follows_rays]
                turn.fitted = resettled(setup, turn.fitted, paths, self.scene, self._lost)
        return turn

    def _scored(self) -> tuple[Turn, FitSetup, Fitted, Evidence, dict[str, list[Template]]]:
        """The turn with all scores, where it was scored, and each effect's templates."""
        setup, here = on_bounded_ground(self._setup, self._base, self.scene)
        evidence = Evidence.of(here.problem, here.x)
        rays = self._other.rays_of(here.scene)
        turn, templates = score_effects(
            self.scene, setup, rays, here, evidence, self.options, len(self.turns), self._progress
        )
        self._scores = turn
        return turn, setup, here, evidence, templates

    @property
    def _has_moved(self) -> bool:
        """Whether the turn before changed the geometry. What is missing may have waited for that, and a scan of all
        pixels may be blind to a body of few."""
        return bool(self.turns) and self.turns[-1].added is not None and is_geometry(self.turns[-1].added)

    def _judged_wrong(self) -> bool:
        """Whether edges do not agree with the images, at which no scan looks, or structure is left on all pixels."""
        verdict = self._judge.judgement(self._judge(self._base.scene, "train"))
        return bool({"edges", "structure"} & set(verdict.findings))

    def _with_geometry(
        self,
        setup: FitSetup,
        turn: Turn,
        here: Fitted,
        sensor: Sequence[Hypothesis],
        bodies: list[Hypothesis],
        price: float,
        closed: Collection[str],
    ) -> FitSetup:
        """Let angles, spacings and bodies that are not `closed` contend with the effect that the turn has added, or
        with none. Returns the setup of what is added then.

        What is behind the effect waits. Nothing is lost by that: the next turn tries it beside the effect, and in the
        end each is asked beside all the others. A wrong angle seems to move bodies, and a moved body to turn views: so
        bodies that are behind the best of the sensor wait, too, and the sensor where a body is far ahead. Either makes
        bodies seem to be missing: these wait where they promise far less.
        """
        ahead = EffectGain.of(setup, here, turn.fitted)
        if ahead.most and not _shifts(turn):
            return setup
        of_bodies, of_sensor = (max([0.0, *(one.foretold for one in asked)]) for asked in (bodies, sensor))
        least = max(ahead.least, SENSOR_BEHIND * of_bodies)
        self._say_fits([one.name for one in worth_a_fit(sensor, price, least)])
        offered = sensor_candidates(self.scene, setup, here, sensor, price, least)
        if offered:
            ahead = replace(ahead, blurred=max(ahead.blurred, of_sensor))
        self._say_fits([one.name for one in worth_fits(bodies, price, ahead)])
        offered += geometry_candidates(self.scene, setup, here, bodies, price, ahead, offered)
        offered = [c for c in offered if c.name not in closed]
        return add_the_likeliest(setup, turn, here, self.scene, offered, price)

    def _say_fits(self, names: Sequence[str]) -> None:
        if names:
            console.say(f"turn {len(self.turns) + 1}: fits of geometry: {', '.join(names)}")

    def _confirmed(self) -> bool:
        """Ask everything that was added beside all others; whether anything may be found now that was hidden before.

        An effect that gained next to nothing hid nothing: the last turn has scored the same residual.
        """
        anything_hidden = False
        while self._added(self._base):
            self._doing = "whether the added effects hold"
            console.say(f"asked beside each other, and of views left out: {', '.join(self._added(self._base))}")
            answers = self._record.confirmation(self._stage, self._setup, self._base, self._confirm)
            self._stage += 1
            console.say("\n".join(confirmation_lines(answers)))
            self._asked = set(self._added(answers.fitted))
            self._rename(answers)
            for one in answers.asked:
                turn = next(turn for turn in reversed(self.turns) if turn.added == one.effect)
                next(c for c in turn.candidates if c.effect == one.effect).answered(one)
            refused = {one.effect for one in answers.asked if one.refused}
            self._base = answers.fitted
            self._refused.setdefault(frozenset(self._added(self._base)), set()).update(refused)
            anything_hidden |= any(one.refused != TOO_LITTLE for one in answers.asked if one.refused)
            if not any(is_geometry(name) for name in refused):
                break
            anything_hidden = True  # other pixels are lit
            self._setup, self._base = on_its_ground(self._setup, self._other, self._base)  # and the rest is asked there
        return anything_hidden

    def _rename(self, answers: Confirmation) -> None:
        """Let the turn that added an effect have the smaller one that took its place (`with_smaller`)."""
        for one in answers.asked:
            if is_geometry(one.effect) or any(turn.added == one.effect for turn in self.turns):
                continue
            turn = next(t for t in reversed(self.turns) if t.added and one.effect in _contained(t.added))
            larger = next(c for c in turn.candidates if c.effect == turn.added)
            larger.refused = f"{one.effect} explains the same with fewer numbers"
            if all(c.effect != one.effect for c in turn.candidates):
                turn.candidates.append(Candidate(one.effect, "testable"))
            turn.added = one.effect
            self._times[one.effect] += 1

    def _confirm(self) -> Confirmation:
        setup, here = on_bounded_ground(self._setup, self._base, self.scene)
        scene, posed = posed_anew(setup, here, self.scene)
        if posed is not None:
            here = refit_as(setup, scene)
        settled = settle(setup, here, self.options.starts, self.options.seed)
        price = Evidence.of(settled.problem, settled.x).price()
        last = self.turns[-1]
        settled = resettled(setup, settled, self._effects(settled), self.scene, self._lost)
        settled = trimmed(setup, settled, self._effects(settled), price, self.scene)
        settled = with_smaller(setup, settled, self._effects(settled), price)
        return confirm(setup, settled, self._added(settled), needed, price, declared=self.scene, quiet=not last.alarms)


def _contained(name: str) -> tuple[str, ...]:
    """The effects that an added one can do all that they do."""
    return () if is_geometry(name) else get(name).contains


def needed(without: Fitted, name: str) -> bool:
    """Whether the dark pixels ask a model without an effect for it."""
    dark = Dark.of(without)
    return dark.asks and dark.answered_by(name)


def _shifts(turn: Turn) -> bool:
    """Whether the turn has added a shift of images, which a body may have instead."""
    return turn.added is not None and not is_geometry(turn.added) and get(turn.added).stage == "position"


def _beside_geometry(allowed: Sequence[Candidate], foretold: float, shifts: float, shadows: bool) -> list[Candidate]:
    """The effects that are fitted in a turn in which a change of geometry is `foretold` far more: the likeliest ones,
    as a score is no gain and may be far below it, and those that shift images, if `shifts` may gain as much.

    Paths over several surfaces may be a thousand times the model's power. A score bounds what a pixel tells, so theirs
    is the farthest below their gain, and what they put into an image looks like a body of another size or place: they
    are always fitted. No score looks at `shadows` that measure power: an effect that adds power may gain there what a
    body that is absent does.
    """
    near = NEAR_BEST * max((c.minus_log_p for c in allowed), default=0.0)
    found = []
    for candidate in allowed:
        effect = get(candidate.effect)
        if effect.stage == "position":
            worth = shifts >= NEAR_BEST * foretold
        elif shadows and effect.additive:
            worth = True
        else:
            enough = candidate.statistic >= FAR_BELOW * 2.0 * foretold and candidate.minus_log_p >= near
            worth = effect.follows_rays or enough
        found += [candidate] if worth else []
    return found


def _promising(screened: Sequence[Hypothesis], area: float, threshold: float) -> bool:
    """Whether what any change of geometry is foretold to gain is more than speckle of a correlation `area` would have
    it: over the `threshold` of -ln p, for all that are asked (Wilks, Bonferroni). Blurred images are the less
    sensitive to speckle, so that this is hardly ever so by chance."""
    gains = ((2.0 * max(one.foretold, 0.0) / area, one.numbers) for one in screened)
    scores = [float(minus_log_p(np.array(gain), numbers, 0)) for gain, numbers in gains]
    return bool(max(scores, default=0.0) - np.log(max(len(scores), 1)) > threshold)


def _say(turn: Turn, number: int, passing: Sequence[Candidate]) -> None:
    scores = ", ".join(f"{c.effect} {score_text(c.minus_log_p)}" for c in passing) or "none"
    dark = "" if turn.dark is None else f", of dark pixels {score_text(turn.dark.minus_log_p)} (z {turn.dark.z:+.1f})"
    console.say(
        f"turn {number + 1}: worth a fit, by score (-ln p, threshold {turn.threshold:.1f}): {scores}; "
        f"scan {score_text(turn.scan_minus_log_p)} (z {turn.spot.z:+.1f}){dark}"
    )


# ---- the last resort, where no named effect explains what is left: backscatter learned from the images


LEAST_VIEWS = 3
"""With two the law of one view would be asked of one other, at one other incidence."""


def learned_law(setup: FitSetup, here: Fitted, price: float) -> tuple[Candidate, Fitted] | None:
    """An effect of the last resort with its fit, and whether views left out bear it (`Candidate.refused`).

    None where the scene has it already, or too few views to leave one out. A parameter costs `price` of 2 ln L.
    """
    offered = [name for name in names() if get(name).last_resort and name not in here.scene.effects]
    if not offered or len({view.view.name for view in here.problem.views}) < LEAST_VIEWS:
        return None
    name = offered[0]
    trial = get(name).trials(Context(here.scene, 1.0))[0]
    scene = replace(here.scene, effects={**here.scene.effects, name: dict(trial.starts[0])})
    fitted = refit_as(setup, scene)
    candidate = Candidate(name, "testable", note="the last resort: no named effect explains the residual")
    candidate.refit_gain = 2.0 * (fitted.log_likelihood - here.log_likelihood)
    candidate.refit_size = fitted.size - here.size
    candidate.table = fitted.scene.effects[name]
    if candidate.refit_gain <= candidate.refit_size * price:
        candidate.refused = TOO_LITTLE
        return candidate, fitted
    candidate.left_out = leave_one_view_out(setup, here, fitted, name)
    candidate.refused = "" if candidate.left_out.passed else NOT_ELSEWHERE
    return candidate, fitted
