"""Measured images -> surface parameters: `warpsar learn`."""

from __future__ import annotations

import csv
import hashlib
import json
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.errors import InputError, WarpsarError
from warpsar.io import checkpoint
from warpsar.io.figures import convergence
from warpsar.io.images import replacing
from warpsar.learning.adam import Adam, GraphAdam
from warpsar.learning.coordinates import DeviceX
from warpsar.learning.fields import write_field_uncertainty
from warpsar.learning.gradcheck import GradientCheck, check_gradient
from warpsar.learning.identify import Identified, identify
from warpsar.learning.observation import Observation, looks_of
from warpsar.learning.optimise import FitState, begin, levenberg_marquardt
from warpsar.learning.problem import FitProblem
from warpsar.learning.results import learned_scene
from warpsar.learning.validity import outside_domains
from warpsar.runtime import console, devices, distributed
from warpsar.runtime.distributed import Ranks
from warpsar.scene.scene import Scene
from warpsar.simulation.outputs import opened, write_json
from warpsar.simulation.rays import Rays
from warpsar.simulation.sampling import Density, choose_density
from warpsar.speckle.likelihood import LOSSES, METRICS, metrics, metrics_of
from warpsar.surface.stage import Stage
from warpsar.surface.surface import KEYS, Surface

RAY_NOISE = 0.01  # looks x relative sampling variance of a lit pixel (scene-format.md)


@dataclass(frozen=True)
class LearnOptions:
    """How to fit; the defaults suit uniform materials and fields alike.

    `optimiser` "auto" takes Levenberg-Marquardt for uniform materials and Adam for fields. `starts`: the scene's own
    and others drawn about it. `total_variation`: weight per parameter key. `validity`: weight of the models' domains
    as soft constraints, 0 for none. `rate`: Adam's first step in log coordinates. `max_time_s` counts all parts of a
    resumed run. `max_memory_gib` bounds what kept hits take (`FitProblem`).
    """

    loss: str = "gamma"
    optimiser: str = "auto"
    starts: int = 3
    iterations: int = 500
    max_time_s: float = float("inf")
    rate: float = 0.05
    total_variation: Mapping[str, float] = field(default_factory=dict)
    validity: float = 0.0
    checkpoint_every: int = 10
    seed: int = 0
    max_memory_gib: float | None = None

    def __post_init__(self) -> None:
        if self.loss not in LOSSES:
            raise InputError(f"--loss: found {self.loss!r}; allowed are {', '.join(LOSSES)}")
        if self.optimiser not in ("auto", "lm", "adam"):
            raise InputError(f"--optimiser: found {self.optimiser!r}; allowed are auto, lm, adam")
        for key, weight in self.total_variation.items():
            if key not in KEYS or not 0 <= weight < float("inf"):
                raise InputError(f"--tv: found {key}={weight}; allowed is one of {', '.join(KEYS)} and a number >= 0")


@dataclass
class Learned:
    """What a fit found. `scene` holds the learned parameters; `history` a row per iteration; `identified` is None for
    fields (see `fields`), which have too many parameters for one information matrix."""

    scene: Scene
    x: np.ndarray
    loss: float
    labels: list[str]
    history: list[dict[str, Any]]
    stopped: str
    gradient_check: GradientCheck
    density: Density
    identified: Identified | None
    domains: dict[str, dict[str, float]]
    train: dict[str, float]
    test: dict[str, float] | None
    problem: FitProblem


