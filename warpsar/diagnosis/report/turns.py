"""One turn in diagnose's report: what each effect scored, what was refitted, and why one was added or refused."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from warpsar.diagnosis.found import Candidate, Turn
from warpsar.diagnosis.geometry.registry import is_geometry
from warpsar.diagnosis.search.outcome import by_score, gain_text, outcome, passed, score_text
from warpsar.evaluation.report_parts import plus_minus
from warpsar.io import html as report

MOST_RESEMBLING = 4


def turn_section(turn: Turn, number: int, content: dict[str, Any]) -> str:
    effects = turn.base.scene.effects
    about = f"with {', '.join(effects)}" if effects else "as declared"
    tested = [c for c in turn.candidates if c.testability == "testable" and not is_geometry(c.effect)]
    error = 100.0 * content["options"]["family_error"]
    sentences = (
        f"The model {about}, fitted. Every effect's template (its change of the images to first order, "
        f"rendered with rays of its own) is compared with the residual, after the part that fitted parameters imitate "
        f"is taken out of both. Scores are -ln p, calibrated by {turn.draws} draws of speckle with the residual's own "
        f"correlation; anything over {turn.threshold:.1f} turns up by chance in {error:g} % of scenes, all effects "
        f"and the scan taken together. A score says that a template fits, not that it is the cause: the "
        f"likeliest is added on trial, and has to hold beside all others at the end."
    )
    blocks = [
        report.paragraph(sentences),
        _bars(turn, tested),
        _candidate_table(turn, tested),
    ]
    blocks += [report.paragraph(text) for text in _why(turn)]
    return report.section(f"Turn {number + 1}: the score of each effect", *blocks)


def _bars(turn: Turn, tested: Sequence[Candidate]) -> str:
    """Calibrated scores as bars, the threshold as a line; linear up to twice the threshold, logarithmic above."""
    named = [(c.effect, max(0.0, c.minus_log_p), c.effect == turn.added) for c in tested]
    named = sorted([("scan for anything", max(0.0, turn.scan_minus_log_p), False), *named], key=lambda one: -one[1])
    linear = 2.0 * turn.threshold
    most = max(linear, *(score for _, score, _ in named))

    def length(score: float) -> float:
        return score / linear if score <= linear else 1.0 + 0.5 * float(np.log2(score / linear))

    bars = [
        report.Bar(name, length(score) / length(most), f"{score:.1f}" if score < 100 else f"{score:.0f}", added)
        for name, score, added in named
    ]
    key = f"score, -ln p, with a line at the threshold of {turn.threshold:.1f}; logarithmic above {linear:.1f}"
    return report.bars(bars, length(turn.threshold) / length(most), f"{key}; blue: added")


def _candidate_table(turn: Turn, tested: Sequence[Candidate]) -> str:
    rows = []
    for c in sorted(tested, key=lambda c: -c.minus_log_p):
        alike = c.resembles[:MOST_RESEMBLING]
        rows.append(
            [
                c.effect,
                score_text(c.minus_log_p),
                _p(c.p_value, turn),
                f"{100 * c.eta:.3g} %",
                "–" if c.refit_gain is None else f"{gain_text(c)} ({c.refit_size})",
                "–" if c.left_out is None else plus_minus(c.left_out.gain, c.left_out.error),
                ", ".join(alike) or "–",
                c.note or "–",
            ]
        )
    rows.append(
        [
            "scan for anything",
            score_text(turn.scan_minus_log_p),
            _p(turn.p_scan, turn),
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


def _why(turn: Turn) -> list[str]:
    """A sentence for every effect that passed: why it was added, or was not."""
    chosen = [c for c in by_score(turn) if passed(c, turn)]
    if not chosen:
        return ["No effect passed the threshold: nothing was added, and the search ends here."]
    sentences = [
        f"{c.effect} {'was' if c.effect == turn.added else 'was not'} added: {outcome(c, turn)}." for c in chosen
    ]
    return sentences + [
        f"{name}, added before, is needless beside {turn.added}, and was dropped." for name in turn.dropped
    ]


def _p(value: float, turn: Turn) -> str:
    """A p-value by bootstrap, which ends at one over its draws."""
    least = 1.0 / (turn.draws + 1)
    return f"< {least:.2g}" if value <= 1.01 * least else f"{value:.2g}"
