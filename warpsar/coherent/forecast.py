"""How long a sweep will take, and how much memory: measured on parts of it before it begins."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial

import numpy as np
import warp as wp

from warpsar.coherent.directions import Directions, radar_records
from warpsar.coherent.rays import CellGrid
from warpsar.coherent.rcs import RcsRequest, working_gib
from warpsar.coherent.records import upload
from warpsar.coherent.sweep import Worker, tubes_of
from warpsar.coherent.traced import LEVELS
from warpsar.kernels.coherent import cells, tubes
from warpsar.runtime import threads
from warpsar.runtime.forecast import LONG_S, duration
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.world import World

_STRETCH = 2**12
"""Tubes of a sample that lie side by side."""
_SAMPLE_S = 1.0
"""How long tubes of the sample are traced."""
_COMPARED = 1.25
"""The sweep with tubes of twice the width is a quarter more."""


@dataclass(frozen=True)
class RcsForecast:
    """Of the whole sweep."""

    directions: int
    tubes: float
    seconds: float
    gib: float

    def __str__(self) -> str:
        return (
            f"{self.directions} direction{'s' if self.directions > 1 else ''}, {self.tubes:.2g} tubes: about "
            f"{duration(self.seconds)} and {self.gib:.2g} GiB"
        )


def forecast(scene: World, asked: RcsRequest, layers: bool = False) -> RcsForecast | None:
    """What the sweep will take; None where that is not long.

    Faces, edges and rough places of a few directions are worked out, and stretches of tubes at random places of all
    directions, on all cores as the sweep does it.
    """
    body, directions, radar = asked.body, asked.directions, scene.radar
    k = 2.0 * np.pi * asked.frequencies / SPEED_OF_LIGHT
    spacing = float(2.0 * np.pi / k.max() / asked.rays_per_wavelength)
    worker = Worker(body, k, spacing, radar.terms, radar.max_bounces, LEVELS, radar.slant_range_m, layers)
    counts = [tubes_of(body, directions, i, spacing) for i in range(len(directions))]
    cores = threads.thread_count() if body.device.is_cpu else 1
    random = np.random.default_rng(0)

    def lit(one: Directions) -> tuple[wp.array, wp.array]:
        radars = upload(radar_records(one, body.origin, radar.slant_range_m), tubes.TubeRadar, body.device)
        return radars, worker.lit_regions(radars)

    def faces(index: int) -> None:
        worker.faces(*lit(directions[index : index + 1]))

    def stretch(index: int, place: float) -> int:
        one = directions[index : index + 1]
        grid = CellGrid(body, one, spacing, radar.slant_range_m)
        first = int(place * max(len(grid) - _STRETCH, 0))
        first -= first % cells.RAYS
        stop = min(first + _STRETCH, len(grid))
        worker.tracer.sums(*lit(one), grid, first, stop)
        return stop - first

    stretch(0, 0.5)  # loads the kernels
    chosen = np.linspace(0, len(directions) - 1, min(cores, len(directions))).astype(int).tolist()
    started = time.perf_counter()
    list(threads.ordered([partial(faces, index) for index in chosen], body.device))
    wp.synchronize()
    each = (time.perf_counter() - started) / len(chosen)
    share = np.array(counts) / sum(counts)
    traced, started = 0, time.perf_counter()
    while (spent := time.perf_counter() - started) < _SAMPLE_S and traced < 0.05 * sum(counts):
        places = zip(random.choice(len(counts), 4 * cores, p=share).tolist(), random.random(4 * cores), strict=True)
        traced += sum(threads.ordered([partial(stretch, index, at) for index, at in places], body.device))
        wp.synchronize()
    if not traced:
        spent, traced = 0.0, 1
    # each stretch asks anew which faces are lit as a whole, which a direction asks once: that is in both
    seconds = each * len(directions) + _COMPARED * spent / traced * sum(counts)
    found = RcsForecast(len(directions), float(sum(counts)), seconds, working_gib(scene, asked, layers))
    return found if seconds > LONG_S else None
