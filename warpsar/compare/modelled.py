"""A view as the model has it: by exact areas where they can be had, else by two independent sets of rays."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from hashlib import sha1
from typing import Any

import numpy as np
from scipy import ndimage

from warpsar.effects.base.effect import DeclaredEffect
from warpsar.effects.registry import declared, get
from warpsar.render.render import ViewRender
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import hit_grid, trace_view, view_seed
from warpsar.surface.samples import image_pixels
from warpsar.surface.stage import Stage
from warpsar.trace.exact import exact_hits
from warpsar.trace.hits import BinGrid, Hits
from warpsar.world.objects.table import Object
from warpsar.world.tables import View
from warpsar.world.world import geometry_of, posed

MOST_FACES, MOST_PIXELS, MOST_SEEN = 2**15, 2**20, 2**18
"""Faces, pixels, and faces times views, for exact areas: beyond them rays are several times as fast, and their noise
lies far below speckle's. Hundreds of views of a fine mesh would take an hour by areas."""
ABOUT = 3  # pixels on a side, over which the variance by rays is averaged
BY_RAYS = 0.1  # share of a pixel's variance that rays make, from which its scatter is not speckle's alone
BINS = 4  # of a pixel along each axis: a quarter of a pixel is what images are moved by
MOST_KEPT = 2**21  # hits of exact areas, of some 60 bytes each, that are kept for further models of a mesh
SURE_SDS = 3.0  # standard deviations by which an object with a stated accuracy is moved


@dataclass(frozen=True)
class Modelled:
    """One polarization of a view. Arrays of shape (rows, cols) unless said otherwise.

    `beta0`: linear power. `slopes`, (2, rows, cols): its change for a pixel of shift in range and in azimuth.
    `moves`, (k, rows, cols): its change where each object that states an accuracy is moved by `SURE_SDS` of it along
    one axis of the world. `covered`: what single bounces reach, and the surface covers (`Rendered.covered`).
    `variance`: of beta0, by the rays (`ray_variance`). `exact`: whether areas are exact. `incidence_deg` and
    `material` (index into the mesh's) are those of the surface in the pixel, weighted by its modelled power; NaN and -1
    where there is none.
    """

    beta0: np.ndarray
    slopes: np.ndarray
    moves: np.ndarray
    covered: np.ndarray
    variance: np.ndarray
    exact: bool
    incidence_deg: np.ndarray
    material: np.ndarray


class KeptAreas:
    """Exact areas of views, which models of one mesh share whatever its surface and effects; the oldest go first. And
    the density of rays that was chosen for views beside effects, whatever numbers these have."""

    def __init__(self) -> None:
        self._kept: dict[tuple[Any, ...], Hits] = {}
        self._densities: dict[Hashable, float] = {}

    def density(self, scene: Scene, views: Sequence[View], choose: Callable[[], float]) -> float:
        """Rays per square metre for these views of the scene: what `choose` finds, or has found for its effects."""
        key = tuple(view.name for view in views), tuple(sorted(scene.effects)), scene.grid.shape
        if key not in self._densities:
            self._densities[key] = choose()
        return self._densities[key]

    def hits(self, scene: Scene, stage: Stage, view: View, grid: BinGrid, seed: int, rays_per_m2: float) -> Hits:
        """As `exact_hits`."""
        target, geometry = stage.target, geometry_of(scene, view)
        mesh = sha1(target.corners.tobytes())
        for part in (target.corner_numbers, stage.face_material.numpy()):
            mesh.update(part.tobytes())
        axes = np.concatenate([geometry.d, geometry.u, geometry.v]).tobytes()
        seen = mesh.digest(), axes, geometry.wavenumber, geometry.slant_range_m, grid, scene.grid.pixel_area_m2
        key = *seen, seed, rays_per_m2
        if key not in self._kept:
            alike = next((hits for known, hits in self._kept.items() if known[: len(seen)] == seen), None)
            if alike is None:
                area = scene.grid.pixel_area_m2
                found = exact_hits(target, geometry, grid, rays_per_m2, seed=seed, pixel_area_m2=area)
            else:  # seed and density are for effects that send rays of their own
                found = replace(alike, seed=seed, rays_per_m2=rays_per_m2, derived={})
            self._kept[key] = found
            while len(self._kept) > 1 and sum(hits.count for hits in self._kept.values()) > MOST_KEPT:
                del self._kept[next(iter(self._kept))]
        return self._kept[key]


