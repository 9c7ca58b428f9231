"""How often causes of made-up differences are found together, falsely named, and covered by their intervals.

    python benchmarks/reflectors_causes.py            # 60 worlds of each kind, on all cores
    python benchmarks/reflectors_causes.py --worlds 10 --kinds loss three
    python benchmarks/reflectors_causes.py --each worlds.jsonl  # and what was found in each world
    python benchmarks/reflectors_causes.py --hold-back  # how often intervals that are foretold hold later values

Three reflectors, two passes, 12 dates each: 0.3 dB of scatter from value to value, 0.15 dB from image to image, clutter
some 25 dB below. Kinds: nothing is wrong; one cause; three at once (constant, a loss, a step).
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # a core for each world; NumPy reads it when it is imported

import numpy as np
from scipy.special import betaincinv

from warpsar.calibration.attitude import Facing, trihedral_rcs_m2
from warpsar.calibration.causes import causes
from warpsar.calibration.differences import Differences, bad_dates
from warpsar.calibration.explain import explain
from warpsar.calibration.forecast import forecast
from warpsar.calibration.joint import joint
from warpsar.calibration.measure import ReflectorObservation
from warpsar.calibration.point import PointMeasurement, interval
from warpsar.calibration.sites import ReflectorSite
from warpsar.products.product import ImagedPoint
from warpsar.runtime.threads import thread_count

PASSES = ((98.0, 38.0), (262.0, 44.0))
NAMES, DAYS, LEG, WAVELENGTH, CELL = ("A", "B", "C"), range(0, 288, 24), 1.2, 0.0555, 2.0
FACINGS = (Facing(95.0, 10.0), Facing(265.0, 10.0))
Off = Callable[[str, int, float], float]
"""Of a reflector's name, a day and an incidence [deg]: what is off [dB]."""

KINDS: dict[str, tuple[Off, dict[str, tuple[str, float]]]] = {
    "nothing": (lambda name, day, angle: 0.0, {}),
    "constant": (lambda name, day, angle: -0.5, {"calibration constant": ("constant [dB]", -0.5)}),
    "pattern": (lambda name, day, angle: 0.15 * (angle - 41.0), {"antenna pattern": ("slope [dB/deg]", 0.15)}),
    "loss": (lambda name, day, angle: -0.8 * (name == "B"), {"loss at B": ("loss [dB]", 0.8)}),
    "three": (
        lambda name, day, angle: -0.6 - 0.8 * (name == "B") - 2.0 * (name == "C" and day > 70),
        {
            "calibration constant": ("constant [dB]", -0.6),
            "loss at B": ("loss [dB]", 0.8),
            "step of C": ("after [dB]", -2.0),
        },
    ),
}
SAME = {"size of B": "loss at B"}
"""Which two only a measurement could tell apart: either name counts."""


def world(off: Off, rng: np.random.Generator) -> list[ReflectorObservation]:
    made = []
    for day in DAYS:
        for azimuth, incidence in PASSES:
            image = 0.15 * rng.normal()
            for name in NAMES:
                made.append(
                    observation(name, day, azimuth, incidence, off(name, day, incidence) + image + 0.3 * rng.normal())
                )
    return made


def observation(name: str, day: int, azimuth: float, incidence: float, off_db: float) -> ReflectorObservation:
    a, i = np.deg2rad([azimuth, incidence])
    toward = np.array([np.sin(a) * np.sin(i), np.cos(a) * np.sin(i), np.cos(i)])
    site = ReflectorSite(name, 46.0, 12.0, 0.0, FACINGS, "triangular", LEG)
    facing = site.facing(toward)
    assert facing is not None
    predicted = float(trihedral_rcs_m2("triangular", LEG, facing, toward, WAVELENGTH))
    target = predicted * 10 ** (off_db / 10)
    low, high = interval(target, CELL, CELL**2, 1.6449)
    point = PointMeasurement(
        100.0, 200.0, (0.1, 0.1), target, low, high, target, target / CELL, 1.0, 100.0, 0.9, 0.0, None, True
    )
    date = np.datetime64("2024-01-01T06:00:00", "us") + np.timedelta64(day, "D")
    return ReflectorObservation(
        site, f"day {day}, from {azimuth:g}", "made", "VV", date, "measured",
        expected=ImagedPoint(0.0, 8e5, 100.0, 200.0, toward), spacing_m=(10.0, 2.0), point=point, facing=facing,
        closed_form_m2=predicted,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--worlds", type=int, default=60)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--hold-back", action="store_true", help="foretell the last third of the dates instead")
    parser.add_argument("--each", type=Path, help="a file for what was found in each world, a line of JSON each")
    given = parser.parse_args()
    work, line = (foretold, foretold_line) if given.hold_back else (judged, judged_line)
    if given.hold_back:
        print("kind: later values inside, and width; by a level of each reflector and pass alone")
    else:
        print("kind: all causes named, or tied to what is named; worlds with a cause that is not there (95 % bounds);")
        print(
            "      the interval holds; that given the others as named; the latter where the true causes alone are named"
        )
    start = time.perf_counter()
    with ProcessPoolExecutor(thread_count(), multiprocessing.get_context("spawn")) as pool:
        for kind in given.kinds:
            found = list(pool.map(work, [kind] * given.worlds, range(given.worlds)))
            print(f"{kind}: {line(found)}", flush=True)
            if given.each is not None:
                with given.each.open("a") as file:
                    file.writelines(json.dumps({"kind": kind, "world": k, **one}) + "\n" for k, one in enumerate(found))
    cpu = sum(os.times()[:4])
    print(f"{time.perf_counter() - start:.0f} s, {cpu:.0f} s of CPU time")


