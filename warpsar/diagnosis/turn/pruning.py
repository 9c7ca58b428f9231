"""What is needless beside the rest of a model: an earlier effect, or a part of one."""

from __future__ import annotations

from collections.abc import Sequence

from warpsar.diagnosis.found import Turn
from warpsar.diagnosis.models.bench import Bench
from warpsar.diagnosis.models.refit import Fitted, refit_as, refit_without
from warpsar.diagnosis.scores.templates import with_effect
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


def trimmed(bench: Bench, fitted: Fitted, names: Sequence[str], price: float) -> Fitted:
    """The model without those parts of the effects `names` (`Effect.simpler`) whose loss costs less than a parameter
    does: `price` of 2 ln L, dark pixels counted."""
    for name in names:
        trimming = True
        while trimming:
            trimming = False
            for table in get(name).simpler(fitted.scene.effects[name]):
                without = refit_as(bench, with_effect(fitted.scene, name, table))
                if 2.0 * (fitted.whole - without.whole) < price:
                    fitted, trimming = without, True
                    break
    return fitted
