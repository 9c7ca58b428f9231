"""Poses, shapes and brightness of many objects at once, from images that need not be differentiable.

A bounce between car and ground is followed by rays, and an image by rays has no derivative over millimetres. So each
object's derivatives are differences over centimetres, of a small scene about it: the object, its neighbours, a piece of
ground, and the pixels that they reach. Objects are fitted in turn, each against what all others give; processes share
them. Whatever all objects have in common (ground, point spread, bounces) is fitted between two rounds.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from warpsar.compare.observation import Observation, estimated_looks, usable_pixels
from warpsar.effects.registry import validate
from warpsar.learning.optimise import begin, levenberg_marquardt
from warpsar.learning.problem import FitProblem
from warpsar.learning.results import learned_scene
from warpsar.runtime.devices import resolve_device
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.simulation.exact_rays import ExactRays
from warpsar.surface.stage import Stage
from warpsar.world.mesh import Mesh
from warpsar.world.objects.table import LIMITS, Object
from warpsar.world.pixels import Pixels
from warpsar.world.tables import View
from warpsar.world.world import geometry_of, posed

ROWS, COLS = 30, 18  # of an object's window: 15 m of slant range and 18 m of azimuth
NEIGHBOURS_M, GROUND_M = 10.0, 11.0  # how far objects and ground reach from the window's middle
GROUND = "car_park"  # material of a window's ground: only its differences count, where shadows move
SIZES = ("length", "width", "height")
POSE, SHAPE = ("east", "north", "heading"), (*SIZES, "side_curvature")
GLINT = "glint"
BRIGHTNESS = "brightness"  # ln of the material's rms height
DETAIL = "detail"  # ln of the object's share of `unresolved_detail`
SURFACE = (DETAIL, BRIGHTNESS)  # what is no pose and no shape, last in this order
STEP = {"east": 0.06, "north": 0.10, "heading": 1.5, "length": 0.04, "width": 0.05, "height": 0.06}
STEP |= {"side_curvature": 0.03, DETAIL: 0.1, BRIGHTNESS: 0.1}
KNOWN = {"east": 0.8, "north": 1.2, "heading": 6.0, "length": 0.10, "width": 0.08, "height": 0.12}
KNOWN |= {"side_curvature": 0.06, DETAIL: 1.0, BRIGHTNESS: 1.2}
"""Standard deviations about the start: of the reading [m], of a parked car [deg], of cars (shares of a size)."""
THING = {"length": 0.5, "width": 0.5, "height": 0.5}  # of what is no car, nothing is known
LARGEST = {"east": 0.6, "north": 0.8, "heading": 5.0}  # move in one step; of logarithms and shares 0.7
LEAST = 0.1  # of an object's own image, that is left where the others' difference to the window's exceeds it
ENOUGH = 0.5  # gain in log-likelihood from which a further step is tried
SHARES = 8  # of the objects, each fitted by a process; as many on any machine, so that the result is the same


def keys_of(one: Object, wanted: Sequence[str]) -> list[str]:
    """Those of the wanted numbers that the object has. A box has neither front nor curved sides, a glint no size."""
    if kind_of(one) == GLINT:
        return [key for key in wanted if key in ("east", "north")]
    return [key for key in wanted if one.primitive == "car" or key not in ("heading", "side_curvature")]


def kind_of(one: Object) -> str:
    """car, thing or glint: what the names of such objects begin with."""
    return str(one.name).rstrip("0123456789")


def value(one: Object, key: str) -> float:
    """A number of an object: metres, degrees, the logarithm of a size, or a share."""
    if key in SIZES:
        assert one.size_m is not None
        return math.log(one.size_m[SIZES.index(key)])
    if key in ("east", "north"):
        return one.position_m[("east", "north").index(key)]
    return one.heading_deg if key == "heading" else float(one.side_curvature or 0.0)


def value_in(scene: Scene, one: Object, key: str) -> float:
    """As `value`, and the logarithms of an object's rms height and share of detail, which the scene holds."""
    if key == BRIGHTNESS:
        return math.log(float(scene.materials[str(one.material)].rms_height_m))
    if key == DETAIL:
        return math.log(scene.effects["unresolved_detail"].get("share", {}).get(str(one.material), 1.0))
    return value(one, key)


