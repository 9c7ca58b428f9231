"""report.html of `warpsar evaluate`: pictures, tables and words, for a reader who has nothing else."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import warp as wp

from warpsar.compare.evaluation import Evaluation
from warpsar.compare.laid import BesideMean
from warpsar.compare.prediction import PredictedImage
from warpsar.errors import InputError
from warpsar.evaluation.report_curves import curves_section
from warpsar.evaluation.report_images import first_pictures, images_section
from warpsar.evaluation.report_numbers import summary_section, verdict_sentence
from warpsar.evaluation.report_prediction import means_section, prediction_section
from warpsar.evaluation.residuals import FactorProfile, profile_figure
from warpsar.io import html as report
from warpsar.io.figures import new
from warpsar.learning.table import figure_of_table
from warpsar.scene.scene import Scene
from warpsar.surface.stage import Stage

if TYPE_CHECKING:
    from matplotlib.figure import Figure
import json

import numpy as np

from warpsar.evaluation.meshview import MeshView
from warpsar.evaluation.report_parts import both_sides, shown_as, shown_interval
from warpsar.learning.curves import curves_beside
from warpsar.learning.identify import Identified, identify
from warpsar.learning.problem import FitProblem
from warpsar.models import registry
from warpsar.simulation.rays import Rays
from warpsar.surface.surface import KINDS, Kind


def write_report(
    path: Path,
    scene: Scene,
    found: Evaluation,
    by_factor: dict[str, FactorProfile],
    expected: dict[str, float],
    content: dict[str, Any],
    command: Sequence[str],
    device: wp.Device,
    *,
    before: Evaluation | None = None,
    predicted: Sequence[PredictedImage] = (),
    laid: Sequence[BesideMean] = (),
    identified: Identified | None = None,
    title: str = "",
    beside: str = "evaluate.json (all numbers), residual images as EXR and PNG, learned.ply",
) -> None:
    """`by_factor` and `expected` are `profiles` and `expected_db` of the images. `content` is that of evaluate.json or
    learn.json, `command` the words that made it. `before` is another model of the same images. `predicted`: test views
    beside predictions of them, and `laid`, beside the mean of train views on the ground. `identified`: what a fit said
    of the parameters, where there was one; else it is found here. `title` takes the place of the verdict, which follows
    it then. `beside` names the other files."""
    stage = Stage.of(scene, device)
    if identified is None:
        identified, words = identified_words(scene, stage, found.rays_per_m2, path.parent / "cache")
    else:
        words = _undetermined(identified, scene)
    verdict = verdict_sentence(Path(scene.path or "the scene").name, found)
    summary = (
        f"{' '.join(command[:2])} {content['version']}; {_curves_and(found)}{len(found.images)} images of "
        f"{scene.grid.shape[0]} x {scene.grid.shape[1]} pixels, {content['rays_per_pixel']:.3g} rays per pixel, on "
        f"{content['device']}"
    )
    sections = [
        *([report.paragraph(verdict)] if title else []),
        first_pictures(scene, found, before),
        summary_section(scene, found, before),
        *([prediction_section(predicted)] if predicted else []),
        *([means_section(laid)] if laid else []),
        images_section(scene, stage, found, before),
        *_curves_sections(found, before),
        _residuals_section(by_factor, expected),
        parameters_section(scene, stage, identified),
        *tables_section(content),
        report.section("What is not identifiable", *words),
        *convergence_sections(Path(scene.path).parent if scene.path else None),
        report.reproduce(
            content,
            command,
            f"Beside this file: {beside}.",
        ),
    ]
    report.write(path, report.page(title or verdict, summary, *sections))


def _curves_and(found: Evaluation) -> str:
    """ "2 curves and ", where there are curves."""
    count = len(found.curves)
    return f"{count} curve{'s' if count > 1 else ''} and " if count else ""


def _curves_sections(found: Evaluation, before: Evaluation | None) -> list[str]:
    """The curves that stand beside the images."""
    first = [] if before is None else before.curves
    return [curves_section(found.curves, found.curve_verdicts, first)] if found.curves else []


def _residuals_section(by_factor: dict[str, FactorProfile], expected: dict[str, float]) -> str:
    text = (
        "The residual of all compared pixels against what might explain it; the mean that speckle has in dB is taken "
        "off. Where the model is true, the blue band lies on the grey one. A slope is a hint at what is missing."
    )
    cells = [
        report.drawing(profile_figure(profile, expected), f"Residual against {profile.label}", show=False)
        for profile in by_factor.values()
        if profile.rows
    ]
    return report.section(
        "What the residual follows", report.paragraph(text), report.row(*cells, across=3, least_px=300)
    )


# ---- tables of sigma0 that were adapted, drawn over incidence


def tables_section(content: Mapping[str, Any]) -> list[str]:
    """A section, or none where `content`, that of learn.json, has no learned table."""
    tables = content.get("learned_tables", {})
    if not tables:
        return []
    text = (
        "What the images changed of the tables. Bands are 95 % intervals, if the model is right. Away from the "
        "incidences seen, a table stays as given."
    )
    figures = [
        report.drawing(figure_of_table(name, of_incidence), f"sigma0 of {name} over local incidence, before and after")
        for name, of_incidence in tables.items()
    ]
    return [
        report.section("Learned tables of sigma0", report.paragraph(text), report.row(*figures, across=2, least_px=300))
    ]


# ---- the fit's history, where there was a fit


def convergence_sections(folder: Path | None) -> list[str]:
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


# ---- surface parameters: values, what the data can say of them, and pictures on the mesh


INCIDENCE_DEG = 55.0  # of the two looks at the mesh


def identified_words(
    scene: Scene, stage: Stage, rays_per_m2: float, cache: Path | None = None
) -> tuple[Identified | None, list[str]]:
    """What the train views, and train curves beside them, can say of the parameters, and the words for it; `cache` as
    in `evaluated`."""
    nothing = [report.paragraph("Nothing is to be learned here, or there is no train view to learn from.")]
    learns = any(block.learn for block in stage.surface.blocks) or bool(scene.effects)
    if not learns or not any(v.role == "train" and v.images for v in scene.views):
        return None, nothing
    if any(block.learn and block.size > 1 for block in stage.surface.blocks):
        return None, field_words(Path(scene.path).parent if scene.path else None)
    device = stage.target.device
    try:
        beside = curves_beside(scene, cache, device.alias)
        problem = FitProblem(scene, device, rays=Rays(stage, rays_per_m2, scene.sampling.seed), beside=beside)
    except InputError as error:  # a value at a dead point (eps_r = 1) can be simulated, but not differentiated
        return None, [report.paragraph(f"Not known: {error}")]
    if not problem.x0.size:  # effects alone, and all that they state is held
        return None, nothing
    identified = identify(problem, problem.x0)
    return identified, _undetermined(identified, scene)


def _undetermined(identified: Identified, scene: Scene) -> list[str]:
    """The words for what the data do not determine."""
    if not identified.undetermined:
        return [report.paragraph("Every value that is learned is determined by itself.")]
    curves = ", and of the noise of the train curves," if any(one.role == "train" for one in scene.curves) else ""
    text = (
        f"From the Fisher information of the train views' speckle{curves} at these parameters: relative standard "
        "deviations, and the products (*) and ratios (/) that the data determine where single values are not."
    )
    return [report.bullets(identified.undetermined), report.paragraph(text, quiet=True)]


def field_words(folder: Path | None) -> list[str]:
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


def stated(table: Mapping[str, Any]) -> str:
    """The parameters of an effect: "level 0.00299, window taylor"; of tables by view or material, each entry."""
    words = []
    for key, value in table.items():
        entries = {f"{key} of {one}": x for one, x in value.items()} if isinstance(value, Mapping) else {key: value}
        for one, x in entries.items():
            each = x if isinstance(x, list | tuple) else [x]
            words.append(f"{one} " + " ".join(f"{y:.4g}" if isinstance(y, float) else str(y) for y in each))
    return ", ".join(words)


def parameters_section(scene: Scene, stage: Stage, identified: Identified | None) -> str:
    surface = stage.surface
    at = {} if identified is None else {label: k for k, label in enumerate(identified.labels)}
    rows = []
    for name in surface.materials:
        row = [name]
        own = [block for block in surface.blocks if block.material == name]
        model = registry.get(surface.model[surface.materials.index(name)])
        for block in own:
            kind = block.kind
            if not kind.own and not model.of_surface:  # it says nothing
                row.append("")
                continue
            label, factor = shown_as(kind.key)
            values = surface.values(name, kind.key) * factor
            if block.size > 1:
                row.append(f"{_number(values.min())} to {_number(values.max())}, median {_number(np.median(values))}")
                continue
            text = _number(float(values.ravel()[0]))
            place = at.get(f"{name}.{kind.key}")
            if identified is not None and place is not None and identified.tells(place):
                ends = kind.interval(identified.interval_95(place, float(surface.nodes[block.start])))
                text += f" {shown_interval(ends, factor)}"
            elif place is not None:
                text += " (not determined)"
            table = "table, " if model.from_table else ""
            row.append(f"{table}{label} {text}" if kind.own else text)
        rows.append(row)
    caption = "In brackets: 95 % intervals" if identified is not None else ""
    blocks = [report.table(["material", *(shown_as(kind.key)[0] for kind in KINDS)], rows, caption)]
    if scene.effects:
        declared_rows = [[name, stated(table)] for name, table in scene.effects.items()]
        blocks.append(report.table(["declared effect", "parameters"], declared_rows))
    bare = np.array([not registry.get(model).of_surface for model in surface.model])
    sides = both_sides(stage, INCIDENCE_DEG)
    chosen = [k for k in KINDS if any(b.learn for b in surface.blocks if b.kind is k)] or list(KINDS[:3])
    for kind in chosen if not bare.all() else []:
        blocks += _on_the_mesh(kind, sides, bare)
    return report.section("Parameters of the surface", *blocks)


def _on_the_mesh(kind: Kind, sides: Sequence[tuple[float, MeshView]], bare: np.ndarray) -> list[str]:
    """A colour scale, and the parameter on the mesh from each side; grey where a material has none, (materials,)."""
    label, factor = shown_as(kind.key)
    logarithmic = kind.key != "specular_fraction"  # learned, and told apart, by ratios
    planes = [np.where(bare[side.material], np.nan, side.parameters[kind.key] * factor) for _, side in sides]
    planes = [np.log10(plane) for plane in planes] if logarithmic else planes
    shown = np.concatenate(planes)
    shown = shown[~np.isnan(shown)]
    if not shown.size:
        return []
    low, high = float(shown.min()), float(shown.max())
    marks = np.linspace(low, high, 3 if high > low else 1)
    pictures = [
        report.picture(
            report.png(side.paint(report.colour(plane, "viridis", low, high))), f"{label}, from azimuth {at:g}°"
        )
        for (at, side), plane in zip(sides, planes, strict=True)
    ]
    ticks = [_number(10.0**mark if logarithmic else mark) for mark in marks]
    return [report.scale("viridis", ticks, label), report.row(*pictures, across=2)]
