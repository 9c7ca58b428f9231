"""What images can tell at best: gains in 2 ln L of models fitted to noise-free images, and their spread by speckle.

Every model is fitted to the noise-free images of the truth by the gamma loss (the Kullback-Leibler projection). Speckle
then moves each fit by one Gauss-Newton step. Nothing is fitted again for a draw, so hundreds of draws cost seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from scipy.ndimage import gaussian_filter

from warpsar.compare.observation import Observation
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.frozen import frozen
from warpsar.diagnosis.models.left_out import BLOCK, clipped
from warpsar.diagnosis.models.refit import descend
from warpsar.diagnosis.scores.evidence import LARGEST, Evidence
from warpsar.diagnosis.scores.score import TangentProjection, TemplateGroup, group
from warpsar.diagnosis.scores.templates import TemplateMaker, with_effect
from warpsar.effects.registry import names
from warpsar.io.images import write_tiff
from warpsar.learning.optimise import begin
from warpsar.learning.problem import FitProblem
from warpsar.learning.results import learned_scene
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.speckle.likelihood import loss_terms
from warpsar.speckle.own import LAGS, TAPER
from warpsar.surface.stage import Stage

RAYS_PER_PIXEL = 64.0  # the truth and every model use the same rays, so that their sampling noise cancels
FIT_LOOKS = 16.0  # of the noise-free fits: the expected gain is proportional to the looks
# Log coordinates that speckle moves a parameter by, as a standard deviation: a direction that the data do not see would
# otherwise go on without end, where a fit meets bounds.
REACH = 2.0
AT_BOUND = 0.02  # nearer to a bound than this, a parameter stays there
AGAIN, ARRIVED = 10, 0.01  # times that a fit goes on, and the log-likelihood at which it has arrived
ALIKE = 0.3  # share of what the declared model leaves, that a rival's template must explain to be fitted


Speckle = Callable[[Observation], np.ndarray]
"""Draws of speckle for an image's compared pixels, shape (draws, pixels)."""


@dataclass(frozen=True)
class Part:
    """What belongs to one effect in a model: `own` columns, shape (p,); `floor`, how far down a step of them goes;
    `views` that have numbers of their own, where all its numbers are such."""

    own: np.ndarray
    floor: np.ndarray
    views: tuple[str, ...] | None


@dataclass(frozen=True)
class Model:
    """A model at its best fit to the noise-free images. `mu`: beta0 of all compared pixels, shape (n,); `jacobian`:
    d ln(mu) / dx, shape (n, p), and 0 for what lies at a bound; `parts` by effect. `size` is the number of parameters
    that count, and `labels` names the p."""

    scene: Scene
    mu: np.ndarray
    jacobian: np.ndarray
    parts: Mapping[str, Part]
    size: int
    labels: list[str]

    @classmethod
    def of(cls, setup: FitSetup, scene: Scene, x: np.ndarray | None = None) -> Model:
        """The scene's model, as declared or at `x` of its fit problem."""
        problem = setup.problem(scene, dark=False)
        scene = scene if x is None else learned_scene(problem, x)
        problem = setup.problem(scene, dark=False)
        mu = np.concatenate(problem.modelled_as_declared())
        jacobian = np.concatenate(problem.jacobian(np.clip(problem.x0, *problem.bounds)))
        low, high = problem.bounds
        jacobian[:, (problem.x0 < low + AT_BOUND) | (problem.x0 > high - AT_BOUND)] = 0.0
        zero_sums = {(c.effect, c.key) for c in problem.effect_coordinates if c.declared.zero_sum}
        size = problem.x0.size - len(zero_sums)
        return cls(scene, mu, jacobian, {name: _part(problem, name) for name in scene.effects}, size, problem.labels)


def _part(problem: FitProblem, effect: str) -> Part:
    surface = problem.learned.size
    mine = [(surface + k, c) for k, c in enumerate(problem.effect_coordinates) if c.effect == effect]
    own, floor = np.zeros(problem.x0.size, bool), np.full(problem.x0.size, -np.inf)
    own[[k for k, _ in mine]] = True
    # a level in log coordinates changes the image in proportion to itself: at -1 nothing of it is left
    floor[[k for k, c in mine if c.declared.scale == "log"]] = -1.0
    views = tuple(dict.fromkeys(c.view for _, c in mine if c.view is not None))
    return Part(own, floor, views if all(c.view is not None for _, c in mine) else None)