@dataclass(frozen=True)
class Belief:
    """What a fit takes for known: how many pixels the likelihood counts as one speckle, and standard deviations of a
    car's numbers in place of `KNOWN`'s."""

    shared: float = 1.0
    sd: Mapping[str, float] = field(default_factory=dict)

    def known(self, one: Object) -> dict[str, float]:
        return KNOWN | dict(self.sd) if one.primitive == "car" else KNOWN | THING


def with_values(one: Object, values: Mapping[str, float]) -> Object:
    """The object with these numbers."""
    assert one.size_m is not None
    position, size = list(one.position_m), list(one.size_m)
    changed: dict[str, Any] = {}
    for key, number in values.items():
        if key in SIZES:
            size[SIZES.index(key)] = math.exp(number)
        elif key in ("east", "north"):
            position[("east", "north").index(key)] = float(number)
        elif key == "heading":
            changed["heading_deg"] = float(number)
        elif key == "side_curvature":
            changed[key] = float(np.clip(number, *LIMITS[key]))
    return one.model_copy(update={"position_m": tuple(position), "size_m": tuple(size), **changed})


@dataclass(frozen=True)
class Seen:
    """One view of the whole scene, (rows, cols) each: modelled beta0, measured power over its gain, usable pixels."""

    view: View
    model: np.ndarray
    measured: np.ndarray
    usable: np.ndarray
    looks: float


def whole(scene: Scene, view: View) -> Observation:
    """A view's image with its shadows. A model's own shadows hide what it misplaced: a fit that leaves them out, as
    `observe` does, never pays for a glint that it put a shadow on."""
    measured = np.asarray(scene.measured(view, "HH"))
    usable = usable_pixels(scene, view, measured) & (np.nan_to_num(measured) > 0)
    none = np.zeros_like(usable)
    looks = view.looks or estimated_looks(scene, view, np.where(usable, measured, np.nan))
    return Observation(view, "HH", measured, usable, none, none, looks, view.looks is None)


def problem_of(scene: Scene, views: Sequence[str]) -> FitProblem:
    """Exact hits of the given views, whatever their role; every pixel of their images counts."""
    device = resolve_device("cpu")
    return FitProblem(
        scene,
        device,
        roles=("train", "test"),
        views=list(views),
        rays=ExactRays(Stage.of(scene, device), seed=1),
        observations={view.name: [whole(scene, view)] for view in scene.views if view.name in views},
    )


def seen_in(scene: Scene, views: Sequence[str]) -> list[Seen]:
    problem = problem_of(scene, views)
    modelled = problem.modelled(problem.x0)
    found = []
    for view, seen, gain in zip(problem.views, problem.observations, problem.gains(modelled), strict=True):
        model = view.render.images[seen.polarization].numpy().reshape(scene.grid.shape).astype(float)
        measured = np.asarray(seen.measured, float) / gain
        found.append(Seen(view.view, model, np.where(seen.interior, measured, 1.0), seen.interior, seen.looks))
    return found


