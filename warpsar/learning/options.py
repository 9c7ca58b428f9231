"""How to fit, and what is refused because it would do nothing or end nowhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real

from warpsar.errors import InputError, refuse_number, shown
from warpsar.learning.problem import FitProblem
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import LOSSES
from warpsar.surface.surface import KEYS, Surface


@dataclass(frozen=True)
class LearnOptions:
    """How to fit; the defaults suit uniform materials and fields.

    `optimiser`: "auto" takes Levenberg-Marquardt for uniform materials and Adam for fields. `starts`: how many, the
    scene's own and others drawn about it. `total_variation`: weight per parameter key. `validity`: weight of the
    models' domains as soft constraints, 0 for none. `rate`: Adam's first step in log coordinates. `max_time_s` counts
    all parts of a resumed run. `max_memory_gib` bounds what kept hits take (`FitProblem`).
    """

    loss: str = "gamma"
    optimiser: str = "auto"
    starts: int = 3
    iterations: int = 500
    max_time_s: float = float("inf")
    rate: float = 0.05
    total_variation: Mapping[str, float] = field(default_factory=dict)
    validity: float = 0.0
    checkpoint_every: int = 10
    seed: int = 0
    max_memory_gib: float | None = None

    def __post_init__(self) -> None:
        for name in ("starts", "iterations", "checkpoint_every"):
            refuse_number(getattr(self, name), f"--{name.replace('_', '-')}", whole=True, low=1)
        refuse_number(self.seed, "--seed", whole=True)
        refuse_number(self.max_time_s, "--max-time", above=True)
        refuse_number(self.rate, "--rate", above=True)
        refuse_number(self.validity, "--validity")
        if self.max_memory_gib is not None:
            refuse_number(self.max_memory_gib, "--max-memory", above=True)
        if not isinstance(self.total_variation, Mapping):
            raise InputError(f"--tv: found {shown(self.total_variation)}; allowed is a dict of keys and weights")
        if self.loss not in LOSSES:
            raise InputError(f"--loss: found {self.loss!r}; allowed are {', '.join(LOSSES)}")
        if self.optimiser not in ("auto", "lm", "adam"):
            raise InputError(f"--optimiser: found {self.optimiser!r}; allowed are auto, lm, adam")
        for key, weight in self.total_variation.items():
            if key not in KEYS or not isinstance(weight, Real) or not 0 <= weight < float("inf"):
                raise InputError(f"--tv: found {key}={weight}; allowed is one of {', '.join(KEYS)} and a number >= 0")


def refuse_starts(scene: Scene) -> None:
    """Refuse starts outside the bounds: eps_r = 1 and tau = 0 or 1 lie there, where derivatives are exactly 0.

    Raises InputError.
    """
    surface = Surface.of(scene)
    for block in surface.blocks:
        kind = block.kind
        values = kind.from_coordinate(surface.nodes[block.start : block.stop])
        bad = values[~((values >= kind.low * (1 - 1e-6)) & (values <= kind.high * (1 + 1e-6)))]
        if not block.learn or not bad.size:
            continue
        why = {
            "eps_r": "; at 1, sigma0 and all its derivatives are 0 (a dead point), and near it they are too small",
            "specular_fraction": "; at 0 and 1 its logit is infinite, and every derivative to it 0",
        }.get(kind.key, "")
        raise InputError(
            f"{scene.name}: materials.{block.material}.{kind.key}: found a start at {bad[0]:g}; to be learned it must "
            f"be from {kind.low:g} to {kind.high:g}{why}"
        )


def refuse_options(problem: FitProblem, options: LearnOptions) -> None:
    """Refuse options that do nothing, or nothing sensible, to the parameters learned here. Raises InputError."""
    if options.optimiser == "lm" and not problem.uniform:
        raise InputError("--optimiser: found lm, and a field to learn; allowed for fields is adam")
    if options.validity > 0 and not problem.surface.by_default.all():
        raise InputError("--validity: found a material whose model is not ka_spm; allowed with ka_spm alone")
    fields = {block.kind.key for block in problem.surface.blocks if block.learn and block.size > 1}
    for key, weight in options.total_variation.items():
        if weight > 0 and key not in fields:
            known = ", ".join(sorted(fields)) or "none: no field is learned"
            raise InputError(f"--tv: found {key}, of which no field (texture or vertex) is learned; allowed: {known}")
