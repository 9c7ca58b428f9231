"""Where objects stand, and how the radar looks at them: from metres away to the likeliest geometry, with intervals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import warp as wp

from warpsar.compare.observation import Observation
from warpsar.effects.registry import declared, effects_at_edges, response_of
from warpsar.errors import InputError
from warpsar.learning.device_values import DeviceValues
from warpsar.learning.geometry import Geometry, freed, still
from warpsar.learning.identify import Identified
from warpsar.learning.pose import Descended, PosedNumbers, PosedProblem, descend
from warpsar.learning.pose_pixels import PosePixels, compared
from warpsar.learning.prior import Known, Prior
from warpsar.learning.problem import FitProblem
from warpsar.learning.pull import Pull, pulls
from warpsar.learning.results import learned_scene
from warpsar.parameters.tree import object_values
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.simulation.exact_rays import ExactRays
from warpsar.surface.stage import Stage
from warpsar.surface.surface import Surface
from warpsar.world.objects.table import Learnable, Object
from warpsar.world.tables import Grid, View
from warpsar.world.tolerance import pinned

T = TypeVar("T", View, Grid)

SEARCH_BLUR_M = (3.0, 1.5, 0.75)  # full widths at half maximum: an object is found from as far away as it is blurred
SEARCH_STEPS, SEARCH_FLAT, SEARCH_FLAT_OF_EACH = 12, 1.0, 0.1
"""The search ends where a step promises less of the log-likelihood than 1, or than 0.1 for each number that moves."""
TRADES = 0.95  # correlation from which two numbers are said to trade
UNKNOWN_M = 1.0  # standard deviation at an object's edge from which a move is called unknown
SHARE = 0.2  # of a unit move, from which a number is part of it


@dataclass(frozen=True)
class FoundPoses:
    """Objects at their likeliest poses, views at their angles, and pixel spacings.

    `scene`: the scene with them, and with the surface and effects that were fitted along. `loss`: where the fit ended,
    with its priors. `size`: how many numbers of poses moved. `identified`: information on everything that was fitted,
    poses last [m at the objects' edges]. `words`: what cannot be told apart. `pulls`: every number of a pose or size
    that is known to a tolerance, before and after. `values`: the tables and terms that were fitted along.
    """

    scene: Scene
    loss: float
    size: int
    objects: dict[str, dict[str, Any]]
    numbers: dict[str, dict[str, Any]]
    identified: Identified
    words: list[str]
    values: DeviceValues
    without: Callable[[], float] = field(repr=False)
    """Fits surface and effects with nothing moved; returns that fit's loss."""
    pulls: list[Pull] = field(default_factory=list)

    @cached_property
    def gain(self) -> float:
        """What the poses add to the log-likelihood over all usable pixels above a common floor (`pose_pixels`), where
        surface and effects are at their best with and without them. It is a fit of its own when first asked for."""
        return self.without() - self.loss


@dataclass(frozen=True)
class PoseSearch:
    """What blurred images say of a geometry: where the fit of sharp images begins. `gain`: what has been gained of the
    log-likelihood of the least blurred ones, by which searches are compared; 0 where there was none. `pixels` and
    `gains` as `lit_pixels` has them, the others as `find_poses`; `known`: where the search ended, by label."""

    scene: Scene
    device: wp.Device
    pixels: Mapping[str, list[Observation]]
    gains: Mapping[tuple[str, str], float]
    loss: str
    held: bool
    standing: Collection[str]
    gain: float
    known: Mapping[str, float]
    values: DeviceValues
    smooth: bool = False

    def finish(self) -> FoundPoses:
        """The likeliest geometry of the sharp images, from where the search ended."""
        problem, end = self.descended(0.0)
        of_x, x, identified = problem.of_numbers(end.x)
        found = _scene_at(problem, end.x, self.scene)
        tolerated = set(problem.geometry.labels) - {problem.labels[k] for k in problem.stood}
        return FoundPoses(
            found,
            end.loss,
            problem.count - len(problem.stood),
            summary(of_x, x, identified),
            numbers(of_x, x, identified),
            identified,
            [*problem.geometry.held, *_words(of_x, identified)],
            self._values_at(problem, end.x),
            self.loss_without,
            [pull for pull in pulls(of_x, x, identified) if pull.label in tolerated],
        )

    def shaded(self) -> PoseSearch:
        """The search with surfaces and effects at their best where nothing moves. Where all bodies are known to be
        near, steps that move them need not bring them to their brightness first."""
        if self.held or not lacks_fields(self.scene):
            return self
        alone = replace(self, scene=still(self.scene), standing=())
        both = compared(alone.scene, alone.pixels, 0.0, alone.gains)
        problem = alone._problem(both, 0.0)
        there = descend(problem, problem.start_from(self.known), flat=search_flat(problem), near=True)
        return replace(self, known=dict(zip(problem.labels, there.x.tolist(), strict=True)))

    def approached(self) -> tuple[Scene, DeviceValues]:
        """The scene near its likeliest geometry, as close as a search comes, and the tables and terms there: for what
        is looked for in the images before they are fitted to the end."""
        problem = self._problem(compared(self.scene, self.pixels, 0.0, self.gains), 0.0)
        there = descend(problem, problem.start_from(self.known), flat=search_flat(problem), near=True)
        return _scene_at(problem, there.x, self.scene), self._values_at(problem, there.x)

    def _values_at(self, problem: PosedProblem, x: np.ndarray) -> DeviceValues:
        """The tables and terms at an x of the problem."""
        inner, rest = problem.split(x)
        return replace(self.values, start=rest[inner.of_values])

    def descended(self, blur_m: float) -> tuple[PosedProblem, Descended]:
        """The problem of images blurred by `blur_m`, and where it ends from what is known.

        Blurred images hold the point spread that a scene declares, so it is no part of their x.
        """
        both = compared(self.scene, self.pixels, blur_m, self.gains)
        problem = self._problem(both, blur_m)
        start = problem.start_from(self.known)
        if not blur_m:
            return problem, descend(problem, start)
        return problem, descend(problem, start, most=SEARCH_STEPS, flat=search_flat(problem), near=True)

    def _problem(self, both: PosePixels, blur_m: float) -> PosedProblem:
        return PosedProblem(
            both.scene,
            self.device,
            both.observations,
            loss=self.loss,
            held=self.held,
            level=both.level,
            standing=self.standing,
            forward=blur_m > 0.0,
            smooth=self.smooth,
            values=self.values,
        )

    def loss_without(self) -> float:
        """The loss where nothing of the geometry moves."""
        _, end = replace(self, scene=still(self.scene), known={}, standing=()).descended(0.0)
        return end.loss


def search_flat(problem: PosedProblem) -> float:
    """The promised gain in log-likelihood at which a search ends."""
    return max(SEARCH_FLAT, SEARCH_FLAT_OF_EACH * problem.x0.size)


def lacks_fields(scene: Scene) -> bool:
    """Whether each surface parameter that is learned is one number."""
    return all(block.layout == "uniform" for block in Surface.of(scene).blocks if block.learn)


def find_poses(
    scene: Scene,
    device: wp.Device,
    *,
    views: Sequence[str] | None = None,
    observations: Mapping[str, list[Observation]] | None = None,
    loss: str = "gamma",
    search: bool = True,
    held: bool = False,
    standing: Collection[str] = (),
    smooth: bool = False,
    values: DeviceValues | None = None,
) -> FoundPoses:
    """Fit what `learn` of the scene's objects, views and image frees, with surface and effects unless they are `held`.

    `views`: names of the views to use; by default those with role train. `observations`, by view name: frozen pixels
    that other models are compared on; by default those that the scene as given lights. `search`: begin with blurred
    images, which find an object from 3 m, 20 degrees and 20 % away, unless all is known to be near (`known_near`).
    `standing`: labels of objects whose foot stays at its height, where their own is learned. `smooth`: fields move
    along, as in `PosedProblem`. `values`: tables and learned terms to fit along. Raises InputError where nothing of the
    geometry is to be learned, and for views without images.
    """
    approaching = search_poses(
        scene,
        device,
        views=views,
        observations=observations,
        loss=loss,
        blurs_m=None if search else (),
        held=held,
        standing=standing,
        smooth=smooth,
        values=values,
    )
    return approaching.finish()


def search_poses(
    scene: Scene,
    device: wp.Device,
    *,
    views: Sequence[str] | None = None,
    observations: Mapping[str, list[Observation]] | None = None,
    loss: str = "gamma",
    blurs_m: Sequence[float] | None = SEARCH_BLUR_M,
    held: bool = False,
    standing: Collection[str] = (),
    smooth: bool = False,
    values: DeviceValues | None = None,
) -> PoseSearch:
    """What `find_poses` begins with, and goes on from (`PoseSearch.finish`): a search on images blurred by `blurs_m`
    [m], one after the other. None: by `SEARCH_BLUR_M`, or by nothing where all is known to be near."""
    if next(freed(scene), None) is None and not effects_at_edges(scene.effects):
        raise InputError(
            f"{scene.name}: found no object, view, [radar] or [image] with `learn`, and no effect that edges tell; at "
            f"least one must be there"
        )
    near = blurs_m is None and known_near(scene)
    if blurs_m is None:
        blurs_m = () if near else SEARCH_BLUR_M
    pixels, gains = lit_pixels(scene, device, loss, views, observations)
    found = PoseSearch(scene, device, pixels, gains, loss, held, standing, 0.0, {}, values or DeviceValues(), smooth)
    for blur_m in blurs_m:
        blurred, there = found.descended(blur_m)
        gain = blurred.value(blurred.x0) - there.loss if blur_m == blurs_m[-1] else 0.0
        found = replace(found, gain=gain, known=dict(zip(blurred.labels, there.x.tolist(), strict=True)))
    return found.shaded() if near else found


def known_near(scene: Scene) -> bool:
    """Whether all that is to be found is known so well that a sharp image finds it: by twice its standard deviation it
    moves outlines by no more than a point of the image is wide on the ground. Otherwise blurred images must come first.
    """
    geometry = Geometry(scene)
    most = min((_point_m(scene, view) for view in scene.views if view.role == "train"), default=0.0)
    for c, (about, sd) in zip(geometry.coordinates, geometry.known, strict=True):
        shared = geometry.shared(c)
        both = math.hypot(sd, shared[1] if shared is not None else 0.0)
        if (abs(c.start - about) + 2.0 * both) / abs(c.per_metre(0.0)) > most:
            return False
    return True


def _point_m(scene: Scene, view: View) -> float:
    """How wide a point is in a view, on level ground, as the side of a square [m]: its response, and a pixel."""
    asked = response_of(declared(scene, view)).width_m
    along, across = (math.hypot(wide or 0.0, step) for wide, step in zip(asked, scene.grid.spacing_m, strict=True))
    return math.sqrt(along * across / math.sin(math.radians(view.incidence_deg)))


def lit_pixels(
    scene: Scene,
    device: wp.Device,
    loss: str,
    views: Sequence[str] | None = None,
    observations: Mapping[str, list[Observation]] | None = None,
) -> tuple[dict[str, list[Observation]], dict[tuple[str, str], float]]:
    """What the declared model sees of every image, by view name, and the images' gains, by view name and polarization.

    `views` and `observations` as in `find_poses`.
    """
    rays = ExactRays(Stage.of(scene, device), seed=scene.sampling.seed)
    given = FitProblem(scene, device, loss=loss, views=views, rays=rays, observations=observations)
    pixels: dict[str, list[Observation]] = {}
    for seen in given.observations:
        pixels.setdefault(seen.view.name, []).append(seen)
    gains = given.gains(given.modelled(given.x0))
    return pixels, {(s.view.name, s.polarization): float(g) for s, g in zip(given.observations, gains, strict=True)}


def group_pose(
    scene: Scene,
    device: wp.Device,
    group: str,
    *,
    learn: tuple[Learnable, ...] = ("position", "heading"),
    views: Sequence[str] | None = None,
    observations: Mapping[str, list[Observation]] | None = None,
    loss: str = "gamma",
) -> FoundPoses:
    """The likeliest pose of a part of the scene's own mesh that no `[[objects]]` table declares; as `find_poses`.

    Raises InputError for a name that is no group of the mesh, or one that an object moves already.
    """
    return find_poses(with_group(scene, group, learn), device, views=views, observations=observations, loss=loss)


def with_group(scene: Scene, group: str, learn: tuple[Learnable, ...]) -> Scene:
    """The scene with one of its groups as an object of its own, where it stands. Nothing else is learned of objects."""
    others = [one.model_copy(update={"learn": ()}) for one in scene.objects]
    return with_objects(scene, [*others, Object(group=group, learn=learn)])


def _scene_at(problem: PosedProblem, x: np.ndarray, scene: Scene) -> Scene:
    """`scene` with everything that x says; without the floor that only the comparison has.

    Tolerances stay about the values that were known.
    """
    inner, rest = problem.split(x)
    fitted = learned_scene(inner, rest)
    effects = {name: table for name, table in fitted.effects.items() if name in scene.effects}
    objects = tuple(
        one.model_copy(update={"tolerance": known.pinned().tolerance} if known.tolerance else {})
        for one, known in zip(fitted.objects, scene.objects, strict=True)
    )
    views = [_pinned(one, known) for one, known in zip(fitted.views, scene.views, strict=True)]
    turned = {key: getattr(scene.views[0], key) - getattr(views[0], key) for key in scene.radar.tolerance}
    common = {key: pinned(one, turned[key]) for key, one in scene.radar.tolerance.items()}
    return replace(
        fitted,
        effects=effects,
        objects=objects,
        views=views,
        grid=_pinned(fitted.grid, scene.grid),
        radar=fitted.radar.model_copy(update={"tolerance": common}),
    )


def _pinned(table: T, declared: T) -> T:
    """A view or [image] with its tolerances about the values that were `declared`."""
    if not declared.tolerance:
        return table
    known = {key: pinned(one, getattr(declared, key)) for key, one in declared.tolerance.items()}
    return table.model_copy(update={"tolerance": known})


def summary(problem: PosedNumbers | PosedProblem, x: np.ndarray, identified: Identified) -> dict[str, dict[str, Any]]:
    """What JSON files say of every object: its values, and a standard deviation beside each that was learned."""
    found: dict[str, dict[str, Any]] = {}
    for one in problem.geometry.at(x[problem.size :]).objects:
        entry: dict[str, Any] = {"position_m": list(one.position_m), "heading_deg": one.heading_deg}
        entry |= {"pitch_deg": one.pitch_deg, "roll_deg": one.roll_deg, "scale": list(one.scales)}
        if one.size_m is not None:
            entry["size_m"] = list(one.size_m)
        for word in ("cabin", "side_curvature"):
            if word in one.learn:
                entry[word] = object_values(one, word)[0]
        found[one.label] = entry
    sds = identified.sd[problem.size :]
    for c, coordinate, sd in zip(problem.geometry.coordinates, x[problem.size :], sds, strict=True):
        if c.body is None:
            continue
        entry = found[c.body]
        value_sd = float(sd * abs(c.per_metre(float(coordinate))))
        key = sd_key(c.parameter.key)
        if c.index is None:
            entry[key] = value_sd
        else:
            entry.setdefault(key, [0.0, 0.0, 0.0])[c.index] = value_sd
    return found


def numbers(problem: PosedNumbers, x: np.ndarray, identified: Identified) -> dict[str, dict[str, Any]]:
    """What JSON files say of the views' angles and pixel spacings that were learned, and of errors that the bodies of a
    survey have in common, by dotted name."""
    sds = identified.sd[problem.size :]
    found = {
        c.label: {
            "value": c.value(float(coordinate)),
            "sd": float(sd * abs(c.per_metre(float(coordinate)))),
            "unit": c.parameter.unit,
        }
        for c, coordinate, sd in zip(problem.geometry.coordinates, x[problem.size :], sds, strict=True)
        if c.body is None
    }
    return found | survey_errors(problem.prior, x, identified.covariance)


def survey_errors(prior: Prior, x: np.ndarray, covariance: np.ndarray) -> dict[str, dict[str, Any]]:
    """The error that the bodies of a survey have in common, by "survey.heading_deg": `value` and `sd`, in its `unit`.

    With r the values less what is known, C = own^2 + s^2 11' their prior covariance, and a = s^2 C^-1 1: the error is
    a'r on average, of variance s^2 - s^2 a'1 about it; r's own uncertainty a' cov(r) a comes on top.
    """
    groups: dict[str, list[Known]] = {}
    for one in prior.known:
        if one.shared is not None:
            groups.setdefault(one.shared[0], []).append(one)
    found = {}
    for name, members in groups.items():
        shares = np.array([one.shared[1] for one in members if one.shared is not None])
        variance = np.diag([one.sd**2 for one in members]) + np.outer(shares, shares) * (1.0 - np.eye(len(members)))
        weights = np.linalg.solve(variance, shares * shares[0])
        apart = np.array([float(one.value(float(x[one.at]))) - one.about for one in members])
        slopes = np.array([float(one.slope(float(x[one.at]))) for one in members])
        at = [one.at for one in members]
        of_values = covariance[np.ix_(at, at)] * np.outer(slopes, slopes)
        own = float(shares[0] ** 2 - weights @ shares * shares[0])
        sd = float(np.sqrt(max(own, 0.0) + weights @ of_values @ weights))
        found[name] = {"value": float(weights @ apart), "sd": sd, "unit": members[0].unit}
    return found


def sd_key(key: str) -> str:
    """Where JSON files have the standard deviation of what an object's table has at `key`."""
    stem, _, unit = key.partition("_")
    if key == "side_curvature":
        return "side_curvature_sd"
    return f"{stem}_sd_{unit}" if unit else f"{stem}_sd"


def _words(problem: PosedNumbers, identified: Identified) -> list[str]:
    """Sentences about what the images do not tell of poses, alone or from one another."""
    size, labels = problem.size, identified.labels[problem.size :]
    information = identified.information
    own, mixed = information[:size, :size], information[:size, size:]
    # what is left of the poses' information when surfaces and effects are unknown
    left = information[size:, size:] - mixed.T @ np.linalg.pinv(own, rcond=1e-9, hermitian=True) @ mixed
    values, vectors = np.linalg.eigh(left)
    sentences, mentioned = [], np.zeros(len(labels), bool)
    for value, direction in zip(values, vectors.T, strict=True):
        if value * UNKNOWN_M**2 >= 1.0:
            continue
        parts = [k for k in np.argsort(-np.abs(direction)) if abs(direction[k]) > SHARE]
        mentioned[parts] = True
        if len(parts) == 1:
            sentences.append(f"{labels[parts[0]]}: not identifiable")
        else:
            moves = ", ".join(f"{labels[k]} {direction[k]:+.2f} m" for k in parts)
            sentences.append(
                f"{labels[parts[0]]}: not told apart from the others of this move, which no image shows: {moves}"
            )
    sds = identified.sd[size:]
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = identified.covariance[size:, size:] / np.outer(sds, sds)
    for k, j in itertools.combinations(range(len(labels)), 2):
        if abs(correlation[j, k]) > TRADES and not (mentioned[j] and mentioned[k]):
            sentences.append(
                f"{labels[k]} and {labels[j]}: hardly told apart (correlation {correlation[j, k]:+.3f}); views from "
                f"other sides would part them"
            )
    return sentences
