"""Phase history to complex image: range compression by FFT, backprojection in Warp.

A point of amplitude A at q gives the samples A exp(-j 4 pi f_k (|position_p - q| - reference_range_p) / c) for
frequency k and pulse p. The image is sum_p exp(+j 4 pi f dR / c) profile_p(dR), normalised so that it is A at q (Gorham
and Moore, "SAR image formation toolbox for MATLAB", SPIE 7699, 2010). Distances are the true ones, so the curvature of
the wavefront needs no extra step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from scipy import fft

from warpsar.errors import InputError
from warpsar.formats.base.data import PhaseHistory
from warpsar.kernels.backproject import Pulses, backproject_kernel
from warpsar.runtime import console, devices, threads
from warpsar.runtime.structs import fill
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.taper import taper

OVERSAMPLING = 8  # with cubic interpolation the edge of the band loses 6e-4 of its amplitude
PROFILE_BYTES = 256 * 2**20
_PIXELS_PER_TASK = 1 << 14


def cell_m(history: PhaseHistory, reference_point_m: np.ndarray) -> tuple[float, float]:
    """Resolution cell (range, azimuth) [m] of the full band and aperture: c / 2B and lambda / 2 (aperture angle).

    Of two antennas apart both are larger, by the cosine of half the angle between them.
    The half-power width of an unweighted point target is 0.886 of it.
    """
    wavelength = SPEED_OF_LIGHT / history.centre_frequency_hz
    aperture = np.ptp(cross_range_cosine(history, reference_point_m)) * _spread(history.position_m.shape[0])
    cells = SPEED_OF_LIGHT / (2.0 * history.bandwidth_hz), wavelength / (2.0 * max(aperture, 1e-12))
    if history.transmitter_m is None:
        return cells
    middle = history.position_m.shape[0] // 2
    ends = [
        place[middle] - history.in_frame(reference_point_m) for place in (history.position_m, history.transmitter_m)
    ]
    shortened = 0.5 * float(np.linalg.norm(sum(end / np.linalg.norm(end) for end in ends)))
    return cells[0] / shortened, cells[1] / shortened


def focus(
    history: PhaseHistory,
    points_m: np.ndarray,
    *,
    reference_point_m: np.ndarray,
    window_range: str = "none",
    window_azimuth: str = "none",
    subapertures: int = 1,
    device: str | None = None,
) -> Iterator[np.ndarray]:
    """One complex64 image per sub-aperture (equal numbers of pulses, in azimuth order), at world points (..., 3) [m].

    `window_range` tapers the band, and `window_azimuth` each sub-aperture: "none", "hann" or "taylor". The frequency
    step df leaves a swath of c / 4 df on each side unambiguous; points outside it are NaN. Raises InputError for an
    unknown window, and for more sub-apertures than pairs of pulses.
    """
    target = devices.resolve_device(device)
    pulses = history.position_m.shape[0]
    if not 1 <= subapertures <= max(1, pulses // 2):
        raise InputError(
            f"subapertures = {subapertures}: {history.source} has {pulses} pulses; "
            f"allowed are 1 to {max(1, pulses // 2)}"
        )
    cosine = cross_range_cosine(history, reference_point_m)
    order = np.argsort(cosine, kind="stable")
    points = np.ascontiguousarray(history.in_frame(np.asarray(points_m, np.float64))).reshape(-1, 3)
    points_d: wp.array = wp.array(points, dtype=wp.vec3d, device=target)

    with console.progress(pulses, "focusing", "pulse") as bar:
        for part in np.array_split(order, subapertures):
            weights = taper(window_azimuth, centred(cosine[part]))
            image = wp.zeros(points.shape[0], dtype=wp.vec2, device=target)
            bins = profile_bins(history)
            block = max(1, PROFILE_BYTES // (8 * bins))
            for first in range(0, part.size, block):
                chosen = part[first : first + block]
                _add_pulses(history, chosen, weights[first : first + block], window_range, points_d, image, target)
                bar.update(chosen.size)
            flat = image.numpy()
            scale = np.float32(1.0 / weights.sum())
            yield ((flat[:, 0] + 1j * flat[:, 1]) * scale).astype(np.complex64).reshape(points_m.shape[:-1])


def _add_pulses(
    history: PhaseHistory,
    chosen: np.ndarray,
    weights: np.ndarray,
    window_range: str,
    points: wp.array,
    image: wp.array,
    device: wp.Device,
) -> None:
    """Add the pulses `chosen` to `image` (vec2, shape (n,)) at `points` (vec3d, shape (n,))."""
    pulses = uploaded(history, chosen, weights, window_range, device)

    def launch(first: int, last: int) -> None:
        wp.launch(
            backproject_kernel,
            dim=last - first,
            inputs=[points[first:last], pulses],
            outputs=[image[first:last]],
            device=device,
        )

    size = points.shape[0]
    step_points = _PIXELS_PER_TASK if device.is_cpu else size
    tasks = [partial(launch, a, min(a + step_points, size)) for a in range(0, size, step_points)]
    for _ in threads.ordered(tasks, device):
        pass


def uploaded(
    history: PhaseHistory, chosen: np.ndarray, weights: np.ndarray, window_range: str, device: wp.Device
) -> Any:
    """The range profiles of some pulses on a device, `kernels.backproject.Pulses`."""
    profiles, frequency, bins_per_metre = range_profiles(history, chosen, weights, window_range)
    step = history.frequency_step_hz[chosen]
    sender = np.empty((0, 3)) if history.transmitter_m is None else history.transmitter_m[chosen]

    def upload(values: np.ndarray) -> wp.array:
        return wp.array(values, dtype=wp.float64, device=device)

    return fill(
        Pulses,
        position=wp.array(history.position_m[chosen], dtype=wp.vec3d, device=device),
        sender=wp.array(sender, dtype=wp.vec3d, device=device),
        reference_range=upload(history.reference_range_m[chosen]),
        turns_per_metre=upload(2.0 * frequency / SPEED_OF_LIGHT),
        bins_per_metre=upload(bins_per_metre),
        half_swath=upload(SPEED_OF_LIGHT / (4.0 * step)),
        profile=wp.array(profiles.view(np.float32).reshape(*profiles.shape, 2), dtype=wp.vec2, device=device),
    )


def profile_bins(history: PhaseHistory) -> int:
    return 1 << math.ceil(math.log2(OVERSAMPLING * history.samples.shape[0]))


def range_profiles(
    history: PhaseHistory, chosen: np.ndarray, weights: np.ndarray, window: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Range-compressed pulses: complex64 (pulse, bin), the frequency [Hz] they are demodulated to, bins per metre."""
    count = history.samples.shape[0]
    bins = profile_bins(history)
    band = taper(window, (np.arange(count) + 0.5) / count - 0.5)
    middle = count // 2
    start, step = history.frequency_start_hz[chosen], history.frequency_step_hz[chosen]
    spectrum = np.zeros((chosen.size, bins), np.complex64)
    weighted = history.samples[:, chosen].T * (weights[:, None] * (band / band.sum()))
    spectrum[:, : count - middle] = weighted[:, middle:]
    spectrum[:, bins - middle :] = weighted[:, :middle]
    profiles = fft.ifft(spectrum, axis=1, norm="forward", workers=threads.thread_count())
    return profiles, start + middle * step, bins * 2.0 * step / SPEED_OF_LIGHT


def cross_range_cosine(history: PhaseHistory, reference_point_m: np.ndarray) -> np.ndarray:
    """Cosine of the angle between each pulse's direction and the track's, seen from the reference point, (pulse,)."""
    toward = history.towards(reference_point_m)[0]
    track = np.linalg.svd(toward - toward.mean(axis=0), full_matrices=False)[2][0]
    return toward @ track


def _spread(count: int) -> float:
    """Width of an aperture over the distance of its first and last sample: each sample stands for an interval."""
    return count / max(1, count - 1)


def centred(cosine: np.ndarray) -> np.ndarray:
    """Place of each pulse in its aperture, -1/2 to 1/2."""
    width = np.ptp(cosine) * _spread(cosine.size)
    middle = (cosine.max() + cosine.min()) / 2.0
    return (cosine - middle) / width if width > 0.0 else np.zeros_like(cosine)
