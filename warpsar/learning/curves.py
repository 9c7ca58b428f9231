"""Surfaces learned from measured curves of radar cross-section: materials from curves alone, and curves beside
images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.coherent.left_out import left_out
from warpsar.compare.curve import CurveComparison, compare_curves, content_of
from warpsar.curves.shape import TWICE_LOG_LIMIT, ProfileInterval
from warpsar.errors import InputError
from warpsar.learning.coordinates import SceneCoordinates
from warpsar.learning.curve_likelihood import CurveLikelihood
from warpsar.learning.geometry import freed
from warpsar.learning.prior import Beside
from warpsar.parameters.parameter import Parameter
from warpsar.runtime import console
from warpsar.scene.scene import Scene
from warpsar.world.curve import Curve
from warpsar.world.mesh import read_mesh

PASSES = 2
POINTS, VALLEYS, FEW, GLANCE = 9, 7, 3, 3
FIRST_REACH = 1.6
"""Factor by which the first grid of a learned value, and that of thicknesses, reaches up and down.

Each further one reaches a third of its logarithm.
"""
FLAT, FLAT_BESIDE = 1e-3, 2e-2  # gain in log-likelihood that counts as none
PER_DIRECTION = 3.0  # rows for an independent direction: more take time and say little
MOST_STEPS, MOST_BESIDE = 30, 4  # of a fit, and of the others' fit at a place of a profile
LARGEST_STEP, LARGEST_WALK = 1.0, 2.0  # of a coordinate
DAMPED = 1e-3
WALK, WIDER = 12, 1.7  # steps of a profile to each side, and how much longer each is than the one before it


class CurvesBeside:
    """The train curves of a scene beside its images, as a part of the same fit: what they say of x."""

    def __init__(self, coordinates: SceneCoordinates, cache: Path | None = None, device: str | None = None) -> None:
        """Of the coordinates' scene; `cache` as in `observe`. Raises InputError for a field that a curve's body has."""
        scene = coordinates.scene
        train = [curve for curve in scene.curves if curve.role == "train"]
        self._size = coordinates.x0.size
        names = {name for curve in train for name in _materials_of(scene, curve)}
        fields = [name for name in names if scene.materials[name].layout != "uniform"]
        if fields:
            raise InputError(
                f"{scene.name}: curves: found {fields[0]}, whose values are a field; beside images the material of a "
                f"curve must have one number for each"
            )
        own = [(place, one) for place, one in coordinates.numbers() if one.root == "materials" and one.owner in names]
        self._elements = np.array([place for place, _ in own], int)
        self._likelihood = CurveLikelihood(scene, [one for _, one in own], cache, device)

    def value(self, x: np.ndarray) -> float:
        """The negative log-likelihood at x."""
        return self._likelihood.value(x[self._elements])

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """d value / dx, shape (p,)."""
        found = np.zeros(self._size)
        found[self._elements] = self._likelihood.slopes(x[self._elements])[0]
        return found

    def information(self, x: np.ndarray) -> np.ndarray:
        """Fisher information, shape (p, p)."""
        found = np.zeros((self._size, self._size))
        found[np.ix_(self._elements, self._elements)] = self._likelihood.slopes(x[self._elements])[1]
        return found


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
    """A scene whose materials were fitted to its curves; its curves before and after."""

    scene: Scene
    found_values: dict[str, ProfileInterval]
    """Under "material.eps_r", "material.layers.0.mu_r", and products under "material.(eps_r - 1) x thickness_m" [m]."""
    before: list[CurveComparison]
    after: list[CurveComparison]

    def content(self) -> dict[str, Any]:
        """For learn.json."""
        return {
            "not_applied_to_curves": list(left_out(self.scene, "rcs")),
            "materials": {key: one.content() for key, one in self.found_values.items()},
            "fitted_together": sum(" x " not in key for key in self.found_values),
            "before": content_of(self.before),
            "after": content_of(self.after),
        }

    @property
    def words(self) -> list[str]:
        """A sentence for each value."""
        return [
            f"{key}: {one.value:.4g}, 95 % interval {one.low:.4g} to {one.high:.4g}{' m' * key.endswith('thickness_m')}"
            + (", which runs into an end of what was tried" if one.open else "")
            for key, one in self.found_values.items()
        ]


def learn_from_curves(scene: Scene, cache: Path, device: str | None = None) -> LearnedCurves:
    """Fit what materials name in `learn` to the train curves: `eps_r`, `thickness_m`, and values of `layers`.

    A start is sought on grids (`_Fit.sought`), from which all values are fitted together. Intervals are those of
    profiles, beside which the other values are fitted along. Where curves tell a product alone, as of a thin sheet
    (eps_r - 1) x thickness, the intervals of its two factors are wide, and the product has a narrow one.
    Raises InputError where there is nothing to learn or to learn it from.
    """
    if not any(curve.role == "train" for curve in scene.curves):
        raise InputError(f"{scene.name}: curves: found no train curve; must have one to learn from")
    wanted = [one for one in scene.parameters.values() if _of_curves(scene, one)]
    if not wanted:
        raise InputError(
            f"{scene.name}: found nothing to learn from curves; a material must be no bare conductor and have "
            '"eps_r", "thickness_m" or a value of its layers, as "layers.0.eps_r", in learn'
        )
    likelihood = CurveLikelihood(scene, wanted, device=device, per_direction=PER_DIRECTION)
    bar = console.progress(None, "sweeps", "learn")
    fitted = _Fit(likelihood, np.eye(len(wanted)), bar.update)
    x = np.array([float(one.transform.to_coordinate(one.value)) for one in wanted])
    x = fitted.descended(fitted.sought(np.clip(x, *fitted.ends)))
    found = {one.old_name: fitted.profile(place, x, one) for place, one in enumerate(wanted)}
    for name, (first, second) in _products(scene, wanted).items():
        turned = np.eye(len(wanted))
        turned[first, second] = -1.0  # x = turned @ u with u_first = x_first + x_second
        found[name] = _Fit(likelihood, turned, bar.update).profile(first, np.linalg.solve(turned, x))
    bar.close()
    now = likelihood.moved(scene, x)
    before, after = (compare_curves(one, cache=cache, device=device) for one in (scene, now))
    return LearnedCurves(now, found, before, after)


def _of_curves(scene: Scene, one: Parameter) -> bool:
    """Whether a fit to curves alone changes it."""
    if one.root != "materials" or not one.freed or one.layout != "number":
        return False
    bare = scene.materials[one.owner].bare
    return one.key.startswith("layers.") or (one.key in ("eps_r", "thickness_m") and not bare)


def _products(scene: Scene, wanted: Sequence[Parameter]) -> dict[str, tuple[int, int]]:
    """Products that curves of thin layers tell, with the places of their factors: in air the phase that a layer adds
    goes with (eps_r - 1) x thickness, and on a conductor with mu_r x thickness, where the electric field is 0. What is
    lost goes there with the loss of mu_r x thickness."""
    place = {(one.owner, one.key): at for at, one in enumerate(wanted)}
    found = {}
    for (owner, key), at in place.items():
        layer, _, of = key.rpartition(".")
        beside = place.get((owner, f"{layer}.thickness_m" if layer else "thickness_m"))
        if beside is None:
            continue
        if of in ("mu_r", "mu_r_loss") and scene.materials[owner].conductor:
            found[f"{owner}.{key} x thickness_m"] = at, beside
        elif of == "eps_r" and not scene.materials[owner].conductor and wanted[at].transform.kind == "contrast":
            found[f"{owner}.({key} - 1) x thickness_m"] = at, beside
    return found


class _Fit:
    """A fit over u, where x = turn u are the coordinates of the likelihood."""

    def __init__(self, likelihood: CurveLikelihood, turn: np.ndarray, progress: Callable[[], Any]) -> None:
        self._likelihood, self._turn, self._progress = likelihood, turn, progress
        ends = [sorted(float(one.transform.to_coordinate(e)) for e in _reach(one)) for one in likelihood.parameters]
        low, high = np.array(ends).T
        self.ends = low, high

    def value(self, u: np.ndarray) -> float:
        self._progress()
        return self._likelihood.value(self._turn @ u)

    def sought(self, u: np.ndarray) -> np.ndarray:
        """A start from which the likeliest place is downhill, within `FIRST_REACH` of what is declared.

        A thickness has a valley for each half of a wavelength. So each of some thicknesses has the fillings sought
        beside it, each on a grid of its own. The likeliest few are fitted some steps with all others, and the best of
        them goes on.
        """
        thick = [place for place, one in enumerate(self._likelihood.parameters) if one.key.endswith("thickness_m")]
        fillings = [place for place in range(u.size) if place not in thick]
        reach = np.log(FIRST_REACH)
        for place in thick or [-1]:
            tried = list[np.ndarray]()
            for start in self._beside(u, place, reach, VALLEYS) if thick else u[None]:
                for turn in range(1 if thick else PASSES):
                    for filling in fillings:
                        start = min(self._beside(start, filling, reach / 3.0**turn, POINTS), key=self.value)
                tried.append(start)
            tried.sort(key=self.value)
            u = min((self.descended(one, most=GLANCE) for one in tried[:FEW]), key=self.value)
        return u

    def _beside(self, u: np.ndarray, place: int, reach: float, count: int) -> np.ndarray:
        """u with other values at a place, shape (count, p)."""
        tried = np.repeat(u[None], count, axis=0)
        tried[:, place] += np.linspace(-reach, reach, count)
        return np.clip(tried, *self.ends)

    def descended(self, u: np.ndarray, held: int | None = None, most: int = MOST_STEPS) -> np.ndarray:
        """Levenberg-Marquardt from u, until a step promises no gain, or for the `most` steps.

        With the value `held` where it is, it ends earlier, and takes one-sided slopes.
        """
        most, flat = (most, FLAT) if held is None else (MOST_BESIDE, FLAT_BESIDE)
        free = np.array([place for place in range(u.size) if place != held], int)
        loss, damping = self.value(u), DAMPED
        for _ in range(most if free.size else 0):
            gradient, information = self._slopes(u, free, one_sided=held is not None)
            while damping < 1e9:
                step = -_solved(information, gradient, damping)
                if -0.5 * (gradient @ step) < flat:
                    return u
                tried = u.copy()
                tried[free] += np.clip(step, -LARGEST_STEP, LARGEST_STEP)
                tried = self._inside(tried, held)
                if (ahead := self.value(tried)) < loss:
                    u, loss, damping = tried, ahead, max(damping / 10.0, 1e-9)
                    break
                damping *= 10.0
        return u

    def profile(self, place: int, best: np.ndarray, parameter: Parameter | None = None) -> ProfileInterval:
        """The 95 % interval of a value, beside which the others are fitted along.

        `parameter` turns its coordinate into its value; without one the exponential does. An end that is not reached is
        open, and is the last that was tried.
        """
        every = np.arange(best.size)
        _, information = self._slopes(best, every)
        variance = float(np.linalg.pinv(information)[place, place])
        sd = np.sqrt(variance) if variance > 0.0 else np.inf  # 0 where the curves say nothing of the value
        others = np.delete(every, place)
        along = np.eye(best.size)[place]
        along[others] = -_solved(information[np.ix_(others, others)], information[others, place], DAMPED)
        top, ends, is_open = self.value(best), list[float](), False
        for sign in (-1.0, 1.0):
            u, inner, fall, tangent = best, float(best[place]), 0.0, along
            step = sign * float(np.clip(sd, 1e-6, LARGEST_STEP))
            for _ in range(WALK):
                there = self._inside(u + step * tangent, None)
                if abs(there[place] - u[place]) < 1e-3 * abs(step):
                    is_open = True  # at the end of what is allowed
                    break
                there = self.descended(there, place)
                tangent = (there - u) / (there[place] - u[place])
                u, now = there, float(np.sqrt(max(2.0 * (self.value(there) - top), 0.0)))
                if now**2 > TWICE_LOG_LIMIT:
                    inner += (np.sqrt(TWICE_LOG_LIMIT) - fall) / (now - fall) * (float(u[place]) - inner)
                    break
                inner, fall, step = float(u[place]), now, float(np.clip(WIDER * step, -LARGEST_WALK, LARGEST_WALK))
            else:
                is_open = True
            ends.append(inner)
        back = np.exp if parameter is None else parameter.transform.from_coordinate
        value, low, high = (float(back(u)) for u in (best[place], *ends))
        return ProfileInterval(value, low, high, is_open)

    def _slopes(self, u: np.ndarray, free: np.ndarray, *, one_sided: bool = False) -> tuple[np.ndarray, np.ndarray]:
        self._progress()
        return self._likelihood.slopes(self._turn @ u, self._turn[:, free].T, one_sided=one_sided)

    def _inside(self, u: np.ndarray, held: int | None) -> np.ndarray:
        """u with its values inside what is allowed, but for the one that is held."""
        x = np.clip(self._turn @ u, *self.ends)
        found = np.linalg.solve(self._turn, x)
        if held is not None:
            found[held] = u[held]
        return found


def _solved(information: np.ndarray, right: np.ndarray, damping: float) -> np.ndarray:
    """The solution of information x = right, damped by a share of its diagonal."""
    if not right.size:
        return right
    diagonal = np.diag(information)
    least = 1e-9 * max(float(diagonal.sum()), 1e-12)
    return np.asarray(np.linalg.solve(information + damping * np.diag(np.maximum(diagonal, least)), right))


def _reach(one: Parameter) -> tuple[float, float]:
    """How far a fit goes."""
    assert one.fit_bounds is not None
    return one.fit_bounds
