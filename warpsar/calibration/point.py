"""A point target in an image: where it is, its radar cross-section with an interval, and its response."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.special import ndtri

F64 = NDArray[np.float64]
OVERSAMPLING = 4
"""Of the grid on which a complex peak is searched and integrated. Power has twice the bandwidth of the samples."""
CUT_OVERSAMPLING = 64
FINER = 1024
OUTLIER = 10.0
"""Clutter over its mean by this factor is another target: of speckle exp(-10) is so bright."""
SIDELOBE_CELLS = 10.0
"""How far from the peak sidelobes count."""
SKEW_TURNS = 8
"""In which an interval's end and the skew there settle."""
ABSENT = 0.01
"""Chance that clutter alone has such a peak somewhere in the box that is searched: above it nothing is seen."""


@dataclass(frozen=True)
class ResponseAxis:
    """The response to a point along one axis: a band of `bandwidth` [1/m] under a window alpha - (1 - alpha) cos.

    `pixel_m` [m]: of a detected image, whose pixels are taken whole; 0 for a complex one. `looks`: how many such bands
    side by side are averaged in power.
    """

    bandwidth: float
    hamming: float = 1.0
    pixel_m: float = 0.0
    looks: float = 1.0

    @property
    def cell_m(self) -> float:
        """Length of an independent sample of clutter: int w^4 / (int w^2)^2; 1 / bandwidth, unweighted."""
        weights = _weights(self.hamming)
        return float((weights**4).mean() / (weights**2).mean() ** 2 / self.bandwidth / self.looks)

    @property
    def peak_m(self) -> float:
        """A point's energy over its peak: int w^2 / (int w)^2 [m]; 1 / bandwidth, unweighted."""
        weights = _weights(self.hamming)
        return float((weights**2).mean() / weights.mean() ** 2 / self.bandwidth)

    def power_1_m(self, offset_m: F64) -> F64:
        """Of a point, at distances (n,) from it [m]: its integral over all of them is 1. Whole pixels are averaged."""
        frequency = ((np.arange(FINER) + 0.5) / FINER - 0.5) * self.bandwidth
        inside = np.linspace(-0.5, 0.5, 9) * self.pixel_m if self.pixel_m else np.zeros(1)
        at = np.asarray(offset_m, np.float64)[:, None] + inside
        response = np.cos(2.0 * np.pi * at[..., None] * frequency) @ _weights(self.hamming) / FINER
        energy = (_weights(self.hamming) ** 2).mean() / self.bandwidth
        return np.asarray((response**2).mean(axis=1) / energy)

    def share(self, half_m: float) -> float:
        """Of a point's energy, what lies within `half_m` of it [m].

        Of whole pixels it is the mean over where in its pixel the point lies.
        """
        return _share(self.hamming, half_m * self.bandwidth, self.pixel_m * self.bandwidth)

    def interference_m(self, half_m: float) -> float:
        """Clutter that beats with the target under a window of `half_m` to both sides [m].

        With s the point's response of energy 1 and rho the correlation of clutter it is the double integral of
        s(x) s(y) rho(x - y) over the window, per look. Over all space it is `cell_m`; a window cuts the response, whose
        cut edges meet clutter of all the band.
        """
        return _moments(self.hamming, half_m * self.bandwidth)[0] / self.bandwidth / self.looks

    def unevenness_m(self, half_m: float) -> float:
        """Variance of the mean of clutter's power under that window, over its square, times the window [m].

        The double integral of rho(x - y)^2 over the window, over the window's length. For long windows: `cell_m`.
        """
        return _moments(self.hamming, half_m * self.bandwidth)[1] / self.bandwidth / self.looks


def _weights(hamming: float) -> F64:
    at = (np.arange(FINER) + 0.5) / FINER - 0.5
    return np.asarray(hamming + (1.0 - hamming) * np.cos(2.0 * np.pi * at))


