"""report.html of `warpsar diagnose`: what was found, why it is believed, and what is left, for one who doubts it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.diagnosis.carried import is_carried
from warpsar.diagnosis.found import Candidate, Turn
from warpsar.diagnosis.judge import ROLES, Judged
from warpsar.diagnosis.place import residual_on
from warpsar.diagnosis.result import SAME_SD, Diagnosed, Moved, why_not
from warpsar.effects.registry import get
from warpsar.evaluation.image import ratio_db
from warpsar.evaluation.meshview import look
from warpsar.io import html as report
from warpsar.io.figures import new
from warpsar.surface.stage import Stage

if TYPE_CHECKING:
    from matplotlib.figure import Figure


RESIDUAL_COLOURS = "RdBu_r"
SIDES_DEG = ((205.0, 45.0), (25.0, 45.0))  # azimuth and incidence of the two looks at the mesh: askew to the compass
MOST_RESEMBLING = 4
SURFACE_REACH_DB = 3.0  # of averages over 5 x 5 pixels and several views
UNITS = {"eps_r": ("eps_r", 1.0), "rms_height_m": ("h [mm]", 1e3), "correlation_length_m": ("l [mm]", 1e3)}
ROLE_WORDS = {"train": "train", "test": "test (decided nothing)"}


def write_report(
    path: Path, done: Diagnosed, moves: Sequence[Moved], content: dict[str, Any], command: Sequence[str]
) -> None:
    """`content` is that of diagnosis.json, `command` the words that made it."""
    found = done.diagnosis
    title = f"What {Path(found.scene.path or 'the scene').name} lacks: {', '.join(found.verdict) or _nothing(done)}"
    lead = (
        f"warpsar {content['version']} diagnose; {len(done.models[0])} images of {found.scene.grid.shape[0]} x "
        f"{found.scene.grid.shape[1]} pixels, {content['rays_per_pixel']:.3g} rays per pixel, on {content['device']}"
    )
    sections = [
        _summary(done, content),
        _pictures(done),
        *(_turn(turn, number, done, content) for number, turn in enumerate(found.turns)),
        _parameters(done, moves, content),
        _not_tested(found.turns[-1]),
        _left(done),
        report.reproduce(
            content, command, "Beside this file: diagnosis.json (all numbers), scene.toml (the model at the end)."
        ),
    ]
    report.write(path, report.page(title, lead, *sections))


def _nothing(done: Diagnosed) -> str:
    return "something unexplained" if done.diagnosis.unexplained else "nothing"


def plus_minus(value: float, error: float) -> str:
    """A value and its standard error, to the digits that mean something."""
    digits = int(np.clip(1 - np.floor(np.log10(max(abs(error), 1e-6))), 0, 4))
    return f"{value:.{digits}f} ±\u00a0{error:.{digits}f}"


def _g(value: float | None) -> str:
    return "–" if value is None or not np.isfinite(value) else f"{value:.3g}"


def _said(table: Any) -> str:
    """An effect's table in one line, numbers to four digits."""
    if isinstance(table, dict):
        return ", ".join(f"{key} {_said(value)}" for key, value in table.items())
    return f"{table:.4g}" if isinstance(table, float) else str(table)


def _p(value: float, content: dict[str, Any]) -> str:
    """A p-value by bootstrap, which ends at one over its draws."""
    least = 1.0 / (content["options"]["draws"] + 1)
    return f"< {least:.2g}" if value <= 1.01 * least else f"{value:.2g}"


# In short


