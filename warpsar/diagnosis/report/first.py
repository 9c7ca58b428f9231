"""The first screen of diagnose's report: the verdict in one sentence, pictures before and after, what to do next."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpsar.compare.comparison import Comparison
from warpsar.diagnosis.found import EffectRival
from warpsar.diagnosis.geometry.registry import summary_of
from warpsar.diagnosis.models.names import kind_of, object_of
from warpsar.diagnosis.report.next_step import Step, next_steps, refuted
from warpsar.diagnosis.result import Diagnosed
from warpsar.evaluation.report_parts import (
    SMOOTHED,
    averaged_ratio_db,
    beta0_rgb,
    image_axes,
    reach_db,
    residual_rgb,
    residual_scale,
)
from warpsar.io import html as report
from warpsar.io import html_image
from warpsar.simulation.rays import covered_in
from warpsar.surface.stage import Stage

PERCENT = 99.0  # of the compared pixels that the scale of the residual holds
REACH_SD = 4.0  # of a residual in standard deviations


def verdict_sentence(done: Diagnosed) -> str:
    """The verdict in one sentence."""
    names = _joined([_with_rivals(name, done) for name in done.verdict])
    late = ", but the time was over before all was asked" if done.diagnosis.not_asked else ""
    if refuted(done):
        return f"What the train views tell does not hold on the test views{late}."
    if done.unexplained and names:
        return f"The model lacks {names}, and something that nothing found explains{late}."
    if done.unexplained:
        return f"The model lacks something that nothing found explains{late}."
    if names:
        return f"The model lacks {names}; with it nothing but speckle is left{late}."
    return f"Nothing is missing: what the model leaves looks like speckle{late}."


def first_screen(done: Diagnosed, out: Path) -> list[str]:
    """`out` is the folder of the written scene."""
    number = telling(done)
    image = done.models[-1][number]
    residual = (
        "measured less modelled power, in standard deviations of the speckle that the model has"
        if _speckle_alone(done)
        else f"measured over modelled power, averaged over {SMOOTHED} x {SMOOTHED} pixels"
    )
    text = (
        f"The pictures show {image.name}, a {image.role} image. Residual: {residual}; grey where nothing is compared. "
        "Click on a picture to enlarge it."
    )
    return [
        *map(report.paragraph, _meanings(done)),
        _pictures(done, number),
        report.heading("What to do next"),
        *(block for step in next_steps(done, out) for block in _step(step)),
        report.paragraph(text, quiet=True),
    ]


def _step(step: Step) -> list[str]:
    return [report.paragraph(step.words), *([report.command(step.command)] if step.command else [])]


def telling(done: Diagnosed) -> int:
    """The image that shows the verdict best, as an index into those of the models.

    What is left unexplained is shown where it is strongest. What was found is shown where it explains most. Where
    nothing is missing, a test image is shown: it named nothing.
    """
    first, last = done.models[0], done.models[-1]
    names = [image.name for image in last]
    if done.unexplained and done.left.image in names:
        return names.index(done.left.image)
    if done.changed:
        return int(np.argmax([_deviance(a) - _deviance(b) for a, b in zip(first, last, strict=True)]))
    return next((k for k, image in enumerate(last) if image.role == "test"), 0)


def _deviance(image: Comparison) -> float:
    return float(image.scaled_deviance.sum()) if image.seen.count else 0.0


def _with_rivals(name: str, done: Diagnosed) -> str:
    rivals: list[EffectRival] = [one for one, _ in done.alternatives if kind_of(one.effect) == name]
    others = dict.fromkeys(kind_of(one.other) for one in rivals)
    return " or ".join([name, *others, *(done.speckle.rivals if name in done.speckle.names else [])])


def _joined(names: list[str]) -> str:
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else "".join(names)


def _meanings(done: Diagnosed) -> list[str]:
    """What the names of the verdict mean."""
    held = [name for name in done.diagnosis.held if name not in done.not_established]
    meanings = []
    for name in held:
        kind, of = kind_of(name), object_of(name)
        alone = ", fitted to this test view alone" if name in done.diagnosis.of_test_views else ""
        meanings.append(f"{kind}{f' of {of}{alone}' if of else ''}: {summary_of(kind)}")
    speckle = f"{done.speckle.words[0].upper()}{done.speckle.words[1:]}."
    return [*([f"{'; '.join(meanings)}."] if meanings else []), *([speckle] if done.speckle.names else [])]


def _speckle_alone(done: Diagnosed) -> bool:
    """Whether the model is as it was, and its speckle is not."""
    return bool(done.speckle.names) and not done.diagnosis.held and not done.unexplained


def _pictures(done: Diagnosed, number: int) -> str:
    """Residual before and after, and the measured image; where nothing changed, the residual, the image and the model.

    All on the same axes, both residuals on one scale.
    """
    before, after = done.models[0][number], done.models[-1][number]
    shown = {"residual before": before, "residual after": after} if done.changed else {"residual": after}
    if _speckle_alone(done):
        residuals = {
            name: np.where(image.usable & image.interior, image.residual, np.nan) for name, image in shown.items()
        }
        reach, unit, label = REACH_SD, "", "standard deviations"
    else:
        in_the_dark = done.unexplained and done.left.where == "dark"
        residuals = {name: averaged_ratio_db(image, in_the_dark) for name, image in shown.items()}
        reach = reach_db([one[np.isfinite(one)] for one in residuals.values()], PERCENT)
        unit, label = " dB", "measured / modelled"
    coloured = {name: residual_rgb(one, reach) for name, one in residuals.items()}
    if done.unexplained and done.left.image == after.name:
        last = list(coloured)[-1]
        coloured[last] = html_image.framed(coloured[last], done.left.shape.rectangle)
    scene = done.diagnosis.scene
    powers = {"measured": after.measured}
    on_mesh: list[np.ndarray | None] = [None]
    if not done.changed:
        powers["modelled"] = after.simulated
        on_mesh.append(covered_in(scene, Stage.of(scene, done.diagnosis.setup.device), after.view))
    greys, key = beta0_rgb(list(powers.values()), on_mesh)
    axes = image_axes(scene)
    pictures = [
        html_image.image(report.png(rgb), name, *axes)
        for name, rgb in (coloured | dict(zip(powers, greys, strict=True))).items()
    ]
    return report.row(*pictures, across=3) + report.row(residual_scale(reach, label, unit), key, across=3)