@lru_cache(maxsize=256)
def _share(hamming: float, half: float, pixel: float) -> float:
    """Lengths in units of 1 / bandwidth."""
    weights = _weights(hamming)
    reach = half + 0.5 * pixel
    at = np.linspace(0.0, reach, 1001)
    frequency = (np.arange(FINER) + 0.5) / FINER - 0.5
    response = np.cos(2.0 * np.pi * np.outer(at, frequency)) @ weights / FINER
    inside = np.clip((reach - at) / pixel, 0.0, 1.0) if pixel else np.ones_like(at)
    return float(2.0 * np.trapezoid(response**2 * inside, at) / (weights**2).mean())  # by Parseval


@lru_cache(maxsize=256)
def _moments(hamming: float, half: float) -> tuple[float, float]:
    """Double integrals over a window, of the response with clutter's correlation, and of that correlation squared over
    the window's length; lengths in units of 1 / bandwidth."""
    weights = _weights(hamming)
    at, step = np.linspace(-half, half, 401, retstep=True)
    frequency = (np.arange(FINER) + 0.5) / FINER - 0.5
    response = np.cos(2.0 * np.pi * np.outer(at, frequency)) @ weights / FINER / np.sqrt((weights**2).mean())
    apart = step * np.arange(401)
    correlation = np.cos(2.0 * np.pi * np.outer(apart, frequency)) @ weights**2 / FINER / (weights**2).mean()
    whole = toeplitz(correlation)
    trapezoid = np.full(401, step)
    trapezoid[[0, -1]] *= 0.5
    beats = float((response * trapezoid) @ whole @ (response * trapezoid))
    return beats, float(trapezoid @ whole**2 @ trapezoid) / (2.0 * half)


@dataclass(frozen=True)
class PointSettings:
    """What is integrated, in resolution cells (1 / bandwidth, or pixels where those are longer)."""

    window_cells: float = 2.0
    """Half of the window about the peak."""
    guard_cells: float = 1.0
    """Between the window and clutter."""
    clutter_cells: float = 10.0
    """Half of the box whose four corners are clutter. Its rows and columns hold the target's sidelobes."""
    confidence: float = 0.9


@dataclass(frozen=True)
class AxisQuality:
    """Width and sidelobes of the response along one axis."""

    width_m: float
    """At half power."""
    pslr_db: float
    """Highest sidelobe over the peak."""
    islr_db: float
    """Energy of the sidelobes over that of the main lobe, between its first minima."""


@dataclass(frozen=True)
class PointMeasurement:
    """Lines and pixels are fractions, in the chip that was given. Areas are in m2 of RCS."""

    line: float
    pixel: float
    position_sd_m: tuple[float, float]
    """Of azimuth and range: the bound by clutter, sqrt(3 / (2 pi^2 SCR)) cells (Bamler and Eineder, 2005)."""
    rcs_m2: float
    """By the integral, clutter subtracted, over the share of the response that the window holds."""
    low_m2: float
    high_m2: float
    peak_rcs_m2: float
    """By the peak: its power, clutter subtracted, times the area of the response; NaN for detected images."""
    scr: float
    """The peak's power, clutter subtracted, over the mean power of clutter."""
    clutter: float
    """Mean power of a pixel, in the unit of the image."""
    clutter_cells: float
    """Independent samples of clutter that were averaged."""
    window_share: float
    phase_deg: float | None
    """Of the peak; None for detected images."""
    quality: tuple[AxisQuality, AxisQuality] | None
    """Of azimuth and range; None for detected images."""
    seen: bool
    """Whether the peak stands out of the clutter. If not, the RCS is of what lies at the expected place."""


