"""What views that no parameter of an effect has seen say of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from warpsar.compare.observation import Observation
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.refit import Fitted, descend
from warpsar.learning.results import learned_scene
from warpsar.runtime import once
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import loss_terms
from warpsar.speckle.residual import residual_autocovariance

BLOCK = 8  # columns: what a view's own parameters are fitted on and judged on alternates
# Share of a gain that is gained again by letting a view's own parameter vary over its columns: at most, and where the
# parameter is plainly one value. At one look the rows of an interference reach 0.12, and a mover's smear 0.33.
VARIES, EVEN = 0.5, 0.25
# Log-likelihood at which one pixel's difference is cut off. Otherwise a few bright pixels are all of the sum and of
# its error.
LARGEST_DIFFERENCE = 20.0


@dataclass(frozen=True)
class ViewsLeftOut:
    """Log-likelihood of views that were left out, with an effect less without it: sum and standard error. `expected`
    is that sum on average, were the effect true as the other views have it. `quiet`: whether nothing but speckle is
    left beside the effect, to the scan. `uneven`: of numbers of single views, the share of their gain that they gain
    again where they may vary over a view's columns; None for numbers of all views."""

    gain: float
    error: float
    views: int
    expected: float = float("inf")
    quiet: bool = False
    uneven: float | None = None

    @property
    def passed(self) -> bool:
        """More than two standard errors above zero; with a single view nothing can be left out.

        A true effect gains half of its 2 ln L, with an error of about the root of that. So a weak one is hardly two
        errors above zero, and views left out cannot decide. They can still speak against it: asked is then a gain that
        is positive, and no more than two errors below what the effect predicts. Where the scan is not quiet, something
        else is missing that any weak effect may feed on, and two errors are asked.

        Numbers of single views lie in few pixels, whose scatter makes the error large. The same power in all columns
        is what sets them apart from something that stands there, so one and a half errors are enough then.
        """
        asked = (1.5 if self.uneven is not None and self.uneven < EVEN else 2.0) * self.error
        if self.quiet:
            asked = max(0.0, min(asked, self.expected - 2.0 * self.error))
        return self.views < 2 or self.gain > asked

    @property
    def varies(self) -> bool:
        """Whether numbers of single views are no properties of those views."""
        return self.uneven is not None and self.uneven > VARIES


def leave_one_view_out(
    setup: FitSetup, base: Fitted, fitted: Fitted, effect: str, *, quiet: bool = False
) -> ViewsLeftOut:
    """Explain each training view by both models, with the parameters of `effect` taken from the other views.

    `quiet` as in `ViewsLeftOut`. Pixels are compared in pairs; each counts `LARGEST_DIFFERENCE` at most. The error has
    two parts: correlated speckle, and the choice of pixels. A few pixels that gain much are no proof.

    Everything else in both models is a nuisance and is fitted to all views. A surface that has never seen a view's
    incidence extrapolates badly, and that error would decide. Parameters of a single view (its gain, its interference)
    cannot come from the others. Both models are then fitted on every other block of the view's columns, and judged on
    the blocks between.
    """
    names = [view.view.name for view in fitted.problem.views]
    if len(names) < 2:
        return ViewsLeftOut(0.0, 0.0, len(names))
    own = [c for c in fitted.problem.effect_coordinates if c.effect == effect]
    per_view = all(c.view is not None for c in own)

    def judged(name: str) -> list[np.ndarray]:
        if per_view:
            models = (_by_halves(setup, base, name), _by_halves(setup, fitted, name))
        else:
            models = (
                _modelled(setup, base.scene, name),
                _modelled(setup, _with_the_others(setup, fitted, effect, name), name),
            )
        return [_gain(seen, *mu) for seen, *mu in zip(setup.observations[name], *models, strict=True)]

    # where each view has its own parameters, one without any has the same image with and without
    touched = [name for name in names if not per_view or any(c.view == name for c in own)]
    found = setup.share([partial(judged, name) for name in touched])
    seen = [one for name in touched for one in setup.observations[name]]
    gains = [gain for view in found for gain in view]
    all_of_them = summed(seen, gains, len(names), quiet)
    return replace(all_of_them, uneven=_over_columns(setup, base, fitted, effect)) if per_view else all_of_them


def summed(seen: Sequence[Observation], gains: Sequence[np.ndarray], views: int, quiet: bool) -> ViewsLeftOut:
    """The sum of what every pixel gains, with its error. `gains`, shape (2, n) for each observation: measured, and as
    it would be on average were the model true."""
    gains = [clipped(one) for one in gains]
    measured, expected = np.concatenate(gains, axis=1)
    covariance = residual_autocovariance([(one, now - mean) for one, (now, mean) in zip(seen, gains, strict=True)])
    error = np.sqrt(measured.size * (covariance.sum() + expected.var()))
    total, error, foreseen = once.decide([measured.sum(), error, expected.sum()]).tolist()
    return ViewsLeftOut(total, error, views, foreseen, quiet)


