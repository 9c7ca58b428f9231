"""One reflector in one product: where it must be, where it is, and what it sends back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from warpsar.calibration.attitude import Facing, trihedral_rcs_m2
from warpsar.calibration.point import PointMeasurement, PointSettings, ResponseAxis, measure_point
from warpsar.calibration.sites import ReflectorSite
from warpsar.errors import InputError
from warpsar.products.product import ImagedPoint, Product, Radiometry, to_beta0
from warpsar.world.frame import SPEED_OF_LIGHT

F64 = NDArray[np.float64]
Status = Literal[
    "measured",
    "not seen",
    "outside",
    "too near the edge",
    "masked",
    "saturated",
    "not apart",
    "no calibration",
    "no orbit",
    "no image",
]
CELLS_BESIDE = 1.0
"""Beyond the window: nearer than this a point has its main lobe in it."""
ONE_PLACE_CELLS = 0.01
"""Nearer than this two sites are one device."""
ALLOWANCE_M = (15.0, 15.0)
"""In azimuth and slant range: atmosphere (2 to 4 m), tides (0.2 m), and the product's own timing."""
FEWEST_PIXELS = 2.0
"""Lines and pixels that are searched, where the allowance is less."""


@dataclass(frozen=True)
class Cutout:
    """The image about a reflector: power (lines, pixels) in beta0, or in the product's own numbers."""

    power: F64
    line: int
    pixel: int
    """Of its first sample in the product."""


@dataclass(frozen=True)
class ReflectorObservation:
    """A reflector in a product. What is not known is None."""

    site: ReflectorSite
    source: str
    platform: str
    polarization: str | None
    date: np.datetime64
    status: Status
    reason: str = ""
    """In words, where it is not "measured"."""
    stands: bool = True
    """Whether the table of sites says that it stands at that date."""
    expected: ImagedPoint | None = None
    spacing_m: tuple[float, float] | None = None
    """Of azimuth, on the ground, and slant range."""
    point: PointMeasurement | None = None
    """In the product's lines and pixels."""
    noise_db: float | None = None
    """beta0 of the annotated noise."""
    facing: Facing | None = None
    closed_form_m2: float | None = None
    engine_m2: float | None = None
    response: tuple[ResponseAxis, ResponseAxis] | None = None
    """Of azimuth and range."""
    cutout: Cutout | None = None

    @property
    def calibrated(self) -> bool:
        return self.status in ("measured", "not seen")

    @property
    def predicted_m2(self) -> float | None:
        """By the engine where it was asked, else in closed form."""
        return self.closed_form_m2 if self.engine_m2 is None else self.engine_m2

    @property
    def difference_db(self) -> float | None:
        """Measured over predicted."""
        if self.status != "measured" or self.point is None or not self.predicted_m2 or self.point.rcs_m2 <= 0.0:
            return None
        return float(10.0 * np.log10(self.point.rcs_m2 / self.predicted_m2))

    @property
    def difference_sd_db(self) -> float | None:
        """Of clutter and noise, to first order."""
        if self.point is None or self.point.rcs_m2 <= 0.0 or self.point.low_m2 <= 0.0:
            return None
        from_low_to_high = 10.0 * np.log10(self.point.high_m2 / self.point.low_m2)
        return float(from_low_to_high / (2.0 * 1.6449))  # a 90 % interval

    @property
    def offset_m(self) -> tuple[float, float] | None:
        """Found less expected place, in azimuth and slant range."""
        if self.status in ("not seen", "not apart") or None in (self.point, self.expected, self.spacing_m):
            return None
        assert self.point is not None
        assert self.expected is not None
        assert self.spacing_m is not None
        steps = self.point.line - self.expected.line, self.point.pixel - self.expected.pixel
        return steps[0] * self.spacing_m[0], steps[1] * self.spacing_m[1]


