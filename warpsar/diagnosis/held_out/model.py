"""Models of some of the train views: how one is fitted, and how well it predicts the others."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from warpsar.compare.aim import MeasuredImage, Reach, aimed, best_shift, stated_aims, with_aims
from warpsar.compare.prediction import PredictedImage, compared, measured_of, predicted
from warpsar.compare.rivals import Seen
from warpsar.diagnosis.geometry.registry import content, scene_with
from warpsar.diagnosis.models.refit import standing_at, surface_content, with_surface
from warpsar.learning.geometry import still
from warpsar.learning.optimise import levenberg_marquardt
from warpsar.learning.problem import FitProblem
from warpsar.learning.results import learned_scene
from warpsar.runtime import threads
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.world.pixels import Pixels
from warpsar.world.tables import View

ITERATIONS = 6
FLAT, KEPT_WITHIN = 0.5, 0.05
FITTED = 0.8  # of the window's rows and columns, about the middle, that a fit looks at: far ground says nothing new
KEPT = 2  # sets of rays
FEW_RAYS = 0.125
BOUND = 0.5
"""Of a pixel's loss in a fit. A few glints, where a strong scatterer stands in for speckle, else outvote the rest: the
body's mean would follow them, and most of its pixels would be too bright."""


@dataclass(frozen=True)
class FittedViews:
    """A scene at its best on some of its views, and the bounded loss there."""

    scene: Scene
    loss: float


class FitRays:
    """Where models are fitted: scenes of one geometry and one seed share their rays."""

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self._kept: OrderedDict[bytes, Rays] = OrderedDict()
        self._making = threading.Lock()

    def fitted(
        self, scene: Scene, names: Sequence[str], iterations: int = ITERATIONS, *, aimed: bool = True
    ) -> FittedViews:
        """Everything but the geometry that the scene frees, at its best on the views `names`. With `aimed` false the
        numbers that belong to single views are held."""
        problem = self._problem(scene, names)
        moving = np.ones(problem.x0.size, bool)
        moving[problem.learned.size :] = [aimed or c.view is None for c in problem.effect_coordinates]
        state = standing_at(problem, problem.x0)
        for _ in range(iterations if moving.any() else 0):
            state = levenberg_marquardt(problem, state, moving, flat=FLAT, kept_within=KEPT_WITHIN, straight=True)
            if state.arrived:
                break
        learned = learned_scene(problem, state.best_x)
        return FittedViews(replace(scene, materials=learned.materials, effects=learned.effects), float(state.best_loss))

    def loss_at_start(self, scene: Scene, names: Sequence[str]) -> float:
        """The bounded loss of the views `names` before any fit."""
        problem = self._problem(scene, names)
        return float(problem.value(problem.modelled(problem.x0)))

    def _problem(self, scene: Scene, names: Sequence[str]) -> FitProblem:
        return FitProblem(still(scene), self.device, views=names, rays=self._rays(scene), bound=BOUND)

    def _rays(self, scene: Scene) -> Rays:
        key = hashlib.sha256(scene.mesh.vertices.tobytes() + str(scene.sampling.seed).encode()).digest()
        with self._making:
            if key not in self._kept:
                self._kept[key] = Rays(Stage.of(scene, self.device), seed=scene.sampling.seed)
                while len(self._kept) > KEPT:
                    self._kept.popitem(last=False)
            return self._kept[key]


def with_other_rays(scene: Scene) -> Scene:
    """The same model on rays of another seed."""
    return replace(scene, sampling=scene.sampling.model_copy(update={"seed": scene.sampling.seed + 1}))


def with_few_rays(scene: Scene) -> Scene:
    """The same model on `FEW_RAYS` of its rays."""
    density = FEW_RAYS * scene.sampling.density_per_m2(scene.grid)
    return replace(scene, sampling=scene.sampling.model_copy(update={"rays_per_pixel": None, "rays_per_m2": density}))


