"""What a change of geometry is: one way in which a scene may be declared wrongly, and what everybody asks of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.movable import standing
from warpsar.diagnosis.models.names import name_of
from warpsar.diagnosis.models.refit import Fitted
from warpsar.learning.geometry import Geometry, with_free
from warpsar.learning.pose_search import FoundPoses
from warpsar.scene.scene import Scene

Section = Literal["objects", "sensor"]


@dataclass(frozen=True)
class Hypothesis:
    """A change of one body, of one view or of one spacing, before any fit.

    `kind`: name of the change. `label`: what it is of. `foretold`: log-likelihood of blurred images that it would gain.
    `numbers`: how many it frees. `parameters`: dotted names, where they are known before the fit.
    """

    kind: str
    label: str
    foretold: float
    numbers: int
    parameters: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return name_of(self.kind, self.label)


@dataclass(frozen=True)
class GeometryCandidate:
    """One change as it was fitted, and how well it explains the images.

    kind: name of the change. object: what it is of. scene: the scene with it. gain: log-likelihood that it adds, on all
    usable pixels above a common floor, surface and effects at their best with and without. size: numbers that it frees.
    values: what it found and standard deviations, as `diagnosis.json` has them. words: what is said beside it. reading:
    how it is said where another change of the same body makes the same images; empty where it is never said so.
    """

    kind: str
    object: str
    scene: Scene
    gain: float
    size: int
    values: dict[str, Any] = field(default_factory=dict)
    words: list[str] = field(default_factory=list)
    reading: str = ""

    @property
    def name(self) -> str:
        return name_of(self.kind, self.object)


class GeometryChange:
    """One way in which the geometry may be wrong, in one file.

    A scene holds its own changes: they are what it has unlike the declared scene. A `label` says of what a change is:
    an object or a group of the mesh, a view, an axis of the image. A subclass is a `BodyChange` or a `SensorChange`.
    """

    name: ClassVar[str]
    order: ClassVar[int]  # smaller ones are asked and said first
    summary: ClassVar[str]
    section: ClassVar[Section]  # of diagnosis.json that has its values
    edges_doubt: ClassVar[bool] = True  # whether it has no name beside edges that do not agree
    structure_doubts: ClassVar[Literal["nowhere", "on it", "anywhere"]] = "nowhere"
    """Where structure that is left takes the name: a body lies at one place, and what is left may lie at another."""

    def coordinates(self, declared: Scene, scene: Scene, label: str) -> list[str]:
        """The dotted names of the parameters that a fit frees of it, in a scene that has the change."""
        raise NotImplementedError

    def numbers(self, declared: Scene, scene: Scene, label: str) -> int:
        """How many numbers those are. The height of a foot that stays on the ground is none."""
        free = with_free(scene, self.coordinates(declared, scene, label))
        on_ground = standing(free)
        return sum(
            (c.parameter.key, c.index) != ("position_m", 2) or c.body not in on_ground
            for c in Geometry(free).coordinates
        )

    def taken_back(self, declared: Scene, scene: Scene, label: str) -> Scene:
        """The scene without the change, all else as it is."""
        raise NotImplementedError

    def only_view(self, label: str) -> str | None:
        """The single view whose image it changes, so that no other view tells it; None where there are more."""
        return None

    def values(
        self, declared: Scene, scene: Scene, label: str, first: Mapping[str, Any], posed: FoundPoses | None
    ) -> dict[str, Any]:
        """What became of it, for `section` of diagnosis.json. `scene`: at the end. `first`: `values` of the candidate
        that was added. `posed`: the last fit of all changes; None where nothing of them could be fitted."""
        raise NotImplementedError

    def proposed(self, setup: FitSetup, here: Fitted, price: float, least: float) -> list[GeometryCandidate]:
        """Changes that no screening finds, each fitted, beside the model `here`. A number costs `price` of 2 ln L, and
        a fit is worth at least `least` of ln L."""
        return []
