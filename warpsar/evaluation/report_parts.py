"""What the reports of evaluate and diagnose share: residual pictures, names of parameters, numbers with errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import convolve

from warpsar.compare.comparison import Comparison
from warpsar.evaluation.meshview import MeshView, look
from warpsar.io import html as report
from warpsar.io.grey_scale import GreyScale, in_decibel, tinted
from warpsar.io.html_image import ImageAxis
from warpsar.scene.scene import Scene
from warpsar.surface.stage import Stage

SMOOTHED = 3  # pixels on a side over which powers are averaged, so that speckle hides less
RESIDUAL_COLOURS = "RdBu_r"  # red: the measured image is brighter
AZIMUTHS_DEG = (205.0, 25.0)  # of the two looks at the mesh: askew to the compass
_NAMES = {
    "rms_height_m": ("h [mm]", 1e3),
    "correlation_length_m": ("l [mm]", 1e3),
    "specular_fraction": ("tau", 1.0),
}


def image_axes(scene: Scene) -> tuple[ImageAxis, ImageAxis]:
    """Range (down) and azimuth (along) of the scene's images, about the reference point [m]."""
    height, width = (n * s for n, s in zip(scene.grid.shape, scene.grid.spacing_m, strict=True))
    return ImageAxis("range [m]", -height / 2, height / 2), ImageAxis("azimuth [m]", -width / 2, width / 2)


def plus_minus(value: float, error: float) -> str:
    """A value and its standard error, to the digits that mean something."""
    digits = int(np.clip(1 - np.floor(np.log10(max(abs(error), 1e-6))), 0, 4))
    return f"{value:.{digits}f} ±\u00a0{error:.{digits}f}"


def shown_as(key: str) -> tuple[str, float]:
    """A surface parameter's name with its unit, and the factor from SI to that unit."""
    return _NAMES.get(key, (key, 1.0))


def shown_interval(ends: tuple[float | None, float | None], factor: float) -> str:
    """A 95 % interval in brackets, times `factor`; an end that is None is open."""
    low, high = (None if end is None else f"{end * factor:.3g}" for end in ends)
    if low is None and high is None:
        return "(open)"
    return f"(over {low})" if high is None else f"(under {high})" if low is None else f"({low} to {high})"


def reach_db(residuals: Sequence[np.ndarray], percent: float) -> float:
    """End of a residual's colour scale [dB]: `percent` of the compared pixels are inside, whole dB, 3 to 30."""
    residual = np.concatenate([np.abs(one) for one in residuals])
    return float(np.clip(np.ceil(np.percentile(residual, percent)), 3.0, 30.0))


def averaged_ratio_db(image: Comparison, dark: bool = False) -> np.ndarray:
    """Measured over modelled power [dB], each averaged over `SMOOTHED` pixels on a side, shape (rows, cols).

    Infinite where one of them has no power; NaN where both have none, or nothing is compared: off the lit surface by
    more than a few pixels, unless `dark`.
    """
    mask = image.usable if dark else image.usable & ~image.seen.dark
    box = np.ones((SMOOTHED, SMOOTHED))
    measured, modelled = (
        convolve(np.where(mask, np.maximum(np.nan_to_num(one), 0.0), 0.0).astype(float), box, mode="constant")
        for one in (image.measured, image.simulated)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = 10.0 * np.log10(measured / modelled)
    return np.where(mask, ratio, np.nan)


def residual_rgb(residual_db: np.ndarray, reach: float) -> np.ndarray:
    """Colours of a residual [dB], 0 to 1, shape (*residual_db.shape, 3); NaN is grey."""
    return report.colour(residual_db, RESIDUAL_COLOURS, -reach, reach)


def residual_scale(reach: float, label: str, unit: str = " dB") -> str:
    """The key of `residual_rgb`."""
    return report.scale(RESIDUAL_COLOURS, [f"−{reach:g}", "0", f"+{reach:g}{unit}"], label)


def beta0_rgb(
    powers: Sequence[np.ndarray], covered: Sequence[np.ndarray | None] | None = None
) -> tuple[list[np.ndarray], str]:
    """Greys of images of beta0, linear power, on one scale, shape (*power.shape, 3), and the key of the scale.

    `covered`: of each image, where a surface of the mesh lies, lit or hidden; None for a measured one. Pixels beyond
    the mesh are dark blue and do not count for the scale, as in a quick look.
    """
    masks = [None] * len(powers) if covered is None else covered
    pairs = list(zip(powers, masks, strict=True))
    scale = GreyScale.of([power if mask is None else power[mask] for power, mask in pairs])
    images = []
    for power, mask in pairs:
        grey = report.colour(scale.grey(in_decibel(power)), "gray", 0.0, 1.0)
        images.append(grey if mask is None else tinted(grey, mask))
    ends = any(mask is not None and not mask.all() for mask in masks)
    return images, report.beta0_scale(scale, beyond_mesh=ends)


def both_sides(stage: Stage, incidence_deg: float) -> list[tuple[float, MeshView]]:
    """The mesh from two opposite sides, each with its azimuth [deg]."""
    return [(azimuth, look(stage, azimuth, incidence_deg)) for azimuth in AZIMUTHS_DEG]
