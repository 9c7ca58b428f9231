"""Measured images, and curves beside them -> surface parameters: the whole fit, from a scene to what was learned."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path

import numpy as np
import warp as wp

from warpsar.compare.evaluation import Evaluation, evaluated
from warpsar.compare.judgement import Judgement
from warpsar.compare.metrics import PooledMetrics
from warpsar.compare.observation import looks_of
from warpsar.errors import InputError, WarpsarError, refuse_kind
from warpsar.io.checkpoint import Checkpoint
from warpsar.learning.coordinates import SceneCoordinates
from warpsar.learning.curves import curves_beside
from warpsar.learning.descent import FitRecord, History, descend, stand
from warpsar.learning.device_values import DeviceValues
from warpsar.learning.gradcheck import GradientCheck, check_gradient
from warpsar.learning.identify import Identified, identify, of_first
from warpsar.learning.learned_objects import LearnedObjects, learned_objects
from warpsar.learning.metrics import pooled_metrics
from warpsar.learning.options import LearnOptions, refuse_options, refuse_starts
from warpsar.learning.prior import Beside
from warpsar.learning.problem import FitProblem
from warpsar.learning.profiles import with_profiles
from warpsar.learning.pull import Pull, pulls
from warpsar.learning.results import learned_scene
from warpsar.learning.table import LearnedTable, tables_to_learn, with_tables
from warpsar.learning.term import Trained, as_asked, seen_cosines, with_untrained_terms
from warpsar.learning.trust import doubts, outside_domains, worse
from warpsar.runtime import console, devices, once
from warpsar.scene.scene import Scene, scene_or_file
from warpsar.simulation.rays import Rays
from warpsar.simulation.sampling import RAY_NOISE, Density, choose_density
from warpsar.surface.stage import Stage
from warpsar.world.models import TABLE, TERM
from warpsar.world.world import lacks_images


@dataclass
class Learned:
    """What a fit found.

    `scene` holds the learned parameters, `x` the same as a vector. `domains`, by material: share of its lit area
    outside the domain of each model. `before` and `after`: the scene as it was given and `scene`, each beside all
    measured images, as `evaluate` has them; `worse`: what got worse from one to the other, in words. `identified` is
    None for fields (see fields.py), which have too many parameters for one information matrix. `pulls`: every value
    known to a tolerance, before and after. `doubts`: why the intervals do not hold; empty where nothing speaks against
    them. `objects`: poses and sizes, where any is learned. `terms`, by
    material: learned terms that were trained. `tables`, by material: tables of sigma0 that were learned.
    """

    scene: Scene
    x: np.ndarray
    loss: float
    labels: list[str]
    history: History
    stopped: str
    gradient_check: GradientCheck
    density: Density
    identified: Identified | None
    domains: dict[str, dict[str, float]]
    before: Evaluation
    after: Evaluation
    worse: list[str]
    pulls: list[Pull]
    doubts: list[str]
    problem: FitProblem
    objects: LearnedObjects | None = None
    terms: Mapping[str, Trained] = field(default_factory=dict)
    tables: Mapping[str, LearnedTable] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Learned: {len(self.labels)} parameters, loss {self.loss:.4f}, stopped: {self.stopped}>"

    @property
    def train(self) -> PooledMetrics:
        """Metrics of the train views."""
        assert self.after.train is not None
        return self.after.train

    @property
    def test(self) -> PooledMetrics | None:
        """Metrics of the test views; None where there are none."""
        return self.after.test

    @property
    def verdicts(self) -> dict[str, Judgement]:
        """Whether anything is left beside speckle, by role."""
        return self.after.verdicts


def learn(
    scene: Scene | PathLike[str] | str,
    *,
    device: str | None = None,
    options: LearnOptions | None = None,
    folder: Path | str | None = None,
    resume: bool = False,
) -> Learned:
    """Fit the materials' learnable parameters, and the declared effects' unless they are held, to the `train` views.

    With `folder` the run keeps a checkpoint there, and `resume` goes on from it. Each of several processes
    holds a share of the views; all return the same, and the first one writes. Learned terms and tables
    that materials' `learn` names are a part of x beside all numbers.
    Raises InputError for scenes that cannot be learned from, and WarpsarError where the gradient check fails.
    """
    scene = scene_or_file(scene)
    options = options or LearnOptions()
    refuse_kind(options, LearnOptions, "options")
    refuse_starts(scene)
    asked = scene
    where = devices.resolve_device(device)
    once.join(where)
    folder = None if folder is None else Path(folder)
    kept = Checkpoint(folder, resume)

    def prepared(one: Scene) -> FitProblem:
        problem, _ = prepare(one, where, options, shared=True)
        refuse_options(problem, options)  # before a term is begun
        return problem

    cache = None if folder is None else folder / "cache"
    beside = curves_beside(scene, cache, where.alias)
    declared, terms = with_untrained_terms(asked, folder, prepared)
    tables = tables_to_learn(declared, folder, options.loss)
    blocks = [one.block(declared, name) for some in (terms, tables) for name, one in some.items()]
    values = DeviceValues.of(blocks)
    poses = once.agree(lambda: learned_objects(declared, where, options.loss, values))
    scene = declared if poses is None else poses.scene
    values = values if poses is None else poses.found.values
    problem, density = once.agree(lambda: prepare(scene, where, options, shared=True, values=values, beside=beside))
    if not problem.x0.size and poses is None:
        raise InputError(
            f"{scene.name}: materials: nothing to learn: every `learn` is empty, and no effect's parameter is fitted"
        )
    refuse_options(problem, options)
    cosines = {name: seen_cosines(problem, name, TABLE) for name in tables}
    check = _checked(problem) if problem.x0.size else GradientCheck(0.0, 0)
    tests = once.agree(lambda: _test_problem(scene, where, options, problem, density))
    record = FitRecord(kept, _tag(declared, options))
    runs = descend if problem.x0.size else stand
    state, stopped = runs(problem, tests, options, record, stoppable=folder is not None)
    x = np.asarray(state.best_x)
    whole, covariance = _determined(problem, x, poses)
    fit = (
        {"before": _as_given(problem), "after": pooled_metrics(problem, x), "steps": state.iteration}
        if values.blocks
        else {}
    )
    trained, learned = dict[str, Trained](), dict[str, LearnedTable]()
    for block, part in values.parts:
        name, its = block.material, block.values(x[problem.of_values][part])
        if block.key == TERM:
            trained[name] = terms[name].trained(its, **fit)
        else:
            material = f"{scene.name}: materials.{name}.learn"
            sd = block.sd(covariance[part, part])
            learned[name] = tables[name].learned(material, its, sd, cosines[name], **fit)
    written = once.write(lambda: learned_scene(problem, x, folder))
    final = with_tables(as_asked(written or learned_scene(problem, x), asked, terms), learned)
    before, after = (evaluated(one, where, progress="compare", cache=cache) for one in (asked, final))
    domains = outside_domains(problem, x)
    pulled = [*pulls(problem, x, whole), *([] if poses is None else poses.found.pulls)]
    return Learned(
        scene=final,
        x=x,
        loss=state.best_loss,
        labels=problem.labels if x.size < 1000 else [],
        history=record.history,
        stopped=stopped,
        gradient_check=check,
        density=density,
        identified=whole if whole is None or not values.blocks else _of_numbers(problem, whole),
        domains=domains,
        before=before,
        after=after,
        worse=once.find(lambda: worse(before.images, after.images)),
        pulls=pulled,
        doubts=[
            *doubts(problem, x, after.verdicts, domains),
            *(f"{role} curves: {one.words}" for role, one in after.curve_verdicts.items() if one.wrong),
            *(one.words for one in pulled if one.alarm),
        ],
        problem=problem,
        objects=poses,
        terms=trained,
        tables=learned,
    )


def _determined(
    problem: FitProblem, x: np.ndarray, poses: LearnedObjects | None
) -> tuple[Identified | None, np.ndarray]:
    """What the data tell about x, and not about fields; poses that were fitted along widen it. Second, the covariance
    of the coordinates of tables and terms, beside which fields are held."""
    own = problem.of_values
    if not x.size:
        return None, np.zeros((0, 0))
    if not problem.uniform:
        if own.start == own.stop:
            return None, np.zeros((0, 0))
        return None, identify(problem, x, list(range(own.start, own.stop))).covariance
    found = identify(problem, x)
    # a profile beside moving objects would trace them at each step, and one beside curves would sweep the rays of their
    # bodies: there the standard deviation says it all
    if poses is not None:
        found = poses.widened(found)
    elif problem.prior.beside is None:
        found = with_profiles(problem, x, found)
    return found, found.covariance[own, own]


def _of_numbers(problem: FitProblem, whole: Identified) -> Identified | None:
    """What is said of surfaces and effects; None without any."""
    size = problem.of_values.start
    return of_first(whole, size, problem.zero_sum_means) if size else None


def _as_given(problem: FitProblem) -> dict[str, float]:
    """Metrics at the start, with all tables as given and terms of nothing."""
    x = problem.x0.copy()
    x[problem.of_values] = 0.0
    return pooled_metrics(problem, x)


def _checked(problem: FitProblem) -> GradientCheck:
    """The gradient check at the start. Raises WarpsarError where it fails."""
    check = check_gradient(problem, problem.x0)
    console.say(
        f"gradient check: adjoint against central differences agree to {check.worst:.1e} "
        f"over {check.directions} directions"
    )
    if not check.passed:
        raise WarpsarError(
            f"{problem.scene.path}: the gradient check failed: {check.worst:.2g} off, over the allowed 2e-2; more "
            f"rays, or a start further inside the bounds, may help"
        )
    return check


def prepare(
    scene: Scene,
    device: wp.Device,
    options: LearnOptions,
    *,
    shared: bool = False,
    values: DeviceValues | None = None,
    beside: Callable[[SceneCoordinates], Beside] | None = None,
) -> tuple[FitProblem, Density]:
    """The fit problem of the train views, with as many rays as the looks of the images ask for. `shared`, `values` and
    `beside` as in `FitProblem`."""
    views = [v for v in scene.views if v.role == "train" and v.images]
    if not views:
        raise lacks_images(scene, "train")
    stage = Stage.of(scene, device)
    looks = [looks_of(scene, view) for view in views]
    density = choose_density(scene, stage, views, looks, RAY_NOISE, shared=shared)
    if density.chosen:
        console.say(
            f"rays: {density.rays_per_pixel:g} per pixel; looks x relative sampling variance {density.noise:.2g} "
            f"(wanted: under {RAY_NOISE})"
        )
    problem = FitProblem(
        scene,
        device,
        loss=options.loss,
        rays=Rays(stage, density.rays_per_m2, scene.sampling.seed),
        total_variation=options.total_variation,
        validity=options.validity,
        shared=shared,
        max_memory_gib=options.max_memory_gib,
        values=values,
        beside=beside,
    )
    for name, (number, estimated, zeros) in problem.of_each(lambda s: (s.looks, s.looks_estimated, s.zeros)).items():
        if estimated:
            console.say(f"looks of {name}: not declared, estimated as {number:.1f}")
        if zeros:
            console.say(f"{name}: {zeros} lit pixels measure 0 and are left out")
    return problem, density


def _test_problem(
    scene: Scene, device: wp.Device, options: LearnOptions, problem: FitProblem, density: Density
) -> FitProblem | None:
    """The test views, which no fit touches; None where there are none with images."""
    if not any(v.role == "test" and v.images for v in scene.views):
        return None
    return FitProblem(
        scene,
        device,
        loss=options.loss,
        roles=("test",),
        rays=Rays(problem.stage, density.rays_per_m2, scene.sampling.seed),
        shared=True,
        max_memory_gib=options.max_memory_gib,
        values=problem.values,
    )


def _tag(scene: Scene, options: LearnOptions) -> str:
    """What a checkpoint belongs to: the input and the options that change the result."""
    free = ("iterations", "max_time_s", "checkpoint_every", "max_memory_gib")
    return tag_of(scene, {k: v for k, v in asdict(options).items() if k not in free})


def tag_of(scene: Scene, chosen: Mapping[str, object]) -> str:
    """What a checkpoint belongs to: the input, and what was `chosen` and changes the result (JSON's types)."""
    # a scene made in memory has no text for the hash to hold
    made = "" if scene.source else repr((scene.radar, scene.grid, scene.sampling, scene.materials, scene.effects))
    return hashlib.sha256((scene.input_hash + made + json.dumps(chosen, sort_keys=True)).encode()).hexdigest()
