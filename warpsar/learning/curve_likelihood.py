"""What measured curves of radar cross-section say of numbers of a scene: a likelihood, with slopes and information."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.compare.curve import CurveComparison
from warpsar.curves.noise import Noises, fit
from warpsar.curves.observe import PER_DIRECTION, observe
from warpsar.curves.observed import ObservedCurve
from warpsar.parameters.at import at
from warpsar.parameters.parameter import Parameter
from warpsar.runtime import once
from warpsar.scene.scene import Scene

STEP = 1e-2  # of a coordinate, up and down
KEPT = 50  # places whose curves are kept


class CurveLikelihood:
    """The negative log-likelihood of a scene's train curves over the coordinates x of some of its numbers, shape (p,).

    The noise is at its likeliest for each x, as where curves are fitted alone, so by the envelope theorem it adds
    nothing to a gradient. Gradients are differences, `STEP` of a coordinate to either side. The information comes from
    those of the normal scores (`CurveComparison.residual`), which have the variance 1 where model and noise
    are right.
    """

    def __init__(
        self,
        scene: Scene,
        parameters: Sequence[Parameter],
        cache: Path | None = None,
        device: str | None = None,
        per_direction: float = PER_DIRECTION,
    ) -> None:
        """`cache` and `per_direction` as in `observe`."""
        self.scene = replace(scene, curves=tuple(curve for curve in scene.curves if curve.role == "train"))
        self.parameters = list(parameters)
        self._cache, self._device, self._per_direction = cache, device, per_direction
        self._known: dict[bytes, tuple[float, list[ObservedCurve], Noises]] = {}

    def value(self, x: NDArray[np.float64]) -> float:
        """The negative log-likelihood at x."""
        return float(once.find(lambda: self._at(x)[0]))

    def slopes(
        self, x: NDArray[np.float64], directions: NDArray[np.float64] | None = None, *, one_sided: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The gradient at x along `directions`, shape (k,), and the Fisher information, shape (k, k).

        `directions` has the shape (k, p), by default every coordinate. `one_sided`: by half as many sweeps, for a step
        that the next one corrects.
        """
        along = np.eye(x.size) if directions is None else directions
        gradient, information = once.find(lambda: self._slopes(x, along, one_sided))
        return np.asarray(gradient), np.asarray(information)

    def moved(self, scene: Scene, x: NDArray[np.float64]) -> Scene:
        """The scene with its numbers at x."""
        values = {one: one.transform.from_coordinate(float(u)) for one, u in zip(self.parameters, x, strict=True)}
        return replace(scene, materials=at(scene, values).materials)

    def _at(self, x: NDArray[np.float64]) -> tuple[float, list[ObservedCurve], Noises]:
        """The negative log-likelihood, the curves beside the model, and their noise; kept for each place."""
        if x.tobytes() not in self._known:
            curves = observe(
                self.moved(self.scene, x), cache=self._cache, device=self._device, per_direction=self._per_direction
            )
            fitted = fit(curves, self.scene.radar.terms)
            if len(self._known) >= KEPT:
                self._known.clear()
            self._known[x.tobytes()] = -fitted.log_likelihood, curves, fitted.noise
        return self._known[x.tobytes()]

    def _slopes(
        self, x: NDArray[np.float64], along: NDArray[np.float64], one_sided: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        gradient, scores = np.zeros(len(along)), list[NDArray[np.float64]]()
        here, curves, noise = self._at(x)
        apart = STEP if one_sided else 2.0 * STEP
        below = here, self._scores(curves, noise)
        for place, direction in enumerate(along):
            ends = []
            for sign in (1.0,) if one_sided else (1.0, -1.0):
                value, beside, _ = self._at(x + sign * STEP * direction)
                ends.append((value, self._scores(beside, noise)))
            up, down = ends[0], below if one_sided else ends[1]
            gradient[place] = (up[0] - down[0]) / apart
            scores.append((up[1] - down[1]) / apart)
        weight = np.concatenate([one.weight for one in curves])
        slopes = np.array(scores).reshape(len(along), weight.size)
        return gradient, (slopes * weight) @ slopes.T

    def _scores(self, curves: Sequence[ObservedCurve], noise: Noises) -> NDArray[np.float64]:
        """Normal scores of all rows beside a noise that stands."""
        terms = self.scene.radar.terms
        return np.concatenate([CurveComparison(one, terms, noise[one.polarization]).residual for one in curves])
