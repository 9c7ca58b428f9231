"""Range profiles of a sweep, and the image that they make of a body that turns (ISAR).

A point at r sends e^{+2jk s.r} times its amplitude, with s toward the radar. So the mean of A e^{-2jk s.r} over
frequencies and azimuths, with weights that add up to 1, is that amplitude where the point is, and falls off beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.coherent.directions import Directions
from warpsar.coherent.rcs import Rcs
from warpsar.errors import InputError
from warpsar.io import figures
from warpsar.io.images import replacing
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.taper import taper
from warpsar.world.world import World

FEWEST = 8
"""Frequencies, and azimuths, of an image."""
_FINER = 8
"""Bins of a profile for each of its cells of range: a straight line between them is then right to 2 %."""
_MOST_PIXELS = 512
_DYNAMIC_DB = 50.0
_MARGIN = 1.2
"""Of a picture, over the body's extent."""


@dataclass(frozen=True)
class RangeProfiles:
    """`amplitude_m` (azimuths, bins, polarizations) against `range_m` (bins,): the way from the reference point toward
    the radar [m]. A point of RCS sigma has 4 pi |amplitude|^2 = sigma at its place."""

    range_m: NDArray[np.float64]
    amplitude_m: NDArray[np.complex128]
    carrier_rad_m: float
    """Wavenumber of the phase that a point at `range_m` has: e^{2j carrier range}."""


@dataclass(frozen=True)
class BodyImage:
    """`amplitude_m` (north, east, polarizations) on the level plane through the reference point."""

    east_m: NDArray[np.float64]
    north_m: NDArray[np.float64]
    amplitude_m: NDArray[np.complex128]
    polarizations: tuple[str, ...]


def refuse_steps(
    scene: World, azimuths: Sequence[float], incidences: Sequence[float], frequencies: Sequence[float]
) -> None:
    """Raise InputError where azimuths and frequencies make no image, or one that repeats itself within the body."""
    problems = []
    for name, option, values in (("azimuths", "--azimuths", azimuths), ("frequencies", "--frequencies", frequencies)):
        steps = np.diff(values)
        if len(values) < FEWEST:
            problems.append(f"{option}: found {len(values)} {name}; --isar needs {FEWEST} or more, START:STOP:STEP")
        elif np.ptp(steps) > 1e-6 * abs(float(steps[0])):
            problems.append(f"{option}: found {name} whose steps differ; --isar needs even ones, START:STOP:STEP")
    if len(incidences) > 1:
        problems.append(f"--incidences: found {len(incidences)}; --isar needs one")
    if not problems:
        size = 2.0 * float(np.linalg.norm(scene.mesh.vertices - np.asarray(scene.reference_point_m), axis=1).max())
        step = float(frequencies[1] - frequencies[0])
        if SPEED_OF_LIGHT / (2.0 * step) < size:
            problems.append(
                f"--frequencies: found a step of {step:.4g} Hz; must be up to {SPEED_OF_LIGHT / (2.0 * size):.4g} Hz, "
                f"or the image repeats itself within a body of {size:.3g} m about the reference point"
            )
        turn = abs(float(azimuths[1] - azimuths[0]))
        widest = float(np.rad2deg(SPEED_OF_LIGHT / frequencies[-1] / (2.0 * size)))
        if turn > widest:
            problems.append(
                f"--azimuths: found a step of {turn:g} degrees; must be up to {widest:.3g}, or the image repeats "
                f"itself within a body of {size:.3g} m about the reference point"
            )
    if problems:
        raise InputError("\n  ".join(["--isar:", *problems]) if problems[1:] else problems[0])


def range_profiles(found: Rcs) -> RangeProfiles:
    """Profiles of the first incidence, by a Fourier transform over the frequencies with a Taylor window."""
    frequencies = found.frequency_hz
    n = frequencies.size
    window = taper("taylor", (np.arange(n) + 0.5) / n - 0.5)
    step = float(frequencies[1] - frequencies[0])
    bins = _FINER * n
    weighted = found.amplitude_m[:, 0] * (window / window.sum())[None, :, None]
    spectrum = np.fft.fft(weighted, bins, axis=1)  # sum over f of A e^{-2 pi j f bin / bins}
    range_m: NDArray[np.float64] = np.fft.fftfreq(bins).astype(np.float64) * SPEED_OF_LIGHT / (2.0 * step)
    first, middle = (
        2.0 * np.pi * f / SPEED_OF_LIGHT for f in (frequencies[0], 0.5 * (frequencies[0] + frequencies[-1]))
    )
    turned = spectrum * np.exp(-2j * first * range_m)[None, :, None]
    turned = turned * np.exp(2j * middle * range_m)[None, :, None]
    order = np.argsort(range_m)
    return RangeProfiles(range_m[order], turned[:, order], float(middle))