def measure_point(
    chip: NDArray[np.complex128] | F64,
    expected: tuple[float, float],
    search: tuple[float, float],
    spacing_m: tuple[float, float],
    response: tuple[ResponseAxis, ResponseAxis],
    settings: PointSettings | None = None,
) -> PointMeasurement:
    """Measure the brightest point within `search` (lines, pixels) of the expected place, (line, pixel).

    `chip` (lines, pixels) is a complex image whose power is beta0, or that power. `spacing_m` and `response` are of
    azimuth and range. docs/reflectors.md states the estimate and its interval.
    """
    settings = settings or PointSettings()
    complex_chip = np.iscomplexobj(chip)
    samples = np.asarray(chip, np.complex128)
    turns = _centroids(samples) if complex_chip else (0.0, 0.0)
    factor = OVERSAMPLING if complex_chip else 1
    fine = _padded(_still(samples, turns), (factor, factor)) if complex_chip else samples
    power: F64 = np.abs(fine) ** 2 if complex_chip else fine.real
    lines, pixels = (np.arange(n) / factor for n in power.shape)
    near = (np.abs(lines - expected[0]) <= search[0])[:, None] & (np.abs(pixels - expected[1]) <= search[1])
    top = np.unravel_index(np.where(near, power, -np.inf).argmax(), power.shape)
    place, raised = _refined(power, (int(top[0]), int(top[1])))
    line, pixel = (at / factor for at in place)
    cells = tuple(max(1.0 / axis.bandwidth, axis.pixel_m) for axis in response)
    pixel_area = spacing_m[0] * spacing_m[1]
    cell_area = response[0].cell_m * response[1].cell_m
    clutter, count = _clutter(power, (lines, pixels), (line, pixel), spacing_m, cells, settings)
    independent = count * pixel_area / factor**2 / cell_area
    peak = float(power[top]) * (raised if complex_chip else 1.0)
    tried = max((2.0 * search[0] * spacing_m[0]) * (2.0 * search[1] * spacing_m[1]) / cell_area, 1.0)
    chance = tried * np.exp(-min(peak / clutter, 700.0)) if clutter > 0.0 else 0.0
    seen = bool(chance < ABSENT)
    if not seen:
        line, pixel = expected
    half = [settings.window_cells * cell for cell in cells]
    if not complex_chip:  # whole pixels about the brightest one
        line, pixel = (float(top[0]), float(top[1])) if seen else (round(line), round(pixel))
        half = [(round(h / s) + 0.5) * s for h, s in zip(half, spacing_m, strict=True)]
    # A sample stands for its cell of the grid, which the window's edge may cut.
    weights = [
        np.clip((h + 0.5 * s / factor - np.abs(at - place) * s) * factor / s, 0.0, 1.0)
        for at, place, h, s in zip((lines, pixels), (line, pixel), half, spacing_m, strict=True)
    ]
    inside = weights[0][:, None] * weights[1]
    share = float(np.prod([axis.share(h) for axis, h in zip(response, half, strict=True)]))
    window_area = float(inside.sum()) * pixel_area / factor**2
    target = (float((power * inside).sum()) * pixel_area / factor**2 - clutter * window_area) / share
    # What beats with the target, clutter under it, and the error of clutter's mean; all over the share.
    beating = clutter * float(np.prod([axis.interference_m(h) for axis, h in zip(response, half, strict=True)]))
    uneven = float(np.prod([axis.unevenness_m(h) for axis, h in zip(response, half, strict=True)]))
    cell_rcs = beating / share**2
    spread = clutter**2 * window_area * (uneven + window_area / independent) / share**2
    z = float(ndtri(0.5 + 0.5 * settings.confidence))
    # Third cumulants: of the target in clutter 6 T q^2, as of a non-central chi-squared; of clutter alone, of a gamma.
    own = clutter**2 * window_area * uneven / share**2
    third = 6.0 * cell_rcs**2, 2.0 * own**2 / max(clutter * window_area / share, 1e-300)
    low, high = interval(target, cell_rcs, spread, z, third)
    if not complex_chip and seen:
        line, pixel = _centroid(power, inside, clutter)
    scr = max(peak / clutter - 1.0, 0.0) if clutter > 0.0 else float("inf")
    bound = np.sqrt(3.0 / (2.0 * np.pi**2 * max(scr, 1e-3)))
    return PointMeasurement(
        line=line,
        pixel=pixel,
        position_sd_m=(bound / response[0].bandwidth, bound / response[1].bandwidth),
        rcs_m2=target,
        low_m2=low,
        high_m2=high,
        peak_rcs_m2=(peak - clutter) * response[0].peak_m * response[1].peak_m if complex_chip else float("nan"),
        scr=scr,
        clutter=clutter,
        clutter_cells=independent,
        window_share=share,
        phase_deg=_phase_deg(fine, place, factor, turns) if complex_chip else None,
        quality=_qualities(_still(samples, turns), (line, pixel), spacing_m, cells) if complex_chip and seen else None,
        seen=seen,
    )


