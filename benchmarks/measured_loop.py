"""What the loops on measured data share: the impulse response that a pixel grid should show, the diagnosis with every
step's scene kept, results that are made once, and tables."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tables

from warpsar.diagnosis.command import command_line, in_short
from warpsar.diagnosis.content import content_of
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.report.page import write_report
from warpsar.diagnosis.result import diagnose, fitted_models
from warpsar.diagnosis.surface_moves import moved_parameters
from warpsar.io.images import replacing
from warpsar.simulation import outputs
from warpsar.world.taper import taper

REACH = 12  # pixels on either side of a point that its kernel is followed
FINE = 40  # places of a point inside a pixel


def impulse_response(x_m: np.ndarray, cell_m: float, window: str) -> np.ndarray:
    """Power of a focused point at distances `x_m`, any shape, 1 at 0: the squared transform of the aperture's taper.

    `cell_m`: c / 2B in range, lambda / 2 (aperture angle) in azimuth."""
    place = (np.arange(400) + 0.5) / 400 - 0.5
    weight = taper(window, place)
    response = (weight * np.exp(2j * np.pi * np.multiply.outer(x_m / cell_m, place))).mean(axis=-1)
    return np.asarray(np.abs(response / weight.mean()) ** 2)


def pixel_kernel(cell_m: float, window: str, spacing_m: float, samples: int, place: float | None = None) -> np.ndarray:
    """Share of a point's power in the pixels about its own, (2 REACH + 1,), sum 1: the impulse response at each of a
    pixel's samples, averaged. The point lies at `place` in its pixel (-1/2 to 1/2); by default everywhere alike."""
    pixel = np.arange(-REACH, REACH + 1.0)[:, None, None]
    sample = ((np.arange(samples) + 0.5) / samples - 0.5)[None, :, None]
    point = (np.arange(FINE) + 0.5) / FINE - 0.5 if place is None else np.array([place])
    kernel = impulse_response((pixel + sample - point) * spacing_m, cell_m, window).mean(axis=(1, 2))
    return np.asarray(kernel / kernel.sum())


def best_width(kernel: np.ndarray, spacing_m: float, window: str) -> float:
    """Full width at half maximum [m] of the `point_spread` that is nearest to a pixel kernel, in least squares."""
    from scipy.optimize import minimize_scalar

    shape, width = {
        "sinc": (lambda t: np.sinc(t) ** 2, 0.8858929413789),
        "taylor": (lambda t: impulse_response(t, 1.0, "taylor"), 1.1874775859198),
        "gaussian": (lambda t: np.exp(-4.0 * np.log(2.0) * t**2), 1.0),
    }[window]
    pixel = np.arange(-REACH, REACH + 1.0) * spacing_m

    def misfit(fwhm_m: float) -> float:
        modelled = shape(width * pixel / fwhm_m)
        return float(np.sum((kernel - modelled / modelled.sum()) ** 2))

    trials = np.linspace(0.3, 4.0, 75) * spacing_m
    start = float(trials[int(np.argmin([misfit(t) for t in trials]))])
    step = trials[1] - trials[0]
    return float(minimize_scalar(misfit, bounds=(start - step, start + step), method="bounded").x)


def half_power_width(profile: np.ndarray, step_m: float) -> float:
    """Full width at half maximum [m] of a finely sampled peak, from its largest sample, linear in between."""
    peak = int(np.argmax(profile))
    half = profile[peak] / 2.0
    ends = []
    for side in (profile[peak:], profile[peak::-1]):
        k = int(np.argmax(side < half))
        ends.append(k - 1 + (side[k - 1] - half) / (side[k - 1] - side[k]))
    return float(sum(ends) * step_m)