class Window:
    """The pixels about an object in one view, as an image of a small scene of its own."""

    def __init__(self, scene: Scene, seen: Seen, index: int) -> None:
        self.seen, self.index = seen, index
        geometry, shape, spacing = geometry_of(scene, seen.view), scene.grid.shape, scene.grid.spacing_m
        east, north, _ = scene.objects[index].position_m
        middle = np.array([east, north, 0.0])
        row, col = (round(float(middle @ axis) / s) for axis, s in zip((geometry.d, geometry.u), spacing, strict=True))
        self.reference = row * spacing[0] * geometry.d + col * spacing[1] * geometry.u
        first = (shape[0] // 2 + row - ROWS // 2, shape[1] // 2 + col - COLS // 2)
        ends = [(max(f, 0), min(f + n, whole)) for f, n, whole in zip(first, (ROWS, COLS), shape, strict=True)]
        self.whole = tuple(slice(*pair) for pair in ends)
        self.part = tuple(slice(low - f, high - f) for f, (low, high) in zip(first, ends, strict=True))
        self.grid = scene.grid.model_copy(update={"shape": (ROWS, COLS)})
        plain = Pixels(np.ones((ROWS, COLS), np.float32))
        self.view = seen.view.model_copy(update={"looks": 1.0, "images": {"HH": plain}, "mask": None})
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * GROUND_M + middle
        faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
        self.ground = Mesh(corners, faces, np.zeros(2, np.int32), (GROUND,))
        self.near = [
            k
            for k, other in enumerate(scene.objects)
            if k != index and np.abs(np.subtract(other.position_m[:2], middle[:2])).max() < NEIGHBOURS_M
        ]

    def problem(self, scene: Scene, one: Object) -> FitProblem:
        """The window's scene with the object as given: its x is the logarithm of the object's rms height."""
        materials = {
            name: table.model_copy(update={"learn": ("rms_height_m",) if name == one.material else ()})
            for name, table in scene.materials.items()
        }
        objects = [one, *(scene.objects[k] for k in self.near)]
        effects = {k: {**table, "fixed": True} for k, table in scene.effects.items() if k != "eps_gradient"}
        if detail := effects.pop("unresolved_detail", None):
            names = [str(o.material) for o in objects if str(o.material) in detail["materials"]]
            share = {name: float(detail.get("share", {}).get(name, 1.0)) for name in names}
            table = {**detail, "materials": names, "share": share, "fixed": False, "learn": ["share"]}
            effects |= {"unresolved_detail": table} if names else {}
        own = replace(
            scene,
            mesh=self.ground,
            assembly=None,
            objects=(),
            materials={GROUND: materials[GROUND]},
            grid=self.grid,
            reference_point_m=tuple(self.reference),
            views=[self.view],
            effects={},
            path=None,
        )
        own = replace(with_objects(own, objects, materials), effects=effects)
        every = np.ones((ROWS, COLS), bool)
        plain = Observation(self.view, "HH", every.astype(np.float32), every, ~every, ~every, 1.0, False)
        device = resolve_device("cpu")
        rays = ExactRays(Stage.of(own, device), seed=1)
        return FitProblem(own, device, views=[self.view.name], rays=rays, observations={self.view.name: [plain]})

    def image(self, problem: FitProblem, material: str, log_height: float, log_share: float | None) -> np.ndarray:
        """beta0 of those pixels that lie in the whole image."""
        x = np.array(problem.x0, float)
        x[0] = log_height
        if log_share is not None:
            at = [c.entry for c in problem.effect_coordinates].index(material)
            x[problem.learned.size + at] = log_share
        (image,) = problem.modelled(x)
        return image.reshape(ROWS, COLS)[self.part]


@dataclass(frozen=True)
class Fitted:
    """An object after its fit; `information` is that of the images alone about `keys`, brightness last, for speckle of
    the stated looks that `Belief.shared` pixels share; `scatter`: looks times the mean squared relative residual."""

    object: Object
    log_height: float
    log_share: float | None
    gain: float
    keys: list[str]
    information: np.ndarray
    scatter: float


class _Fit:
    """One object against everything else, which stays: `vector` holds its keys' values, brightness last."""

    def __init__(
        self, scene: Scene, index: int, start: Object, seen: Sequence[Seen], keys: Sequence[str], belief: Belief
    ) -> None:
        self.scene, self.one = scene, scene.objects[index]
        self.keys = [*keys_of(self.one, keys), BRIGHTNESS]
        self.geometric = [k for k in self.keys if k not in SURFACE]
        self.windows = [Window(scene, each, index) for each in seen]
        self.start = np.array([value_in(scene, self.one, k) for k in self.keys])
        kind = [o for o in scene.objects if kind_of(o) == kind_of(self.one)]
        self.about = np.array(
            [
                float(np.median([value_in(scene, o, k) for o in kind])) if k in SURFACE else value(start, k)
                for k in self.keys
            ]
        )
        self.belief, known = belief, belief.known(self.one)
        self.sd = np.array([known[k] for k in self.keys])
        self.problems = self.posed(self.start)
        self.now = self.shot(self.problems, self.start)
        self.others = [w.seen.model[w.whole] - n for w, n in zip(self.windows, self.now, strict=True)]
        shared = belief.shared
        self.data = [(w.seen.measured[w.whole], w.seen.usable[w.whole], w.seen.looks / shared) for w in self.windows]

    def at(self, vector: np.ndarray) -> Object:
        """The object with the vector's pose and shape."""
        return with_values(self.one, dict(zip(self.geometric, vector, strict=False)))

    def posed(self, vector: np.ndarray) -> list[FitProblem]:
        return [w.problem(self.scene, self.at(vector)) for w in self.windows]

    def shot(self, problems: Sequence[FitProblem], vector: np.ndarray) -> list[np.ndarray]:
        name, height, share = str(self.one.material), float(vector[-1]), self.share(vector)
        return [w.image(p, name, height, share) for w, p in zip(self.windows, problems, strict=True)]

    def share(self, vector: np.ndarray) -> float | None:
        """ln of the share of detail, where it is fitted."""
        return float(vector[self.keys.index(DETAIL)]) if DETAIL in self.keys else None

    def total(self, images: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The whole scene's pixels with the object's window as given."""
        return [np.maximum(o + i, LEAST * i) for o, i in zip(self.others, images, strict=True)]

    def loss(self, images: Sequence[np.ndarray], vector: np.ndarray) -> float:
        found = 0.5 * float((((vector - self.about) / self.sd) ** 2).sum())
        for mu, (measured, usable, looks) in zip(self.total(images), self.data, strict=True):
            found += looks * float((measured / mu + np.log(mu))[usable].sum())
        return found

    def quadratic(self, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Gradient with the prior, the images' information alone, and the scatter."""
        mus = self.total(self.now)
        slopes: list[list[np.ndarray]] = [[] for _ in mus]
        for k, key in enumerate(self.keys):
            moved = vector.copy()
            moved[k] += STEP[key]
            problems = self.problems if key in SURFACE else self.posed(moved)
            for found, other, mu in zip(slopes, self.total(self.shot(problems, moved)), mus, strict=True):
                found.append(np.log(other / mu) / STEP[key])
        gradient = (vector - self.about) / self.sd**2
        information = np.zeros((len(self.keys), len(self.keys)))
        squares = []
        for found, mu, (measured, usable, looks) in zip(slopes, mus, self.data, strict=True):
            matrix = np.stack([each[usable] for each in found], axis=1)
            residual = (measured / mu - 1.0)[usable]
            gradient = gradient - looks * matrix.T @ residual
            information = information + looks * matrix.T @ matrix
            squares.append(self.belief.shared * looks * float(np.mean(residual**2)))
        return gradient, information, float(np.mean(squares))

    def step(self, gradient: np.ndarray, information: np.ndarray, damping: float) -> np.ndarray:
        """Shortened, so that no number moves by more than `LARGEST`."""
        curvature = information + np.diag(1.0 / self.sd**2)
        move = -np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), gradient)
        return np.asarray(
            move / max(1.0, *(abs(m) / LARGEST.get(k, 0.7) for m, k in zip(move, self.keys, strict=True)))
        )

    def descended(self, steps: int, *, told: bool = False) -> Fitted:
        """Levenberg-Marquardt; the whole scene's model is left with the object in its new place. `told`: the
        information is that of the end, not of the last step's begin."""
        vector, current, damping = self.start.copy(), self.loss(self.now, self.start), 1e-2
        first, scatter = current, 1.0
        for _ in range(steps):
            gradient, information, scatter = self.quadratic(vector)
            gain = 0.0
            for _ in range(4):
                trial = vector + self.step(gradient, information, damping)
                for k, key in enumerate(self.keys):
                    trial[k] = np.clip(trial[k], *LIMITS[key]) if key in LIMITS else trial[k]
                problems = self.posed(trial)
                images = self.shot(problems, trial)
                if (loss := self.loss(images, trial)) < current:
                    gain = current - loss
                    vector, self.problems, self.now, current = trial, problems, images, loss
                    damping = max(damping / 10.0, 1e-4)
                    break
                damping = max(10.0 * damping, 0.05)
            if gain < ENOUGH:
                break
        if told:
            _, information, scatter = self.quadratic(vector)
        for window, mu in zip(self.windows, self.total(self.now), strict=True):
            window.seen.model[window.whole] = mu
        gain, share = first - current, self.share(vector)
        return Fitted(self.at(vector), float(vector[-1]), share, gain, self.keys, information, scatter)


