"""What diagnosis.json holds beside version, device, seed, time and hash."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from warpsar.compare.comparison import Comparison
from warpsar.compare.contract import ROLES
from warpsar.compare.metrics import difference, pool
from warpsar.diagnosis.field_content import fields_content
from warpsar.diagnosis.found import Candidate, DiagnoseOptions, Diagnosis, EffectRival, Turn
from warpsar.diagnosis.geometry.registry import is_geometry
from warpsar.diagnosis.geometry.registry import names as geometry_names
from warpsar.diagnosis.known import known_content
from warpsar.diagnosis.left.words import described
from warpsar.diagnosis.models.movable import MOST_NUMBERS, may_move
from warpsar.diagnosis.models.names import kind_of, object_of
from warpsar.diagnosis.result import Diagnosed, of_role, why_not
from warpsar.diagnosis.search.outcome import outcome
from warpsar.diagnosis.surface_moves import ParameterMove
from warpsar.diagnosis.written_scene import own_materials
from warpsar.effects.registry import get
from warpsar.learning.identify import Identified


def content_of(
    done: Diagnosed, moves: Sequence[ParameterMove], identified: Identified, options: DiagnoseOptions
) -> dict[str, Any]:
    """JSON's types; docs/diagnosis-json.md explains the keys."""
    diagnosis = done.diagnosis
    last = diagnosis.turns[-1]
    rows, columns = done.place.window
    added = list(enumerate(turn for turn in diagnosis.turns if turn.fitted is not None))
    held = {turn.added: (k, turn) for k, turn in added if turn.added in diagnosis.held}  # the last time counts
    last_held = max(held.values(), key=lambda pair: pair[0])[1] if held else None
    untestable = {c.effect: why_not(c) for c in last.candidates if c.testability != "testable"}
    if options.bodies and not may_move(diagnosis.final.problem):
        untestable |= dict.fromkeys(geometry_names(), f"the surface has more than {MOST_NUMBERS} numbers to learn")
    return {
        "options": asdict(options),
        "verdict": done.verdict,
        "not_established": done.not_established,
        "unexplained": done.unexplained,
        "reasons": done.reasons,
        "doubts": done.doubts,
        "judgement": {role: one.content() for role, one in done.verdicts.items()},
        "own_numbers_fitted_to_test_views": done.own_numbers,
        "of_test_views": diagnosis.of_test_views,
        "foretold_test_views": None if done.foretold is None else done.foretold.content(),
        "speckle": asdict(done.speckle),
        "not_asked": diagnosis.not_asked,
        "alternatives": [
            *([one.effect, one.other] for one, _ in done.alternatives),
            *([name, other] for name in done.speckle.names for other in done.speckle.rivals),
        ],
        "alternatives_because": [_rival(one) | {"deciding": by.content()} for one, by in done.alternatives],
        "before": done.before,
        "after": done.after,
        "gain": {role: _gain(done.models[0], done.models[-1], role) for role in ROLES},
        "steps": [
            _addition(turn, options, done.models[k], done.models[-1 if turn is last_held else k + 1], diagnosis)
            for k, turn in held.values()
        ],
        "taken_back": {
            turn.added: candidate.refused
            for _, turn in added
            for candidate in turn.candidates
            if candidate.effect == turn.added and turn.added not in diagnosis.held
        },
        "withdrawn": diagnosis.withdrawn,
        "candidates": [
            *(_candidate(c, diagnosis.turns[0]) for c in diagnosis.turns[0].candidates if not is_geometry(c.effect)),
            *map(_declared, diagnosis.scene.effects),
        ],
        "not_testable": list(untestable),
        "not_testable_because": untestable,
        "turns": [_turn(turn) for turn in diagnosis.turns],
        "left_at_the_end": {
            "p_value": last.p_scan,
            "minus_log_p": last.scan_minus_log_p,
            "threshold": last.threshold,
            **asdict(done.place),
            "window": rows if rows == columns else [rows, columns],
            "dark": None if last.dark is None else asdict(last.dark),
            "description": described(done.left),
        },
        "materials": {
            **{name: {m.key: _moved(m) for m in moves if m.material == name} for name in diagnosis.scene.materials},
            **own_materials(diagnosis, identified),
        },
        **fields_content(diagnosis.declared, diagnosis.final),
        "effects": diagnosis.final.scene.effects,
        "objects": diagnosis.objects,
        "sensor": diagnosis.sensor,
        "identifiability": identified.summary(),
        **known_content(diagnosis, identified),
        "rays_per_pixel": diagnosis.density.rays_per_pixel,
        "rays_chosen": diagnosis.density.chosen,
        "ray_noise": diagnosis.density.noise,
        "images": [_image(*pair) for pair in zip(done.models[0], done.models[-1], strict=True)],
        "per_view_effects_on_test_views": _per_view_note(diagnosis),
    }


