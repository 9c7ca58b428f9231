"""Surface parameters, effects, tables, learned terms and geometry together: images, derivatives, and a descent.

A derivative to a pose needs two renders of each view, and nothing of what a fit records beside them. So only the hits
are traced anew, and only where a body can change the image. The power before the image stage is enough: a body changes
it near by alone, whatever sidelobes a point has.

Fields move along where they are asked to be `smooth`. Their columns are sparse, and those of all else, poses included,
stand beside them in one normal matrix (`sparse_quadratic.py`).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import warp as wp
from scipy.sparse import csr_array, hstack

from warpsar.compare.observation import Observation
from warpsar.effects.base.effect import DeclaredEffect
from warpsar.effects.registry import declared, get
from warpsar.learning.device_values import DeviceValues
from warpsar.learning.field_levels import FieldLevels
from warpsar.learning.geometry import Geometry
from warpsar.learning.identify import Identified, of_information, score_products
from warpsar.learning.pose_sharing import Box, boxes, columns_of, faces_about, meetings, shared
from warpsar.learning.prior import Known, Prior
from warpsar.learning.problem import FitProblem
from warpsar.learning.roughness import FieldPrior, Roughness
from warpsar.learning.sparse_quadratic import (
    FAINT,
    SparseQuadratic,
    SparseStep,
    curvature,
    node_numbers,
    solved,
    whole_jacobian,
)
from warpsar.learning.view import FitView
from warpsar.render.render import ViewRender
from warpsar.render.tangents import through_image
from warpsar.runtime import threads
from warpsar.runtime.deadline import check
from warpsar.runtime.matmul import gram_by_tiles, transposed_times
from warpsar.scene.scene import Scene
from warpsar.simulation.exact_rays import ExactRays
from warpsar.simulation.rays import effects_grid
from warpsar.speckle.likelihood import Curvature, residual_sd
from warpsar.speckle.residual import residual_autocovariance
from warpsar.surface.stage import Stage
from warpsar.trace.target import Target

POSE_STEP_M = 2e-3  # of a difference: its error is under 1e-3 of a derivative (docs/learn-method.md)
LIT = 0.1  # share of a pixel that is no floor, from which its residual tells of speckle
KEPT = 3  # poses whose hits are kept
# How far a descent goes on with the changes of an image by its poses: of a pixel, and of a log coordinate. They hardly
# change within; where a descent seems to have arrived, they are made anew.
KEPT_WITHIN_PX, KEPT_WITHIN = 0.1, 0.2
BESIDE = 5.0  # times as far, for what belongs to another body near by: of its changes only a shadow or a blur is shared
MOST_STEPS = 40
LARGEST_MOVE_M, LARGEST_STEP = 1.0, 1.0  # in one step: of a pose, and of a log coordinate
STANDS_M = 1e-2  # standard deviation of a foot's height about the ground that it stands on
DAMPED = 1e-3  # damping of a first step, and least one after a step that gained nothing
FEW_RAYS = 0.125  # of the scene's: for paths over several surfaces where images are only screened
# Gain in log-likelihood that counts as none, and the same for each number that moves: by 5e-4 for each, a number is on
# average within 3 % of its standard deviation of its best.
FLAT, FLAT_OF_EACH = 2e-3, 5e-4
# The same where rays follow paths over several surfaces: as bodies move, their noise makes steps of some tenths of it.
FLAT_BY_RAYS = 0.5
SMOOTH_SD = 0.3  # of the difference of a smooth field's neighbours, in log coordinates, before any image
ACCURATE = 1e-6  # of a right side, that conjugate gradients leave where intervals come from it


def without_paths(scene: Scene) -> Scene:
    """The scene with single bounces alone."""
    if all(get(name).stage != "path" for name in scene.effects):
        return scene
    return replace(scene, effects={name: t for name, t in scene.effects.items() if get(name).stage != "path"})


def render_elsewhere(
    problem: FitProblem,
    view: FitView,
    x: np.ndarray,
    scene: Scene,
    columns: tuple[int, int] | None = None,
    faces: np.ndarray | None = None,
    *,
    paths: bool = True,
    coarse: bool = False,
) -> ViewRender:
    """The view with its geometry as `scene` has it; surface and effects as x of `problem` says. It has run.

    `columns`: from the first to before the last column of the image that is made; the others stay without hits.
    `faces`: those that are there, shape (faces,), as `exact_hits` has them; by default all.
    `paths`: whether light that went over several surfaces is in them; `coarse`: with few rays. The scene has the faces
    of the problem's own, in the same order. Raises TimeUp where the time of the run is over.
    """
    check()
    there = next(one for one in scene.views if one.name == view.view.name)
    placed = replace(scene, effects=problem.effect_tables(x))
    placed = placed if paths else without_paths(placed)
    effects = declared(placed, there, neutral=True)
    stage = replace(problem.stage, target=Target.upload(scene.mesh, scene.reference_point_m, problem.device))
    rays = exact_rays(scene, stage, coarse=coarse)
    hits = rays.trace(placed, there, effects, _of_the_grid(placed, effects, columns), only_faces=faces)
    render = ViewRender(stage, there, hits, scene.grid.shape, tuple(there.images), effects)
    render.set_parameters(problem.float_nodes(x))
    render.forward()
    return render


def exact_rays(scene: Scene, stage: Stage, *, coarse: bool, all_rays: bool = False) -> ExactRays:
    """Images of exact areas. Paths over several surfaces have the scene's rays; for `coarse` images `FEW_RAYS` of them,
    unless `all_rays` are asked for, and no finer ones at the borders of corners: blurred images average over many
    pixels."""
    density = scene.sampling.density_per_m2(scene.grid) * (FEW_RAYS if coarse and not all_rays else 1.0)
    return ExactRays(stage, density, scene.sampling.seed, coarse=coarse)


def _of_the_grid(
    scene: Scene, effects: list[DeclaredEffect], columns: tuple[int, int] | None
) -> tuple[int, int] | None:
    """The columns of the hits' grid that columns of the image are, one at least."""
    if columns is None:
        return None
    grid, wide = effects_grid(scene, effects), scene.grid.shape[1]
    fine = grid.bins_per_pixel
    margin = (grid.shape[1] // fine - wide) // 2
    first, last = (min(max(column + margin, 0) * fine, grid.shape[1]) for column in columns)
    first = min(first, grid.shape[1] - 1)  # one column at least: a body may lie beside a view's image
    return first, max(last, first + 1)


@dataclass(frozen=True)
class _Changes:
    """`found`: d(mu) / dp of each observation, shape (pixels, len(p)). `made`, (len(p),): at which of the `places` each
    column was made, x each; -1 where none was. `central`, (len(p),): whether that was by the differences that are asked
    for at an end."""

    places: list[np.ndarray]
    made: np.ndarray
    central: np.ndarray
    found: list[np.ndarray]

    def renewed(self, x: np.ndarray, stale: np.ndarray, central: bool, found: list[np.ndarray]) -> _Changes:
        """With the `stale` columns as made at x."""
        made = np.where(stale, len(self.places), self.made)
        used, made = np.unique(made, return_inverse=True)
        places = [[*self.places, x.copy()][k] for k in used]
        return _Changes(places, made, np.where(stale, central, self.central), found)


class PosedProblem:
    """A fit problem whose geometry moves. x holds that of `FitProblem`, and then the geometry's coordinates [m].

    `observations`, by view name, are the same for every pose. Images have exact areas, without rays, so that
    differences of them are their derivatives, silhouettes and shadows included. `prior` is what the scene knows of
    everything in x to a tolerance.
    """

    def __init__(
        self,
        scene: Scene,
        device: wp.Device,
        observations: Mapping[str, list[Observation]],
        *,
        loss: str = "gamma",
        held: bool = False,
        level: float = 0.0,
        standing: Collection[str] = (),
        bound: float = 0.0,
        forward: bool = False,
        rough: bool = False,
        smooth: bool = False,
        values: DeviceValues | None = None,
    ) -> None:
        """`held`: nothing moves but the poses. `smooth`: neighbouring nodes of fields are expected to differ by
        `SMOOTH_SD`, and sparse columns take fields of any size. Where differences are forward ones, or hits are not at
        hand, each field moves as a whole (`FieldLevels`). `level` [beta0]: how much of the floor was added to the
        measurement. `bound` is that of the loss, as in `FitProblem`. `forward`: changes by poses are forward
        differences, of half as many images, and paths over several surfaces have few rays (`exact_rays`), for a search
        on blurred images that something finer follows. `rough`: so, but the image itself has all its rays, and
        the changes are of single bounces alone, which is enough to tell which pose is worth a fit. Few rays leave paths
        that are off everywhere alike, and a body seems to move; and paths would be traced for each change.

        `standing`: labels of objects whose foot stays at its height, known to `STANDS_M`. Their height and that of the
        foot would trade otherwise: a body sunk into the ground looks like a lower one.
        """
        self.scene, self.device, self.loss, self._seen = scene, device, loss, observations
        self.geometry, self.level, self.bound, self.values = Geometry(scene), level, bound, values
        self.forward, self.rough = forward or rough, rough
        self._kept: OrderedDict[bytes, FitProblem] = OrderedDict()
        self._changes: _Changes | None = None
        self.count = len(self.geometry.coordinates)
        start = self.standing(np.zeros(self.count))
        fields = smooth and not held and not start.uniform
        self.levels = FieldLevels.of(start) if fields else None
        by_level = fields and (self.forward or not start.keeps_hits)
        own, ends, labels = start.x0, start.bounds, start.labels
        if self.levels is not None and by_level:
            own, ends, labels = self.levels.start, self.levels.ends, self.levels.labels
        self.size = 0 if held else own.size
        self._own = start.x0.copy()
        self.x0 = np.concatenate([own[: self.size], np.zeros(self.count)])
        low, high = (np.concatenate([a[: self.size], b]) for a, b in zip(ends, self.geometry.bounds, strict=True))
        self.bounds = low, high
        self.labels = [*labels[: self.size], *self.geometry.labels]
        self.prior = Prior.of(None if held else start, self.geometry)
        if self.levels is not None and by_level:
            self.prior = self.levels.prior(self.prior, self.count)
        self.stood = [
            k
            for k, c in enumerate(self.geometry.coordinates, start=self.size)
            if (c.parameter.key, c.index) == ("position_m", 2) and c.body in standing
        ]
        self._hold_the_stood()
        self.nodes: np.ndarray | None = None
        """Of each element of x the number of its node, 0 where it has none; None without smooth fields that move."""
        if fields and not by_level:
            self.nodes = np.concatenate([node_numbers(start), np.zeros(self.count, int)])
            roughness = Roughness.of(start, 1.0 / SMOOTH_SD**2)
            self.prior = FieldPrior(self.prior.known, self.x0.size, roughness, self.prior.standard)
        self.zero_sum_means = np.zeros((0, self.x0.size))

    def _hold_the_stood(self) -> None:
        low, high = self.bounds
        low[self.stood] = high[self.stood] = 0.0
        known = list(self.prior.known)
        for k in self.stood:
            c = self.geometry.coordinates[k - self.size]
            known.append(Known(c.label, k, c.value(0.0), STANDS_M, "m", c.value, c.per_metre))
        self.prior = Prior(known, self.prior.size, self.prior.standard)

    @property
    def by_rays(self) -> bool:
        """Whether rays follow paths over several surfaces as bodies move. Their changes take long, and have the noise
        of rays, so those of a pose close by will do."""
        return self.count > 0 and any(get(name).stage == "path" for name in self.scene.effects)

    def standing(self, p: np.ndarray) -> FitProblem:
        """The plain fit problem with the objects at p."""
        key = np.asarray(p, float).tobytes()
        if key not in self._kept:
            self._kept[key] = self._made(p)
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]

    def _made(self, p: np.ndarray) -> FitProblem:
        scene = self.geometry.at(p)
        rays = exact_rays(scene, Stage.of(scene, self.device), coarse=self.forward, all_rays=self.rough)
        roles = ("train", "test")
        return FitProblem(
            scene,
            self.device,
            loss=self.loss,
            roles=roles,
            views=list(self._seen),
            rays=rays,
            observations=self._seen,
            bound=self.bound,
            values=self.values,
        )

    def split(self, x: np.ndarray) -> tuple[FitProblem, np.ndarray]:
        """The problem at x's poses, and the rest of x as that problem has it."""
        rest = self._own if self.size == 0 else x[: self.size]
        if self.levels is not None and self.nodes is None:
            rest = self.levels.x(rest)
        return self.standing(x[self.size :]), rest

    def start_from(self, known: Mapping[str, float]) -> np.ndarray:
        """The start, with what is known of it by label."""
        x = np.array([known.get(label, value) for label, value in zip(self.labels, self.x0, strict=True)])
        if self.levels is not None and self.nodes is not None:
            x[: self.size] = self.levels.risen(known)
        return x

    def modelled(self, x: np.ndarray) -> list[np.ndarray]:
        """As `FitProblem.modelled`."""
        problem, rest = self.split(x)
        return problem.modelled(rest)

    def value(self, x: np.ndarray) -> float:
        """The loss at x with its priors."""
        problem, rest = self.split(x)
        return problem.value(problem.modelled(rest)) + self.prior.value(x)

    def jacobian(self, x: np.ndarray, *, near: bool = False) -> list[np.ndarray]:
        """d ln(mu) / dx of every observation, shape (pixels, len(x)), as `FitProblem.jacobian`.

        Those to poses are differences of exact images, `POSE_STEP_M` to either side. `near`: for a step on the way,
        those of an x close by will do, if there are any, and otherwise differences to one side.
        """
        found = self.slopes(x, near=near)
        if not self.scene.grid.calibrated:
            problem, rest = self.split(x)
            weights = [c.weight for c in problem.curvatures(problem.modelled(rest))]
            found = [j - np.average(j, axis=0, weights=w) for j, w in zip(found, weights, strict=True)]
        return found

    def slopes(self, x: np.ndarray, *, near: bool = False) -> list[np.ndarray]:
        """As `jacobian`, but the tangent of an unknown gain stays in the columns of poses: they are 0 where a body
        changes nothing."""
        problem, rest = self.split(x)
        if self.levels is not None:
            own: list[np.ndarray] | None = self.levels.jacobian(problem, x[: self.size])
        else:
            own = problem.jacobian(rest) if self.size else None
        modelled = problem.modelled(rest)
        changes = self._changes_at(problem, rest, x, near=near)
        found = []
        for k, (change, seen, mu) in enumerate(zip(changes, problem.observations, modelled, strict=True)):
            one = np.empty((mu.size, x.size))
            if own is not None:
                one[:, : self.size] = own[k]
            np.multiply(np.where(mu > seen.darkest, 1.0 / mu, 0.0)[:, None], change, out=one[:, self.size :])
            found.append(one)
        return found

    def _changes_at(
        self, problem: FitProblem, rest: np.ndarray, x: np.ndarray, *, near: bool = False
    ) -> list[np.ndarray]:
        """d(mu) / dp of every observation, shape (pixels, len(p)); `near` as in `jacobian`."""
        if self._changes is None:
            into = [np.zeros((seen.values.size, self.count), np.float32) for seen in problem.observations]
            self._changes = _Changes([], np.full(self.count, -1), np.zeros(self.count, bool), into)
        stale = self._stale(problem, rest, x, near=near)
        if stale.any():
            # what a step on the way needs may be less exact than what an interval is made from
            forward = self.forward or (near and not self.by_rays)
            found = [one.copy() for one in self._changes.found]  # another problem may have these, too
            self._change(problem, rest, x[self.size :], np.flatnonzero(stale), found, forward=forward)
            self._changes = self._changes.renewed(x, stale, self.forward or not forward, found)
        return self._changes.found

    def _stale(self, problem: FitProblem, rest: np.ndarray, x: np.ndarray, *, near: bool) -> np.ndarray:
        """Which columns must be made anew at x, shape (len(p),). Where those of an x close by will do, that is asked of
        what can change the column alone: of bodies whose pixels meet, and of what belongs to no body."""
        last = self._changes
        assert last is not None
        stale = (last.made < 0) | (False if near else ~last.central)
        within = np.full(x.size, KEPT_WITHIN_PX * min(self.scene.grid.spacing_m))
        within[: self.size] = KEPT_WITHIN
        matters = None
        for k, place in enumerate(last.places):
            rows, away = np.flatnonzero(last.made == k), np.abs(place - x) / within
            if not near:
                stale[rows] |= bool(away.any())
            elif (away > 1.0).any():
                matters = matters or self._matters(problem, rest)
                own, beside = (one[rows] for one in matters)
                stale[rows] = ((away > 1.0) & own).any(axis=1) | ((away > BESIDE) & beside).any(axis=1)
        return stale

    def _matters(self, problem: FitProblem, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which elements of x can change each column of d(mu) / dp, shape (len(p), len(x)): those of its own body and
        those of none, and those of other bodies."""
        scene, coordinates = replace(problem.scene, effects=problem.effect_tables(rest)), self.geometry.coordinates
        everything = np.ones((self.count, self.x0.size), bool)
        met = meetings(without_paths(scene) if self.rough else scene, [view.view for view in problem.views])
        if met is None:
            return everything, everything
        labels = [one.label for one in scene.objects]
        belongs = [self.owners, *(np.array([one == c.body for one in labels], bool) for c in coordinates)]
        of_bodies = np.column_stack(belongs)
        own = of_bodies | ~of_bodies.any(axis=0)
        beside = met.astype(int) @ of_bodies.astype(int) > 0
        bodies = [None if c.body is None else labels.index(c.body) for c in coordinates]
        rows = [(everything[0], everything[0]) if k is None else (own[k], beside[k]) for k in bodies]
        return np.array([one for one, _ in rows]), np.array([other for _, other in rows])

    @cached_property
    def owners(self) -> np.ndarray:
        """Which bodies each element of x before the geometry belongs to, shape (bodies, size): those of its material,
        where nothing else is made of it; none for what all have in common."""
        problem = self.standing(np.zeros(self.count))
        scene, found = problem.scene, np.zeros((len(problem.scene.objects), self.size), bool)
        if self.levels is not None or not self.size or scene.assembly is None:
            return found
        faces = scene.assembly.faces_of(scene.objects)
        of_bodies = np.zeros(len(scene.mesh.faces), bool)
        of_bodies[np.concatenate([*faces.values(), np.zeros(0, int)]).astype(int)] = True
        common = set(scene.mesh.face_material[~of_bodies].tolist())
        users: dict[str, list[int]] = {}
        for number, one in enumerate(scene.objects):
            for material in set(scene.mesh.face_material[faces[one.label]].tolist()) - common:
                users.setdefault(scene.mesh.materials[material], []).append(number)
        for at, parameter in problem.numbers():
            name = parameter.owner if parameter.root == "materials" else parameter.entry
            if at < self.size and name in users:
                found[users[name], at] = True
        return found

    def tangent(self, x: np.ndarray, *, near: bool = False) -> csr_array:
        """`jacobian` of all observations' pixels, one after the other, beside smooth fields, shape (n, len(x)). Gains
        are projected out of all but the fields' columns (`whole_jacobian`)."""
        problem, rest = self.split(x)
        surface = whole_jacobian(problem, rest)
        modelled = problem.modelled(rest)
        weights = [c.weight for c in problem.curvatures(modelled)]
        columns = []
        for change, seen, mu, w in zip(
            self._changes_at(problem, rest, x, near=near), problem.observations, modelled, weights, strict=True
        ):
            one = np.where(mu > seen.darkest, 1.0 / mu, 0.0)[:, None] * change
            columns.append(one if self.scene.grid.calibrated else one - np.average(one, axis=0, weights=w))
        return csr_array(hstack([surface, csr_array(np.concatenate(columns))]))

    def begin_with(self, other: PosedProblem) -> None:
        """Take the changes by poses at the start from a problem of the same scene that has these views and others."""
        if not other.is_made_at(other.x0):
            other.jacobian(other.x0)
        changed = other._changes
        assert changed is not None
        known, mine = (one.standing(np.zeros(one.count)).observations for one in (other, self))
        changes = {(s.view.name, s.polarization): each for s, each in zip(known, changed.found, strict=True)}
        found = [changes[s.view.name, s.polarization] for s in mine]
        self._changes = _Changes([self.x0.copy()], np.zeros(self.count, int), np.ones(self.count, bool), found)

    def is_made_at(self, x: np.ndarray) -> bool:
        """Whether all changes by poses were made at this x, and as exactly as they are asked for at an end."""
        last = self._changes
        if last is None or not last.central.all() or (last.made < 0).any():
            return False
        return all(np.array_equal(place, x) for place in last.places)

    def _change(
        self,
        problem: FitProblem,
        rest: np.ndarray,
        p: np.ndarray,
        columns: np.ndarray,
        into: list[np.ndarray],
        *,
        forward: bool,
    ) -> None:
        """Fill `columns` of d(mu) / dp of every observation, shape (pixels, len(p)) each."""
        tasks, start = [], 0
        for view in problem.views:
            end = start + len(view.observations)
            tasks += self._moves(problem, view, rest, p, columns, into[start:end], forward=forward)
            start = end
        for _ in threads.ordered(tasks, self.device):
            pass

    def _moves(
        self,
        problem: FitProblem,
        view: FitView,
        rest: np.ndarray,
        p: np.ndarray,
        columns: np.ndarray,
        into: list[np.ndarray],
        *,
        forward: bool,
    ) -> list[Callable[[], None]]:
        """Tasks that fill `columns` of the view's d(mu) / dp, `into`: one for all that may move in one render, or for
        all that share the render of what stands, where differences are forward ones."""
        scene = replace(problem.scene, effects=problem.effect_tables(rest))
        places = boxes(without_paths(scene) if self.rough else scene, view.view)
        coordinates, name = self.geometry.coordinates, view.view.name
        tasks: dict[object, list[Sequence[int]]] = {}
        for numbers in shared([coordinates[k] for k in columns], places):
            group = [int(columns[number]) for number in numbers]
            if any(coordinates[k].changes(name) for k in group):
                bodies = frozenset(coordinates[k].body for k in group)
                tasks.setdefault(bodies if forward else tuple(group), []).append(group)
        return [
            partial(self._moved, problem, view, rest, p, groups, places, into, forward=forward)
            for groups in tasks.values()
        ]

    def _moved(
        self,
        problem: FitProblem,
        view: FitView,
        rest: np.ndarray,
        p: np.ndarray,
        groups: Sequence[Sequence[int]],
        places: Mapping[str, Box] | None,
        into: list[np.ndarray],
        *,
        forward: bool,
    ) -> None:
        """Fill the columns of groups that move the same bodies: differences of the power before the image stage, taken
        through that stage. An angle and a spacing may change that stage, too, so theirs are differences of images."""
        coordinates, shape = self.geometry.coordinates, problem.scene.grid.shape
        moving = {body for k in groups[0] if (body := coordinates[k].body) is not None}
        band, faces = None, None
        if places is not None and moving:
            band = columns_of([places[body] for body in moving])
            faces = faces_about(problem.scene, view.view, moving)

        def at(step: np.ndarray) -> ViewRender:
            stepped = self.geometry.stepped(problem.scene, p, step) if moving else self.geometry.at(p + step)
            paths = not self.rough
            return render_elsewhere(problem, view, rest, stepped, band, faces, paths=paths, coarse=self.forward)

        standing = at(np.zeros(p.size)) if forward else None
        apart = POSE_STEP_M if forward else 2.0 * POSE_STEP_M
        for group in groups:
            step = np.zeros(p.size)
            step[group] = POSE_STEP_M
            above, below = at(step), standing or at(-step)
            for (polarization, pixels, _), found in zip(view.compared, into, strict=True):
                if not moving:
                    up, down = (one.images[polarization].numpy()[pixels].astype(float) for one in (above, below))
                    found[:, group[0]] = (up - down) / apart
                    continue
                up, down = (one.before_image[polarization].numpy().reshape(shape) for one in (above, below))
                change = (up - down) / np.float32(apart)
                own = [places[body] for k in group if (body := coordinates[k].body)] if places is not None else None
                moves = np.stack([change] if own is None else [one.alone(change) for one in own])
                moved = through_image(above, polarization, moves.reshape(len(group), -1))
                found[:, group] = moved[:, pixels].T

    def identified(self, x: np.ndarray) -> Identified:
        """Fisher information of surface, effects and poses together, with the priors, and the intervals from it.

        A floor that was added has no speckle, so a residual's standard deviation is that of the rest alone.
        """
        jacobians = self.jacobian(x, near=self.by_rays)
        problem, rest = self.split(x)
        modelled = problem.modelled(rest)
        known = self.prior.information(x)
        return self._identified(self.labels, problem, modelled, problem.curvatures(modelled), jacobians, known)

    def of_numbers(self, x: np.ndarray) -> tuple[PosedNumbers, np.ndarray, Identified]:
        """What is known of the numbers of x, which are all but the nodes of smooth fields: these, their part of x, and
        what the images tell of them where fields move along with them."""
        kept = np.arange(x.size) if self.nodes is None else np.flatnonzero(self.nodes == 0)
        place = {int(k): number for number, k in enumerate(kept)}
        standard = self.prior.standard
        first = int(np.searchsorted(kept, standard.start))
        numbers = PosedNumbers(
            self.geometry,
            kept.size - self.count,
            [self.labels[k] for k in kept],
            [place[k] for k in self.stood],
            Prior(
                [replace(one, at=place[one.at]) for one in self.prior.known],
                kept.size,
                slice(first, first + standard.stop - standard.start),
            ),
            (self.bounds[0][kept], self.bounds[1][kept]),
            self.zero_sum_means[:, kept],
        )
        return numbers, x[kept], self.identified(x) if self.nodes is None else self._beside_fields(x, kept)

    def _beside_fields(self, x: np.ndarray, kept: np.ndarray) -> Identified:
        """`identified` of the elements `kept`, whatever the fields are.

        Each of their columns loses what fields can imitate: J_k - J_f A with A = H_ff^-1 H_fk. The information that is
        left is Schur's complement of the fields' curvature H_ff.
        """
        problem, rest = self.split(x)
        tangent = self.tangent(x, near=self.by_rays)
        modelled = problem.modelled(rest)
        curvatures = problem.curvatures(modelled)
        hessian = self._curvature(tangent, curvatures, x)
        diagonal = hessian.diagonal()
        assert self.nodes is not None
        nodes = self.nodes
        fields = np.flatnonzero((nodes > 0) & (diagonal > FAINT * np.median(diagonal)))
        own, mixed = csr_array(hessian[fields][:, fields]), hessian[fields][:, kept].toarray()
        along = np.stack([solved(own, column, nodes[fields], ACCURATE) for column in mixed.T], axis=1)
        left = tangent[:, kept].toarray() - tangent[:, fields] @ along
        jacobians = np.split(left, np.cumsum([c.weight.size for c in curvatures])[:-1])
        if not self.scene.grid.calibrated:
            jacobians = [
                j - np.average(j, axis=0, weights=c.weight) for j, c in zip(jacobians, curvatures, strict=True)
            ]
        assert isinstance(self.prior, FieldPrior)
        prior = self.prior.sparse_information(x)
        known = prior[kept][:, kept].toarray() + along.T @ (prior[fields][:, fields] @ along)
        labels = [self.labels[k] for k in kept]
        return self._identified(labels, problem, modelled, curvatures, jacobians, known)

    def _curvature(self, tangent: csr_array, curvatures: Sequence[Curvature], x: np.ndarray) -> csr_array:
        weights = [c.weight for c in curvatures]
        return curvature(tangent, weights, self.prior, x, calibrated=self.scene.grid.calibrated)

    def quadratic(self, x: np.ndarray, loss: float, *, near: bool = False) -> DenseQuadratic | SparseQuadratic:
        """The loss with its priors about x, where it is `loss`; `near` as in `jacobian`. Beside smooth fields the
        gradient to all but poses comes from the adjoint."""
        if self.nodes is None:
            return DenseQuadratic(x, loss, *_quadratic(self, x, near=near), self.bounds)
        problem, rest = self.split(x)
        _, slope = problem.gradient(rest)
        slope = slope - problem.prior.gradient(rest)
        tangent = self.tangent(x, near=near)
        curvatures = problem.curvatures(problem.modelled(rest))
        push = np.concatenate([c.weight * c.residual for c in curvatures])
        gradient = self.prior.gradient(x)
        gradient[: self.size] += slope
        gradient[self.size :] -= tangent[:, self.size :].T @ push
        hessian = self._curvature(tangent, curvatures, x)
        return SparseQuadratic.of(x, loss, gradient, hessian, self.nodes, self.bounds)

    def _identified(
        self,
        labels: list[str],
        problem: FitProblem,
        modelled: Sequence[np.ndarray],
        curvatures: Sequence[Curvature],
        jacobians: Sequence[np.ndarray],
        known: np.ndarray,
    ) -> Identified:
        """What images with these columns tell, beside what is `known`, shape (p, p), as of one more measurement."""
        pairs, spreads = [], []
        for seen, c, mu in zip(problem.observations, curvatures, modelled, strict=True):
            share = np.clip(1.0 - self.level / mu, 0.0, 1.0)
            lit = share > LIT
            inside = seen.interior.copy()
            inside[seen.interior] = lit
            sd = share * residual_sd(problem.loss, seen.looks)
            spreads.append(sd[:, None])
            pairs.append((replace(seen, interior=inside), c.residual[lit] / sd[lit]))
        autocovariance = residual_autocovariance(pairs)
        information = products = known
        for seen, j, c, sd in zip(problem.observations, jacobians, curvatures, spreads, strict=True):
            weighted = c.weight[:, None] * j
            information = information + transposed_times(j, weighted)
            products = products + score_products(sd * weighted, autocovariance, seen)
        return of_information(labels, information, products)


@dataclass
class PosedNumbers:
    """The numbers of a posed problem's x, without the nodes of fields: those of surfaces and effects (`size`), and then
    the geometry's coordinates. All as `PosedProblem` has it."""

    geometry: Geometry
    size: int
    labels: list[str]
    stood: list[int]
    prior: Prior
    bounds: tuple[np.ndarray, np.ndarray]
    zero_sum_means: np.ndarray


@dataclass(frozen=True)
class Descended:
    """Where a descent ended: `x`, its `loss` with priors, and the steps that it took."""

    x: np.ndarray
    loss: float
    steps: int


def descend(
    problem: PosedProblem, x: np.ndarray, *, most: int = MOST_STEPS, flat: float | None = None, near: bool = False
) -> Descended:
    """Levenberg-Marquardt from x over surface, effects and poses, until a step promises a gain of less than `flat`; by
    default `FLAT`, more where many numbers move, or `FLAT_BY_RAYS`.

    No step moves an object by more than `LARGEST_MOVE_M`. `near`: the end may be a place where changes of the image by
    poses are those of a place close by, as for a search that goes on from there, or by rays.
    """
    ends_near = near or problem.by_rays
    if flat is None:
        flat = FLAT_BY_RAYS if problem.by_rays else max(FLAT, FLAT_OF_EACH * x.size)
    low, high = problem.bounds
    x = np.clip(x, low, high)
    loss, damping = problem.value(x), DAMPED
    near = True
    for step_number in range(most):
        check()
        here = problem.quadratic(x, loss, near=near)
        exact = ends_near or not problem.count or problem.is_made_at(x)
        trial = _lower(problem, here, damping, flat)
        near = trial is not None
        if trial is not None:
            gained = loss - trial[1]
            x, loss, damping = trial
            near = gained > 0.1 * flat
        if not near and exact:
            return Descended(x, loss, step_number + 1)
    return Descended(x, loss, most)


@dataclass(frozen=True)
class DenseQuadratic:
    """The loss about x as a quadratic: `gradient` and `hessian`, shapes (p,) and (p, p)."""

    x: np.ndarray
    loss: float
    gradient: np.ndarray
    hessian: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]

    @cached_property
    def free(self) -> np.ndarray:
        """The elements that may move, shape (p,)."""
        low, high = self.bounds
        outward = (self.x <= low) & (self.gradient > 0) | (self.x >= high) & (self.gradient < 0)
        return np.asarray(~outward & (np.diag(self.hessian) > 0))

    def step(self, damping: float) -> SparseStep:
        """The step at a damping, which is relative to the diagonal of the curvature."""
        gradient, hessian = self.gradient, self.hessian
        step = _step(gradient, hessian, self.free, damping)
        return SparseStep(step, -float(gradient @ step + 0.5 * step @ hessian @ step))


