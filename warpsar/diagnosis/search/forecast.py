"""How long a diagnosis will take: said before it begins, from a timed sample of its work.

Nobody knows beforehand how many effects there are. So what is said is how long it takes where nothing is missing, and
how much each effect adds that is found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.scores.bootstrap import BATCH
from warpsar.diagnosis.scores.evidence import Evidence
from warpsar.runtime import threads
from warpsar.runtime.forecast import LONG_S, duration, timed
from warpsar.scene.scene import Scene
from warpsar.speckle.draws import Speckle
from warpsar.speckle.scan import Scan
from warpsar.speckle.tail import FIRST

# Set on the shared cases `none` and `tall`, on two cores; benchmarks/diagnosis_forecast.py holds them against others.
JACOBIANS = 60.0  # of a start of a fit, and of the models that are judged
BATCHES = 45.0  # of draws beside the first ones of the bootstrap, that templates, scores and the judgement are worth
EFFECT = 2.0  # times all of it, for an effect that is found: candidates' fits, the next turn, and confirmation


@dataclass(frozen=True)
class DiagnosisForecast:
    """`nothing_s`: where nothing is missing. `effect_s`: what each effect adds that is found."""

    nothing_s: float
    effect_s: float

    def __str__(self) -> str:
        return (
            f"about {duration(self.nothing_s)} if nothing is missing, and about {duration(self.effect_s)} more for "
            f"each effect that is found; --time-limit ends it earlier"
        )


def forecast(setup: FitSetup, scene: Scene, options: DiagnoseOptions) -> DiagnosisForecast | None:
    """From one Jacobian of the declared model and one batch of draws of speckle; None where it is not long.

    The Jacobian is made twice, and the second is timed: the first one compiles.
    """
    problem = setup.problem(scene)
    problem.jacobian(problem.x0)
    jacobian, _ = timed(lambda: problem.jacobian(problem.x0))
    evidence = Evidence.of(problem, problem.x0)
    speckle = Speckle(evidence.observations, evidence.autocovariance)
    scan = Scan(evidence.observations, evidence.autocovariance, evidence.silent)
    batch, _ = timed(lambda: scan.largest(evidence.split(speckle(np.random.default_rng(0), BATCH))))
    draws = min(options.draws, FIRST) / BATCH
    batches = draws / min(threads.thread_count(), draws) + BATCHES
    nothing = JACOBIANS * (1 + options.starts) * jacobian + batches * batch
    return DiagnosisForecast(nothing, EFFECT * nothing) if nothing > LONG_S else None