def _summary(done: Diagnosed, content: dict[str, Any]) -> str:
    found = done.diagnosis
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
                plus_minus(gain["deviance"], gain["error"]) if found.verdict else "–",
                f"{before['rmse_db']:.2f} → {after['rmse_db']:.2f}",
                f"{before['correlation']:.3f} → {after['correlation']:.3f}",
            ]
        )
    head = ["views", "images", "pixels", "deviance before", "deviance after", "difference", "rmse [dB]", "correlation"]
    explained = (
        "Deviance is the mean of 2 L (I/mu - 1 - ln(I/mu)) over what speckle alone would leave: 1 is a perfect model. "
        "Before: the declared model at its best fit. After: with everything that was added, all parameters fitted "
        "again. Both on the same pixels, frozen from the declared model before the first fit: lit with all eight "
        "neighbours, off the image's edge. ± is one standard error, with the correlation of neighbouring pixels; that "
        "of the difference is smaller, because both models meet the same speckle. Test views were looked at once, "
        f"after the last decision. Rays: {content['rays_per_pixel']:g} per pixel; looks x pixels x relative sampling "
        f"variance of the model is {content['ray_noise']:.2g} over all train pixels: about what rays add to 2 ln L."
    )
    words = [report.paragraph(text) for text in _verdict(done, content)]
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
    if not found.scene.grid.calibrated:
        words.append(
            report.paragraph("The images are not calibrated: each has a gain of its own, fitted, on test views too.")
        )
    return report.section("In short", *words, report.table(head, rows), report.paragraph(explained, quiet=True))


def _verdict(done: Diagnosed, content: dict[str, Any]) -> list[str]:
    found = done.diagnosis
    error = 100.0 * content["options"]["family_error"]
    said = []
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
        tables = _said(step["parameters"])
        doubt = f" But {step['note']}." if is_carried(step["effect"], step["carried_over"] or 0.0) else ""
        said.append(f"Added: {step['effect']} ({get(step['effect']).summary}), with {tables}.{held}{doubt}")
    said += [
        f"Dropped again, being needless beside {turn['added']}: {name}."
        for turn in content["turns"]
        for name in turn["dropped"]
    ]
    if not said and any(c.refit_gain is not None for c in found.turns[0].candidates):
        said.append(
            "Nothing was added: none of the effects that passed the threshold held; the sections on the turns say why."
        )
    elif not said:
        said.append(
            "Nothing was added: no effect of the library explains what is left better than chance would, at a family "
            f"error rate of {error:g} %."
        )
    if found.unexplained:
        said.append(
            "Something is left that no effect of the library explains. It is not given a name; the section before the "
            "last says where it is."
        )
    elif found.turns[-1].added is None:
        said.append("What is left at the end looks like speckle, to the tests made here.")
    else:
        said.append("The limit of added effects was reached: whether anything is left was not asked.")
    return said


# Pictures


def _pictures(done: Diagnosed) -> str:
    first, last = done.models[0], done.models[-1]
    grid = done.diagnosis.scene.grid
    height, width = (n * s for n, s in zip(grid.shape, grid.spacing_m, strict=True))
    reach = _reach(first)
    same = not done.diagnosis.verdict
    blocks = [
        report.paragraph(
            f"Measured over modelled power on the compared pixels, grey elsewhere; one scale for all. The radar is at "
            f"the top: range runs down ({height:g} m), azimuth across ({width:g} m)."
            + (" Nothing was added, so there is no second picture." if same else "")
        ),
        report.scale(RESIDUAL_COLOURS, [f"-{reach:g}", "0", f"+{reach:g} dB"], "measured / modelled"),
    ]
    cells = []
    for before, after in zip(first, last, strict=True):
        name = f"{before.name}, {before.role}"
        pair = [("before", before)] if same else [("before", before), ("after", after)]
        cells += [
            report.picture(
                _residual_png(image, reach),
                f"{name}, {when}: deviance {image.scaled_deviance.mean():.3f}",
                aspect=width / height,
            )
            for when, image in pair
        ]
    return report.section("The residual before and after", *blocks, report.row(*cells))


def _residual_db(image: Judged) -> np.ndarray:
    return np.where(image.seen.interior, ratio_db(image.seen.measured, image.modelled), np.nan)


