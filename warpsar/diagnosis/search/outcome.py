"""What became of every effect in a turn, in words: the console, diagnosis.json and the report say the same."""

from __future__ import annotations

from typing import Any

from warpsar.diagnosis.found import Candidate, Turn
from warpsar.diagnosis.models.left_out import ViewsLeftOut
from warpsar.diagnosis.search.confirmation import Confirmation
from warpsar.evaluation.report_parts import plus_minus

_SIGNATURE = {"confirmed": "its own test confirms it", "none": "its own test does not decide"}


def score_text(score: float) -> str:
    """A score, -ln p."""
    return f"{max(0.0, score):.1f}"


def gain_text(candidate: Candidate) -> str:
    """What the candidate's refit gained in 2 ln L; empty without a refit."""
    return "" if candidate.refit_gain is None else f"{candidate.refit_gain:+,.1f}"


def effect_table(table: Any) -> str:
    """An effect's table in one line, numbers to four digits."""
    if isinstance(table, dict):
        return ", ".join(f"{key} {effect_table(value)}" for key, value in table.items() if value != [])
    if isinstance(table, list) and table and isinstance(table[0], float):
        return f"[{', '.join(map(effect_table, table))}]"
    return f"{table:.4g}" if isinstance(table, float) else str(table)


def passed(candidate: Candidate, turn: Turn) -> bool:
    """Whether the candidate could be the cause: it scored over the threshold, or dark pixels had it fitted."""
    over = candidate.testability == "testable" and candidate.minus_log_p > turn.threshold
    return over or candidate.refit_gain is not None


def by_score(turn: Turn) -> list[Candidate]:
    """The turn's candidates, the one that was added first and then by their scores."""
    return sorted(turn.candidates, key=lambda c: (c.effect != turn.added, -c.minus_log_p))


def outcome(candidate: Candidate, turn: Turn) -> str:
    """Why a candidate was added or was not, with its gain."""
    if candidate.testability == "absent":
        return "no place for it in this scene"
    if candidate.testability == "not_testable":
        return "not testable here"
    if not passed(candidate, turn):
        return f"-ln p {score_text(candidate.minus_log_p)} is not over the threshold of {turn.threshold:.1f}"
    parts = []
    if candidate.refit_gain is not None:
        count = f"{candidate.refit_size} parameter{'' if candidate.refit_size == 1 else 's'}"
        parts.append(f"2 ln L {gain_text(candidate)} for {count}")
    if candidate.left_out is not None and candidate.left_out.views > 1:
        parts.append(f"views left out gain {_plus_minus(candidate.left_out)} in ln L")
    if candidate.signature is not None and candidate.signature.outcome != "against":
        parts.append(f"{_SIGNATURE[candidate.signature.outcome]}: {candidate.signature.text}")
    if candidate.effect != turn.added:
        parts.append(candidate.refused or _not_fitted(turn))
    elif candidate.refused:
        parts.append(f"taken back at the end: {candidate.refused}")
    parts += [note for note in candidate.note.split("; ") if note and note not in parts]
    return "; ".join(parts)


def confirmation_lines(confirmation: Confirmation) -> list[str]:
    """What was asked of the added effects beside each other, for the console."""
    lines = ["every added effect beside all the others:"]
    for one in confirmation.asked:
        parts = [f"2 ln L {one.gain:+,.1f} for {one.size} parameter{'' if one.size == 1 else 's'}"]
        if one.left_out is not None and one.left_out.views > 1:
            parts.append(f"views left out gain {_plus_minus(one.left_out)} in ln L")
        if one.signature is not None and one.signature.outcome != "against":
            parts.append(f"{_SIGNATURE[one.signature.outcome]}: {one.signature.text}")
        parts += [one.refused] if one.refused else []
        parts += [note for note in one.notes if note != one.refused]
        lines.append(f"  {'taken back' if one.refused else 'holds'}: {one.effect}: {'; '.join(parts)}")
    return lines


def _plus_minus(left: ViewsLeftOut) -> str:
    return plus_minus(left.gain, left.error).replace("±\u00a0", "+- ")


def _not_fitted(turn: Turn) -> str:
    """Why a candidate that passed got no full fit."""
    if any(c.refit_gain is not None for c in turn.candidates):
        return "others looked likelier after a few iterations"
    return "the limit of added effects was reached"


def turn_lines(turn: Turn, number: int) -> list[str]:
    """A turn for the console: what was added and dropped, then what was not added, and why. Turns count from 0."""
    lines = [f"turn {number + 1}: " + ("nothing was added" if turn.added is None else f"added on trial: {turn.added}")]
    untestable = [c.effect for c in turn.candidates if c.testability != "testable"]
    under = [c for c in by_score(turn) if c.testability == "testable" and not passed(c, turn)]
    for candidate in by_score(turn):
        if candidate.effect == turn.added:
            assert turn.fitted is not None
            table = turn.fitted.scene.effects.get(candidate.effect, candidate.table)
            lines.append(f"  {candidate.effect}: {effect_table(table)}")
            lines += [f"  dropped: {name}, needless beside {turn.added}" for name in turn.dropped]
        elif passed(candidate, turn):
            lines.append(f"  not added: {candidate.effect}: {outcome(candidate, turn)}")
    if under:
        scores = ", ".join(f"{c.effect} {score_text(c.minus_log_p)}" for c in under)
        lines.append(f"  not over the threshold of {turn.threshold:.1f}: {scores}")
    if untestable:
        lines.append(f"  not testable: {', '.join(untestable)}")
    return lines
