"""The answer in diagnose's report: what was added, why, and how far the model is from the images before and after."""

from __future__ import annotations

from typing import Any

from warpsar.compare.contract import ROLES
from warpsar.diagnosis.geometry.registry import summary_of
from warpsar.diagnosis.models.carried import Carried
from warpsar.diagnosis.report.next_step import refuted
from warpsar.diagnosis.result import OPEN_WORDS, Diagnosed
from warpsar.diagnosis.search.outcome import effect_table
from warpsar.evaluation.report_parts import plus_minus
from warpsar.io import html as report

_OUTCOME = {"confirmed": "confirmed", "against": "against it", "none": "nothing decisive"}
ROLE_WORDS = {"train": "train", "test": "test (no fit used them)"}
_ROLE_VIEWS = {"train": "Train views", "test": "Test views, which no fit used"}


def summary_section(done: Diagnosed, content: dict[str, Any]) -> str:
    diagnosis = done.diagnosis
    rows = []
    for role in ROLES:
        before, after, gain = done.before[role], done.after[role], content["gain"][role]
        if before is None or after is None or gain is None:
            continue
        rows.append(
            [
                ROLE_WORDS[role],
                str(before["images"]),
                f"{before['pixels']:,}",
                plus_minus(before["deviance"], before["deviance_error"]),
                plus_minus(after["deviance"], after["deviance_error"]),
                plus_minus(gain["deviance"], gain["error"]) if done.changed else "–",
                f"{before['rmse_db']:.2f} → {after['rmse_db']:.2f}",
                f"{before['correlation']:.3f} → {after['correlation']:.3f}",
            ]
        )
    head = ["views", "images", "pixels", "deviance before", "deviance after", "difference", "rmse [dB]", "correlation"]
    explained = (
        "Deviance is the mean of 2 L (I/mu - 1 - ln(I/mu)) over its mean under speckle alone: 1 is a perfect model. "
        "Before: the declared model at its best fit, with the looks of the scene file. After: with all names of the "
        "verdict, all parameters fitted again. Each on its interior: pixels that its surface covers with all eight "
        "neighbours, off the image's edge; the difference on the pixels of both. ± is one standard error, with the "
        "correlation of neighbouring pixels; that of the difference is smaller, because both models meet the same "
        "speckle. warpsar evaluate gives the same numbers of the written scene. Test views were looked at once, after "
        f"the last decision. Rays of the fits: {content['rays_per_pixel']:g} per pixel; looks x pixels x relative "
        f"sampling variance of the model is {content['ray_noise']:.2g} over all train pixels: about what rays add to "
        "2 ln L."
    )
    words = [*_first(done), *(report.paragraph(text) for text in _verdict(done, content))]
    if content["per_view_effects_on_test_views"]:
        words.append(report.paragraph(content["per_view_effects_on_test_views"]))
    zeros = sum(image["zeros"] for image in content["images"])
    if zeros:
        words.append(
            report.paragraph(
                f"{zeros} lit pixels measure exactly 0, which no speckle makes; they are left out of all this."
            )
        )
    if any(image["looks_estimated"] for image in content["images"]):
        words.append(report.paragraph("The looks of the images were not declared; they were estimated."))
    if done.doubts:
        words.append(report.paragraph("Values that mean little, whatever they are:"))
        words.append(report.bullets(done.doubts))
    if not diagnosis.scene.grid.calibrated:
        words.append(
            report.paragraph("The images are not calibrated: each has a gain of its own, fitted, on test views too.")
        )
    blocks = [report.table(head, rows), *_in_the_dark(done), report.paragraph(explained, quiet=True)]
    return report.section("In short", *words, *blocks)


def _in_the_dark(done: Diagnosed) -> list[str]:
    """A table of dark pixels before and after, where there are any."""
    rows = []
    for role in ROLES:
        before, after = done.before[role], done.after[role]
        if before is None or after is None or not before["dark_pixels"]:
            continue
        rows.append(
            [
                ROLE_WORDS[role],
                f"{before['dark_pixels']:,}",
                f"{before['dark_measured']:.3g}",
                f"{before['dark_modelled']:.3g} → {after['dark_modelled']:.3g}",
                f"{before['dark_impossible']} → {after['dark_impossible']}",
                *("–" if one["dark_deviance"] is None else f"{one['dark_deviance']:.3f}" for one in (before, after)),
            ]
        )
    if not rows:
        return []
    head = ["views", "dark pixels", "measured", "modelled", "impossible", "deviance before", "deviance after"]
    caption = (
        "Dark pixels: more than six from anything lit. Measured and modelled: mean beta0. Impossible: power where the "
        "model has none. Deviance: where the model has a trace or more."
    )
    return [report.table(head, rows, caption)]


