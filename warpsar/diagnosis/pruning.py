"""Which earlier effects the newest one has made needless."""

from __future__ import annotations

from collections.abc import Sequence

from warpsar.diagnosis.bench import Bench
from warpsar.diagnosis.found import Turn
from warpsar.diagnosis.refit import refit_without
from warpsar.effects.registry import get


def prune(bench: Bench, turn: Turn, earlier: Sequence[str], price: float) -> None:
    """Drop each of the `earlier` effects whose loss costs less likelihood than its parameters do: `price` of 2 ln L
    each. A blur can stand in for a shift until the shift is found."""
    for name in earlier:
        assert turn.fitted is not None
        if name not in turn.fitted.scene.effects or get(name).additive:
            continue
        without = refit_without(bench, turn.fitted, name)
        lost = 2.0 * (turn.fitted.log_likelihood - without.log_likelihood)
        if lost < (turn.fitted.size - without.size) * price:
            turn.dropped.append(name)
            turn.fitted = without