def _residual_png(image: Judged, reach: float) -> bytes:
    return report.png(report.colour(_residual_db(image), RESIDUAL_COLOURS, -reach, reach))


def _reach(images: Sequence[Judged]) -> float:
    """End of the residual's colour scale [dB]: 98 % of the compared pixels are inside, whole dB, at least 3."""
    residual = np.concatenate([np.abs(_residual_db(i)[i.seen.interior]) for i in images])
    return float(np.clip(np.ceil(np.percentile(residual, 98.0)), 3.0, 30.0))


# Turns


def _turn(turn: Turn, number: int, done: Diagnosed, content: dict[str, Any]) -> str:
    effects = turn.base.scene.effects
    about = f"with {', '.join(effects)}" if effects else "as declared"
    tested = [c for c in turn.candidates if c.testability == "testable"]
    draws, error = content["options"]["draws"], 100.0 * content["options"]["family_error"]
    said = (
        f"The model {about}, fitted. Every effect's template (what it would change in the images to first order, "
        f"rendered with rays of its own) is compared with what is left, after what the fitted parameters imitate is "
        f"taken out of both. Scores are -ln p, calibrated by {draws} draws of speckle with the residual's own "
        f"correlation; anything over {turn.threshold:.1f} turns up by chance in {error:g} % of scenes, all effects "
        f"and the scan taken together. A score says that a template fits, not that it is the cause: the best are "
        f"refitted fully, and have to help on views left out."
    )
    blocks = [
        report.paragraph(said),
        report.row(
            report.drawing(_bars(turn, tested), f"What each effect scored in turn {number + 1}", show=False),
            across=2,
            least_px=300,
        ),
        _candidate_table(turn, tested, content),
    ]
    blocks += [report.paragraph(text) for text in _why(turn, tested)]
    return report.section(f"Turn {number + 1}: what each effect scored", *blocks)


def _bars(turn: Turn, tested: Sequence[Candidate]) -> Figure:
    """Calibrated scores as bars, the threshold as a line; linear below it, logarithmic above."""
    named = [(c.effect, max(0.0, c.minus_log_p), c.effect == turn.added) for c in tested]
    named = sorted(named, key=lambda item: item[1])
    named.append(("scan for anything", max(0.0, turn.scan_minus_log_p), False))
    figure, axis = new(6.4, 0.9 + 0.24 * len(named))
    scores = [score for _, score, _ in named]
    colours = ["C0" if added else ("0.45" if score > turn.threshold else "0.75") for _, score, added in named]
    axis.barh(range(len(named)), scores, color=colours, height=0.7)
    axis.axvline(turn.threshold, color="C3", lw=1.2)
    axis.set_xscale("symlog", linthresh=2.0 * turn.threshold, linscale=2.0)
    most = max([*scores, 2.0 * turn.threshold])
    axis.set_xlim(0.0, 2.2 * most)
    ticks = [0.0, 5.0, 10.0, *(10.0**k for k in range(2, 7) if 10.0**k <= 2.0 * most)]
    axis.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axis.minorticks_off()
    axis.set_yticks(range(len(named)), [name for name, _, _ in named])
    for k, score in enumerate(scores):
        axis.text(score, k, f" {score:.1f}" if score < 100 else f" {score:.0f}", va="center", fontsize=7)
    axis.set_xlabel("score: -ln p   (blue: added; red line: threshold)")
    axis.grid(axis="x", alpha=0.3, lw=0.4)
    return figure