def _rival(one: EffectRival) -> dict[str, Any]:
    return {
        "effect": one.effect,
        "other": one.other,
        "gain": one.gain,
        "distance": one.distance,
        "z": one.z,
        "lead": one.margin,
        "error": one.error,
    }


def _gain(before: Sequence[Comparison], after: Sequence[Comparison], role: str) -> dict[str, float] | None:
    pair = difference(of_role(before, role), of_role(after, role))
    return None if pair is None else {"deviance": pair[0], "error": pair[1]}


def _candidate(c: Candidate, turn: Turn) -> dict[str, Any]:
    left = c.left_out
    return {
        "effect": kind_of(c.effect),
        **({"object": object_of(c.effect)} if is_geometry(c.effect) else {}),
        "testability": c.testability,
        "statistic": c.statistic,
        "p_value": c.p_value if c.testability == "testable" else None,
        "minus_log_p": c.minus_log_p,
        "eta": c.eta,
        "resembles": c.resembles,
        "refit_gain": c.refit_gain,
        "refit_size": c.refit_size,
        "left_out": None if left is None else {**asdict(left), "passed": left.passed},
        "carried_over": None if c.carried is None else asdict(c.carried),
        "signature": None if c.signature is None else asdict(c.signature),
        "note": c.note,
        "outcome": outcome(c, turn),
    }


def _declared(effect: str) -> dict[str, Any]:
    return {"effect": effect, "testability": "declared", "statistic": None, "p_value": None}


def _addition(
    turn: Turn,
    options: DiagnoseOptions,
    before: Sequence[Comparison],
    after: Sequence[Comparison],
    diagnosis: Diagnosis,
) -> dict[str, Any]:
    """What a turn added, as the final model has it, and how far the models before and after it are from the
    images."""
    chosen = next(c for c in turn.candidates if c.effect == turn.added)
    train, test = (pool(of_role(after, role)) for role in ROLES)
    assert train is not None
    return {
        **_candidate(chosen, turn),
        "threshold": turn.threshold,
        "family_error": options.family_error,
        "parameters": {**diagnosis.objects, **diagnosis.sensor}[object_of(chosen.effect)]
        if is_geometry(chosen.effect)
        else diagnosis.final.scene.effects[chosen.effect],
        "train_deviance": train["deviance"],
        "train_deviance_error": train["deviance_error"],
        "test_deviance": None if test is None else test["deviance"],
        "test_deviance_error": None if test is None else test["deviance_error"],
        "gain": {role: _gain(before, after, role) for role in ROLES},
        "refitted": [c.effect for c in turn.candidates if c.refit_gain is not None],
    }


def _turn(turn: Turn) -> dict[str, Any]:
    return {
        "threshold": turn.threshold,
        "draws": turn.draws,
        "scan": {"z": turn.spot.z, "minus_log_p": turn.scan_minus_log_p, "p_value": turn.p_scan},
        "candidates": [_candidate(c, turn) for c in turn.candidates],
        "added": turn.added,
        "dropped": turn.dropped,
    }


def _moved(m: ParameterMove) -> dict[str, Any]:
    return {
        "before": m.before,
        "before_sd_log": m.before_sd,
        "after": m.after,
        "after_sd_log": m.after_sd,
        "after_interval_95": list(m.after_95),
        "after_interval_from": m.after_from,
        "moved_sds": m.sds,
    }


def _image(before: Comparison, after: Comparison) -> dict[str, Any]:
    seen = before.seen
    return {
        "name": seen.view.name,
        "role": before.role,
        "polarization": seen.polarization,
        "looks": seen.looks,
        "looks_estimated": seen.looks_estimated,
        "pixels": int(seen.values.size),
        "left_out": seen.left_out,
        "zeros": seen.zeros,
        "dark": int(seen.dark.sum()),
        "gain": after.gain,
        "deviance_before": float(before.scaled_deviance.mean()),
        "deviance_after": float(after.scaled_deviance.mean()),
    }


def _per_view_note(diagnosis: Diagnosis) -> str | None:
    """Effects with a number for each view say nothing of views that no fit has touched."""
    mine = [name for name in diagnosis.final.scene.effects if any(p.per_view for p in get(name).parameters)]
    if not mine or not any(v.role == "test" and v.images for v in diagnosis.scene.views):
        return None
    return (
        f"{', '.join(mine)}: one number per view, which cannot come from other views; on test views it stays at its "
        f"default, so their deviance says nothing of it"
    )
