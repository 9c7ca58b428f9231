"""Point targets of known cross-section in speckle: bias of the RCS, and coverage of its interval.

    python benchmarks/reflectors_simulated.py            # tables of docs/reflectors-checks.md
    python benchmarks/reflectors_simulated.py --draws 1000

The images are made here with NumPy alone: a point's response and the clutter pass through the same band and window.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # a core for each row; NumPy reads it when it is imported

import numpy as np
from numpy.typing import NDArray

from warpsar.calibration.point import PointSettings, ResponseAxis, measure_point
from warpsar.runtime.threads import thread_count

SIDE = 64
SPACING_M = (14.0, 2.33)
BANDWIDTH = (1.0 / 21.0, 1.0 / 2.65)
"""Sentinel-1 IW: 327 Hz at 6.8 km/s, and 56.5 MHz."""
SEARCH = (3.0, 5.0)
SCR_DB = (10.0, 15.0, 20.0, 30.0)
CENTRE = (SIDE / 2, SIDE / 2)


def chips(
    rng: np.random.Generator, scr: float, hamming: tuple[float, float], clutter: float = 1.0
) -> tuple[NDArray[np.complex128], float, tuple[float, float]]:
    """An image of a point in speckle, its RCS [m2] and place. SCR: RCS over clutter in a resolution cell."""
    axes = [ResponseAxis(band, alpha) for band, alpha in zip(BANDWIDTH, hamming, strict=True)]
    weights = []
    for step, band, alpha in zip(SPACING_M, BANDWIDTH, hamming, strict=True):
        frequency = np.fft.fftfreq(2 * SIDE, step)
        inside = np.abs(frequency) < band / 2
        weights.append(np.where(inside, alpha + (1 - alpha) * np.cos(2 * np.pi * frequency / band), 0.0))
    whole = weights[0][:, None] * weights[1]
    noise = rng.normal(size=(*whole.shape, 2)) @ [1, 1j]
    speckle = np.fft.ifft2(np.fft.fft2(noise) * whole)
    speckle *= np.sqrt(clutter / (np.abs(speckle) ** 2).mean())
    speckle = speckle[:SIDE, :SIDE]
    rcs = scr * clutter * axes[0].cell_m * axes[1].cell_m
    place = tuple(c + rng.uniform(-0.5, 0.5) for c in CENTRE)
    cuts = []
    for weight, step, at in zip(weights, SPACING_M, place, strict=True):
        frequency = np.fft.fftfreq(2 * SIDE, step)
        response = np.exp(2j * np.pi * np.outer(np.arange(SIDE) * step - at * step, frequency)) @ weight
        # int |h|^2 dx = 1 over all space, by Parseval
        cuts.append(response / np.sqrt((weight**2).sum() * 2 * SIDE * step))
    point = np.sqrt(rcs) * cuts[0][:, None] * cuts[1] * np.exp(2j * np.pi * rng.uniform())
    return point + speckle, rcs, (place[0], place[1])


def row(draws: int, hamming: tuple[float, float], scr_db: float, detected: bool = False) -> tuple[float, ...]:
    """SCR, mean error [dB], its standard error, scatter, coverage [%], mean width [dB], mean error of the peak, share
    that is seen [%], and of those, in azimuth and range, the scatter of places over their stated errors, and how many
    lie within 1.645 of them [%]."""
    whole = [step if detected else 0.0 for step in SPACING_M]
    axes = tuple(ResponseAxis(b, alpha, m) for b, alpha, m in zip(BANDWIDTH, hamming, whole, strict=True))
    rng = np.random.default_rng([int(100 * hamming[0]), int(scr_db)])  # rows of one seed would err alike
    errors, covered, widths, peaks, off = [], [], [], [], []
    for _ in range(draws):
        chip, rcs, place = chips(rng, 10 ** (scr_db / 10), hamming)
        chip = np.abs(chip) ** 2 if detected else chip
        found = measure_point(chip, CENTRE, SEARCH, SPACING_M, (axes[0], axes[1]), PointSettings())
        errors.append(found.rcs_m2 / rcs)
        peaks.append(found.peak_rcs_m2 / rcs)
        covered.append(found.low_m2 <= rcs <= found.high_m2)
        widths.append(10 * np.log10(found.high_m2 / max(found.low_m2, 1e-3 * rcs)))
        if found.seen:
            found_at = (found.line, found.pixel)
            step_sd = zip(found_at, place, SPACING_M, found.position_sd_m, strict=True)
            off.append([(at - true) * step / sd for at, true, step, sd in step_sd])
    ratio = np.array(errors)
    return (
        scr_db,
        10 * np.log10(ratio.mean()),
        10 * np.log10(np.e) * ratio.std() / np.sqrt(draws),
        10 * np.log10(np.e) * ratio.std(),
        100 * float(np.mean(covered)),
        float(np.mean(widths)),
        10 * np.log10(np.mean(peaks)),
        100 * len(off) / draws,
        *np.std(off, axis=0),
        *(100 * np.mean(np.abs(off) < 1.645, axis=0)),
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--draws", type=int, default=4000)
    parser.add_argument("--detected", action="store_true", help="power alone, as GRD and .mli have it")
    given = parser.parse_args()
    draws = given.draws
    asked = [(hamming, scr) for hamming in ((1.0, 1.0), (0.75, 0.75)) for scr in SCR_DB]
    print(f"{draws} draws, 90 % intervals")
    print("SCR [dB]  bias [dB]  +-  scatter [dB]  coverage [%]  width [dB]  bias by peak [dB]", end="  ")
    print("seen [%]  place / sd  place holds [%]")
    with ProcessPoolExecutor(thread_count(), multiprocessing.get_context("spawn")) as pool:
        rows = pool.map(row, [draws] * len(asked), *zip(*asked, strict=True), [given.detected] * len(asked))
        for (hamming, _), found in zip(asked, rows, strict=True):
            print(f"Hamming {hamming[0]:g}: " + "  ".join(f"{value:8.3f}" for value in found), flush=True)


if __name__ == "__main__":
    main()
