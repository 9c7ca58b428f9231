"""Surfaces learned from measured curves of radar cross-section: permittivities from curves alone, and curves beside
images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.coherent.left_out import left_out
from warpsar.compare.curve import CurveComparison, compare_curves, content_of
from warpsar.curves.noise import Noises, fit
from warpsar.curves.observe import observe
from warpsar.curves.observed import ObservedCurve
from warpsar.curves.shape import ProfileInterval, likelihood, on_grid, profiles
from warpsar.errors import InputError
from warpsar.learning.coordinates import SceneCoordinates
from warpsar.learning.geometry import freed
from warpsar.learning.prior import Beside
from warpsar.parameters.at import at
from warpsar.runtime import once
from warpsar.scene.scene import Scene
from warpsar.world.curve import Curve
from warpsar.world.mesh import read_mesh

STEP = 1e-2  # of a coordinate, up and down
KEPT = 50  # places whose curves are kept
PASSES = 2
POINTS = 9
FIRST_REACH = 1.6
"""Factor by which the first grid of a learned value reaches up and down.

Each further one reaches a third of its logarithm.
"""


class CurvesBeside:
    """The train curves of a scene beside its images, as a part of the same fit: what they say of x.

    The noise is at its likeliest for each x, as where curves are fitted alone, so by the envelope theorem it adds
    nothing to a gradient. Gradients are central differences, `STEP` of a coordinate to either side. The information
    comes from those of the normal scores (`CurveComparison.residual`), which have the variance 1 where model and noise
    are right.
    """

    def __init__(self, coordinates: SceneCoordinates, cache: Path | None = None, device: str | None = None) -> None:
        """Of the coordinates' scene; `cache` as in `observe`. Raises InputError for a field that a curve's body has."""
        scene = coordinates.scene
        self._scene = replace(scene, curves=tuple(curve for curve in scene.curves if curve.role == "train"))
        self._size, self._cache, self._device = coordinates.x0.size, cache, device
        names = {name for curve in self._scene.curves for name in _materials_of(scene, curve)}
        fields = [name for name in names if scene.materials[name].layout != "uniform"]
        if fields:
            raise InputError(
                f"{scene.name}: curves: found {fields[0]}, whose values are a field; beside images the material of a "
                f"curve must have one number for each"
            )
        own = [(place, one) for place, one in coordinates.numbers() if one.root == "materials" and one.owner in names]
        self._elements = np.array([place for place, _ in own], int)
        self._parameters = [one for _, one in own]
        self._known: dict[bytes, tuple[float, list[ObservedCurve], Noises]] = {}

    def value(self, x: np.ndarray) -> float:
        """The negative log-likelihood at x."""
        return float(once.find(lambda: self._at(x)[0]))

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """d value / dx, shape (p,)."""
        return np.asarray(once.find(lambda: self._slopes(x)[0]))

    def information(self, x: np.ndarray) -> np.ndarray:
        """Fisher information, shape (p, p)."""
        return np.asarray(once.find(lambda: self._slopes(x)[1]))

    def _at(self, x: np.ndarray) -> tuple[float, list[ObservedCurve], Noises]:
        """The negative log-likelihood, the curves beside the model, and their noise; kept for each place."""
        here = x[self._elements]
        if here.tobytes() not in self._known:
            values = zip(self._parameters, here, strict=True)
            found = {one: one.transform.from_coordinate(float(coordinate)) for one, coordinate in values}
            moved = replace(self._scene, materials=at(self._scene, found).materials)
            curves = observe(moved, cache=self._cache, device=self._device)
            fitted = fit(curves, self._scene.radar.terms)
            if len(self._known) >= KEPT:
                self._known.clear()
            self._known[here.tobytes()] = -fitted.log_likelihood, curves, fitted.noise
        return self._known[here.tobytes()]

    def _slopes(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and information."""
        gradient, scores = np.zeros(self._size), list[np.ndarray]()
        _, curves, noise = self._at(x)
        for element in self._elements:
            ends = []
            for sign in (1.0, -1.0):
                moved = x.copy()
                moved[element] += sign * STEP
                value, beside, _ = self._at(moved)
                ends.append((value, self._scores(beside, noise)))
            (up, above), (down, below) = ends
            gradient[element] = (up - down) / (2.0 * STEP)
            scores.append((above - below) / (2.0 * STEP))
        weight = np.concatenate([one.weight for one in curves])
        information = np.zeros((self._size, self._size))
        if scores:
            slopes = np.stack(scores)
            information[np.ix_(self._elements, self._elements)] = (slopes * weight) @ slopes.T
        return gradient, information

    def _scores(self, curves: Sequence[ObservedCurve], noise: Noises) -> np.ndarray:
        """Normal scores of all rows beside a noise that stands."""
        terms = self._scene.radar.terms
        return np.concatenate([CurveComparison(one, terms, noise[one.polarization]).residual for one in curves])


