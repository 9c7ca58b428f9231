"""Hypotheses tried one after the other; what stays is what views say that were left out of its fit.

The train views are left out in parts (`arcs.py`). A model is one scene for each part, fitted to the others. Its score
is the gamma deviance of every view by the model that has not seen it. A trial stays if its gain, less its standard
error over views and arcs, is above the noise: what a fit with nothing new gains on other rays and with as many
iterations more, its mean and one standard error. At the end every effect is left out once more, on as many draws of
rays as it takes: it stays if it is worth two standard errors over arcs and draws, for what came early may only have
stood in for what came later. What gains less than that cannot be told here. Glints of the body are asked last.

A body meets its rivals before any lead is claimed: itself turned round, and a box of its size, each fitted in the same
way. They are asked once its sizes were first moved, so that a run of little time has an answer, and again at the end.
Where the box predicts as well the first time, the search ends: no effect makes a body of another one. At the end the
box goes through a search of its own, since effects that were chosen for the body hold the box below its best.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from warpsar.compare.aim import EXPECTED
from warpsar.compare.prediction import BOX, SURE, THEN, Advantage, PredictedImage, advantage, predicted
from warpsar.diagnosis.held_out.arcs import arcs_of, by_azimuth, folds, mean_and_error, over_draws
from warpsar.diagnosis.held_out.azimuths import Counting, counted
from warpsar.diagnosis.held_out.box import as_box
from warpsar.diagnosis.held_out.geometry import (
    NEAR,
    TURNED,
    WIDE,
    Number,
    Profile,
    bodies,
    numbers,
    profiled,
    turnable,
    turned,
)
from warpsar.diagnosis.held_out.glints import FEWEST_VIEWS, found_by_parts, found_in_all, glints_of, with_glints
from warpsar.diagnosis.held_out.glints import NAME as GLINTS
from warpsar.diagnosis.held_out.hypotheses import EffectHypothesis, hypotheses, level_of
from warpsar.diagnosis.held_out.model import (
    FitRays,
    FittedViews,
    TrainViews,
    scene_content,
    scene_of,
    with_few_rays,
    with_other_rays,
)
from warpsar.diagnosis.models.change import as_declared
from warpsar.diagnosis.run_log import RunLog
from warpsar.effects.registry import declared, get, response_of
from warpsar.learning.pull import Pull
from warpsar.runtime import console, threads
from warpsar.runtime.deadline import TimeUp, check, deadline
from warpsar.scene.scene import Scene
from warpsar.world.world import refuse_both_kinds

GLANCE = 3  # iterations of a first fit, on one part alone, by which the likeliest is chosen
FEW, FEWER = 10, 3  # views of that fit, and of the choice where it begins
LAST = 6  # of the fit of all views at the end, which begins where the others ended
PAYS = 2.0  # standard errors that an effect is worth at the end
DRAWS = 2  # of rays, on which an effect is left out at the end, if the first does not tell
MATTERS = 0.05  # gain of a trial from which on sizes and angles are moved beside it; after smaller ones, at the end
GEOMETRY = "sizes and angles"
FRONT_ERRORS = 2.0  # standard errors by which a body predicts better than turned round, where its front is told
CERTAIN = 4.0  # standard errors from which on a front, or what an effect is worth, is not asked again
EXPLAINED = 2.0  # standard errors above the deviance of speckle, within which nothing else is left
BOXED = "a box of its size"
GAINS = "the gain of each effect at the end"
RIVALS = "whether the body turned round, or a box of its size, predicts as well"
BEATEN = "a box of its size predicts as well"
SEARCHED = f"{BOXED}, by a search of its own"


@dataclass(frozen=True)
class TrialStep:
    """One trial: its gain in the deviance of views left out (1 is what speckle leaves), with its standard error over
    views and arcs, the noise that it had to pass, and whether it stays. `glance`: of the first part's views alone.
    `again`: what an effect of the model is worth at the end; its error has the scatter over draws of rays, too."""

    label: str
    gain: float
    error: float
    noise: float
    stays: bool
    glance: bool = False
    again: bool = False

    @property
    def open(self) -> bool:
        """Whether it goes, and may be true nonetheless: it gained, and no more than its uncertainty; or it was held
        before, and leaving it out did no good that is sure."""
        least = -self.error if self.again else self.error
        return not self.stays and not self.glance and self.gain > least


@dataclass
class Model:
    """A scene for each part that is left out, and the scores of the views, in order of azimuth, by the scene that has
    not seen them. `again`: the same model fitted with nothing new on other rays; None until it is asked for."""

    scenes: list[Scene]
    scores: np.ndarray
    again: Model | None = None


@dataclass(frozen=True)
class _Ends:
    """Fitted scenes of some parts, scores, and which of several starts they began from."""

    scenes: list[Scene]
    scores: np.ndarray
    start: int = 0


@dataclass(frozen=True)
class Added:
    """An effect of the model, or more of one: the keys that its table got, none for the whole table."""

    effect: str
    keys: frozenset[str] = frozenset()

    def taken_from(self, scene: Scene) -> Scene:
        """The scene without it."""
        table = {key: value for key, value in scene.effects[self.effect].items() if key not in self.keys}
        rest = {name: one for name, one in scene.effects.items() if name != self.effect}
        return replace(scene, effects=rest | ({self.effect: table} if self.keys else {}))


@dataclass
class HeldOut:
    """What was found. `declared` and `final`: the scene of the file fitted, and with all that stays, fitted to all
    train views. `folds` have the names of the views left out together. `before` and `after`: deviances of the views
    left out, by name, in order of azimuth. `images`: the views left out beside all that predicts them. `rivals`:
    whether there are bodies, which meet a box of their size. `fronts`: by body, its trial against itself turned round.
    `box_held`: what the box's own search found; None where it had none. `untold`: effects of which the views do not
    tell whether they are there. `not_asked`: what a limit of time left out. `ended`: why the search ended before every
    effect was asked. `counting`: how azimuths are counted, where that is not as they are stated; the scenes have them
    clockwise from the front."""

    scene: Scene
    declared: Scene
    final: Scene
    folds: list[list[str]]
    steps: list[TrialStep]
    profiles: dict[str, Profile]
    before: dict[str, float]
    after: dict[str, float]
    images: list[PredictedImage]
    rivals: bool = False
    fronts: dict[str, TrialStep] = field(default_factory=dict)
    box_held: list[str] | None = None
    held: list[str] = field(default_factory=list)
    untold: list[str] = field(default_factory=list)
    not_asked: list[str] = field(default_factory=list)
    ended: str = ""
    counting: Counting | None = None

    @property
    def pulls(self) -> list[Pull]:
        """The sizes and angles that were moved, beside their tolerances."""
        return [one.pull for one in self.profiles.values()]

    @property
    def of_pictures(self) -> Advantage | None:
        """How far ahead the model is of pictures of other views."""
        return advantage(self.images)

    @property
    def of_box(self) -> Advantage | None:
        """How far ahead of a box of the body's size the model is that met it; None where none was asked."""
        then = bool(self.images) and THEN in self.images[0].predictions
        return advantage(self.images, THEN if then else "model", rivals=(BOX,))

    @property
    def advantages(self) -> list[Advantage]:
        return [one for one in (self.of_pictures, self.of_box) if one is not None]

    @property
    def undecided(self) -> bool:
        """Whether a body has not met its box at its best, so that no lead can be claimed."""
        box = self.of_box
        return self.rivals and (box is None or (box.ahead and self.box_held is None))

    @property
    def explained(self) -> bool:
        """Whether the views left out have nothing but speckle left. A box may then be what the body is."""
        return _is_speckle(np.array(list(self.after.values())))

    @property
    def open(self) -> bool:
        """Whether it is not ahead, and no rival surely predicts as well either."""
        failed = [one for one in self.advantages if not one.ahead]
        return not self.ahead and not self.undecided and all(one.open for one in failed)

    @property
    def ahead(self) -> bool:
        """Whether no rival predicts as well; a box may, where nothing but speckle is left."""
        pictures, box = self.of_pictures, self.of_box
        better = pictures is None or pictures.ahead
        return better and not self.undecided and (box is None or box.ahead or self.explained)


