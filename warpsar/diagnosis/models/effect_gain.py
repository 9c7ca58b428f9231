"""How far the effect that a turn would add is ahead of any body, before a body is fitted.

A body's gain is foretold on blurred images. So what the effect gains is taken there, too: one image of the model with
it and one without, which are at hand.
"""

from __future__ import annotations

from dataclasses import dataclass

from warpsar.diagnosis.models.all_pixels import log_likelihood
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.refit import Fitted
from warpsar.learning.pose_search import SEARCH_BLUR_M

FAR_BEHIND = 0.1  # of what the effect gains: a body that is foretold less is no rival (blur takes most of a gain)
MOST = 0.5  # of the loss, speckle included: an effect that takes so much of it is added first


@dataclass(frozen=True)
class EffectGain:
    """What the best effect gains of the log-likelihood of all usable pixels above a common floor: `sharp`, and
    `blurred` as the images of the screening are. `most`: whether it takes most of the loss of these."""

    sharp: float = 0.0
    blurred: float = 0.0
    most: bool = False

    @classmethod
    def of(cls, setup: FitSetup, here: Fitted, ahead: Fitted | None) -> EffectGain:
        """Of the model `ahead`, with the effect, over `here`; none where there is no such model."""
        if ahead is None:
            return cls()
        sharp, blurred = (
            log_likelihood(setup, ahead, blur_m) - log_likelihood(setup, here, blur_m)
            for blur_m in (0.0, SEARCH_BLUR_M[0])
        )
        return cls(sharp, blurred, blurred > -MOST * log_likelihood(setup, here, SEARCH_BLUR_M[0]))

    @property
    def least(self) -> float:
        """What a body must be foretold on blurred images to be fitted in this turn."""
        return max(self.blurred, FAR_BEHIND * self.sharp)
