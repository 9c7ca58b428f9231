"""How often causes of made-up differences are found together, falsely named, and covered by their intervals.

    python benchmarks/reflectors_causes.py            # 60 worlds of each kind, some 6 minutes of CPU time
    python benchmarks/reflectors_causes.py --worlds 10 --kinds loss three
    python benchmarks/reflectors_causes.py --hold-back  # how often intervals that are foretold hold later values

Three reflectors, two passes, 12 dates each: 0.3 dB of scatter from value to value, 0.15 dB from image to image, clutter
some 25 dB below. Kinds: nothing is wrong; one cause; three at once (constant, a loss, a step).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from scipy.special import betaincinv

from warpsar.calibration.attitude import Facing, trihedral_rcs_m2
from warpsar.calibration.explain import explain
from warpsar.calibration.forecast import forecast
from warpsar.calibration.measure import ReflectorObservation
from warpsar.calibration.point import PointMeasurement, interval
from warpsar.calibration.sites import ReflectorSite
from warpsar.products.product import ImagedPoint

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
    given = parser.parse_args()
    worlds = given.worlds
    if given.hold_back:
        held_back(worlds, given.kinds)
        return
    print("kind: all causes named, or tied to what is named; worlds with a cause that is not there (95 % bounds);")
    print("      the interval holds; the interval over all ties holds")
    for k, (kind, (off, truth)) in enumerate(KINDS.items()):
        if kind not in given.kinds:
            continue
        found = false = held = tied_held = counted = 0
        for seed in range(worlds):
            joint = explain(world(off, np.random.default_rng([k, seed, 3]))).joint
            assert joint is not None
            named = {SAME.get(one.cause.name, one.cause.name): one for one in joint.causes}
            tied = {SAME.get(one.other, one.other) for one in joint.stands}
            found += set(truth) <= set(named) | tied
            could_be = {name for name in named if name in truth or _tied_to(joint.stands, name, truth)}
            false += bool(set(named) - could_be)
            for name, (parameter, value) in truth.items():
                one = named.get(name)
                if one is None or one.cause.name != name:
                    continue
                at = one.cause.parameters.index(parameter)
                counted += 1
                held += one.low[at] <= value <= one.high[at]
                tied_held += one.tied_low[at] <= value <= one.tied_high[at]
        shares = [f"{100 * each / counted:.0f} % of {counted}" if counted else "-" for each in (held, tied_held)]
        bounds = f"({100 * bound(false, worlds, 0.025):.1f} to {100 * bound(false, worlds, 0.975):.1f} %)"
        print(f"{kind}: {found} of {worlds}; {false} of {worlds} {bounds}; {'; '.join(shares)}", flush=True)


def bound(count: int, of: int, chance: float) -> float:
    """Of a share, one end of Clopper and Pearson's interval."""
    if chance < 0.5:
        return float(betaincinv(count, of - count + 1, chance)) if count else 0.0
    return float(betaincinv(count + 1, of - count, chance)) if count < of else 1.0


def held_back(worlds: int, kinds: list[str]) -> None:
    """How many values of the last 4 of 12 dates lie in the 90 % intervals that the first 8 foretell."""
    since = np.datetime64("2024-01-01", "us") + np.timedelta64(DAYS[8], "D")
    print("kind: later values inside, and width; by a level of each reflector and pass alone")
    for k, (kind, (off, _)) in enumerate(KINDS.items()):
        if kind not in kinds:
            continue
        values = []
        for seed in range(worlds):
            made = world(off, np.random.default_rng([k, seed, 1]))
            values += list(forecast(made, since, explain([one for one in made if one.date < since])).values)
        words = []
        for of in ("", "level_"):
            inside = 100 * np.mean([getattr(one, f"{of}inside") for one in values])
            width = np.mean([getattr(one, f"{of}high_dbsm") - getattr(one, f"{of}low_dbsm") for one in values])
            words.append(f"{inside:.1f} % of {len(values)}, {width:.2f} dB")
        print(f"{kind}: {'; '.join(words)}", flush=True)


def _tied_to(stands: tuple, name: str, truth: dict[str, tuple[str, float]]) -> bool:
    """Whether a true cause could stand for it."""
    return any(SAME.get(one.cause, one.cause) == name and SAME.get(one.other, one.other) in truth for one in stands)


if __name__ == "__main__":
    main()
