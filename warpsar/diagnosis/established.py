"""Which of the names that the final model has are earned: whatever is left unexplained may be what they stand in for.

An error that no hypothesis describes is taken up by those that come nearest to it. Each gains likelihood, and views
left out confirm the gain. What gives a stand-in away is what it cannot take up: edges that still do not agree, or
structure. Beside these a name holds only if it has evidence of its own.
"""

from __future__ import annotations

from collections.abc import Mapping

from warpsar.compare.judgement import Judgement
from warpsar.diagnosis.found import Diagnosis
from warpsar.diagnosis.models.change import ABSENT, MISSING, is_geometry
from warpsar.diagnosis.models.names import kind_of
from warpsar.diagnosis.models.sensor import is_sensor
from warpsar.effects.registry import get

PLACED = {ABSENT, MISSING}  # bodies that are there or are not: no remainder elsewhere puts them in doubt


def not_established(found: Diagnosis, verdicts: Mapping[str, Judgement]) -> dict[str, str]:
    """Names of the final model that are not earned, with their objects, and why, in words.

    What the time left on trial is none. Beside edges that do not agree, nothing that moves edges is, be it a body, an
    angle or a shift of images, nor an effect whose own test does not confirm it. Beside structure, such effects and
    angles and spacings of the sensor are not: a body lies at one place, and what is left may lie at another.
    """
    left = {one for verdict in verdicts.values() for one in verdict.findings}
    why = {}
    for name in found.held:
        if name in found.on_trial:
            why[name] = "the time was over before it was asked beside the others"
        elif is_geometry(name):
            if "edges" in left and kind_of(name) not in PLACED:
                why[name] = "edges do not agree with it"
            elif "structure" in left and is_sensor(name):
                why[name] = "structure is left with it"
        elif "edges" in left and get(name).stage == "position":
            why[name] = "edges do not agree with it"
        elif {"edges", "structure"} & left and not found.signed(name):
            why[name] = "what is left may be what it stands in for, and its own test does not confirm it"
    return why
