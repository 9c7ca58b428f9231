"""One measured image beside what a model makes of it; and all measured images of a scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np
import warp as wp

from warpsar.compare.metrics import ImageMetrics, image_metrics
from warpsar.compare.modelled import BY_RAYS, SURE_SDS, KeptAreas, Modelled, modelled, sampled
from warpsar.compare.observation import Observation, declared_looks, looks_of, observe, usable_pixels
from warpsar.effects.registry import declared, get
from warpsar.runtime import console, once
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import hit_grid
from warpsar.simulation.sampling import RAY_NOISE, choose_density
from warpsar.speckle.likelihood import best_gain, scaled_deviance
from warpsar.surface.stage import Stage
from warpsar.trace.rays import ray_count
from warpsar.world.tables import View
from warpsar.world.world import geometry_of, lacks_images

ALLOWED_PX = 0.1  # pixels by which outlines may lie off that nobody states the accuracy of
LEVEL_SHARE = 0.05  # of the interior's median: power in pixels that are not lit as a whole is judged against so much
LARGEST = 8.0  # standard deviations at which a residual is cut off
SCATTERS = 1e-4  # share of a pixel's variance, below which its own scatter is nothing
AT_EDGES = 0.02  # share of a pixel's variance that the allowed displacement makes, from which it belongs to edges


@dataclass(frozen=True)
class Comparison:
    """One measured image beside the model's. Arrays have shape (rows, cols) = (range, azimuth) unless said otherwise.

    `seen` holds the measured beta0 and the interior, whose pixels the metrics compare. `simulated`: beta0 of the model,
    with `gain`. `level` [beta0]: what power outside of the interior is judged against. `usable`: finite, unmasked, off
    the image's edge. `slopes`, `moves`, `exact`, `incidence_deg` and `material` are those of `Modelled`, with the gain.
    `reach_px`: pixels by which outlines may lie off in range and in azimuth.
    `smeared`: cells in azimuth over which effects of phase spread one point: its speckle is one draw in all of them.
    `by_rays`: variance of `simulated` that its rays leave (`modelled.ray_variance`).
    `sampling_noise`: looks x relative variance of the model that its rays leave, averaged over the interior.
    `start_m`, `spacing_m`: range and azimuth of the first pixel's outer corner about the reference point, and steps.
    """

    seen: Observation
    simulated: np.ndarray
    gain: float
    level: float
    usable: np.ndarray
    slopes: np.ndarray
    moves: np.ndarray
    exact: bool
    reach_px: tuple[float, float]
    smeared: float
    by_rays: np.ndarray
    sampling_noise: float
    incidence_deg: np.ndarray
    material: np.ndarray
    start_m: tuple[float, float]
    spacing_m: tuple[float, float]

    def __repr__(self) -> str:
        rows, cols = self.simulated.shape
        return f"<Comparison {self.name}: {self.role}, {rows} x {cols} pixels, gain {self.gain:.4g}>"

    @property
    def view(self) -> View:
        return self.seen.view

    @property
    def role(self) -> str:
        return self.seen.view.role

    @property
    def polarization(self) -> str:
        return self.seen.polarization

    @property
    def name(self) -> str:
        return f"{self.view.name} {self.polarization}"

    @property
    def measured(self) -> np.ndarray:
        """beta0, linear power, NaN where it is not finite."""
        return self.seen.measured

    @property
    def interior(self) -> np.ndarray:
        return self.seen.interior

    @cached_property
    def valid(self) -> np.ndarray:
        """Pixels that measure power, wherever they lie but on masked ground."""
        return np.asarray(self.usable & (np.nan_to_num(self.measured) > 0))

    @property
    def range_m(self) -> np.ndarray:
        """Slant range of the rows' centres about the reference point, shape (rows,)."""
        return np.asarray(self.start_m[0] + (np.arange(self.simulated.shape[0]) + 0.5) * self.spacing_m[0])

    @property
    def azimuth_m(self) -> np.ndarray:
        """Azimuth of the columns' centres about the reference point, shape (cols,)."""
        return np.asarray(self.start_m[1] + (np.arange(self.simulated.shape[1]) + 0.5) * self.spacing_m[1])

    @cached_property
    def metrics(self) -> ImageMetrics:
        """As evaluate.json has them."""
        return image_metrics(self.seen, self.simulated, self.valid)

    @property
    def ratio_db(self) -> np.ndarray:
        """10 log10(measured / simulated) [dB]; NaN where either is not positive."""
        return ratio_db(self.measured, self.simulated)

    @property
    def scaled_deviance(self) -> np.ndarray:
        """d / E[d] of every interior pixel, shape (n,): 1 on average where speckle alone is left."""
        return scaled_deviance(self.seen.values, self.simulated[self.interior], self.seen.law)

    @cached_property
    def displaced(self) -> np.ndarray:
        """The square of what the allowed displacement of outlines changes, at most."""
        reach = np.array(self.reach_px)[:, None, None]
        return np.maximum(((reach * self.slopes) ** 2).sum(axis=0), (self.moves**2).sum(axis=0))

    @cached_property
    def sd(self) -> np.ndarray:
        """Standard deviation of a pixel about the model: speckle's, what outlines change that lie a little off, and
        what rays leave open."""
        power = self.simulated + np.where(self.interior, 0.0, self.level)
        return np.sqrt(np.maximum(power, 1e-30) ** 2 / self.seen.looks + self.displaced + self.by_rays)

    @cached_property
    def residual(self) -> np.ndarray:
        """(measured - simulated) / sd of usable pixels within +-`LARGEST`; 0 elsewhere."""
        away = (np.nan_to_num(self.measured).astype(float) - self.simulated) / self.sd
        return np.where(self.usable, np.clip(away, -LARGEST, LARGEST), 0.0)

    @cached_property
    def at_edges(self) -> np.ndarray:
        """Usable pixels that the allowed displacement of outlines changes beside speckle."""
        return np.asarray(self.usable & (self.displaced > AT_EDGES * self.sd**2))

    @cached_property
    def open_by_rays(self) -> np.ndarray:
        """Usable pixels whose power the model's rays leave open beside speckle."""
        return np.asarray(self.usable & (self.by_rays > BY_RAYS * self.sd**2))

    @cached_property
    def even(self) -> np.ndarray:
        """Pixels of the interior that no edge is in, and that rays tell."""
        return np.asarray(self.interior & ~self.at_edges & ~self.open_by_rays)

    @cached_property
    def scatters(self) -> np.ndarray:
        """Usable pixels that speckle, displaced outlines or rays make scatter; in the others the model has nothing."""
        own = self.simulated**2 / self.seen.looks + self.displaced + self.by_rays
        return np.asarray(self.usable & (own > SCATTERS * self.sd**2))

    def under(self, view: View) -> Comparison:
        """The same with looks and texture as `view` declares them."""
        looks, seen = declared_looks(view), self.seen
        stated = (looks, view.looks_estimated, view.texture or math.inf)
        if looks is None or stated == (seen.looks, seen.looks_estimated, seen.texture):
            return self
        seen = replace(
            self.seen, view=view, looks=looks, looks_estimated=view.looks_estimated, texture=view.texture or math.inf
        )
        return replace(self, seen=seen)

    def part(self, rows: slice, cols: slice) -> Comparison:
        """A rectangle of it."""
        seen = self.seen
        planes = {k: getattr(seen, k)[rows, cols] for k in ("measured", "interior", "silent", "dark")}
        least = None if seen.least is None else seen.least[rows, cols]
        own = {k: getattr(self, k)[rows, cols] for k in ("simulated", "usable", "by_rays", "incidence_deg", "material")}
        own |= {k: getattr(self, k)[:, rows, cols] for k in ("slopes", "moves")}
        return replace(self, seen=replace(seen, **planes, least=least), **own)


