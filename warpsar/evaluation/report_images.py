"""Pictures in evaluate's report: every measured image beside its simulation and the residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpsar.compare.comparison import Comparison, ratio_db
from warpsar.compare.evaluation import Evaluation
from warpsar.evaluation.report_numbers import METRICS, metric_cells
from warpsar.evaluation.report_parts import (
    SMOOTHED,
    averaged_ratio_db,
    beta0_rgb,
    image_axes,
    plus_minus,
    reach_db,
    residual_rgb,
    residual_scale,
)
from warpsar.io import html as report
from warpsar.io import html_image
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import covered_in
from warpsar.surface.stage import Stage

PICTURE_PIXELS = 1.5e6  # of all pictures of images together: the file stays under some 5 MB


def residual_picture(image: Comparison) -> bytes:
    """PNG of the residual [dB] on the compared pixels, grey elsewhere; red: the measured image is brighter."""
    residual = np.where(image.interior, image.ratio_db, np.nan)
    return report.png(residual_rgb(residual, _reach([image])))


def _reach(images: Sequence[Comparison]) -> float:
    return reach_db([image.ratio_db[image.interior] for image in images], 90.0)


def _deviance(image: Comparison) -> tuple[float, float]:
    return image.metrics["deviance"], image.metrics["deviance_error"]


def reduced(power: np.ndarray, mask: np.ndarray, factor: int) -> np.ndarray:
    """Mean of linear `power` over the `mask`ed pixels of factor x factor blocks; NaN where there are none. The last
    rows and columns that fill no block are dropped."""
    rows, cols = (n // factor * factor for n in power.shape)

    def blocks(a: np.ndarray) -> np.ndarray:
        return a[:rows, :cols].reshape(rows // factor, factor, cols // factor, factor).sum(axis=(1, 3))

    with np.errstate(invalid="ignore"):
        return np.asarray(blocks(np.where(mask, power, 0.0)) / blocks(mask.astype(float)))


def first_pictures(scene: Scene, found: Evaluation, before: Evaluation | None) -> str:
    """The residual of the test image that is explained worst, or of a train image without any, beside what was
    measured. With `before`, the residual of that model stands first."""
    number = max(
        range(len(found.images)),
        key=lambda k: (found.images[k].role == "test", np.nan_to_num(found.images[k].metrics["deviance"])),
    )
    image = found.images[number]
    shown = (
        {"residual": image} if before is None else {"residual before": before.images[number], "residual after": image}
    )
    residuals = {name: averaged_ratio_db(one) for name, one in shown.items()}
    reach = reach_db([one[np.isfinite(one)] for one in residuals.values()], 99.0)
    greys, key = beta0_rgb([image.measured])
    coloured = {name: residual_rgb(one, reach) for name, one in residuals.items()} | {"measured": greys[0]}
    pictures = [html_image.image(report.png(rgb), name, *image_axes(scene)) for name, rgb in coloured.items()]
    caption = (
        f"{image.name}, a {image.role} image. Residual: measured over simulated power, averaged over {SMOOTHED} x "
        f"{SMOOTHED} pixels."
    )
    return (
        report.row(*pictures, across=3)
        + report.row(residual_scale(reach, "measured / simulated"), key, across=3)
        + report.paragraph(caption, quiet=True)
    )


def images_section(scene: Scene, stage: Stage, found: Evaluation, before: Evaluation | None) -> str:
    """Each image in a row. With `before`, the residual of that model stands beside the one of `found`."""
    rows, cols = scene.grid.shape
    down, along = image_axes(scene)
    factor = max(1, int(np.ceil(np.sqrt(3 * len(found.images) * rows * cols / PICTURE_PIXELS))))
    factor = min(factor, rows, cols)
    earlier = [None] * len(found.images) if before is None else before.images
    reach = _reach([image for image in (*found.images, *earlier) if image is not None])
    blocks = [
        report.paragraph(
            "The radar is at the top. Range and azimuth are about the reference point. Click on a picture to "
            "enlarge it. Measured and simulated share one scale in each row. Residual: measured over simulated, on "
            "the pixels that are compared; grey elsewhere. Dark blue: the mesh ends there."
            + (f" Shown averaged over {factor} x {factor} pixels." if factor > 1 else "")
        ),
        residual_scale(reach, "residual: measured / simulated"),
    ]
    on_mesh: dict[str, np.ndarray] = {}
    for image, first in zip(found.images, earlier, strict=True):
        everywhere = np.isfinite(image.measured)
        measured, simulated = (reduced(p, everywhere, factor) for p in (image.measured, image.simulated))
        inner = [reduced(p, image.interior, factor) for p in (image.measured, image.simulated)]
        if image.view.name not in on_mesh:
            on_mesh[image.view.name] = covered_in(scene, stage, image.view)
        there = reduced(on_mesh[image.view.name].astype(float), everywhere, factor) > 0.5
        greys, key = beta0_rgb([measured, simulated], [None, there])
        panels = [(name, report.png(rgb)) for name, rgb in zip(("measured", "simulated"), greys, strict=True)]
        if first is not None:
            planes = [reduced(p, first.interior, factor) for p in (first.measured, first.simulated)]
            panels.append(("residual before", report.png(residual_rgb(ratio_db(*planes), reach))))
        name = "residual" if first is None else "residual after"
        panels.append((name, report.png(residual_rgb(ratio_db(*inner), reach))))
        v, m = image.view, image.metrics
        blocks.append(report.heading(f"{v.name} · {image.polarization} · {v.role}"))
        looks = f"{image.seen.looks:.3g}" + (" (estimated)" if image.seen.looks_estimated else "")
        facts = [] if first is None else [("deviance before", plus_minus(*_deviance(first)))]
        facts += [
            ("azimuth", f"{v.azimuth_deg:g}°"),
            ("incidence", f"{v.incidence_deg:g}°"),
            ("looks", looks),
            ("deviance", plus_minus(m["deviance"], m["deviance_error"])),
            ("all pixels", plus_minus(m["deviance_all"], m["deviance_all_error"])),
            ("rmse", f"{m['rmse_db']:.2f} dB"),
            ("correlation", f"{m['correlation']:.3f}"),
            ("pixels", f"{m['pixels']:,}"),
            ("left out", f"{m['left_out']:,}"),
        ]
        if not scene.grid.calibrated:
            facts.append(("fitted gain", f"{10.0 * np.log10(image.gain):.2f} dB"))
        pictures = [html_image.image(data, name, down, along) for name, data in panels]
        blocks.append(report.row(*pictures, report.cell(key, report.facts(facts)), across=len(pictures) + 1))
    table = [[f"{i.view.name} {i.polarization}", i.view.role, *metric_cells(i.metrics)] for i in found.images]
    blocks.append(report.heading("Every image"))
    blocks.append(report.table(["image", "role", *METRICS], table))
    return report.section("Measured, simulated, residual", *blocks)
