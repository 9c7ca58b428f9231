"""report.html of `warpsar evaluate`: pictures, tables and words, for a reader who has nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import warp as wp

from warpsar.compare.evaluation import Evaluation
from warpsar.compare.laid import BesideMean
from warpsar.compare.prediction import PredictedImage
from warpsar.evaluation.report_convergence import convergence_sections
from warpsar.evaluation.report_curves import curves_section
from warpsar.evaluation.report_images import first_pictures, images_section
from warpsar.evaluation.report_numbers import summary_section, verdict_sentence
from warpsar.evaluation.report_prediction import means_section, prediction_section
from warpsar.evaluation.report_surface import identified_words, parameters_section
from warpsar.evaluation.report_tables import tables_section
from warpsar.evaluation.residuals import FactorProfile, profile_figure
from warpsar.io import html as report
from warpsar.scene.scene import Scene
from warpsar.surface.stage import Stage


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
    told: Sequence[PredictedImage] = (),
    laid: Sequence[BesideMean] = (),
    title: str = "",
    beside: str = "evaluate.json (all numbers), residual images as EXR and PNG, learned.ply",
) -> None:
    """`by_factor` and `expected` are `profiles` and `expected_db` of the images. `content` is that of evaluate.json or
    learn.json, `command` the words that made it. `before` is another model of the same images. `told`: test views
    beside predictions of them, and `laid`, beside the mean of train views on the ground. `title` takes the place of
    the verdict, which follows it then. `beside` names the other files."""
    stage = Stage.of(scene, device)
    identified, words = identified_words(scene, stage, found.rays_per_m2)
    verdict = verdict_sentence(Path(scene.path or "the scene").name, found)
    lead = (
        f"{' '.join(command[:2])} {content['version']}; {len(found.images)} images of {scene.grid.shape[0]} x "
        f"{scene.grid.shape[1]} pixels, {content['rays_per_pixel']:.3g} rays per pixel, on {content['device']}"
    )
    sections = [
        *([report.paragraph(verdict)] if title else []),
        first_pictures(scene, found, before),
        summary_section(scene, found, before),
        *([prediction_section(told)] if told else []),
        *([means_section(laid)] if laid else []),
        images_section(scene, stage, found, before),
        *([curves_section(found.curves, found.curve_verdicts)] if found.curves else []),
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
    report.write(path, report.page(title or verdict, lead, *sections))


def _residuals_section(by_factor: dict[str, FactorProfile], expected: dict[str, float]) -> str:
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
