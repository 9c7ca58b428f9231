"""The search for a phase over slow time in complex images: its cost, and how far what it finds is off.

    python benchmarks/phase_search.py [--only cost spread level] [--sides 640 1024 2048] [--draws 24]
    [--out phase_search.json] [--write]

The images are made: speckle with points, or with an edge alone (`tests/phase_images.py`). `cost`: one whole question
(`warpsar.diagnosis.phase.ask.asked`) of square images with points, with an error of 2 pi at the band's edge and without
one, each in a process of its own. Time is that of the processor, so other programs beside it hardly count. `spread`: an
error of 2 pi at the band's edge that all ranges share, and one that goes with the look direction, in draws. Beside the
spread stands what the fit states, and the Cramer-Rao bound of a measurement that knows the power of every place and
searches for the phase alone. `level`: the spread again with none of the spectrum's level taken out, half and all.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
import phase_images
import tables
from phase_images import COLUMNS, TURN, aside_of, folds, image

from warpsar.diagnosis.phase import spectrum
from warpsar.diagnosis.phase.ask import asked, folds_of
from warpsar.diagnosis.phase.fit import QUADRATIC, QUADRATIC_MOTION, deviations, fitted
from warpsar.diagnosis.phase.spectrum import AzimuthSpectrum

PIXELS_OF_A_POINT = 1280
"""As many points for each pixel as the tests' images have."""
SIDES = (640, 1024, 2048)
SPREAD_OF = (("16 points", {"points": 16}, 128), ("an edge", {"edge": True}, 128), ("an edge", {"edge": True}, 512))
DARKEST = 1e-3
"""Of the mean power, taken for noise as the search takes it."""


def cost(sides: list[int], draws: int) -> list[dict[str, Any]]:
    """Each size with an error and without one; each alone in a new process."""
    found = []
    for side in sides:
        for turn in (TURN, 0.0):
            with multiprocessing.get_context("spawn").Pool(1) as alone:
                found.append(alone.apply(_cost, (side, turn)))
            print(json.dumps(found[-1]), flush=True)
    return found


