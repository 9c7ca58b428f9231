"""A product's image as `import` takes it: placed by orbit and zero Doppler."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpsar.errors import InputError
from warpsar.formats.base.data import Facts, ImageChip, direction_deg
from warpsar.formats.base.format import Stated
from warpsar.products.product import Product
from warpsar.products.zero_doppler import abeam
from warpsar.world.earth import needed


def chip_of(product: Product, path: Path, stated: Stated) -> ImageChip:
    """The image of a product whose rows are lines and whose columns are pixels.

    Raises InputError without samples, without an orbit, and without a frame, as the file does not fix where the
    world lies.
    """
    orbit, grid, samples = product.orbit, product.grid, product.samples
    if samples is None:
        raise InputError(f"{product.source}: found annotation alone; its image must lie beside it")
    if orbit is None:
        raise InputError(f"{product.source}: found no state vectors of the orbit; must be there to place the image")
    if grid.burst_start_s:
        raise InputError(
            f"{product.source}: found {len(grid.burst_start_s)} bursts, whose spectrum drifts; must be an image "
            "without bursts, such as GRD (`warpsar reflectors` takes bursts)"
        )
    world = needed(stated.frame, path)

    def locate(points_m: np.ndarray) -> np.ndarray:
        time, distance = abeam(orbit, world.to_ecef(points_m), grid.middle_s)
        return np.stack([grid.line(time, distance), grid.pixel(time, distance)], axis=-1)

    def facts(reference_point_m: np.ndarray) -> Facts:
        point = world.to_ecef(reference_point_m)
        time, distance = abeam(orbit, point, grid.middle_s)
        azimuth, incidence = direction_deg(orbit.at(time)[0] - point, world, reference_point_m)
        pol = product.polarization
        return Facts(azimuth, incidence, product.frequency_hz, pol, float(distance), strip_map=True)

    def gain(pixel: np.ndarray) -> np.ndarray:
        assert product.gain is not None
        return product.gain(pixel[..., 0], pixel[..., 1])

    calibrated = product.radiometry == "beta0"
    middle = 0.5 * grid.lines, 0.5 * grid.pixels
    slant = abs(grid.slant_step_m(*middle))
    speed = float(np.linalg.norm(orbit.at(np.array(grid.middle_s))[1]))
    return ImageChip(
        source=product.source,
        samples=samples,
        quantity=product.quantity,
        facts=facts,
        spacing_m=(speed * abs(grid.line_s), slant),
        locate=locate,
        calibrated=calibrated,
        gain=gain if calibrated and product.gain is not None else None,
        top=None if product.quantity == "complex" else product.top,
    )
