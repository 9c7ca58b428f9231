"""All that was measured of a scene beside its model, what it gives together, and the judgement on each role's."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import warp as wp

from warpsar.coherent.left_out import left_out
from warpsar.compare.comparison import Comparison, compare
from warpsar.compare.contract import ROLES
from warpsar.compare.curve import CurveComparison, CurveJudgement, compare_curves, content_of, curve_verdicts
from warpsar.compare.judgement import Judgement, judge
from warpsar.compare.metrics import PooledMetrics, pool
from warpsar.runtime import once
from warpsar.scene.scene import Scene


@dataclass(frozen=True)
class Evaluation:
    """All images and curves of a scene, and the metrics pooled over the pixels of each role; None for a role without
    images.

    `verdicts` and `curve_verdicts`, by role: whether anything is left beside speckle, or beside a curve's noise. Of
    several processes the first one holds all images, the others none; `own` are those that this one made.
    """

    images: list[Comparison]
    train: PooledMetrics | None
    test: PooledMetrics | None
    rays_per_m2: float
    verdicts: dict[str, Judgement] = field(default_factory=dict)
    own: list[Comparison] = field(default_factory=list)
    curves: list[CurveComparison] = field(default_factory=list)
    curve_verdicts: dict[str, CurveJudgement] = field(default_factory=dict)

    def __repr__(self) -> str:
        pooled = {"train": self.train, "test": self.test}
        deviances = "".join(f", {role} deviance {m['deviance']:.3f}" for role, m in pooled.items() if m is not None)
        return f"<Evaluation: {len(self.images)} images, {len(self.curves)} curves{deviances}>"

    def pooled(self, role: str) -> PooledMetrics | None:
        """The metrics of a role."""
        return self.train if role == "train" else self.test

    def of_role(self, role: str) -> list[Comparison]:
        return [image for image in self.images if image.role == role]


def evaluated(
    scene: Scene, device: wp.Device, *, seed: int | None = None, progress: str = "", cache: Path | None = None
) -> Evaluation:
    """All measured images and curves of the scene beside the declared model, as `compare` and `compare_curves` have
    them. Images are shared among the processes; metrics and verdicts are the same for all.

    `cache`: a folder that keeps the amplitudes of curves. Raises InputError for a scene with neither, as `compare`
    does.
    """
    curves: list[CurveComparison] = []
    if scene.curves:
        curves = once.find(partial(compare_curves, scene, cache=cache, device=device.alias))
    of_curves = curve_verdicts(curves)
    if curves and not scene.has_images:
        return Evaluation([], None, None, 0.0, curves=curves, curve_verdicts=of_curves)
    found = compare(scene, device, seed=seed, shared=True, progress=progress)

    def together() -> tuple[PooledMetrics | None, PooledMetrics | None, dict[str, Judgement]]:
        train, test = (pool(found.of(role)) for role in ROLES)
        return train, test, {role: judge(found.of(role)) for role in ROLES if found.of(role)}

    train, test, verdicts = once.find(together)
    return Evaluation(found.images, train, test, found.rays_per_m2, verdicts, found.own, curves, of_curves)


def curves_content(scene: Scene, found: Evaluation) -> dict[str, Any]:
    """What the JSON files say of a scene's curves."""
    return {
        "not_applied_to_curves": list(left_out(scene, "rcs")),
        **content_of(found.curves),
        "curves_verdict": {role: one.content() for role, one in found.curve_verdicts.items()},
    }