def observe(
    product: Product,
    site: ReflectorSite,
    allowance_m: tuple[float, float],
    settings: PointSettings,
    radiometry: Radiometry | None = None,
) -> ReflectorObservation:
    """Measure a reflector in a product. `allowance_m`: how far off it may be, in azimuth and slant range.

    `radiometry` says what power is, where the product does not. What cannot be measured has a status that says why.
    """
    date = product.date(product.grid.middle_s)
    blank = ReflectorObservation(
        site, product.source, product.platform, product.polarization, date, "no orbit", stands=site.stands(date)
    )
    try:
        expected = product.to_image(site.geodetic(date))
    except InputError as error:
        status: Status = "no orbit" if product.orbit is None else "outside"
        return replace(blank, status=status, reason=str(error).removeprefix(f"{product.source}: "))
    facing = site.facing(expected.toward_radar)
    predicted = None
    if facing is not None and site.leg_m is not None:
        predicted = float(trihedral_rcs_m2(site.shape, site.leg_m, facing, expected.toward_radar, product.wavelength_m))
    date = product.date(expected.time_s)
    placed = replace(
        blank, date=date, stands=site.stands(date), expected=expected, facing=facing, closed_form_m2=predicted
    )
    grid = product.grid
    if not (-0.5 <= expected.line < grid.lines - 0.5 and -0.5 <= expected.pixel < grid.pixels - 0.5):
        at = f"line {expected.line:.1f}, pixel {expected.pixel:.1f}"
        shape = f"{grid.lines} lines, {grid.pixels} pixels"
        return replace(placed, status="outside", reason=f"it would lie at {at}; the image has {shape}")
    if product.samples is None:
        return replace(placed, status="no image", reason="annotation alone is there, without an image")
    return _measured(product, placed, expected, allowance_m, settings, radiometry)


def without_neighbours(found: Sequence[ReflectorObservation], settings: PointSettings) -> list[ReflectorObservation]:
    """Observations of one product, of which those whose window holds another reflector are "not apart".

    So are those whose peak is that of another reflector, which is expected nearer to it. Sites at one place are one
    device: ISCE3's table has it twice where its attitude was changed.
    """
    made = []
    for one in found:
        reason = ""
        for other in found:
            if other is one or not one.stands or not other.stands or not (one.response and other.response):
                continue
            off = _cells(one, other, "expected")
            if max(off) < ONE_PLACE_CELLS:
                continue
            if max(off) < settings.window_cells + CELLS_BESIDE:
                reason = (
                    f"{other.site.name} is expected {off[0]:.1f} cells away in azimuth and {off[1]:.1f} in slant "
                    f"range; the window of +- {settings.window_cells:g} cells holds both"
                )
            elif max(_cells(one, other, "point")) < 1.0 and _far(one) > _far(other):
                reason = (
                    f"its brightest point is {other.site.name}'s, which is expected nearer; allow less than it is away"
                )
            if reason:
                break
        made.append(replace(one, status="not apart", reason=reason) if reason else one)
    return made


def _cells(one: ReflectorObservation, other: ReflectorObservation, which: Literal["expected", "point"]) -> list[float]:
    """How far the places of two reflectors lie apart in azimuth and slant range, in resolution cells."""
    assert one.response is not None
    assert one.spacing_m is not None
    first, second = getattr(one, which), getattr(other, which)
    offsets = first.line - second.line, first.pixel - second.pixel
    return [
        abs(steps) * step / max(1.0 / axis.bandwidth, axis.pixel_m)
        for steps, step, axis in zip(offsets, one.spacing_m, one.response, strict=True)
    ]


def _far(one: ReflectorObservation) -> float:
    assert one.point is not None
    assert one.expected is not None
    assert one.spacing_m is not None
    return float(
        np.hypot(
            (one.point.line - one.expected.line) * one.spacing_m[0],
            (one.point.pixel - one.expected.pixel) * one.spacing_m[1],
        )
    )