def judged(kind: str, seed: int) -> dict[str, Any]:
    """What is named in a world, which of it is false, which truths are missing, and of each truth that is named
    whether its interval holds it, and whether that does which takes the others as named."""
    off, truth = KINDS[kind]
    made = Differences.of(world(off, np.random.default_rng([list(KINDS).index(kind), seed, 3])))
    found = joint(made.part(bad_dates(made)[1]), causes)
    named = {SAME.get(one.cause.name, one.cause.name): one for one in found.causes}
    tied = {SAME.get(one.other, one.other) for one in found.stands}
    held = {}
    for name, (parameter, value) in truth.items():
        one = named.get(name)
        if one is None or one.cause.name != name:
            continue
        at = one.cause.parameters.index(parameter)
        held[name] = [
            bool(one.low[at] <= value <= one.high[at]), bool(one.given_low[at] <= value <= one.given_high[at]),
            [float(each[at]) for each in (one.values, one.low, one.high, one.given_low, one.given_high)],
        ]  # fmt: skip
    return {
        "named": [one.cause.name for one in found.causes],
        "false": [n for n in named if n not in truth and not _tied_to(found.stands, n, truth)],
        "missing": sorted(set(truth) - set(named) - tied),
        "held": held,
    }


def judged_line(found: list[dict[str, Any]]) -> str:
    worlds, false = len(found), sum(bool(one["false"]) for one in found)
    held = [each for one in found for each in one["held"].values()]
    true = [each for one in found if len(one["held"]) == len(one["named"]) for each in one["held"].values()]
    shares = [
        f"{100 * np.mean([each[k] for each in some]):.0f} % of {len(some)}" if some else "-"
        for some, k in ((held, 0), (held, 1), (true, 1))
    ]
    bounds = f"({100 * bound(false, worlds, 0.025):.1f} to {100 * bound(false, worlds, 0.975):.1f} %)"
    return f"{sum(not one['missing'] for one in found)} of {worlds}; {false} of {worlds} {bounds}; {'; '.join(shares)}"


def bound(count: int, of: int, chance: float) -> float:
    """Of a share, one end of Clopper and Pearson's interval."""
    if chance < 0.5:
        return float(betaincinv(count, of - count + 1, chance)) if count else 0.0
    return float(betaincinv(count + 1, of - count, chance)) if count < of else 1.0


def foretold(kind: str, seed: int) -> dict[str, Any]:
    """Of the values of the last 4 of 12 dates: which lie in the 90 % intervals that the first 8 foretell, and how wide
    those are; the same of a level alone."""
    since = np.datetime64("2024-01-01", "us") + np.timedelta64(DAYS[8], "D")
    made = world(KINDS[kind][0], np.random.default_rng([list(KINDS).index(kind), seed, 1]))
    values = forecast(made, since, explain([one for one in made if one.date < since])).values
    return {
        of: [
            [bool(getattr(one, f"{of}inside")), getattr(one, f"{of}high_dbsm") - getattr(one, f"{of}low_dbsm")]
            for one in values
        ]
        for of in ("", "level_")
    }


def foretold_line(found: list[dict[str, Any]]) -> str:
    words = []
    for of in ("", "level_"):
        values = np.array([each for one in found for each in one[of]], float)
        words.append(f"{100 * values[:, 0].mean():.1f} % of {len(values)}, {values[:, 1].mean():.2f} dB")
    return "; ".join(words)


def _tied_to(stands: tuple, name: str, truth: dict[str, tuple[str, float]]) -> bool:
    """Whether a true cause could stand for it."""
    return any(SAME.get(one.cause, one.cause) == name and SAME.get(one.other, one.other) in truth for one in stands)


if __name__ == "__main__":
    main()
