"""`warpsar diagnose`: which effect the measured images hold and the scene does not declare."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpsar.diagnosis.found import Candidate, DiagnoseOptions, Diagnosis, Step
from warpsar.diagnosis.judge import ROLES, Judged, difference, pool
from warpsar.diagnosis.procedure import diagnose_scene
from warpsar.diagnosis.report import write_report
from warpsar.diagnosis.result import Diagnosed, Moved, judged, moved_parameters, why_not
from warpsar.effects.registry import get
from warpsar.learning.identify import Identified
from warpsar.runtime import distributed
from warpsar.simulation.outputs import opened, write_json

if TYPE_CHECKING:
    pass


def run(
    scene_path: Path | str, out: Path | str, *, device: str | None = None, options: DiagnoseOptions | None = None
) -> dict[str, Any]:
    """`warpsar diagnose`: diagnosis.json, scene.toml with the added effects and report.html in `out`. Returns the
    JSON's content; of several processes, the first one judges and writes, and the others return nothing."""
    started = time.perf_counter()
    options = options or DiagnoseOptions()
    scene, out, where = opened(scene_path, out, device)
    ranks = distributed.ranks(where)
    found = diagnose_scene(scene, where, options, ranks)

    def written() -> dict[str, Any]:
        if not ranks.first:
            return {}
        done = judged(found)
        moves, identified = moved_parameters(found)
        found.final.scene.save(out / "scene.toml")
        content = content_of(done, moves, identified, options) | {"processes": ranks.size}
        content = write_json(out / "diagnosis.json", scene, where, options.seed, started, content)
        write_report(out / "report.html", done, moves, content, command_line(scene_path, out, where.alias, options))
        print(in_short(done), file=sys.stdout)
        return content

    return ranks.agree(written)


def command_line(scene_path: Path | str, out: Path, device: str, options: DiagnoseOptions) -> list[str]:
    """The words that make this run again."""
    words = ["warpsar", "diagnose", str(scene_path), "-o", str(out), "--device", device, "--seed", str(options.seed)]
    words += ["--family-error", f"{options.family_error:g}", "--draws", str(options.draws)]
    return [*words, "--starts", str(options.starts), "--most-effects", str(options.most_effects)]


def in_short(done: Diagnosed) -> str:
    """One line: the verdict, and what it did to the views that decided nothing."""
    found = done.diagnosis
    text = ", ".join(found.verdict) or "nothing missing"
    if found.unexplained:
        text = f"{', '.join(found.verdict)}; and something is unexplained" if found.verdict else "unexplained"
    for role in reversed(ROLES):
        before, after = done.before[role], done.after[role]
        if before is not None and after is not None:
            return (
                f"{text}; {role} deviance {before['deviance']:.4f} -> {after['deviance']:.4f} "
                f"+- {after['deviance_error']:.4f}"
            )
    return text


def content_of(
    done: Diagnosed, moves: Sequence[Moved], identified: Identified, options: DiagnoseOptions
) -> dict[str, Any]:
    """What diagnosis.json holds beside version, device, seed, time and hash."""
    found = done.diagnosis
    last = found.steps[-1]
    added = [step for step in found.steps if step.fitted is not None]
    untestable = [c for c in last.candidates if c.testability != "testable"]
    return {
        "options": asdict(options),
        "verdict": found.verdict,
        "unexplained": found.unexplained,
        "before": done.before,
        "after": done.after,
        "gain": {role: _gain(done.models[0], done.models[-1], role) for role in ROLES},
        "steps": [
            _step(step, options, done.models[k], done.models[k + 1], final=step is added[-1])
            for k, step in enumerate(added)
        ],
        "candidates": [_candidate(c) for c in found.steps[0].candidates]
        + [
            {"effect": name, "testability": "declared", "statistic": None, "p_value": None}
            for name in found.scene.effects
        ],
        "not_testable": [c.effect for c in untestable],
        "not_testable_because": {c.effect: why_not(c) for c in untestable},
        "turns": [
            {
                "threshold": step.threshold,
                "scan": {"z": step.spot.z, "minus_log_p": step.scan_minus_log_p, "p_value": step.p_scan},
                "candidates": [_candidate(c) for c in step.candidates],
                "added": step.added,
                "dropped": step.dropped,
            }
            for step in found.steps
        ],
        "left_at_the_end": {
            "p_value": last.p_scan,
            "minus_log_p": last.scan_minus_log_p,
            "threshold": last.threshold,
            **asdict(done.place),
        },
        "materials": {
            material: {
                m.key: {
                    "before": m.before,
                    "before_sd_log": m.before_sd,
                    "after": m.after,
                    "after_sd_log": m.after_sd,
                    "moved_sds": m.sds,
                }
                for m in moves
                if m.material == material
            }
            for material in found.scene.materials
        },
        "effects": found.final.scene.effects,
        "identifiability": identified.summary(),
        "rays_per_pixel": found.density.rays_per_pixel,
        "rays_chosen": found.density.chosen,
        "ray_noise": found.density.noise,
        "images": [_image(done, k) for k in range(len(done.models[0]))],
        "per_view_effects_on_test_views": _per_view_note(found),
    }


def _gain(before: Sequence[Judged], after: Sequence[Judged], role: str) -> dict[str, float] | None:
    pair = difference(before, after, role)
    return None if pair is None else {"deviance": pair[0], "error": pair[1]}


def _candidate(c: Candidate) -> dict[str, Any]:
    left = c.left_out
    return {
        "effect": c.effect,
        "testability": c.testability,
        "statistic": c.statistic,
        "p_value": c.p_value if c.testability == "testable" else None,
        "minus_log_p": c.minus_log_p,
        "eta": c.eta,
        "resembles": c.resembles,
        "refit_gain": c.refit_gain,
        "refit_size": c.refit_size,
        "left_out": None if left is None else {**asdict(left), "passed": left.passed},
        "carried_over": c.carried,
        "note": c.note,
    }


def _step(
    step: Step, options: DiagnoseOptions, before: Sequence[Judged], after: Sequence[Judged], *, final: bool
) -> dict[str, Any]:
    chosen = next(c for c in step.candidates if c.effect == step.added)
    assert step.fitted is not None
    train, test = pool(after, "train"), pool(after, "test")
    assert train is not None
    return {
        **_candidate(chosen),
        "threshold": step.threshold,
        "family_error": options.family_error,
        "parameters": step.fitted.scene.effects[chosen.effect],
        "train_deviance": train["deviance"],
        "train_deviance_error": train["deviance_error"],
        "test_deviance": None if test is None else test["deviance"],
        "test_deviance_error": None if test is None else test["deviance_error"],
        "gain": {role: _gain(before, after, role) for role in ROLES},
        "refitted": [c.effect for c in step.candidates if c.refit_gain is not None],
    }


def _image(done: Diagnosed, k: int) -> dict[str, Any]:
    before, after = done.models[0][k], done.models[-1][k]
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


def _per_view_note(found: Diagnosis) -> str | None:
    """Effects with a number for each view say nothing of views that no fit has touched."""
    mine = [name for name in found.final.scene.effects if any(p.per_view for p in get(name).parameters)]
    if not mine or not any(v.role == "test" and v.images for v in found.scene.views):
        return None
    return (
        f"{', '.join(mine)}: one number per view, which cannot come from other views; on test views it stays at its "
        f"default, so their deviance says nothing of it"
    )
