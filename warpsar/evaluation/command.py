"""How well a scene explains its measured images: metrics, residual images and files of `warpsar evaluate`."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from os import PathLike
from pathlib import Path
from typing import Any

import warp as wp

from warpsar.coherent.left_out import left_out_warning
from warpsar.compare.aim import stated_aims, unaimed, with_aims
from warpsar.compare.comparison import Comparison
from warpsar.compare.contract import Verdict
from warpsar.compare.curve import errors_in_short
from warpsar.compare.evaluation import Evaluation, curves_content, evaluated
from warpsar.compare.laid import beside_means
from warpsar.compare.prediction import (
    PredictedImage,
    advantage,
    predictable,
    predictions,
    summaries,
)
from warpsar.errors import InputError
from warpsar.evaluation.meshview import write_learned_ply
from warpsar.evaluation.report import write_report
from warpsar.evaluation.report_curves import write_curves_report
from warpsar.evaluation.report_images import residual_picture
from warpsar.evaluation.residuals import expected_db, profiles
from warpsar.io.images import replacing, write_exr
from warpsar.runtime import console, devices, once
from warpsar.scene.scene import Scene, scene_or_file
from warpsar.simulation.outputs import make_folder, write_json


def evaluate(scene: Scene | PathLike[str] | str, *, device: str | None = None, seed: int | None = None) -> Evaluation:
    """Compare every measured image and curve of the scene, of all roles, with the declared model; nothing is fitted but
    one gain per image where the images are not calibrated, the floor of `deviance_all`, and the noise of curves.

    Areas are exact where the scene is not too large for it. What rays sample is the mean of two renders from
    independent rays, whose difference is its sampling noise. `seed` overrides the scene's. Several processes share
    the views; the first one returns all images, the others none. Raises InputError for a scene without measured
    images and curves, or where image and mesh do not meet.
    """
    scene = scene_or_file(scene)
    return evaluated(scene, devices.resolve_device(device), seed=seed, progress="evaluate")


def _stem(image: Comparison) -> str:
    return f"{image.view.name}_{image.polarization}_residual"


def _write_residual(out: Path, image: Comparison) -> None:
    """EXR and PNG of one image's residual."""
    planes = {"measured": image.measured, "simulated": image.simulated, "ratio_db": image.ratio_db}
    write_exr(out / f"{_stem(image)}.exr", planes)
    with replacing(out / f"{_stem(image)}.png") as temporary:
        temporary.write_bytes(residual_picture(image))


def _say_what_was_fitted(image: Comparison, calibrated: bool) -> None:
    seen = image.seen
    if seen.looks_estimated:
        console.say(f"looks of {image.view.name} {image.polarization}: not declared, estimated as {seen.looks:.1f}")
    if not calibrated:
        console.say(f"gain of {image.view.name} {image.polarization}: not calibrated, fitted as {image.gain:.4g}")


def _say_verdicts(verdicts: Mapping[str, Verdict], scene_path: Path | str, of: str = "views") -> None:
    for role, one in verdicts.items():
        console.say(f"{role} {of}: {one.words}")
    if any(one.wrong for one in verdicts.values()):
        console.say(f"next: warpsar diagnose {scene_path} -o diagnosed/ names what the model lacks")


