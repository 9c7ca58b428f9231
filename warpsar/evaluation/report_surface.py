"""Surface parameters in evaluate's report: values, what the data can say of them, and pictures on the mesh."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.errors import InputError
from warpsar.evaluation.meshview import MeshView
from warpsar.evaluation.report_parts import both_sides, shown_as, shown_interval
from warpsar.io import html as report
from warpsar.learning.identify import Identified, identify
from warpsar.learning.problem import FitProblem
from warpsar.models import registry
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.surface.surface import KINDS, Kind

INCIDENCE_DEG = 55.0  # of the two looks at the mesh


def identified_words(scene: Scene, stage: Stage, rays_per_m2: float) -> tuple[Identified | None, list[str]]:
    """What the train views can say of the parameters, and the words for it."""
    nothing = [report.paragraph("Nothing is to be learned here, or there is no train view to learn from.")]
    learns = any(block.learn for block in stage.surface.blocks) or bool(scene.effects)
    if not learns or not any(v.role == "train" and v.images for v in scene.views):
        return None, nothing
    if any(block.learn and block.size > 1 for block in stage.surface.blocks):
        return None, field_words(Path(scene.path).parent if scene.path else None)
    try:
        problem = FitProblem(scene, stage.target.device, rays=Rays(stage, rays_per_m2, scene.sampling.seed))
    except InputError as error:  # a value at a dead point (eps_r = 1) can be simulated, but not differentiated
        return None, [report.paragraph(f"Not known: {error}")]
    if not problem.x0.size:  # effects alone, and all that they state is held
        return None, nothing
    identified = identify(problem, problem.x0)
    if not identified.undetermined:
        return identified, [report.paragraph("Every value that is learned is determined by itself.")]
    said = (
        "From the Fisher information of the train views' speckle at these parameters: relative standard deviations, "
        "and the products (*) and ratios (/) that the data determine where single values are not."
    )
    return identified, [report.bullets(identified.undetermined), report.paragraph(said, quiet=True)]


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
        said = [[name, stated(table)] for name, table in scene.effects.items()]
        blocks.append(report.table(["declared effect", "parameters"], said))
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