def _gain(seen: Observation, without: np.ndarray, with_it: np.ndarray) -> np.ndarray:
    """Log-likelihood that every pixel gains, and what it would gain on average if beta0 were `with_it`; (2, n)."""
    gains = [
        loss_terms("gamma", beta0, without, seen.looks) - loss_terms("gamma", beta0, with_it, seen.looks)
        for beta0 in (seen.values, with_it)
    ]
    return np.stack(gains)


def _with_the_others(setup: FitSetup, fitted: Fitted, effect: str, name: str) -> Scene:
    """The model with the effect as all views but `name` have it, and everything else as all views do."""
    problem = setup.problem(fitted.scene, [view for view in setup.observations if view != name])
    x, _, _ = descend(problem, [problem.x0], quick=True)
    known = dict(zip(problem.labels, x, strict=True))
    whole = setup.problem(fitted.scene)
    held = np.array([c.effect == effect for c in whole.effect_coordinates], bool)
    held = np.concatenate([np.zeros(whole.learned.size, bool), held])
    start = np.where(held, [known.get(label, at) for label, at in zip(whole.labels, whole.x0, strict=True)], whole.x0)
    x, _, _ = descend(whole, [start], ~held, quick=True)
    return learned_scene(whole, x)


def _by_halves(setup: FitSetup, model: Fitted, name: str) -> list[np.ndarray]:
    """beta0 of every pixel of each observation of a view, fitted to the other views and the other half of this."""
    images = [np.empty(seen.pixels.size) for seen in setup.observations[name]]
    for half in (0, 1):
        part = [replace(s, interior=s.interior & column_blocks(s, half)) for s in setup.observations[name]]
        problem = replace(setup, observations={**setup.observations, name: part}).problem(model.scene)
        x, _, _ = descend(problem, [problem.x0], quick=True)
        modelled = _modelled(setup, learned_scene(problem, x), name)
        for into, seen, mu in zip(images, setup.observations[name], modelled, strict=True):
            judged = ~column_blocks(seen, half)[seen.interior]
            into[judged] = mu[judged]
    return images


def _over_columns(setup: FitSetup, base: Fitted, fitted: Fitted, name: str) -> float:
    """Share of the gain of an effect's values for single views that is gained again where they may vary over columns.

    Each is fitted anew to each block of its view's columns. Something that lies in a few columns gains much so, such as
    a mover's smear along a range line.
    """
    views = dict.fromkeys(c.view for c in fitted.problem.effect_coordinates if c.effect == name and c.view is not None)

    def gained(view: str) -> float:
        held = setup.problem(fitted.scene, [view], dark=False)
        without = setup.problem(base.scene, [view], dark=False)
        return _lost(without.terms(without.modelled_as_declared()), held.terms(held.modelled(held.x0)))

    def regained(view: str, pixels: list[Observation]) -> float:
        part = replace(setup, observations={view: pixels}).problem(fitted.scene, [view], dark=False)
        own = [c.effect == name and c.view == view for c in part.effect_coordinates]
        moving = np.concatenate([np.zeros(part.learned.size, bool), np.array(own, bool)])
        x, _, _ = descend(part, [part.x0], moving, quick=True)
        return _lost(*(part.terms(part.modelled(at)) for at in (part.x0, x))) - 0.5 * sum(own)

    blocks = [(view, pixels) for view in views for pixels in _by_blocks(setup.observations[view])]
    tasks = [*(partial(gained, view) for view in views), *(partial(regained, *block) for block in blocks)]
    found = setup.share(tasks)
    once = sum(found[: len(views)])
    return sum(found[len(views) :]) / once if once > 0 else 1.0


def _by_blocks(seen: Sequence[Observation]) -> Iterator[list[Observation]]:
    """A view's observations, block of columns by block, where there are pixels."""
    block_of = np.arange(seen[0].interior.shape[1]) // BLOCK
    for block in range(block_of[-1] + 1):
        part = [replace(one, interior=one.interior & (block_of == block)) for one in seen]
        if any(one.interior.any() for one in part):
            yield part


def _lost(before: Sequence[np.ndarray], after: Sequence[np.ndarray]) -> float:
    return float(sum(clipped(a - b).sum() for a, b in zip(before, after, strict=True)))


def clipped(differences: np.ndarray) -> np.ndarray:
    """Log-likelihoods of pixels, each counting `LARGEST_DIFFERENCE` at most."""
    return np.clip(differences, -LARGEST_DIFFERENCE, LARGEST_DIFFERENCE)


def _modelled(setup: FitSetup, scene: Scene, name: str) -> list[np.ndarray]:
    """beta0 of every interior pixel of each observation of a view, of the scene as it stands."""
    problem = setup.problem(scene, [name], dark=False)
    modelled = problem.modelled_as_declared()
    return [gain * mu for mu, gain in zip(modelled, problem.gains(modelled), strict=True)]


def column_blocks(seen: Observation, half: int) -> np.ndarray:
    """Every other block of columns, shape of the image."""
    columns = np.arange(seen.interior.shape[1]) // BLOCK % 2 == half
    return np.broadcast_to(columns, seen.interior.shape)
