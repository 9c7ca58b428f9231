"""An object on trial: how well the images are explained with it, and where it then stands.

All usable pixels count, above a floor that model and measurement share (`learning.pose_pixels`). Beside paths over
several surfaces bodies are tried on single bounces (`TrialGround.trials`): paths would be followed anew for
each number of each shape.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import warp as wp

from warpsar.compare.observation import Observation
from warpsar.diagnosis.models.movable import standing
from warpsar.diagnosis.models.refit import BOUND
from warpsar.learning.pose import FLAT, MOST_STEPS, PosedProblem, descend, without_paths
from warpsar.learning.pose_pixels import PosePixels, compared
from warpsar.learning.problem import FitProblem
from warpsar.learning.results import learned_scene
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.simulation.exact_rays import ExactRays
from warpsar.surface.stage import Stage
from warpsar.surface.surface import KINDS
from warpsar.world.objects.table import Object
from warpsar.world.tables import Material

EPS_R = (2.0, 80.0)  # from dry sand to water
CORRELATION = (0.3, 30.0)  # correlation length times wavenumber
BY_PATHS = 0.1  # of a pixel's power, that paths may bring where single bounces alone are compared


@dataclass(frozen=True)
class Standing:
    """A scene at its best: `loss` above the common floor, at x of `problem`."""

    scene: Scene
    loss: float
    problem: PosedProblem
    x: np.ndarray

    def modelled(self) -> list[np.ndarray]:
        """Power of every pixel compared, at the best gains; in the order of `observations`."""
        inner, rest = self.problem.split(self.x)
        modelled = inner.modelled(rest)
        return [gain * mu for mu, gain in zip(modelled, inner.gains(modelled), strict=True)]

    @property
    def observations(self) -> list[Observation]:
        return self.problem.split(self.x)[0].observations


@dataclass(frozen=True)
class TrialGround:
    """What all trials share: a scene whose objects stand still, the pixels by view name, and the images' gains."""

    scene: Scene
    device: wp.Device
    pixels: Mapping[str, Sequence[Observation]]
    gains: Mapping[tuple[str, str], float]
    loss: str
    bound: float = 0.0  # of the loss, as in `FitProblem`
    followed: Scene | None = None  # the scene with its paths, where this ground is one of single bounces
    _compared: dict[float, PosePixels] = field(default_factory=dict)

    @classmethod
    def of(
        cls, scene: Scene, device: wp.Device, observations: Mapping[str, list[Observation]] | None, loss: str
    ) -> TrialGround:
        """`observations` as `find_poses` takes them."""
        still = with_objects(scene, [one.model_copy(update={"learn": ()}) for one in scene.objects])
        rays = ExactRays(Stage.of(still, device), seed=scene.sampling.seed)
        views = None if observations is None else list(observations)
        given = FitProblem(still, device, loss=loss, views=views, rays=rays, observations=observations)
        pixels: dict[str, list[Observation]] = {}
        for seen in given.observations:
            pixels.setdefault(seen.view.name, []).append(seen)
        gains = given.gains(given.modelled(given.x0))
        loud = {(s.view.name, s.polarization): float(g) for s, g in zip(given.observations, gains, strict=True)}
        return cls(still, device, pixels, loud, loss)

    def compared(self, blur_m: float) -> PosePixels:
        if blur_m not in self._compared:
            found = compared(self.scene, self.pixels, blur_m, self.gains)
            self._compared[blur_m] = found if self.followed is None else self._off_paths(found, self.followed, blur_m)
        return self._compared[blur_m]

    @cached_property
    def trials(self) -> TrialGround:
        """The ground on which bodies are tried: this one, or single bounces alone where it follows paths.

        Then pixels to which paths bring a part of the power are left out. Those to which paths over the body bring more
        cannot be known before the body is: a pixel costs `BOUND` at most, so that none drags it anywhere. A body has
        tens of pixels of paths, and hundreds of its own light and shadow, which place it to a few centimetres.
        """
        single = without_paths(self.scene)
        if single is self.scene:
            return self
        return TrialGround(single, self.device, self.pixels, self.gains, self.loss, BOUND, self.scene)

    def _off_paths(self, found: PosePixels, followed: Scene, blur_m: float) -> PosePixels:
        """The pixels without those to which paths bring more than `BY_PATHS`."""
        whole = compared(followed, self.pixels, blur_m, self.gains)
        problems = [PosedProblem(one.scene, self.device, found.observations, loss=self.loss) for one in (whole, found)]
        every, direct = (one.modelled(one.x0) for one in problems)
        observations: dict[str, list[Observation]] = {}
        for seen, mu, single in zip(problems[0].standing(np.zeros(0)).observations, every, direct, strict=True):
            own = seen.interior.copy()
            own[seen.interior] = mu - single <= BY_PATHS * mu
            observations.setdefault(seen.view.name, []).append(replace(seen, interior=own))
        return replace(found, observations=observations)

    def holding(self, one: Object, material: Material | None = None) -> Scene:
        """The scene and an object; `material` is the object's own, under the object's name."""
        more = {} if material is None or one.material is None else {one.material: material}
        return with_objects(self.scene, [*self.scene.objects, one], more)

    def problem(self, scene: Scene, blur_m: float = 0.0, views: Sequence[str] | None = None) -> PosedProblem:
        """The problem of a scene with an object on trial, which stays on the ground unless it is a point."""
        both = self.compared(blur_m)
        scene = scene if self.followed is None else without_paths(scene)
        seen = {name: found for name, found in both.observations.items() if views is None or name in views}
        effects = dict(both.scene.effects)
        for name, table in scene.effects.items():  # as far as a fit has come with them
            effects[name] = effects[name] if name in both.scene.effects and blur_m else table
        problem = PosedProblem(
            replace(scene, effects=effects),
            self.device,
            seen,
            loss=self.loss,
            level=both.level,
            standing=standing(scene),
            bound=self.bound,
        )
        low, high = problem.bounds
        for label, least, largest in _usual(scene):
            if label in problem.labels:
                k = problem.labels.index(label)
                low[k], high[k] = max(low[k], least), min(high[k], largest)
        return problem

    def settled(
        self,
        scene: Scene,
        blur_m: float = 0.0,
        *,
        views: Sequence[str] | None = None,
        most: int = MOST_STEPS,
        flat: float = FLAT,
    ) -> Standing:
        """The scene at its best, from where it stands; as `descend`. Effects that trials lack stay as they are."""
        problem = self.problem(scene, blur_m, views)
        end = descend(problem, problem.x0, most=most, flat=flat)
        inner, rest = problem.split(end.x)
        found = learned_scene(inner, rest)
        effects = {name: table if blur_m else found.effects.get(name, table) for name, table in scene.effects.items()}
        return Standing(replace(found, effects=effects), end.loss, problem, end.x)

    def as_it_stands(self, scene: Scene, blur_m: float = 0.0) -> Standing:
        """The scene as it is."""
        problem = self.problem(scene, blur_m)
        return Standing(scene, problem.value(problem.x0), problem, problem.x0)