def learn(
    scene: Scene,
    *,
    device: str | None = None,
    options: LearnOptions | None = None,
    folder: Path | str | None = None,
    resume: bool = False,
) -> Learned:
    """Fit the materials' learnable parameters, and the declared effects', to the `train` views.

    With `folder` the run keeps a checkpoint there, and `resume` goes on from it. Of several processes (`distributed`)
    each holds a share of the views; all return the same, and the first one writes. Raises InputError for scenes that
    cannot be learned from, and WarpsarError where the gradient check fails.
    """
    options = options or LearnOptions()
    _refuse_starts(scene)
    where = devices.resolve_device(device)
    ranks = distributed.ranks(where)
    folder = None if folder is None else Path(folder)
    if folder is not None and ranks.first and distributed.restarts() == 0 and not resume:
        checkpoint.remove(folder)  # of an earlier run: torchrun's restarts shall find this one's
    problem, density = ranks.agree(lambda: prepare(scene, where, options, ranks))
    if not problem.x0.size:
        raise InputError(f"{scene.path}: materials: nothing to learn: every `learn` is empty and no effect is declared")
    _refuse_options(problem, options)
    check = check_gradient(problem, problem.x0)
    console.say(
        f"gradient check: adjoint against central differences agree to {check.worst:.1e} "
        f"over {check.directions} directions"
    )
    if not check.passed:
        raise WarpsarError(
            f"{scene.path}: the gradient check failed: {check.worst:.2g} off, over the allowed 2e-2; more rays, or a "
            f"start further inside the bounds, may help"
        )
    tests = ranks.agree(lambda: _test_problem(scene, where, options, problem, density))
    tag = _tag(scene, options)
    source = folder if resume and ranks.first else None
    stored = ranks.hand_out(ranks.agree(lambda: None if source is None else checkpoint.read(source, tag)))
    if resume and stored is None:
        console.say("--resume: there is no checkpoint; the run starts afresh")
    state, history, stopped = _iterate(problem, tests, options, folder, tag, stored)
    x = np.asarray(state.best_x)
    train = pooled_metrics(problem, x)
    final = learned_scene(problem, x, folder if ranks.first else None)
    return Learned(
        scene=final,
        x=x,
        loss=state.best_loss,
        labels=problem.labels if x.size < 1000 else [],
        history=history,
        stopped=stopped,
        gradient_check=check,
        density=density,
        identified=identify(problem, x) if problem.uniform else None,
        domains=outside_domains(problem, x),
        train=train,
        test=None if tests is None else pooled_metrics(tests, tests.follow(problem, x)),
        problem=problem,
    )


def prepare(
    scene: Scene, device: Any, options: LearnOptions, ranks: Ranks = distributed.ONE
) -> tuple[FitProblem, Density]:
    """The fit problem of the train views, with as many rays as the looks of the images ask for."""
    stage = Stage.of(scene, device)
    views = [v for v in scene.views if v.role == "train" and v.images]
    density = choose_density(scene, stage, views, [looks_of(scene, v) for v in views], RAY_NOISE, ranks=ranks)
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
        ranks=ranks,
        max_memory_gib=options.max_memory_gib,
    )
    for name, seen in _of_all(problem, _described).items():
        if seen["estimated"]:
            console.say(f"looks of {name}: not declared, estimated as {seen['looks']:.1f}")
        if seen["zeros"]:
            console.say(f"{name}: {seen['zeros']} lit pixels measure 0 and are left out")
    return problem, density


def _described(seen: Observation) -> dict[str, Any]:
    return {
        "looks": seen.looks,
        "estimated": seen.looks_estimated,
        "used": int(seen.interior.sum()),
        "left_out": seen.left_out,
        "zeros": seen.zeros,
    }


def _of_all(problem: FitProblem, about: Callable[[Observation], Any]) -> dict[str, Any]:
    """What there is to say (JSON's types) about every observation of all ranks, by "view polarization", in order."""
    mine = [[s.view.name, s.polarization, about(s)] for s in problem.observations]
    order = [view.name for view in problem.chosen]
    found = sorted((each for part in problem.ranks.gather(mine) for each in part), key=lambda one: order.index(one[0]))
    return {f"{view} {polarization}": what for view, polarization, what in found}


def _test_problem(
    scene: Scene, device: Any, options: LearnOptions, problem: FitProblem, density: Density
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
        ranks=problem.ranks,
        max_memory_gib=options.max_memory_gib,
    )


def pooled_metrics(problem: FitProblem, x: np.ndarray | DeviceX) -> dict[str, float]:
    """Metrics of scene-format.md over all observations' interior pixels, each weighted by its pixels."""
    observations = problem.observations
    if isinstance(x, DeviceX) and problem.scene.grid.calibrated:
        moments = problem.moments(x)
        parts = [metrics_of(sums, seen.count, seen.looks) for seen, sums in zip(observations, moments, strict=True)]
    else:
        modelled = problem.modelled(x)
        pairs = zip(observations, modelled, problem.gains(modelled), strict=True)
        parts = [metrics(seen.values, gain * mu, seen.looks) for seen, mu, gain in pairs]
    total = np.zeros(len(METRICS) + 1)
    for seen, found in zip(observations, parts, strict=True):
        total += seen.count * np.array([*(found[key] for key in METRICS), 1.0])
    *sums, count = problem.ranks.sum(total)
    return {key: float(value / count) for key, value in zip(METRICS, sums, strict=True)}


