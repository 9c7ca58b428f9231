"""Frequencies of curves that are held back in turn: what the others find, and how well it foretells them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.compare.curve import CurveComparison
from warpsar.diagnosis.curves import DiagnosedCurves, diagnose_curves
from warpsar.errors import InputError
from warpsar.scene.scene import Scene


@dataclass(frozen=True)
class HeldBack:
    """What the train curves of all other frequencies say, and the curves of these as test."""

    frequencies_hz: list[float]
    found: DiagnosedCurves

    @property
    def errors_db(self) -> tuple[float, float]:
        """Mean abs(dB) of the curves held back, of the model as declared and with what was found."""
        before, after = (_error_db(one) for one in (self.found.before, self.found.after))
        return before, after

    @property
    def words(self) -> str:
        """One sentence, without its end."""
        held = ", ".join(f"{one / 1e9:.4g}" for one in self.frequencies_hz)
        before, after = self.errors_db
        return f"{held} GHz held back: {self.found.in_short}; mean error there {before:.1f} -> {after:.1f} dB"

    def content(self) -> dict[str, Any]:
        """For diagnosis.json."""
        before, after = self.errors_db
        own = {"frequencies_hz": self.frequencies_hz, "error_db_before": before, "error_db_after": after}
        return {**own, **self.found.content(), "words": self.words}


def _error_db(curves: Sequence[CurveComparison]) -> float:
    return float(np.mean([one.error_db for one in curves if one.role == "test"]))


def held_back_in_turn(scene: Scene, parts: int, cache: Path, device: str | None = None) -> list[HeldBack]:
    """Hold back the frequencies of the train curves in so many parts, each of neighbours. Curves of the role test are
    not looked at.

    Raises InputError for more parts than frequencies, and as `diagnose_curves` does.
    """
    train = {one: float(np.median(one.rows().frequency_hz)) for one in scene.curves if one.role == "train"}
    frequencies = sorted(set(train.values()))
    if len(frequencies) < parts:
        raise InputError(
            f"--folds {parts}: found train curves of {len(frequencies)} frequencies; must be {parts} or more"
        )
    found = []
    for held in np.array_split(frequencies, parts):
        roles = {one: "test" if frequency in held else "train" for one, frequency in train.items()}
        curves = tuple(one.model_copy(update={"role": role}) for one, role in roles.items())
        found.append(HeldBack(held.tolist(), diagnose_curves(replace(scene, curves=curves), cache, device)))
    return found


def lost(names: Sequence[str], held_back: Sequence[HeldBack]) -> list[str]:
    """Those of the names that are not found with every part held back."""
    return [name for name in names if not all(name in one.found.verdict for one in held_back)]
