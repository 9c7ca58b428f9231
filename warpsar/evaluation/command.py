"""How well a scene explains its measured images: metrics, residual images and files of `warpsar evaluate`."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warpsar.curves import command as curve_command
from warpsar.effects.registry import declared, get
from warpsar.errors import InputError
from warpsar.evaluation.collected import collected
from warpsar.evaluation.image import EvaluatedImage, Evaluation
from warpsar.evaluation.meshview import write_learned_ply
from warpsar.evaluation.metrics import image_metrics, nuisance_floor, pool
from warpsar.evaluation.report import write_report
from warpsar.evaluation.report_images import residual_picture
from warpsar.evaluation.residuals import expected_db, profiles
from warpsar.io.images import replacing, write_exr
from warpsar.learning.observation import looks_of, observe
from warpsar.learning.verdict import Verdict, verdict
from warpsar.render.render import ViewRender
from warpsar.runtime import console, devices, distributed
from warpsar.runtime.distributed import Ranks
from warpsar.scene.scene import Scene
from warpsar.simulation.outputs import make_folder, write_json
from warpsar.simulation.rays import hit_grid, trace_view, view_seed
from warpsar.simulation.sampling import RAY_NOISE, choose_density
from warpsar.speckle.likelihood import best_gain
from warpsar.surface.samples import image_pixels
from warpsar.surface.stage import Stage
from warpsar.trace.rays import ray_count
from warpsar.world.tables import View
from warpsar.world.world import geometry_of


def evaluate(scene: Scene, *, device: str | None = None, seed: int | None = None) -> Evaluation:
    """Compare every measured image of the scene, of all roles, with the declared model; nothing is fitted but one
    gain per image where the images are not calibrated, and the floor of `deviance_all`.

    The model is the mean of two renders from independent rays, whose difference is its sampling noise. `seed` overrides
    the scene's. Several processes (`distributed`) share the views; all of them are in what the first one returns, none
    in what the others do. Raises InputError for a scene without measured images, or where image and mesh do not meet.
    """
    where = devices.resolve_device(device)
    ranks = distributed.ranks(where)
    return _joined(scene, *_evaluated(scene, where, scene.sampling.seed if seed is None else seed, ranks), ranks)


def _evaluated(scene: Scene, device: wp.Device, seed: int, ranks: Ranks) -> tuple[list[EvaluatedImage], float]:
    """This rank's images, dealt by their rays, and the rays per square metre."""
    views = [(index, view) for index, view in enumerate(scene.views) if view.images]
    if not views:
        raise InputError(f"{scene.name}: views: found none with measured images; evaluate needs `images` in a view")
    stage = Stage.of(scene, device)
    # Image effects only lower the noise of what is lit, but spread light where next to none is left to measure it on.
    plain = replace(scene, effects={name: t for name, t in scene.effects.items() if get(name).stage != "image"})
    looks = [looks_of(scene, view) for _, view in views]
    density = ranks.agree(
        lambda: choose_density(plain, stage, [view for _, view in views], looks, RAY_NOISE, ranks=ranks)
    ).rays_per_m2
    grid = hit_grid(scene)
    costs = [ray_count(stage.target, geometry_of(scene, view), grid, density) * len(view.images) for _, view in views]
    mine = distributed.deal(costs, ranks.size)[ranks.rank]
    bar = console.progress(len(mine), "evaluate", "view")

    def images() -> list[EvaluatedImage]:
        found = []
        for index, view in (views[i] for i in mine):
            found += _evaluate_view(scene, stage, view, index, seed, density)
            bar.update()
        return found

    found = ranks.agree(images)
    bar.close()
    return found, density


def _joined(scene: Scene, images: list[EvaluatedImage], density: float, ranks: Ranks) -> Evaluation:
    """The images of all ranks in the order of the views, with what they give together; on the first rank alone."""
    if ranks.size > 1:
        images = collected(scene, images, ranks)
    pooled = {role: pool([i for i in images if i.view.role == role]) for role in ("train", "test")}
    return Evaluation(images, pooled["train"], pooled["test"], density, _verdicts(scene, images))