class NoiseFree:
    """Noise-free images of a scene with `effects`, on the rays and pixels that all models share.

    `scene` declares none of the effects and holds the true materials. Images are written into `folder`.
    """

    def __init__(self, scene: Scene, effects: Mapping[str, Mapping[str, Any]], device: wp.Device, folder: Path) -> None:
        rays, other = (Rays(Stage.of(scene, device), density_of(scene), seed) for seed in (11, 12))
        every = [(view.name, polarization) for view in scene.views for polarization in scene.radar.polarizations]
        ones = {key: np.ones(scene.grid.shape, np.float32) for key in every}
        self.device, self.other = device, other
        truth = replace(_with_images(scene, ones, folder), effects={n: dict(t) for n, t in effects.items()})
        problem = FitProblem(truth, device, rays=rays)
        problem.modelled_as_declared()
        images = {
            (v.view.name, polarization): np.asarray(image.numpy().reshape(scene.grid.shape), np.float32)
            for v in problem.views
            for polarization, image in v.render.images.items()
        }
        self.scene = _with_images(scene, {**ones, **images}, folder)
        one, two = (FitSetup(device, each, {}) for each in (rays, other))
        self.setup = replace(one, observations=frozen(one, two, self.scene))
        self.effects = effects
        self.truth = Model.of(self.setup, replace(self.scene, effects=truth.effects))
        self.seen = [one for found in self.setup.observations.values() for one in found]
        self.ends = np.cumsum([one.count for one in self.seen])

    def split(self, pixels: np.ndarray) -> list[np.ndarray]:
        """An array over all pixels, (n, ...), as one per observation."""
        return np.split(pixels, self.ends[:-1])

    def fitted(self, effects: Mapping[str, Mapping[str, Any]], further: int = 4) -> Model:
        """The model with these effects at its best, from the true surface and `further` starts about it."""
        return self._best(replace(self.scene, effects={n: dict(t) for n, t in effects.items()}), further)

    def rivals(self, base: Model, without: str) -> dict[str, Model]:
        """`base` and one effect more, for each effect that explains a good part of what it leaves."""
        found = {}
        evidence = self.evidence(base, white())
        maker, projection = self.templates(base, evidence)
        left = projection(evidence.standardised)
        for name in names():
            if name == without or name in base.scene.effects:
                continue
            trials = [
                (float(s), one.templates[t].trial)
                for one in group(maker.templates(name), projection, evidence)
                for t, s in enumerate(one.statistics(left[:, None])[0][:, 0])
            ]
            if not trials or max(s for s, _ in trials) < ALIKE * float(left @ left):
                continue
            _, best = max(trials, key=lambda pair: pair[0])
            models = [self._best(with_effect(base.scene, name, table), 0) for table in best.starts]
            found[name] = max(models, key=self._likelihood)
        return found

    def _likelihood(self, model: Model) -> float:
        return -float(self.lost(np.concatenate([one.values for one in self.seen])[:, None], model.mu, 1.0).sum())

    def _best(self, scene: Scene, further: int) -> Model:
        """Descended again from where it arrived, until that brings nothing: the valleys are long and flat."""
        problem = self.setup.problem(scene, dark=False)
        x, loss, _ = descend(problem, [begin(problem, k, 7).x for k in range(further + 1)])
        for _ in range(AGAIN):
            x, now, _ = descend(problem, [x])
            if now > loss - ARRIVED:
                break
            loss = now
        return Model.of(self.setup, scene, x)

    def evidence(self, base: Model, autocovariance: np.ndarray, looks: float = FIT_LOOKS) -> Evidence:
        """What `base` leaves of the noise-free images, as if they had `looks`."""
        seen = [replace(one, looks=looks) for one in self.seen]
        ratio = np.concatenate([one.values for one in seen]) / base.mu
        standardised = np.clip(np.sqrt(looks) * (ratio - 1.0), -LARGEST, LARGEST)
        roots = np.full(ratio.size, np.sqrt(looks))
        silent = [np.zeros(one.interior.shape) for one in seen]
        return Evidence(seen, self.split(base.mu), standardised, roots, autocovariance, silent)

    def templates(self, base: Model, evidence: Evidence) -> tuple[TemplateMaker, TangentProjection]:
        """Of a turn about `base`."""
        maker = TemplateMaker(base.scene, self.device, self.other, self.setup.observations, evidence.modelled)
        return maker, TangentProjection(maker.tangent(), evidence.root_looks)

    def groups(
        self, name: str, maker: TemplateMaker, projection: TangentProjection, evidence: Evidence
    ) -> list[TemplateGroup]:
        """The templates of an effect, ready for residuals."""
        return group(maker.templates(name), projection, evidence)

    def lost(self, beta0: np.ndarray, mu: np.ndarray, looks: float) -> np.ndarray:
        """Negative log-likelihood of every pixel, shape of `beta0` (n, draws); `mu` is (n,) or alike."""
        return loss_terms("gamma", beta0, mu if mu.ndim == beta0.ndim else mu[:, None], looks)


