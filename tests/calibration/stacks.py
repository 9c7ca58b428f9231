"""Stacks of Sentinel-1 products with reflectors of known cross-section, made for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from product_files import Band, C, ground_speed, write_gamma, write_safe

DAYS = ("2024-03-05", "2024-03-17", "2024-03-29", "2024-04-10", "2024-04-22", "2024-05-04", "2024-05-16", "2024-05-28")
CLUTTER_DB = -12.0


def image(points: Sequence[tuple[float, float, float]], seed: int, band: Band | None = None) -> NDArray[np.complex64]:
    """beta0 amplitude of points (line, pixel, RCS [dBsm]) in speckle, both through the band's response."""
    band, rng = band or Band(), np.random.default_rng(seed)
    shares = band.azimuth_hz * band.line_s, 2 * band.range_hz / C * band.step_m
    spacing = ground_speed() * band.line_s, band.step_m
    noise = rng.normal(size=(band.lines, band.pixels, 2)) @ [1, 1j]
    inside = [np.abs(np.fft.fftfreq(n)) < b / 2 for n, b in zip((band.lines, band.pixels), shares, strict=True)]
    found = np.fft.ifft2(np.fft.fft2(noise) * inside[0][:, None] * inside[1])
    found *= np.sqrt(10 ** (CLUTTER_DB / 10) / (np.abs(found) ** 2).mean())
    for line, pixel, rcs in points:
        cuts = [
            np.sinc((np.arange(n) - at) * b) * np.sqrt(b / s)
            for n, at, b, s in zip((band.lines, band.pixels), (line, pixel), shares, spacing, strict=True)
        ]
        found = found + 10 ** (rcs / 20) * cuts[0][:, None] * cuts[1] * np.exp(0.7j)
    return found.astype(np.complex64)


def safe_stack(folder: Path, levels_dbsm: Sequence[float], off: tuple[float, float] = (0.0, 0.0)) -> list[Path]:
    """One reflector, `off` (lines, pixels) its place, a product per level."""
    line, pixel = Band().centre
    return [
        write_safe(folder, image([(line + off[0], pixel + off[1], level)], k), beta_lut=300.0, day=DAYS[k])
        for k, level in enumerate(levels_dbsm)
    ]


def gamma_image(folder: Path, level_dbsm: float, incidence_deg: float) -> Path:
    """The same as sigma0 in GAMMA's form."""
    power = np.abs(image([(*Band().centre, level_dbsm)], 50)) ** 2 * np.sin(np.deg2rad(incidence_deg))
    return write_gamma(folder, power)
