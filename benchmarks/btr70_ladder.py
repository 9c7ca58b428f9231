"""Trials on the train chips, some of which are left out: what stays in the model of the BTR-70 (btr70.py)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import btr70_shape as shapes
import numpy as np
from btr70_jobs import Job, done
from btr70_measures import Chip
from btr70_model import begun_with, fitted, held_out, only, with_other_rays, with_tables

from warpsar.scene.scene import Scene

FOLDS, ARCS = 3, 3  # the train views are left out in as many parts, each of as many arcs of neighbours


def folds(train: Sequence[Chip]) -> list[tuple[str, ...]]:
    """The train chips in `FOLDS` parts. Each has arcs of neighbours, so the chips left out are not among their like."""
    ordered = sorted(train, key=lambda chip: chip.azimuth_deg)
    arcs = np.array_split([chip.name for chip in ordered], FOLDS * ARCS)
    return [tuple(str(name) for arc in arcs[k::FOLDS] for name in arc) for k in range(FOLDS)]


def tried(
    source: Path,
    to: Path,
    left_out: Sequence[Chip],
    names: Sequence[str],
    rung: tuple[str, dict[str, Any]] | None = None,
    mesh: Path | None = None,
) -> dict[str, Any]:
    """Fits the scene in `source` on the views `names`, with one effect more, and keeps it in `to`; the scores of the
    chips that were left out."""
    begun = only(Scene.load(source), names)
    if rung is not None and mesh is not None:
        begun = begun_with(begun, *rung, mesh)
    found, loss = fitted(begun)
    found.save(to / "scene.toml")
    return {"loss": loss, "scores": held_out(found, left_out)}


def settled(source: Path, to: Path, left_out: Sequence[Chip], names: Sequence[str]) -> dict[str, Any]:
    """`tried` with nothing new: on other rays, with as many iterations more."""
    begun = with_other_rays(only(Scene.load(source), names))
    found, loss = fitted(begun)
    return {"loss": loss, "scores": held_out(found, left_out)}


def standing(source: Path, to: Path, tables_of_objects: shapes.Tables) -> dict[str, Any]:
    """Keeps the scene in `source` in `to`, with other tables of its objects."""
    with_tables(Scene.load(source), tables_of_objects).save(to / "scene.toml")
    return {}


def mean_and_error(gain: np.ndarray) -> tuple[float, float]:
    return float(gain.mean()), float(gain.std(ddof=1) / np.sqrt(gain.size))


@dataclass
class Ladder:
    """Trials on the train chips, a third of them left out at a time; `now` holds the best scene of each third.

    A trial stays if the gain of the chips left out, less its standard error, is above the noise: what a fit with
    nothing new may gain, its mean and one standard error. `noise` is that of the model of the moment.
    """

    out: Path
    train: Sequence[Chip]
    processes: int
    now: list[Path]
    scores: np.ndarray | None = None
    noise: float | None = None
    steps: list[dict[str, Any]] = field(default_factory=list)

    @property
    def left(self) -> list[list[Chip]]:
        """The chips that each scene of `now` leaves out."""
        return [[chip for chip in self.train if chip.name in fold] for fold in folds(self.train)]

    def scored(self, name: str, make: Callable[..., dict[str, Any]], *more: Any) -> tuple[np.ndarray, list[Path]]:
        """The scores of the chips left out, fold after fold, of what `make` fits to the others."""
        to = [self.out / f"{name}_{k}" for k in range(FOLDS)]
        jobs = []
        for k, left in enumerate(self.left):
            rest = [chip.name for chip in self.train if chip not in left]
            jobs.append(Job(to[k].with_suffix(".json"), make, (self.now[k], to[k], left, rest, *more)))
        return np.concatenate([one["scores"] for one in done(jobs, self.processes)]), to

    def turn(self, name: str, label: str, *rung: Any) -> None:
        """Tries one thing."""
        scores, to = self.scored(name, tried, *rung)
        if self.scores is None:
            self.now, self.scores = [folder / "scene.toml" for folder in to], scores
            return
        if self.noise is None:
            again, _ = self.scored(f"{self.now[0].parent.name.removesuffix('_0')}_again", settled)
            mean, error = mean_and_error(self.scores - again)
            self.noise = max(mean, 0.0) + error
        if self.judged(label, self.scores - scores):
            self.now, self.scores, self.noise = [folder / "scene.toml" for folder in to], scores, None

    def judged(self, label: str, gain: np.ndarray) -> bool:
        """Whether a trial stays; notes it."""
        mean, error = mean_and_error(gain)
        noise = self.noise or 0.0
        stays = bool(mean - error > noise)
        self.steps.append({"tried": label, "gain": mean, "error": error, "noise": noise, "stays": stays})
        verdict = "stays" if stays else "goes"
        print(f"{label}: left-out gain {mean:+.4f} +- {error:.4f}, noise {noise:.4f}: {verdict}", file=sys.stderr)
        return stays

    def shaped(self, name: str, label: str, begun: shapes.Tables, *, near: bool) -> dict[str, Any]:
        """Moves size and slope, and keeps them where they stay."""
        profiles = shapes.Profiles(self.now, self.left, self.out / name, self.processes)
        found = shapes.shape(profiles, begun, near=near)
        if not self.judged(label, np.array(found["gains"])):
            return found | {"tables": begun}
        to = [self.out / f"{name}_{k}" for k in range(FOLDS)]
        both = zip(self.now, to, strict=True)
        done([Job(one.with_suffix(".json"), standing, (at, one, found["tables"])) for at, one in both], 1)
        self.now, self.noise = [folder / "scene.toml" for folder in to], None
        self.scores = np.concatenate([held_out(Scene.load(p), c) for p, c in zip(self.now, self.left, strict=True)])
        return found
