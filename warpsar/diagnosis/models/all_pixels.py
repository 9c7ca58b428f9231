"""Models compared on all usable pixels, lit or not, above a floor that they share.

A change of geometry lights some pixels and darkens others. On the lit pixels of one model alone, the other would be
judged by half of what it says.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import minimum_filter, uniform_filter

from warpsar.compare.observation import TRACE, Observation, usable_pixels
from warpsar.diagnosis.models.explained import Compared, Explained
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.left_out import column_blocks
from warpsar.diagnosis.models.movable import standing
from warpsar.diagnosis.models.refit import BOUND, Fitted, refit_as
from warpsar.learning.pose import Descended, PosedProblem, descend
from warpsar.learning.pose_pixels import FLOOR_SHARE, blurred, compared
from warpsar.runtime import once
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import bounded, loss_terms

SPECKLED = 6.0  # standard deviations of a pixel's speckle, which the mean of 3 x 3 pixels has at most


def log_likelihood(setup: FitSetup, fitted: Fitted, blur_m: float = 0.0) -> float:
    """Of all usable pixels above a common floor, with the model as it stands; each costs `BOUND` at most, about.

    The floor is a twentieth of the lit pixels' median. It stands in model and measurement alike, so it leaves the mean
    as it is, and pixels that measure 0 count. `blur_m`: full width at half maximum of a Gaussian that blurs both.
    """
    total = 0.0
    for seen, measured, mean, _ in _above_the_floor(setup, fitted, blur_m):
        total -= float(bounded(loss_terms("gamma", measured, mean, seen.looks), BOUND).sum())
    return float(once.decide(total))


def explained(setup: FitSetup, before: Fitted, after: Fitted) -> Explained:
    """How much of what is unlike speckle in a model another one explains, in the pixels in which they differ; on the
    pixels of `log_likelihood`."""
    first = list(_above_the_floor(setup, before))
    both = zip(first, _above_the_floor(setup, after), strict=True)
    found = Explained.of(
        Compared(seen.looks, measured, one, other, 0.5 * seen.law.expected_deviance * lit**2)
        for (seen, measured, one, lit), (_, _, other, _) in both
    )
    return Explained(float(once.decide(found.before)), float(once.decide(found.after)))


def _above_the_floor(
    setup: FitSetup, fitted: Fitted, blur_m: float = 0.0
) -> Iterator[tuple[Observation, np.ndarray, np.ndarray, np.ndarray]]:
    """Every image's usable pixels: measured and modelled power above the common floor, (n,) [beta0], and which share of
    the modelled power is no floor, and so has speckle."""
    modelled = fitted.problem.modelled(fitted.x)
    gains = iter(fitted.problem.gains(modelled))
    level = FLOOR_SHARE * float(
        np.median([np.median(s.values) for found in setup.observations.values() for s in found])
    )
    for view in fitted.problem.views:
        for seen in view.observations:
            image = float(next(gains)) * view.render.images[seen.polarization].numpy().reshape(seen.interior.shape)
            use = usable_pixels(fitted.scene, seen.view, seen.measured)
            both = (np.asarray(seen.measured, float), np.maximum(image.astype(float), 0.0))
            measured, mean = (blurred(fitted.scene.grid, each, blur_m)[use] + level for each in both)
            yield seen, measured, mean, 1.0 - level / mean


def lit_shadows(fitted: Fitted, far: bool = False) -> bool:
    """Whether a shadow of the model is none: 3 x 3 pixels that it does not light, nor their neighbours, measure more
    than it has there by a trace of the lit pixels' median, on average, and by more than the speckle of what it has.

    These pixels belong to no scan: a blur reaches them. Pixels farther than six from anything lit are dark ones, which
    have tests of their own; `far`: count them, too.
    """
    gains = iter(fitted.problem.gains(fitted.problem.modelled(fitted.x)))
    for view in fitted.problem.views:
        for seen in view.observations:
            image = float(next(gains)) * view.render.images[seen.polarization].numpy().reshape(seen.interior.shape)
            unlit = _shadow(fitted, view.render.lit(seen.polarization), seen)
            unlit &= far | ~seen.dark
            whole = minimum_filter(unlit.astype(np.uint8), size=3, mode="constant") > 0
            more, has = (
                uniform_filter(np.where(unlit, each, 0.0), size=3, mode="constant")
                for each in (seen.measured - image, image)
            )
            if (more > TRACE * np.median(seen.values) + SPECKLED / np.sqrt(seen.looks) * has)[whole].any():
                return True
    return False


def with_shadows(setup: FitSetup, fitted: Fitted) -> tuple[FitSetup, Fitted]:
    """All of a model's shadows in the place of dark pixels, where too few pixels are far from anything lit; and the
    model fitted to these, too.

    What adds power shows in shadows above all. Its level in the light is a surface's as well, so that lit pixels alone
    leave it open. Near what is lit a blur adds power, too: with far pixels there is no need for the near ones.
    """
    if setup.has_dark:
        return setup, fitted
    fitted.problem.modelled(fitted.x)
    observations, more = dict[str, list[Observation]](), False
    for view in fitted.problem.views:
        for seen in setup.observations[view.view.name]:
            lit = view.render.lit(seen.polarization)
            dark = once.decide(_shadow(fitted, lit, seen) & ~seen.interior & ~seen.silent) > 0
            more |= bool((dark & ~seen.dark).any())
            observations.setdefault(view.view.name, []).append(replace(seen, dark=seen.dark | dark))
    if not more:
        return setup, fitted
    made = replace(setup, observations=observations)
    return made, refit_as(replace(made, bound=fitted.problem.misfit.bound), fitted.scene)


def _shadow(fitted: Fitted, lit: np.ndarray, seen: Observation) -> np.ndarray:
    """Usable pixels of an image that the model does not light, nor their neighbours, (rows, cols) bool."""
    unlit = minimum_filter((~lit).astype(np.uint8), size=3) > 0
    return np.asarray(unlit & usable_pixels(fitted.scene, seen.view, seen.measured))


@dataclass(frozen=True)
class Exact:
    """Models by exact areas, without rays, on all usable pixels above a common floor: smooth in every pose.

    `pixels` are the frozen observations by view name. `gains`, by view name and polarization, are those of images that
    are not calibrated.
    """

    setup: FitSetup
    gains: Mapping[tuple[str, str], float]

    @classmethod
    def of(cls, setup: FitSetup, fitted: Fitted) -> Exact:
        """With the gains of a fitted model."""
        gains = fitted.problem.gains(fitted.problem.modelled(fitted.x))
        pairs = zip(fitted.problem.observations, gains, strict=True)
        return cls(setup, {(seen.view.name, seen.polarization): float(gain) for seen, gain in pairs})

    def problem(
        self,
        scene: Scene,
        views: Sequence[str] | None = None,
        blur_m: float = 0.0,
        bound: float = 0.0,
        half: int | None = None,
        on_ground: bool = True,
        rough: bool = False,
    ) -> PosedProblem:
        """What `learn` frees of the scene's geometry, with surface and effects; images blurred by `blur_m`. `bound` is
        that of the loss. `half`: of the pixels every other block of columns alone, the first or the second ones, and
        surface and effects held. Objects whose size is fitted stay `on_ground`. `rough` as in
        `PosedProblem`."""
        ready = scene if scene.assembly is not None else with_objects(scene, ())
        both = compared(ready, self.setup.observations, blur_m, self.gains)
        seen = {name: found for name, found in both.observations.items() if views is None or name in views}
        if half is not None:
            seen = {
                name: [replace(one, interior=one.interior & column_blocks(one, half)) for one in found]
                for name, found in seen.items()
            }
        return PosedProblem(
            both.scene,
            self.setup.device,
            seen,
            held=half is not None,
            level=both.level,
            standing=standing(both.scene) if on_ground else (),
            bound=bound,
            rough=rough,
        )

    def settled(
        self, scene: Scene, views: Sequence[str] | None = None, flat: float | None = None
    ) -> tuple[PosedProblem, Descended]:
        """Surface and effects at their best, and what `learn` of the scene's objects frees; `flat` as in `descend`."""
        problem = self.problem(scene, views)
        return problem, descend(problem, problem.x0, flat=flat)

    def images(self, problem: PosedProblem, x: np.ndarray, name: str) -> list[tuple[Observation, np.ndarray]]:
        """A view's observations and their modelled beta0 with its gain, shape (n,) each."""
        inner, rest = problem.split(x)
        modelled = inner.modelled(rest)
        pairs = zip(inner.observations, modelled, inner.gains(modelled), strict=True)
        return [(seen, gain * mu) for seen, mu, gain in pairs if seen.view.name == name]
