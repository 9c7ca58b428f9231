"""What every comparison of a measurement with a model has: of an image of power, or of a curve of RCS."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

ROLES = ("train", "test")


class AnyComparison(Protocol):
    """A measurement beside what a model predicts for it: `Comparison` of an image, `CurveComparison` of a curve."""

    @property
    def name(self) -> str:
        """As tables and messages have it."""

    @property
    def role(self) -> str:
        """ "train" or "test"."""

    @property
    def polarization(self) -> str: ...

    @property
    def simulated(self) -> np.ndarray:
        """The model's prediction: beta0 of pixels (rows, cols), or RCS [m2] of directions (n,)."""

    @property
    def residual(self) -> np.ndarray:
        """What is left, in standard deviations of the measurement's own law; of the same shape."""

    @property
    def scaled_deviance(self) -> np.ndarray:
        """Of each value that is compared, (n,): 1 on average where model and law are right."""


class Verdict(Protocol):
    """Whether anything is left of the measurements of one role: `Judgement` of images, `CurveJudgement` of curves."""

    @property
    def findings(self) -> Sequence[str]:
        """What departs, the chief one first; empty where nothing does."""

    @property
    def wrong(self) -> bool:
        """Whether anything departs."""

    @property
    def words(self) -> str:
        """For a reader."""

    def content(self) -> dict[str, Any]:
        """For the JSON files."""
