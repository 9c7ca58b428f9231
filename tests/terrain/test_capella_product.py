"""A Capella SLC, made here: its place, power and noise by formulas of their own, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from product_files import CAPELLA_BAND as BAND
from product_files import CAPELLA_NESZ_DB as NESZ_DB
from product_files import CAPELLA_SCALE as SCALE
from product_files import SITE, capella_metadata, earth_fixed, nearest, place, write_capella
from terrain_files import dem, flat

import warpsar
from warpsar.errors import InputError
from warpsar.formats import registry

IMAGE = np.full((BAND.lines, BAND.pixels), 3.0 + 4.0j, np.complex64)


def written(folder: Path, said: dict[str, Any], *, inside: bool = True) -> Path:
    return write_capella(folder, IMAGE, said, inside=inside)


@pytest.mark.parametrize("inside", [True, False])
def test_the_site_lies_where_the_orbit_puts_it(tmp_path: Path, inside: bool) -> None:
    (found,) = registry.products(written(tmp_path, capella_metadata(), inside=inside))
    point = found.to_image(SITE)
    # times in the file are whole microseconds of lines 2 ms apart
    assert (point.line, point.pixel) == (pytest.approx(23.25, abs=1e-3), pytest.approx(47.75, abs=1e-3))
    assert found.side == "right"
    assert (found.platform, found.polarization, found.radiometry) == ("capella-14", "HH", "beta0")


def test_power_and_noise_are_beta0(tmp_path: Path) -> None:
    """|3 + 4j|^2 = 25 times the factor squared; NESZ is sigma0, and beta0 = sigma0 / sin(incidence)."""
    (found,) = registry.products(written(tmp_path, capella_metadata()))
    assert found.samples is not None
    assert found.gain is not None
    assert found.noise is not None
    value = found.samples[slice(2, 4), slice(5, 6)]
    gain = found.gain(23.0, 48.0)
    np.testing.assert_allclose(np.abs(value) ** 2 * gain, 25.0 * SCALE**2)
    time, _ = nearest(SITE)
    ray = place(time) - earth_fixed(SITE)
    lat, lon = np.deg2rad(SITE[:2])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    sine = np.sin(np.arccos(ray @ up / np.linalg.norm(ray)))
    assert found.noise(23.25, 47.75) * gain == pytest.approx(10.0 ** (0.1 * NESZ_DB) / sine, rel=1e-4)


def test_a_twin_lies_on_its_pixels(tmp_path: Path) -> None:
    found = warpsar.twin(
        written(tmp_path, capella_metadata()), dem(tmp_path, flat(31)), geoid_offset_m=0.0, device="cpu"
    )
    row, column = 23 - found.window.lines[0], 48 - found.window.pixels[0]
    shown = tuple(float(found.image[name][row, column]) for name in ("latitude", "longitude", "height"))
    time, distance = nearest(shown)  # type: ignore[arg-type]
    start, near = BAND.start()
    assert (time - start) / BAND.line_s == pytest.approx(23.0, abs=0.01)
    assert (distance - near) / BAND.step_m == pytest.approx(48.0, abs=0.01)
    assert found.image["measured"][row, column] == pytest.approx(25.0 * SCALE**2, rel=1e-5)


def changed(name: str, value: Any) -> dict[str, Any]:
    said = capella_metadata()
    *way, last = name.split(".")
    at = said
    for key in way:
        at = at[key]
    at[last] = value
    return said


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (capella_metadata(type="pfa"), "must be slant_plane"),
        (capella_metadata(type="geotransform"), "GEC and GEO lie on a map"),
        (
            capella_metadata(doppler_centroid_polynomial={"coefficients": [[800.0]]}),
            "lines must be those of zero Doppler",
        ),
        (capella_metadata(doppler_centroid_polynomial={"coefficients": "no"}), "must be numbers"),
        (capella_metadata(first_line_time="yesterday"), "must be a time in UTC"),
        (changed("collect.image.rows", 47), "its metadata says"),
        (changed("collect.image.scale_factor", 0), "must be a number above 0"),
        (changed("collect.image.radiometry", "amplitude"), "must be one of beta_nought"),
        (changed("collect.state.coordinate_system", {"type": "eci"}), "must be ecef"),
        (changed("collect.state.state_vectors", []), "must be at least 2"),
        (changed("collect.radar", {}), "found no collect.radar"),
    ],
)
def test_what_is_refused(tmp_path: Path, said: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        registry.products(written(tmp_path, said))


def test_another_polarization_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="found the polarization HH; VV was asked for"):
        registry.products(written(tmp_path, capella_metadata()), polarization="VV")


def test_the_json_alone_has_no_pixels(tmp_path: Path) -> None:
    path = tmp_path / "scene_extended.json"
    path.write_text(json.dumps(capella_metadata()))
    (found,) = registry.products(path)
    assert found.samples is None
    assert found.to_image(SITE).pixel == pytest.approx(47.75, abs=1e-3)