def _verdicts(scene: Scene, images: list[EvaluatedImage]) -> dict[str, Verdict]:
    """Whether anything is left beside speckle, by role."""
    found = {}
    for role in ("train", "test"):
        mine = [image for image in images if image.view.role == role]
        if mine:
            noise = max(image.sampling_noise for image in mine)
            found[role] = verdict(scene, [(image.observation, image.simulated) for image in mine], noise)
    return found


def _evaluate_view(
    scene: Scene, stage: Stage, view: View, index: int, seed: int, rays_per_m2: float
) -> list[EvaluatedImage]:
    shape, effects = scene.grid.shape, declared(scene, view)
    # Masks are those of the surface's own light: a floor, a blur or a second bounce must not widen them.
    own = [e for e in effects if e.effect.stage not in ("path", "image")]
    seeds = (view_seed(seed, index), view_seed(seed + 1, index + len(scene.views)))
    pair, lit = [], dict.fromkeys(view.images, np.zeros(shape, bool))
    for one in seeds:
        hits = trace_view(scene, stage, view, seed=one, effects=effects, rays_per_m2=rays_per_m2)
        render = ViewRender(stage, view, hits, shape, tuple(view.images), effects)
        pair.append(render.forward())
        alone = pair[-1]
        if len(own) < len(effects):
            alone = ViewRender(stage, view, hits, shape, tuple(view.images), own).forward()
        lit = {pol: lit[pol] | (alone[pol] > 0) for pol in lit}
    mask = scene.mask(view)
    grid = hit_grid(scene)
    axes = [a + (np.arange(n) + 0.5) * s for a, n, s in zip(grid.start_m, shape, grid.spacing_m, strict=True)]
    found = []
    for pol in view.images:
        first, second = (images[pol].astype(float) for images in pair)
        mean = (first + second) / 2.0
        seen = observe(scene, view, pol, lit[pol] & (mean > 0))
        mu = mean[seen.interior]
        noise = seen.looks * float(np.mean(((first - second)[seen.interior] / 2.0 / mu) ** 2))
        gain = 1.0 if scene.grid.calibrated else best_gain("gamma", seen.values, mu, seen.looks)
        valid = np.isfinite(seen.measured) & (np.nan_to_num(seen.measured) > 0)
        if mask is not None:
            valid &= mask
        incidence, material = _surface_in_pixels(scene, render, pol)
        floor = nuisance_floor(seen.measured[valid].astype(float), gain * mean[valid])
        image = EvaluatedImage(
            observation=seen,
            simulated=gain * mean,
            valid=valid,
            gain=gain,
            floor=floor,
            incidence_deg=incidence,
            material=material,
            range_m=axes[0],
            azimuth_m=axes[1],
            sampling_noise=noise,
            metrics=image_metrics(seen, gain * mean, valid, floor),
        )
        found.append(image)
    return found


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


def _stem(image: EvaluatedImage) -> str:
    return f"{image.view.name}_{image.polarization}_residual"


def _write_residual(out: Path, image: EvaluatedImage) -> None:
    """EXR and PNG of one image's residual."""
    planes = {"measured": image.measured, "simulated": image.simulated, "ratio_db": image.ratio_db}
    write_exr(out / f"{_stem(image)}.exr", planes)
    with replacing(out / f"{_stem(image)}.png") as temporary:
        temporary.write_bytes(residual_picture(image))


def _say_what_was_fitted(image: EvaluatedImage, calibrated: bool) -> None:
    seen = image.observation
    if seen.looks_estimated:
        console.say(f"looks of {image.view.name} {image.polarization}: not declared, estimated as {seen.looks:.1f}")
    if not calibrated:
        console.say(f"gain of {image.view.name} {image.polarization}: not calibrated, fitted as {image.gain:.4g}")


def _say_verdicts(verdicts: dict[str, Verdict], scene_path: Path | str) -> None:
    for role, one in verdicts.items():
        console.say(f"{role} views: {one.words}")
    if any(one.wrong for one in verdicts.values()):
        console.say(f"next: warpsar diagnose {scene_path} -o diagnosed/ names what the model lacks")