def _refuse_starts(scene: Scene) -> None:
    """Starts that a fit cannot leave or may not keep: outside the bounds, where eps_r = 1 and tau = 0 or 1 lie, whose
    derivatives are exactly 0."""
    surface = Surface.of(scene)
    for block in surface.blocks:
        kind = block.kind
        values = kind.from_coordinate(surface.nodes[block.start : block.stop])
        bad = values[~((values >= kind.low * (1 - 1e-6)) & (values <= kind.high * (1 + 1e-6)))]
        if not block.learn or not bad.size:
            continue
        why = {
            "eps_r": "; at 1, sigma0 and all its derivatives are 0 (a dead point), and near it they are too small",
            "specular_fraction": "; at 0 and 1 its logit is infinite, and every derivative to it 0",
        }.get(kind.key, "")
        raise InputError(
            f"{scene.path}: materials.{block.material}.{kind.key}: found a start at {bad[0]:g}; to be learned it must "
            f"be from {kind.low:g} to {kind.high:g}{why}"
        )


def _refuse_options(problem: FitProblem, options: LearnOptions) -> None:
    """Options that would do nothing, or nothing sensible, to what is learned here."""
    if options.optimiser == "lm" and not problem.uniform:
        raise InputError("--optimiser: found lm, and a field to learn; allowed for fields is adam")
    fields = {block.kind.key for block in problem.surface.blocks if block.learn and block.size > 1}
    for key, weight in options.total_variation.items():
        if weight > 0 and key not in fields:
            known = ", ".join(sorted(fields)) or "none: no field is learned"
            raise InputError(f"--tv: found {key}, of which no field (texture or vertex) is learned; allowed: {known}")


def _tag(scene: Scene, options: LearnOptions) -> str:
    """What a checkpoint belongs to: input and options, but for those that only say when to stop, or where hits are."""
    free = ("iterations", "max_time_s", "checkpoint_every", "max_memory_gib")
    chosen = {k: v for k, v in asdict(options).items() if k not in free}
    # a scene made in memory has no text for the hash to hold
    made = "" if scene.source else repr((scene.radar, scene.grid, scene.sampling, scene.materials, scene.effects))
    return hashlib.sha256((scene.input_hash + made + json.dumps(chosen, sort_keys=True)).encode()).hexdigest()


def _steps(problem: FitProblem, options: LearnOptions, state: FitState | None) -> Iterator[FitState]:
    """States of the whole run, one per iteration, from `state` on; ends when every start has arrived."""
    kind = options.optimiser
    if kind == "auto":
        kind = "lm" if problem.uniform else "adam"
    starts = options.starts if kind == "lm" else 1
    state = state or begin(problem, 0, options.seed)
    while True:
        if kind == "lm":
            while not state.arrived and state.since_start < 100:
                state = levenberg_marquardt(problem, state)
                yield state
        else:
            graph = problem.shared_nodes is not None and not problem.effect_coordinates and problem.keeps_hits
            descent = (GraphAdam if graph and problem.scene.grid.calibrated else Adam)(problem, state, options.rate)
            while not state.arrived:
                state = descent.step(state)
                yield state
        if state.start + 1 >= starts:
            return
        state = begin(problem, state.start + 1, options.seed, state)


def _iterate(
    problem: FitProblem,
    tests: FitProblem | None,
    options: LearnOptions,
    folder: Path | None,
    tag: str,
    stored: dict[str, np.ndarray] | None,
) -> tuple[FitState, list[dict[str, Any]], str]:
    """Run to the end, with checkpoints; returns the last state, the history and why it stopped."""
    ranks = problem.ranks
    history: list[dict[str, Any]] = [] if stored is None else json.loads(str(stored.pop("history")))
    spent = 0.0 if stored is None else float(stored.pop("spent_s"))
    state = None if stored is None else FitState.from_arrays(stored)
    started = time.perf_counter() - spent
    stopped = "plateau"
    interrupted: list[int] = []
    previous = None
    if folder is not None and hasattr(signal, "SIGTERM"):
        try:
            previous = signal.signal(signal.SIGTERM, lambda number, frame: interrupted.append(number))
        except ValueError:  # not the main thread: whoever runs it keeps the signal
            previous = None
    bar = console.progress(options.iterations, "learn")
    bar.update(state.iteration if state else 0)

    def save(now: FitState) -> None:
        if folder is not None and ranks.first:
            extra = {
                "history": np.array(json.dumps(history)),
                "spent_s": np.array(time.perf_counter() - started),
            }
            checkpoint.write(folder, {**now.arrays(), **extra}, tag)

    steps = _steps(problem, options, state)
    try:
        while state is None or state.iteration < options.iterations:
            now = next(steps, None)
            if now is None:
                break
            state = now
            row = {"iteration": state.iteration, "start": state.start, "loss": state.loss}
            row |= {f"train_{k}": v for k, v in pooled_metrics(problem, state.x).items()}
            if tests is not None:
                followed = tests.follow(problem, state.x)
                row |= {f"test_{k}": v for k, v in pooled_metrics(tests, followed).items()}
            history.append(row)
            bar.update(state.iteration - bar.n)
            bar.set_postfix_str(f"loss {state.loss:.6g}", refresh=False)
            # a signal, and a second more or less, reach the ranks at different iterations
            asked = ranks.largest(float(bool(interrupted)))
            late = ranks.largest(time.perf_counter() - started) > options.max_time_s
            if asked:
                save(state)
                refusal = WarpsarError(f"stopped by a signal at iteration {state.iteration}; go on with --resume")
                refusal.quiet = not ranks.first
                raise refusal
            if late:
                stopped = "time"
                break
            if len(history) % options.checkpoint_every == 0:
                save(state)
        else:
            stopped = "iterations"
    finally:
        bar.close()
        if previous is not None:
            signal.signal(signal.SIGTERM, previous)
    assert state is not None
    save(state)
    return state, history, stopped


