"""Whether dark pixels measure what the model does not put there: the scan of what lies far from everything lit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from warpsar.diagnosis.dark.pixels import DarkPixels, dark_pixels
from warpsar.diagnosis.found import DarkScan
from warpsar.diagnosis.models.fit_setup import DARK_PIXELS, FitSetup
from warpsar.diagnosis.models.refit import Fitted
from warpsar.diagnosis.scores.evidence import LARGEST, Evidence
from warpsar.simulation.rays import Rays
from warpsar.speckle.lines import Lines


def scan_dark(setup: FitSetup, other_rays: Rays, base: Fitted, evidence: Evidence, seed: int) -> DarkScan | None:
    """The strongest row, column or window of dark pixels about `base`; None where there are too few
    pixels, or where model and images hold nothing.

    `other_rays` say where the model is unsure of its own power. The speckle is that of the lit pixels' `evidence`.
    """
    other = replace(setup, rays=other_rays).problem(base.scene)
    pixels = dark_pixels(base.problem, base.x, other)
    lines = Lines(pixels, evidence.autocovariance)
    if lines.pixels < DARK_PIXELS:
        return None
    strongest = lines.strongest([one.residual for one in pixels])
    if strongest.z == 0.0:
        return None  # nothing is measured there, and nothing is modelled
    score = float(lines.tail(seed, LARGEST)(abs(strongest.z)))
    one = pixels[strongest.observation]
    inside = _inside(one, strongest.rows, strongest.cols)
    return DarkScan(
        score,
        strongest.z,
        strongest.observation,
        strongest.kind,
        strongest.rows,
        strongest.cols,
        int(inside.sum()),
        float(one.measured[inside].mean()),
        float(one.modelled[inside].mean()),
        bool((inside & ~one.empty).any()),
    )


def _inside(one: DarkPixels, rows: tuple[int, int], cols: tuple[int, int]) -> np.ndarray:
    """The judged pixels of a box, shape of the image."""
    inside = np.zeros_like(one.interior)
    box = tuple(slice(max(first, 0), end) for first, end in (rows, cols))
    inside[box] = one.interior[box]
    return inside
