"""How large the largest score gets by speckle alone: a parametric bootstrap at the looks declared."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.stats import gamma, norm

from warpsar.diagnosis.evidence import LARGEST, Evidence
from warpsar.diagnosis.scan import Scan
from warpsar.diagnosis.score import Group, Projection
from warpsar.runtime import threads
from warpsar.runtime.distributed import ONE, Ranks

BATCH = 25  # draws at once; fixed, so that the numbers do not depend on the threads
TAIL = 0.1  # share of the draws from which a score's tail is taken to fall off exponentially


@dataclass(frozen=True)
class Tail:
    """-ln of the probability that speckle alone exceeds a value, from draws: their empirical tail down to `TAIL`, and
    an exponential one beyond it (peaks over threshold)."""

    body: np.ndarray  # sorted draws
    edge: float
    scale: float

    @classmethod
    def of(cls, draws: np.ndarray) -> Tail:
        body = np.sort(draws)
        edge = float(np.quantile(body, 1.0 - TAIL))
        excess = body[body > edge] - edge
        return cls(body, edge, max(float(excess.mean()) if excess.size else 0.0, 1e-6))

    def __call__(self, values: npt.ArrayLike) -> np.ndarray:
        values = np.asarray(values, float)
        above = self.body.size - np.searchsorted(self.body, values, side="left")
        empirical = -np.log(np.maximum((above + 1.0) / (self.body.size + 1.0), TAIL))
        beyond = -np.log(TAIL) + (values - self.edge) / self.scale
        return np.where(values > self.edge, beyond, np.minimum(empirical, -np.log(TAIL)))


@dataclass(frozen=True)
class Bootstrap:
    """Calibrated scores. `tails`: per effect, and "scan" among them, of its largest score; every one so counts alike,
    however many trials it has. `largest`: the largest -ln p of every draw over all of them, sorted."""

    tails: Mapping[str, Tail]
    largest: np.ndarray

    def threshold(self, family_error: float) -> float:
        """What any of them must exceed, in calibrated -ln p, at the family's error rate."""
        return float(np.quantile(self.largest, 1.0 - family_error))

    def p_family(self, minus_log_p: float) -> float:
        """Share of the draws whose largest score is at least this; no less than 1 / (draws + 1)."""
        return float((1 + np.sum(self.largest >= minus_log_p)) / (self.largest.size + 1))


def bootstrap(
    evidence: Evidence,
    projection: Projection,
    groups: Mapping[str, Sequence[Group]],
    scan: Scan,
    draws: int,
    seed: int,
    progress: Callable[[int], object] | None = None,
    ranks: Ranks = ONE,
) -> Bootstrap:
    """Draw speckle with the residual's own correlation and take it through the projection, every score and the scan.

    A draw stands for a refit: the tangent space is taken out of it as a fit would. `ranks` share the draws.
    """
    speckle = Speckle(evidence)
    seeds = np.random.SeedSequence(seed).spawn(-(-draws // BATCH))

    def batch(sequence: np.random.SeedSequence) -> dict[str, np.ndarray]:
        drawn = speckle(np.random.default_rng(sequence), BATCH)
        residuals = projection(np.clip(drawn, -LARGEST, LARGEST))  # as the evidence is
        found = {
            name: np.max([g.statistics(residuals)[1].max(axis=0) for g in members], axis=0)
            for name, members in groups.items()
        }
        found["scan"] = scan.largest(evidence.split(residuals))
        if progress is not None:
            progress(BATCH * ranks.size)
        return found

    batches = ranks.deal_out(
        [partial(batch, sequence) for sequence in seeds],
        told=lambda found: {name: values.tolist() for name, values in found.items()},
        heard=lambda found: {name: np.array(values) for name, values in found.items()},
        run=threads.in_threads,
    )
    scores = {name: np.concatenate([b[name] for b in batches])[:draws] for name in batches[0]}
    tails = {name: Tail.of(values) for name, values in scores.items()}
    largest = np.max([tails[name](values) for name, values in scores.items()], axis=0)
    return Bootstrap(tails, np.sort(largest))


class Speckle:
    """Standardised gamma speckle on the pixels of the evidence, with its autocovariance.

    Correlated: a Gaussian field taken to the gamma distribution quantile by quantile, which lowers correlations (0.72
    to 0.65 at one look); the field's own are as much higher.
    """

    def __init__(self, evidence: Evidence) -> None:
        self.observations = evidence.observations
        self.white = np.count_nonzero(evidence.autocovariance) == 1
        self.sd = float(np.sqrt(evidence.autocovariance.max()))
        self.spectra = []
        # gamma quantiles over those of the normal distribution, once for every number of looks
        self._normal = np.linspace(-7.0, 7.0, 4001)
        self._power: dict[float, np.ndarray] = {}
        if not self.white:
            lags = evidence.autocovariance.shape[0] // 2
            correlation = evidence.autocovariance / evidence.autocovariance[lags, lags]
            for seen in self.observations:
                kernel = np.zeros([n + 2 * lags for n in seen.interior.shape])
                if seen.looks not in self._power:
                    self._power[seen.looks] = self._quantiles(seen.looks)
                kernel[: 2 * lags + 1, : 2 * lags + 1] = self._underlying(correlation, seen.looks)
                kernel = np.roll(kernel, (-lags, -lags), (0, 1))
                self.spectra.append((kernel.shape, np.sqrt(np.maximum(np.fft.rfft2(kernel).real, 0.0))))

    def __call__(self, random: np.random.Generator, draws: int) -> np.ndarray:
        """Draws of sqrt(L) (I / mu - 1), shape (n, draws); scaled up where the residual varies more than speckle."""
        parts = []
        for index, seen in enumerate(self.observations):
            looks = seen.looks
            if self.white:
                power = random.standard_gamma(looks, (int(seen.interior.sum()), draws)) / looks
            else:
                shape, spectrum = self.spectra[index]
                noise = np.fft.rfft2(random.standard_normal((draws, *shape)))
                rows, cols = seen.interior.shape
                field = np.fft.irfft2(noise * spectrum, shape)[:, :rows, :cols][:, seen.interior].T
                field /= np.sqrt(np.mean(spectrum**2)) if spectrum.any() else 1.0
                power = np.interp(field, self._normal, self._power[looks])
            parts.append(np.sqrt(looks) * (power - 1.0))
        return np.concatenate(parts) * max(self.sd, 1.0)

    def _quantiles(self, looks: float) -> np.ndarray:
        below = gamma.ppf(norm.cdf(self._normal), looks)
        above = gamma.isf(norm.sf(self._normal), looks)
        return np.where(self._normal < 0, below, above) / looks

    def _underlying(self, correlation: np.ndarray, looks: float) -> np.ndarray:
        """Correlations of normal variables whose gamma ones have `correlation` (not negative), any shape.

        The transform's Hermite coefficients c_k make it sum(c_k^2 rho^k) / sum(c_k^2) (Lancaster, 1957).
        """
        z, w = np.polynomial.hermite_e.hermegauss(120)
        power = np.interp(z, self._normal, self._power[looks])
        order = np.arange(1, 25)
        hermite = np.polynomial.hermite_e.hermevander(z, order[-1])[:, 1:]
        shares = ((w * power) @ hermite) ** 2 / np.cumprod(order.astype(float))
        rho = np.linspace(0.0, 1.0, 201)
        return np.interp(correlation, (rho[:, None] ** order) @ shares / shares.sum(), rho)
