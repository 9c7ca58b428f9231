"""report.html of `warpsar evaluate`: pictures, tables and words, for a reader who has nothing else."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.errors import InputError
from warpsar.evaluation.image import EvaluatedImage, Evaluation, ratio_db
from warpsar.evaluation.meshview import MeshView, look
from warpsar.evaluation.residuals import Profile, profile_figure
from warpsar.io import html as report
from warpsar.io.figures import new
from warpsar.learning.identify import Identified, identify
from warpsar.learning.problem import FitProblem
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.surface.surface import KINDS, Kind

if TYPE_CHECKING:
    from matplotlib.figure import Figure


RESIDUAL_COLOURS = "RdBu_r"
PICTURE_PIXELS = 1.5e6  # of all pictures of images together: the file stays under some 5 MB
SIDES_DEG = ((205.0, 55.0), (25.0, 55.0))  # azimuth and incidence of the two looks at the mesh: askew to the compass
UNITS = {"eps_r": ("eps_r", 1.0), "rms_height_m": ("h [mm]", 1e3), "correlation_length_m": ("l [mm]", 1e3)}


def write_report(
    path: Path,
    scene: Scene,
    found: Evaluation,
    by_factor: dict[str, Profile],
    content: dict[str, Any],
    command: Sequence[str],
    device: Any,
) -> None:
    """`content` is that of evaluate.json, `command` the words that made it."""
    stage = Stage.of(scene, device)
    identified, words = _identified(scene, stage, found.rays_per_m2)
    title = f"How well {Path(scene.path or 'the scene').name} explains its measured images"
    lead = (
        f"warpsar {content['version']} evaluate; {len(found.images)} images of {scene.grid.shape[0]} x "
        f"{scene.grid.shape[1]} pixels, {content['rays_per_pixel']:.3g} rays per pixel, on {content['device']}"
    )
    sections = [
        _summary(scene, found),
        _images(scene, found),
        _residuals(by_factor, content["expected_residual_db"]),
        _parameters(scene, stage, identified),
        report.section("What is not identifiable", *words),
        *_convergence(Path(scene.path).parent if scene.path else None),
        report.reproduce(
            content,
            command,
            "Beside this file: evaluate.json (all numbers), residual images as EXR and PNG, learned.ply.",
        ),
    ]
    report.write(path, report.page(title, lead, *sections))


# Numbers


def _pm(metrics: dict[str, Any], key: str) -> str:
    """A deviance and its standard error, to the digits that mean something."""
    value, error = metrics[key], metrics[f"{key}_error"]
    digits = int(np.clip(1 - np.floor(np.log10(max(error, 1e-6))), 0, 4))
    return f"{value:.{digits}f} ±\u00a0{error:.{digits}f}"


METRICS = (
    "deviance",
    "deviance, all pixels",
    "rmse [dB]",
    "nrmse",
    "rmse [beta0]",
    "correlation",
    "pixels",
    "left out",
)


def _metric_cells(m: dict[str, Any]) -> list[str]:
    return [
        _pm(m, "deviance"),
        _pm(m, "deviance_all"),
        f"{m['rmse_db']:.2f}",
        f"{m['nrmse']:.3f}",
        f"{m['rmse']:.3g}",
        f"{m['correlation']:.3f}",
        f"{m['pixels']:,}",
        f"{m['left_out']:,}",
    ]


def _summary(scene: Scene, found: Evaluation) -> str:
    rows = [[role, str(m["images"]), *_metric_cells(m)] for role, m in _roles(found)]
    blocks = [report.table(["views", "images", *METRICS], rows)]
    blocks += [report.paragraph(_verdict(role, m)) for role, m in _roles(found)]
    explained = (
        "Deviance is the mean of 2 L (I/mu - 1 - ln(I/mu)) over what speckle alone would leave: 1 is a perfect model. "
        "It is taken over the lit interior: pixels whose 3 x 3 neighbours the model lights, off the image's edge. "
        "The second one takes every valid pixel, shadows too, with a level added to the model that is fitted to each "
        "image. ± is one standard error, with the correlation of neighbouring pixels."
    )
    if not scene.grid.calibrated:
        explained += (
            " The images are not calibrated: one gain per image is fitted, so absolute brightness is not tested."
        )
    noise = max(i.sampling_noise for i in found.images)
    explained += f" Rays add at most {noise:.1g} to a deviance, as two independent renders show."
    zeros = sum(m["zeros"] for _, m in _roles(found))
    if zeros:
        explained += f" {zeros} lit pixels measure exactly 0, which no speckle makes; they are left out."
    return report.section("In short", *blocks, report.paragraph(explained, quiet=True))


def _roles(found: Evaluation) -> list[tuple[str, dict[str, Any]]]:
    return [(role, m) for role, m in (("train", found.train), ("test", found.test)) if m is not None]


def _verdict(role: str, m: dict[str, Any]) -> str:
    name = {"train": "On the train views", "test": "On the test views, which no fit has touched"}[role]
    away = (m["deviance"] - 1.0) / m["deviance_error"]
    if abs(away) <= 3.0:
        return f"{name}, the model leaves no more than speckle: deviance {_pm(m, 'deviance')}."
    if away < 0:
        return f"{name}, less is left than speckle of these looks leaves: deviance {_pm(m, 'deviance')}; check `looks`."
    return (
        f"{name}, something is left beside speckle: deviance {_pm(m, 'deviance')}, "
        f"{away:.0f} standard errors above the floor."
    )


# Images


def residual_picture(image: EvaluatedImage) -> bytes:
    """PNG of the residual [dB] on the compared pixels, grey elsewhere; red: the measured image is brighter."""
    residual = np.where(image.interior, image.ratio_db, np.nan)
    reach = _reach([image])
    return report.png(report.colour(residual, RESIDUAL_COLOURS, -reach, reach))


def _reach(images: Sequence[EvaluatedImage]) -> float:
    """End of the residual's colour scale [dB]: 90 % of the compared pixels are inside, whole dB, at least 3."""
    residual = np.concatenate([np.abs(i.ratio_db[i.interior]) for i in images])
    return float(np.clip(np.ceil(np.percentile(residual, 90.0)), 3.0, 30.0))