def ratio_db(measured: np.ndarray, other: np.ndarray) -> np.ndarray:
    """10 log10(measured / other) [dB], any shape; NaN where either is not positive."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = 10.0 * np.log10(measured.astype(float) / other)
    return np.where((measured > 0) & (other > 0), ratio, np.nan)


@dataclass(frozen=True)
class SceneComparison:
    """All images of a scene that were measured, in the order of its views, and the rays per square metre that sample
    what exact areas do not. Of several processes the first one holds all of them, the others none; `own` are those of
    this one."""

    images: list[Comparison]
    own: list[Comparison]
    rays_per_m2: float

    def of(self, role: str) -> list[Comparison]:
        return [image for image in self.images if image.role == role]


def compare(
    scene: Scene,
    device: wp.Device,
    *,
    seed: int | None = None,
    roles: Sequence[str] = ("train", "test"),
    shared: bool = False,
    progress: str = "",
    edges: bool = True,
    kept: KeptAreas | None = None,
) -> SceneComparison:
    """Every measured image of the scene, of these roles, beside the declared model. Nothing is fitted but one gain for
    an image where the images are not calibrated.

    `seed` overrides the scene's. `shared`: whether the processes of the run share the views. `progress`: what the bar
    is called; empty for none. Without `edges` there are metrics alone, and no judgement: `slopes` and `moves` are 0.
    `kept`: exact areas that models of one mesh share, and their densities.
    Raises InputError for a scene without measured images, or where image and mesh do not meet.
    """
    views = [(index, view) for index, view in enumerate(scene.views) if view.images and view.role in roles]
    if not views:
        raise lacks_images(scene, *roles)
    stage, seed = Stage.of(scene, device), scene.seed(seed)
    # Image effects only lower the noise of what is lit, but spread light where next to none is left to measure it on.
    plain = replace(scene, effects={name: t for name, t in scene.effects.items() if get(name).stage != "image"})
    looks = [looks_of(scene, view) for _, view in views]
    sharing = once.join(device) if shared else once.ALONE
    density = scene.sampling.density_per_m2(scene.grid)
    if sampled(plain):  # exact areas alone have no noise for which more would be chosen
        named = [view for _, view in views]
        kept = kept or KeptAreas()
        density = kept.density(
            scene, named, lambda: choose_density(plain, stage, named, looks, RAY_NOISE, shared=shared).rays_per_m2
        )
    grid = hit_grid(scene)
    costs = [ray_count(stage.target, geometry_of(scene, view), grid, density) * len(view.images) for _, view in views]
    mine = sharing.mine(costs)
    bar = console.progress(len(mine), progress, "view") if progress else None

    def images() -> list[Comparison]:
        found = []
        for index, view in (views[i] for i in mine):
            planes = modelled(scene, stage, view, index, seed, density, edges=edges, kept=kept)
            found += [beside(scene, view, pol, plane) for pol, plane in planes.items()]
            if bar is not None:
                bar.update()
        return found

    found = sharing.agree(images)
    if bar is not None:
        bar.close()
    return SceneComparison(found if sharing.alone else _collected(scene, found, sharing), found, density)


def beside(scene: Scene, view: View, polarization: str, model: Modelled) -> Comparison:
    """The view's measured image of a polarization beside its model.

    Raises NothingLitError where no pixel is lit by the model, unmasked and positive at once.
    """
    seen = observe(scene, view, polarization, model.covered & (model.beta0 > 0))
    mu = model.beta0[seen.interior]
    gain = 1.0 if scene.grid.calibrated else best_gain("gamma", seen.values, mu, seen.looks)
    reach = granted_px(scene)
    grid = hit_grid(scene)
    return Comparison(
        seen=seen,
        simulated=gain * model.beta0,
        gain=gain,
        level=LEVEL_SHARE * gain * float(np.median(mu)),
        usable=usable_pixels(scene, view, seen.measured),
        slopes=gain * model.slopes,
        moves=gain * model.moves,
        exact=model.exact,
        reach_px=(reach[0], reach[1]),
        smeared=_smeared(scene, view),
        by_rays=gain**2 * model.variance,
        sampling_noise=seen.looks * float(np.mean(model.variance[seen.interior] / mu**2)),
        incidence_deg=model.incidence_deg,
        material=model.material,
        start_m=grid.start_m,
        spacing_m=grid.spacing_m,
    )


def granted_px(scene: Scene) -> list[float]:
    """Rows and columns by which outlines may lie off: what the scene's accuracy grants, at least `ALLOWED_PX`."""
    accuracy = scene.accuracy_m or 0.0
    return [max(ALLOWED_PX, SURE_SDS * accuracy / step) for step in scene.grid.spacing_m]


def _smeared(scene: Scene, view: View) -> float:
    """Cells in azimuth over which the view's effects of phase spread a point: the slope of the phase spans so many."""
    place = np.linspace(-1.0, 1.0, 201)
    turned = [one.effect.phase(one.values, one.settings, place) for one in declared(scene, view)]
    return 1.0 + sum(float(np.ptp(np.gradient(one, place))) / np.pi for one in turned if one is not None)


def _collected(scene: Scene, images: Sequence[Comparison], sharing: once.Sharing) -> list[Comparison]:
    """The images of all processes on the first one, in the order of the scene's views, which every process has read."""
    views, without = {view.name: view for view in scene.views}, cast(View, None)
    mine = [(image.view.name, replace(image, seen=replace(image.seen, view=without))) for image in images]
    found = [each for part in sharing.collect(mine) for each in part]
    found.sort(key=lambda each: list(views).index(each[0]))
    return [replace(image, seen=replace(image.seen, view=views[name])) for name, image in found]