def turned(scene: Scene) -> Scene:
    """The scene with train and test views exchanged."""
    other = {"train": "test", "test": "train"}
    return replace(scene, views=[v.model_copy(update={"role": other[v.role]}) for v in scene.views])


class HeldViews:
    """The noise-free test views of a scene, on rays and pixels that all models share: do they withdraw a right result?

    An effect that has numbers of single views, or that trades with the surface, is known badly from few views. Its
    model may then be farther from the test views than the declared one, though it is the true one.
    """

    def __init__(self, noise_free: NoiseFree) -> None:
        self._noise_free = noise_free
        scene, rays = turned(noise_free.scene), noise_free.setup.rays
        other = Rays(rays.stage, rays.rays_per_m2, rays.seed + 1)
        one, two = (FitSetup(noise_free.device, each, {}) for each in (rays, other))
        self._setup = replace(one, observations=frozen(one, two, scene))
        self.seen = [one for found in self._setup.observations.values() for one in found]

    def of(self, model: Model) -> tuple[np.ndarray, np.ndarray]:
        """beta0 of the compared pixels, shape (n,), and d ln(beta0) / dx, (n, p), with x as the model has it.

        Numbers of train views change nothing here.
        """
        problem = self._setup.problem(turned(model.scene), dark=False)
        mu = np.concatenate(problem.modelled_as_declared())
        known = dict(zip(problem.labels, np.concatenate(problem.jacobian(problem.x0)).T, strict=True))
        nothing = np.zeros(mu.size)
        return mu, np.stack([known.get(label, nothing) for label in model.labels], axis=1)

    def stands(self, beta0: np.ndarray, looks: float, model: Model, base: Model, speckle: Speckle) -> np.ndarray:
        """Whether `model` is no farther from the test views than `base`, by more than the standard error of the
        difference, per draw; `beta0` of the train views, shape (n, draws)."""
        truth, _ = self.of(self._noise_free.truth)
        measured = truth[:, None] * np.concatenate([speckle(one) for one in self.seen], axis=1).T
        lost = []
        for one in (base, model):
            mu, jacobian = self.of(one)
            step = step_of(one, beta0 / one.mu[:, None] - 1.0, looks)
            moved = mu[:, None] * np.exp(np.clip(jacobian @ step, -10.0, 10.0))
            lost.append(self._noise_free.lost(measured, moved, looks))
        gained = lost[0] - lost[1]
        error = np.sqrt(np.maximum(len(gained) * covariance_sum(self.seen, gained - gained.mean(axis=0)), 0.0))
        return np.asarray(gained.sum(axis=0) >= -error)


def density_of(scene: Scene) -> float:
    return RAYS_PER_PIXEL / scene.grid.pixel_area_m2


def white() -> np.ndarray:
    """Autocovariance of speckle without correlation."""
    found = np.zeros((2 * LAGS + 1, 2 * LAGS + 1))
    found[LAGS, LAGS] = 1.0
    return found