def exact_areas(scene: Scene) -> bool:
    """Whether the scene's images are compared by exact areas."""
    faces, measured = len(scene.mesh.faces), sum(bool(view.images) for view in scene.views)
    few = faces <= MOST_FACES and faces * measured <= MOST_SEEN
    return few and int(np.prod(scene.grid.shape)) <= MOST_PIXELS


def sampled(scene: Scene) -> bool:
    """Whether rays sample a part of the scene's images: ways over several surfaces, or all light of a large scene."""
    return not exact_areas(scene) or any(get(name).stage == "path" for name in scene.effects)


def modelled(
    scene: Scene,
    stage: Stage,
    view: View,
    index: int,
    seed: int,
    rays_per_m2: float,
    *,
    edges: bool = True,
    kept: KeptAreas | None = None,
) -> dict[str, Modelled]:
    """The polarizations of which the view has measured images. Without `edges`, slopes and moves are 0.

    Rays sample what exact areas do not: ways over several surfaces, and all light of large scenes. Then two independent
    sets of them are rendered. Their mean is the model, and their difference tells its variance. `index` is the view's
    number in the scene. Exact areas are taken from those `kept`.
    """
    kept = kept or KeptAreas()
    effects, exact = declared(scene, view), exact_areas(scene)
    seeds = [view_seed(seed, index)] + [view_seed(seed + 1, index + len(scene.views))] * sampled(scene)
    bins = BINS if edges else 1
    renders = [_render(scene, stage, view, effects, each, rays_per_m2, exact, bins, kept) for each in seeds]
    images = [render.forward() for render in renders]
    shifted = _shifted(renders[0]) if exact and edges else {}
    moves = _moves(scene, stage, view, effects, seeds[0], rays_per_m2) if edges else {}
    found: dict[str, Modelled] = {}
    for pol in view.images:
        planes = [image[pol].astype(float) for image in images]
        mean = np.mean(planes, axis=0)
        variance = np.zeros_like(mean) if len(planes) == 1 else ray_variance(*planes)
        covered = np.logical_and.reduce([render.covered(pol) for render in renders])
        slopes = np.zeros((2, *mean.shape)) if not edges else shifted[pol] if exact else _between_pixels(mean)
        if edges and scene.accuracy_m is not None:
            slopes = _over_far(slopes, mean, [scene.accuracy_m / step for step in scene.grid.spacing_m])
        moved = moves.get(pol, np.zeros((0, *mean.shape)))
        about = _surface_in_pixels(scene, renders[0], pol)
        found[pol] = Modelled(mean, slopes, moved, covered, variance, exact, *about)
    return found