class FoldSearch:
    """The trials on one scene."""

    def __init__(
        self,
        scene: Scene,
        device: wp.Device,
        parts: int,
        progress: Callable[[], object],
        log: RunLog | None = None,
        time_limit_s: float | None = None,
        *,
        of_rival: bool = False,
    ) -> None:
        """`of_rival`: it is the search of a rival, which meets none itself."""
        self._log, self._time_limit_s = log or RunLog(), time_limit_s
        self._whose = f"{BOXED}: " if of_rival else ""
        self._model: Model
        self._rivals: dict[str, Model] = {}  # as they were asked last
        self._met: Model | None = None  # the model that the box was asked beside
        self._faced: Model | None = None  # the model that the bodies turned round were asked beside
        self._fronts: dict[str, TrialStep] = {}
        self._box_held: list[str] | None = None
        self._glints = 0  # taken, if they stay
        self._doing = ""
        self.not_asked: list[str] = []  # what a limit of time left out, in words
        self.ended = ""  # why, before every effect was asked
        self.trained, self.device, self._progress = TrainViews(scene, device), device, progress
        self.folds = folds(self.trained.views, parts)
        self._counting = None if of_rival else counted(self.trained)
        if self._counting is not None:
            console.say(self._counting.words)
            self.trained = TrainViews(self._counting.of(scene), device)
            self.folds = folds(self.trained.views, parts)
        self.fits = FitRays(device)
        self.start = self.trained.scene
        self.order = [view.name for view in by_azimuth(self.trained.views)]
        self._arcs = arcs_of(len(self.order), len(self.folds))
        self.numbers = numbers(self.start)
        self.bodies = [] if of_rival else bodies(self.start)
        self.steps: list[TrialStep] = []
        self.profiles: dict[str, Profile] = {}
        self.held: list[str] = [] if self._counting is None else [self._counting.label]
        self._added: dict[str, Added] = {}
        self._glanced: dict[str, tuple[float, float, dict[str, Any], bool]] = {}

    def run(self) -> HeldOut:
        """Fit, try, fit again; until the time is over: then what was found so far stands."""
        started, limit_s = time.monotonic(), self._time_limit_s
        first = self._model = self._surely_fitted([self.start] * len(self.folds))
        console.say(f"as declared: deviance of views left out {first.scores.mean() / EXPECTED:.3f}")
        try:
            with deadline(None if limit_s is None else max(limit_s - (time.monotonic() - started), 0.0)):
                self._search()
        except TimeUp:
            unmet = [GAINS] if self._not_again() else []
            unmet += [RIVALS] if self.bodies and self._met is None else []
            self.not_asked = list(dict.fromkeys([self._doing, *unmet]))
            console.say(f"the time is over; not asked: {'; '.join(self.not_asked)}")
        model, boxed, met = self._model, self._rivals.get(BOX), self._met
        self._progress()
        models = {"model": model.scenes, "before": first.scenes}
        if boxed is not None and met is not None:
            models |= {BOX: boxed.scenes} | ({} if met is model else {THEN: met.scenes})
        final = self._of_all_views(model)
        doubted = [one.label for one in self._not_again() if one.gain <= PAYS * one.error]
        return HeldOut(
            scene=self.trained.whole,
            declared=self.trained.finished(first.scenes[0]),
            final=self.trained.finished(final),
            folds=self.folds,
            steps=self.steps,
            profiles=self.profiles,
            before=self._by_name(first.scores),
            after=self._by_name(model.scores),
            images=self._images(models),
            rivals=bool(self.bodies),
            fronts=self._fronts,
            box_held=self._box_held,
            held=[label for label in dict.fromkeys(self.held) if label not in doubted],
            untold=[*self._untold(), *doubted],
            not_asked=self.not_asked,
            ended=self.ended,
            counting=self._counting,
        )

    def _untold(self) -> list[str]:
        """The effects whose last trial told nothing."""
        last = {one.label: one for one in self.steps if one.label in self._glanced}
        return [label for label, one in last.items() if one.open and label not in self.held]

    def _not_again(self) -> list[TrialStep]:
        """The trials of effects of the model that were not asked again at the end."""
        last = {one.label: one for one in self.steps if one.label in self._added}
        return [one for one in last.values() if not one.again]

    def _search(self) -> None:
        refused: set[str] = set()
        offsets: Sequence[float] = WIDE
        pending = True
        while True:
            self._doing = "whether another effect is missing"
            model = self._turn(self._model, refused)
            if model is None:
                break
            self._model, pending = model, True
            if self.steps[-1].gain > MATTERS:
                offsets, pending = self._geometry(offsets), False
                if self._met is None:
                    self._ask_fronts()
                    self._meet_box()
                    if self._beaten():
                        self.ended = BEATEN
                        console.say(f"the search ends: {BEATEN}")
                        return
        if pending:
            self._geometry(offsets)
        if self._faced is not self._model:
            self._ask_fronts()
        self._doing = GAINS
        self._model = self._asked_again(self._model)
        self._ask_glints()
        if self._met is not self._model:
            self._meet_box()
        if self._ahead_of_box():
            self._search_box()

    def _images(self, models: Mapping[str, Sequence[Scene]]) -> list[PredictedImage]:
        """The views left out beside what models that have not seen them predict, and beside the rivals."""
        images = []
        for part, left in enumerate(self.folds):
            scenes = {name: scenes[part] for name, scenes in models.items()}
            images += self.trained.beside(scenes, left, self._rest(part))
        return images

    def _by_name(self, scores: np.ndarray) -> dict[str, float]:
        return dict(zip(self.order, (scores / EXPECTED).tolist(), strict=True))

    def _rest(self, part: int) -> list[str]:
        return [name for name in self.trained.names if name not in self.folds[part]]

    def _scored(self, scenes: Sequence[Scene], first: np.ndarray | None = None) -> np.ndarray:
        """The scores of all views; `first` are those of the first part where they are known."""
        check()
        scores: dict[str, float] = {}
        for part, (scene, left) in enumerate(zip(scenes, self.folds, strict=True)):
            own = first if first is not None and not part else self.trained.scores(scene, left)
            scores |= dict(zip(left, own.tolist(), strict=True))
        return np.array([scores[name] for name in self.order])

    def _fitted(
        self,
        starts: Sequence[Scene],
        enough: Callable[[np.ndarray], bool] = lambda scores: False,
        other: Sequence[Scene] | None = None,
    ) -> Model | None:
        """The model fitted, the first part by all cores, the others side by side. None where the scores of the first
        part's views, in their order in the fold, are `enough` to know. With `other` starts, from those that the first
        part's fit ends lower from."""
        choices = [starts] if other is None else [starts, other]

        def tasks(choice: Sequence[Scene], parts: range) -> list[Callable[[], FittedViews]]:
            return [partial(self.fits.fitted, choice[part], self._rest(part)) for part in parts]

        def first_part() -> _Ends:
            fits = [task for choice in choices for task in tasks(choice, range(1))]
            ends = list(threads.ordered(fits, self.device))
            best = int(np.argmin([one.loss for one in ends]))
            scene = ends[best].scene
            return _Ends([scene], self.trained.scores(scene, self.folds[0]), best)

        def rest() -> _Ends:
            fits = tasks(choices[ahead.start], range(1, len(starts)))
            scenes = [one.scene for one in threads.ordered(fits, self.device)]
            return _Ends(scenes, self._scored([*ahead.scenes, *scenes], ahead.scores))

        ahead = self._kept(first_part)
        self._progress()
        if enough(ahead.scores):
            return None
        whole = self._kept(rest)
        self._progress()
        return Model([*ahead.scenes, *whole.scenes], whole.scores)

    def _kept(self, run: Callable[[], _Ends]) -> _Ends:
        """What `run` gives, or gave in an earlier part of the run."""
        return self._log.following(
            run,
            lambda found: {
                "scenes": [scene_content(self.start, one) for one in found.scenes],
                "scores": found.scores.tolist(),
                "start": found.start,
            },
            lambda entry: _Ends(
                [scene_of(self.start, one) for one in entry["scenes"]], np.array(entry["scores"]), entry["start"]
            ),
        )

    def _scored_moved(self, now: Sequence[Scene], change: Callable[[Scene], Scene]) -> np.ndarray:
        """The scores of the models changed by a function."""
        return self._log.following(
            lambda: self._scored([change(scene) for scene in now]), lambda found: found.tolist(), np.array
        )

    def _surely_fitted(self, starts: Sequence[Scene], other: Sequence[Scene] | None = None) -> Model:
        model = self._fitted(starts, other=other)
        assert model is not None
        return model

    def _again(self, model: Model) -> Model:
        """The model fitted with nothing new, on other rays."""
        if model.again is None:
            model.again = self._surely_fitted([with_other_rays(scene) for scene in model.scenes])
        return model.again

    def _of_first(self, model: Model) -> np.ndarray:
        """A model's scores of the first part's views, in their order in the fold."""
        return model.scores[[self.order.index(name) for name in self.folds[0]]]

    def _noise(self, model: Model) -> float:
        """What a fit with nothing new gains: its mean, if it gains, and one standard error; 0 where none was made."""
        if model.again is None:
            return 0.0
        mean, error = mean_and_error(model.scores - model.again.scores, self._arcs)
        return max(mean, 0.0) + error

    def _judged(self, label: str, model: Model, scores: np.ndarray, *, refitted: bool = True) -> bool:
        """Whether a trial with these scores stays. One that is not `refitted` has no noise to pass."""
        mean, error = mean_and_error(model.scores - scores, self._arcs)
        if refitted and mean > error:
            self._again(model)
        noise = self._noise(model) if refitted else 0.0
        self.steps.append(
            TrialStep(label, mean / EXPECTED, error / EXPECTED, noise / EXPECTED, bool(mean - error > noise))
        )
        self._say()
        if self.steps[-1].stays:
            self.held.append(label)
        return self.steps[-1].stays

    def _say(self) -> None:
        one = self.steps[-1]
        verdict = "stays" if one.stays else "cannot be told here" if one.open else "goes"
        noise = f", noise {one.noise:.4f}" if one.noise else ""
        how = ("asked again, " if one.again else "") + ("first part, " if one.glance else "")
        what = "worth to" if one.again else "gain of"
        console.say(
            f"{self._whose}{one.label}: {how}{what} views left out {one.gain:+.4f} +- {one.error:.4f}{noise}: {verdict}"
        )

    def _turn(self, model: Model, refused: set[str]) -> Model | None:
        """Try the hypotheses in the order of a first fit, until one stays; None where none does.

        First fits of earlier turns order them at first. A gain hardly grows by what else was added, so that only the
        one ahead is fitted anew, until it is still ahead.
        """
        left = {one.label: one for one in hypotheses(model.scenes[0], self._level(model)) if one.label not in refused}
        dear = {label for label, one in left.items() if get(one.effect).follows_rays}
        new = [one for label, one in left.items() if label not in self._glanced and label not in dear]
        self._glance(model, new)
        fresh = {one.label for one in new}
        while left:
            # what follows rays anew is asked last: one fit of it costs as much as many others
            label = max(left, key=lambda one: (one not in dear, self._glanced.get(one, (0.0,))[0]))
            if label not in fresh:
                self._glance(model, [left[label]])
                fresh.add(label)
                continue
            gain, error, table, on_declared = self._glanced[label]
            one = left.pop(label)
            refused.add(label)
            if gain + error <= 0.0:
                self._refuse(label, gain, error)
                continue
            first = [one.started(scene, table, self.start if on_declared else scene) for scene in model.scenes]
            trial = self._fitted(first, partial(self._hopeless, label, model))
            if trial is not None and self._judged(label, model, trial.scores):
                had = frozenset(model.scenes[0].effects[one.effect]) if one.extension else frozenset(table)
                keys = frozenset(table) - had
                self._added[label] = Added(one.effect, keys)
                return trial
        return None

    def _refuse(self, label: str, gain: float, error: float, noise: float = 0.0) -> None:
        """A trial that the views of the first part tell to go."""
        self.steps.append(TrialStep(label, gain / EXPECTED, error / EXPECTED, noise / EXPECTED, False, True))
        self._say()

    def _hopeless(self, label: str, model: Model, scores: np.ndarray) -> bool:
        """Whether the first part's views gain no more than noise by a trial, one standard error included."""
        gain, error = mean_and_error(self._of_first(model) - scores)
        noise = self._noise(model)
        if gain + error > noise:
            return False
        self._refuse(label, gain, error, noise)
        return True

    def _asked_again(self, model: Model) -> Model:
        """The model without the effects that are worth nothing at its end, those that gained least first. With and
        without, it is fitted on from where it stands, on the same rays."""
        gains = {one.label: one.gain for one in self.steps if one.stays}
        for label in sorted(self._added, key=lambda one: gains[one]):
            if label not in self._added:
                continue  # gone with its effect
            one = self._added[label]
            step, without = self._worth(label, one, model)
            self.steps.append(step)
            self._say()
            if without is not None:
                model = without
                gone = [each for each, more in self._added.items() if more.effect == one.effect]
                for each in gone if not one.keys else [label]:
                    del self._added[each]
                    self.held.remove(each)
        return model

    def _worth(self, label: str, one: Added, model: Model) -> tuple[TrialStep, Model | None]:
        """What an effect of the model is worth: on one draw of rays where that is certain, else on `DRAWS`. The model
        without it, where it is not surely worth something."""
        first: list[tuple[float, float]] = []
        found: list[np.ndarray] = []
        without, full = None, model
        for _ in range(DRAWS):
            reduced, full = full, self._again(full)

            def enough(scores: np.ndarray, full: Model = full) -> bool:
                first.append(mean_and_error(scores - self._of_first(full)))
                return not found and first[-1][0] > CERTAIN * first[-1][1]

            bare = self._fitted([one.taken_from(with_other_rays(scene)) for scene in reduced.scenes], enough)
            if bare is None:
                worth, error = first[-1]
                return TrialStep(label, worth / EXPECTED, error / EXPECTED, 0.0, True, True, True), None
            without = without or bare
            found.append(bare.scores - full.scores)
            worth, error = over_draws(found, self._arcs)
            if abs(worth) > CERTAIN * error:
                break
        stays = worth > PAYS * error
        step = TrialStep(label, worth / EXPECTED, error / EXPECTED, 0.0, stays, False, True)
        return step, None if stays else without

    def _level(self, model: Model) -> float:
        images = predicted(model.scenes[0], self.trained.views[:1], self.device)
        return level_of([plane for image in images for plane in image.values()])

    def _glance(self, model: Model, some: Sequence[EffectHypothesis]) -> None:
        """A first fit of each on the first part, with the aim points held: the gain of the views left out, its standard
        error, the table where it begins, and whether on the declared surface. An effect that follows rays anew
        is fitted only where a trace of it, on few rays, makes some views left out better: a fit takes minutes."""
        level, rest = self._level(model), self._rest(0)
        few, fewer = (_spread(rest, count) for count in (FEW, FEWER))
        ahead = [name for name in self.order if name in self.folds[0]]
        own = np.array([score for name, score in zip(self.order, model.scores, strict=True) if name in self.folds[0]])
        scene = model.scenes[0]

        def traced(one: EffectHypothesis, tables: list[dict[str, Any]]) -> tuple[float, float, dict[str, Any], bool]:
            thin = with_few_rays(scene)
            scored = partial(self.trained.scores, names=_spread(ahead, FEWER), coarse=True)
            gains = [scored(thin) - scored(one.started(thin, one.trace_of(table), thin)) for table in tables]
            best = int(np.argmax([gain.mean() for gain in gains]))
            return *mean_and_error(gains[best]), tables[best], False

        def glance(one: EffectHypothesis) -> tuple[float, float, dict[str, Any], bool]:
            tables = one.tables(scene, level)
            if get(one.effect).follows_rays:
                mean, error, table, on_declared = traced(one, tables)
                if mean + error <= 0.0:
                    return mean, error, table, on_declared
            if len(tables) > 1:
                losses = [self.fits.loss_at_start(one.started(scene, table, scene), fewer) for table in tables]
                tables = [tables[int(np.argmin(losses))]]
            surfaces = [scene] if one.extension else [scene, self.start]
            ends = [
                self.fits.fitted(one.started(scene, tables[0], surface), few, GLANCE, aimed=False)
                for surface in surfaces
            ]
            best = int(np.argmin([end.loss for end in ends]))
            mean, error = mean_and_error(own - self.trained.scores(ends[best].scene, ahead))
            return mean, error, tables[0], best == 1

        def seen() -> list[tuple[float, float, dict[str, Any], bool]]:
            return list(threads.ordered([partial(glance, one) for one in some], self.device))

        found = self._log.following(seen, list, lambda entry: [tuple(one) for one in entry])
        for one, each in zip(some, found, strict=True):
            self._glanced[one.label] = each
        self._progress()

    def _geometry(self, offsets: Sequence[float]) -> Sequence[float]:
        """Move sizes and angles, one after the other, and fit all else anew where that pays. Returns the places of the
        next profiles."""
        if not self.numbers:
            return offsets
        self._doing = GEOMETRY
        now, profiles = self._profiled(self._model.scenes, self.numbers, offsets)
        moved = Model(now, self._scored_moved(now, lambda scene: scene))
        if not self._judged(GEOMETRY, self._model, moved.scores, refitted=False):
            return offsets
        self.profiles |= profiles
        for one in profiles.values():
            console.say(
                f"  {self._whose}{one.label}: {one.value:.4g} +- {one.half:.2g} {one.unit}, known as {one.known:.4g}"
            )
        # what was fitted to other sizes would make anything seem likely that is fitted next
        self._model = min(moved, self._surely_fitted(now), key=_mean_score)
        return NEAR

    def _profiled(
        self, scenes: Sequence[Scene], some: Sequence[Number], offsets: Sequence[float]
    ) -> tuple[list[Scene], dict[str, Profile]]:
        """The scenes with some numbers moved, one after the other, and their profiles."""
        now, weight, profiles = list(scenes), 0.5 * self._draws(), {}
        for number in some:

            def scored(change: Callable[[Scene], Scene]) -> np.ndarray:
                return self._scored_moved(now, change)  # noqa: B023 - called at once

            profiles[number.label], by = profiled(number, now[0], offsets, scored, weight)
            now = [number.moved(scene, by) for scene in now]
            self._progress()
        return now, profiles

    def _ask_fronts(self) -> None:
        """Turn bodies round where that predicts better. One whose front is certain is not asked again."""
        self._doing = RIVALS
        for label in turnable(self.start):
            name, before = f"{label} {TURNED}", self._fronts.get(label)
            if before is not None and abs(before.gain) > CERTAIN * before.error:
                continue
            rival, profiles = self._rival(name, partial(turned, label=label))
            model = self._model
            stays = self._judged(name, model, rival.scores)
            step = self.steps[-1]
            if stays:
                self._rivals[name], self._model = model, rival
                self.profiles |= profiles
                step = replace(step, gain=-step.gain)
            self._fronts[label] = step
        self._faced = self._model

    def _ask_glints(self) -> None:
        """Glints of the bodies, in each part by its own train views. All else is held, as where sizes are moved: a
        fit bounds the loss of bright pixels, so it does not tell how strong glints are."""
        self._doing = GLINTS
        scenes = self._model.scenes
        if len(self.order) < FEWEST_VIEWS or not bodies(self.start) or GLINTS in scenes[0].effects:
            return

        found, count = self._log.following(
            partial(found_by_parts, self.trained, scenes, self.folds),
            lambda found: {"points": [[one.row for one in part] for part in found[0]], "count": found[1]},
            lambda entry: ([glints_of(part) for part in entry["points"]], entry["count"]),
        )
        if not count:
            self.steps.append(TrialStep(GLINTS, 0.0, 0.0, 0.0, False))
            self._say()
            return
        moved = [with_glints(scene, some) for scene, some in zip(scenes, found, strict=True)]
        scores = self._scored_moved(moved, lambda scene: scene)
        if self._judged(GLINTS, self._model, scores, refitted=False):
            self._glints, self._model = count, Model(moved, scores)

    def _of_all_views(self, model: Model) -> Scene:
        """The model fitted to all train views, with as many glints as they pay for, found in all of them."""
        scene = model.scenes[0]
        if self._glints:
            scene = Added(GLINTS).taken_from(scene)
        whole = self.fits.fitted(scene, self.trained.names, LAST).scene
        return with_glints(whole, found_in_all(self.trained, whole, self._glints)) if self._glints else whole

    def _meet_box(self) -> None:
        """Hold the model against itself with every body as a box."""
        if not self.bodies:
            return
        self._doing = RIVALS
        self._rivals[BOX] = self._boxed()
        self._met = self._model
        self._step_of_box(BOXED)

    def _search_box(self) -> None:
        """Take the box through a search of its own, from the surface and the effects of the file; the better of the two
        boxes is the rival. It has the body's sizes as they were found."""
        self._doing = SEARCHED
        console.say(f"{SEARCHED}: effects that were chosen for the body hold it below its best")
        whole, found = self.trained.whole, self.trained.finished(self._model.scenes[0])
        boxed = as_box(replace(found, materials=whole.materials, effects=whole.effects), self.bodies)
        search = FoldSearch(boxed, self.device, len(self.folds), self._progress, self._log, of_rival=True)
        search._model = search._surely_fitted([search.start] * len(self.folds))
        search._search()
        self._rivals[BOX] = min((self._rivals[BOX], search._model), key=_mean_score)
        self._box_held = list(dict.fromkeys(search.held))
        self._step_of_box(SEARCHED)

    def _step_of_box(self, label: str) -> None:
        assert self._met is not None
        gain, error = mean_and_error(self._met.scores - self._rivals[BOX].scores, self._arcs)
        self.steps.append(TrialStep(label, gain / EXPECTED, error / EXPECTED, 0.0, False))
        self._say()

    def _beaten(self) -> bool:
        """Whether the box that the model met predicts as well, and more than speckle is left. A body that is declared
        as a box is its own rival, which says nothing before the end."""
        if self._met is None or _is_speckle(self._met.scores / EXPECTED):
            return False
        margin = self._over_box()
        return margin is not None and margin.correlation <= SURE * margin.error and margin.deviance <= 0.0

    def _ahead_of_box(self) -> bool:
        margin = self._over_box()
        return margin is not None and margin.ahead

    def _over_box(self) -> Advantage | None:
        """How far the model that met the box is ahead of it; None where none was met, or the body is a box itself."""
        if self._met is None or self._met is self._rivals[BOX]:
            return None
        return advantage(self._images({"model": self._met.scenes, BOX: self._rivals[BOX].scenes}), rivals=(BOX,))

    def _boxed(self) -> Model:
        """The rival that has every body as a box of its size. Bodies that are boxes are their own rivals."""
        if all(one.primitive == "box" for one in self.start.objects if one.label in self.bodies):
            return self._model
        return self._rival(BOX, lambda scene: as_box(scene, self.bodies))[0]

    def _rival(self, name: str, made: Callable[[Scene], Scene]) -> tuple[Model, dict[str, Profile]]:
        """A rival of the model at its best: as `made` of the model, or as it was when it was asked last; its sizes and
        the angle of the views moved, and all else fitted, from there and from the declared surface. With its profiles.
        """
        first = [made(scene) for scene in self._model.scenes]
        offsets: Sequence[float] = WIDE
        if name in self._rivals:
            pairs = zip(self._rivals[name].scenes, self._model.scenes, strict=True)
            first = [replace(rival, materials=one.materials, effects=one.effects) for rival, one in pairs]
            offsets = NEAR
        mine = {one.label: one for one in self.numbers}
        own = [mine.get(one.label, one) for one in numbers(first[0])]
        free = [one for one in own if one.parameter.root == "views" or one.parameter.owner in self.bodies]
        now, profiles = self._profiled(first, free, offsets)
        # the rival at its best: the body's surface may lead it into a valley
        self._rivals[name] = self._surely_fitted(now, [as_declared(self.start, scene) for scene in now])
        return self._rivals[name], profiles

    def _draws(self) -> float:
        """Independent draws of speckle in a view: its pixels over those that share a draw by the point spread."""
        scene = self.start
        widths = response_of(declared(scene, scene.views[0])).width_m
        shared = [max((width or 0.0) / step, 1.0) for width, step in zip(widths, scene.grid.spacing_m, strict=True)]
        return float(np.prod(scene.grid.shape)) / float(np.prod(shared))


def _mean_score(model: Model) -> float:
    return float(model.scores.mean())


def _is_speckle(deviances: np.ndarray) -> bool:
    mean, error = mean_and_error(deviances)
    return mean <= 1.0 + EXPLAINED * error


def _spread(names: Sequence[str], count: int) -> list[str]:
    """So many of the names, evenly."""
    return [names[int(k)] for k in np.linspace(0, len(names), min(count, len(names)), endpoint=False)]


def held_out(
    scene: Scene, device: wp.Device, parts: int, log: RunLog | None = None, time_limit_s: float | None = None
) -> HeldOut:
    """What the scene's model lacks, by train views left out in so many parts. `log` may be of an earlier part of the
    run; the search ends after `time_limit_s` with what it has found.

    Raises InputError for fewer than two train views for each part, and for curves beside images.
    """
    refuse_both_kinds(scene)
    bar = console.progress(0, "diagnose", "step")
    try:
        return FoldSearch(scene, device, parts, bar.update, log, time_limit_s).run()
    finally:
        bar.close()