_Task = tuple[Scene, list[int], Sequence[Object], Sequence[str], Sequence[str], int, bool, Belief]


def _share(task: _Task) -> dict[int, Fitted]:
    scene, mine, starts, views, keys, steps, told, belief = task
    seen, found = seen_in(scene, views), {}
    for index in mine:
        done = _Fit(scene, index, starts[index], seen, keys, belief).descended(steps, told=told)
        found[index], scene = done, placed(scene, {index: done})
    return found


def placed(scene: Scene, found: Mapping[int, Fitted]) -> Scene:
    """The scene with fitted objects in place."""
    objects, materials = list(scene.objects), dict(scene.materials)
    for index, one in found.items():
        objects[index] = one.object
        name = str(one.object.material)
        materials[name] = materials[name].model_copy(update={"rms_height_m": math.exp(one.log_height)})
    scene = replace(posed(scene, objects), materials=materials)
    shares = {str(one.object.material): math.exp(one.log_share) for one in found.values() if one.log_share is not None}
    if not shares:
        return scene
    detail = scene.effects["unresolved_detail"]
    table = {**detail, "share": {**detail.get("share", {}), **shares}}
    return replace(scene, effects={**scene.effects, "unresolved_detail": table})


def fit_round(
    scene: Scene,
    starts: Sequence[Object],
    views: Sequence[str],
    keys: Sequence[str],
    *,
    steps: int = 2,
    told: bool = False,
    belief: Belief | None = None,
) -> tuple[Scene, dict[int, Fitted]]:
    """Every object fitted once, against all others as they stand: `SHARES` shares, from south to north.

    `starts` are the objects as they were read off, which the priors are about. `told`: as `_Fit.descended`."""
    order = sorted(range(len(scene.objects)), key=lambda k: scene.objects[k].position_m[1])
    shares = [part.tolist() for part in np.array_split(order, min(SHARES, len(order)))]
    tasks = [(scene, mine, starts, views, keys, steps, told, belief or Belief()) for mine in shares]
    with multiprocessing.get_context("spawn").Pool(min(len(tasks), os.cpu_count() or 1)) as pool:
        found = {k: one for part in pool.map(_share, tasks, chunksize=1) for k, one in part.items()}
    return placed(scene, found), found


def fit_common(scene: Scene, views: Sequence[str], *, most: int = 30, flat: float = 1.0) -> Scene:
    """Every material's brightness and the effects, with all objects where they stand."""
    problem = problem_of(scene, views)
    state = begin(problem, 0, 0)
    for _ in range(most):
        state = levenberg_marquardt(problem, state, flat=flat, kept_within=0.3)
        if state.arrived:
            break
    return learned_scene(problem, np.asarray(state.best_x), None)


def with_effects(scene: Scene, **tables: Mapping[str, Any]) -> Scene:
    checked = {name: validate(name, dict(table), f"effects.{name}") for name, table in tables.items()}
    return replace(scene, effects={**scene.effects, **checked})
