"""A point target in an image: where it is, its radar cross-section with an interval, and its response."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.special import gammaincc, ndtri

F64 = NDArray[np.float64]
OVERSAMPLING = 4
"""Of the grid on which a complex peak is searched and integrated. Power has twice the bandwidth of the samples."""
CUT_OVERSAMPLING = 64
FINER = 1024
OUTLIER = 10.0
"""Clutter over its mean by this factor is another target: of speckle exp(-10) is so bright."""
SIDELOBE_CELLS = 10.0
"""How far from the peak sidelobes count."""
PLACE_REACH = 1.0
PLACE_STEPS = 33
"""Pixels to both sides of the brightest one in which a detected point is placed, and steps there."""
HIGH_SCR = 1e4
"""Beyond it the place's likelihood is narrower than the table's steps."""
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
        inside = np.linspace(-0.5, 0.5, 9) * self.pixel_m if self.pixel_m else np.zeros(1)
        at = np.asarray(offset_m, np.float64)[..., None] + inside
        return np.asarray((_response(self.hamming, at * self.bandwidth) ** 2).mean(axis=-1) / self.peak_m)

    def share(self, half_m: float) -> float:
        """Of a point's energy, what lies within `half_m` of it [m].

        Of whole pixels it is the mean over where in its pixel the point lies.
        """
        return _share(self.hamming, half_m * self.bandwidth, self.pixel_m * self.bandwidth)

    def peak_sd_m(self, scr: float) -> float:
        """Deviation of a peak's place by clutter [m]; without a window sqrt(3 / (2 pi^2 SCR)) / bandwidth where the SCR
        is high (Bamler and Eineder, IEEE GRSL 2, 2005). Where it is low, the peak's top is flatter than a parabola."""
        return _peak_sd(self.hamming, scr) / self.bandwidth

    def amplitude2(self, offset_m: F64) -> F64:
        """Power of a point at distances from it [m], over its peak; whole pixels are averaged."""
        return self.power_1_m(offset_m) * self.peak_m

    def correlation(self, offset_m: F64) -> F64:
        """Of clutter's amplitude, between places so far apart [m]."""
        return _correlation(self.hamming, np.asarray(offset_m) * self.bandwidth)

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


def _response(hamming: float, at: F64) -> F64:
    """Amplitude of a point over its peak, at distances in units of 1 / bandwidth."""
    beside = 0.5 * (1.0 - hamming)
    return np.asarray(np.sinc(at) + beside / hamming * (np.sinc(at - 1.0) + np.sinc(at + 1.0)))


def _correlation(hamming: float, apart: F64) -> F64:
    """Of clutter, which has passed the window, at distances in units of 1 / bandwidth."""
    rest = 1.0 - hamming
    shares = hamming**2 + 0.5 * rest**2, hamming * rest, 0.25 * rest**2  # of w^2: 1, exp(+-i t), exp(+-2 i t)
    found = shares[0] * np.sinc(apart)
    for k in (1, 2):
        found = found + shares[k] * (np.sinc(apart - k) + np.sinc(apart + k))
    return np.asarray(found / shares[0])


def _peak_sd(hamming: float, scr: float) -> float:
    """Lengths in units of 1 / bandwidth."""
    at, response, against = _peak_shape(hamming)
    likely = np.exp(np.maximum(scr / against * (response**2 - 1.0), -700.0))
    if scr > HIGH_SCR:  # the parabola of the top
        bend = (2.0 * np.pi) ** 2 * float(_weights(hamming) @ ((np.arange(FINER) + 0.5) / FINER - 0.5) ** 2)
        return float(np.sqrt(against / (2.0 * scr * bend / _weights(hamming).sum())))
    return float(np.sqrt((at**2 * likely).sum() / likely.sum()))


@lru_cache(maxsize=64)
def _peak_shape(hamming: float) -> tuple[F64, F64, float]:
    """Places to one cell from the peak, the amplitude there, and int f^2 w^2 / int w^2 over int f^2 w / int w: clutter
    has passed the window once more in power, so it moves the peak less than the top's curvature alone says."""
    weights = _weights(hamming)
    frequency = (np.arange(FINER) + 0.5) / FINER - 0.5
    at = np.linspace(-1.0, 1.0, 801)
    moments = [(frequency**2 * w).sum() / w.sum() for w in (weights**2, weights)]
    return at, _response(hamming, at), float(moments[0] / moments[1])


def _weights(hamming: float) -> F64:
    at = (np.arange(FINER) + 0.5) / FINER - 0.5
    return np.asarray(hamming + (1.0 - hamming) * np.cos(2.0 * np.pi * at))


@lru_cache(maxsize=256)
def _share(hamming: float, half: float, pixel: float) -> float:
    """Lengths in units of 1 / bandwidth."""
    weights = _weights(hamming)
    reach = half + 0.5 * pixel
    at = np.linspace(0.0, reach, 1001)
    response = _response(hamming, at) * weights.mean()
    inside = np.clip((reach - at) / pixel, 0.0, 1.0) if pixel else np.ones_like(at)
    return float(2.0 * np.trapezoid(response**2 * inside, at) / (weights**2).mean())  # by Parseval


