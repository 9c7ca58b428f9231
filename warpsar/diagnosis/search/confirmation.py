"""Which of the added effects hold, each asked beside all the others.

Effects were added one after the other, on trial. What is asked of one of them depends on what else is in the model:
without a blur that is missing, the bright lines of a second bounce look wrong in views left out. So nothing is asked
before all are found. Then the worst is taken back, and the rest is asked again (backward elimination).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from warpsar.diagnosis.dark.evidence import Dark
from warpsar.diagnosis.found import Confirmed
from warpsar.diagnosis.geometry.registry import is_geometry
from warpsar.diagnosis.models.all_pixels import lit_shadows
from warpsar.diagnosis.models.carried import Carried, carried_over
from warpsar.diagnosis.models.fit_setup import DARK_PIXELS, FitSetup
from warpsar.diagnosis.models.left_out import ViewsLeftOut, leave_one_view_out
from warpsar.diagnosis.models.refit import Fitted, refit_without
from warpsar.diagnosis.search.geometry_confirmation import asked_of, taken_back, views_left_out
from warpsar.diagnosis.turn.addition import TOO_LITTLE
from warpsar.diagnosis.turn.signature import signature
from warpsar.effects.registry import get
from warpsar.runtime import once
from warpsar.scene.scene import Scene

NOT_ELSEWHERE = "it does not help on views left out as a true one would"


@dataclass
class Confirmation:
    """The model with those effects that hold, and what was `asked` of each, the refused ones first."""

    fitted: Fitted
    asked: list[Confirmed]


def confirm(
    setup: FitSetup,
    fitted: Fitted,
    added: Sequence[str],
    needed: Callable[[Fitted, str], bool],
    price: float,
    *,
    declared: Scene | None = None,
    quiet: bool = False,
) -> Confirmation:
    """Which of the `added` effects, and changes of the geometry, hold.

    A parameter costs `price` of 2 ln L. `needed` says of a model without an effect whether the dark pixels ask it for
    that effect: such an effect stays, whatever it gains in the light, unless its own test speaks against it. So does
    one that adds power without which shadows have too little, and with which they have not (`_fills_shadows`). `quiet`:
    whether the scan finds nothing beside them. Where a change of geometry is taken back, other pixels are lit, and
    nothing more is asked on these. `declared`: the scene that geometry is compared with; by default the model's own.
    """
    scene = fitted.scene if declared is None else declared
    refused: list[Confirmed] = []
    while True:
        left = [name for name in added if is_geometry(name) or name in fitted.scene.effects]
        without = {name: _without(setup, fitted, scene, name) for name in left}
        additive = [name for name in left if not is_geometry(name) and get(name).additive]
        dark = {
            name
            for name in additive
            if needed(without[name], name) or _fills_shadows(setup, fitted, without[name], name)
        }
        asked = {
            name: asked_of(setup, fitted, without[name], scene, name)
            if is_geometry(name)
            else _gained(fitted, without[name], name)
            for name in left
        }
        poor = [one for one in asked.values() if one.effect not in dark and one.gain <= one.size * price]
        if poor:
            worst = min(poor, key=lambda one: one.gain - one.size * price)
            worst.refused = TOO_LITTLE
        else:
            for name in left:
                if is_geometry(name):
                    answer = views_left_out(setup, fitted, without[name], scene, name, quiet)
                    asked[name].left_out = answer
                    asked[name].refused = "" if answer.passed else NOT_ELSEWHERE
                elif name in dark:
                    _earned(setup, fitted, without[name], asked[name])
                else:
                    _ask(setup, fitted, without[name], asked[name], quiet)
            failing = [one for one in asked.values() if one.refused]
            if not failing:
                return Confirmation(fitted, [*refused, *asked.values()])
            worst = min(failing, key=_strength)
        fitted = without[worst.effect]
        refused.append(worst)
        if is_geometry(worst.effect):
            return Confirmation(fitted, [*refused, *(one for one in asked.values() if one is not worst)])


def _without(setup: FitSetup, fitted: Fitted, declared: Scene, name: str) -> Fitted:
    if is_geometry(name):
        return taken_back(setup, fitted, declared, name)
    return refit_without(setup, fitted, name)


def _fills_shadows(setup: FitSetup, fitted: Fitted, without: Fitted, name: str) -> bool:
    """Whether shadows measure power that only the model with the effect has: most of what dark pixels measure where
    nothing is modelled, or, where there are no dark pixels to ask, all that a shadow measures. Ghosts fall on a part
    of the dark."""
    if not setup.has_dark:
        return bool(once.decide(float(lit_shadows(without, far=True) and not lit_shadows(fitted, far=True))))
    if get(name).is_floor:  # which lies under all of them
        return False
    left, before = (Dark.of(model).unexplained for model in (fitted, without))
    return bool(once.decide(float(before >= DARK_PIXELS and left < 0.5 * before)))


def _gained(fitted: Fitted, without: Fitted, name: str) -> Confirmed:
    gain = 2.0 * (fitted.log_likelihood - without.log_likelihood)
    return Confirmed(name, gain, fitted.size - without.size)


def _strength(one: Confirmed) -> float:
    """How clearly views left out speak for an effect, in standard errors."""
    left = one.left_out
    return 0.0 if left is None or left.error <= 0 else left.gain / left.error


def _ask(setup: FitSetup, fitted: Fitted, without: Fitted, one: Confirmed, quiet: bool) -> None:
    """Whether the effect helps on views left out, is one value for a view, and is no power that the surface may send.
    Fills in the answers."""
    name = one.effect
    # numbers of single views have too few pixels to be told from what stands in their rows
    quiet = quiet and not all(parameter.per_view for parameter in get(name).parameters)
    one.left_out = leave_one_view_out(setup, without, fitted, name, quiet=quiet)
    if not one.left_out.passed:
        one.refused = NOT_ELSEWHERE
        return
    if one.left_out.varies:
        one.refused = "not one value for a view: it varies over the view's columns"
        return
    if not _earned(setup, fitted, without, one):
        return
    if get(name).in_image:
        one.carried = carried_over(setup, fitted, name)
        if one.carried.by_surface(name):
            shared = _shared_note(name, one.carried, one.left_out)
            one.notes.append(shared)
            if get(name).additive:
                one.refused = shared


def _earned(setup: FitSetup, fitted: Fitted, without: Fitted, one: Confirmed) -> bool:
    """Whether nothing in the effect's own test speaks against its name."""
    own = signature(setup, without, fitted, one.effect)
    one.signature = own = once.find(lambda: own)
    if own.outcome == "against":
        one.refused = f"its own test speaks against it: {own.text}"
    return own.outcome != "against"


def _shared_note(name: str, carried: Carried, left: ViewsLeftOut) -> str:
    """Why the surface may be the cause. Power added in an image may come from something that stands there. Every radar
    blurs, so of a blur the amount alone is in doubt."""
    share = f"the surface takes {100.0 * carried.share:.0f} % of its gain over from view to view"
    if left.views == 1:
        share = "one view alone"
    if get(name).additive:
        return f"{share}: it cannot be told from something that stands there"
    return f"{share}: its size cannot be told from errors of the mesh, and is that of both"