class TrainViews:
    """The train views of a scene, and what a model of some of them is asked about the others.

    `scene` has their images cut to the middle that is fitted, and their aim points found: fits begin there. It has
    the test views without images. Predictions are made on the whole image, so that they can be shifted.
    """

    def __init__(self, scene: Scene, device: wp.Device) -> None:
        self.whole, self.device, self.reach = scene, device, Reach.of(scene)
        self.views = [view for view in scene.views if view.role == "train" and view.images]
        self.names = [view.name for view in self.views]
        self._measured: dict[tuple[str, str], np.ndarray] = {
            (v.name, p): measured_of(scene, v, p) for v in self.views for p in v.images
        }
        self._beside = {key: MeasuredImage(power, self.reach) for key, power in self._measured.items()}
        window = self.reach.window(np.empty(scene.grid.shape)).shape
        shape = tuple(n - 2 * round(0.5 * (1.0 - FITTED) * n) for n in window)
        found = self._aimed(scene) if aimed(scene) else scene
        grid = scene.grid.model_copy(update={"shape": shape})
        self.scene = replace(found, views=[self._cut(view, shape) for view in scene.views], grid=grid)

    def _aimed(self, scene: Scene) -> Scene:
        """With the aim points of views that state none where the declared model correlates best."""
        stated = stated_aims(scene)
        views = [view for view in self.views if view.name not in stated]
        shifts = {}
        for view, image in zip(views, predicted(scene, views, self.device), strict=True):
            pol = next(iter(view.images))
            shifts[view.name] = best_shift(self._measured[view.name, pol], image[pol], self.reach)[1]
        return with_aims(scene, shifts)

    def _cut(self, view: View, shape: tuple[int, ...]) -> View:
        """The view with the middle of its images; a test view without any."""
        images = {}
        for pol in view.images if view.name in self.names else ():
            whole = self._measured[view.name, pol]
            row, col = ((n - m) // 2 for n, m in zip(whole.shape, shape, strict=True))
            images[pol] = Pixels(whole[row : row + shape[0], col : col + shape[1]])
        return view.model_copy(update={"images": images, "slc": {}, "mask": None})

    def images(self, scene: Scene, names: Sequence[str], *, coarse: bool = False) -> list[dict[str, np.ndarray]]:
        """What a scene predicts of views, by polarization, on the whole image; `coarse` as in `Hits`."""
        bare = {view.name: view.model_copy(update={"images": {}}) for view in scene.views}
        on_whole = replace(scene, grid=self.whole.grid, views=list(bare.values()))
        return predicted(on_whole, [bare[name] for name in names], self.device, coarse=coarse)

    def measured(self, name: str, polarization: str) -> np.ndarray:
        """Measured power of a train view, the whole image."""
        return self._measured[name, polarization]

    def scores(self, scene: Scene, names: Sequence[str], *, coarse: bool = False) -> np.ndarray:
        """Mean gamma deviance of each view at the model's best aim point, shape (names,): lower is better. `coarse` as
        in `Hits`."""

        def score(name: str, image: Mapping[str, np.ndarray]) -> float:
            measured = {pol: one for (view, pol), one in self._beside.items() if view == name}
            return float(np.mean([one.deviance(image[pol]) for pol, one in measured.items()]))

        images = self.images(scene, names, coarse=coarse)
        tasks = [partial(score, name, image) for name, image in zip(names, images, strict=True)]
        return np.array(list(threads.in_threads(tasks)))

    def beside(self, scenes: Mapping[str, Scene], names: Sequence[str], others: Sequence[str]) -> list[PredictedImage]:
        """The views `names` beside what each scene predicts, and beside the rivals that `others` make."""
        views = {view.name: view for view in self.views}
        images = {which: self.images(scene, names) for which, scene in scenes.items()}
        seen = {(name, pol): self._seen(views[name], pol) for name in views for pol in views[name].images}
        found = []
        for number, name in enumerate(names):
            for pol in views[name].images:
                own = seen[name, pol]
                train = [seen[other, pol] for other in others if (other, pol) in seen]
                planes = {which: each[number][pol] for which, each in images.items()}
                spacing_m = self.whole.grid.spacing_m
                found.append(
                    PredictedImage(views[name], pol, True, compared(own, planes, train, spacing_m, self.reach))
                )
        return found

    def _seen(self, view: View, polarization: str) -> Seen:
        return Seen(view.name, view.azimuth_deg, view.incidence_deg, self._measured[view.name, polarization])

    def finished(self, scene: Scene) -> Scene:
        """A fitted scene with the whole images of the scene file."""
        views = [
            now.model_copy(update={"images": was.images, "mask": was.mask, "slc": was.slc})
            for now, was in zip(scene.views, self.whole.views, strict=True)
        ]
        return replace(scene, grid=self.whole.grid, views=views)


# ---- scenes in JSON's types, for the checkpoint of a search


def scene_content(declared: Scene, scene: Scene) -> dict[str, Any]:
    """What a search may change of a scene: surface, effects, geometry, and the seed of its rays."""
    return {
        "materials": surface_content(scene),
        "effects": scene.effects,
        "geometry": content(declared, scene),
        "seed": scene.sampling.seed,
    }


def scene_of(declared: Scene, about: Mapping[str, Any]) -> Scene:
    """The scene that `scene_content` gave."""
    placed = scene_with(declared, replace(declared, effects=about["effects"]), about["geometry"])
    sampling = placed.sampling.model_copy(update={"seed": about["seed"]})
    return with_surface(replace(placed, sampling=sampling), about["materials"])