@lru_cache(maxsize=256)
def _moments(hamming: float, half: float) -> tuple[float, float]:
    """Double integrals over a window, of the response with clutter's correlation, and of that correlation squared over
    the window's length; lengths in units of 1 / bandwidth."""
    weights = _weights(hamming)
    at, step = np.linspace(-half, half, 401, retstep=True)
    response = _response(hamming, at) * weights.mean() / np.sqrt((weights**2).mean())
    whole = toeplitz(_correlation(hamming, step * np.arange(401)))
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
    """Of azimuth and range, by clutter. It holds the chance that the peak is clutter's and the point lies elsewhere."""
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
    looks = response[0].looks * response[1].looks
    chance = tried * float(gammaincc(looks, looks * peak / clutter)) if clutter > 0.0 else 0.0
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
    scr = max(peak / clutter - 1.0, 0.0) if clutter > 0.0 else float("inf")
    # The peak lies over the target by one clutter, and by one half more for each axis on which it was sought.
    strength = max(looks * (scr - 1.0), 1.0)
    near_sd = response[0].peak_sd_m(strength), response[1].peak_sd_m(strength)
    if not complex_chip and seen:
        # Pixels no longer than a cell may be samples as well as means, and the file does not say which.
        first, second = (
            replace(axis, pixel_m=axis.pixel_m * (axis.pixel_m * axis.bandwidth > 1.0)) for axis in response
        )
        fits = [
            _matched(power, inside, (line, pixel), clutter, spacing_m, each) for each in (response, (first, second))
        ]
        (line, pixel), near_sd, _ = max(fits, key=lambda one: one[2])
    evidence = power * (looks / clutter) if clutter > 0.0 else power
    position_sd = _with_elsewhere(near_sd, evidence, near, (lines, pixels), (line, pixel), spacing_m, cells)
    return PointMeasurement(
        line=line,
        pixel=pixel,
        position_sd_m=position_sd,
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
    if corners.size == 0 or corners.mean() <= 0.0:
        return 0.0, 1.0
    for _ in range(3):
        corners = corners[corners <= OUTLIER * corners.mean()]
    return float(corners.mean()), float(corners.size)


def _matched(
    power: F64,
    inside: F64,
    start: tuple[float, float],
    clutter: float,
    spacing_m: tuple[float, float],
    response: tuple[ResponseAxis, ResponseAxis],
) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Of a detected image, the place at which a point's power fits best by least squares, its deviations [m], and what
    the fit takes off the sum of squares.

    Power of pixels i and j has the covariance (2 T C h_i h_j rho_ij + C^2 rho_ij^2) / looks: T is the peak's power, C
    clutter's, h the point's amplitude, and rho clutter's correlation.
    """
    taken = [np.flatnonzero(inside.any(axis=1 - axis)) for axis in (0, 1)]
    above = power[np.ix_(*taken)] - clutter
    steps = np.linspace(-PLACE_REACH, PLACE_REACH, PLACE_STEPS)
    shapes = [
        axis.amplitude2((at - (begin + steps[:, None])) * step)
        for axis, at, begin, step in zip(response, taken, start, spacing_m, strict=True)
    ]
    norm = np.outer((shapes[0] ** 2).sum(axis=1), (shapes[1] ** 2).sum(axis=1))
    along = shapes[0] @ above @ shapes[1].T
    fit = np.maximum(along, 0.0) ** 2 / norm
    top = np.unravel_index(fit.argmax(), fit.shape)
    place, _ = _refined(fit, (int(top[0]), int(top[1])))
    found = [s + np.interp(p, np.arange(PLACE_STEPS), steps) for s, p in zip(start, place, strict=True)]
    peak = max(float(along[top] / norm[top]), 1e-3 * clutter)
    beats, own, slope = [], [], []
    for axis, at, middle, step in zip(response, taken, found, spacing_m, strict=True):
        off = (at - middle) * step
        shape = axis.amplitude2(off)
        rho = axis.correlation(off[:, None] - off)
        edge = 0.02 / axis.bandwidth
        ramp = (axis.amplitude2(off + edge) - axis.amplitude2(off - edge)) / (2.0 * edge)
        each = np.sqrt(shape)[:, None] * rho * np.sqrt(shape)
        beats.append([v @ each @ v for v in (ramp, shape)])
        own.append([v @ rho**2 @ v for v in (ramp, shape)])
        slope.append([(v**2).sum() for v in (ramp, shape)])
    looks = response[0].looks * response[1].looks
    deviations = [
        np.sqrt((2.0 * peak * clutter * beats[k][0] * beats[1 - k][1] + clutter**2 * own[k][0] * own[1 - k][1]) / looks)
        / (peak * slope[k][0] * slope[1 - k][1])
        for k in (0, 1)
    ]
    return (float(found[0]), float(found[1])), (float(deviations[0]), float(deviations[1])), float(fit[top])


def _with_elsewhere(
    near_sd: tuple[float, float],
    strength: F64,
    near: NDArray[np.bool_],
    axes: tuple[F64, F64],
    place: tuple[float, float],
    spacing_m: tuple[float, float],
    cells: tuple[float, ...],
) -> tuple[float, float]:
    """Deviations of the place, if the point may be another peak of the searched box as well.

    A point of unknown amplitude in Gaussian clutter lies at a place with a likelihood exp(power over clutter), the
    amplitude integrated out. Beyond one cell from the peak that is another peak's.
    """
    off = [(at - p) * s for at, p, s in zip(axes, place, spacing_m, strict=True)]
    main = (np.abs(off[0]) <= cells[0])[:, None] & (np.abs(off[1]) <= cells[1])
    box = near | main
    likely = np.where(box, np.exp(np.minimum(strength - strength[box].max(), 0.0)), 0.0)
    likely /= likely.sum()
    here = float(likely[main].sum())
    beyond = np.where(main, 0.0, likely)
    second = (beyond.sum(axis=1) * off[0] ** 2).sum(), (beyond.sum(axis=0) * off[1] ** 2).sum()
    return (
        float(np.sqrt(here * near_sd[0] ** 2 + second[0])),
        float(np.sqrt(here * near_sd[1] ** 2 + second[1])),
    )


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