def _first(done: Diagnosed) -> list[str]:
    """What a reader must know before any name: whether the answer is whole."""
    diagnosis, blocks = done.diagnosis, []
    if done.unexplained:
        names = f" {', '.join(done.verdict)} was found, and does not explain it." if done.verdict else ""
        if not refuted(done):
            blocks.append(report.paragraph(f"A part of the residual has no explanation.{names}"))
        blocks.append(report.bullets([f"{one[0].upper()}{one[1:]}" for one in done.reasons]))
        if done.not_established:
            blocks.append(
                report.paragraph("In the model, but not established: they may stand in for the rest of the residual.")
            )
            blocks.append(report.bullets([f"{name}: {why}" for name, why in done.not_established.items()]))
    elif done.verdict:
        blocks.append(report.paragraph("With these names only speckle is left, to the tests made here."))
    else:
        blocks.append(report.paragraph("Nothing is missing, to the tests made here: the residual looks like speckle."))
    if diagnosis.not_asked:
        blocks.append(report.paragraph("The time was over before all was asked. Not asked:"))
        blocks.append(report.bullets(diagnosis.not_asked))
    if done.speckle.departs:
        blocks.append(report.paragraph(f"{done.speckle.words[0].upper()}{done.speckle.words[1:]}."))
    bullets = [f"{_ROLE_VIEWS[role]}: {one.words}" for role, one in done.verdicts.items() if not one.wrong]
    if done.own_numbers:
        bullets.append("For this, numbers that effects hold for each view by itself were fitted to the test views, too")
    if done.foretold is not None:
        bullets.append(
            f"{OPEN_WORDS[0].upper()}{OPEN_WORDS[1:]}. {done.open_surface[0].upper()}{done.open_surface[1:]}"
        )
    return [*blocks, report.bullets(bullets)] if bullets else blocks


def _named(step: dict[str, Any]) -> str:
    """What was added, and what that means."""
    of = f" of {step['object']}" if "object" in step else ""
    return f"{step['effect']}{of} ({summary_of(step['effect'])})"


def _verdict(done: Diagnosed, content: dict[str, Any]) -> list[str]:
    diagnosis = done.diagnosis
    error = 100.0 * content["options"]["family_error"]
    sentences = []
    for step in content["steps"]:
        left = step["left_out"]
        held = ""
        if left is not None:
            held = (
                f" Each of {left['views']} train views was predicted from the others: with it ln L is higher by "
                f"{plus_minus(left['gain'], left['error'])}, all views together."
                if left["views"] > 1
                else " There is one train view: none could be left out to ask."
            )
        tables = effect_table(step["parameters"])
        over = None if "object" in step else step["carried_over"]
        doubt = f" But {step['note']}." if over and Carried(**over).by_surface(step["effect"]) else ""
        own = step["signature"]
        earned = f" Its own test says: {_OUTCOME[own['outcome']]} ({own['text']})." if own else ""
        sentences.append(f"Added: {_named(step)}, with {tables}.{held}{earned}{doubt}")
    sentences += [
        f"The data do not decide between {one.effect} and {one.other}: in its place it would fit as well, to the "
        f"scatter of that difference under speckle (2 ln L {one.gain:+.1f}). {by.sentence[0].upper()}{by.sentence[1:]}."
        for one, by in done.alternatives
    ]
    if diagnosis.withdrawn:
        sentences.append(
            f"Tried, and not the answer: {', '.join(diagnosis.withdrawn)}. Added, it holds on the train views, but the "
            "test views speak against it."
        )
    sentences += [
        f"Tried, and taken back: {name}. {why[0].upper()}{why[1:]}."
        for name, why in content["taken_back"].items()
        if why
    ]
    sentences += [
        f"Dropped again, being needless beside {turn['added']}: {name}."
        for turn in content["turns"]
        for name in turn["dropped"]
    ]
    if not sentences and any(c.refit_gain is not None for c in diagnosis.turns[0].candidates):
        sentences.append(
            "Nothing was added: no effect that passed the threshold held; the sections on the turns say why."
        )
    elif not sentences:
        sentences.append(
            "Nothing was added: no effect of the library explains the residual better than chance would, at a family "
            f"error rate of {error:g} %."
        )
    sentences += [f"{content['tolerances'][label]['after']['words']}." for label in content["leaves_tolerance"]]
    return sentences