def correlated(sigma_px: float) -> np.ndarray:
    """Autocovariance of the power of fields with a Gaussian point-spread function: the fields' own, squared."""
    impulse = np.zeros((8 * LAGS + 1, 8 * LAGS + 1))
    impulse[4 * LAGS, 4 * LAGS] = 1.0
    fields = gaussian_filter(gaussian_filter(impulse, sigma_px), sigma_px)  # the sampled kernel with itself
    middle = slice(3 * LAGS, 5 * LAGS + 1)
    return np.asarray((fields / fields.max())[middle, middle] ** 2)


def expected_gain(truth: Model, base: Model) -> float:
    """2 ln L by which the truth is ahead of `base`, of one look, on average over speckle."""
    ratio = truth.mu / base.mu
    return float(2.0 * (ratio - 1.0 - np.log(ratio)).sum())


def gains(noise_free: NoiseFree, beta0: np.ndarray, looks: float, model: Model, base: Model) -> np.ndarray:
    """2 ln L that `model` gains over `base` in every draw, both fitted to it; `beta0` has shape (n, draws)."""
    apart = (noise_free.lost(beta0, base.mu, looks) - noise_free.lost(beta0, model.mu, looks)).sum(axis=0)
    fitted = [_explained(beta0, looks, one) for one in (model, base)]
    return np.asarray(2.0 * apart + fitted[0] - fitted[1])


def _explained(beta0: np.ndarray, looks: float, model: Model) -> np.ndarray:
    """2 ln L that one Gauss-Newton step from the noise-free fit gains in every draw."""
    residual = beta0 / model.mu[:, None] - 1.0
    step = step_of(model, residual, looks)
    gained = model.jacobian @ step
    return np.asarray(looks * (2.0 * gained * residual - gained**2).sum(axis=0))


def inflation(noise_free: NoiseFree, model: Model, base: Model, evidence: Evidence) -> float:
    """Variance of the score beyond `base`, relative to white speckle: what correlated speckle multiplies gains by."""
    basis = TangentProjection(base.jacobian, np.ones(base.mu.size)).basis
    extra = TangentProjection(np.hstack([basis, model.jacobian]), np.ones(base.mu.size)).basis
    left = extra - basis @ (basis.T @ extra)
    left, strength, _ = np.linalg.svd(left, full_matrices=False)
    left = left[:, strength > 0.5]  # orthonormal in all but rounding
    return max(float(evidence.products(left, 1).sum() / max(left.shape[1], 1)), 1.0)


@dataclass(frozen=True)
class Judgement:
    """What views left out say in one draw: `gain` of log-likelihood and its `error` as `leave_one_view_out` has them,
    and the gain that is `expected` where the model with the effect is true."""

    gain: float
    error: float
    expected: float

    @property
    def as_expected(self) -> bool:
        """Over two errors; or, where that is more than the effect itself lets expect, positive and no less than two
        errors under what it lets expect."""
        return self.gain > max(0.0, min(2.0 * self.error, self.expected - 2.0 * self.error))