def _measured(
    product: Product,
    placed: ReflectorObservation,
    expected: ImagedPoint,
    allowance_m: tuple[float, float],
    settings: PointSettings,
    radiometry: Radiometry | None,
) -> ReflectorObservation:
    grid, samples = product.grid, product.samples
    assert samples is not None
    spacing = product.spacing_m(expected)
    search = tuple(max(a / s, FEWEST_PIXELS) for a, s in zip(allowance_m, spacing, strict=True))
    response = responses(product, spacing)
    cells = [max(1.0 / axis.bandwidth, axis.pixel_m) for axis in response]
    reach = [
        int(np.ceil(far + settings.clutter_cells * cell / step))
        for far, cell, step in zip(search, cells, spacing, strict=True)
    ]
    centre = round(expected.line), round(expected.pixel)
    start = [max(c - r, 0) for c, r in zip(centre, reach, strict=True)]
    stop = [min(c + r + 1, n) for c, r, n in zip(centre, reach, (grid.lines, grid.pixels), strict=True)]
    needed = [far + settings.window_cells * cell / s for far, cell, s in zip(search, cells, spacing, strict=True)]
    placed = replace(placed, spacing_m=spacing)
    if any(
        at - need < low - 0.5 or at + need > high - 0.5
        for at, need, low, high in zip((expected.line, expected.pixel), needed, start, stop, strict=True)
    ):
        reason = (
            f"it would lie at line {expected.line:.1f}, pixel {expected.pixel:.1f}; what is searched and integrated "
            f"about it (allowance {allowance_m[0]:g} m, {allowance_m[1]:g} m) reaches beyond"
        )
        return replace(placed, status="too near the edge", reason=reason)
    try:
        raw = np.asarray(samples[slice(start[0], stop[0]), slice(start[1], stop[1])])
    except InputError as error:  # a file that was cut off
        return replace(placed, status="no image", reason=str(error).removeprefix(f"{product.source}: "))
    lines, pixels = np.arange(start[0], stop[0]), np.arange(start[1], stop[1])
    box = tuple(
        slice(max(int(at - need) - low, 0), int(np.ceil(at + need)) - low + 1)
        for at, need, low in zip((expected.line, expected.pixel), needed, start, strict=True)
    )
    bad = ~np.isfinite(raw) | ((raw == 0) if np.iscomplexobj(raw) else (raw <= 0))
    if bad[box].mean() > 0.25 or not np.isfinite(raw[box]).all():
        reason = f"{int(bad[box].sum())} of {bad[box].size} samples about it are zero, below zero, or not finite"
        return replace(placed, status="masked", reason=reason)
    raw = np.where(np.isfinite(raw), raw, 0)
    largest = np.maximum(np.abs(raw.real), np.abs(raw.imag)) if np.iscomplexobj(raw) else raw
    top = product.top
    if top is None and np.issubdtype(largest.dtype, np.floating):
        top = float(np.finfo(largest.dtype).max)
    if top is not None and (largest[box] >= top).any():
        reason = f"a sample about it has the largest number of the format, {top:g}"
        return replace(placed, status="saturated", reason=reason)
    radiometry = product.radiometry or radiometry
    factor = float(to_beta0(radiometry, expected.incidence_deg))
    gain = product.gain(lines[:, None], pixels) if product.gain is not None else np.ones((1, 1))
    chip: NDArray[Any]
    if product.quantity == "complex":
        chip = raw.astype(np.complex128) * np.sqrt(gain * factor)
        if product.demodulate is not None:
            chip = product.demodulate(lines.astype(float), pixels.astype(float), chip)
    else:
        chip = (raw.astype(np.float64) ** (2 if product.quantity == "amplitude" else 1)) * gain * factor
    within = expected.line - start[0], expected.pixel - start[1]
    found = measure_point(chip, within, (search[0], search[1]), spacing, response, settings)
    if found.clutter <= 0.0:
        return replace(placed, status="masked", reason="there is no clutter about it")
    point = replace(found, line=found.line + start[0], pixel=found.pixel + start[1])
    noise = None
    if product.noise is not None and radiometry is not None:
        at = float(product.noise(point.line, point.pixel)) * float(np.mean(gain)) * factor
        noise = float(10.0 * np.log10(at)) if at > 0.0 else None
    power = np.abs(chip) ** 2 if np.iscomplexobj(chip) else chip
    seen: Status = "measured" if point.seen else "not seen"
    status: Status = "no calibration" if radiometry is None else seen
    reason = {
        "measured": "",
        "not seen": "no peak stands out of the clutter within the allowance; the RCS is an upper bound",
        "no calibration": "the product does not say what its power is: no calibration annotation, and no --radiometry",
    }[status]
    cutout = Cutout(np.asarray(power, np.float64), start[0], start[1])
    return replace(placed, status=status, reason=reason, point=point, noise_db=noise, response=response, cutout=cutout)


def responses(product: Product, spacing_m: tuple[float, float]) -> tuple[ResponseAxis, ResponseAxis]:
    """Of azimuth and range, from the processed bands; where the product does not say, of one pixel's band."""
    range_hz, azimuth_hz = product.bandwidth_hz
    azimuth = azimuth_hz * abs(product.grid.line_s) / spacing_m[0] if azimuth_hz else 1.0 / spacing_m[0]
    along = 2.0 * range_hz / SPEED_OF_LIGHT if range_hz else 1.0 / spacing_m[1]
    whole = product.quantity != "complex"
    return (
        ResponseAxis(azimuth, product.hamming[1], spacing_m[0] if whole else 0.0, product.looks[1]),
        ResponseAxis(along, product.hamming[0], spacing_m[1] if whole else 0.0, product.looks[0]),
    )