def _candidate_table(turn: Turn, tested: Sequence[Candidate], content: dict[str, Any]) -> str:
    rows = []
    for c in sorted(tested, key=lambda c: -c.minus_log_p):
        alike = c.resembles[:MOST_RESEMBLING]
        rows.append(
            [
                c.effect,
                f"{max(0.0, c.minus_log_p):.1f}",
                _p(c.p_value, content),
                f"{100 * c.eta:.3g} %",
                "–" if c.refit_gain is None else f"{c.refit_gain:+,.0f} ({c.refit_size})",
                "–" if c.left_out is None else plus_minus(c.left_out.gain, c.left_out.error),
                ", ".join(alike) or "–",
                c.note or "–",
            ]
        )
    rows.append(
        [
            "scan for anything",
            f"{turn.scan_minus_log_p:.1f}",
            _p(turn.p_scan, content),
            *["–"] * 4,
            f"z {turn.spot.z:+.1f}",
        ]
    )
    head = ["effect", "-ln p", "p (family)", "its own", "refit, 2 ln L", "views left out, ln L", "alike", "note"]
    caption = (
        "its own: share of the template that the surface's parameters cannot imitate. refit: gain of the full fit, and "
        "by how many parameters. alike: effects whose templates the data hardly tell from this one."
    )
    return report.table(head, rows, caption)


def _why(turn: Turn, tested: Sequence[Candidate]) -> list[str]:
    refitted = sorted((c for c in tested if c.refit_gain is not None), key=lambda c: -(c.refit_gain or 0.0))
    said = []
    if turn.added is not None:
        winner = next(c for c in refitted if c.effect == turn.added)
        others = [f"{c.effect} {c.refit_gain:+,.0f}" for c in refitted if c is not winner]
        text = f"{winner.effect} was added: fitted fully it gains {winner.refit_gain:,.0f} in 2 ln L"
        text += (
            f", the others that were fitted {', '.join(others)}"
            if others
            else "; no other effect came near the threshold"
        )
        top = max(tested, key=lambda c: c.minus_log_p)
        if winner.left_out is None:
            text += f". {winner.note}, which no model without such an effect can hold, so that nothing else was asked"
        elif top is not winner:
            text += f". {top.effect} scored higher before the fit, but fits worse"
        said.append(text + ".")
        said += [f"{name}, added before, is needless beside {winner.effect}, and was dropped." for name in turn.dropped]
    elif refitted:
        said.append(
            f"Nothing was added: what passed the threshold ({', '.join(c.effect for c in refitted)}) gained less "
            f"likelihood than its parameters cost, or was refused."
        )
    else:
        said.append("No effect passed the threshold: nothing was added, and the search ends here.")
    for c in refitted:
        if c.left_out is not None and c.effect != turn.added:
            why = "it does not help on views left out by more than two standard errors"
            said.append(f"{c.effect} was refused: {c.note if c.left_out.passed else why}.")
    return said


# Parameters


def _parameters(done: Diagnosed, moves: Sequence[Moved], content: dict[str, Any]) -> str:
    rows = []
    for move in moves:
        label, factor = UNITS.get(move.key, ("tau", 1.0))
        row = [f"{move.material}: {label}"]
        for value, sd in ((move.before, move.before_sd), (move.after, move.after_sd)):
            row.append(f"{_g(value * factor)} {_percent(sd)}")
        row.append("–" if not done.diagnosis.verdict else f"{move.move:+.2f}")
        row.append("–" if not done.diagnosis.verdict or not np.isfinite(move.sds) else f"{move.sds:+.1f}")
        rows.append(row)
    head = ["parameter", "before", "after", "move (ln)", "in standard deviations"]
    caption = (
        "In brackets: one standard deviation, from the speckle that was found; –: the data do not determine it alone."
    )
    blocks = []
    if done.diagnosis.final.scene.effects:
        tables = [[name, _said(table)] for name, table in done.diagnosis.final.scene.effects.items()]
        blocks.append(report.table(["effect", "parameters, fitted"], tables))
    blocks.append(report.table(head, rows, caption))
    far = [m for m in moves if np.isfinite(m.sds) and abs(m.sds) > SAME_SD]
    if done.diagnosis.verdict:
        said = (
            f"{len(far) or 'None'} of {len(moves)} surface parameters moved by more than {SAME_SD:g} standard "
            f"deviations when what was missing was added"
            + (": so far had they been pulled by leaving it out." if far else ".")
        )
        blocks.append(report.paragraph(said))
    blocks.append(report.bullets(content["identifiability"]["words"]))
    return report.section("How the surface parameters moved", *blocks)


