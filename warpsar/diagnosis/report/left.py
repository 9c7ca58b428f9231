"""What is left, in diagnose's report: residuals before and after, the strongest window, and its place on the mesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpsar.compare.comparison import Comparison, ratio_db
from warpsar.diagnosis.left.figures import REACH_SD, SMOOTHED, in_plan, spectrum, worst_view
from warpsar.diagnosis.left.place import ResidualPlace, residual_on
from warpsar.diagnosis.left.words import sentences
from warpsar.diagnosis.result import Diagnosed
from warpsar.evaluation.report_parts import both_sides, image_axes, reach_db, residual_rgb, residual_scale
from warpsar.io import html as report
from warpsar.io import html_image
from warpsar.surface.stage import Stage

SURFACE_REACH_DB = 3.0  # of averages over 5 x 5 pixels and several views
INCIDENCE_DEG = 45.0  # of the two looks at the mesh


def residuals_section(done: Diagnosed) -> str:
    first, last = done.models[0], done.models[-1]
    reach = _reach(first)
    same = not done.changed
    blocks = [
        report.paragraph(
            "Measured over modelled power on the compared pixels, grey elsewhere; one scale for all. The radar is at "
            "the top. Range and azimuth are about the reference point. Click on a picture to enlarge it."
            + (" Nothing was added, so there is no second picture." if same else "")
        ),
        residual_scale(reach, "measured / modelled"),
    ]
    cells, axes = [], image_axes(done.diagnosis.scene)
    for before, after in zip(first, last, strict=True):
        name = f"{before.name}, {before.role}"
        pair = [("before", before)] if same else [("before", before), ("after", after)]
        cells += [
            html_image.image(
                report.png(residual_rgb(_residual_db(image), reach)),
                f"{name}, {when}: deviance {image.scaled_deviance.mean():.3f}",
                *axes,
            )
            for when, image in pair
        ]
    return report.section("The residual before and after", *blocks, report.row(*cells))


def _residual_db(image: Comparison) -> np.ndarray:
    return np.where(image.seen.interior, ratio_db(image.seen.measured, image.simulated), np.nan)


def _reach(images: Sequence[Comparison]) -> float:
    return reach_db([_residual_db(image)[image.seen.interior] for image in images], 98.0)


def left_section(done: Diagnosed) -> str:
    return report.section(
        "What is left at the end, and where",
        report.bullets(sentences(done.left)),
        *_pictures(done),
        *_nearest(done),
        report.paragraph(_strongest_window(done)),
        *_place(done.place),
        *_on_the_mesh(done),
    )


def _pictures(done: Diagnosed) -> list[str]:
    """The worst view and the surface from above; where something has to be explained, the spectrum."""
    found, left = done.diagnosis, done.left
    view = report.png(worst_view(left))
    plan, *plan_axes = in_plan(found, left)
    blocks = [
        report.paragraph(
            f"The residual in {left.image}, which shows it best, in standard deviations of speckle; framed where it is "
            f"strongest. Beside it the mean of all train views on the surface from above, over {SMOOTHED} x {SMOOTHED} "
            "pixels. Grey: no pixel is compared."
        ),
        residual_scale(REACH_SD, "standard deviations; half as many from above", unit=""),
        report.row(
            html_image.image(view, f"The residual in {left.image}", *image_axes(found.scene)),
            html_image.image(report.png(plan), "The same on the surface from above", *plan_axes),
            across=2,
        ),
    ]
    if left.unexplained:
        words = "Its spectrum in that image, and its mean along range and along azimuth"
        blocks.append(report.drawing(spectrum(left, found.scene.grid.spacing_m), words))
    return blocks


def _nearest(done: Diagnosed) -> list[str]:
    """The explanations that come nearest, where something has to be explained."""
    left = done.left
    if not left.unexplained or not left.nearest:
        return []
    rows = [
        [one.effect, f"{one.score:.1f}", "–" if one.refit_gain is None else f"{one.refit_gain:+,.1f}", one.against]
        for one in left.nearest
    ]
    head = ["nearest explanations", "score, -ln p", "refit, 2 ln L", "evidence against it"]
    return [report.table(head, rows, f"A score must exceed {left.nearest[0].threshold:.1f}")]


def ratio_words(ratio_db: float) -> str:
    """Measured over modelled power [dB] in words; NaN where a window holds dark pixels alone."""
    return "no lit pixel is compared there" if np.isnan(ratio_db) else f"measured over modelled {ratio_db:+.2f} dB"


def _strongest_window(done: Diagnosed) -> str:
    """Where the strongest window lies, and whether it has to be explained."""
    found, where = done.diagnosis, done.place
    last = found.turns[-1]
    rows, columns = where.window
    text = (
        f"The strongest window of {rows} x {columns} pixels is in {where.view} {where.polarization} at "
        f"row {where.row}, column {where.col} (range {where.range_m:+.1f} m, azimuth {where.azimuth_m:+.1f} m): "
        f"{ratio_words(where.ratio_db)}, z {where.z:+.1f}, score {last.scan_minus_log_p:.1f} against "
        f"a threshold of {last.threshold:.1f}."
    )
    surface = [c.effect for c in last.candidates if c.shared]
    verdict = (
        f"What was tried as {' and '.join(surface)} lies on the surface: something the mesh lacks is left unexplained."
        if done.unexplained and surface
        else "Nothing in the library explains it: it is left unexplained."
        if done.unexplained
        else "Speckle alone leaves such a window somewhere: nothing has to be explained."
        if last.scan_minus_log_p <= last.threshold
        else "The limit of added effects was reached before it was explained."
    )
    return f"{text} {verdict}"


def _place(where: ResidualPlace) -> list[str]:
    """Tables of what is lit in the window, and of the same place in every view."""
    if not where.parts:
        return [report.paragraph("No surface is lit there.")]
    blocks = []
    rows = []
    for p in where.parts:
        extent = " × ".join(f"{b - a:.1f}" for a, b in zip(p.low_m, p.high_m, strict=True))
        rows.append([p.material, f"{100 * p.share:.0f} %", *(f"{c:.1f}" for c in p.centre_m), extent])
    head = ["surface in the window", "of its lit area", "east [m]", "north [m]", "up [m]", "extent [m]"]
    blocks.append(report.table(head, rows, "World coordinates of the lit surfaces in that window"))
    rows = [
        [
            v.image,
            v.role,
            str(v.row),
            str(v.col),
            "–" if not np.isfinite(v.ratio_db) else f"{v.ratio_db:+.2f}",
        ]
        for v in where.views
    ]
    head = ["image", "role", "row", "column", "measured / modelled [dB]"]
    blocks.append(report.table(head, rows, "The same place in every view, whether it is seen there or not"))
    return blocks


def _on_the_mesh(done: Diagnosed) -> list[str]:
    """What is left, painted on the mesh from two sides."""
    found = done.diagnosis
    reach = SURFACE_REACH_DB
    stage = Stage.of(found.final.scene, found.setup.device)
    pictures = []
    for azimuth, side in both_sides(stage, INCIDENCE_DEG):
        shades = residual_rgb(residual_on(side, found, done.models[-1]), reach)
        pictures.append(report.picture(report.png(side.paint(shades)), f"the residual, from azimuth {azimuth:g}°"))
    return [
        report.paragraph(
            "What is left on the surface: measured over modelled power, averaged over 5 x 5 pixels and the train views "
            "that see the place; grey where none does."
        ),
        residual_scale(reach, "measured / modelled"),
        report.row(*pictures, across=2),
    ]
