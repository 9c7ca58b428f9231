"""How large the largest score gets by speckle alone: a parametric bootstrap at the looks declared."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from warpsar.diagnosis.scores.evidence import LARGEST, Evidence
from warpsar.diagnosis.scores.score import TangentProjection, TemplateGroup
from warpsar.runtime import once, threads
from warpsar.runtime.deadline import check
from warpsar.speckle.draws import Speckle
from warpsar.speckle.scan import Scan
from warpsar.speckle.tail import FIRST, SURE, Tail, Tails

BATCH = 25  # draws at once; fixed, so that the numbers do not depend on the threads
BEHIND = 0.5  # of the best score, below which it does not matter on which side of the threshold another one is


@dataclass(frozen=True)
class Bootstrap:
    """Calibrated scores. `tails`: per effect of its largest score, and of the "scan"; every one so counts alike,
    however many trials it has. `largest`: the largest -ln p of every draw over all of them, sorted."""

    tails: Mapping[str, Tail | Tails]
    largest: np.ndarray

    @property
    def draws(self) -> int:
        """How many draws there were."""
        return self.largest.size

    def threshold(self, family_error: float) -> float:
        """What any of them must exceed, in calibrated -ln p, at the family's error rate."""
        return Tail.of(self.largest).value(-np.log(family_error))

    def decides(self, scores: Mapping[str, Any], family_error: float) -> bool:
        """Whether more draws would put no score, by name and not calibrated, on the other side of the threshold; that
        of the scan has one for each of its questions.

        A score below `BEHIND` of the best needs no side: what is added on trial comes first, and it is scored again.
        Nor does the scan where an effect is surely beyond: it only says that something is left.
        """
        threshold = self.threshold(family_error)
        unsure = SURE * Tail.of(self.largest).value_error(-np.log(family_error))
        ends = {name: self.tails[name].interval(score) for name, score in scores.items()}
        best = max(low for low, _ in ends.values())
        needed = threshold - unsure
        if best > threshold + unsure:
            needed = max(needed, BEHIND * best)
        if any(low > threshold + unsure for name, (low, _) in ends.items() if name != "scan"):
            ends.pop("scan", None)
        return all(low > threshold + unsure or high < needed for low, high in ends.values())

    def with_another(self, seed: int) -> Bootstrap:
        """One more member of the family, of pixels that no other member uses: a calibrated -ln p is exponential."""
        more = np.random.default_rng([seed, self.largest.size]).exponential(size=self.largest.size)
        return replace(self, largest=np.sort(np.maximum(self.largest, more)))

    def p_family(self, minus_log_p: float) -> float:
        """Share of the draws whose largest score is at least this; no less than 1 / (draws + 1)."""
        return float((1 + np.sum(self.largest >= minus_log_p)) / (self.largest.size + 1))


def bootstrap(
    evidence: Evidence,
    projection: TangentProjection,
    groups: Mapping[str, Sequence[TemplateGroup]],
    scan: Scan,
    draws: int,
    seed: int,
    progress: Callable[[int], object] | None = None,
    decided: Callable[[Bootstrap], bool] | None = None,
) -> Bootstrap:
    """Draw speckle with the residual's own correlation and take it through the projection, every score and the scan.

    A draw stands for a refit: the tangent space is taken out of it as a fit would. Processes share the draws. With
    `decided` there are `FIRST` of them, and all only where these do not decide.
    """
    speckle = Speckle(evidence.observations, evidence.autocovariance)
    seeds = np.random.SeedSequence(seed).spawn(-(-draws // BATCH))

    processes = once.processes()

    def batch(sequence: np.random.SeedSequence) -> dict[str, np.ndarray]:
        check()
        random = np.random.default_rng(sequence)
        drawn = speckle(random, BATCH)
        known = projection.known.drawn(random, BATCH)
        limit = np.float32(LARGEST)
        residuals = projection(np.clip(drawn, -limit, limit, out=drawn), known)  # as the evidence is
        found = {name: np.max([g.largest(residuals) for g in members], axis=0) for name, members in groups.items()}
        found["scan"] = scan.largest(evidence.split(residuals))
        if progress is not None:
            progress(BATCH * processes)
        return found

    def run(some: Sequence[np.random.SeedSequence]) -> list[dict[str, np.ndarray]]:
        return once.share([partial(batch, sequence) for sequence in some], run=threads.in_threads)

    def calibrated(batches: Sequence[Mapping[str, np.ndarray]]) -> Bootstrap:
        scores = {name: np.concatenate([b[name] for b in batches], axis=-1)[..., :draws] for name in batches[0]}
        tails = {name: (Tail if values.ndim == 1 else Tails).of(values) for name, values in scores.items()}
        return Bootstrap(tails, np.sort(np.max([tails[name](values) for name, values in scores.items()], axis=0)))

    first = len(seeds) if decided is None else min(FIRST // BATCH, len(seeds))
    batches = run(seeds[:first])
    found = calibrated(batches)
    if decided is None or first == len(seeds):
        return found
    if once.decide(float(decided(found))):
        if progress is not None:
            progress((len(seeds) - first) * BATCH)
        return found
    return calibrated([*batches, *run(seeds[first:])])
