"""An object on trial: how well the images are explained with it, and where it then stands.

All usable pixels count, above a floor that model and measurement share (`learning.pose_pixels`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import warp as wp

from warpsar.compare.observation import Observation
from warpsar.diagnosis.models.movable import standing
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
            self._compared[blur_m] = compared(self.scene, self.pixels, blur_m, self.gains)
        return self._compared[blur_m]

    def holding(self, one: Object, material: Material | None = None) -> Scene:
        """The scene and an object; `material` is the object's own, under the object's name."""
        more = {} if material is None or one.material is None else {one.material: material}
        return with_objects(self.scene, [*self.scene.objects, one], more)

    def problem(
        self, scene: Scene, blur_m: float = 0.0, views: Sequence[str] | None = None, *, rough: bool = False
    ) -> PosedProblem:
        """The problem of a scene with an object on trial, which stays on the ground unless it is a point. `rough`:
        beside paths over several surfaces, changes are those of single bounces, as `PosedProblem` has it; they would be
        followed anew for each number of each shape."""
        both = self.compared(blur_m)
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
            rough=rough and without_paths(scene) is not scene,
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
        rough: bool = False,
    ) -> Standing:
        """The scene at its best, from where it stands; as `descend`."""
        problem = self.problem(scene, blur_m, views, rough=rough)
        end = descend(problem, problem.x0, most=most, flat=flat)
        inner, rest = problem.split(end.x)
        found = learned_scene(inner, rest)
        effects = {name: table if blur_m else found.effects[name] for name, table in scene.effects.items()}
        return Standing(replace(found, effects=effects), end.loss, problem, end.x)


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