def reduced(power: np.ndarray, mask: np.ndarray, factor: int) -> np.ndarray:
    """Mean of linear `power` over the `mask`ed pixels of factor x factor blocks; NaN where there are none. The last
    rows and columns that fill no block are dropped."""
    rows, cols = (n // factor * factor for n in power.shape)

    def blocks(a: np.ndarray) -> np.ndarray:
        return a[:rows, :cols].reshape(rows // factor, factor, cols // factor, factor).sum(axis=(1, 3))

    with np.errstate(invalid="ignore"):
        return np.asarray(blocks(np.where(mask, power, 0.0)) / blocks(mask.astype(float)))


def _images(scene: Scene, found: Evaluation) -> str:
    rows, cols = scene.grid.shape
    height, width = (n * s for n, s in zip(scene.grid.shape, scene.grid.spacing_m, strict=True))
    factor = max(1, int(np.ceil(np.sqrt(3 * len(found.images) * rows * cols / PICTURE_PIXELS))))
    factor = min(factor, rows, cols)
    reach = _reach(found.images)
    blocks = [
        report.paragraph(
            f"The radar is at the top: range runs down ({height:g} m), azimuth across ({width:g} m). Measured and "
            f"simulated share one dB scale in each row. Residual: measured over simulated, on the pixels that are "
            f"compared; grey elsewhere." + (f" Shown averaged over {factor} x {factor} pixels." if factor > 1 else "")
        ),
        report.scale(RESIDUAL_COLOURS, [f"-{reach:g}", "0", f"+{reach:g} dB"], "residual: measured / simulated"),
    ]
    for image in found.images:
        everywhere = np.isfinite(image.measured)
        measured, simulated = (reduced(p, everywhere, factor) for p in (image.measured, image.simulated))
        inner = [reduced(p, image.interior, factor) for p in (image.measured, image.simulated)]
        shown = np.concatenate([10.0 * np.log10(p[image.interior]) for p in (image.measured, image.simulated)])
        low, high = (int(f(np.percentile(shown, q))) for f, q in ((np.floor, 1.0), (np.ceil, 99.7)))
        panels = []
        for name, power in (("measured", measured), ("simulated", simulated)):
            with np.errstate(divide="ignore", invalid="ignore"):
                db = np.where(np.isnan(power), np.nan, 10.0 * np.log10(np.maximum(power, 1e-30)))
            panels.append((name, report.png(report.colour(db, "gray", low, high))))
        residual = report.colour(ratio_db(*inner), RESIDUAL_COLOURS, -reach, reach)
        panels.append(("residual", report.png(residual)))
        v, m = image.view, image.metrics
        blocks.append(report.heading(f"{v.name} · {image.polarization} · {v.role}"))
        looks = f"{image.observation.looks:.3g}" + (" (estimated)" if image.observation.looks_estimated else "")
        said = [
            ("azimuth", f"{v.azimuth_deg:g}°"),
            ("incidence", f"{v.incidence_deg:g}°"),
            ("looks", looks),
            ("deviance", _pm(m, "deviance")),
            ("all pixels", _pm(m, "deviance_all")),
            ("rmse", f"{m['rmse_db']:.2f} dB"),
            ("correlation", f"{m['correlation']:.3f}"),
            ("pixels", f"{m['pixels']:,}"),
            ("left out", f"{m['left_out']:,}"),
        ]
        if not scene.grid.calibrated:
            said.append(("fitted gain", f"{10.0 * np.log10(image.gain):.2f} dB"))
        key = report.scale("gray", [f"{low}", f"{high} dB"], "beta0")
        pictures = [report.picture(data, name, aspect=width / height) for name, data in panels]
        blocks.append(report.row(*pictures, report.cell(key, report.facts(said))))
    table = [[f"{i.view.name} {i.polarization}", i.view.role, *_metric_cells(i.metrics)] for i in found.images]
    blocks.append(report.heading("Every image"))
    blocks.append(report.table(["image", "role", *METRICS], table))
    return report.section("Measured, simulated, residual", *blocks)


def _residuals(by_factor: dict[str, Profile], expected: dict[str, float]) -> str:
    said = (
        "The residual of all compared pixels against what might explain it; the mean that speckle has in dB is taken "
        "off. Where the model is true, the blue band lies on the grey one. A slope is a hint at what is missing."
    )
    cells = [
        report.drawing(profile_figure(profile, expected), f"Residual against {profile.label}", show=False)
        for profile in by_factor.values()
        if profile.rows
    ]
    return report.section(
        "What the residual follows", report.paragraph(said), report.row(*cells, across=3, least_px=300)
    )


# Parameters


def _identified(scene: Scene, stage: Stage, rays_per_m2: float) -> tuple[Identified | None, list[str]]:
    """What the train views can say of the parameters, and the words for it."""
    learns = any(block.learn for block in stage.surface.blocks) or bool(scene.effects)
    if not learns or not any(v.role == "train" and v.images for v in scene.views):
        said = "Nothing is to be learned here, or there is no train view to learn from."
        return None, [report.paragraph(said)]
    if any(block.learn and block.size > 1 for block in stage.surface.blocks):
        return None, _field_words(Path(scene.path).parent if scene.path else None)
    try:
        problem = FitProblem(scene, stage.target.device, rays=Rays(stage, rays_per_m2, scene.sampling.seed))
    except InputError as error:  # a value at a dead point (eps_r = 1) can be simulated, but not differentiated
        return None, [report.paragraph(f"Not known: {error}")]
    identified = identify(problem, problem.x0)
    said = (
        "From the Fisher information of the train views' speckle at these parameters: relative standard deviations, "
        "and the products (*) and ratios (/) that the data determine where single values are not."
    )
    return identified, [report.bullets(identified.words), report.paragraph(said, quiet=True)]


def _field_words(folder: Path | None) -> list[str]:
    """What learn.json beside the scene says of fields, which are too large for one information matrix."""
    path = folder / "learn.json" if folder else None
    try:
        fields = json.loads(path.read_text(encoding="utf-8")).get("fields", {}) if path and path.is_file() else {}
        words = [
            f"{name}: {f['determined']} of {f['nodes']} nodes determined to better than a factor e, "
            f"{f['nodes'] - f['seen']} seen by no train view"
            for name, f in fields.items()
        ]
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: not what `warpsar learn` leaves ({error}); remove it") from error
    if not words:
        return [
            report.paragraph(
                "Not known for fields without the learn.json that `warpsar learn` leaves beside its scene."
            )
        ]
    return [report.bullets(words)]


def _number(value: float) -> str:
    return f"{value:.3g}"


def _shown(kind: Kind) -> tuple[str, float]:
    return UNITS.get(kind.key, ("tau", 1.0))


def _parameters(scene: Scene, stage: Stage, identified: Identified | None) -> str:
    surface = stage.surface
    sd = {} if identified is None else dict(zip(identified.labels, identified.sd, strict=True))
    rows = []
    for name in surface.materials:
        row = [name]
        for kind in KINDS:
            block, factor = surface.block(name, kind.key), _shown(kind)[1]
            values = surface.values(name, kind.key) * factor
            if block.size > 1:
                row.append(f"{_number(values.min())} to {_number(values.max())}, median {_number(np.median(values))}")
                continue
            text = _number(float(values.ravel()[0]))
            spread = sd.get(f"{name}.{kind.key}")
            if spread is not None and np.isfinite(spread) and spread < 3.0:
                node = float(surface.nodes[block.start])
                ends = kind.from_coordinate(np.array([node - 1.96 * spread, node + 1.96 * spread])) * factor
                text += f" ({_number(ends[0])} to {_number(ends[1])})"
            elif spread is not None:
                text += " (not determined)"
            row.append(text)
        rows.append(row)
    caption = "In brackets: 95 % intervals" if identified is not None else ""
    blocks = [report.table(["material", *(_shown(kind)[0] for kind in KINDS)], rows, caption)]
    if scene.effects:
        said = [[name, json.dumps(table)] for name, table in scene.effects.items()]
        blocks.append(report.table(["declared effect", "parameters"], said))
    sides = [look(stage, *side) for side in SIDES_DEG]
    chosen = [k for k in KINDS if any(b.learn for b in surface.blocks if b.kind is k)] or list(KINDS[:3])
    for kind in chosen:
        blocks += _on_the_mesh(kind, sides)
    return report.section("Parameters of the surface", *blocks)


def _on_the_mesh(kind: Kind, sides: Sequence[MeshView]) -> list[str]:
    """A colour scale, and the parameter on the mesh from each side."""
    label, factor = _shown(kind)
    logarithmic = kind.key != "specular_fraction"  # learned, and told apart, by ratios
    planes = [side.parameters[kind.key] * factor for side in sides]
    planes = [np.log10(plane) for plane in planes] if logarithmic else planes
    low, high = min(float(p.min()) for p in planes), max(float(p.max()) for p in planes)
    marks = np.linspace(low, high, 3 if high > low else 1)
    pictures = [
        report.picture(
            report.png(side.paint(report.colour(plane, "viridis", low, high))), f"{label}, from azimuth {at:g}°"
        )
        for side, plane, (at, _) in zip(sides, planes, SIDES_DEG, strict=True)
    ]
    ticks = [_number(10.0**mark if logarithmic else mark) for mark in marks]
    return [report.scale("viridis", ticks, label), report.row(*pictures, across=2)]


# How it came to be


def _convergence(folder: Path | None) -> list[str]:
    """The fit's history, where `warpsar learn` left one beside the scene."""
    path = folder / "history.csv" if folder else None
    if path is None or not path.is_file():
        return []
    history = _history(path)
    if not history:
        return []
    figures = [
        report.drawing(_loss_figure(history), "Loss above the best one, against iterations"),
        report.drawing(_deviance_figure(history), "Deviance of the fit, in units of the speckle floor"),
    ]
    return [report.section("Convergence of the fit", report.row(*figures, across=2, least_px=300))]


def _history(path: Path) -> list[dict[str, float]]:
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            history = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(stream)]
        for row in history:
            numbers = {key: row[key] for key in ("iteration", "start", "loss", "train_deviance")}
            if not all(0 <= abs(value) < 1e100 for value in numbers.values()):
                raise ValueError(f"found {numbers}; must be finite numbers")
    except (OSError, ValueError, TypeError, KeyError, csv.Error) as error:
        raise InputError(f"{path}: not what `warpsar learn` leaves ({error}); remove it") from error
    return history


def _loss_figure(history: list[dict[str, float]]) -> Figure:
    figure, axis = new(4.6, 3.0)
    best = min(row["loss"] for row in history)
    for start in sorted({row["start"] for row in history}):
        mine = [row for row in history if row["start"] == start]
        above = [max(row["loss"] - best, 1e-4) for row in mine]
        axis.plot([row["iteration"] for row in mine], above, ".-", label=f"start {start + 1:g}")
    axis.set_yscale("log")
    axis.set_xlabel("iteration")
    axis.set_ylabel("loss above the best [log-likelihood]")
    axis.legend(frameon=False, fontsize=8)
    return figure


def _deviance_figure(history: list[dict[str, float]]) -> Figure:
    figure, axis = new(4.6, 3.0)
    for role, style in (("train", "-"), ("test", "--")):
        if f"{role}_deviance" in history[0]:
            axis.plot(
                [row["iteration"] for row in history],
                [row[f"{role}_deviance"] for row in history],
                style,
                label=f"{role} views",
            )
    axis.axhline(1.0, color="0.6", lw=0.8)
    axis.set_yscale("log")
    axis.set_xlabel("iteration")
    axis.set_ylabel("deviance / speckle floor")
    axis.legend(frameon=False, fontsize=8)
    return figure