def run(
    scene_path: Path | str,
    out: Path | str,
    *,
    device: str | None = None,
    options: LearnOptions | None = None,
    resume: bool = False,
) -> dict[str, Any]:
    """`warpsar learn`: scene.toml with what was learned, history.csv, learn.json and figures in `out`."""
    started = time.perf_counter()
    options = options or LearnOptions()
    scene, out, where = opened(scene_path, out, device)
    resume = resume or bool(distributed.restarts())
    found = learn(scene, device=where.alias, options=options, folder=out, resume=resume)
    ranks = found.problem.ranks
    if ranks.first:
        found.scene.save(out / "scene.toml")
        with replacing(out / "history.csv") as temporary, temporary.open("w", newline="") as stream:
            writer = csv.DictWriter(stream, list(found.history[0]))
            writer.writeheader()
            writer.writerows(found.history)
        convergence(out / "convergence.png", found.history)
    described = _of_all(found.problem, _described)
    content = {
        "options": asdict(options),
        "rays_per_pixel": found.density.rays_per_pixel,
        "rays_chosen": found.density.chosen,
        "ray_noise": found.density.noise,
        "gradient_check": {"worst": found.gradient_check.worst, "directions": found.gradient_check.directions},
        "loss": found.loss,
        "iterations": found.history[-1]["iteration"],
        "stopped": found.stopped,
        "train": found.train,
        "test": found.test,
        "materials": _material_summary(found),
        "effects": found.scene.effects,
        "outside_domain": found.domains,
        "looks": {name: {key: seen[key] for key in ("looks", "estimated")} for name, seen in described.items()},
        "pixels": {name: {key: seen[key] for key in ("used", "left_out", "zeros")} for name, seen in described.items()},
        "processes": ranks.size,
    }
    if not scene.grid.calibrated:
        modelled = found.problem.modelled(found.x)
        pairs = zip(found.problem.observations, modelled, strict=True)
        gains = {(s.view.name, s.polarization): found.problem.misfit.gain(s, mu) for s, mu in pairs}
        content["gains"] = _of_all(found.problem, lambda s: gains[s.view.name, s.polarization])
    if found.identified is not None:
        content["identifiability"] = found.identified.summary()
        for sentence in found.identified.words:
            console.say(sentence)
    else:
        content["fields"] = write_field_uncertainty(found.problem, found.x, out)
    ranks.barrier()  # a rank that dies from here on takes no result with it
    if not ranks.first:
        return content
    content = write_json(out / "learn.json", scene, where, options.seed, started, content)
    checkpoint.remove(out)
    print(
        f"train deviance {found.train['deviance']:.4f}"
        + ("" if found.test is None else f", test deviance {found.test['deviance']:.4f}"),
        file=sys.stdout,
    )
    return content


def _material_summary(found: Learned) -> dict[str, dict[str, Any]]:
    """Learned value of every parameter, and its 95 % interval where it is a single number."""
    problem = found.problem
    nodes = problem.nodes(found.x)
    at = 0
    summary: dict[str, dict[str, Any]] = {}
    for block in problem.surface.blocks:
        values = problem.surface.values(block.material, block.kind.key, nodes)
        entry: dict[str, Any] = {"learned": block.learn, "layout": block.layout}
        if block.size == 1:
            entry["value"] = float(values.ravel()[0])
        else:
            entry |= {"median": float(np.median(values)), "low": float(values.min()), "high": float(values.max())}
        if block.learn:
            if found.identified is not None:
                sd = float(found.identified.sd[at])
                centre = float(nodes[block.start])
                ends = block.kind.from_coordinate(np.array([centre - 1.96 * sd, centre + 1.96 * sd]))
                entry["interval_95"] = [float(e) for e in ends]
                entry["sd_log"] = sd
            at += block.size
        summary.setdefault(block.material, {})[block.kind.key] = entry
    return summary