def interval(
    target: float, cell: float, spread: float, z: float, third: tuple[float, float] = (0.0, 0.0)
) -> tuple[float, float]:
    """All T for which the estimate is neither among the largest nor among the smallest: `z` deviations to both sides.

    The estimate has the mean T, the variance V = 2 T cell + spread (the beat of the target with the clutter of one
    resolution cell, and the clutter's own), and the third cumulant K = third[0] T + third[1]. Its quantile is that of
    Cornish and Fisher, T +- z sqrt(V) + (z^2 - 1) K / (6 V): power has a long upper tail. Less than
    no power is the clutter's unevenness: the upper bound is at least that of an estimate one deviation of clutter below
    0, beyond which there is no power to exclude a target (Cowan, Cranmer, Gross and Vitells, arXiv:1105.3166, 2011).
    """

    def bound(side: float, target: float) -> float:
        found = max(target, cell)
        for _ in range(SKEW_TURNS):
            variance = max(2.0 * found * cell + spread, 1e-300)
            at = target - (z**2 - 1.0) / 6.0 * (third[0] * found + third[1]) / variance
            root = np.sqrt(max(z**2 * (2.0 * cell * at + spread) + z**4 * cell**2, 0.0))
            found = max(at + z**2 * cell + side * root, 0.0)
        return float(found)

    return bound(-1.0, target), bound(1.0, max(target, -float(np.sqrt(spread))))


def _centroids(samples: NDArray[np.complex128]) -> tuple[float, float]:
    """The spectrum's middle [rad per sample] along both axes, by the phase from sample to sample."""
    along = np.vdot(samples[:-1], samples[1:]), np.vdot(samples[:, :-1], samples[:, 1:])
    return float(np.angle(along[0])), float(np.angle(along[1]))


def _still(samples: NDArray[np.complex128], turns: tuple[float, float]) -> NDArray[np.complex128]:
    """With the spectrum's middle at zero frequency."""
    lines, pixels = (np.arange(n) for n in samples.shape)
    return np.asarray(samples * np.exp(-1j * (turns[0] * lines[:, None] + turns[1] * pixels)))