def ray_variance(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Variance of the mean of two images by independent rays, any units squared, shape (rows, cols).

    Two values of a pixel may be alike by chance, and power may fall into a pixel or the next one by chance. So it is
    the mean over `ABOUT` x `ABOUT` pixels where this is more than the pixel's own: of variances or of relative ones,
    whichever is less. A bright corner says nothing of the ground beside it then, nor that of the corner.
    """
    own, power = (one - other) ** 2 / 4.0, ((one + other) / 2.0) ** 2
    relative = np.divide(own, power, out=np.zeros_like(own), where=power > 0.0)
    alike, share = (ndimage.uniform_filter(each, ABOUT, mode="nearest") for each in (own, relative))
    return np.asarray(np.maximum(own, np.minimum(alike, share * power)))


def known_by_rays(one: np.ndarray, other: np.ndarray, looks: float) -> np.ndarray:
    """Where one of two images by independent rays is known well beside speckle of so many looks, bool (rows, cols)."""
    return np.asarray(2.0 * ray_variance(one, other) * looks <= BY_RAYS * ((one + other) / 2.0) ** 2)


def _render(
    scene: Scene,
    stage: Stage,
    view: View,
    effects: list[DeclaredEffect],
    seed: int,
    rays_per_m2: float,
    exact: bool,
    bins: int,
    kept: KeptAreas,
) -> ViewRender:
    shape, polarizations = scene.grid.shape, tuple(view.images)
    if not exact:
        hits = trace_view(scene, stage, view, seed=seed, effects=effects, rays_per_m2=rays_per_m2)
        return ViewRender(stage, view, hits, shape, polarizations, effects)
    margin = sum(e.effect.margin_m(scene.grid, e.values) for e in effects)
    margin += max(scene.grid.spacing_m) if bins > 1 else 0.0
    fine = max([bins, *(e.effect.bins_per_pixel for e in effects)])
    hits = kept.hits(scene, stage, view, hit_grid(scene, fine, margin), seed, rays_per_m2)
    return ViewRender(stage, view, hits, shape, polarizations, effects)


def _shifted(render: ViewRender) -> dict[str, np.ndarray]:
    """Differences of images moved by one bin to either side, for a pixel of shift. The render ends as it was."""
    found: dict[str, list[np.ndarray]] = {}
    for step in (np.array([1.0, 0.0]) / BINS, np.array([0.0, 1.0]) / BINS):
        ahead, behind = render.moved(*step), render.moved(*-step)
        for pol in ahead:
            change = (ahead[pol].astype(float) - behind[pol]) * (BINS / 2.0)
            found.setdefault(pol, []).append(change)
    render.forward()
    return {pol: np.stack(both) for pol, both in found.items()}


def _over_far(slopes: np.ndarray, image: np.ndarray, sd_px: Sequence[float]) -> np.ndarray:
    """The slopes, or what a shift by 1, 2 or 3 standard deviations changes for a pixel of it, where that is more.

    An edge may be nearer than an accuracy of some pixels, and farther than the step that a slope is taken by.
    """
    found = slopes.copy()
    for axis, sd in enumerate(sd_px):
        for sds in range(1, int(SURE_SDS) + 1):
            for way in (sds * sd, -sds * sd):
                step = (way, 0.0) if axis == 0 else (0.0, way)
                change = (ndimage.shift(image, step, order=1, mode="nearest") - image) / way
                found[axis] = np.where(np.abs(change) > np.abs(found[axis]), change, found[axis])
    return found


def _between_pixels(image: np.ndarray) -> np.ndarray:
    """The larger of the differences to both neighbours along each axis: no less than what a shift changes."""
    found = []
    for axis in (0, 1):
        step = np.diff(image, axis=axis, prepend=0.0, append=0.0)
        behind, ahead = (-np.take(step, range(k, k + image.shape[axis]), axis=axis) for k in (0, 1))
        found.append(np.where(np.abs(behind) > np.abs(ahead), behind, ahead))
    return np.stack(found)


def _moves(
    scene: Scene, stage: Stage, view: View, effects: list[DeclaredEffect], seed: int, rays_per_m2: float
) -> dict[str, np.ndarray]:
    """`Modelled.moves` by polarization; empty where no object states an accuracy.

    All such objects are moved at once: each pixel is changed by those that are near it, or shade it.
    """
    if all(one.accuracy_m is None for one in scene.objects):
        return {}
    found: dict[str, list[np.ndarray]] = {}
    for axis in range(3):
        ends = []
        for way in (SURE_SDS, -SURE_SDS):
            moved = posed(scene, [_moved(one, axis, way) for one in scene.objects])
            there = Stage.of(moved, stage.target.device)
            render = _render(moved, there, view, effects, seed, rays_per_m2, exact_areas(scene), 1, KeptAreas())
            ends.append(render.forward())
        for pol in ends[0]:
            found.setdefault(pol, []).append((ends[0][pol].astype(float) - ends[1][pol]) / 2.0)
    return {pol: np.stack(planes) for pol, planes in found.items()}


def _moved(one: Object, axis: int, sds: float) -> Object:
    position = list(one.position_m)
    position[axis] += sds * (one.accuracy_m or 0.0)
    return one.model_copy(update={"position_m": tuple(position)})


def _surface_in_pixels(scene: Scene, render: ViewRender, polarization: str) -> tuple[np.ndarray, np.ndarray]:
    """Incidence angle [deg] and index of the strongest material of every pixel, weighted by modelled power."""
    hits, (rows, cols) = render.shaded, render.shape
    pixel = image_pixels(hits, render.shape)
    inside = pixel >= 0
    pixel = pixel[inside]
    power = (hits.weight.numpy().astype(float) * render.sigma[polarization].numpy())[inside]
    total = np.bincount(pixel, power, rows * cols)
    angle = np.rad2deg(np.arccos(np.minimum(hits.cos_incidence.numpy()[inside].astype(float), 1.0)))
    with np.errstate(invalid="ignore", divide="ignore"):
        incidence = np.bincount(pixel, power * angle, rows * cols) / total
    of_hit = scene.mesh.face_material[hits.face.numpy()[inside]]
    shares = np.stack(
        [np.bincount(pixel[of_hit == m], power[of_hit == m], rows * cols) for m in range(len(scene.mesh.materials))]
    )
    material = np.where(total > 0, shares.argmax(axis=0), -1)
    return incidence.reshape(rows, cols), material.reshape(rows, cols)