def _view(image: Comparison, calibrated: bool) -> dict[str, Any]:
    """One image's entry in evaluate.json."""
    seen, stem = image.seen, _stem(image)
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
    processes each writes the residual images of its views, the first one the rest; the others return nothing."""
    started = time.perf_counter()
    scene = Scene.load(scene_path)
    first = None if before is None else Scene.load(before)
    if first is not None:
        compared(scene, first)
    out = Path(out)
    make_folder(out)
    where = devices.resolve_device(device)
    once.join(where)
    console.say_device(where)
    console.warn(scene.warnings)
    seed = scene.seed(seed)
    cache = out / "cache"
    predicted: list[PredictedImage] = []
    if predictable(scene):
        predicted = once.agree(lambda: _predicted(scene, first, where))
        scene = _aimed(scene, predicted, "model")
        first = None if first is None else _aimed(first, predicted, "before")
    console.warn(unaimed(scene))
    found = evaluated(scene, where, seed=seed, progress="evaluate", cache=cache)
    for image in found.own:
        _write_residual(out, image)
    earlier = None if first is None else evaluated(first, where, seed=seed, progress="evaluate before", cache=cache)
    processes = once.processes()
    command = ["warpsar", "evaluate", str(scene_path), "-o", str(out), "--device", where.alias, "--seed", str(seed)]
    command += [] if before is None else ["--before", str(before)]

    def write_curves() -> dict[str, Any]:
        content = write_json(out / "evaluate.json", scene, where, seed, started, curves_content(scene, found))
        title = f"How well {Path(scene_path).name} explains its measured curves"
        predicted = [] if earlier is None else earlier.curves
        verdicts, beside = found.curve_verdicts, "evaluate.json (all numbers)"
        page = out / "report.html"
        write_curves_report(page, title, found.curves, verdicts, content, command, before=predicted, beside=beside)
        console.say_written(out, "report.html", "evaluate.json")
        print(errors_in_short(found.curves), file=sys.stdout)
        return content

    def write() -> dict[str, Any]:
        if found.curves:
            console.warn(left_out_warning(scene, "a curve"))
            _say_verdicts(found.curve_verdicts, scene_path, "curves")
        if not scene.has_images:
            return write_curves()
        _say_verdicts(found.verdicts, scene_path)
        for image in found.images:
            _say_what_was_fitted(image, scene.grid.calibrated)
        models = {"model": found.images} | ({} if earlier is None else {"before": earlier.images})
        laid = [] if predicted else beside_means(scene, models)
        for one in laid:
            console.say(one.words)
        write_learned_ply(out / "learned.ply", scene)
        by_factor, expected = profiles(found.images, scene.mesh.materials), expected_db(found.images)
        content = {
            "verdict": {role: one.content() for role, one in found.verdicts.items()},
            "rays_per_pixel": found.rays_per_m2 * scene.grid.pixel_area_m2,
            "calibrated": scene.grid.calibrated,
            "processes": processes,
            "views": [_view(image, scene.grid.calibrated) for image in found.images],
            "train": found.train,
            "test": found.test,
            "residuals_db": {name: profile.rows for name, profile in by_factor.items()},
            "expected_residual_db": expected,
            **({} if earlier is None else {"before": {"train": earlier.train, "test": earlier.test}}),
            **({"prediction": _prediction_content(predicted)} if predicted else {}),
            **({"beside_means": [asdict(one) for one in laid]} if laid else {}),
            **(curves_content(scene, found) if found.curves else {}),
        }
        content = write_json(out / "evaluate.json", scene, where, seed, started, content)
        write_report(
            out / "report.html",
            scene,
            found,
            by_factor,
            expected,
            content,
            command,
            where,
            before=earlier,
            predicted=predicted,
            laid=laid,
        )
        console.say_written(out, "report.html", "evaluate.json", "learned.ply", "residual images")
        pooled = [(role, found_in) for role, found_in in (("train", found.train), ("test", found.test)) if found_in]
        words = [f"{role} deviance {m['deviance']:.4f} +- {m['deviance_error']:.4f}" for role, m in pooled]
        print(", ".join([*words, *_prediction_words(predicted)]), file=sys.stdout)
        return content

    return once.write(write) or {}


def _predicted(scene: Scene, first: Scene | None, device: wp.Device) -> list[PredictedImage]:
    """The test views beside what the models predict and beside measured rivals."""
    scenes = {"model": scene} | ({} if first is None else {"before": first})
    tests = sum(len(view.images) for view in scene.views if view.role == "test")
    bar = console.progress(tests, "predict", "image")
    found = predictions(scenes, device, bar.update)
    bar.close()
    ahead = advantage(found)
    if ahead is not None:
        console.say(ahead.words)
    return found


def _aimed(scene: Scene, predicted: Sequence[PredictedImage], name: str) -> Scene:
    """The scene with the aim points of the test views that state none, as a model's own likelihood has them."""
    stated = stated_aims(scene)
    shifts = {image.view.name: image.predictions[name].at for image in predicted if image.view.name not in stated}
    return with_aims(scene, shifts)


def _prediction_content(predicted: Sequence[PredictedImage]) -> dict[str, Any]:
    """What evaluate.json says of the prediction of test views."""
    ahead = advantage(predicted)
    return {
        "lead": None if ahead is None else {**asdict(ahead), "ahead": ahead.ahead, "words": ahead.words},
        "means": [asdict(row) for row in summaries(predicted)],
        "images": [
            {
                "name": image.view.name,
                "polarization": image.polarization,
                "azimuth_deg": image.view.azimuth_deg,
                "incidence_deg": image.view.incidence_deg,
                "in_sector": image.in_sector,
                "predictions": {name: asdict(one) for name, one in image.predictions.items()},
            }
            for image in predicted
        ],
    }


def _prediction_words(predicted: Sequence[PredictedImage]) -> list[str]:
    """The correlation of the model, in each set and at each incidence."""
    return [
        f"{'unseen sectors' if row.in_sector else 'between train views'} at {90.0 - row.incidence_deg:.1f} deg of "
        f"depression: correlation {row.correlation:.3f}"
        for row in summaries(predicted)
        if row.prediction == "model"
    ]