def kept(path: Path, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The JSON at `path`; made and written first where it is not there."""
    if not path.exists():
        print(f"{path.stem} ...", file=sys.stderr)
        started = time.process_time()
        content = make() | {"cpu_s": round(time.process_time() - started, 1)}
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8", newline="\n")
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def diagnosed(scene_path: Path, out: Path, options: DiagnoseOptions, device: str | None = None) -> dict[str, Any]:
    """`warpsar diagnose`, with the scene after every addition kept too: step0.toml (the declared model) onwards."""
    started = time.perf_counter()
    scene, out, where = outputs.opened(scene_path, out, device)
    done = diagnose(scene, device=where.alias, options=options)
    for number, fitted in enumerate(fitted_models(done.diagnosis)):
        fitted.scene.save(out / f"step{number}.toml")
    done.diagnosis.final.scene.save(out / "scene.toml")
    moves, identified = moved_parameters(done.diagnosis)
    content = outputs.write_json(
        out / "diagnosis.json", scene, where, options.seed, started, content_of(done, moves, identified, options)
    )
    write_report(out / "report.html", done, moves, content, command_line(scene_path, out, where.alias, options))
    print(in_short(done), file=sys.stderr)
    return dict(content)


def effect_widths(diagnosis: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Learned widths of `point_spread` at the end of a diagnosis, with the 95 % interval: {} where it was not added."""
    table, said = diagnosis["effects"].get("point_spread"), diagnosis["identifiability"]
    found = {}
    for key in ("range_fwhm_m", "azimuth_fwhm_m"):
        if table and key in table:
            deviation = said["standard_deviation"][said["parameters"].index(f"point_spread.{key}")]
            value = float(table[key])
            found[key] = {
                "value_m": value,
                "low_m": value * float(np.exp(-1.96 * deviation)),
                "high_m": value * float(np.exp(1.96 * deviation)),
            }
    return found


def decibels(image: np.ndarray, reference: float) -> np.ndarray:
    """For pictures: 10 log10 of image over reference, -60 where there is nothing."""
    return np.asarray(10.0 * np.log10(np.maximum(image / reference, 1e-6)))


def turns_of(diagnosis: dict[str, Any]) -> list[list[str]]:
    """A line per turn of a diagnosis, for tables: -ln p of the effects that passed, 2 ln L of those that were refitted,
    what was asked of these and came out, and what was added."""
    lines = []
    for number, turn in enumerate(diagnosis["turns"], 1):
        passed = [
            c for c in turn["candidates"] if c["testability"] == "testable" and c["minus_log_p"] > turn["threshold"]
        ]
        passed.sort(key=lambda c: -c["minus_log_p"])
        refitted = [c for c in turn["candidates"] if c["refit_gain"] is not None]
        refitted.sort(key=lambda c: -c["refit_gain"])
        asked = []
        for c in refitted:
            left, over = c["left_out"], c["carried_over"]
            said = [] if left is None or left["views"] < 2 else [f"left out {left['gain']:,.0f} ± {left['error']:,.0f}"]
            said += [] if over is None else [f"carried over {100 * over['share']:.0f} %"]
            asked += [f"{c['effect']}: {', '.join(said)}"] if said else []
        lines.append(
            [
                str(number),
                ", ".join(f"{c['effect']} {c['minus_log_p']:.0f}" for c in passed),
                ", ".join(f"{c['effect']} {c['refit_gain']:+,.0f}" for c in refitted),
                "; ".join(asked),
                turn["added"] or "none",
            ]
        )
    return lines


TURNS = ("turn", "passed: -ln p", "refitted: 2 ln L", "asked", "added")


def rounded(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table whose numbers have three digits."""
    return tables.markdown(head, [[f"{v:.3g}" if isinstance(v, float) else v for v in row] for row in rows])


def written(out: Path, name: str, content: dict[str, Any], bodies: dict[str, str]) -> None:
    """NAME.json and NAME.md in the folder."""
    text = "\n\n".join(f"## {title}\n\n{body}" for title, body in bodies.items())
    for suffix, whole in (("json", json.dumps(content, indent=1)), ("md", text)):
        with replacing(out / f"{name}.{suffix}") as temporary:
            temporary.write_text(f"{whole}\n", encoding="utf-8", newline="\n")
