"""All measured images of a scene beside its model, what they give together, and the judgement on each role's."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace

from warpsar.compare.comparison import Compared, Comparison
from warpsar.compare.judgement import Judgement, judge
from warpsar.compare.metrics import PooledMetrics, pool
from warpsar.runtime.distributed import Ranks

ROLES = ("train", "test")


@dataclass(frozen=True)
class Evaluation:
    """All images of a scene, and the metrics pooled over the pixels of each role; None for a role without images.

    `verdicts`, by role: whether anything is left beside speckle.
    """

    images: list[Comparison]
    train: PooledMetrics | None
    test: PooledMetrics | None
    rays_per_m2: float
    verdicts: dict[str, Judgement] = field(default_factory=dict)

    @classmethod
    def of(cls, found: Compared) -> Evaluation:
        """What the compared images of a scene give together; empty where another process holds them."""
        roles = [role for role in ROLES if found.of(role)]
        train, test = (pool(found.of(role)) for role in ROLES)
        return cls(found.images, train, test, found.rays_per_m2, {role: judge(found.of(role)) for role in roles})

    def shared(self, ranks: Ranks) -> Evaluation:
        """The same on all ranks, as the first one has it; the images stay there."""
        if ranks.size == 1:
            return self
        said = [self.train, self.test, {role: asdict(one) for role, one in self.verdicts.items()}]
        train, test, verdicts = ranks.gather(said)[0]
        if ranks.first:
            return self
        return replace(self, train=train, test=test, verdicts={k: Judgement.heard(one) for k, one in verdicts.items()})

    def pooled(self, role: str) -> PooledMetrics | None:
        """The metrics of a role."""
        return self.train if role == "train" else self.test

    def of_role(self, role: str) -> list[Comparison]:
        return [image for image in self.images if image.role == role]