def _cost(side: int, turn: float) -> dict[str, Any]:
    made = image(lambda x: turn * x**2, points=side * side // PIXELS_OF_A_POINT, shape=(side, side), seed=3)
    rows = folds(made)
    del made
    wall, spent = time.perf_counter(), time.process_time()
    told = asked(rows)
    return {
        "side": side,
        "turn_rad": turn,
        "outcome": told.phase.outcome,
        "found_rad": list(told.phase.coefficients),
        "cpu_s": time.process_time() - spent,
        "wall_s": time.perf_counter() - wall,
        "spectra_gib": sum(one.spectrum.nbytes for one in rows) / 2**30,
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def spread(sides: list[int], draws: int) -> list[dict[str, Any]]:
    """The error that all ranges share, and that which goes with the look direction."""
    found = []
    for what, kind, rows in SPREAD_OF:
        aside = aside_of(rows)
        alike = _drawn(lambda x: TURN * x**2, kind, rows, draws, QUADRATIC)
        across = _drawn(lambda x, aside=aside: TURN * aside[:, None] * x**2, kind, rows, draws, QUADRATIC_MOTION)
        bounds = _bounds(rows) if "edge" in kind else None
        for part, (values, stated) in zip(("all ranges", "across"), (alike, across), strict=True):
            found.append(
                {
                    "image": what,
                    "rows": rows,
                    "part": part,
                    "draws": draws,
                    "mean": float(values.mean() / TURN - 1.0),
                    "spread": float(values.std(ddof=1) / TURN),
                    "stated": float(np.sqrt((stated**2).mean()) / TURN),
                    "bound": None if bounds is None else bounds[part == "across"] / TURN,
                }
            )
            print(json.dumps(found[-1]), flush=True)
    return found


def level(sides: list[int], draws: int) -> list[dict[str, Any]]:
    """What an error that goes with the look direction spreads by, with other shares of the level taken out."""
    found, aside = [], aside_of(128)
    for share in (0.0, 0.5, 1.0):
        spectrum.LEVEL_SHARE = share
        for what, kind in (("16 points", {"points": 16}), ("an edge", {"edge": True})):
            values, _ = _drawn(lambda x: TURN * aside[:, None] * x**2, kind, 128, draws, QUADRATIC_MOTION)
            found.append({"share": share, "image": what, "spread": float(values.std(ddof=1) / TURN)})
            print(json.dumps(found[-1]), flush=True)
    spectrum.LEVEL_SHARE = 0.5
    return found


def _drawn(phase: Callable[..., Any], kind: dict[str, Any], rows: int, draws: int, family: Any) -> tuple[Any, Any]:
    """The last coefficient in each draw, and the standard deviation that is stated [rad]."""
    found, stated = [], []
    for seed in range(draws):
        made = image(phase, **kind, seed=100 + seed, shape=(rows, COLUMNS))
        lines = AzimuthSpectrum.joined(folds(made))
        found.append(fitted(lines, family))
        stated.append(deviations(lines, family, found[-1]))
    return np.array(found)[:, -1], np.array(stated)[:, -1]


def _bounds(rows: int) -> tuple[float, float]:
    """The least standard deviations of a phase that all ranges share, and of one that goes with the look direction,
    beside one that all share [rad].

    The samples y of a row are linear in independent circular Gaussian numbers, whose power is 1 before the edge and
    DARK^2 behind it. With their covariance S the information about the phase is tr(S^-1 S' S^-1 S') for each row (Kay,
    Fundamentals of Statistical Signal Processing, 1993, eq. 15.52). Rows count as independent, which gives too much.
    """
    place = phase_images.places(COLUMNS)
    power = np.r_[np.ones(COLUMNS), np.full(COLUMNS, phase_images.DARK**2)]
    forward = np.fft.fft(np.eye(2 * COLUMNS))
    inverse = np.conj(forward)[COLUMNS // 2 : COLUMNS // 2 + COLUMNS] / (2 * COLUMNS)
    turned = inverse * (phase_images.amplitude_at(place) * np.exp(1j * TURN * place**2))
    made, change = turned @ forward, (turned * (1j * place**2)) @ forward
    covariance = (made * power) @ made.conj().T
    covariance += DARKEST * np.trace(covariance).real / COLUMNS * np.eye(COLUMNS)
    half = (change * power) @ made.conj().T
    ratio = np.linalg.solve(covariance, half + half.conj().T)
    of_row = float(np.trace(ratio @ ratio).real)
    aside = aside_of(rows)[np.any(folds_of(rows, phase_images.SPACING_M[0], phase_images.CELLS_M[0]), axis=0)]
    information = of_row * np.array([[len(aside), aside.sum()], [aside.sum(), (aside**2).sum()]])
    return of_row**-0.5 * len(aside) ** -0.5, float(np.sqrt(np.linalg.inv(information)[1, 1]))


_PARTS = ("spread", "stated", "bound")
WORK = {"cost": cost, "spread": spread, "level": level}


def written(found: dict[str, Any]) -> dict[str, str]:
    """The tables of docs/diagnosis-method.md."""
    bodies = {}
    if "cost" in found:
        header = ("pixels", "an error of 2 pi", "without one", "memory at most")
        rows = []
        for side in dict.fromkeys(one["side"] for one in found["cost"]):
            both = [one for one in found["cost"] if one["side"] == side]
            said = {one["turn_rad"]: f"{one['outcome']}, {one['cpu_s']:.0f} s" for one in both}
            told = [said.get(turn, "not measured") for turn in (TURN, 0.0)]
            rows.append((f"{side:,} x {side:,}", *told, f"{max(one['peak_gib'] for one in both):.2f} GiB"))
        bodies["phase.cost"] = tables.markdown(header, rows)
    if "spread" in found:
        header = ("image", "rows", "error", "mean", *_PARTS)
        bodies["phase.spread"] = tables.markdown(
            header,
            [
                (
                    *(one["image"], one["rows"], one["part"], f"{100 * one['mean']:+.1f} %"),
                    *(
                        f"{100 * one[key]:.1f} %" if one[key] is not None else ""
                        for key in ("spread", "stated", "bound")
                    ),
                )
                for one in found["spread"]
            ],
        )
    if "level" in found:
        shares = dict.fromkeys(one["share"] for one in found["level"])
        rows = [
            (f"{share:g}", *(f"{100 * one['spread']:.1f} %" for one in found["level"] if one["share"] == share))
            for share in shares
        ]
        bodies["phase.level"] = tables.markdown(("share of the level", "16 points", "an edge"), rows)
    return bodies


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=WORK, default=list(WORK))
    parser.add_argument("--sides", nargs="+", type=int, default=list(SIDES))
    parser.add_argument("--draws", type=int, default=24)
    tables.add_options(parser)
    options = parser.parse_args()
    if options.source:
        result = tables.stored(options.source)
    else:
        result = {"made": tables.made()} | {name: WORK[name](options.sides, options.draws) for name in options.only}
        tables.save(options.out, result)
    tables.publish(written(result), result, options.write)


if __name__ == "__main__":
    main()
