"""report.html of `warpsar diagnose --folds`: what stays, why, and how well views left out are predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from scipy.ndimage import uniform_filter

from warpsar.compare.aim import Reach
from warpsar.compare.comparison import ratio_db
from warpsar.compare.prediction import THEN, measured_of, predicted, summaries
from warpsar.diagnosis.held_out.glints import PlacedGlint, on_bodies
from warpsar.diagnosis.held_out.search import BOXED, FRONT_ERRORS, HeldOut, TrialStep
from warpsar.diagnosis.known import tension_words
from warpsar.evaluation.report_parts import beta0_rgb, image_axes, reach_db, residual_rgb, residual_scale
from warpsar.evaluation.report_prediction import prediction_table
from warpsar.io import html as report
from warpsar.io import html_image
from warpsar.scene.scene import Scene

SHOWN = 3  # views
SMOOTHED_PX = 3
PERCENT = 98.0  # of the residual, that its scale holds


def sentence(result: HeldOut) -> str:
    """The verdict and what it did to the views left out, in one line."""
    before, after = (float(np.mean(list(each.values()))) for each in (result.before, result.after))
    names = ", ".join(result.held) or "nothing"
    verdict = f"found: {names}; deviance of views left out {before:.3f} -> {after:.3f}"
    if result.untold:
        verdict += f"; cannot be told here: {', '.join(result.untold)}"
    if result.not_asked:
        verdict += "; the time was over before all was asked"
    if result.ended:
        verdict += f"; the search ended early, for {result.ended}"
    fronts = [front_words(label, step) for label, step in result.fronts.items() if not _is_known(step)]
    return "; ".join([verdict, *([_of_body(result)] if result.advantages else []), *fronts])


def _of_body(result: HeldOut) -> str:
    """Whether the model is of this body, in words."""
    pictures, box = result.of_pictures, result.of_box
    if result.undecided:
        return f"no lead is claimed: {_unasked(result)}"
    if result.open:
        return "whether it is this body is not told: it correlates better than every rival, and by deviance it may not"
    if not result.ahead:
        return "not this body"
    if box is None or pictures is None:
        return "predicts better than pictures of other views"
    if box.ahead:
        return "predicts better than pictures of other views and a box"
    return "predicts better than pictures of other views; a box does as well, and nothing but speckle is left"


def _unasked(result: HeldOut) -> str:
    """What an undecided body has not met."""
    return f"{BOXED} was not asked" if result.of_box is None else f"{BOXED} had no search of its own"


def _is_known(step: TrialStep) -> bool:
    return -step.gain > FRONT_ERRORS * step.error


def front_words(label: str, step: TrialStep) -> str:
    """What a body turned round says of its front."""
    change = f"turned round, {label} changes the deviance of views left out by {-step.gain:+.3f} +- {step.error:.3f}"
    return change if _is_known(step) else f"which end of {label} is its front is not told ({change})"


def judgement(result: HeldOut) -> list[str]:
    """How far ahead the model is of each rival, and which numbers leave their tolerances, in words."""
    sentences = [] if result.counting is None else [f"{result.counting.words}; the scene written has them so"]
    sentences += [one.words for one in result.advantages]
    if result.of_box is not None and THEN in result.images[0].predictions:
        sentences[-1] += "; the box was asked before all effects were tried, and is held against the model of that time"
    if result.undecided:
        sentences.append(f"{_unasked(result)}, so no lead is claimed")
    sentences += [one.words for one in result.pulls if one.alarm]
    return [*sentences, *(front_words(label, step) for label, step in result.fronts.items())]


def write_report(
    path: Path,
    result: HeldOut,
    content: dict[str, Any],
    command: Sequence[str],
    device: wp.Device,
) -> None:
    """`content` is that of diagnosis.json, `command` the words that made it."""
    count = sum(len(fold) for fold in result.folds)
    rows, cols = result.scene.grid.shape
    summary = (
        f"{Path(result.scene.path or 'the scene').name}: {count} train views of {rows} x {cols} pixels, left out in "
        f"{len(result.folds)} parts, in arcs of azimuth"
    )
    sections = [
        _in_short(result),
        _pictures(result, device),
        _steps(result),
        *_profiles(result),
        *_glints(on_bodies(result.final)),
        _folds(result),
        report.reproduce(
            content, command, "Beside this file: diagnosis.json (all numbers), scene.toml (the model at the end)."
        ),
    ]
    title = sentence(result)
    report.write(path, report.page(title[0].upper() + title[1:] + ".", summary, *sections))


def _in_short(result: HeldOut) -> str:
    sentences = [
        "Every train view is predicted by a model that has not seen it, nor its neighbours. The rivals need no "
        "physics: the nearest measured view turned as a picture, the same smoothed, the one nearest to the mirrored "
        "azimuth, and the mean of all. The box has the body's extents, and the better of two sets of effects: what was "
        "found for the body, and what a search of its own found. All is fitted anew, sizes too. A body that predicts "
        "no better than the box has told nothing of itself. Turned round, the body is fitted anew in the same way."
    ]
    sentences += [f"The time was over; not asked: {one}." for one in result.not_asked]
    if result.box_held is not None:
        sentences.append(f"The box's own search found: {', '.join(result.box_held) or 'nothing'}.")
    sentences += [f"The search ended before every effect was asked, for {result.ended}."] if result.ended else []
    sentences += [f"{words[0].upper()}{words[1:]}." for words in judgement(result)]
    return report.section("In short", *map(report.paragraph, sentences), prediction_table(summaries(result.images)))


def _pictures(result: HeldOut, device: wp.Device) -> str:
    """Some views, and the residuals of the model as declared and at the end, each at its aim point."""
    train = [view for view in result.scene.views if view.role == "train" and view.images]
    ordered = sorted(train, key=lambda view: view.azimuth_deg % 360.0)
    chosen = [ordered[int(k)] for k in np.linspace(0, len(ordered), min(SHOWN, len(ordered)), endpoint=False)]
    pol = next(iter(chosen[0].images))
    shifts = {image.view.name: image.predictions for image in result.images if image.polarization == pol}
    models: dict[str, list[np.ndarray]] = {
        "before": _planes(result.declared, chosen, pol, device),
        "after": _planes(result.final, chosen, pol, device),
    }
    reach = Reach.of(result.scene)
    grid = result.scene.grid
    shape = reach.window(np.empty(grid.shape)).shape
    axes = image_axes(replace(result.scene, grid=grid.model_copy(update={"shape": shape}), views=[]))
    rows: list[tuple[str, np.ndarray, dict[str, np.ndarray]]] = []
    for number, view in enumerate(chosen):
        measured = measured_of(result.scene, view, pol)
        names: Mapping[str, str] = {"before": "before", "after": "model"}
        planes = {}
        for when, name in names.items():
            at = shifts[view.name][name].at
            plane = reach.window(models[when][number], at)
            power = reach.window(measured)
            use = np.isfinite(power) & (plane > 0.0)
            planes[when] = plane * float(np.median(power[use] / plane[use])) / np.log(2.0)
        rows.append((f"{view.name}: azimuth {view.azimuth_deg:g}°", reach.window(measured), planes))
    residuals = [
        {when: ratio_db(_mean(power), _mean(plane)) for when, plane in planes.items()} for _, power, planes in rows
    ]
    ends = reach_db([each[np.isfinite(each)] for one in residuals for each in one.values()], PERCENT)
    blocks = [
        report.paragraph(
            f"Residual: measured over modelled power, averaged over {SMOOTHED_PX} x {SMOOTHED_PX} pixels, each model "
            "at its own aim point. The radar is at the top. Click on a picture to enlarge it."
        ),
        residual_scale(ends, "measured / modelled"),
    ]
    for (title, power, planes), residual in zip(rows, residuals, strict=True):
        greys, key = beta0_rgb([power, planes["after"]])
        panels = [(name, report.png(rgb)) for name, rgb in zip(("measured", "modelled"), greys, strict=True)]
        panels += [(f"residual {when}", report.png(residual_rgb(each, ends))) for when, each in residual.items()]
        blocks += [
            report.heading(title),
            report.row(*(html_image.image(png, name, *axes) for name, png in panels), report.cell(key), across=5),
        ]
    return report.section("Residuals of train views", *blocks)


def _planes(scene: Scene, views: Sequence[Any], polarization: str, device: wp.Device) -> list[np.ndarray]:
    now = {view.name: view for view in scene.views}
    return [image[polarization] for image in predicted(scene, [now[view.name] for view in views], device)]


def _mean(power: np.ndarray) -> np.ndarray:
    return np.asarray(uniform_filter(np.nan_to_num(power), SMOOTHED_PX, mode="nearest"))


def _steps(result: HeldOut) -> str:
    rows = [
        [
            step.label + (" (asked again)" if step.again else "") + (" (first part)" if step.glance else ""),
            f"{step.gain:+.4f}",
            f"{step.error:.4f}",
            f"{step.noise:.4f}" if step.noise else "",
            "yes" if step.stays else "cannot be told" if step.open else "",
        ]
        for step in result.steps
    ]
    sentences = (
        "In the order in which they were tried. The gain is that of the mean deviance of the views left out, of which "
        "speckle leaves 1. A trial stays if its gain, less its standard error, is above the noise: what a fit with "
        "nothing new gains on other rays. A hypothesis that gains nothing on the first part gets no other fit. Effects "
        "that stay are asked again at the end: each is left out once more, on two draws of rays where one does not "
        "tell, and goes unless it is worth two standard errors over arcs of views and over draws. What gains less "
        "cannot be told here: more views may. Nor can what gained no more than two standard errors "
        "and was not asked again, as the search ended before that."
    )
    head = ("tried", "gain of views left out", "standard error", "noise", "stays")
    return report.section("What was tried", report.paragraph(sentences), report.table(head, rows))


def _profiles(result: HeldOut) -> list[str]:
    if not result.profiles:
        return []
    rows = [
        [
            one.label,
            f"{one.known:.4g} ± {one.known_sd:.2g}",
            f"{one.value:.4g} ± {one.half:.2g}",
            one.unit,
            tension_words(one.pull.content()),
        ]
        for one in result.profiles.values()
    ]
    sentences = (
        "Where the views left out are predicted best, each number moved by itself. ± of what was known is one standard "
        "deviation; of what was found the 95 % interval by a jackknife over arcs of neighbouring views. The last "
        "column: how far from what is known the views left out lead without this tolerance, in standard deviations of "
        "both together. Beyond 3 a number leaves its tolerance, and where it was found three of the tolerance's away."
    )
    head = ("number", "known", "found", "unit", "from what is known")
    return [report.section("Sizes and angles", report.paragraph(sentences), report.table(head, rows))]


def _glints(glints: Sequence[PlacedGlint]) -> list[str]:
    if not glints:
        return []
    rows = [
        [
            one.body,
            *(f"{place:+.2f}" for place in one.place_m),
            "all round" if one.aspect_deg is None else f"{one.aspect_deg:.0f}",
            "" if one.aspect_deg is None else f"{one.half_width_deg:.0f}",
            f"{one.rcs_dbsm:.1f}",
        ]
        for one in glints
    ]
    sentences = (
        "Places that return more than the model says, the strongest first: what on the body is this? The place is in "
        "the body's own frame: across to its right, along to its front, up. The aspect is the radar's azimuth in the "
        "middle of the lobe, clockwise from the front; half is left at the half width. A place is known to about a "
        "cell of resolution, and its height less well. With free gains the level is relative to the scene's surfaces."
    )
    head = ("body", "across [m]", "along [m]", "up [m]", "aspect [deg]", "half width [deg]", "level [dBsm]")
    return [report.section("Glints", report.paragraph(sentences), report.table(head, rows))]


def _folds(result: HeldOut) -> str:
    items = [", ".join(fold) for fold in result.folds]
    return report.section("Views left out together", report.bullets(items))
