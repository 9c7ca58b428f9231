"""Whether an added effect would have another setting beside all the others.

A setting was chosen when the effect was added, while others were still missing: the window of a blur has hardly another
shape than what they leave. Asked again at the end, the choice does not depend on the order. Only effects of the image
are asked: what was rendered stays as it is, so that it costs little.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.refit import Fitted, refit_as
from warpsar.diagnosis.turn.screening import WORTH
from warpsar.effects.registry import get


def resettled(setup: FitSetup, fitted: Fitted, added: Sequence[str]) -> Fitted:
    """`fitted`, with those settings of the `added` effects that the images ask for; everything is fitted anew with
    each. What the scene file declares stays."""
    for name in (one for one in added if get(one).stage == "image"):
        for table in _other_settings(name, fitted.scene.effects[name]):
            trial = refit_as(setup, replace(fitted.scene, effects={**fitted.scene.effects, name: table}))
            if trial.log_likelihood > fitted.log_likelihood + WORTH:
                fitted = trial
    return fitted


def _other_settings(name: str, table: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The table with each other value of each setting that has a few."""
    for setting in get(name).settings:
        now = table.get(setting.name, setting.default)
        for value in setting.schema.get("enum", []):
            if value != now:
                yield {**table, setting.name: value}