def body_image(found: Rcs, profiles: RangeProfiles, half_m: float) -> BodyImage:
    """The profiles put back onto the level plane, `half_m` [m] to all sides of the reference point."""
    azimuth = found.azimuth_deg
    turn = np.deg2rad(abs(float(azimuth[-1] - azimuth[0])))
    level = np.sin(np.deg2rad(found.incidence_deg[0]))
    band = float(found.frequency_hz[-1] - found.frequency_hz[0])
    middle = float(found.frequency_hz.mean())
    cells = [SPEED_OF_LIGHT / (2.0 * band)]
    cells.append(SPEED_OF_LIGHT / (4.0 * middle * np.sin(min(turn, np.pi) / 2.0)))
    pixels = int(np.clip(np.ceil(8.0 * half_m * level / min(cells)), 64, _MOST_PIXELS))
    axis = np.linspace(-half_m, half_m, pixels)
    east, north = np.meshgrid(axis, axis)
    round_trip = turn > 2.0 * np.pi - 1.5 * np.deg2rad(abs(float(azimuth[1] - azimuth[0])))
    place = (np.arange(azimuth.size) + 0.5) / azimuth.size - 0.5
    window = taper("none" if round_trip else "taylor", place)
    window = window / window.sum()
    s = Directions.of(azimuth, np.full(azimuth.size, found.incidence_deg[0])).s
    total = np.zeros((*east.shape, len(found.polarizations)), np.complex128)
    bin_m = float(profiles.range_m[1] - profiles.range_m[0])
    for one, weight, echo in zip(s, window, profiles.amplitude_m, strict=True):
        way = one[0] * east + one[1] * north
        at = (way - profiles.range_m[0]) / bin_m
        low = np.clip(np.floor(at).astype(np.int64), 0, len(echo) - 2)
        share = (at - low)[:, :, None]
        # the profile without its carrier is smooth, so a straight line between bins holds
        smooth = (1.0 - share) * echo[low] + share * echo[low + 1]
        total += weight * smooth * np.exp(-2j * profiles.carrier_rad_m * way)[:, :, None]
    return BodyImage(axis, axis, total, found.polarizations)


def write_isar(found: Rcs, scene: World, out: Path) -> list[str]:
    """range_profile.png, isar.png, and isar.npz with all their numbers, in `out`; returns the names."""
    profiles = range_profiles(found)
    about = scene.mesh.vertices - np.asarray(scene.reference_point_m)
    half = _MARGIN * float(np.linalg.norm(about[:, :2], axis=1).max())
    image = body_image(found, profiles, half)
    with replacing(out / "isar.npz") as temporary, temporary.open("wb") as stream:
        np.savez(
            stream,
            polarizations=np.array(found.polarizations),
            azimuth_deg=found.azimuth_deg,
            range_m=profiles.range_m,
            profile_m=profiles.amplitude_m,
            east_m=image.east_m,
            north_m=image.north_m,
            image_m=image.amplitude_m,
        )
    _draw_profiles(found, profiles, half, out / "range_profile.png")
    _draw_image(image, about, out / "isar.png")
    return ["range_profile.png", "isar.png", "isar.npz"]


def _decibels(amplitude: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.asarray(10.0 * np.log10(np.maximum(4.0 * np.pi * np.abs(amplitude) ** 2, 1e-30)))


def _draw_profiles(found: Rcs, profiles: RangeProfiles, half: float, path: Path) -> None:
    inside = np.flatnonzero(np.abs(profiles.range_m) <= half)
    decibels = _decibels(profiles.amplitude_m[:, inside])
    count = len(found.polarizations)
    figure, panels = figures.new(1.0 + 4.4 * count, 4.6, ncols=count, sharey=True, squeeze=False)
    azimuth, way = found.azimuth_deg, profiles.range_m[inside]
    for p, panel in enumerate(panels[0]):
        top = decibels.max()
        drawn = panel.pcolormesh(
            azimuth, way, decibels[:, :, p].T, vmin=top - _DYNAMIC_DB, vmax=top, cmap="magma", rasterized=True
        )
        panel.set_title(found.polarizations[p], fontsize=10)
        panel.set_xlabel("azimuth [deg]")
    panels[0, 0].set_ylabel("way toward the radar [m]")
    figure.colorbar(drawn, ax=panels[0].tolist(), label="RCS [dBsm]")
    figures.save(figure, path)


def _draw_image(image: BodyImage, about: NDArray[np.float64], path: Path) -> None:
    decibels = _decibels(image.amplitude_m)
    count = len(image.polarizations)
    figure, panels = figures.new(1.0 + 4.4 * count, 4.6, ncols=count, sharey=True, squeeze=False)
    ends = (image.east_m[0], image.east_m[-1], image.north_m[0], image.north_m[-1])
    low, high = about[:, :2].min(axis=0), about[:, :2].max(axis=0)
    for p, panel in enumerate(panels[0]):
        top = decibels.max()
        drawn = panel.imshow(
            decibels[:, :, p], extent=ends, origin="lower", vmin=top - _DYNAMIC_DB, vmax=top, cmap="magma"
        )
        panel.plot(
            [low[0], high[0], high[0], low[0], low[0]],
            [low[1], low[1], high[1], high[1], low[1]],
            color="w",
            lw=0.6,
            ls=":",
        )
        panel.set_title(f"{image.polarizations[p]}; dotted: the body's extent", fontsize=9)
        panel.set_xlabel("east of the reference point [m]")
    panels[0, 0].set_ylabel("north of the reference point [m]")
    figure.colorbar(drawn, ax=panels[0].tolist(), label="RCS [dBsm]")
    figures.save(figure, path)