def _percent(sd: float) -> str:
    return f"(± {100 * sd:.2g} %)" if np.isfinite(sd) and sd < 1.0 else "(–)"


def _not_tested(turn: Turn) -> str:
    items = [f"{c.effect}: {why_not(c)}" for c in turn.candidates if c.testability != "testable"]
    said = "Not found is not absent. Of these effects nothing can be said from these views, with the model as it ended:"
    if not items:
        return report.section(
            "What could not be tested", report.paragraph("Every effect of the library could be tested.")
        )
    return report.section("What could not be tested", report.paragraph(said), report.bullets(items))


# What is left


def _left(done: Diagnosed) -> str:
    found, where = done.diagnosis, done.place
    last = found.turns[-1]
    text = (
        f"The strongest window of {where.window} x {where.window} pixels is in {where.view} {where.polarization} at "
        f"row {where.row}, column {where.col} (range {where.range_m:+.1f} m, azimuth {where.azimuth_m:+.1f} m): "
        f"measured over modelled {where.ratio_db:+.2f} dB, z {where.z:+.1f}, score {last.scan_minus_log_p:.1f} against "
        f"a threshold of {last.threshold:.1f}."
    )
    surface = [c.effect for c in last.candidates if c.shared]
    verdict = (
        f"What was tried as {' and '.join(surface)} lies on the surface: something the mesh lacks is left unexplained."
        if found.unexplained and surface
        else "Nothing in the library explains it: it is left unexplained."
        if found.unexplained
        else "Speckle alone leaves such a window somewhere: nothing has to be explained."
        if last.scan_minus_log_p <= last.threshold
        else "The limit of added effects was reached before it was explained."
    )
    blocks = [report.paragraph(f"{text} {verdict}")]
    if where.parts:
        rows = []
        for p in where.parts:
            extent = " × ".join(f"{b - a:.1f}" for a, b in zip(p.low_m, p.high_m, strict=True))
            rows.append([p.material, f"{100 * p.share:.0f} %", *(f"{c:.1f}" for c in p.centre_m), extent])
        head = ["surface in the window", "of its lit area", "east [m]", "north [m]", "up [m]", "extent [m]"]
        blocks.append(report.table(head, rows, "World coordinates of what is lit in that window"))
        rows = [
            [
                v["image"],
                v["role"],
                str(v["row"]),
                str(v["col"]),
                "–" if not np.isfinite(v["ratio_db"]) else f"{v['ratio_db']:+.2f}",
            ]
            for v in where.views
        ]
        head = ["image", "role", "row", "column", "measured / modelled [dB]"]
        blocks.append(report.table(head, rows, "The same place in every view, whether it is seen there or not"))
    else:
        blocks.append(report.paragraph("No surface is lit there."))
    reach = SURFACE_REACH_DB
    stage = Stage.of(found.final.scene, found.bench.device)
    pictures = []
    for at in SIDES_DEG:
        side = look(stage, *at)
        shades = report.colour(residual_on(side, found, done.models[-1]), RESIDUAL_COLOURS, -reach, reach)
        pictures.append(report.picture(report.png(side.paint(shades)), f"what is left, from azimuth {at[0]:g}°"))
    blocks += [
        report.paragraph(
            "What is left on the surface: measured over modelled power, averaged over 5 x 5 pixels and the train views "
            "that see the place; grey where none does."
        ),
        report.scale(RESIDUAL_COLOURS, [f"-{reach:g}", "0", f"+{reach:g} dB"], "measured / modelled"),
        report.row(*pictures, across=2),
    ]
    return report.section("What is left at the end, and where", *blocks)