def _padded(samples: NDArray[np.complex128], factors: tuple[int, int]) -> NDArray[np.complex128]:
    """On a grid so many times as fine, by zeros about the spectrum."""
    spectrum = np.fft.fftshift(np.fft.fft2(samples))
    shape = tuple(n * f for n, f in zip(samples.shape, factors, strict=True))
    whole = np.zeros(shape, np.complex128)
    # The zero frequency of an axis of n samples lies at n // 2 after the shift.
    start = [big // 2 - n // 2 for big, n in zip(shape, samples.shape, strict=True)]
    whole[start[0] : start[0] + samples.shape[0], start[1] : start[1] + samples.shape[1]] = spectrum
    return np.asarray(np.fft.ifft2(np.fft.ifftshift(whole)) * factors[0] * factors[1])


def _refined(power: F64, top: tuple[int, int]) -> tuple[tuple[float, float], float]:
    """A peak between samples, and its power over the highest one: the parabola through three logarithms, per axis."""
    place, raised = [], 0.0
    for axis, at in enumerate(top):
        off = 0.0
        if 0 < at < power.shape[axis] - 1:
            three = power[at - 1 : at + 2, top[1]] if axis == 0 else power[top[0], at - 1 : at + 2]
            low, middle, high = np.log(np.maximum(three, 1e-300))
            bend = low - 2.0 * middle + high
            if bend < 0.0:
                off = 0.5 * (low - high) / bend
                raised += -0.125 * (low - high) ** 2 / bend
        place.append(at + off)
    return (place[0], place[1]), float(np.exp(raised))


def _clutter(
    power: F64,
    axes: tuple[F64, F64],
    place: tuple[float, float],
    spacing_m: tuple[float, float],
    cells: tuple[float, ...],
    settings: PointSettings,
) -> tuple[float, float]:
    """Mean power of the four corners, without other targets, and how many samples of `power` that are."""
    out, within = settings.window_cells + settings.guard_cells, settings.clutter_cells
    off = [np.abs(at - p) * s / c for at, p, s, c in zip(axes, place, spacing_m, cells, strict=True)]
    taken = [(each > out) & (each <= within) for each in off]
    corners = power[taken[0][:, None] & taken[1]]
    corners = corners[np.isfinite(corners)]
    if corners.size == 0:
        return 0.0, 1.0
    for _ in range(3):
        corners = corners[corners <= OUTLIER * corners.mean()]
    return float(corners.mean()), float(corners.size)


def _centroid(power: F64, inside: F64, clutter: float) -> tuple[float, float]:
    weight = inside * np.maximum(power - clutter, 0.0)
    lines, pixels = (np.arange(n) for n in power.shape)
    total = weight.sum()
    return float((weight.sum(axis=1) * lines).sum() / total), float((weight.sum(axis=0) * pixels).sum() / total)


def _phase_deg(
    fine: NDArray[np.complex128], place: tuple[float, float], factor: int, turns: tuple[float, float]
) -> float:
    sample = fine[round(place[0]) % fine.shape[0], round(place[1]) % fine.shape[1]]
    nearest = round(place[0]) / factor, round(place[1]) / factor
    return float(np.degrees(np.angle(sample * np.exp(1j * (turns[0] * nearest[0] + turns[1] * nearest[1])))))


def _qualities(
    still: NDArray[np.complex128],
    place: tuple[float, float],
    spacing_m: tuple[float, float],
    cells: tuple[float, ...],
) -> tuple[AxisQuality, AxisQuality]:
    """Of cuts through the peak, which is moved to a sample first. The spectrum lies about zero."""
    nearest = round(place[0]), round(place[1])
    shift = [p - n for p, n in zip(place, nearest, strict=True)]
    ramps = [np.exp(2j * np.pi * np.fft.fftfreq(n) * s) for n, s in zip(still.shape, shift, strict=True)]
    moved = np.fft.ifft2(np.fft.fft2(still) * ramps[0][:, None] * ramps[1])
    cuts = moved[:, nearest[1]], moved[nearest[0], :]
    found = [_quality(cut, at, step, cell) for cut, at, step, cell in zip(cuts, nearest, spacing_m, cells, strict=True)]
    return found[0], found[1]


def _quality(cut: NDArray[np.complex128], at: int, step_m: float, cell_m: float) -> AxisQuality:
    fine = np.abs(_padded(cut[None], (1, CUT_OVERSAMPLING))[0]) ** 2
    step, top = step_m / CUT_OVERSAMPLING, at * CUT_OVERSAMPLING
    near = slice(max(top - CUT_OVERSAMPLING, 0), top + CUT_OVERSAMPLING + 1)
    top = near.start + int(fine[near].argmax())
    edges, ends = [], []
    for way in (-1, 1):
        arm = fine[top::way] / fine[top]
        below = np.flatnonzero(arm < 0.5)
        if below.size == 0:
            return AxisQuality(float("nan"), float("nan"), float("nan"))
        last = int(below[0])
        edges.append(last - 1 + (arm[last - 1] - 0.5) / (arm[last - 1] - arm[last]))
        rising = np.flatnonzero(np.diff(arm[last:]) > 0.0)
        ends.append(last + int(rising[0]) if rising.size else arm.size - 1)
    reach = int(SIDELOBE_CELLS * cell_m / step)
    left, right = fine[max(top - reach, 0) : top - ends[0]], fine[top + ends[1] + 1 : top + reach + 1]
    sides = np.concatenate([left, right])
    main = fine[top - ends[0] : top + ends[1] + 1]
    if sides.size == 0:
        return AxisQuality(sum(edges) * step, float("nan"), float("nan"))
    with np.errstate(divide="ignore"):
        return AxisQuality(
            sum(edges) * step,
            float(10.0 * np.log10(sides.max() / fine[top])),
            float(10.0 * np.log10(sides.sum() / main.sum())),
        )
