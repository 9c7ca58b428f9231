"""The body of a world, kept from view to view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from warpsar.coherent.body import CoherentBody
from warpsar.coherent.patches import PatchesOnDevice
from warpsar.coherent.sweep import Worker
from warpsar.collection import places
from warpsar.collection.plan import Plan
from warpsar.collection.scatterers import TOGETHER, body_of, spacing_m
from warpsar.scene.scene import Scene
from warpsar.world.frame import SPEED_OF_LIGHT

TILE_BYTES = 2**31
"""Memory of a tile of an image, where nobody says how much there may be."""
ALIKE = 0.9
"""Views share a body whose scatterers are this close to the spacing that they need, or closer."""


class Bodies:
    """The body of a world on a device, for all its plans.

    The number of scatterers of a face depends on a view's cells, and all that is drawn after them on it. Views of much
    the same cells therefore share a body: only so do they see one surface.
    """

    def __init__(
        self,
        world: Scene,
        plans: Sequence[Plan],
        device: wp.Device,
        seed: int,
        together: int = TOGETHER,
        tile_bytes: int = TILE_BYTES,
    ) -> None:
        """`together`: scatterers that are held at a time while they are seen; `tile_bytes`: memory of an image's
        tile."""
        self.world, self.device, self.seed, self.together = world, device, seed, together
        self.tile_bytes = tile_bytes
        self._spacings = sorted(map(spacing_m, plans))
        self._spacing = 0.0
        self._body: CoherentBody | None = None
        self._patches: PatchesOnDevice | None = None
        self._worker: Worker | None = None

    def of(self, plan: Plan) -> CoherentBody:
        """The body for one of the plans, made where the last one does not serve."""
        needed = spacing_m(plan)
        spacing = next(one for one in self._spacings if one >= ALIKE * needed)
        if self._body is None or spacing != self._spacing:
            self._body, self._spacing = None, spacing  # a device may not hold two
            self._patches = self._worker = None
            self._body = body_of(self.world, spacing, self.device, self.seed)
        return self._body

    def patches(self, plan: Plan) -> PatchesOnDevice:
        """Patches of the body's rough faces, with their places about the reference point, in the frame of `Site`."""
        body = self.of(plan)
        if self._patches is None:
            middle = body.origin + plan.site.reference_m
            self._patches = body.patches.on(self.device, lambda point: plan.site.about(point + middle))
        return self._patches

    def rough_worker(self, plan: Plan) -> Worker:
        """What sees the body's rough faces at a plan's frequency."""
        body, k = self.of(plan), 2.0 * np.pi * plan.centre_hz / SPEED_OF_LIGHT
        if self._worker is None or self._worker.k[0] != k:
            self._worker = places.worker_of(body, k, ("rough",), 1, 1.0)
        return self._worker