def left_out(
    noise_free: NoiseFree, beta0: np.ndarray, looks: float, model: Model, base: Model, part: Part
) -> list[Judgement]:
    """`leave_one_view_out` of every draw, with Gauss-Newton steps in place of fits."""
    residual, base_residual = beta0 / model.mu[:, None] - 1.0, beta0 / base.mu[:, None] - 1.0
    views = list(dict.fromkeys(one.view.name for one in noise_free.seen))
    view_of = np.concatenate([np.full(one.count, views.index(one.view.name)) for one in noise_free.seen])
    half_of = np.concatenate([one.pixels % one.interior.shape[1] // BLOCK % 2 for one in noise_free.seen])
    without, with_it = np.empty_like(beta0), np.empty_like(beta0)
    every = np.ones(beta0.shape[0], bool)
    touched = [views.index(v) for v in (part.views or views)]
    for k in touched:
        here = view_of == k
        if part.views is not None:
            for half in (0, 1):
                used, at = ~here | (half_of == half), here & (half_of != half)
                with_it[at] = _moved(model, at, _step(model, used, residual, looks))
                without[at] = _moved(base, at, _step(base, used, base_residual, looks))
        else:
            step = _step(model, ~here, residual, looks) * part.own[:, None]
            step = np.maximum(step, part.floor[:, None])
            rest = _step(model, every, residual - model.jacobian @ step, looks, ~part.own)
            with_it[here] = _moved(model, here, step + rest)
            without[here] = _moved(base, here, _step(base, every, base_residual, looks))
    judged = np.isin(view_of, touched)
    now, mean = (
        clipped(noise_free.lost(of, without, looks) - noise_free.lost(of, with_it, looks))[judged]
        for of in (beta0, with_it)
    )
    chosen = [one for one in noise_free.seen if views.index(one.view.name) in touched]
    covariance = covariance_sum(chosen, now - mean)
    error = np.sqrt(np.maximum(len(now) * (covariance + mean.var(axis=0)), 0.0))
    found = zip(now.sum(axis=0), error, mean.sum(axis=0), strict=True)
    return [Judgement(*map(float, one)) for one in found]


def covariance_sum(seen: Sequence[Observation], residuals: np.ndarray) -> np.ndarray:
    """Sum of `residual_autocovariance` of every draw, shape (draws,); `residuals` of the pixels of all `seen`, (n,
    draws). All draws at once, by Fourier transforms."""
    total, count = 0.0, 0.0
    for one, part in zip(seen, np.split(residuals, np.cumsum([s.count for s in seen])[:-1]), strict=True):
        shape = [n + LAGS for n in one.interior.shape]
        grid = np.zeros((part.shape[1] + 1, *one.interior.shape))
        grid[:-1, one.interior], grid[-1] = part.T, one.interior
        lagged = np.fft.irfft2(np.abs(np.fft.rfft2(grid, shape)) ** 2, shape)
        lagged = np.roll(lagged, (LAGS, LAGS), (1, 2))[:, : 2 * LAGS + 1, : 2 * LAGS + 1]
        total, count = total + lagged[:-1], count + np.round(lagged[-1])
    covariance = total / np.maximum(count, 1.0)
    variance = covariance[:, LAGS, LAGS].copy()
    noise = covariance < 3.0 * variance[:, None, None] / np.sqrt(np.maximum(count, 1.0))
    noise[:, LAGS, LAGS] = False
    return np.asarray((np.where(noise, 0.0, covariance) * TAPER).sum(axis=(1, 2)))


def _moved(model: Model, at: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Modelled beta0 of the pixels `at` after a step of x."""
    return np.asarray(model.mu[at, None] * np.exp(np.clip(model.jacobian[at] @ step, -10.0, 10.0)))


def step_of(model: Model, residual: np.ndarray, looks: float) -> np.ndarray:
    """Gauss-Newton on all pixels, shape (p, draws); `residual` has shape (n, draws)."""
    return _step(model, np.ones(model.mu.size, bool), residual, looks)


def _step(
    model: Model, used: np.ndarray, residual: np.ndarray, looks: float, moving: np.ndarray | None = None
) -> np.ndarray:
    """Gauss-Newton on the pixels `used`, shape (p, draws); a step is a few times `REACH` at most."""
    moving = np.ones(model.jacobian.shape[1], bool) if moving is None else moving
    part = model.jacobian[used][:, moving]
    step = np.zeros((model.jacobian.shape[1], residual.shape[1]))
    curvature = looks * part.T @ part + np.eye(part.shape[1]) / REACH**2
    step[moving] = np.linalg.solve(curvature, looks * part.T @ residual[used])
    return step


def _with_images(scene: Scene, images: Mapping[tuple[str, str], np.ndarray], folder: Path) -> Scene:
    """The scene with its `images`, by view and polarization, written into `folder`."""
    paths: dict[str, dict[str, Path]] = {}
    for (view, polarization), image in images.items():
        path = paths.setdefault(view, {})[polarization] = folder / f"{view}_{polarization}.tif"
        write_tiff(path, image)
    found = [v.model_copy(update={"images": paths[v.name], "looks": FIT_LOOKS}) for v in scene.views]
    return replace(scene, views=found)