def _lower(
    problem: PosedProblem, here: DenseQuadratic | SparseQuadratic, damping: float, flat: float
) -> tuple[np.ndarray, float, float] | None:
    """An x of a lower loss than `here`, that loss, and the damping to go on with; None where a gain of less than `flat`
    is promised, or no step gains."""
    low, high = problem.bounds
    if not here.free.any():
        return None
    for _ in range(8):
        planned = here.step(damping)
        if planned.promised < flat:
            return None
        trial = np.clip(here.x + _shortened(problem, planned.step), low, high)
        value = problem.value(trial)
        if value < here.loss:
            return trial, value, max(damping / 10.0, 1e-9)
        damping = max(8.0 * damping, DAMPED)
    return None


def _quadratic(
    problem: PosedProblem, x: np.ndarray, *, near: bool = False, shifts: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and curvature of the loss with its priors; `near` as in `PosedProblem.jacobian`. `shifts`: also to those
    of every image in range and azimuth [pixels], behind x."""
    slopes = problem.slopes(x, near=near)
    inner, rest = problem.split(x)
    curvatures = inner.curvatures(inner.modelled(rest))
    gradient, hessian = problem.prior.gradient(x), problem.prior.information(x)
    if shifts:
        slopes = [np.hstack(pair) for pair in zip(slopes, _shifts(inner), strict=True)]
        more = 2 * len(slopes)
        gradient, hessian = np.pad(gradient, (0, more)), np.pad(hessian, (0, more))
    shape, calibrated = problem.scene.grid.shape, problem.scene.grid.calibrated
    for j, c, seen in zip(slopes, curvatures, inner.observations, strict=True):
        of_gain = c.weight @ j  # the tangent of an unknown gain is taken out of every column
        gradient = gradient - (c.weight * c.residual) @ j
        hessian = hessian + gram_by_tiles(j, c.weight, seen.pixels, shape)
        if not calibrated:
            total = float(c.weight.sum())
            gradient = gradient + of_gain * (float(c.weight @ c.residual) / total)
            hessian = hessian - np.outer(of_gain, of_gain) / total
    return gradient, hessian


def _shifts(problem: FitProblem) -> list[np.ndarray]:
    """d ln(mu) of every observation, shape (pixels, 2 x observations), by a shift of each image by a pixel in range and
    in azimuth, about the images that were rendered last."""
    found = []
    pairs = [(view, seen) for view in problem.views for seen in view.observations]
    for k, (view, seen) in enumerate(pairs):
        image = view.render.images[seen.polarization].numpy().reshape(seen.interior.shape).astype(float)
        slopes = -np.stack([np.gradient(image, axis=axis).ravel()[seen.pixels] for axis in (0, 1)], axis=1)
        mu = np.maximum(image.ravel()[seen.pixels], seen.darkest)
        columns = np.zeros((len(mu), 2 * len(pairs)))
        columns[:, 2 * k : 2 * k + 2] = slopes / mu[:, None]
        found.append(columns)
    return found


def without_shading(problem: PosedProblem, *, shifts: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Curvature and slope of the log-likelihood to the geometry, at the start, with surface and effects moving along;
    with `shifts`, to those of every image too, last.

    Shapes (n, n) and (n,): what is left of the geometry's own when all that surface and effects can imitate is taken
    out. A step s gains slope s - s curvature s / 2 to second order.
    """
    gradient, hessian = _quadratic(problem, problem.x0, shifts=shifts)
    own, n = slice(0, problem.size), problem.size
    along = np.linalg.pinv(hessian[own, own], rcond=1e-9, hermitian=True) @ np.column_stack(
        [hessian[own, n:], gradient[own]]
    )
    return hessian[n:, n:] - hessian[n:, own] @ along[:, :-1], hessian[n:, own] @ along[:, -1] - gradient[n:]


def foretold_gain(left: np.ndarray, slope: np.ndarray) -> float:
    """The gain of the best step, to second order, from a curvature (n, n) and a slope (n,) as `without_shading` has
    them, or the parts of them along which the step may go."""
    return 0.5 * float(slope @ np.linalg.pinv(left, rcond=1e-9, hermitian=True) @ slope)


def _step(gradient: np.ndarray, hessian: np.ndarray, free: np.ndarray, damping: float) -> np.ndarray:
    scale = np.diag(hessian) + 1e-12 * float(np.trace(hessian))
    step = np.zeros_like(gradient)
    step[free] = -np.linalg.solve((hessian + np.diag(damping * scale))[np.ix_(free, free)], gradient[free])
    return step


def _shortened(problem: PosedProblem, step: np.ndarray) -> np.ndarray:
    """Each part of the step within its own bound: neither a surface in its valley nor another body must hold a body
    back, nor the surface of one body that of another, and no node of a smooth field another one."""
    found = step.copy()
    fields = np.zeros(step.size, bool) if problem.nodes is None else problem.nodes > 0
    found[fields] = np.clip(step[fields], -LARGEST_STEP, LARGEST_STEP)
    parts: dict[object, list[int]] = {}
    for k, one in enumerate(problem.geometry.coordinates, start=problem.size):
        parts.setdefault(one.body, []).append(k)
    moves = [(each, LARGEST_MOVE_M) for each in parts.values()]
    surfaces: dict[bytes, list[int]] = {}
    for at in np.flatnonzero(~fields[: problem.size]).tolist():
        surfaces.setdefault(problem.owners[:, at].tobytes(), []).append(at)
    shades = [(each, LARGEST_STEP) for each in surfaces.values()]
    for part, most in [*shades, *moves]:
        largest = float(np.abs(step[part]).max(initial=0.0))
        found[part] *= min(1.0, most / largest) if largest else 1.0
    return found
