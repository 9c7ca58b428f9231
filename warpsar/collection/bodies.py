"""The body of a world, kept from view to view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from warpsar.coherent.body import CoherentBody
from warpsar.coherent.records import upload
from warpsar.collection.plan import Plan
from warpsar.collection.scatterers import TOGETHER, body_of, spacing_m
from warpsar.scene.scene import Scene

ALIKE = 0.9
"""Views share a body whose scatterers are this close to the spacing that they need, or closer."""


class Bodies:
    """The body of a world on a device, for all its plans.

    The number of scatterers of a face depends on a view's cells, and all that is drawn after them on it. Views of much
    the same cells therefore share a body: only so do they see one surface.
    """

    def __init__(
        self, world: Scene, plans: Sequence[Plan], device: wp.Device, seed: int, together: int = TOGETHER
    ) -> None:
        """`together`: scatterers that are held at a time while they are seen."""
        self.world, self.device, self.seed, self.together = world, device, seed, together
        self._spacings = sorted(map(spacing_m, plans))
        self._spacing = 0.0
        self._body: CoherentBody | None = None
        self._places: wp.array | None = None

    def of(self, plan: Plan) -> CoherentBody:
        """The body for one of the plans, made where the last one does not serve."""
        needed = spacing_m(plan)
        spacing = next(one for one in self._spacings if one >= ALIKE * needed)
        if self._body is None or spacing != self._spacing:
            self._body, self._spacing, self._places = None, spacing, None  # a device may not hold two
            self._body = body_of(self.world, spacing, self.device, self.seed)
        return self._body

    def rough_places(self, plan: Plan) -> wp.array:
        """Places of the body's rough scatterers about the reference point, (n,), vec3d [m], in the frame of `Site`."""
        body = self.of(plan)
        if self._places is None:
            world = body.scatterer_points.numpy() + body.origin + np.asarray(self.world.reference_point_m)
            self._places = upload(plan.site.about(world), wp.vec3d, self.device)
        return self._places
