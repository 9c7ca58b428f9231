"""SICD with a grid of range and zero Doppler: its places against sarkit's own projection."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from product_files import SITE, Band, earth_fixed, ground_speed
from sicd_files import write_rgzero

from warpsar.errors import InputError
from warpsar.formats import sicd

pytestmark = pytest.mark.unit


def test_places_are_those_of_sarkits_projection(tmp_path: Path) -> None:
    """Places all over the image. The aim is 0.1 pixel; both leave a thousandth where an iteration ends."""
    import sarkit.sicd as sarkit_sicd
    from sarkit.sicd import projection

    path = write_rgzero(tmp_path, np.ones((256, 256), np.complex64))
    (product,) = sicd.products(path, None)
    with path.open("rb") as file:
        parameters = projection.MetadataParams.from_xml(sarkit_sicd.NitfReader(file).metadata.xmltree)
    point = product.to_image(SITE)
    assert (point.line, point.pixel) == pytest.approx(Band().centre, abs=2e-3)
    back = product.to_ground(np.array([10.0, 128.0, 250.0]), np.array([240.0, 127.0, 5.0]), 250.0)
    for geodetic in back:
        (down, over), _, converged = projection.scene_to_image(parameters, earth_fixed(tuple(geodetic)))
        assert converged
        found = product.to_image(geodetic)
        pixel = down / product.grid.range_step_m + 127
        line = over / (ground_speed() * product.grid.line_s) + 128
        assert (found.line, found.pixel) == pytest.approx((line, pixel), abs=1e-3)


def test_a_grid_of_another_type_is_refused_in_one_line(tmp_path: Path) -> None:
    path = write_rgzero(tmp_path, np.ones((256, 256), np.complex64), Type="PLANE")
    with pytest.raises(InputError, match="a grid of the type PLANE; must be RGZERO"):
        sicd.products(path, None)
    with pytest.raises(InputError, match="found the polarization VV; HH was asked for"):
        sicd.products(write_rgzero(tmp_path, np.ones((256, 256), np.complex64)), "HH")
