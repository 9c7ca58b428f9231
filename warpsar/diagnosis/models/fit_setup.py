"""What every fit of a diagnosis shares."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import chain
from typing import Any, TypeVar

import numpy as np
import warp as wp

from warpsar.compare.observation import Observation
from warpsar.effects.registry import get
from warpsar.learning.problem import FitProblem
from warpsar.learning.roughness import Roughness
from warpsar.learning.view import FitView
from warpsar.runtime import once, threads
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.world.mesh import Mesh

T = TypeVar("T")

DARK_PIXELS = 50  # fewer pixels than this that are far from everything lit say nothing
MOST_KEPT = 8  # sets of rays: two seeds of the models that one turn compares


class OtherMeshes:
    """One set of rays for each mesh and seed; the oldest go first."""

    def __init__(self) -> None:
        self._kept: list[tuple[Mesh, Rays]] = []

    def rays(self, scene: Scene, device: wp.Device, like: Rays) -> Rays:
        """Rays through the scene's mesh, as dense as `like` and of the same seed."""
        for mesh, rays in self._kept:
            if rays.seed == like.seed and same_surface(mesh, scene.mesh):
                return rays
        made = Rays(Stage.of(scene, device), like.rays_per_m2, like.seed)
        self._kept = [*self._kept, (scene.mesh, made)][-MOST_KEPT:]
        return made


def image_of(view: FitView, polarization: str) -> np.ndarray:
    """beta0 of a view's last run before any gain, float64 (rows, cols)."""
    shape = view.observations[0].interior.shape
    return view.render.images[polarization].numpy().astype(float).reshape(shape)


def same_surface(one: Mesh, other: Mesh) -> bool:
    """Whether two meshes have the same triangles of the same materials, vertex by vertex."""
    pairs = ((one.vertices, other.vertices), (one.faces, other.faces), (one.face_material, other.face_material))
    return one.materials == other.materials and all(
        a is b or (a.shape == b.shape and bool((a == b).all())) for a, b in pairs
    )


@dataclass(frozen=True)
class FitSetup:
    """Rays and frozen pixels that all models are compared on. `observations` by view name.

    `bound` is that of the gamma loss in every fit (`speckle.likelihood.bounded`); 0 for none. `roughness` is
    what every fit expects of the learned fields; None where there are none. Every process holds all views, and
    fits whole models by itself. `rays` are those of `mesh`; a scene with another mesh has rays of its own, `others`,
    as many and as random. Without a `mesh`, all scenes have the one of `rays`.
    """

    device: wp.Device
    rays: Rays
    observations: Mapping[str, list[Observation]]
    bound: float = 0.0
    roughness: Roughness | None = None
    mesh: Mesh | None = None
    others: OtherMeshes = field(default_factory=OtherMeshes)

    @property
    def has_dark(self) -> bool:
        """Whether enough pixels are dark for them to say something."""
        return sum(int(seen.dark.sum()) for seen in chain(*self.observations.values())) >= DARK_PIXELS

    def rays_of(self, scene: Scene) -> Rays:
        """The rays of the scene's mesh."""
        if self.mesh is None or same_surface(scene.mesh, self.mesh):
            return self.rays
        return self.others.rays(scene, self.device, self.rays)

    def problem(self, scene: Scene, views: Sequence[str] | None = None, *, dark: bool | None = None) -> FitProblem:
        """The scene's fit problem; its dark pixels are used where it has an additive effect, or as `dark` says."""
        if dark is None:
            dark = any(get(name).additive for name in scene.effects)
        seen = self._with_dark if dark else self.observations
        return FitProblem(
            scene,
            self.device,
            views=views,
            rays=self.rays_of(scene),
            observations=seen,
            bound=self.bound,
            roughness=self.roughness,
        )

    @cached_property
    def _with_dark(self) -> dict[str, list[Observation]]:
        return {name: [one.with_dark() for one in found] for name, found in self.observations.items()}

    def share(self, tasks: Sequence[Callable[[], T]], **how: Any) -> list[T]:
        """As `once.share`; on the CPU tasks of a process run side by side, each on problems of its own."""
        return once.share(tasks, run=partial(threads.ordered, device=self.device), **how)