def _view(image: EvaluatedImage, calibrated: bool) -> dict[str, Any]:
    """One image's entry in evaluate.json."""
    seen, stem = image.observation, _stem(image)
    return {
        "name": image.view.name,
        "role": image.view.role,
        "polarization": image.polarization,
        **image.metrics,
        "looks": seen.looks,
        "looks_estimated": seen.looks_estimated,
        "gain": image.gain,
        "gain_fitted": not calibrated,
        "sampling_noise": image.sampling_noise,
        "files": {"exr": f"{stem}.exr", "png": f"{stem}.png"},
    }


def compared(scene: Scene, before: Scene) -> None:
    """Raises InputError unless both scenes explain the same images: views, polarizations and pixels."""
    names = [[(view.name, pol) for view in one.views for pol in view.images] for one in (scene, before)]
    if names[0] != names[1]:
        raise InputError(
            f"{before.name}: found images {_listed(names[1])}; must be those of {scene.name}: {_listed(names[0])}"
        )
    if scene.grid.shape != before.grid.shape:
        raise InputError(
            f"{before.name}: image.shape: found {before.grid.shape}; must be that of {scene.name}: {scene.grid.shape}"
        )


def _listed(images: Sequence[tuple[str, str]]) -> str:
    return ", ".join(f"{name} {pol}" for name, pol in images) or "none"


def run(
    scene_path: Path | str,
    out: Path | str,
    *,
    before: Path | str | None = None,
    device: str | None = None,
    seed: int | None = None,
) -> dict[str, Any]:
    """`warpsar evaluate`: evaluate.json, residual images (EXR, PNG), learned.ply and report.html in `out`. Returns the
    JSON's content. `before` is a scene file of the same images: the report compares the two models. Of several
    processes (`distributed`) each writes the residual images of its views, the first one the rest; the others return
    nothing."""
    started = time.perf_counter()
    scene = Scene.load(scene_path)
    first = None if before is None else Scene.load(before)
    if first is not None:
        compared(scene, first)
    out = Path(out)
    make_folder(out)
    where = devices.resolve_device(device)
    ranks = distributed.ranks(where)
    console.say_device(where)
    console.warn(scene.warnings)
    seed = scene.sampling.seed if seed is None else seed
    of_curves = curve_command.evaluated(scene, out / "cache", where.alias) if scene.curves and ranks.first else {}
    if of_curves and not any(view.images for view in scene.views):
        console.say(curve_command.in_short(of_curves["curves"]))
        return write_json(out / "evaluate.json", scene, where, seed, started, of_curves)
    mine, density = _evaluated(scene, where, seed, ranks)
    for image in mine:
        _write_residual(out, image)
    found = _joined(scene, mine, density, ranks)
    earlier = None if first is None else _joined(first, *_evaluated(first, where, seed, ranks), ranks)
    if not ranks.first:
        return {}
    _say_verdicts(found.verdicts, scene_path)
    for image in found.images:
        _say_what_was_fitted(image, scene.grid.calibrated)
    write_learned_ply(out / "learned.ply", scene)
    by_factor, expected = profiles(found.images, scene.mesh.materials), expected_db(found.images)
    content = {
        "verdict": {role: one.content() for role, one in found.verdicts.items()},
        "rays_per_pixel": found.rays_per_m2 * scene.grid.pixel_area_m2,
        "calibrated": scene.grid.calibrated,
        "processes": ranks.size,
        "views": [_view(image, scene.grid.calibrated) for image in found.images],
        "train": found.train,
        "test": found.test,
        "residuals_db": {name: profile.rows for name, profile in by_factor.items()},
        "expected_residual_db": expected,
        **({} if earlier is None else {"before": {"train": earlier.train, "test": earlier.test}}),
        **of_curves,
    }
    content = write_json(out / "evaluate.json", scene, where, seed, started, content)
    command = ["warpsar", "evaluate", str(scene_path), "-o", str(out), "--device", where.alias, "--seed", str(seed)]
    command += [] if before is None else ["--before", str(before)]
    write_report(out / "report.html", scene, found, by_factor, expected, content, command, where, before=earlier)
    console.say_written(out, "report.html", "evaluate.json", "learned.ply", "residual images")
    pooled = [(role, found_in) for role, found_in in (("train", found.train), ("test", found.test)) if found_in]
    words = [f"{role} deviance {m['deviance']:.4f} +- {m['deviance_error']:.4f}" for role, m in pooled]
    print(", ".join(words), file=sys.stdout)
    return content