def _usual(scene: Scene) -> list[tuple[str, float, float]]:
    """Labels of the last object's own material, and the coordinates between which a fit looks for them.

    Of a few pixels only brightness is known well. Beyond these values others of its numbers change nothing else.
    """
    if not scene.objects or not _is_own(scene):
        return []
    wavenumber = max(scene.wavenumber(view) for view in scene.views)
    known = {"eps_r": EPS_R, "correlation_length_m": (CORRELATION[0] / wavenumber, CORRELATION[1] / wavenumber)}
    kinds = [kind for kind in KINDS if kind.key in known]
    ends = [[float(kind.to_coordinate(each)) for each in known[kind.key]] for kind in kinds]
    return [(f"{scene.objects[-1].label}.{kind.key}", *end) for kind, end in zip(kinds, ends, strict=True)]  # type: ignore[misc]


def alone(scene: Scene) -> Scene:
    """The scene where nothing moves but its last object and that object's own material."""
    own = scene.objects[-1].material if _is_own(scene) else None
    materials = {
        name: material if name == own else material.model_copy(update={"learn": ()})
        for name, material in scene.materials.items()
    }
    effects = {
        name: {key: value for key, value in table.items() if key not in ("learn", "tolerance")} | {"fixed": True}
        for name, table in scene.effects.items()
    }
    return replace(scene, materials=materials, effects=effects)


def _is_own(scene: Scene) -> bool:
    last = scene.objects[-1]
    return last.material == last.name


def released(scene: Scene, base: Scene) -> Scene:
    """The scene with everything free that is free in `base`, at the values of `base`; the last object's own material
    stays."""
    own = scene.objects[-1].material if _is_own(scene) else None
    materials = {name: base.materials.get(name, m) if name != own else m for name, m in scene.materials.items()}
    return replace(scene, materials=materials, effects=dict(base.effects))
