"""What the search for a phase over slow time in complex images costs: processor's time and memory.

    python benchmarks/phase_search.py [--sides 640 1024 2048] [--out phase_search.json] [--write]

The images are made: speckle with points (`tests/phase_images.py`). One whole question
(`warpsar.diagnosis.phase.ask.asked`) is asked of square images, with an error of 2 pi at the band's edge and without
one, each in a process of its own. Time is that of the processor, so other programs beside it hardly count.
"""

from __future__ import annotations

import json
import multiprocessing
import resource
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import tables
from phase_images import TURN, folds, image

from warpsar.diagnosis.phase.ask import asked

PIXELS_OF_A_POINT = 1280
"""As many points for each pixel as the tests' images have."""
SIDES = (640, 1024, 2048)


def cost(sides: list[int]) -> list[dict[str, Any]]:
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


def table(found: list[dict[str, Any]]) -> str:
    rows = []
    for side in dict.fromkeys(one["side"] for one in found):
        both = [one for one in found if one["side"] == side]
        said = {one["turn_rad"]: f"{one['outcome']}, {one['cpu_s']:.0f} s" for one in both}
        told = [said.get(turn, "not measured") for turn in (TURN, 0.0)]
        rows.append((f"{side:,} x {side:,}", *told, f"{max(one['peak_gib'] for one in both):.2f} GiB"))
    return tables.markdown(("pixels", "an error of 2 pi", "without one", "memory at most"), rows)


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--sides", nargs="+", type=int, default=list(SIDES))
    options = parser.parse_args()
    result = tables.result_of(options, lambda: {"cost": cost(options.sides)})
    tables.publish({"phase.cost": table(result["cost"])}, result, options.write)


if __name__ == "__main__":
    main()