def curves_beside(scene: Scene, cache: Path | None, device: str | None) -> Callable[[SceneCoordinates], Beside] | None:
    """What makes the train curves of a scene with images a part of its fit; None without any.

    Raises InputError where the geometry is learned too: a curve's body may be the one that moves.
    """
    if not any(curve.role == "train" for curve in scene.curves):
        return None
    geometry = next(freed(scene), None)
    if geometry is not None:
        raise InputError(
            f"{scene.name}: found curves, and {geometry.name} to learn; beside curves only surfaces and effects can be "
            f"learned"
        )
    return partial(CurvesBeside, cache=cache, device=device)


def _materials_of(scene: Scene, curve: Curve) -> Sequence[str]:
    """The materials of a curve's body."""
    return scene.mesh.materials if curve.mesh is None else read_mesh(curve.mesh).materials


@dataclass(frozen=True)
class LearnedCurves:
    """A scene whose permittivities were fitted to its curves; its curves before and after."""

    scene: Scene
    found_values: dict[str, ProfileInterval]
    """Under "material.eps_r"."""
    before: list[CurveComparison]
    after: list[CurveComparison]

    def content(self) -> dict[str, Any]:
        """For learn.json."""
        return {
            "not_applied_to_curves": list(left_out(self.scene, "rcs")),
            "materials": {key: one.content() for key, one in self.found_values.items()},
            "fitted_together": len(self.found_values),
            "before": content_of(self.before),
            "after": content_of(self.after),
        }

    @property
    def words(self) -> list[str]:
        """A sentence for each value."""
        return [
            f"{key}: {one.value:.4g}, 95 % interval {one.low:.4g} to {one.high:.4g}"
            + (", which runs into an end of what was tried" if one.open else "")
            for key, one in self.found_values.items()
        ]


def learn_from_curves(scene: Scene, cache: Path, device: str | None = None) -> LearnedCurves:
    """Fit eps_r of every material that names it in `learn` to the train curves, by likelihood on grids that grow finer.

    One value is fitted at a time, twice around. Its interval is that of its profile with the others as found: where
    several trade against each other it is too narrow, and learn.json says how many there are. Raises InputError where
    there is nothing to learn or to learn it from.
    """
    if not any(curve.role == "train" for curve in scene.curves):
        raise InputError(f"{scene.name}: curves: found no train curve; must have one to learn from")
    wanted = [
        one.owner
        for one in scene.parameters.values()
        if one.key == "eps_r" and one.freed and one.layout == "number" and not scene.materials[one.owner].conductor
    ]
    if not wanted:
        raise InputError(
            f"{scene.name}: found nothing to learn from curves; a material must be no conductor and have "
            '"eps_r" in learn'
        )
    train = replace(scene, curves=tuple(curve for curve in scene.curves if curve.role == "train"))
    found_values: dict[str, ProfileInterval] = {}
    now = scene
    for turn in range(PASSES):
        for name in wanted:
            middle = float(now.parameters[f"materials.{name}.eps_r"].value) - 1.0
            reach = np.log(FIRST_REACH) / 3.0**turn
            axes = {"eps_r": 1.0 + middle * np.exp(np.linspace(-reach, reach, POINTS))}

            def twice_log(x: Any, name: str = name, now: Scene = now) -> float:
                one = now.parameters[f"materials.{name}.eps_r"]
                moved = replace(train, materials=at(now, {one: x["eps_r"]}).materials)
                return likelihood(observe(moved, device=device), scene.radar.terms)

            found = profiles(axes, on_grid(axes, twice_log))["eps_r"]
            found_values[f"{name}.eps_r"] = found
            now = at(now, {now.parameters[f"materials.{name}.eps_r"]: found.value})
    before, after = (compare_curves(one, cache=cache, device=device) for one in (scene, now))
    return LearnedCurves(now, found_values, before, after)
